"""Print whether a view stays the same while nothing changes: ``python -m benchmarks.stability INDEX [RECORDING]``.

IoU of two views: cells visible in both, of those visible in either. Each sweep of the index against itself with half of
its points, and with ranges off by 2 cm; and, of a recording by a sensor at rest, each sweep against the one before, by
itself and in a stream.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.estimate import FovEstimate
from viewshed.grid import GRIDS
from viewshed.io import read_index, read_indexed, read_sweeps
from viewshed.metrics import ConfusionCounts
from viewshed.sweep import Sweep
from viewshed_lab._page import table
from viewshed_lab.studies.formatting import format_rate

NOISE_M = 0.02
SEED = 0


def half_of(sweep: Sweep, rng: np.random.Generator) -> Sweep:
    """Return a sweep with a random half of its points."""
    return sweep.select(np.sort(rng.choice(len(sweep), len(sweep) // 2, replace=False)))


def noisy(sweep: Sweep, rng: np.random.Generator) -> Sweep:
    """Return a sweep with normal range noise of 2 cm standard deviation."""
    range_m = np.maximum(np.linalg.norm(sweep.points, axis=1), 1e-3)
    factor = 1.0 + rng.normal(0.0, NOISE_M, len(sweep)) / range_m
    return sweep.replace(points=(sweep.points * factor[:, None]).astype(np.float32))


CHANGES: dict[str, Callable[[Sweep, np.random.Generator], Sweep]] = {
    "half of the points": half_of,
    "ranges off by 2 cm": noisy,
}


def iou(one: FovEstimate, other: FovEstimate) -> float:
    """Return the intersection over union of the visible cells; NaN if none is visible."""
    mask = np.ones(one.grid.shape, np.bool_)
    return ConfusionCounts.of(one.visible(), other.visible(), mask, one.grid.cell_m**2).iou


def row(name: str, ious: Iterable[float], more: str = "") -> tuple[str, ...]:
    """Return a line of the table: number, median and minimum of IoUs."""
    known = [value for value in ious if not np.isnan(value)]
    median, minimum = (float(np.median(known)), min(known)) if known else (float("nan"), float("nan"))
    return name, str(len(known)), format_rate(median), format_rate(minimum), more


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="stability", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("index", type=Path)
    parser.add_argument(
        "at_rest", type=Path, nargs="?", help="a recording by a sensor that stands still, without poses"
    )
    arguments = parser.parse_args(words)
    estimator, rng = ShadowMap(GRIDS["road"]), np.random.default_rng(SEED)
    by_change: dict[str, list[float]] = {name: [] for name in CHANGES}
    for entry in read_index(arguments.index):
        if entry.points:
            sweep = read_indexed(entry)
            original = estimator.estimate(sweep)
            for name, change in CHANGES.items():
                by_change[name].append(iou(original, estimator.estimate(change(sweep, rng))))
    rows = [row(name, ious) for name, ious in by_change.items()]
    if arguments.at_rest is not None:
        sweeps = list(read_sweeps(arguments.at_rest))
        streams = {"each by itself": map(estimator.estimate, sweeps), "in a stream": estimator.stream(sweeps)}
        for name, stream in streams.items():
            views = list(stream)
            heights_m = [view.basis.sensor_height_m for view in views if view.basis is not None]
            more = f"heights {min(heights_m):.2f} to {max(heights_m):.2f} m"
            rows.append(row(f"at rest, {name}", (iou(*pair) for pair in pairwise(views)), more))
    print(table(("what changes", "pairs", "IoU, median", "least", ""), rows))


if __name__ == "__main__":
    main()
