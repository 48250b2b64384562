"""The faults that ``tools/planted_faults.py`` plants fit the code, wherever their symbols are."""

import ast
import builtins
import re
import sys
import textwrap
from collections import Counter
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "viewshed"
sys.path.insert(0, str(ROOT / "tools"))
tool: Any = import_module("planted_faults")
FAULTS = tool.read_faults(ROOT / "tools" / "planted_faults.toml")
SYMBOLS = tool.read_symbols(PACKAGE)
WORDS = frozenset(re.findall(r"\w+", "".join(path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))))

every_fault = pytest.mark.parametrize("fault", FAULTS, ids=[fault.what for fault in FAULTS])


def names(tree: ast.AST) -> set[str]:
    """Return the names that code reads and does not define itself."""
    read = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}
    made = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return read - made - {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}


def attributes(tree: ast.AST) -> set[str]:
    return {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}


def words(source: str) -> set[str]:
    return set(re.findall(r"[A-Za-z_]\w*", source))


@every_fault
def test_a_fault_fits_in_one_place_and_its_code_could_run(fault: Any, tmp_path: Path) -> None:
    planted = tool.plant(fault, SYMBOLS, PACKAGE)
    if planted.symbol.is_native:
        assert planted.before != planted.after
        source = (PACKAGE / planted.symbol.file).read_text(encoding="utf-8")
        assert words(planted.after) <= words(source) | {"true", "false"}
        return
    copy = tmp_path / planted.symbol.file
    copy.parent.mkdir(parents=True, exist_ok=True)
    sound = (PACKAGE / planted.symbol.file).read_text(encoding="utf-8")
    copy.write_text(sound, encoding="utf-8")
    planted.write(tmp_path)
    faulty = copy.read_text(encoding="utf-8")
    compile(faulty, str(copy), "exec")
    assert ast.dump(ast.parse(faulty)) != ast.dump(ast.parse(sound))
    # A fault that uses a name which is not there would be caught by any test at all, and so say nothing.
    before, after = (ast.parse(textwrap.dedent(source)) for source in (planted.before, planted.after))
    in_reach = {symbol.name for symbol in SYMBOLS if symbol.file == planted.symbol.file} | set(dir(builtins))
    assert names(after) <= names(before) | in_reach
    assert attributes(after) <= attributes(before) | WORDS


def test_every_fault_is_described_in_its_own_words() -> None:
    assert [what for what, times in Counter(fault.what for fault in FAULTS).items() if times > 1] == []


def test_every_test_beside_a_fault_exists() -> None:
    missing = [test for fault in FAULTS for test in fault.tests if not (ROOT / test.partition("::")[0]).exists()]
    assert missing == []
    assert [fault.what for fault in FAULTS if not fault.tests] == []


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with two modules: both have ``same``, only one has ``Grid.index``."""
    folder = tmp_path / "house"
    (folder / "room").mkdir(parents=True)
    (folder / "__init__.py").write_text("from .room import grid\n")
    (folder / "room" / "__init__.py").write_text("")
    (folder / "room" / "grid.py").write_text(
        "LIMIT = 3\n\n\n@njit\ndef same(i, j):\n    return i * LIMIT + j\n\n\n"
        "class Grid:\n    cells: int = 4\n\n    def index(self, i, j):\n"
        "        return place(\n            i,\n            j,  \n        ) + i_j\n\n"
        "    def other(self, i, j):\n        return i\n"
    )
    (folder / "walls.py").write_text("from house.room.grid import LIMIT\n\n\ndef same(i):\n    return i\n")
    return folder


def planted(package: Path, symbol: str, find: str, replace: str) -> Any:
    return tool.plant(tool.Fault("x", symbol, find, replace, ()), tool.read_symbols(package), package)


def test_a_fault_is_planted_in_its_symbol_alone(package: Path) -> None:
    fault = planted(package, "Grid.index", "place(i, j)", "place(j, i)")
    fault.write(package)
    source = (package / "room" / "grid.py").read_text()
    assert "        return place(j, i) + i_j\n\n    def other(self, i, j):\n        return i\n" in source
    assert source.startswith("LIMIT = 3\n\n\n@njit\ndef same(i, j):\n    return i * LIMIT + j\n")


@pytest.mark.parametrize(
    ("symbol", "find", "file"),
    [
        ("LIMIT", "3", "room/grid.py"),
        ("Grid.cells", "4", "room/grid.py"),
        ("house.room.grid:same", "LIMIT", "room/grid.py"),
        ("house.walls:same", "return i", "walls.py"),
    ],
)
def test_a_symbol_is_found_in_whatever_file_it_is(package: Path, symbol: str, find: str, file: str) -> None:
    assert planted(package, symbol, find, "5").symbol.file == Path(file)
    (package / file).rename(package / "moved.py")
    moved = f"house.moved:{symbol.partition(':')[2]}" if ":" in symbol else symbol
    assert planted(package, moved, find, "5").symbol.file == Path("moved.py")


@pytest.mark.parametrize(
    ("symbol", "find", "message"),
    [
        ("same", "i", r"is 2: house.room.grid:same, house.walls:same; write one of them"),
        ("Grid.inde", "i", r"must be in the package, got 'Grid.inde'; did you mean .*:Grid.index\b"),
        ("house.bath:same", "i", r"did you mean house.room.grid:same, house.walls:same"),
        ("Grid.other", "place", r"must occur once in Grid.other, found 0 times"),
        ("Grid.other", "i", r"must occur once in Grid.other, found 2 times"),
        ("Grid.other", "retur", r"found 0 times"),
    ],
)
def test_a_fault_that_does_not_fit_is_refused(package: Path, symbol: str, find: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        planted(package, symbol, find, "k")


def test_functions_and_constants_of_the_core_are_found(package: Path) -> None:
    core = package.parent / "core"
    core.mkdir()
    (core / "walls.cpp").write_text(
        "namespace house {\n"
        "constexpr float LOW_M = 1.0f, HIGH_M = 2.0f;\n"
        "constexpr int TABLE[] = {\n    1,\n    2,\n};\n"
        "struct Wall {\n    int width;\n};\n\n"
        "INLINE bool is_low(float z,\n                   int i) {\n    return z < LOW_M;\n}\n\n"
        "void declared(int i);\n\n"
        "float same(float z) {\n    return is_low(z, 1) ? z : 0.0f;\n}\n"
        "}  // namespace house\n"
    )
    found = {(each.name, each.first, each.last) for each in tool.read_symbols(package) if each.module == "core.walls"}
    assert found == {
        ("LOW_M", 2, 2), ("HIGH_M", 2, 2), ("TABLE", 3, 6), ("is_low", 11, 14), ("same", 18, 20),
    }  # fmt: skip
    fault = planted(package, "core.walls:is_low", "z < LOW_M", "z > LOW_M")
    fault.write(package)
    assert "    return z > LOW_M;\n}\n\nvoid declared(int i);" in (core / "walls.cpp").read_text()
    assert fault.symbol.is_native


@pytest.mark.parametrize(
    ("symbol", "find", "stale"),
    [
        ("LIMIT", "3", {"grid.same-5", "walls.same-4"}),
        ("house.room.grid:same", "LIMIT", {"grid.same-5", "walls.same-4"}),
        ("Grid.other", "return i", set()),
        ("house.walls:same", "return i", set()),
    ],
)
def test_compiled_code_that_may_hold_the_sound_version_goes(
    package: Path, symbol: str, find: str, stale: set[str]
) -> None:
    (package / "apart.py").write_text("def alone():\n    return 1\n")
    caches = {"apart.alone-1": package, "walls.same-4": package, "grid.same-5": package / "room"}
    ends = ("py311.nbi", "py311.1.nbc")
    files = {name: [folder / "__pycache__" / f"{name}.{end}" for end in ends] for name, folder in caches.items()}
    for path in (path for paths in files.values() for path in paths):
        path.parent.mkdir(exist_ok=True)
        path.touch()
    tool.drop_compiled(planted(package, symbol, find, "2"), package, tool.importers(package))
    assert {name for name, paths in files.items() if not any(path.exists() for path in paths)} == stale
    assert {name for name, paths in files.items() if all(path.exists() for path in paths)} == set(caches) - stale
