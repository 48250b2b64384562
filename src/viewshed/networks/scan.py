"""What one pass over the returns of a sweep tells: of each cell its lowest and highest ones, and of each azimuth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.bev import BevGrid
from viewshed.blocks import BLOCK, split
from viewshed.level import OBSTACLE_HEIGHTS_M, LevelSweep
from viewshed.polar import BINS_LADDER, bins_filled, farthest_in_bins, nearest_obstacle_in_bins

HEIGHTS_M = (-2.0, 4.0)
"""Heights above local ground that ``lowest`` and ``highest`` tell apart."""
EVIDENCE_BINS = 360
"""Azimuth bins in which returns are counted."""
_BINS = BINS_LADDER[0]
_FOLDED = (1080, 540, 360, 180, 120)
"""Bins that are the same whether told from an azimuth or from the narrowest bins; the edges of others are rounded."""
Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """What the returns of a level sweep tell.

    Attributes:
        lowest: (cells, cells) code of the lowest return of each cell: 0 for none, 1 to 255 upwards.
        highest: (cells, cells) code of the highest one.
        obstacle: (cells, cells) bool, as :meth:`viewshed.level.LevelSweep.obstacle_cells`.
        returns: (EVIDENCE_BINS,) returns of each azimuth bin.
        bins: azimuth bins that the returns fill, as :func:`viewshed.polar.measured_azimuth_bins`.
        blocker_m: (bins,) range in metres of the nearest obstacle of each azimuth bin; inf where none.
        farthest_m: (bins,) range in metres of the farthest return of each azimuth bin; -1 where none.
    """

    lowest: Bytes
    highest: Bytes
    obstacle: NDArray[np.bool_]
    returns: NDArray[np.int32]
    bins: int
    blocker_m: Floats
    farthest_m: Floats


def scan(level: LevelSweep, grid: BevGrid) -> Scan:
    """Return what the returns of ``level`` tell of the cells of ``grid`` and of their azimuths."""
    lattice = np.array([*grid.origin_m, 1.0 / grid.cell_m, grid.cells], np.float32)
    heights = np.array([*HEIGHTS_M, *OBSTACLE_HEIGHTS_M], np.float32)
    columns = level.points, level.range_m, level.azimuth, level.height_m
    cells, obstacle, returns, ranges_m = _scan(columns, lattice, heights)
    bins = bins_filled(returns > 0)
    if bins in _FOLDED:
        shape = bins, _BINS // bins
        blocker_m, farthest_m = ranges_m[0].reshape(shape).min(axis=1), ranges_m[1].reshape(shape).max(axis=1)
    else:
        blocker_m = nearest_obstacle_in_bins(level, bins, 1, OBSTACLE_HEIGHTS_M)
        farthest_m = farthest_in_bins(level, bins)
    lowest, highest = cells[0, :-1].reshape(grid.shape), cells[1, :-1].reshape(grid.shape)
    counts = returns.reshape(EVIDENCE_BINS, -1).sum(axis=1, dtype=np.int32)
    return Scan(lowest, highest, obstacle[:-1].reshape(grid.shape), counts, bins, blocker_m, farthest_m)


@njit(cache=True, nogil=True, error_model="numpy")
def _scan(columns: Any, lattice: Any, heights: Any) -> Any:  # pragma: no cover - compiled
    """Return codes of the lowest and highest return, obstacles, returns and ranges; the last cell is outside."""
    points, range_m, azimuth, height_m = columns
    last = np.uint32(lattice[3]) ** 2
    cells, obstacle = np.zeros((2, last + 1), np.uint8), np.zeros(last + 1, np.bool_)
    lowest, highest = cells[0], cells[1]
    returns, ranges_m = np.zeros(_BINS, np.int32), np.full((2, _BINS), np.inf, np.float32)
    nearest_m, farthest_m = ranges_m[0], ranges_m[1]
    farthest_m[:] = -1.0
    x, y, z = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    cell, bearing, code = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.int32), np.empty(BLOCK, np.uint8)
    for start in range(0, points.shape[0], BLOCK):
        count = split(points, start, x, y, z)
        block = slice(start, start + count)
        ranges, highs = range_m[block], height_m[block]
        _cells(x[:count], y[:count], lattice, cell)
        _codes(azimuth[block], highs, heights, bearing, code)
        for k in range(count):
            c, b = np.uint32(cell[k]), np.uint32(bearing[k])
            highest[c] = max(highest[c], code[k])
            lowest[c] = max(lowest[c], np.uint8(-code[k]))  # 256 less the code, so that 0 is none here as well
            returns[b] += 1
            farthest_m[b] = max(farthest_m[b], ranges[k])
            if heights[2] < highs[k] < heights[3]:
                obstacle[c] = True
                nearest_m[b] = min(nearest_m[b], ranges[k])
    for k in range(last):
        lowest[k] = np.uint8(-lowest[k])
    return cells, obstacle, returns, ranges_m


@njit(cache=True, nogil=True, error_model="numpy")
def _cells(x: Any, y: Any, lattice: Any, cell: Any) -> None:  # pragma: no cover - compiled
    """Write the cell of each point of a block, cells · cells outside."""
    x0, y0, per_m, side = lattice
    none = np.float32(0.0)
    for k in range(x.shape[0]):
        u, v = (x[k] - x0) * per_m, (y[k] - y0) * per_m
        inside = (u >= none) & (v >= none) & (u < side) & (v < side)
        i, j = np.int32(u if inside else side), np.int32(v if inside else none)
        cell[k] = i * np.int32(side) + j


@njit(cache=True, nogil=True, error_model="numpy")
def _codes(azimuth: Any, height_m: Any, heights: Any, bearing: Any, code: Any) -> None:  # pragma: no cover - compiled
    """Write the azimuth bin of each point of a block, and the code of its height."""
    bottom, top = heights[0], heights[1]
    scale = np.float32(254.0) / (top - bottom)
    for k in range(azimuth.shape[0]):
        position = (np.float64(azimuth[k]) + np.pi) * (_BINS / (2.0 * np.pi))
        bearing[k] = min(max(np.int32(position), np.int32(0)), np.int32(_BINS - 1))
    for k in range(azimuth.shape[0]):
        code[k] = 1 + np.int32(min(max(height_m[k] - bottom, np.float32(0.0)), top - bottom) * scale)
