"""Compiled loops of the ray caster.

Each solid and each triangle of the ground is tested against the window of beams that may hit its bounding box: a range
of columns, and blocks of rings. Hits are then recomputed in double precision.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed_lab._numba import atan2

BLOCK = 16
"""Rings are padded to a multiple of this."""

DRAWS = 4096
"""Size of the table of free paths in volumes; a power of two."""


class Beams(NamedTuple):
    """B = blocks · C · BLOCK beams, float32: blocks of 16 rings, within a block column by column (:func:`beam_number`).

    In this order the beams that may hit a solid are contiguous runs, and branch-free tests are vectorized.
    """

    x: NDArray[np.float32]  # (B,) of the unit direction, in world axes
    y: NDArray[np.float32]  # (B,) as ``x``
    z: NDArray[np.float32]  # (B,) as ``x``
    rise: NDArray[np.float32]  # (B,) start of the beam on the sensor's axis, meters
    time: NDArray[np.float32]  # (B,) seconds from the middle of the revolution


class Solids(NamedTuple):
    """S boxes, cylinders and ellipsoids, at the middle of the revolution."""

    # (S, 6, 3) center from the sensor, three rows of the rotation ``world_from_shape``, half sizes, velocity
    boxes: NDArray[np.float64]
    kinds: NDArray[np.uint8]  # (S,) ``BOX``, ``CYLINDER`` or ``ELLIPSOID``
    per_m: NDArray[np.float32]  # (S,) stops per meter of path; infinite for opaque solids
    salts: NDArray[np.uint32]  # (S,) uint32, so that the free paths of two volumes differ
    things: NDArray[np.int32]  # (S,) int32 index of the solid's thing
    materials: NDArray[np.uint8]  # (S,) uint8 rows of ``MATERIALS``


class Ground(NamedTuple):
    """A lattice of quads of two triangles each, relative to the sensor, in world axes."""

    x: NDArray[np.float64]  # (nx,) of the nodes
    y: NDArray[np.float64]  # (ny,) of the nodes
    z: NDArray[np.float64]  # (nx, ny) of the nodes
    material: NDArray[np.uint8]  # (nx - 1, ny - 1) uint8 of the quads


class View(NamedTuple):
    """Orientation, beam bounds and motion of the sensor."""

    rotation: NDArray[np.float64]  # (3, 3) ``world_from_sensor`` at the middle of the revolution
    step: float  # azimuth from column to column, radians
    low_offset: float  # smallest azimuth offset of a beam from its column, including the yaw within the revolution
    high_offset: float  # largest one
    slopes: NDArray[np.float64]  # (R,) ascending tangents of the elevations
    columns: int  # C
    max_range_m: float  # largest range of a hit
    half_period_s: float  # half the duration of the revolution
    lift_m: float  # largest distance of a beam's start from the sensor's position
    slack: float  # largest change of slopes by the yaw of a tilted sensor
    velocity: NDArray[np.float64]  # (3,) of the sensor


class Nearest(NamedTuple):
    """The nearest hit of each beam so far."""

    depth: NDArray[np.float32]  # (B,) float32 meters, +inf for none
    winner: NDArray[np.int32]  # (B,) int32 solid, S + triangle of the ground, or -1


_MARGIN = 2e-4
"""Margin of windows, in radians and in slopes: larger than the error of single precision."""


@njit(cache=True, nogil=True, error_model="numpy")
def _length(vector: Any) -> Any:
    return np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def solid_window(boxes: Any, s: Any, view: Any, drift_m: Any, corners: Any) -> Any:
    """Return first column, number of columns, first and end block of the beams that may hit solid ``s``.

    The solid is widened by ``drift_m``, its movement relative to the sensor within half the period; ``corners`` (2, 8)
    is scratch memory.
    """
    if _length(boxes[s, 0]) - _length(boxes[s, 4]) - drift_m > view.max_range_m:
        return 0, 0, 0, 0
    inside, apart2, flat2 = _gaps(boxes, s, drift_m)
    if inside:
        return 0, view.columns, 0, (view.slopes.shape[0] - 1) // BLOCK + 1
    x, y, z, tall, far2 = _corners(boxes, s, view.rotation, drift_m, corners)
    tall += view.lift_m
    # The smallest horizontal range: horizontal distance if both are upright, else from distance and height.
    upright = view.rotation[2, 2] > 0.999999 and boxes[s, 3, 2] > 0.999999
    tallest = max(abs(z - tall), abs(z + tall))
    near = np.sqrt(flat2) if upright else np.sqrt(max(apart2 - tallest * tallest, 0.0))
    low_slope, high_slope = slopes_of(z - tall, z + tall, near, np.sqrt(far2))
    first, last = ring_blocks(view.slopes, low_slope - view.slack, high_slope + view.slack)
    if first >= last:
        return 0, 0, 0, 0
    middle = float(atan2(np.float32(y), np.float32(x)))
    low, high = spread(corners, np.cos(middle), np.sin(middle))
    start, count = column_range(view, middle, low, high)
    return start, count, first, last


@njit(cache=True, nogil=True, error_model="numpy")
def _gaps(boxes: Any, s: Any, drift_m: Any) -> Any:
    """Return whether the sensor is in an oriented box, and the squares of its distance, in 3D and horizontally."""
    inside, apart2, flat2 = True, 0.0, 0.0
    for k in range(3):
        local = boxes[s, 1, k] * boxes[s, 0, 0] + boxes[s, 2, k] * boxes[s, 0, 1] + boxes[s, 3, k] * boxes[s, 0, 2]
        gap = max(abs(local) - (boxes[s, 4, k] + drift_m), 0.0)
        apart2 += gap * gap
        flat2 += gap * gap if k < 2 else 0.0
        inside = inside and gap == 0.0
    return inside, apart2, flat2


@njit(cache=True, nogil=True, error_model="numpy")
def _corners(boxes: Any, s: Any, rotation: Any, drift_m: Any, corners: Any) -> Any:
    """Store x and y of the corners (2, 8) in the sensor's frame; return the center, half the height, and far².

    ``far`` is the largest horizontal range of a corner.
    """
    x, y, z = _into_sensor(boxes[s, 0, 0], boxes[s, 0, 1], boxes[s, 0, 2], rotation)
    tall, far2 = 0.0, 0.0
    for corner in range(8):
        corners[0, corner], corners[1, corner] = x, y
    for k in range(3):
        # One half axis of the box, in the sensor's frame; bit k of a corner's number is its sign.
        size = boxes[s, 4, k] + drift_m
        a, b, c = _into_sensor(boxes[s, 1, k], boxes[s, 2, k], boxes[s, 3, k], rotation)
        tall += abs(size * c)
        for corner in range(8):
            sign = 1.0 - 2.0 * ((corner >> k) & 1)
            corners[0, corner] += sign * (size * a)
            corners[1, corner] += sign * (size * b)
    for corner in range(8):
        far2 = max(far2, corners[0, corner] * corners[0, corner] + corners[1, corner] * corners[1, corner])
    return x, y, z, tall, far2


@njit(cache=True, nogil=True, error_model="numpy")
def _into_sensor(a: Any, b: Any, c: Any, rotation: Any) -> Any:
    """Return a vector in the sensor's frame."""
    x = rotation[0, 0] * a + rotation[1, 0] * b + rotation[2, 0] * c
    y = rotation[0, 1] * a + rotation[1, 1] * b + rotation[2, 1] * c
    return x, y, rotation[0, 2] * a + rotation[1, 2] * b + rotation[2, 2] * c


@njit(cache=True, nogil=True, error_model="numpy")
def spread(corners: Any, cos: Any, sin: Any) -> Any:
    """Return the smallest and the largest azimuth of corners (2, n) relative to a direction."""
    low, high = 0.0, 0.0
    for corner in range(corners.shape[1]):
        u, v = corners[0, corner], corners[1, corner]
        turned = float(atan2(np.float32(v * cos - u * sin), np.float32(u * cos + v * sin)))
        low, high = min(low, turned), max(high, turned)
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def ring_blocks(slopes: Any, low: Any, high: Any) -> Any:
    """Return the first block of rings, and the one after the last, that may have slopes between two bounds."""
    first, last = np.searchsorted(slopes, low), np.searchsorted(slopes, high)
    if first >= last:
        return 0, 0
    return first // BLOCK, (last - 1) // BLOCK + 1


@njit(cache=True, nogil=True, error_model="numpy")
def slopes_of(low_z: Any, high_z: Any, near: Any, far: Any) -> Any:
    """Return bounds of z over horizontal range for heights in [low, high] and ranges in [near, far]."""
    near = max(near, 1e-3)
    low = low_z / near if low_z < 0 else low_z / far
    high = high_z / near if high_z > 0 else high_z / far
    return low - _MARGIN, high + _MARGIN


@njit(cache=True, nogil=True, error_model="numpy")
def column_range(view: Any, center: Any, low: Any, high: Any) -> Any:
    """Return the first column and the number of columns whose azimuth may lie in center + [low, high]."""
    if high - low >= np.pi - 0.01:
        return 0, view.columns
    start = int(np.floor((center + low - view.high_offset - _MARGIN + np.pi) / view.step - 0.5))
    stop = int(np.ceil((center + high - view.low_offset + _MARGIN + np.pi) / view.step - 0.5)) + 1
    return start, min(stop - start, view.columns)


_NEAR_M = 1e-3
"""Smallest depth of a hit, so that a beam that starts on a surface leaves it."""

_TINY = 1e-20
"""Added to the squared length of a beam's projection, which is 0 along a cylinder's axis."""


@njit(cache=True, nogil=True, error_model="numpy")
def cast_solids(beams: Any, solids: Any, view: Any, draws: Any, nearest: Any) -> None:
    """Test every solid against the beams that may hit it, and keep the nearest hits.

    Args:
        beams: :class:`Beams`.
        solids: :class:`Solids`.
        view: :class:`View`.
        draws: (DRAWS,) float32 exponential free paths of mean 1.
        nearest: :class:`Nearest`, updated in place.
    """
    boxes, columns = solids.boxes, view.columns
    paths, none = np.empty(columns * BLOCK, np.float32), np.zeros(columns * BLOCK, np.float32)
    corners, local = np.empty((2, 8)), np.empty(18, np.float32)
    for s in range(boxes.shape[0]):
        # The window of beams that may point at the solid's bounding box, including its movement.
        drift_m = _length(boxes[s, 5] - view.velocity) * view.half_period_s
        start, count, first, last = solid_window(boxes, s, view, drift_m, corners)
        if first >= last:
            continue
        _local_frame(boxes, s, view, local)
        per_m, kind = solids.per_m[s], solids.kinds[s]
        opaque = np.isinf(per_m)
        start %= columns
        # Two runs if the window crosses the last column.
        for run in range(2):
            low, high = (start, min(start + count, columns)) if run == 0 else (0, start + count - columns)
            for block in range(first, last if high > low else first):
                base, size = np.uint64((block * columns + low) * BLOCK), np.uint64((high - low) * BLOCK)
                if not opaque:
                    _draw_paths(base, size, np.float32(1.0 / per_m), solids.salts[s], draws, paths)
                # One branch-free loop per kind; the free path into opaque solids is 0.
                into = none if opaque else paths
                if kind == 0:
                    _stop_in_box(beams, local, base, size, s, into, nearest)
                else:
                    _stop_in_round(beams, local, base, size, s, kind == 1, into, nearest)


@njit(cache=True, nogil=True, error_model="numpy")
def _local_frame(boxes: Any, s: Any, view: Any, local: Any) -> None:
    """Store rotation (9), sensor (3), the sensor's axis (3) and velocity (3) in units of the solid's half sizes.

    In these units every solid is a cube, a cylinder or a ball of half size 1 around the origin.
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
    """Return the depths at which a beam enters and leaves a cube of half size 1 (slabs, Kay and Kajiya 1986)."""
    n0, f0 = _slab(p, u)
    n1, f1 = _slab(q, v)
    n2, f2 = _slab(r, w)
    enter, leave = (n0 if n0 > n1 else n1), (f0 if f0 < f1 else f1)
    return (enter if enter > n2 else n2), (leave if leave < f2 else f2)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _slab(start: Any, direction: Any) -> Any:
    """Return the depths at which a coordinate enters and leaves [-1, 1]; infinite if it does not change."""
    per = np.float32(1.0) / direction
    a, b = (np.float32(-1.0) - start) * per, (np.float32(1.0) - start) * per
    return (a if a < b else b), (b if a < b else a)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _between_sides(p: Any, q: Any, r: Any, u: Any, v: Any, w: Any, flat: Any) -> Any:
    """Return the depths at which a beam enters and leaves a cylinder (``flat``) or a ball of radius 1.

    The roots of |o + t d|² = 1 are computed from the line's distance to the center, |o × d| / |d|, which avoids
    cancellation; a cylinder ignores z and is cut by its ends.
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
def _stop_in_box(beams: Any, local: Any, base: Any, size: Any, s: Any, paths: Any, nearest: Any) -> None:
    """Hit box ``s`` at the free path beyond its surface, unless the beam leaves it before."""
    depth, winner = nearest.depth, nearest.winner
    for n in range(size):
        i = base + n
        p, q, r, u, v, w = _ray(beams, i, local)
        near, far = _between_slabs(p, q, r, u, v, w)
        t = (near if near > np.float32(0.0) else np.float32(0.0)) + paths[n]
        hit = (near <= far) & (t <= far) & (t > np.float32(_NEAR_M)) & (t < depth[i])
        depth[i] = t if hit else depth[i]
        winner[i] = np.int32(s) if hit else winner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _stop_in_round(beams: Any, local: Any, base: Any, size: Any, s: Any, flat: Any, paths: Any, nearest: Any) -> None:
    """Hit cylinder (``flat``) or ellipsoid ``s`` like :func:`_stop_in_box`."""
    depth, winner = nearest.depth, nearest.winner
    for n in range(size):
        i = base + n
        p, q, r, u, v, w = _ray(beams, i, local)
        near, far = _between_sides(p, q, r, u, v, w, flat)
        t = (near if near > np.float32(0.0) else np.float32(0.0)) + paths[n]
        hit = (near <= far) & (t <= far) & (t > np.float32(_NEAR_M)) & (t < depth[i])
        depth[i] = t if hit else depth[i]
        winner[i] = np.int32(s) if hit else winner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_paths(base: Any, size: Any, mean_m: Any, salt: Any, draws: Any, paths: Any) -> None:
    """Store the free paths in a volume of beams from ``base`` on, meters, random by beam and volume."""
    rows = paths.view(np.uint32)
    # Two loops: the hashes are vectorized, the lookups cannot be.
    for n in range(size):
        rows[n] = mixed(np.uint32(base + n), salt) & np.uint32(DRAWS - 1)
    for n in range(size):
        paths[n] = draws[rows[n]] * mean_m


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def mixed(value: Any, salt: Any) -> Any:
    """Return 32 well-mixed bits of a counter and a salt (Wellons' lowbias32)."""
    h = np.uint32(value ^ salt)
    h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(0x7FEB352D))
    h = np.uint32((h ^ (h >> np.uint32(15))) * np.uint32(0x846CA68B))
    return np.uint32(h ^ (h >> np.uint32(16)))


_EDGE = 1e-5
"""Share of a quad by which its triangles overlap their neighbors, so that no beam passes between two."""


@njit(cache=True, nogil=True, error_model="numpy")
def cast_terrain(beams: Any, ground: Any, view: Any, nearest: Any, first_index: Any) -> None:
    """Test every quad; its two triangles have the indices ``first_index`` + 2 · quad and the next.

    The arguments are the named tuples of this module; ``nearest`` is updated in place.
    """
    columns = view.columns
    # The ground is static, so it drifts by the sensor's own movement within half the period.
    drift_m = _length(view.velocity) * view.half_period_s
    nodes, corners, local = _nodes(ground, view.rotation), np.empty((2, 4)), np.empty(15, np.float32)
    for i in range(ground.x.shape[0] - 1):
        for j in range(ground.y.shape[0] - 1):
            start, count, first, last = _quad_window(nodes, ground, i, j, view, drift_m, corners)
            if first >= last:
                continue
            bent = _quad_frame(ground, i, j, view, local)
            index = np.int32(first_index + 2 * (i * (ground.y.shape[0] - 1) + j))
            start %= columns
            # Two runs if the window crosses the last column, see cast_solids.
            for run in range(2):
                low, high = (start, min(start + count, columns)) if run == 0 else (0, start + count - columns)
                for block in range(first, last if high > low else first):
                    base, size = np.uint64((block * columns + low) * BLOCK), np.uint64((high - low) * BLOCK)
                    if bent:
                        _triangle(beams, local, base, size, np.float32(1.0), index, nearest)
                        _triangle(beams, local, base, size, np.float32(-1.0), np.int32(index + 1), nearest)
                    else:  # a flat quad is one plane: side 0 covers all of it
                        _triangle(beams, local, base, size, np.float32(0.0), index, nearest)


@njit(cache=True, nogil=True, error_model="numpy")
def _nodes(ground: Any, rotation: Any) -> Any:
    """Return x, y, z (nx, ny, 3) of the nodes in the sensor's frame; four quads use each node."""
    out = np.empty((ground.x.shape[0], ground.y.shape[0], 3))
    for i in range(ground.x.shape[0]):
        for j in range(ground.y.shape[0]):
            out[i, j] = _into_sensor(ground.x[i], ground.y[j], ground.z[i, j], rotation)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _quad_window(nodes: Any, ground: Any, i: Any, j: Any, view: Any, drift_m: Any, corners: Any) -> Any:
    """Return first column, number of columns, first and end block of the beams that may hit quad (i, j).

    ``corners`` (2, 4) is scratch memory.
    """
    # The smallest horizontal range, along the world's axes.
    gap_x = max(ground.x[i] - drift_m, -(ground.x[i + 1] + drift_m), 0.0)
    gap_y = max(ground.y[j] - drift_m, -(ground.y[j + 1] + drift_m), 0.0)
    near = np.sqrt(gap_x * gap_x + gap_y * gap_y)
    if near > view.max_range_m:
        return 0, 0, 0, 0
    # Center, largest range and heights of the corners, in the sensor's frame.
    x, y, far2 = 0.0, 0.0, 0.0
    low_z, high_z = np.inf, -np.inf
    for corner in range(4):
        k, n = i + (corner & 1), j + (corner >> 1)
        u, v, w = nodes[k, n, 0], nodes[k, n, 1], nodes[k, n, 2]
        corners[0, corner], corners[1, corner] = u, v
        x, y, far2 = x + u / 4, y + v / 4, max(far2, u * u + v * v)
        low_z, high_z = min(low_z, w), max(high_z, w)
    if view.rotation[2, 2] < 0.999999:  # a tilted sensor: from distance and height in its frame
        near = max(np.sqrt(max(near * near - max(low_z * low_z, high_z * high_z), 0.0)) - drift_m, 0.0)
    low_z, high_z = low_z - view.lift_m - drift_m, high_z + view.lift_m + drift_m
    low_slope, high_slope = slopes_of(low_z, high_z, near, np.sqrt(far2) + drift_m)
    first, last = ring_blocks(view.slopes, low_slope - view.slack, high_slope + view.slack)
    if first >= last:
        return 0, 0, 0, 0
    # Azimuths of the corners relative to the center, widened by the drift.
    middle = float(atan2(np.float32(y), np.float32(x)))
    low, high = spread(corners, np.cos(middle), np.sin(middle))
    if drift_m > 0.0:
        swing = np.pi if near <= drift_m else np.arcsin(drift_m / near)
        low, high = low - swing, high + swing
    start, count = column_range(view, middle, low, high)
    return start, count, first, last


@njit(cache=True, nogil=True, error_model="numpy")
def _quad_frame(ground: Any, i: Any, j: Any, view: Any, local: Any) -> Any:
    """Store slopes of both triangles (a, b, a, b), 1 / sizes, first corner, axis, velocity; return whether it is bent.

    The corner is stored with negative sign: it is the sensor's position relative to the corner.
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
def _triangle(beams: Any, local: Any, base: Any, size: Any, side: Any, index: Any, nearest: Any) -> None:
    """Hit the plane z = z0 + a (x - x0) + b (y - y0) with beams ``base`` to ``base + size``, within its triangle.

    The triangle is where ``side`` · (u - v) ≥ 0, with u and v from 0 to 1 over the quad.
    """
    depth, winner = nearest.depth, nearest.winner
    edge, one = np.float32(-_EDGE), np.float32(1.0 + _EDGE)
    a, b = (local[0], local[1]) if side >= 0 else (local[2], local[3])
    for n in range(size):
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


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def beam_number(c: Any, k: Any, columns: Any) -> Any:
    """Return the index of the beam of column c and ring k in the caster's order: blocks of rings, then columns."""
    return ((k // BLOCK) * columns + c) * BLOCK + k % BLOCK


@njit(cache=True, nogil=True, error_model="numpy")
def turn_beams(
    still: Any, turns: Any, shifts: Any, rises: Any, times: Any, direction: Any, origin: Any, beams: Any
) -> None:
    """Fill unit directions and starts (C, R, 3) in world axes, and the same beams in the caster's order.

    Args:
        still: directions (C, R, 3) in the sensor's frame.
        turns: ``world_from_sensor`` rotations (C, 3, 3).
        shifts: positions of the columns (C, 3) from the reference.
        rises: start heights (R,) of the rings on the sensor's axis.
        times: (C,) of the columns.
        direction: filled, (C, R, 3) float32.
        origin: filled, (C, R, 3) float32.
        beams: :class:`Beams`, filled.
    """
    columns, rings = still.shape[0], still.shape[1]
    for c in range(columns):
        xx, xy, xz = turns[c, 0, 0], turns[c, 0, 1], turns[c, 0, 2]
        yx, yy, yz = turns[c, 1, 0], turns[c, 1, 1], turns[c, 1, 2]
        zx, zy, zz = turns[c, 2, 0], turns[c, 2, 1], turns[c, 2, 2]
        for k in range(rings):
            i = beam_number(c, k, columns)
            x, y, z, rise = still[c, k, 0], still[c, k, 1], still[c, k, 2], rises[k]
            beams.x[i] = xx * x + xy * y + xz * z
            beams.y[i] = yx * x + yy * y + yz * z
            beams.z[i] = zx * x + zy * y + zz * z
            beams.rise[i], beams.time[i] = rise, times[c]
            direction[c, k, 0], direction[c, k, 1], direction[c, k, 2] = beams.x[i], beams.y[i], beams.z[i]
            origin[c, k, 0] = shifts[c, 0] + xz * rise
            origin[c, k, 1] = shifts[c, 1] + yz * rise
            origin[c, k, 2] = shifts[c, 2] + zz * rise


@njit(cache=True, nogil=True, error_model="numpy")
def measure_stops(
    origin: Any,
    direction: Any,
    times: Any,
    solids: Any,
    ground: Any,
    planes: Any,
    draws: Any,
    glossy: Any,
    max_range_m: Any,
    nearest: Any,
    depth: Any,
    thing: Any,
    material: Any,
    cosine: Any,
) -> None:
    """Fill depth, thing, material and cosine of incidence (C, R) from the caster's nearest hits.

    ``origin`` and ``direction`` (C, R, 3) and ``times`` (C,) describe the beams; ``solids``, ``ground`` and ``nearest``
    are tuples of this module; ``planes`` (T, 4) are those of the triangles, ``draws`` (DRAWS,) the free paths,
    ``glossy`` the gloss of materials. Hits beyond ``max_range_m`` are dropped. Volumes without gloss have no normal:
    their cosine is 1.
    """
    materials, local, count = ground.material.reshape(-1), np.empty(6), solids.boxes.shape[0]
    for c in range(depth.shape[0]):
        for k in range(depth.shape[1]):
            i = beam_number(c, k, depth.shape[0])
            s = nearest.winner[i]
            beam = (origin[c, k, 0], origin[c, k, 1], origin[c, k, 2],
                    direction[c, k, 0], direction[c, k, 1], direction[c, k, 2])  # fmt: skip
            t, cos, hit, made_of = np.inf, 0.0, -2, 0
            if s >= count:  # a triangle of the ground
                t, cos = _on_ground(beam, planes, s - count)
                hit, made_of = -1, materials[(s - count) >> 1]
            elif s >= 0:
                _into(beam, solids.boxes, s, times[c], local)
                t, cos = _enter(local, solids.boxes, s, solids.kinds[s], float(nearest.depth[i]))
                # In a volume the beam continues for its free path, the same as in the caster.
                if not np.isinf(solids.per_m[s]):
                    row = mixed(np.uint32(i), solids.salts[s]) & np.uint32(DRAWS - 1)
                    t = max(t, 0.0) + float(draws[row]) / solids.per_m[s]
                    cos = cos if glossy[solids.materials[s]] > 0.0 else 1.0
                hit, made_of = solids.things[s], solids.materials[s]
            if t > max_range_m:
                t, cos, hit, made_of = np.inf, 0.0, -2, 0
            depth[c, k], cosine[c, k], thing[c, k], material[c, k] = t, cos, hit, made_of


@njit(cache=True, nogil=True, error_model="numpy")
def _on_ground(beam: Any, planes: Any, row: Any) -> Any:
    """Return depth and cosine of incidence of a beam (start and direction) at the plane of a triangle."""
    a, b = planes[row, 0], planes[row, 1]
    fall = a * beam[3] + b * beam[4] - beam[5]
    return (beam[2] - a * beam[0] - b * beam[1] - planes[row, 2]) / fall, abs(fall) * planes[row, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def _into(beam: Any, boxes: Any, s: Any, time: Any, local: Any) -> None:
    """Store start and direction (6) of a beam in the frame of a solid."""
    x = beam[0] - boxes[s, 0, 0] - boxes[s, 5, 0] * time
    y = beam[1] - boxes[s, 0, 1] - boxes[s, 5, 1] * time
    z = beam[2] - boxes[s, 0, 2] - boxes[s, 5, 2] * time
    for k in range(3):
        a, b, c = boxes[s, 1, k], boxes[s, 2, k], boxes[s, 3, k]
        local[k], local[3 + k] = a * x + b * y + c * z, a * beam[3] + b * beam[4] + c * beam[5]


@njit(cache=True, nogil=True, error_model="numpy")
def _enter(local: Any, boxes: Any, s: Any, kind: Any, t32: Any) -> Any:
    """Return the depth at which the beam enters the solid, and the cosine there; ``t32`` if it misses by rounding."""
    if kind == 0:
        return _enter_box(local, boxes, s, t32)
    # Roots of a t² + 2 b t + c = 0, the quadric with half sizes 1; a cylinder ignores z.
    a, b, c, cos = 0.0, 0.0, -1.0, 0.0
    for k in range(2 if kind == 1 else 3):
        o, d = local[k] / boxes[s, 4, k], local[3 + k] / boxes[s, 4, k]
        a, b, c = a + d * d, b + o * d, c + o * o
    root2 = b * b - a * c
    t = t32 if kind == 2 or root2 < 0.0 else -np.inf  # along a cylinder's axis only its end is hit
    if root2 >= 0.0 and a > 0.0:
        t = (-b - np.sqrt(root2)) / a
    # A cylinder's end, if the beam enters it after the infinite side surface.
    if kind == 1 and local[5] != 0.0:
        cap = (-local[2] - np.copysign(boxes[s, 4, 2], local[5])) / local[5]
        if cap > t:
            return cap, abs(local[5])
    # The normal is the gradient of the quadric.
    length2 = 0.0
    for k in range(2 if kind == 1 else 3):
        normal = (local[k] + t * local[3 + k]) / (boxes[s, 4, k] * boxes[s, 4, k])
        cos, length2 = cos + normal * local[3 + k], length2 + normal * normal
    return t, min(abs(cos) / np.sqrt(length2 + 1e-30), 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _enter_box(local: Any, boxes: Any, s: Any, t32: Any) -> Any:
    """Return depth and cosine at the side that the beam enters last (slabs)."""
    near, cos = -np.inf, 1.0
    for k in range(3):
        if local[3 + k] != 0.0:
            t = (-local[k] - np.copysign(boxes[s, 4, k], local[3 + k])) / local[3 + k]
            if t > near:
                near, cos = t, abs(local[3 + k])
    return (near, cos) if np.isfinite(near) else (t32, cos)
