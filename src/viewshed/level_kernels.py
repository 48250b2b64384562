"""Compiled loops of :mod:`viewshed.level`: lowest returns by node, levelled points, cells with obstacles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.angles import atan2
from viewshed.blocks import BLOCK, split

EGO_BOX_M = (2.7, 1.1)
"""Half length and half width of the vehicle below the sensor."""
EGO_HEIGHTS_M = (1.2, 3.0)
"""Sensor heights at which such a vehicle is assumed; lower ones are robots, higher ones stand at the roadside."""


@njit(cache=True, nogil=True, error_model="numpy")
def lows(returns: Any, rotation: Any, limits: Any, half: Any, side: int) -> Any:  # pragma: no cover - compiled
    """Return each node's second-lowest point (or the only one), turned, and the height from it up to the highest."""
    points, lone = returns
    lowest, origin = np.full((side * side, 2), np.inf, np.float32), np.zeros((side * side, 2), np.int32)
    highest = np.full(side * side, -np.inf, np.float32)
    x, y, z = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    nodes, heights = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.float32)
    for start in range(0, points.shape[0], BLOCK):
        count = split(points, start, x, y, z)
        _nodes((x[:count], y[:count], z[:count]), rotation, limits, (half, np.float32(side)), nodes, heights)
        for n in range(count):
            k = start + n
            if nodes[n] < 0 or lone[k]:
                continue
            node, low = np.uint32(nodes[n]), heights[n]
            highest[node] = max(highest[node], low)
            if low <= lowest[node, 1] and _before(points, k, low, origin[node, 1], lowest[node, 1]):
                rank = 1
                if _before(points, k, low, origin[node, 0], lowest[node, 0]):
                    lowest[node, 1], origin[node, 1] = lowest[node, 0], origin[node, 0]
                    rank = 0
                lowest[node, rank], origin[node, rank] = low, k
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
    block: Any, rotation: Any, limits: Any, lattice: Any, nodes: Any, heights: Any
) -> None:  # pragma: no cover - compiled
    """Find the node (-1 where it is no candidate for ground) and the z of each point of a block.

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
    xs, ys, zs = block
    for k in range(xs.shape[0]):
        px, py, pz = xs[k], ys[k], zs[k]
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
    rows, kept = np.empty(count, np.int64), np.empty(BLOCK, np.bool_)
    x, y, z = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    m = 0
    for start in range(0, count, BLOCK):
        size = split(points, start, x, y, z)
        _transform((x[:size], y[:size], z[:size]), transform, limits, kept)
        if clutter.shape[0] > 0:
            for k in range(size):
                kept[k] &= not clutter[start + k]
        left = 0
        for k in range(size):
            x[left], y[left], z[left], rows[m + left] = x[k], y[k], z[k], start + k
            left += kept[k]
        block = x[:left], y[:left], z[:left]
        _measure(block, ground.reshape(-1), half, (range_m[m:], azimuth[m:], height[m:]))
        for k in range(left):
            out[m + k, 0], out[m + k, 1], out[m + k, 2] = x[k], y[k], z[k]
        m += left
    return out[:m], range_m[:m], azimuth[:m], height[:m], rows[:m]


@njit(cache=True, nogil=True, error_model="numpy")
def _transform(block: Any, transform: Any, limits: Any, kept: Any) -> None:  # pragma: no cover - compiled
    """Turn and raise the points of a block in place, and mark those in range and outside the vehicle below."""
    xs, ys, zs = block
    near2, far2, ego_x, ego_y = limits[0] * limits[0], limits[1] * limits[1], limits[2], limits[3]
    xx, xy, xz = transform[0, 0], transform[0, 1], transform[0, 2]
    yx, yy, yz = transform[1, 0], transform[1, 1], transform[1, 2]
    zx, zy, zz, up = transform[2, 0], transform[2, 1], transform[2, 2], transform[2, 3]
    for k in range(xs.shape[0]):
        px, py, pz = xs[k], ys[k], zs[k]
        d2 = px * px + py * py + pz * pz
        x, y = xx * px + xy * py + xz * pz, yx * px + yy * py + yz * pz
        ego = (abs(x) < ego_x) & (abs(y) < ego_y)
        kept[k] = (d2 >= near2) & (d2 <= far2) & (not ego)
        xs[k], ys[k], zs[k] = x, y, zx * px + zy * py + zz * pz + up


@njit(cache=True, nogil=True, error_model="numpy")
def _measure(block: Any, ground: Any, half: Any, measured: Any) -> None:  # pragma: no cover - compiled
    """Write range, azimuth and height above the ground (n · n) of each point of a block.

    The places in the ground come first, since a loop that looks up does not vectorize.
    """
    xs, ys, zs = block
    range_m, azimuth, height = measured
    n = np.int32(np.sqrt(ground.shape[0]))
    per_m, last = np.float32(n / (2.0 * half)), np.float32(n - 1.001)
    node, right, below = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    for k in range(xs.shape[0]):
        x, y = xs[k], ys[k]
        range_m[k] = np.sqrt(x * x + y * y)
        azimuth[k] = atan2(y, x)
    for k in range(xs.shape[0]):
        u = min(max((xs[k] + half) * per_m - np.float32(0.5), np.float32(0.0)), last)
        v = min(max((ys[k] + half) * per_m - np.float32(0.5), np.float32(0.0)), last)
        i, j = np.int32(u), np.int32(v)
        below[k], right[k] = u - np.float32(i), v - np.float32(j)
        node[k] = i * n + j
    for k in range(xs.shape[0]):
        at, under = np.uint32(node[k]), np.uint32(node[k] + n)
        low = ground[at] + (ground[at + np.uint32(1)] - ground[at]) * right[k]
        high = ground[under] + (ground[under + np.uint32(1)] - ground[under]) * right[k]
        height[k] = zs[k] - low - (high - low) * below[k]


@njit(cache=True, nogil=True, error_model="numpy")
def slopes(points: Any, range_m: Any, height: Any, straight_up: Any, rows: Any) -> Any:  # pragma: no cover - compiled
    """Return rise over range (M,) from a sensor at ``height`` to points; +inf for those whose row is ``straight_up``.

    ``straight_up`` is a mask of the rows, or has no element where there is none.
    """
    slope = np.empty(points.shape[0], np.float32)
    for k in range(points.shape[0]):
        slope[k] = (points[k, 2] - height) / max(range_m[k], np.float32(1e-3))
    if straight_up.shape[0] > 0:
        for k in range(points.shape[0]):
            slope[k] = np.float32(np.inf) if straight_up[np.uint64(rows[k])] else slope[k]
    return slope


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
