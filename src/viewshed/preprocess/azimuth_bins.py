"""Azimuth bins: what the geometric estimators share. Returns by bin, and limits in range."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.grid import BevGrid, polar_of_cells
from viewshed.preprocess.leveling import LeveledSweep

BINS_LADDER = (1080, 540, 360, 216, 180, 120)
"""Azimuth bins that :func:`measured_azimuth_bins` chooses from; each divides the first."""

FALLBACK_BINS = 360
"""Azimuth bins where the returns are too few to measure the sensor's step."""

MAX_BINS = 32_000


def require(name: str, value: float, low: float, high: float) -> None:
    """Raise a ValueError unless ``low`` ≤ ``value`` ≤ ``high``."""
    if not low <= value <= high:
        raise ValueError(f"{name} must lie in [{low:g}, {high:g}], got {value}")


def require_bins(azimuth_bins: int | None) -> None:
    """Raise a ValueError unless ``azimuth_bins`` is None or a usable number of bins."""
    if azimuth_bins is not None:
        require("azimuth_bins", azimuth_bins, 4, MAX_BINS)


@dataclass(frozen=True, slots=True)
class Crop:
    """Which returns an estimator uses; the default uses all.

    Attributes:
        max_range_m: horizontal range up to which returns count.
        height_m: lowest and highest z from the sensor, in the level attitude.
    """

    max_range_m: float = np.inf
    height_m: tuple[float, float] = (-np.inf, np.inf)

    def __post_init__(self) -> None:
        if not self.max_range_m > 0:
            raise ValueError(f"max_range_m must be positive, got {self.max_range_m}")
        if not self.height_m[0] < self.height_m[1]:
            raise ValueError(f"height_m must be (low, high) with low < high, got {self.height_m}")

    def apply(self, leveled: LeveledSweep) -> LeveledSweep:
        """Return ``level`` with the returns that count, in their order."""
        if self == ALL_RETURNS:
            return leveled
        z_m = leveled.points[:, 2] - np.float32(leveled.sensor_height_m)
        used = (leveled.range_m <= self.max_range_m) & (z_m >= self.height_m[0]) & (z_m <= self.height_m[1])
        keep = np.flatnonzero(used)
        columns = {name: getattr(leveled, name)[keep] for name in ("points", "range_m", "azimuth", "height_m", "rows")}
        return replace(leveled, **columns)

    def any_on(self, leveled: LeveledSweep, grid: BevGrid) -> bool:
        """Return whether a return that counts lies on ``grid``."""
        far_m, low_m, high_m, sensor_m = np.array(
            [self.max_range_m, *self.height_m, leveled.sensor_height_m], np.float32
        )
        x0_m, y0_m = grid.origin_m
        return bool(
            _any_on(
                leveled.points, leveled.range_m, far_m, low_m, high_m, sensor_m, x0_m, y0_m, 1.0 / grid.cell_m,
                float(grid.cells),
            )
        )  # fmt: skip


ALL_RETURNS = Crop()
"""No crop."""


def measured_azimuth_bins(azimuth: NDArray[np.float32]) -> int:
    """Return how many azimuth bins the returns (M,) fill without gaps: the most of ``BINS_LADDER`` that they do.

    A bin is well filled if both neighbors hold a return as well; 95 % of the occupied bins must be. Sparse returns
    fill none and get ``FALLBACK_BINS``.

    >>> measured_azimuth_bins(np.linspace(-3.14, 3.14, 400, dtype=np.float32))
    360
    """
    occupied = np.zeros(BINS_LADDER[0], np.bool_)
    _occupy(azimuth, occupied)
    return bins_filled(occupied)


def bins_filled(occupied: NDArray[np.bool_]) -> int:
    """Return :func:`measured_azimuth_bins` of returns that occupy some of the narrowest bins."""
    for bins in BINS_LADDER:
        filled: NDArray[np.bool_] = np.asarray(occupied.reshape(bins, -1).any(axis=1))
        inner = int(np.count_nonzero(filled[:-2] & filled[1:-1] & filled[2:]))
        inner += int(filled[0] & filled[-1]) * (int(filled[1]) + int(filled[-2]))
        if inner >= 0.95 * max(int(np.count_nonzero(filled)), 1):
            return bins
    return FALLBACK_BINS


def azimuth_bins_of(azimuth: NDArray[np.floating[Any]], bins: int) -> NDArray[np.int16]:
    """Return the bin (…,) in [0, bins) of azimuths (…,) in [-π, π): half-open bins, the first begins at -π.

    >>> azimuth_bins_of(np.array([-np.pi, -0.01, 0.01]), 4).tolist()
    [0, 1, 2]
    """
    position = (azimuth.astype(np.float64) + np.pi) * (bins / (2.0 * np.pi))
    return np.clip(position, 0, bins - 1).astype(np.int16)


@lru_cache(maxsize=16)
def bins_of_cells(grid: BevGrid, bins: int) -> NDArray[np.int16]:
    """Return the azimuth bin (cells, cells) of each cell's center, seen from the sensor; read-only."""
    table = azimuth_bins_of(polar_of_cells(grid)[1], bins)
    table.setflags(write=False)
    return table


def farthest_in_bins(leveled: LeveledSweep, bins: int, drop: int = 0) -> NDArray[np.float32]:
    """Return the range (bins,) in meters of the farthest return but ``drop`` in each azimuth bin; -1 where none."""
    best = np.full((bins, drop + 1), -1.0, np.float32)
    if drop == 0:
        _farthest(leveled.azimuth, leveled.range_m, best[:, 0])
        return best[:, 0]
    _largest(leveled.azimuth, leveled.range_m, best)
    return best[:, drop]


def nearest_obstacle_in_bins(
    leveled: LeveledSweep, bins: int, rank: int, height_m: tuple[float, float]
) -> NDArray[np.float32]:
    """Return the range (bins,) in meters of the ``rank``-th nearest obstacle return of each bin; inf where none."""
    best = np.full((bins, rank), np.inf, np.float32)
    low_m, high_m = np.array(height_m, np.float32)
    _smallest(leveled.azimuth, leveled.range_m, leveled.height_m, low_m, high_m, best)
    return best[:, rank - 1]


def with_margin(limit_m: NDArray[np.float32], margin_m: float) -> NDArray[np.float32]:
    """Return ``limit_m`` moved out by ``margin_m``, but not where it is negative: there is no return."""
    return np.where(limit_m >= 0, limit_m + np.float32(margin_m), np.float32(-1.0)).astype(np.float32)


def within_limits(grid: BevGrid, limit_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the mask (cells, cells) of cells whose center lies no farther than the limit (bins,) of its azimuth."""
    return np.asarray(polar_of_cells(grid)[0] <= limit_m[bins_of_cells(grid, len(limit_m))])


@njit(cache=True, nogil=True, error_model="numpy")
def _any_on(
    points: Any,
    range_m: Any,
    far_m: Any,
    low_m: Any,
    high_m: Any,
    sensor_m: Any,
    x0_m: Any,
    y0_m: Any,
    cells_per_m: Any,
    cells: Any,
) -> Any:  # pragma: no cover - compiled
    """Whether a point within the limits of range and of height from the sensor lies on the grid."""
    for n in range(points.shape[0]):
        z = points[n, 2] - sensor_m
        if range_m[n] <= far_m and low_m <= z <= high_m:
            u, v = (points[n, 0] - x0_m) * cells_per_m, (points[n, 1] - y0_m) * cells_per_m
            if 0 <= u < cells and 0 <= v < cells:
                return True
    return False


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _bin(azimuth: Any, bins: Any) -> Any:  # pragma: no cover - compiled
    """Return the azimuth bin; in float64, as :func:`azimuth_bins_of` computes that of cells."""
    position = int((np.float64(azimuth) + np.pi) * (bins / (2.0 * np.pi)))
    return min(max(position, 0), bins - 1)


@njit(cache=True, nogil=True, error_model="numpy")
def _occupy(azimuth: Any, occupied: Any) -> None:  # pragma: no cover - compiled
    """Mark the bins (bins,) with a return."""
    for n in range(azimuth.shape[0]):
        occupied[_bin(azimuth[n], occupied.shape[0])] = True


@njit(cache=True, nogil=True, error_model="numpy")
def _farthest(azimuth: Any, range_m: Any, best: Any) -> None:  # pragma: no cover - compiled
    """Write the greatest range of each bin (bins,)."""
    for n in range(azimuth.shape[0]):
        b = _bin(azimuth[n], best.shape[0])
        best[b] = max(best[b], range_m[n])


@njit(cache=True, nogil=True, error_model="numpy")
def _largest(azimuth: Any, range_m: Any, best: Any) -> None:  # pragma: no cover - compiled
    """Write the greatest ranges of each bin (bins, drop + 1), descending."""
    bins, last = best.shape[0], best.shape[1] - 1
    for n in range(azimuth.shape[0]):
        b, r = _bin(azimuth[n], bins), range_m[n]
        if r > best[b, last]:
            k = last
            while k > 0 and best[b, k - 1] < r:
                best[b, k] = best[b, k - 1]
                k -= 1
            best[b, k] = r


@njit(cache=True, nogil=True, error_model="numpy")
def _smallest(
    azimuth: Any, range_m: Any, height: Any, low_m: Any, high_m: Any, best: Any
) -> None:  # pragma: no cover - compiled
    """Write the least ranges of each bin (bins, rank), ascending, of returns between two heights."""
    bins, last = best.shape[0], best.shape[1] - 1
    for n in range(azimuth.shape[0]):
        if not low_m < height[n] < high_m:
            continue
        b, r = _bin(azimuth[n], bins), range_m[n]
        if r < best[b, last]:
            k = last
            while k > 0 and best[b, k - 1] > r:
                best[b, k] = best[b, k - 1]
                k -= 1
            best[b, k] = r
