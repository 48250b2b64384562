"""Compiled loops of :mod:`viewshed.level`: lowest returns by node, levelled points, cells with obstacles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.angles import atan2

EGO_BOX_M = (2.7, 1.1)
"""Half length and half width of the vehicle below the sensor."""
EGO_HEIGHTS_M = (1.2, 3.0)
"""Sensor heights at which such a vehicle is assumed; lower ones are robots, higher ones stand at the roadside."""
_BLOCK = 4096


@njit(cache=True, nogil=True, error_model="numpy")
def lows(returns: Any, rotation: Any, limits: Any, half: Any, side: int) -> Any:  # pragma: no cover - compiled
    """Return each node's second-lowest point (or the only one), turned, and the height from it up to the highest."""
    points, lone = returns
    lowest, origin = np.full((side * side, 2), np.inf, np.float32), np.zeros((side * side, 2), np.int32)
    highest = np.full(side * side, -np.inf, np.float32)
    nodes, heights = np.empty(_BLOCK, np.int32), np.empty(_BLOCK, np.float32)
    for start in range(0, points.shape[0], _BLOCK):
        part = points[start : start + _BLOCK]
        _nodes(part, rotation, limits, (half, np.float32(side)), nodes, heights)
        for n in range(part.shape[0]):
            node, z, k = nodes[n], heights[n], start + n
            if node < 0 or lone[k]:
                continue
            highest[node] = max(highest[node], z)
            if _before(points, k, z, origin[node, 1], lowest[node, 1]):
                rank = 1
                if _before(points, k, z, origin[node, 0], lowest[node, 0]):
                    lowest[node, 1], origin[node, 1] = lowest[node, 0], origin[node, 0]
                    rank = 0
                lowest[node, rank], origin[node, rank] = z, k
    return _turned(points, rotation, lowest, origin, highest)


@njit(cache=True, nogil=True, error_model="numpy")
def _turned(points: Any, rotation: Any, lowest: Any, origin: Any, highest: Any) -> Any:  # pragma: no cover - compiled
    side = int(np.sqrt(highest.shape[0]))
    lows, rise = np.full((side, side, 3), np.inf, np.float32), np.zeros((side, side), np.float32)
    for node in range(highest.shape[0]):
        rank = 1 if np.isfinite(lowest[node, 1]) else 0
        if np.isfinite(lowest[node, rank]):
            i, j, k = node // side, node % side, origin[node, rank]
            px, py, pz = points[k, 0], points[k, 1], points[k, 2]
            lows[i, j, 0] = rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz
            lows[i, j, 1] = rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz
            lows[i, j, 2] = lowest[node, rank]
            rise[i, j] = highest[node] - lowest[node, rank]
    return lows, rise


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _before(points: Any, k: Any, z: Any, other: Any, low: Any) -> Any:  # pragma: no cover - compiled
    """Whether ``z`` is lower; among equals x and y decide, so that the order of the points does not."""
    if z != low:
        return z < low
    if points[k, 0] != points[other, 0]:
        return points[k, 0] < points[other, 0]
    return points[k, 1] < points[other, 1]


@njit(cache=True, nogil=True, error_model="numpy")
def _nodes(
    points: Any, rotation: Any, limits: Any, lattice: Any, nodes: Any, heights: Any
) -> None:  # pragma: no cover - compiled
    """Find each point's node (-1 where it is no candidate for ground) and its z.

    No candidates: points outside or out of range, and those that may be the hood or roof of the vehicle below the
    sensor. Without branches, so that it vectorizes.
    """
    half, last = lattice
    per_m, side = last / (np.float32(2.0) * half), np.int32(last)
    near2, far2 = limits[0] * limits[0], limits[1] * limits[1]
    xx, xy, xz = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    yx, yy, yz = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    zx, zy, zz = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    hood_x, hood_y, hood_z = np.float32(EGO_BOX_M[0]), np.float32(EGO_BOX_M[1]), np.float32(-EGO_HEIGHTS_M[0])
    for k in range(points.shape[0]):
        px, py, pz = points[k, 0], points[k, 1], points[k, 2]
        d2 = px * px + py * py + pz * pz
        x, y = xx * px + xy * py + xz * pz, yx * px + yy * py + yz * pz
        z = zx * px + zy * py + zz * pz
        u, v = (x + half) * per_m, (y + half) * per_m
        hood = (abs(x) < hood_x) & (abs(y) < hood_y) & (z > hood_z)
        inside = (d2 >= near2) & (d2 <= far2) & (u >= 0) & (v >= 0) & (u < last) & (v < last) & (not hood)
        i, j = np.int32(u if inside else np.float32(0)), np.int32(v if inside else np.float32(0))
        nodes[k] = i * side + j if inside else np.int32(-1)
        heights[k] = z


@njit(cache=True, nogil=True, error_model="numpy")
def level(
    points: Any, clutter: Any, transform: Any, limits: Any, ground: Any, half: Any
) -> Any:  # pragma: no cover - compiled
    """Transform, drop ego and null returns and clutter, and measure: points, range, azimuth, height above ground, rows.

    ``clutter`` is a mask of the points, or has no element where there is none.
    """
    count = points.shape[0]
    out = np.empty((count, 3), np.float32)
    range_m, azimuth, height = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    rows = np.empty(count, np.int64)
    near2, far2, ego_x, ego_y = limits[0] * limits[0], limits[1] * limits[1], limits[2], limits[3]
    n = ground.shape[0]
    per_m, last = np.float32(n / (2.0 * half)), np.float32(n - 1.001)
    m = 0
    for k in range(count):
        px, py, pz = points[k, 0], points[k, 1], points[k, 2]
        d2 = px * px + py * py + pz * pz
        if d2 < near2 or d2 > far2 or (clutter.shape[0] > 0 and clutter[k]):
            continue
        x = transform[0, 0] * px + transform[0, 1] * py + transform[0, 2] * pz
        y = transform[1, 0] * px + transform[1, 1] * py + transform[1, 2] * pz
        z = transform[2, 0] * px + transform[2, 1] * py + transform[2, 2] * pz + transform[2, 3]
        if abs(x) < ego_x and abs(y) < ego_y:
            continue
        out[m, 0], out[m, 1], out[m, 2] = x, y, z
        rows[m] = k
        m += 1
    for k in range(m):
        x, y = out[k, 0], out[k, 1]
        range_m[k] = np.sqrt(x * x + y * y)
        azimuth[k] = atan2(y, x)
    for k in range(m):
        u = _clamped((out[k, 0] + half) * per_m - np.float32(0.5), last)
        v = _clamped((out[k, 1] + half) * per_m - np.float32(0.5), last)
        i, j = np.int32(u), np.int32(v)
        fu, fv = u - np.float32(i), v - np.float32(j)
        low = ground[i, j] + (ground[i, j + 1] - ground[i, j]) * fv
        high = ground[i + 1, j] + (ground[i + 1, j + 1] - ground[i + 1, j]) * fv
        height[k] = out[k, 2] - low - (high - low) * fu
    return out[:m], range_m[:m], azimuth[:m], height[:m], rows[:m]


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _clamped(value: Any, last: Any) -> Any:  # pragma: no cover - compiled
    value = np.float32(0.0) if value < np.float32(0.0) else value
    return last if value > last else value


@njit(cache=True, nogil=True, error_model="numpy")
def obstacles(points: Any, height: Any, lattice: Any, mask: Any) -> None:  # pragma: no cover - compiled
    """Mark the cells that hold a return between the lattice's last two numbers above local ground."""
    x0, y0, per_m, low, high = lattice
    cells = mask.shape[0]
    for k in range(points.shape[0]):
        if height[k] > low and height[k] < high:
            u, v = (points[k, 0] - x0) * per_m, (points[k, 1] - y0) * per_m
            if u >= 0.0 and v >= 0.0 and u < cells and v < cells:
                mask[int(u), int(v)] = True
