"""Brute force: every beam against every solid and every triangle, in double precision, by other formulas.

Boxes as six faces, cylinders and ellipsoids by the quadratic formula, triangles by barycentric coordinates. Nothing is
left out because it seems out of sight.
"""

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed_lab.sim.assets.shapes import BOX, CYLINDER, PER_M
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.world import Snapshot

BEAMS_AT_ONCE = 1_000
NEAREST_M = 1e-3


def rays_of(scan: ExactScan) -> tuple[F64, F64, F64]:
    """Return starts (N, 3), directions (N, 3) and times (N,) of all beams in the world."""
    origin = scan.origin_m.reshape(-1, 3).astype(np.float64) + scan.world_from_sensor.translation
    times = np.repeat(scan.time_s.astype(np.float64), scan.depth_m.shape[1])
    return origin, scan.direction.reshape(-1, 3).astype(np.float64), times


def solid_interval(snapshot: Snapshot, s: int, origin: F64, direction: F64, times: F64) -> tuple[F64, F64]:
    """Return depths (N,) at which beams enter and leave a solid; NaN where they miss it."""
    center = snapshot.center_m[s] + times[:, None] * snapshot.velocity_mps[s]
    o = (origin - center) @ snapshot.rotation[s]
    d = direction @ snapshot.rotation[s]
    with np.errstate(all="ignore"):
        if snapshot.kind[s] == BOX:
            return _faces(o, d, snapshot.half_m[s])
        return _quadric(o, d, snapshot.half_m[s], bool(snapshot.kind[s] == CYLINDER))


def _faces(o: F64, d: F64, half: F64) -> tuple[F64, F64]:
    """A beam crosses the face of axis k at ±half[k] where the other two coordinates lie within theirs."""
    starts, ways = np.ascontiguousarray(o.T), np.ascontiguousarray(d.T)
    crossings = []
    for k in range(3):
        m, n = (axis for axis in range(3) if axis != k)
        for side in (-1.0, 1.0):
            t = (side * half[k] - starts[k]) / ways[k]
            on = np.isfinite(t) & (np.abs(starts[m] + t * ways[m]) <= half[m] + 1e-9)
            on &= np.abs(starts[n] + t * ways[n]) <= half[n] + 1e-9
            crossings.append(np.where(on, t, np.nan))
    return np.fmin.reduce(crossings), np.fmax.reduce(crossings)


def _quadric(o: F64, d: F64, half: F64, cylinder: bool) -> tuple[F64, F64]:
    axes = slice(0, 2) if cylinder else slice(0, 3)
    p, v = o[:, axes] / half[axes], d[:, axes] / half[axes]
    a, b, c = (v * v).sum(1), 2 * (p * v).sum(1), (p * p).sum(1) - 1
    root = np.sqrt(b * b - 4 * a * c)
    near, far = (-b - root) / (2 * a), (-b + root) / (2 * a)
    if not cylinder:
        return near, far
    crossings = [np.where(np.abs(o[:, 2] + t * d[:, 2]) <= half[2], t, np.nan) for t in (near, far)]
    for side in (-1.0, 1.0):
        t = (side * half[2] - o[:, 2]) / d[:, 2]
        at = (o[:, :2] + t[:, None] * d[:, :2]) / half[:2]
        crossings.append(np.where(((at * at).sum(1) <= 1) & np.isfinite(t), t, np.nan))
    return np.fmin.reduce(crossings), np.fmax.reduce(crossings)


def triangle_depths(corners: F64, origin: F64, direction: F64) -> F64:
    """Return depths (T, N) at which beams cross each triangle (T, 3, 3); NaN where they do not."""
    first, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]

    def along(axis: F64) -> tuple[F64, F64]:
        """Along an axis (T, 3) of each triangle: how far each beam begins from the first corner, and its speed."""
        return axis @ origin.T - (first * axis).sum(axis=1, keepdims=True), axis @ direction.T

    off, speed = along(np.cross(e1, e2))
    t = -off / speed
    on1, on2 = (start + t * speed for start, speed in map(along, (e1, e2)))
    g11, g12, g22 = ((a * b).sum(axis=1, keepdims=True) for a, b in ((e1, e1), (e1, e2), (e2, e2)))
    scale = g11 * g22 - g12 * g12
    u, v = (g22 * on1 - g12 * on2) / scale, (g11 * on2 - g12 * on1) / scale
    return np.where((u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9), t, np.nan)


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

    Volumes that beams may pass (finite ``per_m``) are left out.
    """
    depth, winner = np.full(len(rays[0]), np.inf), np.full(len(rays[0]), -2)
    solids = [s for s in range(len(snapshot.kind)) if np.isinf(PER_M[snapshot.material[s]])]
    corners = triangles_of(snapshot)
    with np.errstate(all="ignore"):
        for low in range(0, len(depth), BEAMS_AT_ONCE):
            part = slice(low, low + BEAMS_AT_ONCE)
            o, d, t = (array[part] for array in rays)
            for s in solids:
                _keep(depth[part], winner[part], solid_interval(snapshot, s, o, d, t)[0], s)
            ground = triangle_depths(corners, o, d)
            _keep(depth[part], winner[part], np.where(ground > NEAREST_M, ground, np.inf).min(axis=0), -1)
    beyond = depth > max_range_m
    depth[beyond], winner[beyond] = np.inf, -2
    return depth, winner


def _keep(depth: F64, winner: NDArray[np.int64], t: F64, index: int) -> None:
    better = (t > NEAREST_M) & (t < depth)
    depth[better], winner[better] = t[better], index
