"""Compiled loops of :mod:`viewshed.visible`: how many beams reach each range, summed over azimuth columns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

AZIMUTH_COLUMNS = 2048
"""Columns in which beams are counted; windows are interpolated within a column."""
GROUND_SECTORS = 128
"""Sectors of azimuth in which the local ground is looked up."""
_COLUMNS_A_SECTOR = AZIMUTH_COLUMNS // GROUND_SECTORS
_STEP = 16


@njit(cache=True, nogil=True, error_model="numpy")
def reached(beams: Any, bottom: Any, top: Any, cell_m: Any, counts: Any) -> None:  # pragma: no cover - compiled
    """Write the beams that reach (column, range bin), summed over the columns before, into (columns + 1, bins).

    Beams are sorted by column first: then a column's sums stay in the nearest memory while its beams are counted, and
    each is written once. They are whole numbers, so that the order of the beams does not matter.
    """
    sectors, bins = top.shape
    begin, end, slope, last = _by_column(beams, top, cell_m)
    sums = np.zeros((bins + _STEP - 1) // _STEP * _STEP, np.int32)
    low, high = np.full(sums.shape[0], np.float32(np.inf)), np.full(sums.shape[0], np.float32(-np.inf))
    counts[0] = 0.0
    for sector in range(sectors):
        low[:bins], high[:bins] = bottom[sector], top[sector]
        for column in range(sector * _COLUMNS_A_SECTOR, (sector + 1) * _COLUMNS_A_SECTOR):
            for n in range(np.uint32(begin[column]), np.uint32(end[column])):
                s, stop = slope[n], last[n]
                whole = np.uint32(stop + _STEP) // np.uint32(_STEP) * np.uint32(_STEP)
                for k in range(whole):  # whole vectors: the bins beyond ``stop`` are masked
                    sums[k] += np.int32((s >= low[k]) & (s <= high[k]) & (np.int32(k) <= stop))
            out = counts[column + 1]
            for k in range(bins):
                out[k] = sums[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _by_column(beams: Any, top: Any, cell_m: Any) -> Any:  # pragma: no cover - compiled
    """Return where the beams of each column begin and end, and slope and last range bin of beams sorted by column.

    Beams that pass above all targets of their sector lie beyond the end.
    """
    azimuth, slope, depth = beams
    column, begin = np.empty(azimuth.shape[0], np.int16), np.zeros(AZIMUTH_COLUMNS + 1, np.int32)
    per_rad, most = np.float32(AZIMUTH_COLUMNS / (2 * np.pi)), np.float32(AZIMUTH_COLUMNS - 1)
    for n in range(azimuth.shape[0]):
        position = (azimuth[n] + np.float32(np.pi)) * per_rad
        column[n] = np.int32(min(max(position, np.float32(0.0)), most))
    for n in range(azimuth.shape[0]):
        begin[np.uint32(column[n]) + np.uint32(1)] += np.int32(1)
    for at in range(AZIMUTH_COLUMNS):
        begin[at + 1] += begin[at]
    end, highest = begin[:AZIMUTH_COLUMNS].copy(), np.array([row.max() for row in top])
    sorted_slope, last = np.empty(azimuth.shape[0], np.float32), np.empty(azimuth.shape[0], np.int32)
    farthest = np.float32(top.shape[1] - 1)
    for n in range(azimuth.shape[0]):
        c, s = np.uint32(column[n]), slope[n]
        k = np.uint32(end[c])
        sorted_slope[k] = s
        last[k] = np.int32(min(max(np.float32(-1.0), depth[n] / cell_m + np.float32(0.5)), farthest))
        end[c] = np.int32(k + np.uint32(s <= highest[c // np.uint32(_COLUMNS_A_SECTOR)]))
    return begin, end, sorted_slope, last
