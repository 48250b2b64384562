"""Compiled loops of :mod:`viewshed.attacks.firing_fit`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def beside(returns: Any, beams: Any, motion: Any, axis: Any, limit_m: float) -> Any:  # pragma: no cover - compiled
    """Return how far returns lie beside their beams (n,), and the normal equations for a better motion.

    ``motion`` (4,): velocity, and turn rate about ``axis``. Of Gauss and Newton's (4, 4) matrix and (4,) right side,
    over the returns less than ``limit_m`` beside, and their number.
    """
    points, ring, column = returns
    azimuth, since_s, elevation, offset, origin_m = beams
    off_m = np.empty(points.shape[0])
    matrix, right, used = np.zeros((4, 4)), np.zeros(4), 0
    miss, slope = np.empty(3), np.empty((4, 3))
    for n in range(points.shape[0]):
        r, s = ring[n], since_s[column[n]]
        angle, flat = azimuth[column[n]] + offset[r], np.cos(elevation[r])
        way = _turned((flat * np.cos(angle), flat * np.sin(angle), np.sin(elevation[r])), axis, motion[3] * s)
        up = _turned((0.0, 0.0, origin_m[r]), axis, motion[3] * s)
        arm = (points[n, 0] - motion[0] * s, points[n, 1] - motion[1] * s, points[n, 2] - motion[2] * s)
        reach = (arm[0] - up[0], arm[1] - up[1], arm[2] - up[2])
        along = reach[0] * way[0] + reach[1] * way[1] + reach[2] * way[2]
        for k in range(3):
            miss[k] = reach[k] - along * way[k]
        off_m[n] = np.sqrt(miss[0] ** 2 + miss[1] ** 2 + miss[2] ** 2)
        if off_m[n] < limit_m:
            used += 1
            _slopes(way, _cross(axis, arm), s, slope)
            for i in range(4):
                right[i] += slope[i, 0] * miss[0] + slope[i, 1] * miss[1] + slope[i, 2] * miss[2]
                for j in range(4):
                    matrix[i, j] += slope[i, 0] * slope[j, 0] + slope[i, 1] * slope[j, 1] + slope[i, 2] * slope[j, 2]
    return off_m, matrix, right, used


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _slopes(way: Any, sideways: Any, s: Any, slope: Any) -> None:  # pragma: no cover - compiled
    """How the miss of one return follows velocity and turn rate: their part across the beam, times the time."""
    turning = sideways[0] * way[0] + sideways[1] * way[1] + sideways[2] * way[2]
    for k in range(3):
        for i in range(3):
            slope[i, k] = s * ((1.0 if i == k else 0.0) - way[i] * way[k])
        slope[3, k] = s * (sideways[k] - turning * way[k])


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _cross(a: Any, b: Any) -> Any:  # pragma: no cover - compiled
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _turned(v: Any, axis: Any, angle: Any) -> Any:  # pragma: no cover - compiled
    """Rodrigues' rotation of v (3,) about a unit axis (3,)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = _cross(axis, v)
    along = (1.0 - c) * (axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2])
    return c * v[0] + s * x + along * axis[0], c * v[1] + s * y + along * axis[1], c * v[2] + s * z + along * axis[2]
