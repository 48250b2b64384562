"""The loops of the ray caster: each solid is tested against the beams that might meet it, with exact intersections.

Beams are stored in blocks of 16 rings, a block column after column, so that those that may meet a solid are runs
without gaps and their test, which has no branches, fills vector registers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.angles import atan2

BLOCK = 16
"""Rings are padded to a multiple of this."""
DRAWS = 4096
"""Free paths in the table of volumes; a power of two."""
_NEAR_M = 1e-3
_MARGIN = 2e-4
_TINY = 1e-20


@njit(cache=True, nogil=True, error_model="numpy")
def ring_blocks(slopes: Any, low: Any, high: Any) -> Any:  # pragma: no cover - compiled
    """Return the first block of rings, and the one after the last, that may lie between two slopes."""
    first, last = np.searchsorted(slopes, low), np.searchsorted(slopes, high)
    if first >= last:
        return 0, 0
    return first // BLOCK, (last - 1) // BLOCK + 1


@njit(cache=True, nogil=True, error_model="numpy")
def slopes_of(low_z: Any, high_z: Any, near: Any, far: Any) -> Any:  # pragma: no cover - compiled
    """Return bounds of z over horizontal range for heights in [low, high] and ranges in [near, far]."""
    near = max(near, 1e-3)
    low = low_z / near if low_z < 0 else low_z / far
    high = high_z / near if high_z > 0 else high_z / far
    return low - _MARGIN, high + _MARGIN


@njit(cache=True, nogil=True, error_model="numpy")
def column_range(sweep: Any, center: Any, low: Any, high: Any, columns: Any) -> Any:  # pragma: no cover - compiled
    """Return the first column and the number of columns whose azimuth may lie in center + [low, high]."""
    step, low_offset, high_offset = sweep
    if high - low >= np.pi - 0.01:
        return 0, columns
    start = int(np.floor((center + low - high_offset - _MARGIN + np.pi) / step - 0.5))
    stop = int(np.ceil((center + high - low_offset + _MARGIN + np.pi) / step - 0.5)) + 1
    return start, min(stop - start, columns)


@njit(cache=True, nogil=True, error_model="numpy")
def _solid_window(solid: Any, pose: Any, sweep: Any, slopes: Any, limits: Any) -> Any:  # pragma: no cover - compiled
    """Return first column, number of columns, first block and last of the beams that may meet an oriented box."""
    center, turn, half = solid
    columns, max_range, drift, lift, slack = limits
    away = np.sqrt(center[0] ** 2 + center[1] ** 2 + center[2] ** 2)
    if away - np.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2) - drift > max_range:
        return 0, 0, 0, 0
    x = pose[0, 0] * center[0] + pose[1, 0] * center[1] + pose[2, 0] * center[2]
    y = pose[0, 1] * center[0] + pose[1, 1] * center[1] + pose[2, 1] * center[2]
    z = pose[0, 2] * center[0] + pose[1, 2] * center[1] + pose[2, 2] * center[2]
    axes = np.empty((3, 3))
    inside = True
    apart2, flat2 = 0.0, 0.0
    for k in range(3):
        size = half[k] + drift
        local = turn[0, k] * center[0] + turn[1, k] * center[1] + turn[2, k] * center[2]
        gap = max(abs(local) - size, 0.0)
        apart2 += gap * gap
        flat2 += gap * gap if k < 2 else 0.0
        inside = inside and gap == 0.0
        for n in range(3):
            axes[k, n] = size * (pose[0, n] * turn[0, k] + pose[1, n] * turn[1, k] + pose[2, n] * turn[2, k])
    if inside:
        return 0, columns, 0, (slopes.shape[0] - 1) // BLOCK + 1
    middle = float(atan2(np.float32(y), np.float32(x)))
    cos, sin = np.cos(middle), np.sin(middle)
    low, high, far2 = 0.0, 0.0, 0.0
    for corner in range(8):
        s0, s1, s2 = 1.0 - 2.0 * (corner & 1), 1.0 - (corner & 2), 1.0 - (corner & 4) / 2
        u = x + s0 * axes[0, 0] + s1 * axes[1, 0] + s2 * axes[2, 0]
        v = y + s0 * axes[0, 1] + s1 * axes[1, 1] + s2 * axes[2, 1]
        turned = float(atan2(np.float32(v * cos - u * sin), np.float32(u * cos + v * sin)))
        low, high, far2 = min(low, turned), max(high, turned), max(far2, u * u + v * v)
    tall = abs(axes[0, 2]) + abs(axes[1, 2]) + abs(axes[2, 2]) + lift
    upright = pose[2, 2] > 0.999999 and turn[2, 2] > 0.999999
    tallest = max(abs(z - tall), abs(z + tall))
    near = np.sqrt(flat2) if upright else np.sqrt(max(apart2 - tallest * tallest, 0.0))
    low_slope, high_slope = slopes_of(z - tall, z + tall, near, np.sqrt(far2))
    first, last = ring_blocks(slopes, low_slope - slack, high_slope + slack)
    start, count = column_range(sweep, middle, low, high, columns)
    return start, count, first, last


@njit(cache=True, nogil=True, error_model="numpy")
def cast_solids(beams: Any, solids: Any, frame: Any, draws: Any, best: Any) -> None:  # pragma: no cover - compiled
    """Test every solid; ``best`` is depth and index of the nearest stop of each beam so far.

    Args:
        beams: x, y and z of the directions in world axes, start of the beam on the sensor's axis, and time, each
            (blocks · C · BLOCK).
        solids: centres from the sensor (S, 3), rotations, half sizes, kinds, velocities, stops per metre, salts.
        frame: the sensor's rotation, azimuth step and offsets, ascending slopes of the rings, limits (columns,
            maximum range, half the period, highest beam start, slack of slopes in a turn), velocity.
        draws: exponential free paths of mean 1.
        best: depth and index.
    """
    centers, turns, halves, kinds, velocities, per_m, salts = solids
    pose, sweep, slopes, limits, own = frame
    columns = limits[0]
    local = np.empty(18, np.float32)
    for s in range(centers.shape[0]):
        speed = velocities[s] - own
        drift = np.sqrt(speed[0] ** 2 + speed[1] ** 2 + speed[2] ** 2) * limits[2]
        solid = (centers[s], turns[s], halves[s])
        start, count, first, last = _solid_window(
            solid, pose, sweep, slopes, (columns, limits[1], drift, limits[3], limits[4])
        )
        if first >= last:
            continue
        _local_frame(solid, speed, pose, local)
        start %= columns
        for run in range(2):
            low, high = (start, min(start + count, columns)) if run == 0 else (0, start + count - columns)
            for block in range(first, last if high > low else first):
                base = np.uint64((block * columns + low) * BLOCK)
                many = np.uint64((high - low) * BLOCK)
                shape = (base, many, kinds[s] == 1, s)
                if np.isinf(per_m[s]):
                    if kinds[s] == 0:
                        _opaque_boxes(beams, local, best, shape)
                    else:
                        _opaque_rounds(beams, local, best, shape)
                else:
                    chance = (np.float32(1.0 / per_m[s]), salts[s], draws)
                    if kinds[s] == 0:
                        _box_volumes(beams, local, best, shape, chance)
                    else:
                        _round_volumes(beams, local, best, shape, chance)


@njit(cache=True, nogil=True, error_model="numpy")
def _local_frame(solid: Any, speed: Any, pose: Any, local: Any) -> None:  # pragma: no cover - compiled
    """Store rotation (9), sensor (3), the sensor's axis (3) and velocity (3) in units of the solid's half sizes."""
    center, turn, half = solid
    for k in range(3):
        place, along, moving = 0.0, 0.0, 0.0
        for n in range(3):
            local[3 * k + n] = turn[n, k] / half[k]
            place -= turn[n, k] * center[n]
            along += turn[n, k] * pose[n, 2]
            moving -= turn[n, k] * speed[n]
        local[9 + k], local[12 + k], local[15 + k] = place / half[k], along / half[k], moving / half[k]


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
def _box_volumes(beams: Any, local: Any, best: Any, shape: Any, chance: Any) -> None:  # pragma: no cover - compiled
    depth, winner = best
    base, many, _, index = shape
    for n in range(many):
        i = base + n
        near, far = _between_slabs(_ray(beams, i, local))
        t = (near if near > np.float32(0.0) else np.float32(0.0)) + _free_path(i, chance)
        hit = (near <= far) & (t <= far) & (t > np.float32(_NEAR_M)) & (t < depth[i])
        depth[i] = t if hit else depth[i]
        winner[i] = np.int32(index) if hit else winner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _round_volumes(beams: Any, local: Any, best: Any, shape: Any, chance: Any) -> None:  # pragma: no cover - compiled
    depth, winner = best
    base, many, flat, index = shape
    for n in range(many):
        i = base + n
        near, far = _between_sides(_ray(beams, i, local), flat)
        t = (near if near > np.float32(0.0) else np.float32(0.0)) + _free_path(i, chance)
        hit = (near <= far) & (t <= far) & (t > np.float32(_NEAR_M)) & (t < depth[i])
        depth[i] = t if hit else depth[i]
        winner[i] = np.int32(index) if hit else winner[i]


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _free_path(i: Any, chance: Any) -> Any:  # pragma: no cover - compiled
    """Metres that beam ``i`` gets into a volume, drawn by beam and volume."""
    mean_m, salt, draws = chance
    return draws[mixed(np.uint32(i), salt) & np.uint32(DRAWS - 1)] * mean_m


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def mixed(value: Any, salt: Any) -> Any:  # pragma: no cover - compiled
    """Return 32 well-mixed bits of a counter and a salt (Wellons' lowbias32)."""
    h = np.uint32(value ^ salt)
    h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(0x7FEB352D))
    h = np.uint32((h ^ (h >> np.uint32(15))) * np.uint32(0x846CA68B))
    return np.uint32(h ^ (h >> np.uint32(16)))
