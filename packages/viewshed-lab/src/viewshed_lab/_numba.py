"""A fast arctangent for compiled loops.

Blocks of points by columns: compiled loops use vectors only on contiguous numbers, and short ones stay at hand.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def atan2(y: Any, x: Any) -> Any:
    """Return the float32 azimuth of (x, y) in [-π, π) radians, within 2e-5; 0 at the origin.

    A minimax polynomial of the arctangent on [0, 1], odd, to the eleventh power.
    """
    ax, ay = abs(x), abs(y)
    small, large = (ax, ay) if ax < ay else (ay, ax)
    ratio = small / (large + np.float32(1e-30))
    s = ratio * ratio
    p = np.float32(-0.01172120) * s + np.float32(0.05265332)
    p = p * s - np.float32(0.11643287)
    p = p * s + np.float32(0.19354346)
    p = p * s - np.float32(0.33262347)
    a = (p * s + np.float32(0.99997726)) * ratio
    a = np.float32(1.57079637) - a if ay > ax else a
    a = np.float32(3.14159274) - a if x < 0 else a
    a = -a if y < 0 else a
    return np.float32(-3.14159274) if a >= np.float32(3.14159265) else a


BLOCK = 1024
"""Points of a block."""


@njit(cache=True, nogil=True, error_model="numpy")
def split(points: Any, start: int, x: Any, y: Any, z: Any) -> Any:
    """Write the coordinates of the block of ``points`` (N, 3) from ``start`` on, and return how many it has."""
    count = min(BLOCK, points.shape[0] - start)
    for k in range(count):
        x[k], y[k], z[k] = points[start + k, 0], points[start + k, 1], points[start + k, 2]
    return count
