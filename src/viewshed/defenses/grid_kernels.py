"""Whether a point has enough neighbors within a radius: a hashed grid of cubes, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_FARTHEST = 1e9


@njit(cache=True, nogil=True, error_model="numpy")
def have_neighbors(
    points: Any, marked: Any, asked: Any, radius_m: float, fewest: int
) -> Any:  # pragma: no cover - compiled
    """Return (N,) bool: ``asked`` points with at least ``fewest`` other ``marked`` points within ``radius_m``.

    Cubes of that side are hashed into a table; those that share a slot are told apart by their own indices. A point's
    own cube is counted first, and counting stops at ``fewest``.
    """
    count = points.shape[0]
    slots = 64
    while slots < 2 * count:
        slots *= 2
    cubes = np.empty((count, 3), np.int64)
    for n in range(count):
        for axis in range(3):
            cubes[n, axis] = int(np.floor(min(max(points[n, axis] / radius_m, -_FARTHEST), _FARTHEST)))
    starts, rows = _table(cubes, marked, slots)
    found = np.zeros(count, np.bool_)
    for n in range(count):
        if asked[n]:
            found[n] = _count(points, cubes, (starts, rows), n, (radius_m * radius_m, fewest)) >= fewest
    return found


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _slot(x: Any, y: Any, z: Any, slots: Any) -> Any:  # pragma: no cover - compiled
    """Hash of a cube (Teschner et al. 2003)."""
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (slots - 1)


@njit(cache=True, nogil=True, error_model="numpy")
def _table(cubes: Any, marked: Any, slots: int) -> Any:  # pragma: no cover - compiled
    """Return where each slot starts (slots + 1,) and the marked rows, slot by slot."""
    count = cubes.shape[0]
    starts = np.zeros(slots + 1, np.int32)
    slot = np.empty(count, np.int32)
    for n in range(count):
        slot[n] = _slot(cubes[n, 0], cubes[n, 1], cubes[n, 2], slots)
        starts[slot[n] + 1] += marked[n]
    for s in range(slots):
        starts[s + 1] += starts[s]
    filled, rows = starts[:-1].copy(), np.empty(starts[slots], np.int32)
    for n in range(count):
        if marked[n]:
            rows[filled[slot[n]]] = n
            filled[slot[n]] += 1
    return starts, rows


@njit(cache=True, nogil=True, error_model="numpy")
def _count(points: Any, cubes: Any, table: Any, n: int, asked: Any) -> Any:  # pragma: no cover - compiled
    """Count neighbors of point ``n``, at most as many as are asked for, from its own cube outward."""
    starts, rows = table
    radius2, fewest = asked
    found = 0
    for place in range(27):
        cell = (place + 13) % 27
        x, y, z = cubes[n, 0] + cell // 9 - 1, cubes[n, 1] + cell // 3 % 3 - 1, cubes[n, 2] + cell % 3 - 1
        slot = _slot(x, y, z, len(starts) - 1)
        for k in range(starts[slot], starts[slot + 1]):
            m = rows[k]
            if m == n or cubes[m, 0] != x or cubes[m, 1] != y or cubes[m, 2] != z:
                continue
            apart2 = 0.0
            for axis in range(3):
                step = np.float64(points[m, axis]) - np.float64(points[n, axis])
                apart2 += step * step
            if apart2 <= radius2:
                found += 1
                if found >= fewest:
                    return found
    return found
