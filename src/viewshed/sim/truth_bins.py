"""Loops of the definitions of visible that go by azimuth bins."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.angles import atan2

BLOCKS, RETURNS, OPEN = 1, 2, 4
"""What a beam met, as flags: a thing that is not the sensor's own vehicle; what sends light back; nothing."""
_PI = np.float32(np.pi)


@njit(cache=True, nogil=True, error_model="numpy")
def what_stopped(depth: Any, thing: Any, material: Any, own: Any, reflectivity: Any) -> Any:  # pragma: no cover
    """Return the flags (C·R,) uint8 of the beams."""
    depths, things, materials = depth.reshape(-1), thing.reshape(-1), material.reshape(-1)
    out = np.empty(depths.size, np.uint8)
    for n in range(depths.size):
        blocks = BLOCKS if things[n] >= 0 and things[n] != own else 0
        returns = RETURNS if reflectivity[materials[n]] > 0 else 0
        out[n] = blocks + returns if depths[n] < np.inf else OPEN
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def stop_limits(beams: Any, flags: Any, bins: Any) -> Any:  # pragma: no cover - compiled
    """Return for each azimuth bin (2, bins) the farthest return (-1 without one) and the nearest stop that blocks."""
    out = np.empty((2, bins), np.float32)
    out[0], out[1] = np.float32(-1.0), np.float32(np.inf)
    per_rad = np.float32(bins / (2 * np.pi))
    for n in range(flags.size):
        if flags[n] & (BLOCKS | RETURNS):
            bend, ux, uy, run = beams[0, n], beams[1, n], beams[2, n], beams[5, n]
            x, y = ux * run - bend * uy, uy * run + bend * ux
            range_m = np.sqrt(x * x + y * y)
            b = min(max(int((atan2(y, x) + _PI) * per_rad), 0), bins - 1)
            if flags[n] & RETURNS:
                out[0, b] = max(out[0, b], range_m)
            if flags[n] & BLOCKS:
                out[1, b] = min(out[1, b], range_m)
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
def see_cells(limits: Any, table: Any, cells: Any, shape: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Fill ``out`` (3, cells) bool with farthest, first_blocker and line_of_sight.

    ``cells`` is as in ``count_cells``; ``shape`` is height of the column above a cell, tolerance below ground, and the
    cell's side.
    """
    high, below, cell = shape
    bins = limits.shape[1]
    per_rad = np.float32(bins / (2 * np.pi))
    ring = 0
    for n in range(cells.shape[1]):
        r, ground = cells[2, n], cells[4, n]
        b = min(max(int((cells[3, n] + _PI) * per_rad), 0), bins - 1)
        out[0, n] = r <= limits[0, b]
        out[1, n] = out[0, n] and r - cell <= limits[1, b]
        ring, out[2, n] = _seen(table[b], ring, (r, ground - below, ground + high, cell))


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _seen(lines: Any, ring: Any, column: Any) -> Any:  # pragma: no cover - compiled
    """Return the first ring above the foot of a column, found from a guess, and whether a line reaches the column."""
    r, foot, top, cell = column
    rings = lines.shape[0]
    while ring > 0 and lines[ring - 1, 1] + r * lines[ring - 1, 0] >= foot:
        ring -= 1
    while ring < rings and lines[ring, 1] + r * lines[ring, 0] < foot:
        ring += 1
    k, between, reached = ring, False, False
    while not reached and k < rings and lines[k, 1] + r * lines[k, 0] <= top:
        between, reached = True, lines[k, 2] >= r - cell
        k += 1
    if not between:
        above = ring == rings or lines[ring, 2] >= r - cell
        reached = above and (ring == 0 or int(lines[ring - 1, 3]) & BLOCKS == 0 or lines[ring - 1, 2] >= r - cell)
    return ring, reached
