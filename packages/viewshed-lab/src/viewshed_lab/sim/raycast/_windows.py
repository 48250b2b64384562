"""Which beams may meet a solid: the window of columns and blocks of rings that holds its bounding box."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed_lab._numba import atan2
from viewshed_lab.sim.raycast._inputs import BLOCK

_MARGIN = 2e-4
"""Radians, and slopes, by which windows are widened: more than single precision is wrong by."""


@njit(cache=True, nogil=True, error_model="numpy")
def solid_window(boxes: Any, s: Any, view: Any, drift_m: Any, corners: Any) -> Any:
    """Return first column, number of columns, first block and last of the beams that may meet solid ``s``.

    The solid is widened by ``drift_m``, how far it moves within half the period as the sensor sees it; ``corners``
    (2, 8) is scratch memory.
    """
    if _length(boxes, s, 0) - _length(boxes, s, 4) - drift_m > view.max_range_m:
        return 0, 0, 0, 0
    inside, apart2, flat2 = _gaps(boxes, s, drift_m)
    if inside:
        return 0, view.columns, 0, (view.slopes.shape[0] - 1) // BLOCK + 1
    x, y, z, tall, far2 = _corners(boxes, s, view.rotation, drift_m, corners)
    tall += view.lift_m
    # The nearest horizontal range: from above if both are upright, else what is left of the distance by its height.
    upright = view.rotation[2, 2] > 0.999999 and boxes[s, 3, 2] > 0.999999
    tallest = max(abs(z - tall), abs(z + tall))
    near = np.sqrt(flat2) if upright else np.sqrt(max(apart2 - tallest * tallest, 0.0))
    low_slope, high_slope = slopes_of(z - tall, z + tall, near, np.sqrt(far2))
    first, last = ring_blocks(view.slopes, low_slope - view.slack, high_slope + view.slack)
    if first >= last:
        return 0, 0, 0, 0
    middle = float(atan2(np.float32(y), np.float32(x)))
    low, high = spread(corners, np.cos(middle), np.sin(middle))
    start, count = column_range(view, middle, low, high)
    return start, count, first, last


@njit(cache=True, nogil=True, error_model="numpy")
def _length(boxes: Any, s: Any, row: Any) -> Any:
    return np.sqrt(boxes[s, row, 0] ** 2 + boxes[s, row, 1] ** 2 + boxes[s, row, 2] ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _gaps(boxes: Any, s: Any, drift_m: Any) -> Any:
    """Return whether the sensor is in an oriented box, and the squares of its distance, in space and from above."""
    inside, apart2, flat2 = True, 0.0, 0.0
    for k in range(3):
        local = boxes[s, 1, k] * boxes[s, 0, 0] + boxes[s, 2, k] * boxes[s, 0, 1] + boxes[s, 3, k] * boxes[s, 0, 2]
        gap = max(abs(local) - (boxes[s, 4, k] + drift_m), 0.0)
        apart2 += gap * gap
        flat2 += gap * gap if k < 2 else 0.0
        inside = inside and gap == 0.0
    return inside, apart2, flat2


@njit(cache=True, nogil=True, error_model="numpy")
def _corners(boxes: Any, s: Any, rotation: Any, drift_m: Any, corners: Any) -> Any:
    """Store x and y of the corners (2, 8) in the sensor's frame; return the center, half the height, and far².

    The latter is the square of the largest horizontal range of a corner.
    """
    x, y, z = _into_sensor(boxes, s, 0, rotation)
    tall, far2 = 0.0, 0.0
    for corner in range(8):
        corners[0, corner], corners[1, corner] = x, y
    for k in range(3):
        # One half axis of the box, in the sensor's frame; bit k of a corner's number is its sign.
        size = boxes[s, 4, k] + drift_m
        p, q, r = boxes[s, 1, k], boxes[s, 2, k], boxes[s, 3, k]
        a = size * (rotation[0, 0] * p + rotation[1, 0] * q + rotation[2, 0] * r)
        b = size * (rotation[0, 1] * p + rotation[1, 1] * q + rotation[2, 1] * r)
        tall += abs(size * (rotation[0, 2] * p + rotation[1, 2] * q + rotation[2, 2] * r))
        for corner in range(8):
            sign = 1.0 - 2.0 * ((corner >> k) & 1)
            corners[0, corner] += sign * a
            corners[1, corner] += sign * b
    for corner in range(8):
        far2 = max(far2, corners[0, corner] * corners[0, corner] + corners[1, corner] * corners[1, corner])
    return x, y, z, tall, far2


@njit(cache=True, nogil=True, error_model="numpy")
def _into_sensor(boxes: Any, s: Any, row: Any, rotation: Any) -> Any:
    """Return a vector of a solid in the sensor's frame."""
    a, b, c = boxes[s, row, 0], boxes[s, row, 1], boxes[s, row, 2]
    x = rotation[0, 0] * a + rotation[1, 0] * b + rotation[2, 0] * c
    y = rotation[0, 1] * a + rotation[1, 1] * b + rotation[2, 1] * c
    return x, y, rotation[0, 2] * a + rotation[1, 2] * b + rotation[2, 2] * c


@njit(cache=True, nogil=True, error_model="numpy")
def spread(corners: Any, cos: Any, sin: Any) -> Any:
    """Return the least and the largest azimuth of corners (2, n) from a direction."""
    low, high = 0.0, 0.0
    for corner in range(corners.shape[1]):
        u, v = corners[0, corner], corners[1, corner]
        turned = float(atan2(np.float32(v * cos - u * sin), np.float32(u * cos + v * sin)))
        low, high = min(low, turned), max(high, turned)
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def ring_blocks(slopes: Any, low: Any, high: Any) -> Any:
    """Return the first block of rings, and the one after the last, that may lie between two slopes."""
    first, last = np.searchsorted(slopes, low), np.searchsorted(slopes, high)
    if first >= last:
        return 0, 0
    return first // BLOCK, (last - 1) // BLOCK + 1


@njit(cache=True, nogil=True, error_model="numpy")
def slopes_of(low_z: Any, high_z: Any, near: Any, far: Any) -> Any:
    """Return bounds of z over horizontal range for heights in [low, high] and ranges in [near, far]."""
    near = max(near, 1e-3)
    low = low_z / near if low_z < 0 else low_z / far
    high = high_z / near if high_z > 0 else high_z / far
    return low - _MARGIN, high + _MARGIN


@njit(cache=True, nogil=True, error_model="numpy")
def column_range(view: Any, center: Any, low: Any, high: Any) -> Any:
    """Return the first column and the number of columns whose azimuth may lie in center + [low, high]."""
    if high - low >= np.pi - 0.01:
        return 0, view.columns
    start = int(np.floor((center + low - view.high_offset - _MARGIN + np.pi) / view.step - 0.5))
    stop = int(np.ceil((center + high - view.low_offset + _MARGIN + np.pi) / view.step - 0.5)) + 1
    return start, min(stop - start, view.columns)
