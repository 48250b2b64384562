"""The loops that cast beams on the triangles of a terrain."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed_lab._numba import atan2
from viewshed_lab.sim.raycast._inputs import BLOCK
from viewshed_lab.sim.raycast._windows import column_range, ring_blocks, slopes_of

_NEAR_M = 1e-3
"""A beam stops no nearer than this."""

_EDGE = 1e-5
"""Share of a quad by which its triangles overlap the next ones: no beam falls between two."""


@njit(cache=True, nogil=True, error_model="numpy")
def cast_terrain(beams: Any, ground: Any, view: Any, nearest: Any, first_index: Any) -> None:
    """Test every quad; its two triangles have the indices ``first_index`` + 2 · quad and the next.

    The arguments are the tuples of :mod:`viewshed_lab.sim.raycast._inputs`; ``nearest`` is improved in place.
    """
    columns, velocity = view.columns, view.velocity
    # The ground stands still, so it drifts by the sensor's own way within half the period.
    drift_m = np.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2) * view.half_period_s
    nodes = _nodes(ground, view.rotation)
    local = np.empty(15, np.float32)
    for i in range(ground.x.shape[0] - 1):
        for j in range(ground.y.shape[0] - 1):
            start, count, first, last = _quad_window(nodes, ground, i, j, view, drift_m)
            if first >= last:
                continue
            bent = _quad_frame(ground, i, j, view, local)
            index = np.int32(first_index + 2 * (i * (ground.y.shape[0] - 1) + j))
            start %= columns
            # Two runs where the window crosses the last column, see cast_solids.
            for run in range(2):
                low, high = (start, min(start + count, columns)) if run == 0 else (0, start + count - columns)
                for block in range(first, last if high > low else first):
                    base, many = np.uint64((block * columns + low) * BLOCK), np.uint64((high - low) * BLOCK)
                    if bent:
                        _triangle(beams, local, base, many, np.float32(1.0), index, nearest)
                        _triangle(beams, local, base, many, np.float32(-1.0), np.int32(index + 1), nearest)
                    else:  # a flat quad is one plane: side 0 takes all of it
                        _triangle(beams, local, base, many, np.float32(0.0), index, nearest)


@njit(cache=True, nogil=True, error_model="numpy")
def _nodes(ground: Any, rotation: Any) -> Any:
    """Return x, y, z (nx, ny, 3) of the nodes in the sensor's frame."""
    out = np.empty((ground.x.shape[0], ground.y.shape[0], 3))
    for i in range(ground.x.shape[0]):
        for j in range(ground.y.shape[0]):
            for k in range(3):
                out[i, j, k] = (
                    rotation[0, k] * ground.x[i] + rotation[1, k] * ground.y[j] + rotation[2, k] * ground.z[i, j]
                )
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _quad_window(nodes: Any, ground: Any, i: Any, j: Any, view: Any, drift_m: Any) -> Any:
    """Return first column, number of columns, first block and last of the beams that may meet quad (i, j)."""
    # The nearest horizontal range, first along the world's axes.
    gap_x = max(ground.x[i] - drift_m, -(ground.x[i + 1] + drift_m), 0.0)
    gap_y = max(ground.y[j] - drift_m, -(ground.y[j + 1] + drift_m), 0.0)
    near = np.sqrt(gap_x * gap_x + gap_y * gap_y)
    if near > view.max_range_m:
        return 0, 0, 0, 0
    # Middle, farthest range and heights of the corners, in the sensor's frame.
    x, y, far2 = 0.0, 0.0, 0.0
    low_z, high_z = np.inf, -np.inf
    for corner in range(4):
        k, n = i + (corner & 1), j + (corner >> 1)
        u, v = nodes[k, n, 0], nodes[k, n, 1]
        x, y, far2 = x + u / 4, y + v / 4, max(far2, u * u + v * v)
        low_z, high_z = min(low_z, nodes[k, n, 2]), max(high_z, nodes[k, n, 2])
    if view.rotation[2, 2] < 0.999999:  # a tilted sensor: what is left of the distance by the height in its frame
        near = max(np.sqrt(max(near * near - max(low_z * low_z, high_z * high_z), 0.0)) - drift_m, 0.0)
    low_z, high_z = low_z - view.lift_m - drift_m, high_z + view.lift_m + drift_m
    low_slope, high_slope = slopes_of(low_z, high_z, near, np.sqrt(far2) + drift_m)
    first, last = ring_blocks(view.slopes, low_slope - view.slack, high_slope + view.slack)
    if first >= last:
        return 0, 0, 0, 0
    # Azimuths of the corners about that of the middle, and how far the drift swings them.
    middle = float(atan2(np.float32(y), np.float32(x)))
    cos, sin = np.cos(middle), np.sin(middle)
    low, high = 0.0, 0.0
    for corner in range(4):
        u, v = nodes[i + (corner & 1), j + (corner >> 1), 0], nodes[i + (corner & 1), j + (corner >> 1), 1]
        turned = float(atan2(np.float32(v * cos - u * sin), np.float32(u * cos + v * sin)))
        low, high = min(low, turned), max(high, turned)
    if drift_m > 0.0:
        swing = np.pi if near <= drift_m else np.arcsin(drift_m / near)
        low, high = low - swing, high + swing
    start, count = column_range(view, middle, low, high)
    return start, count, first, last


@njit(cache=True, nogil=True, error_model="numpy")
def _quad_frame(ground: Any, i: Any, j: Any, view: Any, local: Any) -> Any:
    """Store slopes of both triangles (a, b, a, b), 1 / sizes, first corner, axis, velocity; return whether it is bent.

    Corner and heights are seen from the sensor with the sign turned: the beam starts there, seen from the corner.
    """
    wide, deep = ground.x[i + 1] - ground.x[i], ground.y[j + 1] - ground.y[j]
    a, b, c, d = ground.z[i, j], ground.z[i + 1, j], ground.z[i, j + 1], ground.z[i + 1, j + 1]
    local[0], local[1] = (b - a) / wide, (d - b) / deep
    local[2], local[3] = (d - c) / wide, (c - a) / deep
    local[4], local[5] = 1.0 / wide, 1.0 / deep
    local[6], local[7], local[8] = -ground.x[i], -ground.y[j], -a
    for k in range(3):
        local[9 + k], local[12 + k] = view.rotation[k, 2], view.velocity[k]
    return abs(a + d - b - c) > 1e-9


@njit(cache=True, nogil=True, error_model="numpy")
def _triangle(beams: Any, local: Any, base: Any, many: Any, side: Any, index: Any, nearest: Any) -> None:
    """Stop beams ``base`` to ``base + many`` on the plane z = z0 + a (x - x0) + b (y - y0), within its triangle.

    That is where ``side`` · (u - v) ≥ 0, with u and v from 0 to 1 over the quad.
    """
    depth, winner = nearest.depth, nearest.winner
    edge, one = np.float32(-_EDGE), np.float32(1.0 + _EDGE)
    a, b = (local[0], local[1]) if side >= 0 else (local[2], local[3])
    for n in range(many):
        i = base + n
        x, y, z, rise, time = beams.x[i], beams.y[i], beams.z[i], beams.rise[i], beams.time[i]
        px = local[6] + rise * local[9] + time * local[12]
        py = local[7] + rise * local[10] + time * local[13]
        pz = local[8] + rise * local[11] + time * local[14]
        t = (a * px + b * py - pz) / (z - a * x - b * y)
        u, v = (px + t * x) * local[4], (py + t * y) * local[5]
        inside = (u >= edge) & (v >= edge) & (u <= one) & (v <= one) & (side * (u - v) >= edge)
        hit = inside & (t > np.float32(_NEAR_M)) & (t < depth[i])
        depth[i] = t if hit else depth[i]
        winner[i] = index if hit else winner[i]
