"""A fast arctangent for compiled loops."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def atan2(y: Any, x: Any) -> Any:
    """Return the float32 azimuth of (x, y) in [-π, π) radians, within 2e-5; 0 at the origin.

    Odd minimax polynomial of the arctangent on [0, 1], degree 11.
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
