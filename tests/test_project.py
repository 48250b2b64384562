"""The project around the code: promises that README, docs and pyproject make."""

import ast
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import partial
from pathlib import Path

import docs_site
import pytest
import yaml

import viewshed

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted((ROOT / "packages").glob("*/src/**/*.py"))
PAGES = sorted((ROOT / "docs").rglob("*.md"))
HEAVY = ("numpy", "numba", "matplotlib", "PIL", "shapely", "onnxruntime", "pyarrow", "scipy", "typer")


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _words_for_users() -> str:
    return "\n".join(path.read_text(encoding="utf-8") for path in [ROOT / "README.md", *PAGES])


def test_import_loads_nothing_heavy() -> None:
    code = "import sys, json, viewshed; print(json.dumps(sorted(sys.modules)))"
    loaded = json.loads(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True).stdout)
    assert "viewshed" in loaded
    assert not [name for name in HEAVY if name in loaded]


def test_estimating_needs_no_drawing_and_no_packet_reader() -> None:
    code = "import sys, json, viewshed; viewshed.ESTIMATORS; print(json.dumps(sorted(sys.modules)))"
    loaded = json.loads(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True).stdout)
    assert not [name for name in ("matplotlib", "ouster", "velodyne_decoder", "typer") if name in loaded]


def test_every_public_name_exists_and_has_a_docstring() -> None:
    assert set(viewshed.__all__) <= set(dir(viewshed))
    for name in viewshed.__all__:
        assert getattr(viewshed, name).__doc__, f"viewshed.{name} has no docstring"
    with pytest.raises(AttributeError, match="no attribute 'no_such_name'"):
        _ = viewshed.no_such_name


def test_every_public_name_is_in_the_docs() -> None:
    words = _words_for_users()
    assert [name for name in viewshed.__all__ if not re.search(rf"\b{name}\b", words)] == []


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT / "packages")))
def test_public_definitions_have_docstrings(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    public = [node for node in tree.body if isinstance(node, kinds) and not node.name.startswith("_")]
    assert [node.name for node in public if ast.get_docstring(node) is None] == []


def test_version_is_in_changelog_and_citation() -> None:
    newest = re.search(r"^## (\d\S*)", _text("CHANGELOG.md"), re.MULTILINE)  # "Unreleased" may stand above
    assert newest is not None
    assert newest[1] == viewshed.__version__
    assert yaml.safe_load(_text("CITATION.cff"))["version"] == viewshed.__version__


def test_every_command_and_estimator_is_documented() -> None:
    words, rows = _words_for_users(), re.findall(r"^\| .*", _text("docs/cli.md"), re.MULTILINE)
    listed = {name for row in rows for name in re.findall(r"`([a-z ]+)`", row)}
    listed |= {f"study {name}" for row in rows if row.startswith("| study") for name in re.findall(r"`([a-z]+)`", row)}
    assert set(docs_site.command_names()) <= listed
    assert [name for name in viewshed.ESTIMATORS if f"`{name}`" not in words] == []


def test_no_grab_bags_and_no_open_ends() -> None:
    assert [path.name for path in SOURCES if path.stem in {"utils", "helpers", "common", "misc"}] == []
    marks = re.compile("|".join(["TO" + "DO", "FIX" + "ME", "X" * 3]))
    assert [str(path) for path in _tracked() if _is_text(path) and marks.search(path.read_text("utf-8"))] == []


def test_tracked_files_name_no_machine() -> None:
    words = ("/wo", "rk/"), ("/opt/", "wheels"), ("py", "pi.org"), ("pythonho", "sted"), ("registry.", "npm")
    machine = re.compile("|".join(re.escape("".join(parts)) for parts in words))
    found = [str(path) for path in _tracked() if _is_text(path) and machine.search(path.read_text("utf-8"))]
    assert found == []


def _tracked() -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=False, capture_output=True, text=True)
    if listed.returncode != 0:
        pytest.skip("not a git checkout: tracked files are not known")
    return [ROOT / name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]


def _is_text(path: Path) -> bool:
    return path.suffix in {".py", ".md", ".toml", ".yml", ".cff", ".json", ".geojson", ".txt", ""} and (
        b"\0" not in path.read_bytes()
    )


def test_license_is_apache() -> None:
    assert "Apache License" in _text("LICENSE")
    for package in ("viewshed", "viewshed-lab"):
        assert 'license = "Apache-2.0"' in _text(f"packages/{package}/pyproject.toml")
        assert _text(f"packages/{package}/LICENSE") == _text("LICENSE")


def test_what_a_robot_installs_names_no_module_of_the_laboratory() -> None:
    """Nor where types are checked alone, which import-linter does not see."""
    named = set()
    for path in (ROOT / "packages" / "viewshed" / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules += [each.name for each in node.names] if isinstance(node, ast.Import) else []
            named |= {str(path) for module in modules if module.partition(".")[0] == "viewshed_lab"}
    assert named == set()


def test_every_page_is_in_the_navigation_and_every_link_leads_somewhere() -> None:
    site = yaml.safe_load(_text("mkdocs.yml"))
    notebooks = [path.with_suffix(".md") for path in (ROOT / "docs" / "notebooks").glob("*.ipynb")]
    pages = [str(path.relative_to(ROOT / "docs")) for path in [*PAGES, *notebooks]]
    kept = [page for page in pages if not any(map(partial(fnmatch, page), site["exclude_docs"].split()))]
    assert sorted(_leaves(site["nav"])) == sorted([*kept, *docs_site.ELSEWHERE])
    for page in [*(ROOT / name for name in ("README.md", *docs_site.ELSEWHERE.values())), *PAGES]:
        prose = re.sub(r"^```.*?^```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        for target in re.findall(r"\]\((?!https?://|#|mailto:)([^)#\s]+)", prose):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def _leaves(node: object) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    for child in node if isinstance(node, list) else node.values() if isinstance(node, dict) else ():
        yield from _leaves(child)


def test_make_commands_in_the_pages_are_targets() -> None:
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES]
    shown = {
        target
        for page in pages
        for block in re.findall(r"^```sh\n(.*?)^```|`(make [a-z]+)`", page.read_text("utf-8"), re.MULTILINE | re.DOTALL)
        for target in re.findall(r"^make ([a-z]+)", "\n".join(block), re.MULTILINE)
    }
    assert shown
    assert shown <= set(re.findall(r"^([a-z]+):", _text("Makefile"), re.MULTILINE))


SNIPPETS = [
    str(path.relative_to(ROOT))
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    if re.search(r"^```py", path.read_text(encoding="utf-8"), re.MULTILINE)
]


@pytest.mark.parametrize("page", SNIPPETS)
def test_python_in_the_pages_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs every python block of a page, in order, and compares what the comments after # → say."""
    blocks = re.findall(r"^```py\w*\n(.*?)^```", _text(page), re.MULTILINE | re.DOTALL)
    assert blocks, f"{page} shows no Python"
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {}
    code = "".join(blocks)
    for statement in ast.parse(code).body:
        said = code.splitlines()[statement.end_lineno - 1].partition("# →")[2] if statement.end_lineno else ""
        if said:
            assert str(eval(ast.unparse(statement), scope)) == said.strip(), ast.unparse(statement)
        else:
            exec(ast.unparse(statement), scope)


def test_shell_scripts_parse() -> None:
    checked = subprocess.run(["bash", "-n", str(ROOT / ".ci" / "run")], check=False, capture_output=True)
    assert checked.returncode == 0
    assert os.access(ROOT / ".ci" / "run", os.X_OK)
