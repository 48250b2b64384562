"""The loops before and after the caster: beams in its order, and every stop again in double precision."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.sim.cast_kernels import BLOCK, DRAWS, mixed


@njit(cache=True, nogil=True, error_model="numpy")
def turn_beams(still: Any, turns: Any, starts: Any, direction: Any, origin: Any) -> None:  # pragma: no cover - compiled
    """Fill unit directions and starts (C, R, 3) in world axes.

    Args:
        still: directions (C, R, 3) in the sensor's frame.
        turns: ``world_from_sensor`` rotations (C, 3, 3).
        starts: shift of the column (C, 3), and height of ring k on the sensor's axis (R).
        direction: result.
        origin: result.
    """
    shifts, rises = starts
    for c in range(still.shape[0]):
        m, shift = turns[c], shifts[c]
        for k in range(still.shape[1]):
            x, y, z, rise = still[c, k, 0], still[c, k, 1], still[c, k, 2], rises[k]
            for n in range(3):
                direction[c, k, n] = m[n, 0] * x + m[n, 1] * y + m[n, 2] * z
                origin[c, k, n] = shift[n] + m[n, 2] * rise


@njit(cache=True, nogil=True, error_model="numpy")
def block_beams(direction: Any, rises: Any, times: Any, beams: Any) -> None:  # pragma: no cover - compiled
    """Store the beams in the order of the caster: blocks of rings, a block column after column."""
    columns, rings = direction.shape[0], direction.shape[1]
    for k in range(rings):
        base = (k // BLOCK) * columns * BLOCK + k % BLOCK
        for c in range(columns):
            i = base + c * BLOCK
            for n in range(3):
                beams[n][i] = direction[c, k, n]
            beams[3][i], beams[4][i] = rises[k], times[c]


@njit(cache=True, nogil=True, error_model="numpy")
def measure_stops(beams: Any, times: Any, solids: Any, ground: Any, best: Any, out: Any) -> None:  # pragma: no cover
    """Fill depth, thing, material and cosine of incidence (C, R) from the winners of the caster.

    ``beams`` are starts and directions (C, R, 3); ``ground`` is the lattice (x, y, z from the sensor), materials of the
    quads, free paths and maximum range.
    """
    centers, turns, halves, kinds, velocities, per_m, salts, things, materials = solids
    lattice, quad_material, draws, max_range = ground
    origin, direction = beams
    depth32, winner = best
    depth, thing, material, cosine = out
    planes = _planes(lattice)
    local = np.empty(6)
    columns, deep = depth.shape[0], quad_material.shape[1]
    for c in range(columns):
        for k in range(depth.shape[1]):
            i = ((k // BLOCK) * columns + c) * BLOCK + k % BLOCK
            s = winner[i]
            t, cos, met, made_of = np.inf, 0.0, -2, 0
            if s >= centers.shape[0]:
                triangle = s - centers.shape[0]
                t, cos = _on_ground(origin[c, k], direction[c, k], planes[triangle])
                met, made_of = -1, quad_material[triangle // 2 // deep, triangle // 2 % deep]
            elif s >= 0:
                _into(origin[c, k], direction[c, k], (centers[s], turns[s], velocities[s], times[c]), local)
                t, cos = _enter(local, halves[s], kinds[s], float(depth32[i]))
                if not np.isinf(per_m[s]):
                    path = float(draws[mixed(np.uint32(i), salts[s]) & np.uint32(DRAWS - 1)]) / per_m[s]
                    t, cos = max(t, 0.0) + path, 1.0
                met, made_of = things[s], materials[s]
            if t > max_range:
                t, cos, met, made_of = np.inf, 0.0, -2, 0
            depth[c, k], cosine[c, k], thing[c, k], material[c, k] = t, cos, met, made_of


@njit(cache=True, nogil=True, error_model="numpy")
def _planes(lattice: Any) -> Any:  # pragma: no cover - compiled
    """Return for every triangle a, b and c of z = a x + b y + c, and 1 / length of its normal (T, 4)."""
    xs, ys, zs = lattice
    planes = np.empty((2 * (xs.shape[0] - 1) * (ys.shape[0] - 1), 4))
    row = 0
    for i in range(xs.shape[0] - 1):
        for j in range(ys.shape[0] - 1):
            wide, deep = xs[i + 1] - xs[i], ys[j + 1] - ys[j]
            for upper in range(2):
                if upper == 0:
                    a, b = (zs[i + 1, j] - zs[i, j]) / wide, (zs[i + 1, j + 1] - zs[i + 1, j]) / deep
                else:
                    a, b = (zs[i + 1, j + 1] - zs[i, j + 1]) / wide, (zs[i, j + 1] - zs[i, j]) / deep
                planes[row, 0], planes[row, 1] = a, b
                planes[row, 2] = zs[i, j] - a * xs[i] - b * ys[j]
                planes[row, 3] = 1.0 / np.sqrt(1.0 + a * a + b * b)
                row += 1
    return planes


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _on_ground(o: Any, d: Any, plane: Any) -> Any:  # pragma: no cover - compiled
    a, b = plane[0], plane[1]
    fall = a * d[0] + b * d[1] - d[2]
    return (o[2] - a * o[0] - b * o[1] - plane[2]) / fall, abs(fall) * plane[3]


@njit(cache=True, nogil=True, error_model="numpy")
def _into(origin: Any, direction: Any, solid: Any, local: Any) -> None:  # pragma: no cover - compiled
    """Store start and direction (6) of a beam in the frame of a solid."""
    center, turn, velocity, time = solid
    x = origin[0] - center[0] - velocity[0] * time
    y = origin[1] - center[1] - velocity[1] * time
    z = origin[2] - center[2] - velocity[2] * time
    for k in range(3):
        local[k] = turn[0, k] * x + turn[1, k] * y + turn[2, k] * z
        local[3 + k] = turn[0, k] * direction[0] + turn[1, k] * direction[1] + turn[2, k] * direction[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _enter(local: Any, half: Any, kind: Any, t32: Any) -> Any:  # pragma: no cover - compiled
    """Depth at which the beam enters the solid, and its cosine there; ``t32`` where rounding makes it miss."""
    if kind == 0:
        return _enter_box(local, half, t32)
    a, b, c, cos = 0.0, 0.0, -1.0, 0.0
    for k in range(2 if kind == 1 else 3):
        o, d = local[k] / half[k], local[3 + k] / half[k]
        a, b, c = a + d * d, b + o * d, c + o * o
    root2 = b * b - a * c
    t = t32 if kind == 2 else -np.inf
    if root2 >= 0.0 and a > 0.0:
        t = (-b - np.sqrt(root2)) / a
    if kind == 1 and local[5] != 0.0:
        cap = (-local[2] - np.copysign(half[2], local[5])) / local[5]
        if cap > t:
            return cap, abs(local[5])
    length2 = 0.0
    for k in range(2 if kind == 1 else 3):
        normal = (local[k] + t * local[3 + k]) / (half[k] * half[k])
        cos, length2 = cos + normal * local[3 + k], length2 + normal * normal
    return t, min(abs(cos) / np.sqrt(length2 + 1e-30), 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _enter_box(local: Any, half: Any, t32: Any) -> Any:  # pragma: no cover - compiled
    near, cos = -np.inf, 1.0
    for k in range(3):
        if local[3 + k] != 0.0:
            t = (-local[k] - np.copysign(half[k], local[3 + k])) / local[3 + k]
            if t > near:
                near, cos = t, abs(local[3 + k])
    return (near, cos) if np.isfinite(near) else (t32, cos)
