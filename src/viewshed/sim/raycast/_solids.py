"""The loops of the ray caster: each solid is tested against the beams that might meet it, with exact intersections.

Beams are stored in blocks of 16 rings, a block column after column, so that those that may meet a solid are runs
without gaps and their test, which has no branches, fills vector registers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.sim.raycast._windows import BLOCK, solid_window

DRAWS = 4096
"""Free paths in the table of volumes; a power of two."""

_NEAR_M = 1e-3

_TINY = 1e-20


@njit(cache=True, nogil=True, error_model="numpy")
def cast_solids(beams: Any, solids: Any, frame: Any, draws: Any, best: Any) -> None:  # pragma: no cover - compiled
    """Test every solid; ``best`` is depth and index of the nearest stop of each beam so far.

    Args:
        beams: x, y and z of the directions in world axes, start of the beam on the sensor's axis, and time, each
            (blocks · C · BLOCK).
        solids: center from the sensor, three rows of the rotation, half sizes and velocity (S, 6, 3); kinds, stops per
            meter, salts (S,).
        frame: the sensor's rotation, azimuth step and offsets, ascending slopes of the rings, limits (columns,
            maximum range, half the period, highest beam start, slack of slopes in a turn), velocity.
        draws: exponential free paths of mean 1.
        best: depth and index.
    """
    boxes, kinds, per_m, salts = solids
    pose, sweep, slopes, limits, own = frame
    columns, paths = limits[0], np.empty(limits[0] * BLOCK, np.float32)
    seen, local = np.empty((2, 8)), np.empty(18, np.float32)
    for s in range(boxes.shape[0]):
        drift = _speed(boxes, s, own) * limits[2]
        start, count, first, last = solid_window(boxes, s, pose, slopes, (sweep, limits, drift), seen)
        if first >= last:
            continue
        _local_frame(boxes, s, pose, own, local)
        start %= columns
        for run in range(2):
            low, high = (start, min(start + count, columns)) if run == 0 else (0, start + count - columns)
            for block in range(first, last if high > low else first):
                base, many = np.uint64((block * columns + low) * BLOCK), np.uint64((high - low) * BLOCK)
                shape = (base, many, kinds[s] == 1, s)
                if not np.isinf(per_m[s]):
                    _draw_paths(base, many, (np.float32(1.0 / per_m[s]), salts[s]), draws, paths)
                _cast_solid(beams, local, best, shape, (kinds[s] == 0, np.isinf(per_m[s])), paths)


@njit(cache=True, nogil=True, error_model="numpy")
def _speed(boxes: Any, s: Any, own: Any) -> Any:  # pragma: no cover - compiled
    """Return how fast a solid moves, seen from the sensor."""
    x, y, z = boxes[s, 5, 0] - own[0], boxes[s, 5, 1] - own[1], boxes[s, 5, 2] - own[2]
    return np.sqrt(x**2 + y**2 + z**2)


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_solid(
    beams: Any, local: Any, best: Any, shape: Any, made: Any, paths: Any
) -> None:  # pragma: no cover - compiled
    """Test the beams of a run; ``made`` is whether the solid is a box and whether it is opaque."""
    box, opaque = made
    if box and opaque:
        _opaque_boxes(beams, local, best, shape)
    elif opaque:
        _opaque_rounds(beams, local, best, shape)
    elif box:
        _box_volumes(beams, local, best, shape, paths)
    else:
        _round_volumes(beams, local, best, shape, paths)


@njit(cache=True, nogil=True, error_model="numpy")
def _local_frame(boxes: Any, s: Any, pose: Any, own: Any, local: Any) -> None:  # pragma: no cover - compiled
    """Store rotation (9), sensor (3), the sensor's axis (3) and velocity (3) in units of the solid's half sizes."""
    for k in range(3):
        place, along, moving, half = 0.0, 0.0, 0.0, boxes[s, 4, k]
        for n in range(3):
            turn = boxes[s, 1 + n, k]
            local[3 * k + n] = turn / half
            place -= turn * boxes[s, 0, n]
            along += turn * pose[n, 2]
            moving -= turn * (boxes[s, 5, n] - own[n])
        local[9 + k], local[12 + k], local[15 + k] = place / half, along / half, moving / half


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _ray(beams: Any, i: Any, m: Any) -> Any:  # pragma: no cover - compiled
    """Return start and direction of beam ``i`` in units of the solid's half sizes."""
    x, y, z, rise, time = beams[0][i], beams[1][i], beams[2][i], beams[3][i], beams[4][i]
    p = m[9] + rise * m[12] + time * m[15]
    q = m[10] + rise * m[13] + time * m[16]
    r = m[11] + rise * m[14] + time * m[17]
    u, v, w = m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z
    return p, q, r, u, v, w


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _between_slabs(ray: Any) -> Any:  # pragma: no cover - compiled
    """Depths at which a beam enters and leaves a cube of half size 1 (slabs, Kay and Kajiya 1986)."""
    p, q, r, u, v, w = ray
    n0, f0 = _slab(p, u)
    n1, f1 = _slab(q, v)
    n2, f2 = _slab(r, w)
    enter, leave = (n0 if n0 > n1 else n1), (f0 if f0 < f1 else f1)
    return (enter if enter > n2 else n2), (leave if leave < f2 else f2)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _slab(start: Any, direction: Any) -> Any:  # pragma: no cover - compiled
    """Depths at which a coordinate enters and leaves [-1, 1]; along it they are infinite."""
    per = np.float32(1.0) / direction
    a, b = (np.float32(-1.0) - start) * per, (np.float32(1.0) - start) * per
    return (a if a < b else b), (b if a < b else a)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _between_sides(ray: Any, flat: Any) -> Any:  # pragma: no cover - compiled
    """Depths at which a beam enters and leaves a cylinder (``flat``) or a ball of radius 1.

    Roots of |o + t d|² = 1 from the distance of the line to the middle, |o × d| / |d|, which does not cancel; a
    cylinder leaves z out and is cut by its ends.
    """
    p, q, r, u, v, w = ray
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
def _opaque_boxes(beams: Any, local: Any, best: Any, shape: Any) -> None:  # pragma: no cover - compiled
    depth, winner = best
    base, many, _, index = shape
    for n in range(many):
        i = base + n
        near, far = _between_slabs(_ray(beams, i, local))
        hit = (near <= far) & (near > np.float32(_NEAR_M)) & (near < depth[i])
        depth[i] = near if hit else depth[i]
        winner[i] = np.int32(index) if hit else winner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _opaque_rounds(beams: Any, local: Any, best: Any, shape: Any) -> None:  # pragma: no cover - compiled
    depth, winner = best
    base, many, flat, index = shape
    for n in range(many):
        i = base + n
        near, far = _between_sides(_ray(beams, i, local), flat)
        hit = (near <= far) & (near > np.float32(_NEAR_M)) & (near < depth[i])
        depth[i] = near if hit else depth[i]
        winner[i] = np.int32(index) if hit else winner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _box_volumes(beams: Any, local: Any, best: Any, shape: Any, paths: Any) -> None:  # pragma: no cover - compiled
    depth, winner = best
    base, many, _, index = shape
    for n in range(many):
        i = base + n
        near, far = _between_slabs(_ray(beams, i, local))
        t = (near if near > np.float32(0.0) else np.float32(0.0)) + paths[n]
        hit = (near <= far) & (t <= far) & (t > np.float32(_NEAR_M)) & (t < depth[i])
        depth[i] = t if hit else depth[i]
        winner[i] = np.int32(index) if hit else winner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _round_volumes(beams: Any, local: Any, best: Any, shape: Any, paths: Any) -> None:  # pragma: no cover - compiled
    depth, winner = best
    base, many, flat, index = shape
    for n in range(many):
        i = base + n
        near, far = _between_sides(_ray(beams, i, local), flat)
        t = (near if near > np.float32(0.0) else np.float32(0.0)) + paths[n]
        hit = (near <= far) & (t <= far) & (t > np.float32(_NEAR_M)) & (t < depth[i])
        depth[i] = t if hit else depth[i]
        winner[i] = np.int32(index) if hit else winner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_paths(base: Any, many: Any, chance: Any, draws: Any, paths: Any) -> None:  # pragma: no cover - compiled
    """Store how many meters beams from ``base`` on get into a volume, drawn by beam and volume."""
    mean_m, salt = chance
    tickets = paths.view(np.uint32)
    for n in range(many):
        tickets[n] = mixed(np.uint32(base + n), salt) & np.uint32(DRAWS - 1)
    for n in range(many):
        paths[n] = draws[tickets[n]] * mean_m


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def mixed(value: Any, salt: Any) -> Any:  # pragma: no cover - compiled
    """Return 32 well-mixed bits of a counter and a salt (Wellons' lowbias32)."""
    h = np.uint32(value ^ salt)
    h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(0x7FEB352D))
    h = np.uint32((h ^ (h >> np.uint32(15))) * np.uint32(0x846CA68B))
    return np.uint32(h ^ (h >> np.uint32(16)))
