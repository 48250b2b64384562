"""The loops that cast beams on the triangles of a terrain."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed._numba import atan2
from viewshed.sim.raycast._windows import BLOCK, column_range, ring_blocks, slopes_of

_NEAR_M = 1e-3

_EDGE = 1e-5


@njit(cache=True, nogil=True, error_model="numpy")
def cast_terrain(beams: Any, lattice: Any, frame: Any, best: Any, offset: Any) -> None:  # pragma: no cover - compiled
    """Test every quad; its two triangles have the indices ``offset`` + 2 · quad and the next.

    ``lattice`` is x (nx), y (ny) and z (nx, ny) of the nodes from the sensor, in world axes; the other arguments are
    those of ``cast_solids``.
    """
    xs, ys, zs = lattice
    pose, sweep, slopes, limits, own = frame
    columns = limits[0]
    drift = np.sqrt(own[0] ** 2 + own[1] ** 2 + own[2] ** 2) * limits[2]
    seen = _nodes(xs, ys, zs, pose)
    bounds = (columns, limits[1], drift, limits[3], limits[4])
    local = np.empty(15, np.float32)
    for i in range(xs.shape[0] - 1):
        for j in range(ys.shape[0] - 1):
            start, count, first, last = _quad_window(seen, (xs, ys), (i, j), (pose, sweep, slopes), bounds)
            if first >= last:
                continue
            bent = _quad_frame(lattice, (i, j), pose, own, local)
            index = np.int32(offset + 2 * (i * (ys.shape[0] - 1) + j))
            start %= columns
            for run in range(2):
                low, high = (start, min(start + count, columns)) if run == 0 else (0, start + count - columns)
                for block in range(first, last if high > low else first):
                    window = (np.uint64((block * columns + low) * BLOCK), np.uint64((high - low) * BLOCK))
                    if bent:
                        _triangle(beams, local, best, window, (np.float32(1.0), index))
                        _triangle(beams, local, best, window, (np.float32(-1.0), np.int32(index + 1)))
                    else:
                        _triangle(beams, local, best, window, (np.float32(0.0), index))


@njit(cache=True, nogil=True, error_model="numpy")
def _nodes(xs: Any, ys: Any, zs: Any, pose: Any) -> Any:  # pragma: no cover - compiled
    """Return x, y, z (nx, ny, 3) of the nodes in the sensor's frame."""
    out = np.empty((xs.shape[0], ys.shape[0], 3))
    for i in range(xs.shape[0]):
        for j in range(ys.shape[0]):
            for k in range(3):
                out[i, j, k] = pose[0, k] * xs[i] + pose[1, k] * ys[j] + pose[2, k] * zs[i, j]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _quad_window(seen: Any, lines: Any, quad: Any, view: Any, limits: Any) -> Any:  # pragma: no cover - compiled
    """Return first column, number of columns, first block and last of the beams that may meet a quad."""
    (xs, ys), (i, j), (pose, sweep, slopes) = lines, quad, view
    columns, max_range, drift, lift, slack = limits
    gap_x = max(xs[i] - drift, -(xs[i + 1] + drift), 0.0)
    gap_y = max(ys[j] - drift, -(ys[j + 1] + drift), 0.0)
    near = np.sqrt(gap_x * gap_x + gap_y * gap_y)
    if near > max_range:
        return 0, 0, 0, 0
    x, y, far2 = 0.0, 0.0, 0.0
    low_z, high_z = np.inf, -np.inf
    for corner in range(4):
        k, n = i + (corner & 1), j + (corner >> 1)
        u, v = seen[k, n, 0], seen[k, n, 1]
        x, y, far2 = x + u / 4, y + v / 4, max(far2, u * u + v * v)
        low_z, high_z = min(low_z, seen[k, n, 2]), max(high_z, seen[k, n, 2])
    if pose[2, 2] < 0.999999:
        near = max(np.sqrt(max(near * near - max(low_z * low_z, high_z * high_z), 0.0)) - drift, 0.0)
    low_slope, high_slope = slopes_of(low_z - lift - drift, high_z + lift + drift, near, np.sqrt(far2) + drift)
    first, last = ring_blocks(slopes, low_slope - slack, high_slope + slack)
    if first >= last:
        return 0, 0, 0, 0
    middle = float(atan2(np.float32(y), np.float32(x)))
    cos, sin = np.cos(middle), np.sin(middle)
    low, high = 0.0, 0.0
    for corner in range(4):
        u, v = seen[i + (corner & 1), j + (corner >> 1), 0], seen[i + (corner & 1), j + (corner >> 1), 1]
        turned = float(atan2(np.float32(v * cos - u * sin), np.float32(u * cos + v * sin)))
        low, high = min(low, turned), max(high, turned)
    if drift > 0.0:
        swing = np.pi if near <= drift else np.arcsin(drift / near)
        low, high = low - swing, high + swing
    start, count = column_range(sweep, middle, low, high, columns)
    return start, count, first, last


@njit(cache=True, nogil=True, error_model="numpy")
def _quad_frame(lattice: Any, quad: Any, pose: Any, own: Any, local: Any) -> Any:  # pragma: no cover - compiled
    """Store slopes of both triangles (a, b, a, b), 1 / sizes, first corner, axis, velocity; tell whether it is bent."""
    (xs, ys, zs), (i, j) = lattice, quad
    wide, deep = xs[i + 1] - xs[i], ys[j + 1] - ys[j]
    a, b, c, d = zs[i, j], zs[i + 1, j], zs[i, j + 1], zs[i + 1, j + 1]
    local[0], local[1] = (b - a) / wide, (d - b) / deep
    local[2], local[3] = (d - c) / wide, (c - a) / deep
    local[4], local[5] = 1.0 / wide, 1.0 / deep
    local[6], local[7], local[8] = -xs[i], -ys[j], -a
    for k in range(3):
        local[9 + k], local[12 + k] = pose[k, 2], own[k]
    return abs(a + d - b - c) > 1e-9


@njit(cache=True, nogil=True, error_model="numpy")
def _triangle(beams: Any, local: Any, best: Any, window: Any, which: Any) -> None:  # pragma: no cover - compiled
    """Test z = z0 + a (x - x0) + b (y - y0) where ``side`` · (u - v) ≥ 0, with u and v from 0 to 1 over the quad."""
    bx, by, bz, rises, times = beams
    depth, winner = best
    (base, many), (side, index) = window, which
    edge, one = np.float32(-_EDGE), np.float32(1.0 + _EDGE)
    a, b = (local[0], local[1]) if side >= 0 else (local[2], local[3])
    for n in range(many):
        i = base + n
        x, y, z, rise, time = bx[i], by[i], bz[i], rises[i], times[i]
        px = local[6] + rise * local[9] + time * local[12]
        py = local[7] + rise * local[10] + time * local[13]
        pz = local[8] + rise * local[11] + time * local[14]
        t = (a * px + b * py - pz) / (z - a * x - b * y)
        u, v = (px + t * x) * local[4], (py + t * y) * local[5]
        inside = (u >= edge) & (v >= edge) & (u <= one) & (v <= one) & (side * (u - v) >= edge)
        hit = inside & (t > np.float32(_NEAR_M)) & (t < depth[i])
        depth[i] = t if hit else depth[i]
        winner[i] = index if hit else winner[i]
