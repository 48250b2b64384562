"""Time jobs with the viewshed of one checkout: started by ``benchmarks.versions``, once for each checkout.

Its first line is the version, as JSON. Then it reads a line of JSON for each job to time, ``[job, method, file]``, and
answers with the seconds it took. Only what all versions since 0.3.0 offer is used.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np


@lru_cache(maxsize=8)
def sweep_of(path: str) -> Any:
    """Return a sweep of a file, read once."""
    import viewshed

    return viewshed.read_sweep(path)


@lru_cache(maxsize=32)
def estimator_of(method: str, copy: int = 0) -> Any:
    """Return an estimator, made once; copies for threads of their own."""
    import viewshed

    return viewshed.load_estimator(method)


def estimate(method: str, path: str, copy: int = 0) -> None:
    """Estimate a sweep as if it were new: nothing of it is kept from the time before."""
    sweep = sweep_of(path)
    fresh = type(sweep)(sweep.points, sweep.intensity, sweep.ring, azimuth=sweep.azimuth, time_s=sweep.time_s)
    found = estimator_of(method, copy).estimate(fresh)
    if hasattr(found, "doubt"):
        found.doubt()
    found.visible()


def many(method: str, path: str) -> None:
    """Estimate eight sweeps on two threads, a sweep a thread."""

    def four(copy: int) -> None:
        for _ in range(4):
            estimate(method, path, copy)

    threads = [threading.Thread(target=four, args=(copy,)) for copy in (1, 2)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()


def read(method: str, path: str) -> None:
    """Read a sweep from its file, or the numbers alone."""
    if method == "numpy.fromfile":
        np.fromfile(path, np.float32)
    else:
        import viewshed

        viewshed.read_sweep(path)


JOBS: dict[str, Callable[[str, str], None]] = {"estimate": estimate, "many": many, "read": read}


def main() -> None:
    """Answer lines until there are no more."""
    import viewshed

    print(json.dumps([viewshed.__version__, str(Path(viewshed.__file__).parent)]), flush=True)
    for line in sys.stdin:
        job, method, path = json.loads(line)
        start = time.perf_counter()
        try:
            JOBS[job](method, path)
        except (KeyError, ValueError) as error:  # a method that this version does not have
            print(json.dumps(str(error)), flush=True)
            continue
        print(json.dumps(time.perf_counter() - start), flush=True)


if __name__ == "__main__":
    main()
