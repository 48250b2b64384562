"""Compiled loops of :mod:`viewshed.attacks.lattice`: pixels, empty beams, neighbors in a sweep's order, rays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def pixel_rows(ring: Any, column: Any, rings: int, columns: int) -> Any:  # pragma: no cover - compiled
    """Return the first row of each pixel (rings, columns) int32, -1 where there is none, and which hold several."""
    rows = np.full((rings, columns), -1, np.int32)
    several = np.zeros((rings, columns), np.bool_)
    for n in range(ring.shape[0]):
        r, c = ring[n], column[n]
        if r < 0:
            continue
        if rows[r, c] < 0:
            rows[r, c] = n
        else:
            several[r, c] = True
    return rows, several


@njit(cache=True, nogil=True, error_model="numpy")
def empty_pixels(rows: Any, several: Any, jitter: int, all_rings: bool) -> Any:  # pragma: no cover - compiled
    """Return which pixels (rings, columns) are beams without a return.

    Columns without any return were not fired, rings without any may not exist (``all_rings`` says that they do), and
    next to a pixel with several returns, within ``jitter`` columns, the azimuth only jittered.
    """
    rings, columns = rows.shape
    fired = np.zeros(columns, np.bool_)
    for r in range(rings):
        for c in range(columns):
            fired[c] |= rows[r, c] >= 0
    empty = np.zeros((rings, columns), np.bool_)
    for r in range(rings):
        if all_rings or rows[r].max() >= 0:
            empty[r] = fired & (rows[r] < 0)
            _clear_around(several[r], jitter, empty[r])
    return empty


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _clear_around(several: Any, jitter: int, empty: Any) -> None:  # pragma: no cover - compiled
    columns = empty.shape[0]
    for c in range(columns):
        if several[c]:
            for offset in range(-jitter, jitter + 1):
                empty[(c + offset) % columns] = False


@njit(cache=True, nogil=True, error_model="numpy")
def neighbors(rows: Any, ring: Any, column: Any, by_column: bool) -> Any:  # pragma: no cover - compiled
    """Return for each pixel (K,) the row of the nearest return and how many pixels it lies before the pixel.

    Nearest in the column, or in the ring where the sweep is stored ring by ring; else in the next columns or rings.
    The row is -1 where there is no return at all.
    """
    found, ahead = np.full(ring.shape[0], -1, np.int64), np.zeros(ring.shape[0], np.int64)
    for k in range(ring.shape[0]):
        if by_column:
            found[k], ahead[k] = _by_columns(rows, ring[k], column[k])
        else:
            found[k], ahead[k] = _by_rings(rows, ring[k], column[k])
    return found, ahead


@njit(cache=True, nogil=True, error_model="numpy")
def _by_columns(rows: Any, r: Any, c: Any) -> Any:  # pragma: no cover - compiled
    rings, columns = rows.shape
    for away in range(columns):
        found, ahead = _in_column(rows, r, (c - away) % columns)
        if found >= 0:
            return found, ahead + away * rings
    return -1, 0


@njit(cache=True, nogil=True, error_model="numpy")
def _by_rings(rows: Any, r: Any, c: Any) -> Any:  # pragma: no cover - compiled
    rings, columns = rows.shape
    for away in range(rings):
        for side in (r - away, r + away):
            if 0 <= side < rings:
                found, ahead = _in_ring(rows, side, c)
                if found >= 0:
                    return found, ahead + (r - side) * columns
    return -1, 0


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _in_column(rows: Any, r: Any, c: Any) -> Any:  # pragma: no cover - compiled
    for away in range(rows.shape[0]):
        if r - away >= 0 and rows[r - away, c] >= 0:
            return rows[r - away, c], away
        if r + away < rows.shape[0] and rows[r + away, c] >= 0:
            return rows[r + away, c], -away
    return -1, 0


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _in_ring(rows: Any, r: Any, c: Any) -> Any:  # pragma: no cover - compiled
    """Rows are stored from column 0 on: what lies on the other side of that seam is no neighbor."""
    columns = rows.shape[1]
    for away in range(columns):
        if c - away >= 0 and rows[r, c - away] >= 0:
            return rows[r, c - away], away
        if c + away < columns and rows[r, c + away] >= 0:
            return rows[r, c + away], -away
    return -1, 0


@njit(cache=True, nogil=True, error_model="numpy")
def returned(points: Any, row: Any, pixels: Any, origin_m: Any, poses: Any) -> Any:  # pragma: no cover - compiled
    """Return starts (K, 3), unit directions (K, 3) and depths (K,) of the beams of returns; ring -1 has no height."""
    ring, column = pixels
    up, shift_m = poses
    start, way, depth_m = np.empty((row.shape[0], 3)), np.empty((row.shape[0], 3)), np.empty(row.shape[0])
    for k in range(row.shape[0]):
        c, lift, square = column[k], origin_m[ring[k]] if ring[k] >= 0 else 0.0, 0.0
        for axis in range(3):
            start[k, axis] = shift_m[c, axis] + up[c, axis] * lift
            way[k, axis] = points[row[k], axis] - start[k, axis]
            square += way[k, axis] ** 2
        depth_m[k] = np.sqrt(square)
        for axis in range(3):
            way[k, axis] /= max(depth_m[k], 1e-9)
    return start, way, depth_m


@njit(cache=True, nogil=True, error_model="numpy")
def fired(pixels: Any, shape: Any, azimuth: Any, poses: Any) -> Any:  # pragma: no cover - compiled
    """Return starts (K, 3) and unit directions (K, 3) of the beams of some pixels."""
    ring, column = pixels
    elevation, offset, origin_m = shape
    turn, shift_m = poses
    start, way = np.empty((ring.shape[0], 3)), np.empty((ring.shape[0], 3))
    flat, upward = np.cos(elevation), np.sin(elevation)
    for k in range(ring.shape[0]):
        r, c = ring[k], column[k]
        angle = azimuth[c] + offset[r]
        x, y, z = flat[r] * np.cos(angle), flat[r] * np.sin(angle), upward[r]
        for axis in range(3):
            start[k, axis] = shift_m[c, axis] + turn[c, axis, 2] * origin_m[r]
            way[k, axis] = turn[c, axis, 0] * x + turn[c, axis, 1] * y + turn[c, axis, 2] * z
    return start, way
