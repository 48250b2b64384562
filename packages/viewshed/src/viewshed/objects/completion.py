"""Complete boxes from the visible sides: the part missing to the usual size lies behind them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.detections import ObjectKind

_USUAL_SIZES_M = {
    ObjectKind.OTHER: (0.6, 0.6, 0.6),
    ObjectKind.PEDESTRIAN: (0.6, 0.6, 1.6),
    ObjectKind.CYCLIST: (1.9, 0.6, 1.6),
    ObjectKind.CAR: (4.4, 1.8, 1.5),
    ObjectKind.TRUCK: (8.0, 2.5, 3.0),
}

USUAL_SIZE_M = np.array([_USUAL_SIZES_M[kind] for kind in ObjectKind])
"""Usual length, width and height (5, 3) of each kind; objects that show more are larger."""

LEFT_HIDDEN, RIGHT_HIDDEN = 1, 2
"""Values of the last column of the candidates' sides."""


def complete_boxes(
    sides: NDArray[np.float32], kinds: NDArray[np.uint8], is_end: Mask, top_m: NDArray[np.float32]
) -> F64:
    """Return completed boxes (K, 7) over flat ground at z = 0 from their visible sides.

    Each side is extended to the usual length of the kind. If the sensor is beyond one end, the other end is moved. If
    it is beside, the end that something nearer hides is moved, or else both by half.

    Args:
        sides: (K, 6) of :class:`viewshed.objects.candidates.Candidates`.
        kinds: (K,) uint8 of :class:`viewshed.detections.ObjectKind`.
        is_end: (K,) bool, whether the long visible side is the object's width.
        top_m: (K,) height of the highest return above the ground.
    """
    heading, a_low, a_high, b_low, b_high, hidden = sides.astype(np.float64).T
    # 1. Sides along (u) and across (v) the object's length: a quarter turn where only an end is seen.
    yaw = np.where(is_end, heading + np.pi / 2, heading)
    u = np.where(is_end, b_low, a_low), np.where(is_end, b_high, a_high)
    v = np.where(is_end, -a_high, b_low), np.where(is_end, -a_low, b_high)
    # 2. Which way the axes point as the sensor sees them: to its left or to its right.
    u_middle, v_middle = (u[0] + u[1]) / 2, (v[0] + v[1]) / 2
    u_end, v_end = (
        np.where(hidden == 0, 0.5, (hidden == LEFT_HIDDEN) == points_left)
        for points_left in (v_middle < 0, u_middle > 0)
    )
    # 3. Complete both.
    length_m, width_m, height_m = USUAL_SIZE_M[kinds].T
    u, v = _grown(*u, length_m, u_end), _grown(*v, width_m, v_end)
    along, across = (u[0] + u[1]) / 2, (v[0] + v[1]) / 2
    tall_m = np.maximum(top_m, height_m)
    return np.column_stack([
        _turned(along, across, yaw), tall_m / 2,
        u[1] - u[0], v[1] - v[0], tall_m, (yaw + np.pi) % (2 * np.pi) - np.pi,
    ])  # fmt: skip


def middles_of(sides: NDArray[np.float32]) -> F64:
    """Return x and y (K, 2) of the middles of the visible sides (K, 6)."""
    heading, a_low, a_high, b_low, b_high, _ = sides.astype(np.float64).T
    return _turned((a_low + a_high) / 2, (b_low + b_high) / 2, heading)


def _turned(along: F64, across: F64, yaw: F64) -> F64:
    """Return x and y (K, 2) of coordinates along and across a heading."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([along * c - across * s, along * s + across * c], axis=-1)


def _grown(low: F64, high: F64, min_m: F64, share_high: F64) -> tuple[F64, F64]:
    """Return intervals extended to at least ``min_m``; the sensor at 0 stays on its side of them."""
    missing_m = np.maximum(min_m - (high - low), 0.0)
    at_high = np.where(low > 0, 1.0, np.where(high < 0, 0.0, share_high))
    return low - (1.0 - at_high) * missing_m, high + at_high * missing_m
