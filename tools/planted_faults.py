"""Plant each fault of ``planted_faults.toml`` in a copy of the native core and say which test notices it.

    python tools/planted_faults.py [--only WORD]

A fault names a file of the core and one replaced text in it.
The core of the copy is compiled again for each, and the tests named beside it run until the first one fails. The exit
code is 1 if a fault is not caught, or could not be judged: its tests fail without it, or it does not compile.
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
CORE = Path("packages") / "viewshed" / "src" / "core"
LIMIT_S = 600


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault: in ``file`` of the core, ``find`` (unique, white space ignored) is replaced by ``replace``."""

    what: str
    file: str
    find: str
    replace: str
    tests: tuple[str, ...]


def read_faults(path: Path) -> list[Fault]:
    """Return the faults of a TOML file."""
    tables = tomllib.loads(path.read_text(encoding="utf-8"))["fault"]
    return [Fault(**(table | {"tests": tuple(table["tests"])})) for table in tables]


def plant(fault: Fault, core: Path) -> tuple[Path, str]:
    """Return the file of the core that a fault is in, and its content with the fault.

    Raises:
        ValueError: the file does not hold the text exactly once.
    """
    path = core / fault.file
    source = path.read_text(encoding="utf-8")
    tokens = re.findall(r"\w+|[^\w\s]", fault.find)
    pattern = r"\s*".join(rf"\b{token}\b" if token[0].isalnum() else re.escape(token) for token in tokens)
    matches = list(re.finditer(pattern, source))
    if len(matches) != 1:
        raise ValueError(f"`find` must occur once in {fault.file}, found {len(matches)} times: {fault.find!r}; mend it")
    start, end = matches[0].span()
    return path, source[:start] + fault.replace + source[end:]


def environment_of(project: Path) -> dict[str, str]:
    """Return the environment of a process that imports viewshed from a copy, also beside an editable install."""
    sources = (project / "packages" / name / "src" for name in ("viewshed", "viewshed-lab"))
    paths = [ROOT / "tools" / "startup", *sources, os.environ.get("PYTHONPATH", "")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, map(str, paths)))}


def make_copy(project: Path) -> None:
    """Copy package, core, tests and settings, and compile the core of the copy."""
    for name in ("packages", "tests", "tools", "docs"):
        shutil.copytree(ROOT / name, project / name, ignore=shutil.ignore_patterns("__pycache__", "build", "_core*.so"))
    for name in ("pyproject.toml", "conftest.py"):
        shutil.copy2(ROOT / name, project / name)
    places = ("-S", str(project / "packages" / "viewshed"), "-B", str(project / "build"))
    configure = ("cmake", *places, f"-DPython_EXECUTABLE={sys.executable}")
    subprocess.run(configure, capture_output=True, check=True)
    build(project)
    command = (sys.executable, "-c", "import viewshed; print(viewshed.__file__)")
    run = subprocess.run(command, env=environment_of(project), capture_output=True, text=True, check=True)
    if not Path(run.stdout.strip()).is_relative_to(project):
        raise RuntimeError(f"tests would import {run.stdout.strip()}, not the copy")


def build(project: Path) -> None:
    """Compile the changed files of the core of a copy."""
    run = subprocess.run(("cmake", "--build", str(project / "build")), capture_output=True, text=True, check=False)
    if run.returncode != 0:
        raise RuntimeError(f"the core does not compile: {(run.stdout + run.stderr)[-300:].strip()}")


def first_failure(project: Path, tests: tuple[str, ...]) -> str | None:
    """Return the first test that fails, or None if all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no", "-p", "no:cacheprovider", *tests]
    environment = environment_of(project) | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "COLUMNS": "1000"}
    run = subprocess.run(
        command, cwd=project, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    if run.returncode == 0:
        return None
    failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", run.stdout, re.MULTILINE)
    if run.returncode not in (1, 2) or failed is None:
        raise RuntimeError(f"pytest failed with code {run.returncode}: {(run.stderr or run.stdout)[-300:].strip()}")
    return failed[1]


def judge(fault: Fault, project: Path) -> str | None:
    """Return the first test that fails with a fault, or None; restore the source afterwards (without a build)."""
    path, faulty = plant(fault, project / CORE)
    original = path.read_text(encoding="utf-8")
    try:
        path.write_text(faulty, encoding="utf-8")
        build(project)
        return first_failure(project, fault.tests)
    finally:
        path.write_text(original, encoding="utf-8")


def main() -> int:
    """Run the faults; return 1 if one was not caught."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="run only the faults whose description or file holds this text")
    only = parser.parse_args().only
    faults = [one for one in read_faults(Path(__file__).with_suffix(".toml")) if only in f"{one.what} {one.file}"]
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        make_copy(Path(folder))
        tests = tuple(dict.fromkeys(test for fault in faults for test in fault.tests))
        if failed := first_failure(Path(folder), tests):
            raise SystemExit(f"{failed} fails without a fault")
        for fault in faults:
            caught_by = judge(fault, Path(folder))
            print(f"{fault.what}: {caught_by or 'NOT CAUGHT'}", flush=True)
            missed += [] if caught_by else [fault.what]
    print(f"{len(faults) - len(missed)} of {len(faults)} caught")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
