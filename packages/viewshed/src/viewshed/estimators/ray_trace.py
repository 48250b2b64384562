"""Ray traces to the farthest return: per azimuth bin (quantized) or per window of azimuth (continuous).

Ray trace to the farthest return once the few farthest are dropped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.estimators.classical import ClassicalEstimator
from viewshed.fov.visibility import CAR, Target
from viewshed.geometry import polar
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.preprocess.azimuth_bins import (
    ALL_RETURNS,
    FALLBACK_BINS,
    Crop,
    azimuth_bins_of,
    bins_of_cells,
    farthest_in_bins,
    measured_azimuth_bins,
    require,
    require_bins,
    with_margin,
    within_limits,
)
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep

_SLICES = 8
"""Fine bins in a window's half width; only cells in doubt look at single returns."""


@dataclass(frozen=True, slots=True)
class QuantizedRayTrace(ClassicalEstimator):
    """Visible up to the farthest return of the azimuth bin. Source: arXiv 2503.07375, section on classical estimators.

    A cell belongs to the bin of its center's azimuth from the sensor and is visible if its center's range is at most
    the bin's farthest return plus one cell. With ``range_bins`` ranges are compared as bin numbers instead. A bin
    without a return has no visible cell.

    Limits: holes behind low cars and poles are called visible (later returns of the bin pass over them); one spoofed
    far point opens a whole bin; with ``about_centroid`` (the paper's labels) rays start where no sensor stands.

    >>> import numpy as np
    >>> from viewshed import Sweep
    >>> sweep = Sweep(np.array([[9.0, 0.5, -1.7]]), sensor_height_m=1.7)
    >>> QuantizedRayTrace(BevGrid(32, 16.0)).estimate(sweep).at(np.array([[9.0, 0.6], [-9.0, 0.6]])).tolist()
    [1.0, 0.0]
    """

    grid: BevGrid  # where the cells are
    target: Target = CAR  # passed on; this estimator does not depend on it
    azimuth_bins: int | None = None  # number of bins; None takes them from the measured azimuth step
    range_bins: int | None = None  # number of range bins up to ``max_range_m``; None compares ranges themselves
    max_range_m: float = np.inf  # farther returns count as returns at this range
    crop: Crop = ALL_RETURNS  # which returns count at all
    about_centroid: bool = False  # rays start at the centroid of the points, not at the sensor
    name: str = "quantized"  # goes into the estimate's ``method``

    def __post_init__(self) -> None:
        require_bins(self.azimuth_bins)
        if not self.max_range_m > 0:
            raise ValueError(f"max_range_m must be positive, got {self.max_range_m}")
        if self.range_bins is not None:
            require("range_bins", self.range_bins, 1, 1_000_000)
            if not np.isfinite(self.max_range_m):
                raise ValueError("range_bins need a finite max_range_m; give the range that they divide")
        if self.about_centroid and self.azimuth_bins is None:
            raise ValueError("azimuth_bins must be given with about_centroid; the sensor's step says nothing there")

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return 1 up to the farthest return of each azimuth bin, 0 beyond."""
        leveled = self.crop.apply(leveled)
        if self.about_centroid:
            return self._visible_about_centroid(leveled)
        return within_limits(self.grid, self._limit(farthest_in_bins(leveled, self.azimuth_bins)))

    def _visible_about_centroid(self, leveled: LeveledSweep) -> NDArray[np.float32]:
        bins = self.azimuth_bins or 1
        xy = leveled.points[:, :2].astype(np.float64)
        centroid = xy.mean(axis=0).round(6) if len(xy) else np.zeros(2)
        range_m, azimuth = polar(xy - centroid)
        farthest_m = np.full(bins, -1.0, np.float32)
        np.maximum.at(farthest_m, azimuth_bins_of(azimuth, bins), range_m.astype(np.float32))
        cell_range_m, cell_azimuth = polar(self.grid.centers - centroid)
        limit_m = self._limit(farthest_m)[azimuth_bins_of(cell_azimuth, bins)]
        return (cell_range_m.astype(np.float32) <= limit_m).astype(np.float32)

    def _limit(self, farthest_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the range (bins,) up to which a cell's center is visible."""
        farthest_m = np.minimum(farthest_m, np.float32(self.max_range_m))
        if self.range_bins is None:
            return with_margin(farthest_m, self.grid.cell_m)
        step = self.max_range_m / self.range_bins
        last = np.minimum(np.floor(farthest_m / step), self.range_bins - 1)
        edge = np.nextafter(((last + 1) * step).astype(np.float32), np.float32(0))
        return np.where(farthest_m >= 0, edge, np.float32(-1.0))


@dataclass(frozen=True, slots=True)
class ContinuousRayTrace(ClassicalEstimator):
    """Visible up to the farthest return within ± ``window`` of the cell's azimuth. Source: arXiv 2503.07375.

    A cell is visible if its center's range is at most the farthest return whose azimuth differs from the center's by
    at most ``window`` (plus ``margin_m``). Without a return in the window it is not visible.

    Limits: as the quantized ray trace, and smeared by the window: each far return opens 2 · ``window`` of azimuth.

    >>> ContinuousRayTrace(BevGrid(8, 4.0), window=4.0)
    Traceback (most recent call last):
    ...
    ValueError: window must lie in [0.004, 1.5], got 4.0
    """

    grid: BevGrid  # where the cells are
    target: Target = CAR  # passed on; this estimator does not depend on it
    window: float = 0.01  # half width in radians (the paper's is 0.05)
    margin_m: float | None = None  # how far beyond the return a cell's center may lie; None is one cell
    crop: Crop = ALL_RETURNS  # which returns count at all
    name: str = "continuous"  # goes into the estimate's ``method``

    def __post_init__(self) -> None:
        require("window", self.window, 0.004, 1.5)
        if self.margin_m is not None:
            require("margin_m", self.margin_m, 0.0, 100.0)

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return 1 up to the farthest return near each cell's azimuth, 0 beyond."""
        leveled = self.crop.apply(leveled)
        slices = int(np.ceil(2.0 * np.pi * _SLICES / self.window))
        margin_m = self.grid.cell_m if self.margin_m is None else self.margin_m
        return _core.trace_windows(
            leveled.azimuth, leveled.range_m, slices, self.window, margin_m, *polar_of_cells(self.grid),
            bins_of_cells(self.grid, slices),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class TrimmedRayTrace(ClassicalEstimator):
    """Visible up to the farthest return of the azimuth bin but ``trim``. Source: the trimmed maximum of statistics.

    As :class:`~viewshed.estimators.ray_trace.QuantizedRayTrace`, but the ``trim`` farthest returns of each bin are
    dropped first. A bin with no more than ``trim`` returns has no visible cell.

    Limits: more than ``trim`` spoofed points in a bin open it as before; sensors with few beams lose their outer
    rings (16 beams leave 12); holes behind low cars are called visible, as by every farthest-return method.

    >>> TrimmedRayTrace(BevGrid(8, 4.0), trim=4).name
    'trimmed'
    """

    grid: BevGrid  # where the cells are
    target: Target = CAR  # passed on; this estimator does not depend on it
    trim: int = 4  # farthest returns to drop in each bin
    # number of bins; None takes them from the measured azimuth step, but at most 360, so that a bin holds enough
    # returns to drop some
    azimuth_bins: int | None = None
    name: str = "trimmed"  # goes into the estimate's ``method``

    def __post_init__(self) -> None:
        require("trim", self.trim, 0, 1000)
        require_bins(self.azimuth_bins)

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return 1 up to the farthest return of each azimuth bin but the few farthest, 0 beyond."""
        bins = self.azimuth_bins or min(measured_azimuth_bins(leveled.azimuth), FALLBACK_BINS)
        limit_m = farthest_in_bins(leveled, bins, drop=self.trim)
        return within_limits(self.grid, with_margin(limit_m, self.grid.cell_m))
