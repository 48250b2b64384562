"""The loops of the ray caster: each solid is tested against the beams that might meet it, with exact intersections."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed_lab.sim.raycast._inputs import BLOCK, DRAWS
from viewshed_lab.sim.raycast._windows import solid_window

_NEAR_M = 1e-3
"""A beam stops no nearer than this: one that starts on a surface leaves it."""

_TINY = 1e-20
"""Keeps the length of a beam along a cylinder's axis, seen from its end, from being 0."""


@njit(cache=True, nogil=True, error_model="numpy")
def cast_solids(beams: Any, solids: Any, view: Any, draws: Any, nearest: Any) -> None:
    """Test every solid against the beams that may meet it, and keep the nearest stops.

    Args:
        beams: :class:`~viewshed_lab.sim.raycast._inputs.Beams`.
        solids: :class:`~viewshed_lab.sim.raycast._inputs.Solids`.
        view: :class:`~viewshed_lab.sim.raycast._inputs.View`.
        draws: (DRAWS,) float32 exponential free paths of mean 1.
        nearest: :class:`~viewshed_lab.sim.raycast._inputs.Nearest`, improved in place.
    """
    boxes, columns = solids.boxes, view.columns
    paths = np.empty(columns * BLOCK, np.float32)
    corners, local = np.empty((2, 8)), np.empty(18, np.float32)
    for s in range(boxes.shape[0]):
        # The window of beams that point at the box around the solid, wherever it moves within the revolution.
        drift_m = _speed(boxes, s, view.velocity) * view.half_period_s
        start, count, first, last = solid_window(boxes, s, view, drift_m, corners)
        if first >= last:
            continue
        _local_frame(boxes, s, view, local)
        per_m, kind = solids.per_m[s], solids.kinds[s]
        opaque = np.isinf(per_m)
        start %= columns
        # Two runs where the window crosses the last column.
        for run in range(2):
            low, high = (start, min(start + count, columns)) if run == 0 else (0, start + count - columns)
            for block in range(first, last if high > low else first):
                base, many = np.uint64((block * columns + low) * BLOCK), np.uint64((high - low) * BLOCK)
                if not opaque:
                    _draw_paths(base, many, np.float32(1.0 / per_m), solids.salts[s], draws, paths)
                # One loop for each kind, so that none has a branch.
                if kind == 0 and opaque:
                    _opaque_boxes(beams, local, base, many, s, nearest)
                elif opaque:
                    _opaque_rounds(beams, local, base, many, s, kind == 1, nearest)
                elif kind == 0:
                    _box_volumes(beams, local, base, many, s, paths, nearest)
                else:
                    _round_volumes(beams, local, base, many, s, kind == 1, paths, nearest)


@njit(cache=True, nogil=True, error_model="numpy")
def _speed(boxes: Any, s: Any, velocity: Any) -> Any:
    """Return how fast a solid moves, seen from the sensor."""
    x, y, z = boxes[s, 5, 0] - velocity[0], boxes[s, 5, 1] - velocity[1], boxes[s, 5, 2] - velocity[2]
    return np.sqrt(x**2 + y**2 + z**2)


@njit(cache=True, nogil=True, error_model="numpy")
def _local_frame(boxes: Any, s: Any, view: Any, local: Any) -> None:
    """Store rotation (9), sensor (3), the sensor's axis (3) and velocity (3) in units of the solid's half sizes.

    In those units every solid is a cube, a cylinder or a ball of half size 1 about the origin.
    """
    for k in range(3):
        position, along, moving, half = 0.0, 0.0, 0.0, boxes[s, 4, k]
        for n in range(3):
            turn = boxes[s, 1 + n, k]
            local[3 * k + n] = turn / half
            position -= turn * boxes[s, 0, n]
            along += turn * view.rotation[n, 2]
            moving -= turn * (boxes[s, 5, n] - view.velocity[n])
        local[9 + k], local[12 + k], local[15 + k] = position / half, along / half, moving / half


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _ray(beams: Any, i: Any, m: Any) -> Any:
    """Return start and direction of beam ``i`` in units of the solid's half sizes."""
    x, y, z, rise, time = beams.x[i], beams.y[i], beams.z[i], beams.rise[i], beams.time[i]
    p = m[9] + rise * m[12] + time * m[15]
    q = m[10] + rise * m[13] + time * m[16]
    r = m[11] + rise * m[14] + time * m[17]
    u, v, w = m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z
    return p, q, r, u, v, w


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _between_slabs(p: Any, q: Any, r: Any, u: Any, v: Any, w: Any) -> Any:
    """Depths at which a beam enters and leaves a cube of half size 1 (slabs, Kay and Kajiya 1986)."""
    n0, f0 = _slab(p, u)
    n1, f1 = _slab(q, v)
    n2, f2 = _slab(r, w)
    enter, leave = (n0 if n0 > n1 else n1), (f0 if f0 < f1 else f1)
    return (enter if enter > n2 else n2), (leave if leave < f2 else f2)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _slab(start: Any, direction: Any) -> Any:
    """Depths at which a coordinate enters and leaves [-1, 1]; along it they are infinite."""
    per = np.float32(1.0) / direction
    a, b = (np.float32(-1.0) - start) * per, (np.float32(1.0) - start) * per
    return (a if a < b else b), (b if a < b else a)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _between_sides(p: Any, q: Any, r: Any, u: Any, v: Any, w: Any, flat: Any) -> Any:
    """Depths at which a beam enters and leaves a cylinder (``flat``) or a ball of radius 1.

    Roots of |o + t d|² = 1 from the distance of the line to the middle, |o × d| / |d|, which does not cancel; a
    cylinder leaves z out and is cut by its ends.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    keep = zero if flat else one
    e, g = w * keep, r * keep
    cu, cv, cw = q * e - g * v, g * u - p * e, p * v - q * u
    length2 = u * u + v * v + e * e + np.float32(_TINY)
    root2 = length2 - (cu * cu + cv * cv + cw * cw)
    per = one / length2
    middle, reach = -(p * u + q * v + g * e) * per, np.sqrt(root2 if root2 > zero else zero) * per
    below, above = _slab(r, w)
    low, high = (below, above) if flat else (middle - reach, middle + reach)
    enter = middle - reach if middle - reach > low else low
    leave = middle + reach if middle + reach < high else high
    return enter, (leave if root2 > zero else np.float32(-1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def _opaque_boxes(beams: Any, local: Any, base: Any, many: Any, s: Any, nearest: Any) -> None:
    """Stop beams ``base`` to ``base + many`` where they enter box ``s``."""
    depth, winner = nearest.depth, nearest.winner
    for n in range(many):
        i = base + n
        p, q, r, u, v, w = _ray(beams, i, local)
        near, far = _between_slabs(p, q, r, u, v, w)
        hit = (near <= far) & (near > np.float32(_NEAR_M)) & (near < depth[i])
        depth[i] = near if hit else depth[i]
        winner[i] = np.int32(s) if hit else winner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _opaque_rounds(beams: Any, local: Any, base: Any, many: Any, s: Any, flat: Any, nearest: Any) -> None:
    """Stop beams ``base`` to ``base + many`` where they enter cylinder (``flat``) or ellipsoid ``s``."""
    depth, winner = nearest.depth, nearest.winner
    for n in range(many):
        i = base + n
        p, q, r, u, v, w = _ray(beams, i, local)
        near, far = _between_sides(p, q, r, u, v, w, flat)
        hit = (near <= far) & (near > np.float32(_NEAR_M)) & (near < depth[i])
        depth[i] = near if hit else depth[i]
        winner[i] = np.int32(s) if hit else winner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _box_volumes(beams: Any, local: Any, base: Any, many: Any, s: Any, paths: Any, nearest: Any) -> None:
    """Stop beams their free path into box ``s``, unless they leave it before."""
    depth, winner = nearest.depth, nearest.winner
    for n in range(many):
        i = base + n
        p, q, r, u, v, w = _ray(beams, i, local)
        near, far = _between_slabs(p, q, r, u, v, w)
        t = (near if near > np.float32(0.0) else np.float32(0.0)) + paths[n]
        hit = (near <= far) & (t <= far) & (t > np.float32(_NEAR_M)) & (t < depth[i])
        depth[i] = t if hit else depth[i]
        winner[i] = np.int32(s) if hit else winner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _round_volumes(beams: Any, local: Any, base: Any, many: Any, s: Any, flat: Any, paths: Any, nearest: Any) -> None:
    """Stop beams their free path into cylinder (``flat``) or ellipsoid ``s``, unless they leave it before."""
    depth, winner = nearest.depth, nearest.winner
    for n in range(many):
        i = base + n
        p, q, r, u, v, w = _ray(beams, i, local)
        near, far = _between_sides(p, q, r, u, v, w, flat)
        t = (near if near > np.float32(0.0) else np.float32(0.0)) + paths[n]
        hit = (near <= far) & (t <= far) & (t > np.float32(_NEAR_M)) & (t < depth[i])
        depth[i] = t if hit else depth[i]
        winner[i] = np.int32(s) if hit else winner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_paths(base: Any, many: Any, mean_m: Any, salt: Any, draws: Any, paths: Any) -> None:
    """Store how many meters beams from ``base`` on get into a volume, drawn by beam and volume."""
    tickets = paths.view(np.uint32)
    # Two loops: the hashes fill vector registers, the look-ups cannot.
    for n in range(many):
        tickets[n] = mixed(np.uint32(base + n), salt) & np.uint32(DRAWS - 1)
    for n in range(many):
        paths[n] = draws[tickets[n]] * mean_m


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def mixed(value: Any, salt: Any) -> Any:
    """Return 32 well-mixed bits of a counter and a salt (Wellons' lowbias32)."""
    h = np.uint32(value ^ salt)
    h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(0x7FEB352D))
    h = np.uint32((h ^ (h >> np.uint32(15))) * np.uint32(0x846CA68B))
    return np.uint32(h ^ (h >> np.uint32(16)))
