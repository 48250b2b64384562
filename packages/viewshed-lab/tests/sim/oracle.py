"""Brute force: every beam against every solid and every triangle, in double precision, by other formulas.

Boxes as six faces, cylinders and ellipsoids by the quadratic formula, triangles by barycentric coordinates. Nothing is
culled.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.arrays import F32, F64
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed_lab.sim.assets.shapes import BOX, CYLINDER, PER_M
from viewshed_lab.sim.lidar.firing import column_poses, still_firing
from viewshed_lab.sim.raycast.scan import ExactScan, Motion
from viewshed_lab.sim.world import Snapshot

NEAREST_M = 1e-3


def firing(model: LidarModel, motion: Motion, pose: Rigid) -> tuple[F32, F32, F32]:
    """Return starts (C, R, 3), unit directions (C, R, 3) in the sensor's reference frame, and times (C,) in seconds."""
    start_m, direction, _ = still_firing(model)
    turn, shift_m, time_s = column_poses(model, motion, pose)
    starts = turn[:, None, :, 2] * start_m[:, None] + shift_m[:, None]
    return starts, np.einsum("cij,crj->cri", turn, direction), time_s


def rays_of(scan: ExactScan) -> tuple[F64, F64, F64]:
    """Return starts (N, 3), directions (N, 3) and times (N,) of all beams in the world."""
    origin = scan.origin_m.reshape(-1, 3).astype(np.float64) + scan.world_from_sensor.translation
    times = np.repeat(scan.time_s.astype(np.float64), scan.depth_m.shape[1])
    return origin, scan.direction.reshape(-1, 3).astype(np.float64), times


def solid_interval(snapshot: Snapshot, s: int, origin: F64, direction: F64, times: F64) -> tuple[F64, F64]:
    """Return depths (N,) at which beams enter and leave a solid; NaN where they miss it."""
    center = snapshot.center_m[s] + times[:, None] * snapshot.velocity_mps[s]
    o, d = (origin - center) @ snapshot.rotation[s], direction @ snapshot.rotation[s]
    if snapshot.kind[s] == BOX:
        return _faces(o, d, snapshot.half_m[s])
    return _quadric(o, d, snapshot.half_m[s], bool(snapshot.kind[s] == CYLINDER))


@njit(cache=True, error_model="numpy")
def _faces(o: F64, d: F64, half: F64) -> tuple[F64, F64]:
    """Return entry and exit depths: a beam hits the face k at ±half[k] if its other two coordinates lie on it."""
    near, far = np.full(len(o), np.nan), np.full(len(o), np.nan)
    for i in range(len(o)):
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            for side in (-1.0, 1.0):
                t = (side * half[k] - o[i, k]) / d[i, k]
                on = abs(o[i, m] + t * d[i, m]) <= half[m] + 1e-9 and abs(o[i, n] + t * d[i, n]) <= half[n] + 1e-9
                if np.isfinite(t) and on:
                    near[i], far[i] = np.fmin(near[i], t), np.fmax(far[i], t)
    return near, far


@njit(cache=True, error_model="numpy")
def _quadric(o: F64, d: F64, half: F64, cylinder: bool) -> tuple[F64, F64]:
    near, far = np.full(len(o), np.nan), np.full(len(o), np.nan)
    axes = 2 if cylinder else 3
    for i in range(len(o)):
        a = b = c = 0.0
        for k in range(axes):
            p, v = o[i, k] / half[k], d[i, k] / half[k]
            a, b, c = a + v * v, b + 2 * p * v, c + p * p
        root = np.sqrt(b * b - 4 * a * (c - 1))
        for side in (-1.0, 1.0):
            t = (-b + side * root) / (2 * a)
            if not cylinder or abs(o[i, 2] + t * d[i, 2]) <= half[2]:
                near[i], far[i] = np.fmin(near[i], t), np.fmax(far[i], t)
            if cylinder:  # its ends
                t = (side * half[2] - o[i, 2]) / d[i, 2]
                x, y = (o[i, 0] + t * d[i, 0]) / half[0], (o[i, 1] + t * d[i, 1]) / half[1]
                if np.isfinite(t) and x * x + y * y <= 1:
                    near[i], far[i] = np.fmin(near[i], t), np.fmax(far[i], t)
    return near, far


def ground_depth(snapshot: Snapshot, origin: F64, direction: F64) -> F64:
    """Return the depth (N,) at which beams first cross a triangle of the terrain; infinite where they do not."""
    corners = triangles_of(snapshot)
    first, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(_first_crossing(first, e1, e2, np.cross(e1, e2), origin, direction))


@njit(cache=True, error_model="numpy")
def _first_crossing(first: F64, e1: F64, e2: F64, normal: F64, origin: F64, direction: F64) -> F64:
    depths = np.full(len(origin), np.inf)
    for n in range(len(first)):
        g11 = g12 = g22 = 0.0
        for k in range(3):
            g11, g12, g22 = g11 + e1[n, k] * e1[n, k], g12 + e1[n, k] * e2[n, k], g22 + e2[n, k] * e2[n, k]
        scale = g11 * g22 - g12 * g12
        for i in range(len(origin)):
            off = speed = on1 = on2 = 0.0
            for k in range(3):
                off += normal[n, k] * (origin[i, k] - first[n, k])
                speed += normal[n, k] * direction[i, k]
            t = -off / speed
            for k in range(3):
                p = origin[i, k] + t * direction[i, k] - first[n, k]
                on1, on2 = on1 + e1[n, k] * p, on2 + e2[n, k] * p
            u, v = (g22 * on1 - g12 * on2) / scale, (g11 * on2 - g12 * on1) / scale
            if u >= -1e-9 and v >= -1e-9 and u + v <= 1 + 1e-9 and t > NEAREST_M:
                depths[i] = min(depths[i], t)
    return depths


def triangles_of(snapshot: Snapshot) -> F64:
    """Return the corners (T, 3, 3) of the terrain's triangles: quad (i, j) is cut from (i, j) to (i + 1, j + 1)."""
    x, y, z = snapshot.terrain.x_m, snapshot.terrain.y_m, snapshot.terrain.heights_m
    corners = []
    for i in range(len(x) - 1):
        for j in range(len(y) - 1):
            node = {(a, b): (x[i + a], y[j + b], z[i + a, j + b]) for a in (0, 1) for b in (0, 1)}
            corners.append([node[0, 0], node[1, 0], node[1, 1]])
            corners.append([node[0, 0], node[0, 1], node[1, 1]])
    return np.array(corners)


def opaque_depth(snapshot: Snapshot, rays: tuple[F64, F64, F64], max_range_m: float) -> tuple[F64, NDArray[np.int64]]:
    """Return depth (N,) and solid of the first opaque stop of every beam; -1 the ground, -2 nothing.

    Volumes that beams may pass (finite ``per_m``) are skipped.
    """
    depth, winner = np.full(len(rays[0]), np.inf), np.full(len(rays[0]), -2)
    for s in range(len(snapshot.kind)):
        if np.isinf(PER_M[snapshot.material[s]]):
            _keep(depth, winner, solid_interval(snapshot, s, *rays)[0], s)
    _keep(depth, winner, ground_depth(snapshot, *rays[:2]), -1)
    beyond = depth > max_range_m
    depth[beyond], winner[beyond] = np.inf, -2
    return depth, winner


def _keep(depth: F64, winner: NDArray[np.int64], t: F64, index: int) -> None:
    better = (t > NEAREST_M) & (t < depth)
    depth[better], winner[better] = t[better], index
