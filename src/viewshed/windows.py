"""Sums over the azimuths that a target in each cell spans, by tables made once for a grid and a width."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.bev import BevGrid, polar_of_cells


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Where in sums (columns + 1, bins) over azimuth columns the window of each of N cells begins and ends.

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

    def sums(self, sums: NDArray[np.float32], found: NDArray[np.float32], least: float = -np.inf) -> None:
        """Write the sum over each cell's window, interpolated within columns.

        Args:
            sums: (columns + 1, bins) sums over the columns before.
            found: (cells, cells) where to write, contiguous.
            least: sums below this become it.
        """
        shape = np.uint32(self.bins), np.uint32(self.columns)
        ends = self.ends, self.parts, self.seam, self.turns
        _sum(sums.reshape(-1), shape, ends, np.float32(least), found.reshape(-1))


@lru_cache(maxsize=16)
def range_bins(grid: BevGrid) -> int:
    """Return how many range bins of a cell's length reach the farthest cell of a grid."""
    return int(np.ceil(float(polar_of_cells(grid)[0].max()) / grid.cell_m)) + 1


@lru_cache(maxsize=16)
def windows_of(grid: BevGrid, width_m: float, columns: int) -> Windows:
    """Return the windows of a target so wide that it turns its width to the sensor, in each cell of a grid."""
    range_m, azimuth = (each.reshape(-1) for each in polar_of_cells(grid))
    bins = range_bins(grid)
    middle_m = (np.arange(bins) + 0.5) * grid.cell_m
    half = np.arctan2(width_m / 2, middle_m) * (columns / (2 * np.pi))
    bin_of = np.minimum(range_m / np.float32(grid.cell_m), np.float32(bins - 1)).astype(np.int32)
    at = (azimuth.astype(np.float64) + np.pi) * (columns / (2 * np.pi))
    edges = np.stack([at - half[bin_of], at + half[bin_of]])
    turn = np.floor(edges / columns)
    edges -= turn * columns
    column = np.minimum(edges.astype(np.int32), columns - 1)
    parts = (edges - column).astype(np.float32)
    turns = (turn[1] - turn[0]).astype(np.float32)
    seam = np.flatnonzero(turns).astype(np.int32)
    found = Windows(columns, bins, column * np.int32(bins) + bin_of, parts, seam, turns[seam])
    for array in (found.ends, found.parts, found.seam, found.turns):
        array.setflags(write=False)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _sum(flat: Any, shape: Any, windows: Any, least: Any, found: Any) -> None:  # pragma: no cover - compiled
    """Unsigned indices, since signed ones may count from the end, which takes as long again."""
    bins, columns = shape
    ends, parts, cells, turns = windows
    begins, stops, begin_parts, stop_parts = ends[0], ends[1], parts[0], parts[1]
    for n in range(found.shape[0]):
        begin = _sum_before(flat, bins, np.uint32(begins[n]), begin_parts[n])
        found[n] = max(_sum_before(flat, bins, np.uint32(stops[n]), stop_parts[n]) - begin, least)
    for k in range(cells.shape[0]):
        n, b = cells[k], np.uint32(begins[cells[k]])
        begin = _sum_before(flat, bins, b, begin_parts[n])
        between = _sum_before(flat, bins, np.uint32(stops[n]), stop_parts[n]) - begin
        found[n] = max(between + turns[k] * flat[columns * bins + b % bins], least)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _sum_before(flat: Any, bins: Any, at: Any, part: Any) -> Any:  # pragma: no cover - compiled
    return flat[at] + part * (flat[at + bins] - flat[at])
