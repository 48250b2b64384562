"""Blocks of points by columns: compiled loops use vectors only on contiguous numbers, and short ones stay at hand."""

from __future__ import annotations

from typing import Any

from numba import njit

BLOCK = 1024
"""Points of a block."""


@njit(cache=True, nogil=True, error_model="numpy")
def split(points: Any, start: int, x: Any, y: Any, z: Any) -> Any:  # pragma: no cover - compiled
    """Write the coordinates of the block of ``points`` (N, 3) from ``start`` on, and return how many it has."""
    count = min(BLOCK, points.shape[0] - start)
    for k in range(count):
        x[k], y[k], z[k] = points[start + k, 0], points[start + k, 1], points[start + k, 2]
    return count
