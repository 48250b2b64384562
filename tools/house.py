"""Report the layout of the package beside that of an earlier commit: lines by room, layers, circles, root modules.

    python tools/house.py [--before COMMIT] [--out docs/results/house.md]

Lines are those of Python files, with blank ones and comments. Layers and circles are counted on the imports of the
code itself, imports inside functions among them, those for type checkers not: a layer is one more than the longest
chain of rooms below it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from viewshed._files import write_atomic
from viewshed._page import facts, page, table

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "docs" / "results" / "house.md"


@dataclass(frozen=True, slots=True)
class House:
    """What is counted of one tree.

    Attributes:
        files: Python files.
        lines: by room; files in the root of the package are one room each, called by their file's name.
        root_modules: files in the root, ``__init__`` apart.
        layers: of the contract in pyproject.toml.
        circles: groups of modules that import each other.
    """

    files: int
    lines: dict[str, int]
    root_modules: tuple[str, ...]
    layers: int
    circles: int


def measure(tree: Path) -> House:
    """Return what is counted of a checkout."""
    package = tree / "src" / "viewshed"
    files = sorted(package.rglob("*.py"))
    lines: Counter[str] = Counter()
    for file in files:
        lines[file.relative_to(package).parts[0]] += len(file.read_text(encoding="utf-8").splitlines())
    roots = tuple(file.stem for file in files if file.parent == package and file.stem != "__init__")
    settings = tomllib.loads((tree / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    [layers] = [len(contract["layers"]) for contract in contracts if contract["id"] == "layers"]
    return House(len(files), dict(lines), roots, layers, _circles(tree / "src"))


_COUNT_CIRCLES = """
import sys, grimp
sys.path.insert(0, sys.argv[1])
graph = grimp.build_graph("viewshed", cache_dir=None, exclude_type_checking_imports=True)
below = {module: graph.find_upstream_modules(module) for module in graph.modules}
print(len({frozenset(other for other in below[one] if one in below[other]) for one in below} - {frozenset()}))
"""
"""Two modules are in one circle if each imports the other, directly or through others."""


def _circles(source: Path) -> int:
    """Return how many circles of imports there are, counted in a process that sees no other copy of the package."""
    command = [sys.executable, "-c", _COUNT_CIRCLES, str(source)]
    return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def at_commit(commit: str) -> House:
    """Return what is counted of a commit."""
    with tempfile.TemporaryDirectory() as folder:
        archive = subprocess.run(["git", "-C", str(ROOT), "archive", commit], check=True, capture_output=True)
        subprocess.run(["tar", "-x", "-C", folder], check=True, input=archive.stdout)
        return measure(Path(folder))


def report(before: House, after: House, commit: str) -> str:
    """Return both as Markdown tables."""
    rows = [
        ["Python files", str(before.files), str(after.files)],
        ["lines", f"{sum(before.lines.values()):,}", f"{sum(after.lines.values()):,}"],
        ["modules in the package's root", str(len(before.root_modules)), str(len(after.root_modules))],
        ["import layers", str(before.layers), str(after.layers)],
        ["circles of imports", str(before.circles), str(after.circles)],
    ]
    rooms = [[f"`{room}`", f"{lines:,}"] for room, lines in sorted(after.lines.items(), key=lambda item: -item[1])]
    old = [[f"`{room}`", f"{lines:,}"] for room, lines in sorted(before.lines.items(), key=lambda item: -item[1])]
    return "\n\n".join([
        table(["", f"before (`{commit}`)", "after"], rows),
        "Lines by room after:", table(["room", "lines"], rooms),
        "Lines by room before:", table(["room", "lines"], old),
    ])  # fmt: skip


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--before", default="30c0a4d", help="commit to compare with")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    text = report(at_commit(options.before), measure(ROOT), options.before)
    write_atomic(options.out, page("The layout, before and after", facts(), text).encode())
    print(f"wrote {options.out}")


if __name__ == "__main__":
    main()
