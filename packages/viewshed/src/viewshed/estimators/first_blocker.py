"""Visible before the nearest obstacle return: the safe envelope."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.estimators.classical import ClassicalEstimator
from viewshed.fov.visibility import CAR, Target
from viewshed.grid import BevGrid
from viewshed.preprocess.azimuth_bins import require, require_bins, within_limits
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep
from viewshed.preprocess.reach import reach_of_sweep


@dataclass(frozen=True, slots=True)
class FirstBlocker(ClassicalEstimator):
    """Visible before the ``rank``-th nearest obstacle return of the azimuth bin.

    Source: the occlusion test of Hu et al. (CVPR 2020, "What You See is What You Get") and of AdvCollaborative-
    Perception (USENIX Security 2024), per azimuth instead of per voxel. A cell's center may lie one cell beyond the
    limit. A bin without a return has no visible cell; one with returns but no blocker is visible up to the sensor's
    reach, or with ``limit_farthest`` up to its farthest return.

    Limits: under-claims; a bush, a curb or a parked car lower than the target hides everything behind it, and so does
    a wall grazed by a wide bin or one spoofed near point (``rank`` and ``median_bins`` withstand a few of those).
    Returns above ``obstacle_height_m[1]`` (canopies, bridges) do not block. Without ``limit_farthest`` a removed
    return opens its bin.

    >>> import numpy as np
    >>> from viewshed import Sweep
    >>> sweep = Sweep(np.array([[5.0, 0.5, -0.7], [9.0, 0.9, -1.7]]), sensor_height_m=1.7)
    >>> FirstBlocker(BevGrid(32, 16.0)).estimate(sweep).at(np.array([[5.4, 0.6], [8.5, 0.6]])).tolist()
    [1.0, 0.0]
    """

    grid: BevGrid  # where the cells are
    target: Target = CAR  # passed on; this estimator does not depend on it
    rank: int = 1  # which obstacle return blocks, 1 the nearest
    median_bins: int = 0  # number of azimuth bins (odd) over which the median of the limits is taken, or 0 for none
    limit_farthest: bool = True  # visible no farther than the farthest return of the bin
    # heights above local ground between which a return is an obstacle
    obstacle_height_m: tuple[float, float] = OBSTACLE_HEIGHTS_M
    azimuth_bins: int | None = None  # number of bins; None takes them from the measured azimuth step
    name: str = "first_blocker"  # goes into the estimate's ``method``

    def __post_init__(self) -> None:
        require("rank", self.rank, 1, 1000)
        require("median_bins", self.median_bins, 0, 999)
        require_bins(self.azimuth_bins)
        if self.median_bins and self.median_bins % 2 == 0:
            raise ValueError(f"median_bins must be odd or 0, got {self.median_bins}")
        if not self.obstacle_height_m[0] < self.obstacle_height_m[1]:
            raise ValueError(f"obstacle_height_m must be (low, high) with low < high, got {self.obstacle_height_m}")

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return 1 before the first obstacle of each azimuth bin, 0 behind it."""
        limit_m = _core.first_blocker(
            leveled.azimuth, leveled.range_m, leveled.height_m, *self.obstacle_height_m, self.azimuth_bins, self.rank,
            self.median_bins, None if self.limit_farthest else reach_of_sweep(leveled), self.grid.cell_m,
        )  # fmt: skip
        return within_limits(self.grid, limit_m)
