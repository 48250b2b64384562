"""Plant each fault of ``planted_faults.toml`` in a copy of the package and report which test catches it.

    python tools/planted_faults.py [--only WORD] [--out docs/results/planted_faults.md]

A fault is one replaced text. The tests named beside it run against the copy until the first one fails; if none does,
the fault is not caught and the exit code is 1. The copy without a fault must pass all of those tests first.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = Path("src") / "viewshed"
LIMIT_S = 600


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault: in ``file`` of the package, ``find`` (which must occur once) becomes ``replace``."""

    what: str
    file: str
    find: str
    replace: str
    tests: tuple[str, ...]


def read_faults(path: Path) -> list[Fault]:
    """Return the faults of a TOML file."""
    tables = tomllib.loads(path.read_text(encoding="utf-8"))["fault"]
    return [Fault(**(table | {"tests": tuple(table["tests"])})) for table in tables]


def copy_project(to: Path) -> None:
    """Copy package, tests, tools, pages and settings; compiled code comes along with the times of its sources."""
    for name in ("src", "tests", "tools", "docs", "configs"):
        shutil.copytree(ROOT / name, to / name)
    shutil.copy2(ROOT / "pyproject.toml", to / "pyproject.toml")


def plant(fault: Fault, project: Path) -> None:
    """Put the fault in; compiled code goes where the fault may be compiled into it.

    Raises:
        ValueError: the text to replace does not occur exactly once.
    """
    path = project / PACKAGE / fault.file
    text = path.read_text(encoding="utf-8")
    if text.count(fault.find) != 1:
        raise ValueError(
            f"{fault.file}: {fault.find!r} must occur once, found {text.count(fault.find)}; mend the fault"
        )
    path.write_text(text.replace(fault.find, fault.replace), encoding="utf-8")
    if "njit" in text:
        for cache in (project / PACKAGE).rglob("__pycache__"):
            shutil.rmtree(cache)


def first_failure(project: Path, tests: tuple[str, ...]) -> str | None:
    """Return the first test that fails, or None where all pass.

    Raises:
        RuntimeError: pytest could not run the tests.
    """
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no", "-p", "no:cacheprovider", *tests]
    environment = os.environ | {"PYTHONPATH": str(project / "src"), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    run = subprocess.run(
        command, cwd=project, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    if run.returncode == 0:
        return None
    caught = re.search(r"^(?:FAILED|ERROR) (\S+)", run.stdout, re.MULTILINE)
    if run.returncode not in (1, 2) or caught is None:
        raise RuntimeError(f"pytest failed with code {run.returncode}:\n{run.stdout[-2000:]}{run.stderr[-2000:]}")
    return caught[1]


def check_copy(project: Path) -> None:
    """Make sure that tests would import the copy.

    Raises:
        RuntimeError: they would import another.
    """
    code = "import viewshed; print(viewshed.__file__)"
    environment = os.environ | {"PYTHONPATH": str(project / "src")}
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    if not Path(run.stdout.strip()).is_relative_to(project):
        raise RuntimeError(f"the tests would import {run.stdout.strip()} instead of the copy in {project}")


def run_all(faults: list[Fault]) -> list[tuple[Fault, str | None]]:
    """Return each fault and the test that caught it.

    Raises:
        RuntimeError: a test fails without any fault.
    """
    results = []
    with tempfile.TemporaryDirectory() as folder:
        clean = Path(folder) / "clean"
        clean.mkdir()
        copy_project(clean)
        check_copy(clean)
        broken = first_failure(clean, tuple(dict.fromkeys(test for fault in faults for test in fault.tests)))
        if broken is not None:
            raise RuntimeError(f"{broken} fails without a fault")
        for number, fault in enumerate(faults, 1):
            project = Path(folder) / "planted"
            shutil.copytree(clean, project)
            plant(fault, project)
            results.append((fault, first_failure(project, fault.tests)))
            print(f"{number}/{len(faults)} {fault.what}: {results[-1][1] or 'NOT CAUGHT'}", flush=True)
            shutil.rmtree(project)
    return results


def report(results: list[tuple[Fault, str | None]]) -> str:
    """Return the results as a Markdown page."""
    caught = sum(test is not None for _, test in results)
    lines = [
        "# Planted faults",
        "",
        "Each fault is put into a copy of the package by hand, and the tests of its part run until one fails:",
        "`python tools/planted_faults.py` (the faults are in `tools/planted_faults.toml`).",
        "",
        f"**{caught} of {len(results)} caught.**",
        "",
        "| fault | file | first test that fails |",
        "|---|---|---|",
    ]
    for fault, test in results:
        name = "**not caught**" if test is None else f"`{test.replace('|', '/')}`"
        lines.append(f"| {fault.what} | `{fault.file}` | {name} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Run the faults, write the page, return 1 if one was not caught."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="run only the faults whose description or file holds this text")
    parser.add_argument("--out", type=Path, help="write the page to this file")
    given = parser.parse_args()
    faults = read_faults(Path(__file__).with_suffix(".toml"))
    results = run_all([fault for fault in faults if given.only in fault.what or given.only in fault.file])
    if given.out is not None:
        given.out.write_text(report(results), encoding="utf-8")
    return int(any(test is None for _, test in results))


if __name__ == "__main__":
    sys.exit(main())
