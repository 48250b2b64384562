"""What a user waits for: whole processes, cold, on the wall clock."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.timing import Job, Timing, interleaved

VIEWSHED = str(Path(sys.executable).with_name("viewshed"))
IMPORT = "import viewshed"
IMPORT_ALL = "import viewshed, use every public name"
LIBRARIES = "import numpy, numba, matplotlib.figure, typer"


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
