"""The one definition of *visible*.

A cell is visible to a sweep if a target standing there would have given at least ``min_returns`` returns.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import factorial
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.beam_counts import AZIMUTH_COLUMNS, GROUND_SECTORS, reached
from viewshed.bev import BevGrid
from viewshed.ground import Ground, Places, places_of
from viewshed.windows import range_bins, windows_of

_SLOPE_BINS = 512
_SLOPE_LIMIT = 1.0
_BELOW_GROUND_M = 0.3
_KEPT = threading.local()
Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Target:
    """What would have to be seen: an upright box on the local ground.

    Attributes:
        name: what it is.
        length_m: longer side.
        width_m: shorter side, the one that beams must fall on.
        height_m: height above local ground.
        min_returns: returns from which on it counts as seen.
    """

    name: str
    length_m: float
    width_m: float
    height_m: float
    min_returns: int

    def __post_init__(self) -> None:
        for key in ("length_m", "width_m", "height_m"):
            value = getattr(self, key)
            if not (np.isfinite(value) and 0 < value <= 100):
                raise ValueError(f"{key} must lie in (0, 100], got {value}")
        if not 1 <= self.min_returns <= 10_000:
            raise ValueError(f"min_returns must lie in [1, 10000], got {self.min_returns}")


CAR = Target("car", 4.2, 1.8, 1.5, 5)
PEDESTRIAN = Target("pedestrian", 0.6, 0.6, 1.7, 3)
TARGETS: dict[str, Target] = {target.name: target for target in (CAR, PEDESTRIAN)}
"""The targets by name."""


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Straight beams from the sensor, in the ``level`` frame: what the definition of visible counts.

    Attributes:
        azimuth: (B,) float32 radians in [-π, π).
        slope: (B,) float32 rise over horizontal range.
        depth_m: (B,) float32 horizontal range at which the beam ended; +inf where nothing stopped it.
    """

    azimuth: NDArray[np.float32]
    slope: NDArray[np.float32]
    depth_m: NDArray[np.float32]

    def __post_init__(self) -> None:
        if not (self.azimuth.shape == self.slope.shape == self.depth_m.shape) or self.azimuth.ndim != 1:
            raise ValueError("azimuth, slope and depth_m must have one shape (B,)")

    def __add__(self, other: Beams) -> Beams:
        """Return both together, the other's last."""
        pairs = ((self.azimuth, other.azimuth), (self.slope, other.slope), (self.depth_m, other.depth_m))
        return Beams(*map(np.concatenate, pairs))


def expected_returns(
    beams: Beams, sensor_height_m: float, ground: Ground, grid: BevGrid, target: Target
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (cells, cells) expected returns of a target in each cell, and the beams that aim at it.

    A beam counts for a cell at range r if its azimuth falls inside the target's width at r, its height at r lies
    between the local ground and the target's top, and its depth reaches r less one cell. ``aimed`` leaves the
    depth out: beams that would meet the target if nothing stood nearer. Counts are interpolated within an azimuth
    column (``aimed``: averaged over neighboring sectors of 2.8°), so they need not be whole; heights may lie 0.3 m
    below ground, the tolerance of a measured ground.
    """
    limits = _slope_limits(sensor_height_m, ground, grid, target)
    aimed = _aimed(beams.azimuth, beams.slope, *limits)
    returns, aims = np.empty(grid.shape, np.float32), np.empty(grid.shape, np.float32)
    windows_of(grid, target.width_m, GROUND_SECTORS).sums(aimed, aims)
    _returns(beams, limits, grid, target, returns)
    return returns, aims


def returns_by_kind(
    kinds: Sequence[Beams], sensor_height_m: float, ground: Ground, grid: BevGrid, target: Target
) -> NDArray[np.float32]:
    """Return (kinds, cells, cells) expected returns of a target by each of several sets of beams.

    As :func:`expected_returns` counts them: over disjoint sets they add up to what it gives for all beams.
    """
    limits = _slope_limits(sensor_height_m, ground, grid, target)
    returns = np.empty((len(kinds), *grid.shape), np.float32)
    for beams, found in zip(kinds, returns, strict=True):
        _returns(beams, limits, grid, target, found)
    return returns


def _returns(beams: Beams, limits: tuple[Floats, Floats], grid: BevGrid, target: Target, found: Floats) -> None:
    """Write the expected returns into ``found`` (cells, cells)."""
    if not len(beams.azimuth):
        found.fill(0.0)
        return
    sums = _room((AZIMUTH_COLUMNS + 1, range_bins(grid)))
    reached((beams.azimuth, beams.slope, beams.depth_m), *limits, np.float32(grid.cell_m), sums)
    windows_of(grid, target.width_m, AZIMUTH_COLUMNS).sums(sums, found, 0.0)


def _room(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return memory that this thread uses again and again: to ask for megabytes anew costs page faults."""
    size = int(np.prod(shape))
    if len(getattr(_KEPT, "room", ())) < size:
        _KEPT.room = np.empty(size, np.float32)
    found: NDArray[np.float32] = _KEPT.room[:size].reshape(shape)
    return found


def probability_of_visible(counts: NDArray[np.float32], min_returns: int) -> NDArray[np.float32]:
    """Return P(N ≥ min_returns), N Poisson with mean ``counts``, float32 of the same shape.

    Beam counts of a measured sweep are uncertain by the jitter of azimuths and ground. The median of a Poisson
    variable of whole mean m is m, so that a threshold of 0.5 is the definition itself.

    >>> probability_of_visible(np.array([0.0, 4.0, 5.0, 50.0], np.float32), 5).round(2).tolist()
    [0.0, 0.3700000047683716, 0.5600000023841858, 1.0]
    """
    table = _poisson_table(min_returns)
    index = np.minimum(counts * np.float32(_TABLE_STEPS), np.float32(len(table) - 1)).astype(np.int32)
    prob: NDArray[np.float32] = table[index]
    return prob


_TABLE_STEPS = 32


@lru_cache(maxsize=8)
def _poisson_table(min_returns: int) -> NDArray[np.float32]:
    top = min_returns + 10 * int(np.sqrt(min_returns)) + 10
    mean = np.arange(top * _TABLE_STEPS + 1) / _TABLE_STEPS
    if min_returns > 100:
        return (mean >= min_returns).astype(np.float32)
    below = sum(mean**k / factorial(k) for k in range(min_returns)) * np.exp(-mean)
    return np.maximum.accumulate(np.clip(1.0 - below, 0.0, 1.0)).astype(np.float32)


def _slope_limits(
    sensor_height_m: float, ground: Ground, grid: BevGrid, target: Target
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the slopes (sectors, bins) of beams that pass a target's foot and its top."""
    lattice = ground.half_extent_m, len(ground.heights_m)
    places, per_range = _polar_places(range_bins(grid), grid.cell_m, *lattice)
    foot = ground.on(places) - np.float32(sensor_height_m)
    return (foot - np.float32(_BELOW_GROUND_M)) * per_range, (foot + np.float32(target.height_m)) * per_range


@lru_cache(maxsize=8)
def _polar_places(bins: int, cell_m: float, half_extent_m: float, nodes: int) -> tuple[Places, Floats]:
    """Return where the middles of polar bins (sectors, bins) lie on a ground's lattice, and 1 / range (bins,)."""
    azimuth = (np.arange(GROUND_SECTORS) + 0.5) * (2 * np.pi / GROUND_SECTORS) - np.pi
    range_m = (np.arange(bins) + 0.5) * cell_m
    xy = np.stack([np.cos(azimuth)[:, None] * range_m, np.sin(azimuth)[:, None] * range_m], axis=-1)
    return places_of(xy, half_extent_m, nodes), (1.0 / range_m).astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _aimed(azimuth: Any, slope: Any, bottom: Any, top: Any) -> Any:  # pragma: no cover - compiled
    """Beams that aim at (sector, range bin) whatever their depth, summed over the sectors before."""
    sectors, bins = top.shape
    histogram = np.zeros((sectors, _SLOPE_BINS + 1), np.float32)
    per_rad = np.float32(sectors / (2 * np.pi))
    per_slope = np.float32(_SLOPE_BINS / (2 * _SLOPE_LIMIT))
    for n in range(azimuth.shape[0]):
        sector = min(max(int((azimuth[n] + np.float32(np.pi)) * per_rad), 0), sectors - 1)
        q = (slope[n] + np.float32(_SLOPE_LIMIT)) * per_slope
        if q >= 0 and q < _SLOPE_BINS:
            histogram[sector, int(q) + 1] += 1
    for sector in range(sectors):
        for q in range(_SLOPE_BINS):
            histogram[sector, q + 1] += histogram[sector, q]
    counts = np.zeros((sectors + 1, bins), np.float32)
    _smooth_around(histogram)
    for sector in range(sectors):
        for k in range(bins):
            high = _cumulative(histogram[sector], (top[sector, k] + np.float32(_SLOPE_LIMIT)) * per_slope)
            low = _cumulative(histogram[sector], (bottom[sector, k] + np.float32(_SLOPE_LIMIT)) * per_slope)
            counts[sector + 1, k] = counts[sector, k] + high - low
    return counts


@njit(cache=True, nogil=True, error_model="numpy")
def _smooth_around(histogram: Any) -> None:  # pragma: no cover - compiled
    """Weigh each sector 1/2 and its neighbors 1/4: firings do not divide evenly among sectors."""
    sectors = histogram.shape[0]
    source = histogram.copy()
    for sector in range(sectors):
        before, after = source[sector - 1], source[(sector + 1) % sectors]
        for q in range(histogram.shape[1]):
            histogram[sector, q] = np.float32(0.5) * source[sector, q] + np.float32(0.25) * (before[q] + after[q])


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _cumulative(sums: Any, at: Any) -> Any:  # pragma: no cover - compiled
    at = min(max(at, np.float32(0.0)), np.float32(sums.shape[0] - 1.001))
    i = int(at)
    return sums[i] + (at - i) * (sums[i + 1] - sums[i])
