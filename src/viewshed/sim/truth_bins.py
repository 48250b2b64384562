"""Loops of the definitions of visible that go by azimuth bins."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.angles import atan2

GROUND_STOP, OTHER_STOP, NO_STOP = 0, 1, 2
"""What a beam of a bin met."""
_PI = np.float32(np.pi)


@njit(cache=True, nogil=True, error_model="numpy")
def stop_limits(stops: Any, returns: Any, blocks: Any, bins: Any) -> Any:  # pragma: no cover - compiled
    """Return for each azimuth bin (2, bins) the farthest return (-1 without one) and the nearest stop that blocks.

    ``stops`` is (2, C·R) x and y of the stops from the sensor; ``returns`` and ``blocks`` say which ones count.
    """
    out = np.empty((2, bins), np.float32)
    out[0], out[1] = np.float32(-1.0), np.float32(np.inf)
    per_rad = np.float32(bins / (2 * np.pi))
    for n in range(stops.shape[1]):
        if returns[n] or blocks[n]:
            x, y = stops[0, n], stops[1, n]
            range_m = np.sqrt(x * x + y * y)
            b = min(max(int((atan2(y, x) + _PI) * per_rad), 0), bins - 1)
            if returns[n]:
                out[0, b] = max(out[0, b], range_m)
            if blocks[n]:
                out[1, b] = min(out[1, b], range_m)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def beams_of_bins(beams: Any, azimuth: Any, kind: Any, rings: Any, bins: Any) -> Any:  # pragma: no cover - compiled
    """Return the farthest-reaching beam of each azimuth bin and ring: slope, rise, run to its stop (bins, R), kind.

    A bin without a beam of the ring takes the one before it.
    """
    table = np.empty((3, bins, rings), np.float32)
    table[2] = np.float32(-1.0)
    kinds = np.full((bins, rings), GROUND_STOP, np.uint8)
    per_rad = np.float32(bins / (2 * np.pi))
    for n in range(azimuth.size):
        b, ring = min(max(int((azimuth[n] + _PI) * per_rad), 0), bins - 1), n % rings
        run = np.float32(np.inf) if kind[n] == NO_STOP else beams[5, n]
        if run > table[2, b, ring]:
            table[0, b, ring], table[1, b, ring], table[2, b, ring] = beams[4, n], beams[3, n], run
            kinds[b, ring] = kind[n]
    for step in range(1, 2 * bins):
        b = step % bins
        for ring in range(rings):
            if table[2, b, ring] < 0:
                for row in range(3):
                    table[row, b, ring] = table[row, b - 1, ring]
                kinds[b, ring] = kinds[b - 1, ring]
    return table, kinds


@njit(cache=True, nogil=True, error_model="numpy")
def see_cells(
    limits: Any, table: Any, kinds: Any, cells: Any, shape: Any, out: Any
) -> None:  # pragma: no cover - compiled
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
        out[1, n] = r - cell <= limits[1, b] and out[0, n]
        ring, seen = _seen(table, kinds, (b, ring), (r, ground - below, ground + high, cell))
        out[2, n] = seen


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _seen(table: Any, kinds: Any, at: Any, column: Any) -> Any:  # pragma: no cover - compiled
    """Return the first ring above the foot of a column, found from a guess, and whether a line reaches the column."""
    b, ring = at
    r, foot, top, cell = column
    rings = table.shape[2]
    while ring > 0 and table[1, b, ring - 1] + r * table[0, b, ring - 1] >= foot:
        ring -= 1
    while ring < rings and table[1, b, ring] + r * table[0, b, ring] < foot:
        ring += 1
    k, between = ring, False
    while k < rings and table[1, b, k] + r * table[0, b, k] <= top:
        between = True
        if table[2, b, k] >= r - cell:
            return ring, True
        k += 1
    if between:
        return ring, False
    above = ring == rings or table[2, b, ring] >= r - cell
    under = ring == 0 or kinds[b, ring - 1] != OTHER_STOP or table[2, b, ring - 1] >= r - cell
    return ring, above and under
