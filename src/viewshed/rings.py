"""Rings from cells and cells from rings: the compiled part of :mod:`viewshed.polygons`, in units of cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def trace(padded: Any, labels: Any) -> Any:  # pragma: no cover - compiled
    """Return corners (V, 2), ring starts (R+1,) and each ring's component (R,), negative where it is a hole.

    Walks the cells' edges with the mask on the left and turns left first, so that diagonal cells stay apart;
    a loop is cut off where the walk meets its own corner again. ``padded`` has a border of zeros.
    """
    n = padded.shape[0] - 2
    done = np.zeros((n + 1, n + 1), np.uint8)
    at = np.full((n + 1, n + 1), -1, np.int32)
    size = _corners(padded)
    out, stack = np.empty((size, 2), np.int16), np.empty((size + 1, 3), np.int16)
    starts, ring_labels = np.empty(size // 4 + 1, np.int64), np.empty(size // 4, np.int32)
    used = rings = 0
    for i0 in range(n):
        for j0 in range(n):
            if done[i0, j0] or not _starts(padded, i0, j0):
                continue
            i, j, heading, depth = i0, j0, 0, 0
            while True:
                if at[i, j] >= 0:
                    starts[rings], bottom = used, at[i, j]
                    ring_labels[rings] = _signed_label(stack, bottom, depth, labels)
                    used = _cut_off(stack, bottom, depth, at, out, used)
                    rings, depth = rings + 1, bottom
                    if depth == 0 and i == i0 and j == j0 and heading == 0:
                        break
                at[i, j] = depth
                stack[depth, 0], stack[depth, 1], stack[depth, 2] = i, j, heading
                depth += 1
                if heading == 0:
                    done[i, j] = 1
                i, j, heading = _next_corner(padded, i, j, heading)
    starts[rings] = used
    return out[:used], starts[: rings + 1], ring_labels[:rings]


@njit(cache=True, nogil=True)
def _cut_off(stack: Any, bottom: int, top: int, at: Any, out: Any, used: int) -> int:  # pragma: no cover - compiled
    """Copy a loop to ``out``, forget that its corners were met, and return how much of ``out`` is used."""
    for k in range(bottom, top):
        out[used] = stack[k, :2]
        at[stack[k, 0], stack[k, 1]] = -1
        used += 1
    return used


@njit(cache=True, nogil=True)
def _corners(padded: Any) -> int:  # pragma: no cover - compiled
    """Return how many corners all rings have: one where an odd count of cells meets, two at a diagonal contact."""
    total = 0
    for i in range(padded.shape[0] - 1):
        for j in range(padded.shape[1] - 1):
            a, b, c, d = padded[i, j], padded[i + 1, j], padded[i, j + 1], padded[i + 1, j + 1]
            if (a ^ b ^ c ^ d) == 1:
                total += 1
            elif a == d and b == c and a != b:
                total += 2
    return total


@njit(cache=True, nogil=True)
def _starts(padded: Any, i: int, j: int) -> bool:  # pragma: no cover - compiled
    """Return whether an edge along +i begins, after a turn, at lattice point (i, j)."""
    here = padded[i + 1, j + 1] and not padded[i + 1, j]
    before = padded[i, j + 1] and not padded[i, j]
    return bool(here and not before)


@njit(cache=True, nogil=True)
def _next_corner(padded: Any, i: int, j: int, heading: int) -> Any:  # pragma: no cover - compiled
    """Return the corner (i, j) where the edge that leaves a corner by ``heading`` ends, and the next heading.

    Headings 0…3 are +i, +j, -i, -j; the mask lies on the left.
    """
    di, dj = (1, 0, -1, 0)[heading], (0, 1, 0, -1)[heading]
    ahead_i, ahead_j = (1, 0, 0, 1)[heading], (1, 1, 0, 0)[heading]
    right_i, right_j = (1, 1, 0, 0)[heading], (0, 1, 1, 0)[heading]
    while True:
        i, j = i + di, j + dj
        if not padded[i + ahead_i, j + ahead_j]:
            return i, j, (heading + 1) % 4
        if padded[i + right_i, j + right_j]:
            return i, j, (heading + 3) % 4


@njit(cache=True, nogil=True)
def _signed_label(stack: Any, bottom: int, top: int, labels: Any) -> int:  # pragma: no cover - compiled
    """Return the component of the cell left of a loop's first edge, negative where the loop runs clockwise."""
    doubled_area = 0
    for k in range(bottom, top):
        m = k + 1 if k + 1 < top else bottom
        doubled_area += np.int64(stack[k, 0]) * stack[m, 1] - np.int64(stack[m, 0]) * stack[k, 1]
    i, j, heading = stack[bottom, 0], stack[bottom, 1], stack[bottom, 2]
    left_i, left_j = (0, -1, -1, 0)[heading], (0, 0, -1, -1)[heading]
    label = labels[i + left_i, j + left_j]
    return int(label if doubled_area > 0 else -label)


@njit(cache=True, nogil=True)
def flip(ring: Any, flips: Any) -> None:  # pragma: no cover - compiled
    """Flip, in each row of centres that an edge crosses, the first centre at or beyond the crossing (even-odd rule)."""
    cells = flips.shape[0]
    for k in range(len(ring) - 1):
        (x0, y0), (x1, y1) = ring[k], ring[k + 1]
        low, high = min(x0, x1), max(x0, x1)
        for i in range(max(int(np.ceil(low)), 0), min(int(np.ceil(high)), cells)):
            j = max(int(np.ceil(y0 + (i - x0) * (y1 - y0) / (x1 - x0))), 0)
            if j < cells:
                flips[i, j] = not flips[i, j]


@njit(cache=True, nogil=True)
def touch(ring: Any, touched: Any) -> None:  # pragma: no cover - compiled
    """Mark every cell that an edge of ``ring`` (cell (i, j) spans [i, i+1]) passes through or merely meets."""
    cells = touched.shape[0]
    for k in range(len(ring) - 1):
        (x0, y0), (x1, y1) = (ring[k], ring[k + 1]) if ring[k, 0] <= ring[k + 1, 0] else (ring[k + 1], ring[k])
        slope = (y1 - y0) / (x1 - x0) if x1 > x0 else 0.0
        for i in range(max(int(np.floor(x0 - 1e-9)), 0), min(int(np.floor(x1 + 1e-9)) + 1, cells)):
            a = y0 + (max(x0, float(i)) - x0) * slope
            b = y0 + (min(x1, i + 1.0) - x0) * slope if x1 > x0 else y1
            low, high = int(np.floor(min(a, b) - 1e-9)), int(np.floor(max(a, b) + 1e-9))
            touched[i, max(low, 0) : max(high + 1, 0)] = True
