"""The one definition of *visible*.

A cell is visible to a sweep if a target standing there would have given at least ``min_returns`` returns.

Beams are counted in (azimuth column, range bin), summed over the columns before; then the beams that a target in a cell
spans are the difference of two sums, at the two ends of its window of azimuth.
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

from viewshed.fov.height_map import HeightMap, LatticePositions, lattice_positions
from viewshed.grid import BevGrid, polar_of_cells

AZIMUTH_COLUMNS = 2048
"""Columns in which beams are counted; windows are interpolated within a column."""

GROUND_SECTORS = 128
"""Sectors of azimuth in which the local ground is looked up."""

_SECTOR_COLUMNS = AZIMUTH_COLUMNS // GROUND_SECTORS

_VECTOR = 16

_SLOPE_BINS = 512

_SLOPE_LIMIT = 1.0

_BELOW_GROUND_M = 0.3
"""Beams may pass so far below the ground: the tolerance of a measured ground."""

_TABLE_STEPS = 32

_THREAD = threading.local()

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
    beams: Beams, sensor_height_m: float, ground: HeightMap, grid: BevGrid, target: Target
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (cells, cells) expected returns of a target in each cell, and the beams that aim at it.

    A beam counts for a cell at range r if its azimuth falls inside the target's width at r, its height at r lies
    between the local ground and the target's top, and its depth reaches r less one cell. ``aimed`` leaves the
    depth out: beams that would meet the target if nothing stood nearer. Counts are interpolated within an azimuth
    column (``aimed``: averaged over neighboring sectors of 2.8°), so they need not be whole; heights may lie 0.3 m
    below ground, the tolerance of a measured ground.
    """
    [returns] = returns_by_kind([beams], sensor_height_m, ground, grid, target)
    return returns, beams_that_aim(beams, sensor_height_m, ground, grid, target)


def beams_that_aim(
    beams: Beams, sensor_height_m: float, ground: HeightMap, grid: BevGrid, target: Target
) -> NDArray[np.float32]:
    """Return (cells, cells) beams that would meet a target in each cell if nothing stood nearer.

    Averaged over neighboring sectors of 2.8°.
    """
    foot, top = _slope_limits(sensor_height_m, ground, grid, target)
    aimed = np.empty(grid.shape, np.float32)
    aiming = _count_aiming(beams.azimuth, beams.slope, foot, top)
    _windows(grid, target.width_m, GROUND_SECTORS).sum_into(aimed, aiming)
    return aimed


def returns_by_kind(
    kinds: Sequence[Beams], sensor_height_m: float, ground: HeightMap, grid: BevGrid, target: Target
) -> NDArray[np.float32]:
    """Return (kinds, cells, cells) expected returns of a target by each of several sets of beams.

    As :func:`expected_returns` counts them: over disjoint sets they add up to what it gives for all beams.
    """
    foot, top = _slope_limits(sensor_height_m, ground, grid, target)
    returns = np.empty((len(kinds), *grid.shape), np.float32)
    for beams, out in zip(kinds, returns, strict=True):
        _write_returns(beams, foot, top, grid, target, out)
    return returns


def _write_returns(beams: Beams, foot: Floats, top: Floats, grid: BevGrid, target: Target, out: Floats) -> None:
    """Write the expected returns into ``out`` (cells, cells)."""
    if not len(beams.azimuth):
        out.fill(0.0)
        return
    sums = _scratch((AZIMUTH_COLUMNS + 1, range_bins(grid)))
    _beams_that_reach(beams.azimuth, beams.slope, beams.depth_m, foot, top, np.float32(grid.cell_m), sums)
    _windows(grid, target.width_m, AZIMUTH_COLUMNS).sum_into(out, sums, 0.0)


def _scratch(shape: tuple[int, ...]) -> Floats:
    """Return memory that this thread uses again and again: allocating megabytes anew costs page faults."""
    size = int(np.prod(shape))
    if len(getattr(_THREAD, "scratch", ())) < size:
        _THREAD.scratch = np.empty(size, np.float32)
    scratch: Floats = _THREAD.scratch[:size].reshape(shape)
    return scratch


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


@lru_cache(maxsize=8)
def _poisson_table(min_returns: int) -> NDArray[np.float32]:
    """Return P(N ≥ min_returns) at means 0, 1/32, 2/32 and so on."""
    top = min_returns + 10 * int(np.sqrt(min_returns)) + 10
    mean = np.arange(top * _TABLE_STEPS + 1) / _TABLE_STEPS
    if min_returns > 100:
        return (mean >= min_returns).astype(np.float32)
    below = sum(mean**k / factorial(k) for k in range(min_returns)) * np.exp(-mean)
    return np.maximum.accumulate(np.clip(1.0 - below, 0.0, 1.0)).astype(np.float32)


def _slope_limits(sensor_height_m: float, ground: HeightMap, grid: BevGrid, target: Target) -> tuple[Floats, Floats]:
    """Return the slopes (sectors, bins) of beams that pass a target's foot and its top."""
    lattice = ground.half_extent_m, len(ground.heights_m)
    positions, per_range = _polar_positions(range_bins(grid), grid.cell_m, *lattice)
    foot_m = ground.at_positions(positions) - np.float32(sensor_height_m)
    return (foot_m - np.float32(_BELOW_GROUND_M)) * per_range, (foot_m + np.float32(target.height_m)) * per_range


@lru_cache(maxsize=8)
def _polar_positions(bins: int, cell_m: float, half_extent_m: float, nodes: int) -> tuple[LatticePositions, Floats]:
    """Return the lattice positions of the middles of polar bins (sectors, bins), and 1 / range (bins,)."""
    azimuth = (np.arange(GROUND_SECTORS) + 0.5) * (2 * np.pi / GROUND_SECTORS) - np.pi
    range_m = (np.arange(bins) + 0.5) * cell_m
    xy = np.stack([np.cos(azimuth)[:, None] * range_m, np.sin(azimuth)[:, None] * range_m], axis=-1)
    return lattice_positions(xy, half_extent_m, nodes), (1.0 / range_m).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Ends of the window of azimuth of each of N cells in sums (columns + 1, bins) over azimuth columns.

    Attributes:
        columns: azimuth columns of the turn.
        bins: range bins, each as long as a cell.
        ends: (2, N) int32 flat index of the column that each end lies in, at the cell's range bin: begin and end.
        parts: (2, N) float32 how far into that column it lies, in [0, 1).
        seam: (S,) int32 cells whose window passes the seam.
        turns: (S,) float32 how often it does.
    """

    columns: int
    bins: int
    ends: NDArray[np.int32]
    parts: NDArray[np.float32]
    seam: NDArray[np.int32]
    turns: NDArray[np.float32]

    def sum_into(self, out: Floats, sums: Floats, least: float = -np.inf) -> None:
        """Write into ``out`` (cells, cells) the sum over each cell's window, interpolated within columns.

        Args:
            out: where to write, contiguous.
            sums: (columns + 1, bins) sums over the columns before.
            least: sums below this become it.
        """
        _sum_windows(
            sums.reshape(-1), np.uint32(self.bins), np.uint32(self.columns), self.ends[0], self.ends[1], self.parts[0],
            self.parts[1], self.seam, self.turns, np.float32(least), out.reshape(-1),
        )  # fmt: skip


@lru_cache(maxsize=16)
def range_bins(grid: BevGrid) -> int:
    """Return how many range bins of a cell's length reach the farthest cell of a grid."""
    return int(np.ceil(float(polar_of_cells(grid)[0].max()) / grid.cell_m)) + 1


@lru_cache(maxsize=16)
def _windows(grid: BevGrid, width_m: float, columns: int) -> _Windows:
    """Return the windows of a target of a width that it turns to the sensor, in each cell of a grid."""
    range_m, azimuth = (array.reshape(-1) for array in polar_of_cells(grid))
    bins = range_bins(grid)
    # Half of the width, in columns, at the middle of each range bin.
    middle_m = (np.arange(bins) + 0.5) * grid.cell_m
    half = np.arctan2(width_m / 2, middle_m) * (columns / (2 * np.pi))
    bin_of = np.minimum(range_m / np.float32(grid.cell_m), np.float32(bins - 1)).astype(np.int32)
    # Both ends in columns, taken into one turn; where they lie in different turns, the window passes the seam.
    center = (azimuth.astype(np.float64) + np.pi) * (columns / (2 * np.pi))
    edges = np.stack([center - half[bin_of], center + half[bin_of]])
    turn = np.floor(edges / columns)
    edges -= turn * columns
    column = np.minimum(edges.astype(np.int32), columns - 1)
    parts = (edges - column).astype(np.float32)
    turns = (turn[1] - turn[0]).astype(np.float32)
    seam = np.flatnonzero(turns).astype(np.int32)
    windows = _Windows(columns, bins, column * np.int32(bins) + bin_of, parts, seam, turns[seam])
    for array in (windows.ends, windows.parts, windows.seam, windows.turns):
        array.setflags(write=False)
    return windows


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_windows(
    sums: Any,
    bins: Any,
    columns: Any,
    begins: Any,
    ends: Any,
    begin_parts: Any,
    end_parts: Any,
    seam: Any,
    turns: Any,
    least: Any,
    out: Any,
) -> None:  # pragma: no cover - compiled
    """Write the sum over each window; indices are unsigned, since signed ones may count from the end: twice the time.

    Args: flat ``sums`` over the columns before, of ``columns`` + 1 rows of ``bins``; the others as in ``_Windows``.
    """
    for n in range(out.shape[0]):
        begin = _sum_before(sums, bins, np.uint32(begins[n]), begin_parts[n])
        out[n] = max(_sum_before(sums, bins, np.uint32(ends[n]), end_parts[n]) - begin, least)
    # Windows across the seam: the sum of the whole turn is added.
    for k in range(seam.shape[0]):
        n, b = seam[k], np.uint32(begins[seam[k]])
        begin = _sum_before(sums, bins, b, begin_parts[n])
        between = _sum_before(sums, bins, np.uint32(ends[n]), end_parts[n]) - begin
        out[n] = max(between + turns[k] * sums[columns * bins + b % bins], least)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _sum_before(sums: Any, bins: Any, at: Any, part: Any) -> Any:  # pragma: no cover - compiled
    return sums[at] + part * (sums[at + bins] - sums[at])


@njit(cache=True, nogil=True, error_model="numpy")
def _beams_that_reach(
    azimuth: Any, slope: Any, depth_m: Any, foot: Any, top: Any, cell_m: Any, sums: Any
) -> None:  # pragma: no cover - compiled
    """Write the beams that reach (column, range bin), summed over the columns before, into (columns + 1, bins).

    A beam reaches a bin if its slope there lies between ``foot`` and ``top`` (sectors, bins) and it ended no nearer.
    Beams are sorted by column first: then a column's sums stay in the nearest memory while its beams are counted, and
    each is written once. They are whole numbers, so that the order of the beams does not matter.
    """
    sectors, bins = top.shape
    begin, end, sorted_slope, last_bin = _sort_by_column(azimuth, slope, depth_m, top, cell_m)
    counts = np.zeros((bins + _VECTOR - 1) // _VECTOR * _VECTOR, np.int32)
    low, high = np.full(counts.shape[0], np.float32(np.inf)), np.full(counts.shape[0], np.float32(-np.inf))
    sums[0] = 0.0
    for sector in range(sectors):
        low[:bins], high[:bins] = foot[sector], top[sector]
        for column in range(sector * _SECTOR_COLUMNS, (sector + 1) * _SECTOR_COLUMNS):
            for n in range(np.uint32(begin[column]), np.uint32(end[column])):
                s, last = sorted_slope[n], last_bin[n]
                whole = np.uint32(last + _VECTOR) // np.uint32(_VECTOR) * np.uint32(_VECTOR)
                for k in range(whole):  # whole vectors: the bins beyond ``last`` are masked
                    counts[k] += np.int32((s >= low[k]) & (s <= high[k]) & (np.int32(k) <= last))
            out = sums[column + 1]
            for k in range(bins):
                out[k] = counts[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _sort_by_column(
    azimuth: Any, slope: Any, depth_m: Any, top: Any, cell_m: Any
) -> Any:  # pragma: no cover - compiled
    """Return the begin and end (columns,) of each column's beams, and slope and last range bin (B,) sorted by column.

    Beams that pass above all targets of their sector lie beyond the end.
    """
    # The column of each beam, and how many beams lie in the columns before.
    column, begin = np.empty(azimuth.shape[0], np.int16), np.zeros(AZIMUTH_COLUMNS + 1, np.int32)
    per_rad, most = np.float32(AZIMUTH_COLUMNS / (2 * np.pi)), np.float32(AZIMUTH_COLUMNS - 1)
    for n in range(azimuth.shape[0]):
        position = (azimuth[n] + np.float32(np.pi)) * per_rad
        column[n] = np.int32(min(max(position, np.float32(0.0)), most))
    for n in range(azimuth.shape[0]):
        begin[np.uint32(column[n]) + np.uint32(1)] += np.int32(1)
    for at in range(AZIMUTH_COLUMNS):
        begin[at + 1] += begin[at]
    # Each beam to the end of its column. One above all targets is written there, too, and then written over.
    end, highest = begin[:AZIMUTH_COLUMNS].copy(), np.array([row.max() for row in top])
    sorted_slope, last_bin = np.empty(azimuth.shape[0], np.float32), np.empty(azimuth.shape[0], np.int32)
    farthest = np.float32(top.shape[1] - 1)
    for n in range(azimuth.shape[0]):
        c, s = np.uint32(column[n]), slope[n]
        k = np.uint32(end[c])
        sorted_slope[k] = s
        last_bin[k] = np.int32(min(max(np.float32(-1.0), depth_m[n] / cell_m + np.float32(0.5)), farthest))
        end[c] = np.int32(k + np.uint32(s <= highest[c // np.uint32(_SECTOR_COLUMNS)]))
    return begin, end, sorted_slope, last_bin


@njit(cache=True, nogil=True, error_model="numpy")
def _count_aiming(azimuth: Any, slope: Any, foot: Any, top: Any) -> Any:  # pragma: no cover - compiled
    """Return the beams that aim at (sector, range bin) whatever their depth, summed over the sectors before."""
    # A histogram of slopes in each sector, summed over the slopes below.
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
    _smooth_around(histogram)
    # The beams between a target's foot and top are the difference of two sums.
    sums = np.zeros((sectors + 1, bins), np.float32)
    for sector in range(sectors):
        for k in range(bins):
            high = _cumulative(histogram[sector], (top[sector, k] + np.float32(_SLOPE_LIMIT)) * per_slope)
            low = _cumulative(histogram[sector], (foot[sector, k] + np.float32(_SLOPE_LIMIT)) * per_slope)
            sums[sector + 1, k] = sums[sector, k] + high - low
    return sums


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
    """Return a sum at a position between two of its bins, linearly."""
    at = min(max(at, np.float32(0.0)), np.float32(sums.shape[0] - 1.001))
    i = int(at)
    return sums[i] + (at - i) * (sums[i + 1] - sums[i])
