"""Which beams may meet a solid: the window of columns and blocks of rings that hold its bounding box."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed._numba import atan2

BLOCK = 16
"""Rings are padded to a multiple of this."""

_MARGIN = 2e-4


@njit(cache=True, nogil=True, error_model="numpy")
def solid_window(
    boxes: Any, s: Any, pose: Any, slopes: Any, limits: Any, seen: Any
) -> Any:  # pragma: no cover - compiled
    """Return first column, number of columns, first block and last of the beams that may meet an oriented box.

    ``limits`` are azimuth step and offsets, the limits of ``cast_solids``, and how far the box moves within half the
    period; ``seen`` is room for the corners (2, 8).
    """
    sweep, (columns, max_range, _, lift, slack), drift = limits
    if _length(boxes, s, 0) - _length(boxes, s, 4) - drift > max_range:
        return 0, 0, 0, 0
    inside, apart2, flat2 = _gaps(boxes, s, drift)
    if inside:
        return 0, columns, 0, (slopes.shape[0] - 1) // BLOCK + 1
    x, y, z, tall, far2 = _corners(boxes, s, pose, drift, seen)
    tall += lift
    upright = pose[2, 2] > 0.999999 and boxes[s, 3, 2] > 0.999999
    tallest = max(abs(z - tall), abs(z + tall))
    near = np.sqrt(flat2) if upright else np.sqrt(max(apart2 - tallest * tallest, 0.0))
    low_slope, high_slope = slopes_of(z - tall, z + tall, near, np.sqrt(far2))
    first, last = ring_blocks(slopes, low_slope - slack, high_slope + slack)
    if first >= last:
        return 0, 0, 0, 0
    middle = float(atan2(np.float32(y), np.float32(x)))
    low, high = spread(seen, np.cos(middle), np.sin(middle))
    start, count = column_range(sweep, middle, low, high, columns)
    return start, count, first, last


@njit(cache=True, nogil=True, error_model="numpy")
def _length(boxes: Any, s: Any, row: Any) -> Any:  # pragma: no cover - compiled
    return np.sqrt(boxes[s, row, 0] ** 2 + boxes[s, row, 1] ** 2 + boxes[s, row, 2] ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _gaps(boxes: Any, s: Any, drift: Any) -> Any:  # pragma: no cover - compiled
    """Return whether the sensor is in an oriented box, and the square of the distance to it, and of that from above."""
    inside, apart2, flat2 = True, 0.0, 0.0
    for k in range(3):
        local = boxes[s, 1, k] * boxes[s, 0, 0] + boxes[s, 2, k] * boxes[s, 0, 1] + boxes[s, 3, k] * boxes[s, 0, 2]
        gap = max(abs(local) - (boxes[s, 4, k] + drift), 0.0)
        apart2 += gap * gap
        flat2 += gap * gap if k < 2 else 0.0
        inside = inside and gap == 0.0
    return inside, apart2, flat2


@njit(cache=True, nogil=True, error_model="numpy")
def _corners(boxes: Any, s: Any, pose: Any, drift: Any, seen: Any) -> Any:  # pragma: no cover - compiled
    """Store x and y of the corners (2, 8) in the sensor's frame; return the center, half the height, and far².

    The latter is the square of the largest horizontal range of a corner.
    """
    x, y, z = _turned(boxes, s, 0, pose)
    tall, far2 = 0.0, 0.0
    for corner in range(8):
        seen[0, corner], seen[1, corner] = x, y
    for k in range(3):
        size = boxes[s, 4, k] + drift
        p, q, r = boxes[s, 1, k], boxes[s, 2, k], boxes[s, 3, k]
        a = size * (pose[0, 0] * p + pose[1, 0] * q + pose[2, 0] * r)
        b = size * (pose[0, 1] * p + pose[1, 1] * q + pose[2, 1] * r)
        tall += abs(size * (pose[0, 2] * p + pose[1, 2] * q + pose[2, 2] * r))
        for corner in range(8):
            sign = 1.0 - 2.0 * ((corner >> k) & 1)
            seen[0, corner] += sign * a
            seen[1, corner] += sign * b
    for corner in range(8):
        far2 = max(far2, seen[0, corner] * seen[0, corner] + seen[1, corner] * seen[1, corner])
    return x, y, z, tall, far2


@njit(cache=True, nogil=True, error_model="numpy")
def _turned(boxes: Any, s: Any, row: Any, pose: Any) -> Any:  # pragma: no cover - compiled
    """Return a vector of a solid in the sensor's frame."""
    a, b, c = boxes[s, row, 0], boxes[s, row, 1], boxes[s, row, 2]
    x = pose[0, 0] * a + pose[1, 0] * b + pose[2, 0] * c
    y = pose[0, 1] * a + pose[1, 1] * b + pose[2, 1] * c
    return x, y, pose[0, 2] * a + pose[1, 2] * b + pose[2, 2] * c


@njit(cache=True, nogil=True, error_model="numpy")
def spread(seen: Any, cos: Any, sin: Any) -> Any:  # pragma: no cover - compiled
    """Return the least and the largest azimuth of corners from a direction."""
    low, high = 0.0, 0.0
    for corner in range(seen.shape[1]):
        u, v = seen[0, corner], seen[1, corner]
        turned = float(atan2(np.float32(v * cos - u * sin), np.float32(u * cos + v * sin)))
        low, high = min(low, turned), max(high, turned)
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def ring_blocks(slopes: Any, low: Any, high: Any) -> Any:  # pragma: no cover - compiled
    """Return the first block of rings, and the one after the last, that may lie between two slopes."""
    first, last = _below(slopes, low), _below(slopes, high)
    if first >= last:
        return 0, 0
    return first // BLOCK, (last - 1) // BLOCK + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _below(slopes: Any, slope: Any) -> Any:  # pragma: no cover - compiled
    """Return how many of ascending slopes are less than one."""
    low, high = 0, slopes.shape[0]
    while low < high:
        middle = (low + high) // 2
        if slopes[middle] < slope:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True, nogil=True, error_model="numpy")
def slopes_of(low_z: Any, high_z: Any, near: Any, far: Any) -> Any:  # pragma: no cover - compiled
    """Return bounds of z over horizontal range for heights in [low, high] and ranges in [near, far]."""
    near = max(near, 1e-3)
    low = low_z / near if low_z < 0 else low_z / far
    high = high_z / near if high_z > 0 else high_z / far
    return low - _MARGIN, high + _MARGIN


@njit(cache=True, nogil=True, error_model="numpy")
def column_range(sweep: Any, center: Any, low: Any, high: Any, columns: Any) -> Any:  # pragma: no cover - compiled
    """Return the first column and the number of columns whose azimuth may lie in center + [low, high]."""
    step, low_offset, high_offset = sweep
    if high - low >= np.pi - 0.01:
        return 0, columns
    start = int(np.floor((center + low - high_offset - _MARGIN + np.pi) / step - 0.5))
    stop = int(np.ceil((center + high - low_offset + _MARGIN + np.pi) / step - 0.5)) + 1
    return start, min(stop - start, columns)
