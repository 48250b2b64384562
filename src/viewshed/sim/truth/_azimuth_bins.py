"""Loops of the definitions of visible that go by azimuth bins."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed._numba import atan2

BLOCKS, RETURNS, OPEN = 1, 2, 4
"""What a beam met, as flags: a thing that is not the sensor's own vehicle; what sends light back; nothing."""

LANES = 32
"""Cells of a bin are seen by so many at a time."""

FARTHEST, BLOCKER, SIGHT, BETWEEN = 1, 2, 4, 8
"""What is told of a cell, as flags: the definitions that see it, and that a line passes over it."""

_PI = np.float32(np.pi)


@njit(cache=True, nogil=True, error_model="numpy")
def stop_flags(depth: Any, thing: Any, material: Any, vehicle: Any, reflectivity: Any) -> Any:  # pragma: no cover
    """Return the flags (C·R,) uint8 of the beams."""
    depths, things, materials = depth.reshape(-1), thing.reshape(-1), material.reshape(-1)
    out = np.empty(depths.size, np.uint8)
    for n in range(depths.size):
        blocks = BLOCKS if things[n] >= 0 and things[n] != vehicle else 0
        returns = RETURNS if reflectivity[materials[n]] > 0 else 0
        out[n] = blocks + returns if depths[n] < np.inf else OPEN
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def stop_limits(beams: Any, flags: Any, bins: Any) -> Any:  # pragma: no cover - compiled
    """Return for each azimuth bin (2, bins) the farthest return (-1 without one) and the nearest stop that blocks."""
    out = np.empty((2, bins), np.float32)
    out[0], out[1] = np.float32(-1.0), np.float32(np.inf)
    per_rad = np.float32(bins / (2 * np.pi))
    range_m, azimuth = np.empty(flags.size, np.float32), np.empty(flags.size, np.float32)
    for n in range(flags.size):
        bend, ux, uy, run = beams[0, n], beams[1, n], beams[2, n], beams[5, n]
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
def beams_of_bins(beams: Any, azimuth: Any, flags: Any, rings: Any, bins: Any) -> Any:  # pragma: no cover - compiled
    """Return (bins, R, 4) the farthest-reaching beam of each azimuth bin and ring: slope, rise, run to its stop, flags.

    A bin without a beam of the ring takes that of the bin before it.
    """
    table = np.empty((bins, rings, 4), np.float32)
    table[:, :, 2] = np.float32(-1.0)
    per_rad = np.float32(bins / (2 * np.pi))
    ring = 0
    for n in range(azimuth.size):
        b = min(max(int((azimuth[n] + _PI) * per_rad), 0), bins - 1)
        run = np.float32(np.inf) if flags[n] & OPEN else beams[5, n]
        if run > table[b, ring, 2]:
            table[b, ring, 0], table[b, ring, 1] = beams[4, n], beams[3, n]
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
def see_cells(limits: Any, table: Any, batches: Any, ground: Any, shape: Any, out: Any) -> None:  # pragma: no cover
    """Fill ``out`` (cells,) uint8 with FARTHEST, BLOCKER and SIGHT of the definitions that see a cell.

    Args:
        limits: from ``stop_limits``.
        table: from ``beams_of_bins``.
        batches: the cells of each bin by ascending range, LANES at a time, the last ones repeated: places (B, LANES),
            ranges (B, LANES), bins (B,).
        ground: of the cells, from the sensor's height.
        shape: height of the column above a cell, tolerance below ground, and the cell's side.
        out: as above.
    """
    (cells, ranges, bins), (high, below, cell) = batches, shape
    room, seen, first = np.empty((3, LANES), np.float32), np.empty(LANES, np.int32), 0
    for n in range(bins.shape[0]):
        b = bins[n]
        farthest, blocker = limits[0, b], limits[1, b]
        for k in range(LANES):
            room[0, k] = ground[cells[n, k]]
        low, top = _extremes(room)
        for k in range(LANES):
            r, height = ranges[n, k], room[0, k]
            room[0, k], room[1, k], room[2, k] = r, height - below, height + high
            near = FARTHEST | BLOCKER if r - cell <= blocker else FARTHEST
            seen[k] = near if r <= farthest else 0
        view = (b, ranges[n, 0], ranges[n, LANES - 1], cell)
        first = _first_above(table, view, low - below, first)
        if _meet_columns(table, view, (first, top + high), room, seen) < LANES:
            for k in range(LANES):
                if seen[k] < BETWEEN:
                    seen[k] |= _through_gap(table, b, first, (room[0, k], room[1, k], cell))
        for k in range(LANES):
            out[cells[n, k]] = seen[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _extremes(room: Any) -> Any:  # pragma: no cover - compiled
    """Return the least and the largest of the first row."""
    for k in range(LANES):
        room[1, k], room[2, k] = room[0, k], room[0, k]
    for half in (16, 8, 4, 2, 1):
        for k in range(half):
            room[1, k] = min(room[1, k], room[1, k + half])
            room[2, k] = max(room[2, k], room[2, k + half])
    return room[1, 0], room[2, 0]


@njit(cache=True, nogil=True, error_model="numpy")
def _first_above(table: Any, view: Any, foot: Any, ring: Any) -> Any:  # pragma: no cover - compiled
    """Return the first ring that is not below the feet of all columns between two ranges, found from a guess."""
    b, near, far, _ = view
    while ring > 0 and _highest(table, b, ring - 1, near, far) >= foot:
        ring -= 1
    while ring < table.shape[1] and _highest(table, b, ring, near, far) < foot:
        ring += 1
    return ring


@njit(cache=True, nogil=True, error_model="numpy")
def _highest(table: Any, b: Any, ring: Any, near: Any, far: Any) -> Any:  # pragma: no cover - compiled
    slope, rise = table[b, ring, 0], table[b, ring, 1]
    return max(rise + near * slope, rise + far * slope)


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_columns(table: Any, view: Any, rings: Any, room: Any, seen: Any) -> Any:  # pragma: no cover - compiled
    """Tell in ``met`` whether lines pass between foot and top of columns, and reach them; return how many have such."""
    (b, near, far, cell), (ring, top) = view, rings
    while ring < table.shape[1]:
        slope, rise, run = table[b, ring, 0], table[b, ring, 1], table[b, ring, 2]
        if min(rise + near * slope, rise + far * slope) > top:
            break
        for k in range(LANES):
            height = rise + room[0, k] * slope
            between = (height >= room[1, k]) & (height <= room[2, k])
            worth = np.int32(BETWEEN | SIGHT) if run >= room[0, k] - cell else np.int32(BETWEEN)
            seen[k] |= worth if between else np.int32(0)
        ring += 1
    some = 0
    for k in range(LANES):
        some += 1 if seen[k] >= BETWEEN else 0
    return some


@njit(cache=True, nogil=True, error_model="numpy")
def _through_gap(table: Any, b: Any, ring: Any, column: Any) -> Any:  # pragma: no cover - compiled
    """Return SIGHT where the rings above and below the foot of a column let see between them, or 0."""
    r, foot, cell = column
    rings = table.shape[1]
    while ring < rings and table[b, ring, 1] + r * table[b, ring, 0] < foot:
        ring += 1
    above = ring == rings or table[b, ring, 2] >= r - cell
    below = ring == 0 or int(table[b, ring - 1, 3]) & BLOCKS == 0 or table[b, ring - 1, 2] >= r - cell
    return SIGHT if above and below else 0


@njit(cache=True, nogil=True, error_model="numpy")
def definition_masks(seen: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Fill ``out`` (3, cells) bool with what ``see_cells`` found of each definition."""
    for n in range(seen.shape[0]):
        out[0, n], out[1, n], out[2, n] = seen[n] & FARTHEST != 0, seen[n] & BLOCKER != 0, seen[n] & SIGHT != 0
