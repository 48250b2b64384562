"""Wall-clock time of whole processes from a cold start, as a user experiences it."""

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
"""Number of empty homes in which a first process is timed, and of later processes in each."""

VIEWSHED = str(Path(sys.executable).with_name("viewshed"))
IMPORT = "import viewshed"
IMPORT_ALL = "import viewshed, use every public name"
LIBRARIES = "import numpy, shapely, PIL.ImageFont, typer"


def alone(work: Callable[..., T], *args: object) -> T:
    """Run ``work`` in a new process and return its result."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(work, *args).result()


@dataclass(frozen=True, slots=True)
class Start:
    """Resources used by a process."""

    seconds: float  # wall clock
    processor_s: float  # CPU time of all cores; steadier on a busy machine
    peak_mb: float  # peak memory in 10⁶ bytes


@dataclass(frozen=True, slots=True)
class StartTargets:
    """Maximum seconds of the first process in an empty home, and of later ones."""

    first_s: float
    later_s: float


IN_AN_EMPTY_HOME = "in an empty home"
START_TARGETS = {"npz": StartTargets(1.2, 1.0), "png,geojson,npz": StartTargets(2.0, 1.0)}
"""By the value of ``--results``."""

PEAK_MB = 200.0
"""Maximum memory of each of them in 10⁶ bytes."""


@dataclass(frozen=True, slots=True)
class Starts:
    """Starts of one command."""

    first: list[Start]  # the first one in each of several empty homes
    later: list[Start]  # the others


def imports(rng: np.random.Generator) -> dict[str, Timing]:
    """Return the times of processes that import viewshed, all its public names, numpy alone, and nothing."""
    code = {
        IMPORT: "import viewshed",
        IMPORT_ALL: "import viewshed; [getattr(viewshed, name) for name in viewshed.__all__]",
        "import numpy": "import numpy",
        "Python alone": "",
    }
    return interleaved({name: _job(sys.executable, "-c", text) for name, text in code.items()}, rng)


def estimate(sweep: Path, out: Path, rng: np.random.Generator) -> dict[str, Timing]:
    """Return the times of ``viewshed estimate`` of one sweep with its files, and of importing its libraries."""
    jobs = {
        "viewshed estimate": _job(VIEWSHED, "estimate", str(sweep), "--out", str(out)),
        LIBRARIES: _job(sys.executable, "-c", LIBRARIES),
    }
    return interleaved(jobs, rng)


def estimates_in_empty_homes(sweep: Path, folder: Path, results: str) -> Starts:
    """Return first and later starts of ``viewshed estimate`` of one sweep in empty homes.

    Programs keep their caches in the home, so an empty home hides all caches.
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
"""Starts a command from a small process, as the peak memory of a child includes that of the process that forks it."""


def _started(command: list[str], home: Path) -> Start:
    """Run a command with ``home`` as home and cache, and return its used resources."""
    kept = {name: value for name, value in os.environ.items() if name not in _PLACES}
    home_of_all = {"HOME": str(home), "NUMBA_CACHE_DIR": str(home / "numba")}
    watch = (sys.executable, "-I", "-S", "-c", _WATCH, *command)
    done = subprocess.run(watch, env=kept | home_of_all, capture_output=True, text=True, check=True)
    code, seconds, processor_s, peak_kib = json.loads(done.stdout)
    if code != 0:
        raise RuntimeError(f"{' '.join(command)} failed with exit code {code}: {done.stderr.strip()}")
    return Start(seconds, processor_s, peak_kib * 1024 / 1e6)


_PLACES = {"XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR", "NUMBA_CACHE_DIR", "PYTHONPATH"}
"""Environment variables with other places of caches and sources."""


def first_and_second_demo(folder: Path) -> tuple[float, float]:
    """Return the seconds of the first ``viewshed demo`` (nothing is compiled yet) and of the second."""
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
