"""Azimuth bins, shared by the geometric estimators: returns by bin, and range limits by bin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.preprocess.leveling import LeveledSweep

FALLBACK_BINS = 360
"""Number of azimuth bins if there are too few returns to measure the sensor's azimuth step."""

MAX_BINS = 32_000


def require(name: str, value: float, low: float, high: float) -> None:
    """Raise ValueError unless ``low`` ≤ ``value`` ≤ ``high``."""
    if not low <= value <= high:
        raise ValueError(f"{name} must lie in [{low:g}, {high:g}], got {value}")


def require_bins(azimuth_bins: int | None) -> None:
    """Raise ValueError unless ``azimuth_bins`` is None or in [4, 32000]."""
    if azimuth_bins is not None:
        require("azimuth_bins", azimuth_bins, 4, MAX_BINS)


@dataclass(frozen=True, slots=True)
class Crop:
    """Filter of the returns that an estimator uses; the default keeps all."""

    max_range_m: float = np.inf  # maximum horizontal range of a return
    height_m: tuple[float, float] = (-np.inf, np.inf)  # lowest and highest z from the sensor, after leveling

    def __post_init__(self) -> None:
        if not self.max_range_m > 0:
            raise ValueError(f"max_range_m must be positive, got {self.max_range_m}")
        if not self.height_m[0] < self.height_m[1]:
            raise ValueError(f"height_m must be (low, high) with low < high, got {self.height_m}")

    def apply(self, leveled: LeveledSweep) -> LeveledSweep:
        """Return ``leveled`` with the returns that pass the filter, in order."""
        if self == ALL_RETURNS:
            return leveled
        z_m = leveled.points[:, 2] - np.float32(leveled.sensor_height_m)
        inside = (leveled.range_m <= self.max_range_m) & (z_m >= self.height_m[0]) & (z_m <= self.height_m[1])
        keep = np.flatnonzero(inside)
        columns = {name: getattr(leveled, name)[keep] for name in ("points", "range_m", "azimuth", "height_m", "rows")}
        return replace(leveled, **columns)

    def any_on(self, leveled: LeveledSweep, grid: BevGrid) -> bool:
        """Return whether any return on ``grid`` passes the filter."""
        return _core.any_return_on(
            leveled.points, leveled.range_m, self.max_range_m, *self.height_m, leveled.sensor_height_m,
            *grid.origin_m, 1.0 / grid.cell_m, grid.cells,
        )  # fmt: skip


ALL_RETURNS = Crop()
"""No crop."""


def measured_azimuth_bins(azimuth: NDArray[np.float32]) -> int:
    """Return the largest of 1080, 540, 360, 216, 180 and 120 azimuth bins that the returns (M,) fill without gaps.

    At least 95 % of the occupied bins must have a return in both neighboring bins. If no number fits (sparse returns),
    the result is ``FALLBACK_BINS``.

    >>> measured_azimuth_bins(np.linspace(-3.14, 3.14, 400, dtype=np.float32))
    360
    """
    return _core.azimuth_bins_filled(azimuth)


def azimuth_bins_of(azimuth: NDArray[np.floating[Any]], bins: int) -> NDArray[np.int16]:
    """Return the bin (…,) in [0, bins) of azimuths (…,) in [-π, π); bins are half-open, the first begins at -π.

    >>> azimuth_bins_of(np.array([-np.pi, -0.01, 0.01]), 4).tolist()
    [0, 1, 2]
    """
    position = (azimuth.astype(np.float64) + np.pi) * (bins / (2.0 * np.pi))
    return np.clip(position, 0, bins - 1).astype(np.int16)


@lru_cache(maxsize=16)
def bins_of_cells(grid: BevGrid, bins: int) -> NDArray[np.int16]:
    """Return the azimuth bin (cells, cells) of each cell's center about the sensor; read-only."""
    table = azimuth_bins_of(polar_of_cells(grid)[1], bins)
    table.setflags(write=False)
    return table


def farthest_in_bins(leveled: LeveledSweep, bins: int | None, drop: int = 0) -> NDArray[np.float32]:
    """Return the range (bins,) in meters of each azimuth bin's farthest return after dropping ``drop``; -1 for none.

    If ``bins`` is None, their number is that of :func:`measured_azimuth_bins`.
    """
    return _core.farthest_in_bins(leveled.azimuth, leveled.range_m, bins, drop)


def with_margin(limit_m: NDArray[np.float32], margin_m: float) -> NDArray[np.float32]:
    """Return ``limit_m`` plus ``margin_m``; negative limits (no return) stay -1."""
    return np.where(limit_m >= 0, limit_m + np.float32(margin_m), np.float32(-1.0)).astype(np.float32)


def within_limits(grid: BevGrid, limit_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return 1 for cells (cells, cells) whose center is within the range limit (bins,) of its azimuth bin, else 0."""
    return _core.cells_within(limit_m, polar_of_cells(grid)[0], bins_of_cells(grid, len(limit_m)))
