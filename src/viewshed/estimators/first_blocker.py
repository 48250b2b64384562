"""Visible before the nearest obstacle return: the safe envelope."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.estimators.base import ClassicalEstimator
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.visibility import CAR, Target
from viewshed.grid import BevGrid
from viewshed.preprocess.azimuth_bins import (
    farthest_in_bins,
    fov_of_state,
    measured_azimuth_bins,
    nearest_obstacle_in_bins,
    reach_of,
    require,
    require_bins,
    state_of_limits,
    with_margin,
)
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep


@dataclass(frozen=True, slots=True)
class FirstBlocker(ClassicalEstimator):
    """Visible before the ``rank``-th nearest obstacle return of the azimuth bin.

    Source: the occlusion test of Hu et al. (CVPR 2020, "What You See is What You Get") and of AdvCollaborative-
    Perception (USENIX Security 2024), per azimuth instead of per voxel. A cell's center may lie one cell beyond the
    limit. A bin without a return is UNKNOWN. Behind a blocker a cell is HIDDEN up to the sensor's reach (its
    model's maximum range, else the farthest return of the sweep); where the bin has returns but no blocker it is
    visible up to that reach, or with ``limit_farthest`` up to the bin's farthest return and UNKNOWN beyond.

    Limits: under-claims; a bush, a curb or a parked car lower than the target hides everything behind it, and so does
    a wall grazed by a wide bin or one spoofed near point (``rank`` and ``median_bins`` withstand a few of those).
    Returns above ``obstacle_height_m[1]`` (canopies, bridges) do not block. Without ``limit_farthest`` a removed
    return opens its bin.

    Attributes:
        grid: where the cells are.
        target: passed on; this estimator does not depend on it.
        rank: which obstacle return blocks, 1 the nearest.
        median_bins: median of the limits over so many azimuth bins (odd), or 0 for none.
        limit_farthest: visible no farther than the farthest return of the bin.
        obstacle_height_m: heights above local ground between which a return is an obstacle.
        azimuth_bins: number of bins; None takes them from the measured azimuth step.
        name: goes into the estimate's ``method``.

    >>> import numpy as np
    >>> from viewshed import Sweep
    >>> sweep = Sweep(np.array([[5.0, 0.5, -0.7], [9.0, 0.9, -1.7]]), sensor_height_m=1.7)
    >>> FirstBlocker(BevGrid(32, 16.0)).estimate(sweep).at(np.array([[5.4, 0.6], [8.5, 0.6]])).tolist()
    [1.0, 0.0]
    """

    grid: BevGrid
    target: Target = CAR
    rank: int = 1
    median_bins: int = 0
    limit_farthest: bool = True
    obstacle_height_m: tuple[float, float] = OBSTACLE_HEIGHTS_M
    azimuth_bins: int | None = None
    name: str = "first_blocker"

    def __post_init__(self) -> None:
        require("rank", self.rank, 1, 1000)
        require("median_bins", self.median_bins, 0, 999)
        require_bins(self.azimuth_bins)
        if self.median_bins and self.median_bins % 2 == 0:
            raise ValueError(f"median_bins must be odd or 0, got {self.median_bins}")
        if not self.obstacle_height_m[0] < self.obstacle_height_m[1]:
            raise ValueError(f"obstacle_height_m must be (low, high) with low < high, got {self.obstacle_height_m}")

    def _estimate(self, leveled: LeveledSweep, history: History | None) -> FovEstimate:
        """Estimate what the sensor sees: everything before the first obstacle of each azimuth bin."""
        bins = self.azimuth_bins or measured_azimuth_bins(leveled.azimuth)
        farthest_m = farthest_in_bins(leveled, bins)
        blocker_m = nearest_obstacle_in_bins(leveled, bins, self.rank, self.obstacle_height_m)
        if self.median_bins:
            blocker_m = _median(blocker_m, farthest_m >= 0, self.median_bins // 2)
        reach_m = np.float32(reach_of(leveled))
        limit_m = np.minimum(blocker_m, farthest_m if self.limit_farthest else reach_m)
        limit_m = np.where(farthest_m >= 0, limit_m, np.float32(-1.0))
        hidden_m = np.where((farthest_m >= 0) & np.isfinite(blocker_m), reach_m, np.float32(-1.0))
        state = state_of_limits(leveled, self.grid, with_margin(limit_m, self.grid.cell_m), hidden_m)
        return fov_of_state(leveled, self.grid, state, self.name, self.target)


@njit(cache=True, nogil=True)
def _median(values: NDArray[np.float32], known: NDArray[np.bool_], half: int) -> Any:  # pragma: no cover - compiled
    """Lower median over ± ``half`` bins around the circle, of the bins that are known."""
    bins = values.shape[0]
    out = values.copy()
    window = np.empty(2 * half + 1, np.float32)
    for b in range(bins):
        count = 0
        for offset in range(-half, half + 1):
            c = (b + offset) % bins
            if known[c]:
                window[count] = values[c]
                count += 1
        if count:
            out[b] = np.sort(window[:count])[(count - 1) // 2]
    return out
