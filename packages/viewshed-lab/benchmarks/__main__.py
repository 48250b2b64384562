"""Measure everything, print the table and write the page: ``python -m benchmarks [--page FILE] [--only WORD]``."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path

import numpy as np

from benchmarks import clouds, processes
from benchmarks.cases import Case, all_cases
from benchmarks.report import Row, write
from benchmarks.timing import Timing, bandwidth_bytes_per_s, interleaved
from viewshed_lab._page import facts as facts_of_run

PAGE = Path(__file__).resolve().parents[3] / "docs" / "results" / "speed.md"
LIBRARIES = ("numpy", "numba", "scipy", "shapely", "rasterio", "contourpy", "concave-hull", "pillow")
SEED = 20_250_307


def main() -> None:
    """Run the benchmarks selected on the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes; the JSON goes beside it")
    parser.add_argument("--only", default="", help="measure only the steps that contain this word")
    arguments = parser.parse_args()
    bandwidth = bandwidth_bytes_per_s()
    facts = facts_of_run(
        command=f"`{' '.join(['python -m benchmarks', *sys.argv[1:]])}`",
        libraries=", ".join(f"{name} {metadata.version(name)}" for name in LIBRARIES),
        load=f"{os.getloadavg()[0]:.1f} in the minute before, on all cores",
        bandwidth=f"{bandwidth / 1e9:.1f} GB/s by one thread, read and written in a copy of 256 MB",
    )
    with tempfile.TemporaryDirectory() as name:
        rows = list(_measured(Path(name), arguments.only, bandwidth, facts))
    if not arguments.only:
        write(rows, facts, arguments.page)
        print(f"written to {arguments.page}")


def _measured(folder: Path, only: str, bandwidth: float, facts: dict[str, str]) -> Iterator[Row]:
    rng = np.random.default_rng(SEED)
    for case in all_cases(folder, rng):
        if only in case.step:
            medians = interleaved({"": case.job, **case.others}, rng)
            yield _printed(_row_of_case(case, medians, bandwidth))
    if only in processes.IMPORT_ALL:
        timings = processes.imports(rng)
        for name in (processes.IMPORT, processes.IMPORT_ALL):
            yield _printed(_row_of_process(name, "–", timings, 500.0))
    if only in "viewshed estimate":
        sweep = clouds.write_nuscenes(clouds.synthetic("35k", rng), folder / "cold.pcd.bin")
        processes.estimate(sweep, folder / "out", rng)
        yield _printed(
            _row_of_process("viewshed estimate", "35k", processes.estimate(sweep, folder / "out", rng), 2500.0)
        )
    if only in processes.IN_AN_EMPTY_HOME:
        sweep = clouds.write_nuscenes(clouds.synthetic("35k", rng), folder / "start.pcd.bin")
        for results, targets in processes.START_TARGETS.items():
            starts = processes.estimates_in_empty_homes(sweep, folder, results)
            yield _printed(_row_of_starts(results, "first", starts.first, targets.first_s))
            yield _printed(_row_of_starts(results, "later", starts.later, targets.later_s))
    if only in "viewshed demo":
        first, second = processes.first_and_second_demo(folder)
        facts["viewshed demo"] = f"{first:.1f} s the first time ever (compiles), {second:.1f} s the second"
        print(facts["viewshed demo"])


def _row_of_case(case: Case, timings: Mapping[str, Timing], bandwidth: float) -> Row:
    ours = timings[""]
    others = {name: timing.median_ms for name, timing in timings.items() if name}
    target, met = "", None
    if case.target_ms is not None:
        target, met = f"≤ {case.target_ms:g} ms", ours.median_ms <= case.target_ms
    elif case.target_ratio is not None:
        name, multiple = case.target_ratio
        target, met = f"≤ {multiple:g} × {name}", ours.median_ms <= multiple * others[name]
    floor_ms = 1e3 * case.floor_bytes / bandwidth
    return Row(
        case.step, case.size, ours.median_ms, ours.low_ms, ours.high_ms, ours.repeats, floor_ms, target, met, others
    )


def _row_of_process(name: str, size: str, timings: Mapping[str, Timing], target_ms: float) -> Row:
    ours = timings[name]
    others = {other: timing.median_ms for other, timing in timings.items() if other != name}
    met = ours.median_ms <= target_ms
    target = f"≤ {target_ms / 1e3:g} s"
    step = f"`{name}`, whole process"
    return Row(step, size, ours.median_ms, ours.low_ms, ours.high_ms, ours.repeats, None, target, met, others)


def _row_of_starts(results: str, when: str, starts: Sequence[processes.Start], target_s: float) -> Row:
    times_ms = np.array([1e3 * start.seconds for start in starts])
    low, median, high = (float(value) for value in np.percentile(times_ms, [10, 50, 90]))
    peak_mb = max(start.peak_mb for start in starts)
    met = median <= 1e3 * target_s and peak_mb <= processes.PEAK_MB
    return Row(
        f"`viewshed estimate --results {results}`, {when} {processes.IN_AN_EMPTY_HOME}", "35k", median, low, high,
        len(starts), None, f"≤ {target_s:g} s, ≤ {processes.PEAK_MB:g} MB", met, {}, peak_mb,
    )  # fmt: skip


def _printed(row: Row) -> Row:
    print(" | ".join(row.cells()), flush=True)
    return row


if __name__ == "__main__":
    main()
