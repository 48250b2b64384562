"""Plant each fault of ``planted_faults.toml`` in a copy of the package and report which test catches it.

    python tools/planted_faults.py [--only WORD] [--jobs N] [--out docs/results/planted_faults.md]

A fault names a symbol of the package or of its native core and one replaced text in it, so it follows the symbol from
file to file; the core of a copy is compiled again for each fault in it. The tests named beside it run against the copy
until the first one fails. The exit code is 1 if a fault is not caught, or could not be judged: its tests fail without
it, or they fail because its code cannot run at all.
"""

from __future__ import annotations

import argparse
import ast
import datetime
import difflib
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from with_checkout import environment_of

from viewshed._page import commit_of
from viewshed._results import with_numbers, write_page

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = Path("src") / "viewshed"
CORE = Path("src") / "core"
LIMIT_S = 600
# A fault changes what code answers. Code that stops with one of these was not mended after something was renamed.
_BROKEN = re.compile(r"\b(?:NameError|UnboundLocalError|AttributeError|ImportError|SyntaxError|\w*TypingError)\b")


_NATIVE = (".cpp", ".hpp")
_NO_DEFINITION = r"(namespace|using|struct|class|enum|template|public|private)\b"


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault: in the source of ``symbol``, ``find`` (which must occur once) becomes ``replace``.

    ``symbol`` is a qualified name ("BevGrid.index", "count_points", "MAJORITY"), after "package.module:" where several
    modules have it; of the core, a function or constant after "core.file:". ``find`` is compared without regard to
    white space and to a comma before a closing bracket.
    """

    what: str
    symbol: str
    find: str
    replace: str
    tests: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Symbol:
    """A function, class, constant or field, and where its source is: lines ``first`` to ``last``, from 1.

    ``file`` is relative to the package.
    """

    module: str
    name: str
    file: Path
    first: int
    last: int

    @property
    def is_native(self) -> bool:
        """Whether it is in the core."""
        return self.file.suffix in _NATIVE


@dataclass(frozen=True, slots=True)
class Planted:
    """A fault in its place: the file, relative to the package, and the source of the symbol before and after."""

    fault: Fault
    symbol: Symbol
    before: str
    after: str

    def write(self, package: Path) -> None:
        """Put the fault into a copy of the package."""
        path = package / self.symbol.file
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        lines[self.symbol.first - 1 : self.symbol.last] = [self.after]
        path.write_text("".join(lines), encoding="utf-8")


@dataclass(frozen=True, slots=True)
class Verdict:
    """What came of a fault: the first test that failed, or why that cannot be said; neither if it was not caught."""

    planted: Planted
    caught_by: str | None = None
    trouble: str | None = None

    def __str__(self) -> str:
        if self.trouble is not None:
            return f"**not judged**: {self.trouble}"
        return "**not caught**" if self.caught_by is None else f"`{self.caught_by}`"


def read_faults(path: Path) -> list[Fault]:
    """Return the faults of a TOML file."""
    tables = tomllib.loads(path.read_text(encoding="utf-8"))["fault"]
    return [Fault(**(table | {"tests": tuple(table["tests"])})) for table in tables]


def module_name(package: Path, file: Path) -> str:
    """Return the name under which a file of the package is imported."""
    parts = [package.name, *file.with_suffix("").parts]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def read_symbols(package: Path) -> list[Symbol]:
    """Return every function, class, method, constant and field of the package, those inside functions left out."""
    symbols = []
    for path in sorted(package.rglob("*.py")):
        file = path.relative_to(package)
        for name, first, last in _definitions(ast.parse(path.read_text(encoding="utf-8")), ""):
            symbols.append(Symbol(module_name(package, file), name, file, first, last))
    for path in sorted((package.parent / CORE.name).glob("*.[ch]pp")):
        for name, first, last in _native_definitions(path.read_text(encoding="utf-8").splitlines()):
            symbols.append(Symbol(f"core.{path.stem}", name, Path("..", CORE.name, path.name), first, last))
    return symbols


def _native_definitions(lines: list[str]) -> Iterator[tuple[str, int, int]]:
    """Yield name, first and last line of the functions and constants of a C++ file, which begin at the line's start."""
    at = 0
    while at < len(lines):
        first = at
        at += 1
        if not re.match(r"\w", lines[first]) or re.match(_NO_DEFINITION, lines[first]):
            continue
        # A statement or a signature may go on over several lines.
        while not re.search(r"[;{]\s*(?://.*)?$", lines[at - 1]) and at < len(lines):
            at += 1
        text = " ".join(lines[first:at])
        if text.startswith("constexpr") and "{" not in text.partition("=")[0]:
            while not lines[at - 1].rstrip().endswith(";") and at < len(lines):
                at += 1
            text = " ".join(lines[first:at])
            yield from ((name, first + 1, at) for name in re.findall(r"\b([A-Z]\w*)(?:\[\w*\])?\s*=", text))
        elif (name := re.search(r"([\w~]+)\s*\(", text)) and text.rstrip().endswith("{"):
            while lines[at - 1] != "}" and at < len(lines):
                at += 1
            yield name[1], first + 1, at


def _definitions(parent: ast.AST, prefix: str) -> Iterator[tuple[str, int, int]]:
    """Yield qualified name, first and last line of what is defined in a module or class."""
    for node in ast.iter_child_nodes(parent):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                first = min(each.lineno for each in (node, *node.decorator_list))
                yield prefix + node.name, first, node.end_lineno or first
                if isinstance(node, ast.ClassDef):
                    yield from _definitions(node, f"{prefix}{node.name}.")
            case ast.Assign() | ast.AnnAssign():
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names = {each.id for target in targets for each in ast.walk(target) if isinstance(each, ast.Name)}
                yield from ((prefix + name, node.lineno, node.end_lineno or node.lineno) for name in sorted(names))
            case ast.If() | ast.Try() | ast.ExceptHandler():
                yield from _definitions(node, prefix)


def find_symbol(asked: str, symbols: list[Symbol]) -> Symbol:
    """Return the only symbol of that name.

    Raises:
        ValueError: there is none, or there are several.
    """
    module, _, name = asked.rpartition(":")
    found = [symbol for symbol in symbols if symbol.name == name and module in ("", symbol.module)]
    if len(found) == 1:
        return found[0]
    if found:
        places = ", ".join(f"{symbol.module}:{symbol.name}" for symbol in found)
        raise ValueError(f"`symbol` must be one place, {asked!r} is {len(found)}: {places}; write one of them")
    alike = difflib.get_close_matches(name, sorted({symbol.name for symbol in symbols}), n=3)
    alike = [name] if name in alike else alike  # the name is there, in another module
    near = [f"{symbol.module}:{symbol.name}" for symbol in symbols if symbol.name in alike]
    raise ValueError(f"`symbol` must be in the package, got {asked!r}; did you mean {', '.join(near) or 'another'}?")


def plant(fault: Fault, symbols: list[Symbol], package: Path) -> Planted:
    """Find the place of a fault and make the faulty source.

    Raises:
        ValueError: the symbol is not there or not the only one, or it does not hold the text exactly once.
    """
    symbol = find_symbol(fault.symbol, symbols)
    lines = (package / symbol.file).read_text(encoding="utf-8").splitlines(keepends=True)
    before = "".join(lines[symbol.first - 1 : symbol.last])
    places = list(_pattern(fault.find).finditer(before))
    if len(places) != 1:
        raise ValueError(
            f"`find` must occur once in {fault.symbol}, found {len(places)} times: {fault.find!r}; mend it"
        )
    start, end = places[0].span()
    return Planted(fault, symbol, before, before[:start] + fault.replace + before[end:])


def _pattern(text: str) -> re.Pattern[str]:
    """Return what finds a piece of code however it is broken into lines, and never part of a name."""
    pieces = []
    for token in re.findall(r"\w+|[^\w\s]", text):
        if re.match(r"\w", token):
            pieces.append(rf"\b{token}\b")
        else:
            pieces.append((r",?\s*" if token in ")]}" else "") + re.escape(token))
    return re.compile(r"\s*".join(pieces))


def plant_all(faults: list[Fault], package: Path) -> list[Planted]:
    """Find the places of all faults before any test runs.

    Raises:
        ValueError: some faults do not fit; the message names all of them.
    """
    symbols = read_symbols(package)
    planted, misfits = [], []
    for fault in faults:
        try:
            planted.append(plant(fault, symbols, package))
        except ValueError as error:
            misfits.append(f"{fault.what}: {error}")
    if misfits:
        raise ValueError("\n".join(misfits))
    return planted


def importers(package: Path) -> dict[str, set[str]]:
    """Return for each module those that import it, directly or through others."""
    trees = {
        module_name(package, path.relative_to(package)): (path, ast.parse(path.read_text(encoding="utf-8")))
        for path in package.rglob("*.py")
    }
    direct: dict[str, set[str]] = {module: set() for module in trees}
    for module, (path, tree) in trees.items():
        for imported in _imports(tree, module if path.stem == "__init__" else module.rpartition(".")[0]):
            # "package.name" is a module, or else a name of the module "package".
            source = imported if imported in direct else imported.rpartition(".")[0]
            if source in direct:
                direct[source].add(module)
    reached: dict[str, set[str]] = {}
    for module in direct:
        seen, ahead = set[str](), [module]
        while ahead:
            fresh = direct[ahead.pop()] - seen
            seen |= fresh
            ahead.extend(fresh)
        reached[module] = seen
    return reached


def _imports(tree: ast.Module, parent: str) -> Iterator[str]:
    """Yield what a module of the package ``parent`` imports: modules, and names after their module."""
    for node in ast.walk(tree):
        match node:
            case ast.Import():
                yield from (alias.name for alias in node.names)
            case ast.ImportFrom():
                base = parent.rsplit(".", node.level - 1)[0] if node.level else ""
                base = ".".join(part for part in (base, node.module) if part)
                yield from (f"{base}.{alias.name}" for alias in node.names)


def drop_compiled(planted: Planted, package: Path, above: dict[str, set[str]]) -> None:
    """Delete the compiled code that may hold the sound version of what is planted.

    Numba looks at the times of a function's own file only, but compiles into it the functions and constants that it
    takes from other files. Plain functions and classes cannot be in there.
    """
    if planted.symbol.is_native:
        return
    is_constant = not re.match(r"\s*(?:@|(?:async\s+)?def\b|class\b)", planted.before)
    if is_constant or "njit" in planted.before:
        module = planted.symbol.module
        for stale in {module} | above[module]:
            folder = package.joinpath(*stale.split(".")[1:])
            cache = (folder if folder.is_dir() else folder.parent) / "__pycache__"
            for compiled in cache.glob(f"{stale.rpartition('.')[2]}.*.nb[ic]"):
                compiled.unlink()


def copy_project(to: Path) -> None:
    """Copy package, core, tests, tools, pages and settings; compiled code comes along with the times of its sources."""
    for name in ("src", "tests", "tools", "docs", "configs"):
        shutil.copytree(ROOT / name, to / name)
    for name in ("pyproject.toml", "CMakeLists.txt"):
        shutil.copy2(ROOT / name, to / name)


def build_core(project: Path) -> None:
    """Compile the core of a copy; what is compiled already and has not changed is kept.

    Raises:
        RuntimeError: it does not compile.
    """
    folder = project / "build"
    if not folder.exists():
        configure = ("cmake", "-S", str(project), "-B", str(folder), f"-DPython_EXECUTABLE={sys.executable}")
        subprocess.run(configure, capture_output=True, check=True)
    run = subprocess.run(("cmake", "--build", str(folder)), capture_output=True, text=True, check=False)
    if run.returncode != 0:
        raise RuntimeError(f"the core does not compile: {(run.stdout + run.stderr)[-300:].strip()}")


def first_failure(project: Path, tests: tuple[str, ...]) -> tuple[str, str] | None:
    """Return the first test that fails and the error it fails with, or None where all pass.

    Raises:
        RuntimeError: pytest could not run the tests, or not in time.
    """
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no", "-p", "no:cacheprovider", *tests]
    # COLUMNS: so that the summary's lines are not cut off before the error.
    environment = environment_of(project) | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "COLUMNS": "1000"}
    try:
        run = subprocess.run(
            command, cwd=project, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise RuntimeError(f"not done after {LIMIT_S} s") from error
    if run.returncode == 0:
        return None
    failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - (.*))?$", run.stdout, re.MULTILINE)
    if run.returncode not in (1, 2) or failed is None:
        raise RuntimeError(f"pytest failed with code {run.returncode}: {(run.stderr or run.stdout)[-300:].strip()}")
    return failed[1], failed[2] or ""


def check_copy(project: Path) -> None:
    """Make sure that tests would import the copy.

    Raises:
        RuntimeError: they would import another.
    """
    code = "import viewshed; print(viewshed.__file__)"
    command = (sys.executable, "-c", code)
    run = subprocess.run(command, env=environment_of(project), capture_output=True, text=True, check=True)
    if not Path(run.stdout.strip()).is_relative_to(project):
        raise RuntimeError(f"the tests would import {run.stdout.strip()} instead of the copy in {project}")


def judge(planted: Planted, project: Path, above: dict[str, set[str]]) -> Verdict:
    """Put a fault into a project that has none and run its tests."""
    planted.write(project / PACKAGE)
    drop_compiled(planted, project / PACKAGE, above)
    try:
        if planted.symbol.is_native:
            build_core(project)
        failure = first_failure(project, planted.fault.tests)
    except RuntimeError as error:
        return Verdict(planted, trouble=str(error))
    if failure is None:
        return Verdict(planted)
    test, reason = failure
    if _BROKEN.search(reason):
        return Verdict(planted, trouble=f"{test} cannot run it: {reason}")
    return Verdict(planted, caught_by=test)


def run_all(faults: list[Planted], jobs: int) -> list[Verdict]:
    """Return what came of each fault; each job has one copy of the project, mended after each fault."""
    above = importers(ROOT / PACKAGE)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        clean = Path(folder) / "clean"
        clean.mkdir()
        copy_project(clean)
        build_core(clean)
        check_copy(clean)
        shutil.rmtree(clean / "build")  # it knows its own place only

        # Without a fault all tests must pass; that also compiles what is compiled, once for all copies.
        def unfit(test: str) -> str | None:
            try:
                failure = first_failure(clean, (test,))
            except RuntimeError as error:
                return f"{test} without the fault: {error}"
            return None if failure is None else f"{failure[0]} fails without the fault"

        tests = list(dict.fromkeys(test for planted in faults for test in planted.fault.tests))
        unfits = dict(zip(tests, pool.map(unfit, tests), strict=True))

        projects: queue.SimpleQueue[Path] = queue.SimpleQueue()
        for number in range(jobs):
            shutil.copytree(clean, Path(folder) / str(number))
            projects.put(Path(folder) / str(number))

        def run(planted: Planted) -> Verdict:
            for test in planted.fault.tests:
                if unfits[test] is not None:
                    return Verdict(planted, trouble=unfits[test])
            project = projects.get()
            try:
                return judge(planted, project, above)
            finally:
                shutil.rmtree(project / PACKAGE)
                shutil.copytree(clean / PACKAGE, project / PACKAGE)
                if planted.symbol.is_native:  # written anew, so that it is compiled again
                    core_file = project / PACKAGE / planted.symbol.file
                    core_file.write_bytes((clean / PACKAGE / planted.symbol.file).read_bytes())
                projects.put(project)

        verdicts = []
        try:
            for number, verdict in enumerate(pool.map(run, faults), 1):
                verdicts.append(verdict)
                print(f"{number}/{len(faults)} {verdict.planted.fault.what}: {verdict}", flush=True)
        finally:
            pool.shutdown(cancel_futures=True)  # whoever stops the run does not wait for the faults that are left
    return verdicts


def report(verdicts: list[Verdict]) -> str:
    """Return the results as a Markdown page."""
    caught = sum(verdict.caught_by is not None for verdict in verdicts)
    lines = [
        "Each fault is put into a copy of the package by hand, and the tests of its part run until one fails:",
        "`python tools/planted_faults.py` (the faults are in `tools/planted_faults.toml`).",
        "",
        f"**{caught} of {len(verdicts)} caught.**",
        "",
        "| fault | file | first test that fails |",
        "|---|---|---|",
    ]
    for verdict in verdicts:
        file = verdict.planted.symbol.file.as_posix().removeprefix("../")
        lines.append(f"| {verdict.planted.fault.what} | `{file}` | {str(verdict).replace('|', '/')} |")
    made = f"- date: {datetime.datetime.now(datetime.UTC):%Y-%m-%d}\n- version: viewshed, commit {commit_of(ROOT)}"
    return with_numbers("Planted faults", made, "\n".join(lines))


def main() -> int:
    """Run the faults, write the page, return 1 if one was not caught."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--only", default="", help="run only the faults whose description, symbol or file holds this text"
    )
    parser.add_argument("--jobs", type=int, default=1, help="run this many at once")
    parser.add_argument("--out", type=Path, help="write the page to this file")
    given = parser.parse_args()
    try:
        planted = plant_all(read_faults(Path(__file__).with_suffix(".toml")), ROOT / PACKAGE)
    except ValueError as error:
        parser.error(f"some faults do not fit the code:\n{error}")
    chosen = [
        each
        for each in planted
        if any(given.only in text for text in (each.fault.what, each.fault.symbol, each.symbol.file.as_posix()))
    ]
    if not chosen:
        parser.error(f"--only must be in a description, symbol or file of a fault, got {given.only!r}")
    verdicts = run_all(chosen, given.jobs)
    if given.out is not None:
        write_page(given.out, report(verdicts))
    return int(any(verdict.caught_by is None for verdict in verdicts))


if __name__ == "__main__":
    sys.exit(main())
