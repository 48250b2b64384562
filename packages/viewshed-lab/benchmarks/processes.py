"""What a user waits for: whole processes, cold, on the wall clock."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np

from benchmarks.timing import Job, Timing, interleaved

T = TypeVar("T")

HOMES, LATER = 5, 3
"""Empty homes in which a first process is timed, and how many later ones in each."""

VIEWSHED = str(Path(sys.executable).with_name("viewshed"))
IMPORT = "import viewshed"
IMPORT_ALL = "import viewshed, use every public name"
LIBRARIES = "import numpy, shapely, PIL.ImageFont, typer"


def alone(work: Callable[..., T], *args: object) -> T:
    """Return what ``work`` returns in a process that ends with it."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(work, *args).result()


@dataclass(frozen=True, slots=True)
class Start:
    """What a process took."""

    seconds: float  # on the wall clock
    processor_s: float  # of all cores; on a busy machine the steadier figure
    peak_mb: float  # most memory that it held, in 10⁶ bytes


@dataclass(frozen=True, slots=True)
class StartTargets:
    """Seconds that the first process in an empty home and each later one may take."""

    first_s: float
    later_s: float


IN_AN_EMPTY_HOME = "in an empty home"
START_TARGETS = {"npz": StartTargets(1.2, 1.0), "png,geojson,npz": StartTargets(2.0, 1.0)}
"""By what is written of the sweep."""

PEAK_MB = 200.0
"""Memory that each of them may hold, in 10⁶ bytes."""


@dataclass(frozen=True, slots=True)
class Starts:
    """Starts of one command."""

    first: list[Start]  # the first one in each of several empty homes
    later: list[Start]  # the others


def imports(rng: np.random.Generator) -> dict[str, Timing]:
    """Return the time of a process that imports viewshed, and all it names, beside numpy alone and Python alone."""
    code = {
        IMPORT: "import viewshed",
        IMPORT_ALL: "import viewshed; [getattr(viewshed, name) for name in viewshed.__all__]",
        "import numpy": "import numpy",
        "Python alone": "",
    }
    return interleaved({name: _job(sys.executable, "-c", text) for name, text in code.items()}, rng)


def estimate(sweep: Path, out: Path, rng: np.random.Generator) -> dict[str, Timing]:
    """Return the time of ``viewshed estimate`` of one sweep with its files, beside importing its libraries."""
    jobs = {
        "viewshed estimate": _job(VIEWSHED, "estimate", str(sweep), "--out", str(out)),
        LIBRARIES: _job(sys.executable, "-c", LIBRARIES),
    }
    return interleaved(jobs, rng)


def estimates_in_empty_homes(sweep: Path, folder: Path, results: str) -> Starts:
    """Return what ``viewshed estimate`` of one sweep takes with its ``results``, first and later in empty homes.

    Nothing that another home or the environment may have cached is found: programs keep their caches in the home.
    """
    first, later = list[Start](), list[Start]()
    for number in range(HOMES):
        home = folder / f"home {results} {number}"
        home.mkdir()
        command = [VIEWSHED, "estimate", str(sweep), "--results", results, "--out", str(home / "out")]
        for k in range(1 + LATER):
            (later if k else first).append(_started(command, home))
    return Starts(first, later)


_WATCH = """
import json, os, sys, time
begin = time.perf_counter()
null = os.open(os.devnull, os.O_WRONLY)
child = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ, file_actions=[(os.POSIX_SPAWN_DUP2, null, 1)])
_, status, usage = os.wait4(child, 0)
seconds = time.perf_counter() - begin
print(json.dumps([os.waitstatus_to_exitcode(status), seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss]))
"""
"""Starts a command from a small process: what a child holds at most counts from the memory of the one that forks it."""


def _started(command: list[str], home: Path) -> Start:
    """Run a command to its end with ``home`` as home and cache, and return what it took."""
    kept = {name: value for name, value in os.environ.items() if name not in _PLACES}
    home_of_all = {"HOME": str(home), "NUMBA_CACHE_DIR": str(home / "numba")}
    watch = (sys.executable, "-I", "-S", "-c", _WATCH, *command)
    done = subprocess.run(watch, env=kept | home_of_all, capture_output=True, text=True, check=True)
    code, seconds, processor_s, peak_kib = json.loads(done.stdout)
    if code != 0:
        raise RuntimeError(f"{' '.join(command)} failed with exit code {code}: {done.stderr.strip()}")
    return Start(seconds, processor_s, peak_kib * 1024 / 1e6)


_PLACES = {"XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR", "NUMBA_CACHE_DIR", "PYTHONPATH"}
"""Variables that name other places of caches and sources."""


def first_and_second_demo(folder: Path) -> tuple[float, float]:
    """Return the seconds of the first ``viewshed demo`` ever (nothing is compiled yet) and of the second."""
    job = _job(VIEWSHED, "demo", "--out", str(folder / "demo"), NUMBA_CACHE_DIR=str(folder / "compiled"))
    return _seconds(job), _seconds(job)


def _job(*command: str, **environment: str) -> Job:
    def run() -> None:
        done = subprocess.run(command, check=False, capture_output=True, text=True, env=os.environ | environment)
        if done.returncode != 0:
            raise RuntimeError(f"{' '.join(command)} failed: {done.stderr.strip()}")

    return run


def _seconds(job: Job) -> float:
    start = time.perf_counter()
    job()
    return time.perf_counter() - start
