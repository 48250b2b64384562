"""The site: what it takes from the code, the pages that quote the code, and the notebooks."""

import ast
import json
import re
import shutil
from pathlib import Path

import docs_site
import pytest

from viewshed.cli import main

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))


def test_every_generated_table_stands_on_its_page_as_the_code_has_it() -> None:
    pages = [ROOT / "README.md", *PAGES]
    marks = {
        mark for page in pages for mark in re.findall(r"^<!-- generated: (\w+) -->", page.read_text("utf-8"), re.M)
    }
    assert marks == set(docs_site.GENERATED)
    for page in pages:
        text = page.read_text("utf-8")
        assert docs_site.with_tables(text) == text, f"{page.name}: python tools/docs_site.py writes it"


def test_figures_of_the_readme_are_in_the_pages_that_their_rows_link() -> None:
    rows = docs_site.figures().splitlines()[2:]
    assert len(rows) >= 5
    for row in rows:
        link, _, figure, where, given = (cell.strip() for cell in row.strip("|").split("|"))
        page = (ROOT / re.findall(r"\((docs/results/\w+\.md)\)", link)[0]).read_text("utf-8")
        numbers = re.findall(r"(?<!\d)\d*\.\d+", figure)
        assert numbers
        assert [number for number in numbers if number not in page] == []
        assert ("simulated" in where) or ("real" in where)
        assert given


def test_generated_tables_hold_the_program() -> None:
    assert "| `study robustness` |" in docs_site.command_table()
    from viewshed.sensors import sensor_names
    from viewshed_lab.sim.worlds import WORLDS
    from viewshed_lab.threats.attacks import ATTACKS
    from viewshed_lab.threats.corruptions import SEVERITIES

    for table, names in (
        ("sensors", sensor_names()),
        ("worlds", WORLDS),
        ("attacks", ATTACKS),
        ("corruptions", SEVERITIES),
    ):
        text = docs_site.GENERATED[table]()
        assert [name for name in names if f"`{name}`" not in text] == []
        assert len({line.count("|") for line in text.splitlines()}) == 1


def test_the_command_line_page_has_every_command_and_option() -> None:
    text = docs_site.commands()
    assert "## viewshed estimate\n" in text
    assert "## viewshed study robustness\n" in text
    assert "reproduce" not in text
    estimate = text.split("## viewshed estimate\n")[1].split("\n## ")[0]
    assert "--require-confirmation" in estimate
    assert "Example: viewshed estimate" in estimate


def test_a_picture_opens_in_full_size() -> None:
    page = docs_site.on_page_content('<p><img alt="a street" src="../assets/a.png" /></p>')
    assert page == '<p><a href="../assets/a.png"><img alt="a street" src="../assets/a.png" /></a></p>'


def test_every_export_is_on_its_page() -> None:
    from viewshed.io.export import EXPORTERS

    page = (DOCS / "export.md").read_text("utf-8")
    assert [name for name in EXPORTERS if f"| `{name}`" not in page] == []


def test_what_the_table_of_the_published_system_names_exists() -> None:
    table = (DOCS / "agents.md").read_text("utf-8").split("## The published system, row by row\n")[1]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in re.findall(r"^\| .*\|$", table, re.M)]
    folders = [*ROOT.glob("packages/*/src"), *ROOT.glob("packages/*/tests"), ROOT / "ros" / "viewshed_ros"]
    places = [path for folder in folders for path in folder.rglob("*.py") if "build" not in path.parts]
    tests = set(re.findall(r"^def (test_\w+)", "\n".join(map(_text, places)), re.M))
    assert len(rows) > 30
    for what, where, test in rows[1:]:
        for name in re.findall(r"`([\w.]+\.\w+)`", where):
            module, _, defined = name.rpartition(".")
            files = [path for path in places if path.as_posix().endswith(f"/{module.replace('.', '/')}.py")]
            assert len(files) == 1, f"{what}: no one module {module}"
            assert re.search(rf"^(?:def |class )?{defined}\b", _text(files[0]), re.M), f"{what}: {name} is not there"
        named = re.findall(r"`(\w+)`", test)
        assert set(named) <= tests, f"{what}: {test} is not there"
        assert named or where.startswith("not here: "), f"{what}: name a test, or say why it is not here"


def _text(path: Path) -> str:
    return path.read_text("utf-8")


def test_commands_and_options_of_the_pages_exist() -> None:
    offered = {name: set(re.findall(r"--[a-z0-9-]+", text)) for name, text in _helps().items()}
    for page in [ROOT / "README.md", *DOCS.glob("*.md")]:
        blocks = re.findall(r"^```(?:sh|console|bash)\n(.*?)^```", page.read_text("utf-8"), re.MULTILINE | re.DOTALL)
        lines = "\n".join(line.split("#")[0] for line in "\n".join(blocks).splitlines())
        for words in re.findall(r"^(?:\$ |[A-Z_]+=\S+ | +)?viewshed (\S.*)", lines, re.MULTILINE):
            first, second = [*words.split(), ""][:2]
            name = f"{first} {second}" if f"{first} {second}" in offered else first
            assert name in offered, f"{page.name}: viewshed {words}"
            assert set(re.findall(r"--[a-z0-9-]+", words)) <= offered[name], f"{page.name}: viewshed {words}"


def _helps() -> dict[str, str]:
    """What ``--help`` prints of every command."""
    parts = docs_site.commands().removeprefix("## viewshed ").split("\n## viewshed ")
    return {name: text for name, _, text in (part.partition("\n") for part in parts)}


def _literals() -> str:
    """All texts of the package; what is filled in is …"""
    texts = []
    for path in sorted((ROOT / "packages").glob("*/src/**/*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.JoinedStr):
                texts.append(
                    "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
                )
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    return "\n".join(texts)


def test_messages_of_the_questions_page_are_those_of_the_code() -> None:
    cells = re.findall(r"^\| (.*?) \|", (DOCS / "faq.md").read_text("utf-8"), re.MULTILINE)
    quotes = [quote for cell in cells for quote in re.findall(r"`([^`]+)`", cell) if " " in quote]
    parts = {part.strip(" ,;.") for quote in quotes for part in quote.split("…")}
    words = _literals()
    assert len(parts) > 20
    assert [part for part in parts if len(part) > 8 and part not in words] == []


@pytest.mark.slow
def test_the_tutorial_prints_what_it_says(real_data: Path, tmp_path: Path) -> None:
    text = (DOCS / "tutorial.md").read_text("utf-8")
    shutil.copy(real_data / docs_site.TUTORIAL_SWEEP, tmp_path)
    fresh = docs_site.transcript(text, tmp_path)
    assert _without_times(fresh) == _without_times(text), "python tools/docs_site.py writes it"


@pytest.mark.slow
@pytest.mark.parametrize("attack", ["replay", "relay"])
def test_verdicts_of_the_readme_are_those_of_its_commands(
    attack: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each row quotes what the monitor says of the first forged sweep, the one of second 2."""
    text = (ROOT / "README.md").read_text("utf-8")
    [quoted] = re.findall(rf"^\| `{attack}`.*?\| `(.*?)`", text, re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo").mkdir()
    for command in re.findall(rf"^viewshed ((?:record|monitor) .*demo/{attack}\.mcap)$", text, re.MULTILINE):
        with pytest.raises(SystemExit) as ended:
            main(command.split())
        assert not ended.value.code
    [said] = re.findall(rf"^{attack}\.mcap 00020: (.*)", capsys.readouterr().out, re.MULTILINE)
    assert said == quoted


def _without_times(text: str) -> str:
    """A page without times, and of a monitor's line no more than its verdict: its calibration comes anew more often."""
    text = re.sub(r"(INCONSISTENT|DEGRADED|nothing found) .*(\n  .*)*", r"\1", text)
    return re.sub(r"[\d.]+ (?=ms|\|$)", "", text, flags=re.MULTILINE)


NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def test_notebooks_are_clean() -> None:
    assert len(NOTEBOOKS) == 2
    for notebook in NOTEBOOKS:
        cells = json.loads(notebook.read_text("utf-8"))["cells"]
        outputs = [output for cell in cells for output in cell.get("outputs", [])]
        assert outputs, f"{notebook.name} has no outputs: jupyter execute --inplace {notebook.name}"
        assert [output for output in outputs if output["output_type"] == "error"] == []
        assert notebook.stat().st_size < 600_000


@pytest.mark.docs
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_and_say_the_same(notebook: Path) -> None:
    """Runs a notebook in a kernel of its own and compares what it prints with what is stored."""
    nbformat = pytest.importorskip("nbformat", reason="needs the extra docs")
    nbclient = pytest.importorskip("nbclient", reason="needs the extra docs")
    stored = nbformat.read(notebook, as_version=4)
    fresh = nbclient.NotebookClient(nbformat.read(notebook, as_version=4), timeout=300).execute()
    kept = [k for k, cell in enumerate(stored.cells) if "varies" not in cell.metadata.get("tags", [])]
    printed, before = ([docs_site.printed_by(book.cells[k]) for k in kept] for book in (fresh, stored))
    assert printed == before, f"jupyter execute --inplace docs/notebooks/{notebook.name}"
