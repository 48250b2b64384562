"""libviewshed beside the Python package: ``python -m benchmarks.library`` (compiles it; ``--prefix`` takes one).

Prints a table: milliseconds of one sweep, from points to states, by the library with one thread and with two and by
Python, side by side in one run; the size of the stripped library; and how long it took to compile.
"""

from __future__ import annotations

import argparse
import ctypes as c
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import clouds
from benchmarks.timing import Job, interleaved
from viewshed import GRIDS, Sweep, _core
from viewshed.estimators.shadow_map import ShadowMap
from viewshed_lab._page import facts, table

PACKAGE = Path(__file__).resolve().parents[2] / "viewshed"
SEED, BUDGET_S = 11, 10.0
TARGETS_MS = {("35k", 1): 6.0, ("35k", 2): 4.0}
TARGET_MB, TARGET_BUILD_S = 4.0, 90.0


class _Sweep(c.Structure):
    """``viewshed_sweep`` of viewshed.h."""

    _fields_ = [
        ("count", c.c_size_t), ("points", c.c_void_p), ("point_step", c.c_size_t), ("ring", c.c_void_p),
        ("ring_step", c.c_size_t), ("attitude", c.c_void_p), ("sensor_height_m", c.c_double),
        ("vehicle_yaw", c.c_double),
    ]  # fmt: skip


class _Options(c.Structure):
    """``viewshed_options`` of viewshed.h, of which nothing is changed."""

    _fields_ = [("words", c.c_uint64 * 8)]


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--prefix", type=Path, help="where a library is installed; without it one is compiled")
    told = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        prefix, build_s = (told.prefix, None) if told.prefix else (Path(folder) / "prefix", _build(Path(folder)))
        library = next(prefix.glob("lib*/libviewshed.so"))
        print(table(["what", "points", "median, ms (10–90 %)", "target"], _times(c.CDLL(str(library)))))
        megabytes = _stripped_bytes(library, Path(folder)) / 1e6
    print(f"\nsize, stripped: {megabytes:.2f} MB (target: at most {TARGET_MB:g})")
    if build_s is not None:
        print(f"compiled in {build_s:.0f} s (target: at most {TARGET_BUILD_S:g})")
    print(", ".join(f"{name}: {value}" for name, value in facts().items()))


def _build(folder: Path) -> float:
    """Compile and install the library below a folder; return the seconds that it took."""
    options = ("-DVIEWSHED_PYTHON=OFF", "-DVIEWSHED_LIBRARY=ON", f"-DCMAKE_INSTALL_PREFIX={folder / 'prefix'}")
    begin = time.perf_counter()
    for command in (
        ("cmake", "-S", str(PACKAGE), "-B", str(folder / "build"), *options),
        ("cmake", "--build", str(folder / "build"), "--parallel", "2"),
        ("cmake", "--install", str(folder / "build"), "--component", "library"),
    ):
        subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - begin


def _stripped_bytes(library: Path, folder: Path) -> int:
    stripped = folder / "stripped.so"
    subprocess.run(("strip", "-o", str(stripped), str(library)), check=True)
    return stripped.stat().st_size


def _times(library: c.CDLL) -> list[list[str]]:
    """Return the rows of the table."""
    library.viewshed_no_sweep.restype = _Sweep
    library.viewshed_estimate.argtypes = [c.c_uint64, c.c_void_p, c.c_void_p, c.c_void_p, c.c_size_t, c.c_void_p]
    rows, rng, threads = [], np.random.default_rng(SEED), _core.threads()
    for size in ("35k", "120k"):
        sweep = clouds.synthetic(size, rng)
        jobs = {f"libviewshed, {count} thread(s)": _by_library(library, sweep, count) for count in (1, 2)}
        jobs |= {f"Python, {count} thread(s)": _by_python(sweep, count) for count in (1, 2)}
        for name, timing in interleaved(jobs, rng, BUDGET_S).items():
            target = TARGETS_MS.get((size, 1 if " 1 " in name else 2)) if name.startswith("lib") else None
            spread = f"{timing.median_ms:.2f} ({timing.low_ms:.2f}–{timing.high_ms:.2f})"
            rows.append([name, size, spread, "" if target is None else f"≤ {target:g}"])
    _core.set_threads(threads)
    return rows


def _by_library(library: c.CDLL, sweep: Sweep, threads: int) -> Job:
    """Return a job that estimates the points of a sweep in a stream of its own."""
    library.viewshed_defaults.restype = _Options
    options, stream = library.viewshed_defaults(), c.c_uint64()
    if library.viewshed_open(c.byref(options), c.byref(stream)) != 0:
        raise RuntimeError("the library opens no stream")
    given, state = library.viewshed_no_sweep(), np.empty(GRIDS["road"].shape, np.uint8)
    given.count, given.points = len(sweep), sweep.points.ctypes.data

    def job() -> object:
        library.viewshed_set_threads(c.c_size_t(threads))
        status = library.viewshed_estimate(stream, c.byref(given), state.ctypes.data, None, state.size, None)
        if status != 0:
            raise RuntimeError(f"the library answered {status}")
        return sweep

    return job


def _by_python(sweep: Sweep, threads: int) -> Job:
    estimator, bare = ShadowMap(GRIDS["road"]), Sweep(sweep.points)

    def job() -> object:
        _core.set_threads(threads)
        return estimator.estimate(bare)

    return job


if __name__ == "__main__":
    main()
