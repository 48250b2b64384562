"""Visible up to the nearest obstacle return of each azimuth bin: a conservative estimate."""

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
    """Visible up to the ``rank``-th nearest obstacle return of the azimuth bin.

    Source: the occlusion test of Hu et al. (CVPR 2020, "What You See is What You Get") and of AdvCollaborative-
    Perception (USENIX Security 2024), per azimuth instead of per voxel. A cell's center may be up to one cell beyond
    the limit. A bin without returns has no visible cell. A bin with returns but no obstacle is visible up to the
    sensor's reach, or with ``limit_farthest`` up to its farthest return.

    Limits: claims too little: a bush, a curb or a parked car lower than the target hides everything behind it, and so
    do a wall that a wide bin grazes and one spoofed near point (``rank`` and ``median_bins`` tolerate a few points).
    Returns above ``obstacle_height_m[1]`` (canopies, bridges) do not block. Without ``limit_farthest``, removing the
    blocking return makes its bin visible up to the reach.

    >>> import numpy as np
    >>> from viewshed import Sweep
    >>> sweep = Sweep(np.array([[5.0, 0.5, -0.7], [9.0, 0.9, -1.7]]), sensor_height_m=1.7)
    >>> FirstBlocker(BevGrid(32, 16.0)).estimate(sweep).at(np.array([[5.4, 0.6], [8.5, 0.6]])).tolist()
    [1.0, 0.0]
    """

    grid: BevGrid  # grid of the estimate
    target: Target = CAR  # copied to the estimate; does not change the result
    rank: int = 1  # rank of the blocking obstacle return, 1 is the nearest
    median_bins: int = 0  # width in azimuth bins (odd) of the median filter of the limits, 0 for no filter
    limit_farthest: bool = True  # whether the farthest return of the bin limits the view
    # (low, high) height range above local ground of an obstacle return
    obstacle_height_m: tuple[float, float] = OBSTACLE_HEIGHTS_M
    azimuth_bins: int | None = None  # number of bins; None derives it from the measured azimuth step
    name: str = "first_blocker"  # becomes the estimate's ``method``

    def __post_init__(self) -> None:
        require("rank", self.rank, 1, 1000)
        require("median_bins", self.median_bins, 0, 999)
        require_bins(self.azimuth_bins)
        if self.median_bins and self.median_bins % 2 == 0:
            raise ValueError(f"median_bins must be odd or 0, got {self.median_bins}")
        if not self.obstacle_height_m[0] < self.obstacle_height_m[1]:
            raise ValueError(f"obstacle_height_m must be (low, high) with low < high, got {self.obstacle_height_m}")

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return 1 up to the blocking obstacle of each azimuth bin, 0 behind it."""
        limit_m = _core.first_blocker(
            leveled.azimuth, leveled.range_m, leveled.height_m, *self.obstacle_height_m, self.azimuth_bins, self.rank,
            self.median_bins, None if self.limit_farthest else reach_of_sweep(leveled), self.grid.cell_m,
        )  # fmt: skip
        return within_limits(self.grid, limit_m)
