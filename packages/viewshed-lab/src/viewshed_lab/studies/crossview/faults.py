"""Sensitivity of the cross-view metric: masks with known faults, and the smallest fault that a table can show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree
from scipy.stats import binom

from viewshed.arrays import Mask
from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.sweep import Sweep
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.crossview.rates import RANGE_A_M, CrossViewTruth
from viewshed_lab.studies.suite import Changed

BLOB_M = 4.5
"""Diameter of a wrong blob: the length of a car."""

Change = Callable[[Mask, BevGrid, np.random.Generator], Mask]
"""Maps a mask (cells, cells) and its grid to the mask with a fault."""


def dilated(by_m: float) -> Change:
    """Return the fault that dilates a mask by a length in meters on all sides."""
    return lambda mask, grid, _rng: np.asarray(binary_dilation(mask, _disk(by_m / grid.cell_m)))


def false_blobs(count: int) -> Change:
    """Return the fault that claims ``count`` random blobs that are not visible."""
    return lambda mask, grid, rng: mask | _blobs(~mask, count, grid, rng)


def misses(count: int) -> Change:
    """Return the fault that does not claim ``count`` random blobs that are visible."""
    return lambda mask, grid, rng: mask & ~_blobs(mask, count, grid, rng)


KNOWN_FAULTS: dict[str, Change] = {
    "dilated by 1 m": dilated(1.0),
    "dilated by 2 m": dilated(2.0),
    "12 false blobs": false_blobs(12),
    "100 false blobs": false_blobs(100),
    "12 misses": misses(12),
    "100 misses": misses(100),
}
"""Faults by name; blobs have the length of a car and are drawn anew for each sweep."""


def _with_fault(change: Change, estimator: FovEstimator, sweep: Sweep) -> FovEstimate:
    """Return the mask of an estimator with a fault that depends on the sweep's time alone."""
    estimate = estimator.estimate(sweep)
    mask = change(estimate.visible(), estimator.grid, generator(0, str(sweep.t_ns)))
    return FovEstimate(estimator.grid, mask.astype(np.float32), estimate.state)


def with_known_faults(name: str, estimator: FovEstimator) -> dict[str, FovEstimator]:
    """Return an estimator by name, followed by the estimator with each known fault."""
    faults = {fault: partial(_with_fault, change) for fault, change in KNOWN_FAULTS.items()}
    return {name: estimator, **{f"{name}, {fault}": Changed(estimator, answer) for fault, answer in faults.items()}}


def _disk(radius: float) -> Mask:
    """Return the mask of a disk with a radius in cells."""
    reach = np.arange(-np.ceil(radius), np.ceil(radius) + 1)
    return np.asarray(np.hypot(reach[:, None], reach) <= radius)


def _blobs(within: Mask, count: int, grid: BevGrid, rng: np.random.Generator) -> Mask:
    """Return the mask of ``count`` blobs with centers in a mask, within the range of columns."""
    candidates = np.argwhere(within & (polar_of_cells(grid)[0] < RANGE_A_M[1]))
    centers = np.zeros(grid.shape, np.bool_)
    if len(candidates):
        centers[tuple(rng.permutation(candidates)[:count].T)] = True
    return np.asarray(binary_dilation(centers, _disk(BLOB_M / 2 / grid.cell_m)))


SHARES = (0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7)
"""Shares of wrongly classified ground to try, in ascending order."""

_DRAWS, _POWER, _CHANCE = 200, 0.8, 0.05


@dataclass(frozen=True, slots=True)
class SmallestDifference:
    """The smallest share of wrongly classified ground that a table shows; NaN if it would show none of ``SHARES``."""

    over: float  # share of hidden ground that is claimed
    under: float  # share of visible ground that is not claimed
    hidden_columns: int  # number of columns for ``over``
    hidden_sweeps: int  # number of their sweeps

    @classmethod
    def of(cls, truth: CrossViewTruth, floor: tuple[float, float], rng: np.random.Generator) -> SmallestDifference:
        """Return the smallest shares that a truth shows beyond the metric's own over- and under-claim ``floor``."""
        hidden = [columns.xy[columns.hidden] for _, columns in truth]
        seen = [columns.xy[columns.seen] for _, columns in truth]
        over, under = (smallest_share(xy, own, rng) for xy, own in zip((hidden, seen), floor, strict=True))
        return cls(over, under, sum(map(len, hidden)), sum(len(xy) > 0 for xy in hidden))


def smallest_share(places: Sequence[NDArray[np.float64]], floor: float, rng: np.random.Generator) -> float:
    """Return the smallest of ``SHARES`` that columns at ``places`` can detect; NaN for none.

    Wrong ground is drawn in blobs of ``BLOB_M``: neighboring columns of one sweep are wrong together, so that a
    thousand columns of one wall count for little more than one. A share is detected if in at least ``_POWER`` of the
    draws the number of wrong columns exceeds the quantile 1 - ``_CHANCE`` of the metric's own error.

    Args:
        places: columns (M, 2) of each sweep, in meters.
        floor: share of columns that are wrong by the metric's own error.
        rng: source of all random draws.
    """
    columns = sum(map(len, places))
    minimum = binom.ppf(1 - _CHANCE, columns, floor) + 1
    for share in SHARES if columns else ():
        wrong = np.array([sum(_in_blobs(xy, share, rng) for xy in places) for _ in range(_DRAWS)])
        if np.mean(wrong + rng.binomial(columns - wrong, floor) >= minimum) >= _POWER:
            return share
    return float("nan")


def _in_blobs(xy: NDArray[np.float64], share: float, rng: np.random.Generator) -> int:
    """Return the number of places in random blobs that cover a share of the ground."""
    if not len(xy):
        return 0
    low, high = xy.min(axis=0) - BLOB_M, xy.max(axis=0) + BLOB_M
    # Random disks leave a share exp(-density * area of a disk) of the ground free.
    density = -np.log1p(-share) / (np.pi * BLOB_M**2 / 4)
    centers = rng.uniform(low, high, (rng.poisson(density * np.prod(high - low)), 2))
    return int(np.isfinite(cKDTree(centers).query(xy, distance_upper_bound=BLOB_M / 2)[0]).sum()) if len(centers) else 0
