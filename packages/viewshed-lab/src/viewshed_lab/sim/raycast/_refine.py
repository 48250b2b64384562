"""The loops before and after the caster: beams in its order, and every stop measured again in double precision."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed_lab.sim.raycast._inputs import BLOCK, DRAWS
from viewshed_lab.sim.raycast._solids import mixed


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def beam_number(c: Any, k: Any, columns: Any) -> Any:
    """Return where the beam of column c and ring k is in the order of the caster: blocks of rings, then columns."""
    return ((k // BLOCK) * columns + c) * BLOCK + k % BLOCK


@njit(cache=True, nogil=True, error_model="numpy")
def turn_beams(
    still: Any, turns: Any, shifts: Any, rises: Any, times: Any, direction: Any, origin: Any, beams: Any
) -> None:
    """Fill unit directions and starts (C, R, 3) in world axes, and the same beams in the order of the caster.

    Args:
        still: directions (C, R, 3) in the sensor's frame.
        turns: ``world_from_sensor`` rotations (C, 3, 3).
        shifts: positions of the columns (C, 3) from the reference.
        rises: heights (R,) of the starts of the rings on the sensor's axis.
        times: (C,) of the columns.
        direction: filled, (C, R, 3) float32.
        origin: filled, (C, R, 3) float32.
        beams: :class:`~viewshed_lab.sim.raycast._inputs.Beams`, filled.
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
    draws: Any,
    glossy: Any,
    max_range_m: Any,
    nearest: Any,
    depth: Any,
    thing: Any,
    material: Any,
    cosine: Any,
) -> None:
    """Fill depth, thing, material and cosine of incidence (C, R) from the winners of the caster.

    Starts and directions (C, R, 3) and times (C,) are the beams'; the others the tuples of
    :mod:`viewshed_lab.sim.raycast._inputs`, the free paths (DRAWS,), the gloss of materials, and the range from which
    nothing is met. Volumes without gloss have no normal: their cosine is 1.
    """
    planes, materials, local, count = _planes(ground), ground.material.reshape(-1), np.empty(6), solids.boxes.shape[0]
    for c in range(depth.shape[0]):
        for k in range(depth.shape[1]):
            i = beam_number(c, k, depth.shape[0])
            s = nearest.winner[i]
            beam = (origin[c, k, 0], origin[c, k, 1], origin[c, k, 2],
                    direction[c, k, 0], direction[c, k, 1], direction[c, k, 2])  # fmt: skip
            t, cos, met, made_of = np.inf, 0.0, -2, 0
            if s >= count:  # a triangle of the ground
                t, cos = _on_ground(beam, planes, s - count)
                met, made_of = -1, materials[(s - count) >> 1]
            elif s >= 0:
                _into(beam, solids.boxes, s, times[c], local)
                t, cos = _enter(local, solids.boxes, s, solids.kinds[s], float(nearest.depth[i]))
                # Into a volume the beam goes on for the free path that the caster drew for it.
                if not np.isinf(solids.per_m[s]):
                    ticket = mixed(np.uint32(i), solids.salts[s]) & np.uint32(DRAWS - 1)
                    t = max(t, 0.0) + float(draws[ticket]) / solids.per_m[s]
                    cos = cos if glossy[solids.materials[s]] > 0.0 else 1.0
                met, made_of = solids.things[s], solids.materials[s]
            if t > max_range_m:
                t, cos, met, made_of = np.inf, 0.0, -2, 0
            depth[c, k], cosine[c, k], thing[c, k], material[c, k] = t, cos, met, made_of


@njit(cache=True, nogil=True, error_model="numpy")
def _planes(ground: Any) -> Any:
    """Return for every triangle a, b and c of z = a x + b y + c, and 1 / length of its normal (T, 4)."""
    xs, ys, zs = ground.x, ground.y, ground.z
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


@njit(cache=True, nogil=True, error_model="numpy")
def _on_ground(beam: Any, planes: Any, row: Any) -> Any:
    """Return depth and cosine of incidence of a beam (start and direction) on the plane of a triangle."""
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
    """Depth at which the beam enters the solid, and its cosine there; ``t32`` where rounding makes it miss."""
    if kind == 0:
        return _enter_box(local, boxes, s, t32)
    # Roots of a t² + 2 b t + c = 0, the quadric with half sizes 1; a cylinder leaves z out.
    a, b, c, cos = 0.0, 0.0, -1.0, 0.0
    for k in range(2 if kind == 1 else 3):
        o, d = local[k] / boxes[s, 4, k], local[3 + k] / boxes[s, 4, k]
        a, b, c = a + d * d, b + o * d, c + o * o
    root2 = b * b - a * c
    t = t32 if kind == 2 or root2 < 0.0 else -np.inf  # along a cylinder's axis its end decides
    if root2 >= 0.0 and a > 0.0:
        t = (-b - np.sqrt(root2)) / a
    # A cylinder's end, where it is met after the side's surface goes on beyond it.
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
    """The side that the beam enters last is the one it meets (slabs)."""
    near, cos = -np.inf, 1.0
    for k in range(3):
        if local[3 + k] != 0.0:
            t = (-local[k] - np.copysign(boxes[s, 4, k], local[3 + k])) / local[3 + k]
            if t > near:
                near, cos = t, abs(local[3 + k])
    return (near, cos) if np.isfinite(near) else (t32, cos)
