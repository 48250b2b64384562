"""Ray traces to the farthest return: per azimuth bin (quantized, trimmed) or per azimuth window (continuous)."""

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
"""Fine azimuth bins per half width of a window; only cells that the fine bins leave open test single returns."""


@dataclass(frozen=True, slots=True)
class QuantizedRayTrace(ClassicalEstimator):
    """Visible up to the farthest return of the azimuth bin. Source: arXiv 2503.07375, section on classical estimators.

    A cell belongs to the azimuth bin of its center and is visible if its center's range is at most the bin's farthest
    return plus one cell. With ``range_bins``, indices of range bins are compared instead. A bin without returns has no
    visible cell.

    Limits: shadows of low cars and poles are called visible (other returns of the bin pass over them); one spoofed far
    point opens a whole bin; with ``about_centroid`` (the paper's labels) rays do not start at the sensor.

    >>> import numpy as np
    >>> from viewshed import Sweep
    >>> sweep = Sweep(np.array([[9.0, 0.5, -1.7]]), sensor_height_m=1.7)
    >>> QuantizedRayTrace(BevGrid(32, 16.0)).estimate(sweep).at(np.array([[9.0, 0.6], [-9.0, 0.6]])).tolist()
    [1.0, 0.0]
    """

    grid: BevGrid  # grid of the estimate
    target: Target = CAR  # copied to the estimate; does not change the result
    azimuth_bins: int | None = None  # number of bins; None derives it from the measured azimuth step
    range_bins: int | None = None  # number of range bins up to ``max_range_m``; None compares ranges in meters
    max_range_m: float = np.inf  # ranges of returns are clipped to this
    crop: Crop = ALL_RETURNS  # filter of the returns
    about_centroid: bool = False  # rays start at the centroid of the points, not at the sensor
    name: str = "quantized"  # becomes the estimate's ``method``

    def __post_init__(self) -> None:
        require_bins(self.azimuth_bins)
        if not self.max_range_m > 0:
            raise ValueError(f"max_range_m must be positive, got {self.max_range_m}")
        if self.range_bins is not None:
            require("range_bins", self.range_bins, 1, 1_000_000)
            if not np.isfinite(self.max_range_m):
                raise ValueError("range_bins need a finite max_range_m; give the range that they divide")
        if self.about_centroid and self.azimuth_bins is None:
            raise ValueError(
                "azimuth_bins must be given with about_centroid; the sensor's azimuth step does not apply there"
            )

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
        """Return the maximum range (bins,) of a visible cell center in meters."""
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

    A cell is visible if its center's range is at most that of the farthest return in the window, plus ``margin_m``.
    Without a return in the window it is not visible.

    Limits: those of the quantized ray trace; also, each far return opens 2 · ``window`` of azimuth.

    >>> ContinuousRayTrace(BevGrid(8, 4.0), window=4.0)
    Traceback (most recent call last):
    ...
    ValueError: window must lie in [0.004, 1.5], got 4.0
    """

    grid: BevGrid  # grid of the estimate
    target: Target = CAR  # copied to the estimate; does not change the result
    window: float = 0.01  # half width in radians (the paper's is 0.05)
    margin_m: float | None = None  # distance beyond the return that is still visible; None is one cell
    crop: Crop = ALL_RETURNS  # filter of the returns
    name: str = "continuous"  # becomes the estimate's ``method``

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
    """Visible up to the farthest return of the azimuth bin after dropping the ``trim`` farthest (trimmed maximum).

    Otherwise as :class:`~viewshed.estimators.ray_trace.QuantizedRayTrace`. A bin with ``trim`` or fewer returns has no
    visible cell.

    Limits: more than ``trim`` spoofed points in a bin still open it; sensors with few beams lose their outer rings (12
    of 16 beams remain); shadows of low cars are called visible, as by every farthest-return method.

    >>> TrimmedRayTrace(BevGrid(8, 4.0), trim=4).name
    'trimmed'
    """

    grid: BevGrid  # grid of the estimate
    target: Target = CAR  # copied to the estimate; does not change the result
    trim: int = 4  # number of farthest returns dropped in each bin
    # number of bins; None derives it from the measured azimuth step, at most 360 to have enough returns per bin
    azimuth_bins: int | None = None
    name: str = "trimmed"  # becomes the estimate's ``method``

    def __post_init__(self) -> None:
        require("trim", self.trim, 0, 1000)
        require_bins(self.azimuth_bins)

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return 1 up to the farthest remaining return of each azimuth bin, 0 beyond."""
        bins = self.azimuth_bins or min(measured_azimuth_bins(leveled.azimuth), FALLBACK_BINS)
        limit_m = farthest_in_bins(leveled, bins, drop=self.trim)
        return within_limits(self.grid, with_margin(limit_m, self.grid.cell_m))
