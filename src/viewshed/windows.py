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
        turns: (N,) float32 how often the window passes the seam.
    """

    columns: int
    bins: int
    ends: NDArray[np.int32]
    parts: NDArray[np.float32]
    turns: NDArray[np.float32]

    def sums(self, sums: NDArray[np.float32], grid: BevGrid) -> NDArray[np.float32]:
        """Return the sum (cells, cells) over each cell's window, interpolated within columns.

        Args:
            sums: (columns + 1, bins) sums over the columns before.
            grid: that the windows were made for.
        """
        found = np.empty(grid.shape, np.float32)
        _sum(sums.reshape(-1), (self.bins, self.columns), self.ends, self.parts, self.turns, found.reshape(-1))
        return found


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
    found = Windows(columns, bins, column * np.int32(bins) + bin_of, parts, turns)
    for array in (found.ends, found.parts, found.turns):
        array.setflags(write=False)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _sum(flat: Any, shape: Any, ends: Any, parts: Any, turns: Any, found: Any) -> None:  # pragma: no cover - compiled
    bins, columns = shape
    for n in range(found.shape[0]):
        a, b = ends[0, n], ends[1, n]
        begin = flat[a] + parts[0, n] * (flat[a + bins] - flat[a])
        end = flat[b] + parts[1, n] * (flat[b + bins] - flat[b])
        found[n] = end - begin
    for n in range(found.shape[0]):
        if turns[n] != np.float32(0.0):
            found[n] += turns[n] * flat[columns * bins + ends[0, n] % bins]
