"""Definitions of visibility by azimuth bin: farthest return, first blocker, line of sight.

The sensor's azimuth is divided into as many bins as it has columns (1080 at most). A cell is visible by

- ``farthest`` if its center is no farther than the farthest return of its bin; glass and absorbers give no return;
- ``first_blocker`` if that holds and its center is less than one cell beyond the nearest hit on a thing in its bin,
  at any height; the own vehicle does not block;
- ``line_of_sight`` if a beam of its bin, aimed between the ground and 1.5 m above the center, reaches it, less one
  cell. If no ring aims there, the ring above must reach it (or not exist), and the ring below must reach it or have
  ended on the ground. Range does not limit it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.grid import BevGrid, polar_of_cells
from viewshed_lab._numba import atan2
from viewshed_lab.sim.truth.beam_lines import ALONG_X, ALONG_Y, BEND, RISE, SLOPE, STOP
from viewshed_lab.sim.truth.count import ranges_of

BLOCKS, RETURNS, OPEN = 1, 2, 4
"""Flags of a beam: it hit a thing other than the own vehicle; it hit something that returns light; it hit nothing."""

LANES = 32
"""Number of cells of a bin that are processed together."""

FARTHEST, BLOCKER, SIGHT, BETWEEN = 1, 2, 4, 8
"""Flags of a cell: visible by each definition; a beam crosses the column above it."""

_PI = np.float32(np.pi)


class Batches(NamedTuple):
    """Cells of each azimuth bin by ascending range, in batches of LANES; the last cell of a bin is repeated."""

    cells: NDArray[np.int32]  # (B, LANES) int32
    ranges: NDArray[np.float32]  # (B, LANES) float32 of their centers
    bins: NDArray[np.int32]  # (B,) int32


@lru_cache(maxsize=2)
def batches_of(grid: BevGrid, bins: int) -> Batches:
    """Return the cells of each azimuth bin."""
    azimuth = polar_of_cells(grid)[1].reshape(-1)
    own = ((azimuth + np.float32(np.pi)) * np.float32(bins / (2 * np.pi))).astype(np.int64).clip(0, bins - 1)
    order = np.lexsort((ranges_of(grid), own))
    starts = np.flatnonzero(np.diff(own[order], prepend=-1))
    counts = np.diff(starts, append=len(order))
    batches = -(-counts // LANES)
    first = np.repeat(np.cumsum(batches) - batches, batches)
    step = (np.arange(len(first)) - first)[:, None] * LANES + np.arange(LANES)
    rows = np.repeat(starts, batches)[:, None] + np.minimum(step, np.repeat(counts, batches)[:, None] - 1)
    cells = order[rows].astype(np.int32)
    return Batches(cells, ranges_of(grid)[cells], own[cells[:, 0]].astype(np.int32))


@njit(cache=True, nogil=True, error_model="numpy")
def stop_flags(depth: Any, thing: Any, material: Any, vehicle: Any, reflectivity: Any) -> Any:
    """Return the flags (C·R,) uint8 of beams from depth, thing and material (C, R); ``vehicle`` is the carrier."""
    depths, things, materials = depth.reshape(-1), thing.reshape(-1), material.reshape(-1)
    out = np.empty(depths.size, np.uint8)
    for n in range(depths.size):
        blocks = BLOCKS if things[n] >= 0 and things[n] != vehicle else 0
        returns = RETURNS if reflectivity[materials[n]] > 0 else 0
        out[n] = blocks + returns if depths[n] < np.inf else OPEN
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def stop_limits(beams: Any, flags: Any, bins: Any) -> Any:
    """Return the farthest return (-1 without one) and the nearest blocking hit of each azimuth bin (2, bins).

    ``beams`` are lines (6, C·R), see :mod:`viewshed_lab.sim.truth.beam_lines`; ``flags`` (C·R,). A hit belongs to the
    bin of its own azimuth, not of its beam's.
    """
    out = np.empty((2, bins), np.float32)
    out[0], out[1] = np.float32(-1.0), np.float32(np.inf)
    per_rad = np.float32(bins / (2 * np.pi))
    range_m, azimuth = np.empty(flags.size, np.float32), np.empty(flags.size, np.float32)
    for n in range(flags.size):
        bend, ux, uy, run = beams[BEND, n], beams[ALONG_X, n], beams[ALONG_Y, n], beams[STOP, n]
        x, y = ux * run - bend * uy, uy * run + bend * ux
        range_m[n], azimuth[n] = np.sqrt(x * x + y * y), atan2(y, x)
    for n in range(flags.size):
        b = min(max(int((azimuth[n] + _PI) * per_rad), 0), bins - 1)
        if flags[n] & RETURNS:
            out[0, b] = max(out[0, b], range_m[n])
        if flags[n] & BLOCKS:
            out[1, b] = min(out[1, b], range_m[n])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def beams_of_bins(beams: Any, azimuth: Any, flags: Any, rings: Any, bins: Any) -> Any:
    """Return the farthest-reaching beam of each azimuth bin and ring (bins, R, 4): slope, rise, run to its hit, flags.

    A bin without a beam of a ring takes that of the previous bin.
    """
    table = np.empty((bins, rings, 4), np.float32)
    table[:, :, 2] = np.float32(-1.0)
    per_rad = np.float32(bins / (2 * np.pi))
    ring = 0
    for n in range(azimuth.size):
        b = min(max(int((azimuth[n] + _PI) * per_rad), 0), bins - 1)
        run = np.float32(np.inf) if flags[n] & OPEN else beams[STOP, n]
        if run > table[b, ring, 2]:
            table[b, ring, 0], table[b, ring, 1] = beams[SLOPE, n], beams[RISE, n]
            table[b, ring, 2], table[b, ring, 3] = run, np.float32(flags[n])
        ring = ring + 1 if ring < rings - 1 else 0
    for step in range(1, 2 * bins):
        b = step % bins
        for other in range(rings):
            if table[b, other, 2] < 0:
                for k in range(4):
                    table[b, other, k] = table[b - 1, other, k]
    return table


@njit(cache=True, nogil=True, error_model="numpy")
def see_cells(limits: Any, table: Any, batches: Any, ground: Any, high: Any, below: Any, cell: Any, out: Any) -> None:
    """Fill ``out`` (cells²,) uint8 with the flags FARTHEST, BLOCKER and SIGHT.

    Args:
        limits: (2, bins) from :func:`stop_limits`.
        table: (bins, R, 4) from :func:`beams_of_bins`.
        batches: :class:`Batches`.
        ground: (cells²,) z from the sensor's height.
        high: height of the column above a cell.
        below: depth below the ground at which the column begins.
        cell: side of a cell.
        out: as above.
    """
    columns, seen, first = np.empty((3, LANES), np.float32), np.empty(LANES, np.int32), 0
    for n in range(batches.bins.shape[0]):
        b, ranges = batches.bins[n], batches.ranges[n]
        farthest, blocker = limits[0, b], limits[1, b]
        for k in range(LANES):
            columns[0, k] = ground[batches.cells[n, k]]
        low, top = _extremes(columns)
        # The two definitions that compare ranges, and range, bottom and top of each cell's column.
        for k in range(LANES):
            r, height = ranges[k], columns[0, k]
            columns[0, k], columns[1, k], columns[2, k] = r, height - below, height + high
            near = FARTHEST | BLOCKER if r - cell <= blocker else FARTHEST
            seen[k] = near if r <= farthest else 0
        # Line of sight: a beam of the bin crosses the column, or the cell is visible through the gap between two rings.
        near_m, far_m = ranges[0], ranges[LANES - 1]
        first = _first_above(table, b, near_m, far_m, low - below, first)
        if _meet_columns(table, b, near_m, far_m, cell, first, top + high, columns, seen) < LANES:
            for k in range(LANES):
                if seen[k] < BETWEEN:
                    seen[k] |= _through_gap(table, b, first, columns[0, k], columns[1, k], cell)
        for k in range(LANES):
            out[batches.cells[n, k]] = seen[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _extremes(columns: Any) -> Any:
    """Return minimum and maximum of the first row (3, LANES), by halving, which is vectorized."""
    for k in range(LANES):
        columns[1, k], columns[2, k] = columns[0, k], columns[0, k]
    for half in (16, 8, 4, 2, 1):
        for k in range(half):
            columns[1, k] = min(columns[1, k], columns[1, k + half])
            columns[2, k] = max(columns[2, k], columns[2, k + half])
    return columns[1, 0], columns[2, 0]


@njit(cache=True, nogil=True, error_model="numpy")
def _first_above(table: Any, b: Any, near: Any, far: Any, bottom: Any, ring: Any) -> Any:
    """Return the first ring not below the bottoms of all columns between two ranges; the search starts at ``ring``."""
    while ring > 0 and _highest(table, b, ring - 1, near, far) >= bottom:
        ring -= 1
    while ring < table.shape[1] and _highest(table, b, ring, near, far) < bottom:
        ring += 1
    return ring


@njit(cache=True, nogil=True, error_model="numpy")
def _highest(table: Any, b: Any, ring: Any, near: Any, far: Any) -> Any:
    """Return the larger height of a ring's beam at two ranges."""
    slope, rise = table[b, ring, 0], table[b, ring, 1]
    return max(rise + near * slope, rise + far * slope)


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_columns(
    table: Any, b: Any, near: Any, far: Any, cell: Any, ring: Any, top: Any, columns: Any, seen: Any
) -> Any:
    """Flag in ``seen`` the columns that beams cross (BETWEEN) and reach (SIGHT); return the number of crossed ones.

    ``columns`` (3, LANES) is range, bottom and top of the columns; rings from ``ring`` on, up to one above ``top``.
    """
    while ring < table.shape[1]:
        slope, rise, run = table[b, ring, 0], table[b, ring, 1], table[b, ring, 2]
        if min(rise + near * slope, rise + far * slope) > top:
            break
        for k in range(LANES):
            height = rise + columns[0, k] * slope
            between = (height >= columns[1, k]) & (height <= columns[2, k])
            flag = np.int32(BETWEEN | SIGHT) if run >= columns[0, k] - cell else np.int32(BETWEEN)
            seen[k] |= flag if between else np.int32(0)
        ring += 1
    crossed = 0
    for k in range(LANES):
        crossed += 1 if seen[k] >= BETWEEN else 0
    return crossed


@njit(cache=True, nogil=True, error_model="numpy")
def _through_gap(table: Any, b: Any, ring: Any, r: Any, bottom: Any, cell: Any) -> Any:
    """Return SIGHT if the column is visible through the gap between the rings above and below its bottom, else 0."""
    rings = table.shape[1]
    while ring < rings and table[b, ring, 1] + r * table[b, ring, 0] < bottom:
        ring += 1
    above = ring == rings or table[b, ring, 2] >= r - cell
    below = ring == 0 or int(table[b, ring - 1, 3]) & BLOCKS == 0 or table[b, ring - 1, 2] >= r - cell
    return SIGHT if above and below else 0
