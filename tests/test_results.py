"""Pages of results begin with three numbers of their own, end with how they were made, and stand in the overview."""

import ast
import re
import subprocess
import tomllib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from viewshed_lab import _page
from viewshed_lab._page import page, table
from viewshed_lab._results import KeyNumber, ResultPage, page_files, result_pages, shortened, write_page

FOLDER = Path(__file__).parents[1] / "docs" / "results"
NAMES = [name for each in result_pages().values() for name in each.files]
INDEX: Any = import_module("results_index")
RATES = table(["method", "P / R", "F1"], [["`a`", ".9 / .8", "**.85**"], ["`a`, past", ".7 / .6", ".65 [.6, .7]"]])
MORE = table(["method", "", "F1"], [["a", "1", ".1"], ["b", "2", ".2"]])
TEXT = f"## Rates\n\nabout\n\n{RATES}\n\nbetween\n\n{MORE}\n\n## Times\n\n### Apart\n\n{MORE}\n\n31 MB in all"


@pytest.mark.parametrize(
    ("number", "found"),
    [
        (KeyNumber("x", "Rates", "a |", "F1"), ".85"),
        (KeyNumber("x", "Rates", "a, past", "F1"), ".65 [.6, .7]"),
        (KeyNumber("x", "Rates", "a |", "P / R"), ".9 / .8"),
        (KeyNumber("x", "Rates #2", "b", "F1"), ".2"),
        (KeyNumber("x", "Apart", "a", ""), "1"),
        (KeyNumber("x", "Rates", "c", "F1"), None),
        (KeyNumber("x", "Rates", "a |", "recall"), None),
        (KeyNumber("x", "Times", "a", "F1"), None),
    ],
)
def test_a_key_number_is_a_cell_of_the_page(number: KeyNumber, found: str | None) -> None:
    assert number.find(TEXT) == found


def _worlds() -> str:
    """A page whose title is in the table, with what it leaves out: sections, tables and rows."""
    heading = "road, car"
    header = ["method", "other: precision / recall", "other: F1"]
    rows = [["continuous", ".8 / .7", ".75"], ["quantized", ".8 / .6", ".69"], ["shadow_map", ".9 / .8", ".85"]]
    four = "\n\n".join(f"told {k}\n\n{table(header, rows)}" for k in range(4))
    return page(
        "In the wild", {"seed": "3"}, f"## {heading}\n\n{four}\n\n## indoor, car\n\n{table(header, rows)}", "end"
    )


def test_numbers_on_top_facts_at_the_foot() -> None:
    text = _worlds()
    assert text.split("\n\n")[1] == (
        "- **.85** F1 of `shadow_map`, the default, on roads it was not made for, table, height and attitude given\n"
        "- **.9 / .8** precision / recall of the same"
    )
    assert re.search(r"end\n\n## How it was made\n\n- seed: 3\n(- sources: [0-9a-f]{12}\n)?\Z", text)


def test_what_is_left_out_stands_in_the_file_beside(tmp_path: Path) -> None:
    text = _worlds()
    assert write_page(tmp_path / "new" / "wild", text) == tmp_path / "new" / "wild.md"
    assert (tmp_path / "new" / "wild_full.md").read_text("utf-8") == text
    short = (tmp_path / "new" / "wild.md").read_text("utf-8")
    assert "indoor, car" not in short
    assert "quantized" not in short
    assert "`wild_full.md`" in short
    assert [k for k in range(4) if f"told {k}" in short] == [0, 1, 2]  # the fourth table goes, with its words
    assert (short.count("| shadow_map |"), short.count("| continuous |")) == (3, 3)
    assert "\n## How it was made\n\n- seed: 3\n" in short


def test_a_page_of_another_title_is_as_it_is() -> None:
    text = page("Mine", {"seed": "3"}, TEXT)
    assert shortened("mine", text) == text
    assert list(page_files("mine", text)) == ["mine.md"]
    assert text.startswith("# Mine\n\n## Rates")


@pytest.mark.parametrize("name", [name for name in NAMES if name != INDEX.LOG])
def test_each_published_page_has_its_numbers_and_how_it_was_made(name: str) -> None:
    text = (FOLDER / f"{name}.md").read_text(encoding="utf-8")
    title = text.partition("\n")[0].removeprefix("# ")
    body = "\n\n".join(text.split("\n\n")[2:])
    numbers = [f"- **{found}** {one.of}" for one in result_pages()[title].numbers if (found := one.find(body))]
    top = text.split("\n\n")[1]
    if result_pages()[title].numbers:
        assert top == "\n".join(numbers[:3])
    assert len(re.findall(r"^- .*\*\*", top, re.MULTILINE)) == 3
    assert re.search(r"^- sources: [0-9a-f]{12}$", text, re.MULTILINE)
    assert re.search(r"\n## How it was made\n\n- (?:.*\n)+\Z", text), name


def test_the_overview_names_every_page_with_its_number() -> None:
    assert {path.stem for path in FOLDER.glob("*.md")} - {"index", "archive"} == set(NAMES)
    index = (FOLDER / "index.md").read_text(encoding="utf-8")

    def without_ages(text: str) -> str:
        return re.sub(rf" {INDEX.OLDER}[^|]*\|", "  |", text)

    assert without_ages(index) == without_ages(INDEX.with_overview(index))


def test_every_source_of_a_page_is_there() -> None:
    sources = {path for each in result_pages().values() for path in each.sources}
    assert [path for path in sources if not (FOLDER.parents[1] / path).exists()] == []


NO_FIGURES = re.compile(
    r"viewshed/(__init__|_\w+|arrays|cli/_\w+|show/.*)\.py|viewshed_lab/(_\w+|data/__init__)\.py|benchmarks/report\.py"
    r"|viewshed_lab/studies/(figures|formatting|pages|plan|runner|store)\.py"
)
"""Modules that hold no figure: they store, schedule, draw or format."""


OWN = re.compile(r"/studies/(\w+|judges\.py|published_cases\.py|monitor/traces\.py)$|/benchmarks/|^tools/")
"""Programs that make pages; what several of them share is not followed further."""


@pytest.mark.parametrize(
    "page", [each for each in result_pages().values() if each.sources], ids=lambda page: page.title
)
def test_a_page_depends_on_what_its_study_imports(page: ResultPage) -> None:
    root = FOLDER.parents[1]
    own = [root / path for path in page.sources if OWN.search(path)]
    files = [file for path in own for file in ([path] if path.is_file() else path.rglob("*.py"))]
    bound = [root / path for path in page.sources]
    missing = {
        name
        for module in {module for file in files for module in _imported(file)}
        if not any(module.is_relative_to(path) for path in bound)
        and not NO_FIGURES.fullmatch(name := re.sub(r"^packages/[\w-]+/(src/)?", "", str(module.relative_to(root))))
    }
    assert missing == set()


def _imported(file: Path) -> set[Path]:
    """Return the modules of this repository that a module imports."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {(node.module, f"{node.module}.{each.name}") for each in node.names}
        elif isinstance(node, ast.Import):
            names |= {(each.name, each.name) for each in node.names}
    return {found for package, name in names if (found := _module(name) or _module(package))}


def _module(name: str) -> Path | None:
    packages = FOLDER.parents[1] / "packages"
    for folder in (packages / "viewshed" / "src", packages / "viewshed-lab" / "src", packages / "viewshed-lab"):
        place = folder.joinpath(*name.split("."))
        for path in (place.with_suffix(".py"), place / "__init__.py"):
            if path.is_file():
                return path
    return None


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """A repository with one module, one page made of it, and a function that runs git in it."""

    def git(*words: str) -> str:
        person = ("-c", "user.name=a", "-c", "user.email=a@b.c")
        command = ("git", *person, *words)
        return subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stdout.strip()

    def pages() -> dict[str, ResultPage]:
        text = (tmp_path / "src/viewshed/result_pages.toml").read_text("utf-8")
        return {each["title"]: ResultPage(**each) for each in tomllib.loads(text)["page"]}

    for module, name, value in (
        (_page, "_HERE", tmp_path), (_page, "result_pages", pages), (INDEX, "result_pages", pages),
        (INDEX, "ROOT", tmp_path), (INDEX, "FOLDER", tmp_path / "docs" / "results"),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, value)
    for folder in ("src/viewshed", "docs/results"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "src/viewshed/a.py").write_text("A = 1\n")
    about = '[[page]]\ntitle = "Areas"\ngroup = "All"\nfiles = ["areas"]\nsources = ["src/viewshed/a.py"]\n'
    (tmp_path / "src/viewshed/result_pages.toml").write_text(about)
    git("init", "-q")
    git("add", ".")
    (tmp_path / "docs/results/areas.md").write_text(page("Areas", {"date": "2026-01-02 10:00"}, "- **3** m²"))
    git("add", ".")
    git("commit", "-qm", "one")
    return git


def test_a_page_is_older_once_a_file_of_its_has_changed(repository: Callable[..., str], tmp_path: Path) -> None:
    folder = tmp_path / "docs/results"
    assert INDEX.OLDER not in INDEX.overview(folder)
    (tmp_path / "src/viewshed/a.py").write_text("A = 2\n")
    assert "| [Areas](areas.md) | **3** m² | older, of 2026-01-02 |" in INDEX.overview(folder)
    assert INDEX.rebind("HEAD") == ["areas"]
    assert INDEX.OLDER not in INDEX.overview(folder)


def test_a_page_names_the_commit_of_its_own_checkout_and_no_folder(
    repository: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "packages").mkdir()
    (tmp_path / "packages/a.py").write_text("A = 1\n")
    repository("add", ".")
    repository("commit", "-qm", "two")
    assert re.fullmatch("[0-9a-f]+", _page.commit_of(tmp_path))
    assert _page.commit_of(tmp_path / "packages") == "unknown"  # an installed package within somebody's repository
    (tmp_path / "packages/a.py").write_text("A = 2\n")
    assert _page.commit_of(tmp_path).endswith(" with local changes")
    monkeypatch.setattr("sys.argv", ["/bin/viewshed", "study", "--out=/home/a/b", "/home/a/c.json", "--seed=3", "d/e"])
    assert "study --out=b c.json --seed=3 d/e`" in _page.facts()["command"]
    monkeypatch.setenv("PATH", "")
    assert _page.commit_of(tmp_path) == "unknown"  # no git


def test_a_page_that_was_older_before_stays_so(repository: Callable[..., str], tmp_path: Path) -> None:
    folder = tmp_path / "docs/results"
    (tmp_path / "src/viewshed/a.py").write_text("A = 2\n")
    repository("commit", "-qam", "two")
    (tmp_path / "src/viewshed/b.py").write_text("A = 2\n")
    (tmp_path / "src/viewshed/a.py").unlink()
    settings = tmp_path / "src/viewshed/result_pages.toml"
    settings.write_text(settings.read_text().replace("a.py", "b.py"))
    repository("add", ".")
    assert INDEX.rebind("HEAD") == []
    assert INDEX.rebind("HEAD~1") == ["areas"]  # whoever says that nothing else changed since
    assert INDEX.OLDER not in INDEX.overview(folder)
