"""Local ground, and how sure it is: it decides what is an obstacle and which beams would meet a target.

On a lattice about the sensor (nodes of 1 m on roads, of .5 m indoors), from the second-lowest return of each node:

1. The plane that carries the sensor, through the nodes around it (:mod:`viewshed.preprocess.ground_plane`).
2. Patches: nodes that lie on one plane with their neighbors, and how many of them hang together.
3. A walk outwards from the sensor that carries height and slope and takes a node for ground where ground can make the
   step to it: up as far as a curb, or any way along a patch; down to whatever returns agree on or is clearly lower, for
   nothing but ground lies below ground. What goes on beside accepted ground is attached to it, and the walk repeated:
   now a level that only one narrow sector shows is hardly carried on any more.
4. Heights in between (:mod:`viewshed.preprocess.ground_fill`), with a standard deviation.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.fov.height_map import HeightMap
from viewshed.preprocess.ground_fill import fill_ground, unconfirmed_levels
from viewshed.preprocess.ground_plane import MIN_HEIGHT_M, carrier_plane

ASSUMED_HEIGHT_M = 1.8
"""Sensor height where neither the sweep nor its returns give one."""

UNSEEN_STD_M = 1.0
"""Standard deviation of ground that no return lies on."""

MIN_SUPPORT = 0.22
"""A plane with a smaller share of the near nodes on it is no ground; then the lowest returns are taken as level."""

FLAT_M = 0.2
"""A node whose returns all lie within this height may be a patch of ground; a higher one is a car or a wall."""

EVEN_M = 0.12
"""Nodes whose low points lie this near to one plane are a patch; steeper planes get more by the slope's share."""

STEEPEST = 1.2
"""Slope of the steepest patch (50°): the side of a cutting."""

EVEN_SLOPE = 0.3
"""Steepest patch (17°) that needs no ground at its foot."""

EVEN_STEP_M = 0.5
"""Such a patch may lie this far from what the nodes nearer to the sensor predict, ..."""

LEVEL_M2 = 40.0
"""... or at any height if it is this large: a terrace, and not the roof of a car."""

FACE_M2 = 20.0
"""A patch that climbs from accepted ground is a slope if it is this large, and not the front of a car, ..."""

FOOT_M = 0.25
"""... and meets that ground to within this."""

AGREE_M = 0.3
"""Returns below the ground are believed if two neighbors agree with them to within this, ..."""

LOWER_M = 0.3
"""... or, of a wall that is seen over an edge, if they are this much lower: the ground lies no higher than its foot."""

CARRIED_SLOPE = 0.15
"""Where no ground is met the slope that is carried on differs by at most this from that of the carrier's plane."""

ALONE_WEIGHT = 0.01
"""Weight in the walk of a level that no other direction confirms."""

BURIED_M = 0.3
"""A beam that passes this far below accepted ground had ended there: what it says of ground farther away is wrong."""

BESIDE_NODES, BESIDE_M, BESIDE_SLOPE = 2, 0.12, 0.03
"""Returns are attached to ground at most so many nodes beside them, if two nodes of it are about as high."""

_FLOODS = 30
"""Ground is attached along rings in at most so many passes."""

_REFUSED, _FOLLOWED, _PATCH, _BELOW = 0, 1, 2, 3
"""What a node's low point is to the walk."""


def lattice_nodes(half_extent_m: float) -> int:
    """Return the nodes along a side of the lattice: of 1 m where it is large, of .5 m where it is small.

    >>> lattice_nodes(64.0), lattice_nodes(16.0)
    (128, 64)
    """
    return 128 if half_extent_m > 32.0 else 64


def estimate_ground(
    lows_m: NDArray[np.float32], rise_m: NDArray[np.float32], half_extent_m: float, sensor_height_m: float | None
) -> HeightMap:
    """Return the ground, z from the sensor, from a low point of each node.

    Args:
        lows_m: (n, n, 3) float32 the second-lowest point of each node (the lowest where it is alone, so that one
            return below the ground does not count); +inf where there is none.
        rise_m: (n, n) float32 from that point up to the highest return of the node.
        half_extent_m: half the side of the lattice in meters.
        sensor_height_m: known mounting height, or None.
    """
    nodes = lows_m.shape[0]
    node_m = np.float32(2.0 * half_extent_m / nodes)
    known = np.nan if sensor_height_m is None else float(sensor_height_m)
    plane, support = carrier_plane(lows_m, known)
    even, grade, size = _patches(lows_m)
    patches_m2 = size * node_m * node_m
    flat, order = rise_m < FLAT_M, _order(nodes)
    # Walk, attach what goes on beside the ground, and walk again from there, past levels that one sector alone shows.
    nothing = np.zeros((nodes, nodes), np.bool_)
    walked_m, accepted = _walk(lows_m, flat, node_m, plane, order, even, grade, patches_m2, nothing, nothing)
    alone = unconfirmed_levels(walked_m, accepted, plane, half_extent_m)
    _attach(lows_m, accepted)
    walked_m, accepted = _walk(lows_m, flat, node_m, plane, order, even, grade, patches_m2, accepted, alone)
    heights, std_m = fill_ground(walked_m, accepted, plane, half_extent_m)
    # No plane, or one at the sensor's own height: the ground is not seen.
    middle = nodes // 2
    if support < MIN_SUPPORT or (sensor_height_m is None and heights[middle, middle] > -MIN_HEIGHT_M):
        return HeightMap.flat(half_extent_m, -(sensor_height_m or _lowest_m(lows_m[..., 2])), UNSEEN_STD_M)
    a, b, c = (float(value) for value in plane)
    return HeightMap(heights, half_extent_m, accepted, (a, b, c), float(support), std_m)


def _lowest_m(lows_m: NDArray[np.float32]) -> float:
    """Return how far below the sensor the lowest twentieth of the nodes lies; the assumed height without any."""
    below = -lows_m[np.isfinite(lows_m)]
    return float(np.quantile(below, 0.95).clip(MIN_HEIGHT_M, 10.0)) if below.size > 5 else ASSUMED_HEIGHT_M


@lru_cache(maxsize=4)
def _order(nodes: int) -> NDArray[np.int32]:
    """Return the nodes' (i, j), nearest to the middle first."""
    i, j = np.mgrid[:nodes, :nodes]
    middle = (nodes - 1) / 2
    order = np.argsort(np.hypot(i - middle, j - middle).ravel(), kind="stable")
    return np.ascontiguousarray(np.stack([i.ravel()[order], j.ravel()[order]], axis=1), dtype=np.int32)


@njit(cache=True, nogil=True, error_model="numpy")
def _patches(lows: Any) -> Any:  # pragma: no cover - compiled
    """Return whether each node lies on one plane with its neighbors (n, n), the plane's slope, and the patch's size.

    The slope (n, n, 2) is along x and y; the size (n, n) counts the nodes that hang together.
    """
    n = lows.shape[0]
    even, grade = np.zeros((n, n), np.bool_), np.zeros((n, n, 2), np.float32)
    near = np.empty((9, 3), np.float32)
    for i in range(1, n - 1):
        for j in range(1, n - 1):
            if not np.isfinite(lows[i, j, 2]):
                continue
            count = 0
            for p in range(i - 1, i + 2):
                for q in range(j - 1, j + 2):
                    if np.isfinite(lows[p, q, 2]):
                        near[count] = lows[p, q]
                        count += 1
            # Seven of nine: three rows along any slope, or else a wall and the ground before it were a plane.
            if count >= 7:
                fits, a, b = _one_plane(near[:count])
                even[i, j], grade[i, j, 0], grade[i, j, 1] = fits, a, b
    return even, grade, _sizes(lows, even, grade)


@njit(cache=True, nogil=True, error_model="numpy")
def _one_plane(points: Any) -> Any:  # pragma: no cover - compiled
    """Return whether points (k, 3) lie on their least-squares plane, and its slope along x and y."""
    count = np.float32(points.shape[0])
    mx, my, mz = points[:, 0].sum() / count, points[:, 1].sum() / count, points[:, 2].sum() / count
    xx, xy, yy, xz, yz = 1e-6, 0.0, 1e-6, 0.0, 0.0
    for k in range(points.shape[0]):
        x, y, z = points[k, 0] - mx, points[k, 1] - my, points[k, 2] - mz
        xx += x * x
        xy += x * y
        yy += y * y
        xz += x * z
        yz += y * z
    area = xx * yy - xy * xy
    a, b = (xz * yy - yz * xy) / area, (yz * xx - xz * xy) / area
    slope = np.sqrt(a * a + b * b)
    if slope > STEEPEST:
        return False, a, b
    for k in range(points.shape[0]):
        off = points[k, 2] - mz - a * (points[k, 0] - mx) - b * (points[k, 1] - my)
        if abs(off) > EVEN_M * (1.0 + slope):
            return False, a, b
    return True, a, b


@njit(cache=True, nogil=True, error_model="numpy")
def _sizes(lows: Any, even: Any, grade: Any) -> Any:  # pragma: no cover - compiled
    """Return how many nodes hang together with each (n, n): neighbors on planes that predict each other's low point."""
    n = even.shape[0]
    size, found = np.zeros((n, n), np.int32), np.zeros((n, n), np.bool_)
    members = np.empty((n * n, 2), np.int32)
    for i in range(n):
        for j in range(n):
            if found[i, j] or not even[i, j]:
                continue
            # Breadth first; the queue is the list of members.
            members[0, 0], members[0, 1], found[i, j] = i, j, True
            at, count = 0, 1
            while at < count:
                p, q = members[at, 0], members[at, 1]
                at += 1
                for u in range(max(p - 1, 0), min(p + 2, n)):
                    for v in range(max(q - 1, 0), min(q + 2, n)):
                        if found[u, v] or not even[u, v]:
                            continue
                        dx, dy = lows[u, v, 0] - lows[p, q, 0], lows[u, v, 1] - lows[p, q, 1]
                        rise = 0.5 * ((grade[u, v, 0] + grade[p, q, 0]) * dx + (grade[u, v, 1] + grade[p, q, 1]) * dy)
                        if abs(lows[u, v, 2] - lows[p, q, 2] - rise) < FLAT_M:
                            members[count, 0], members[count, 1], found[u, v] = u, v, True
                            count += 1
            for k in range(count):
                size[members[k, 0], members[k, 1]] = count
    return size


@njit(cache=True, nogil=True, error_model="numpy")
def _walk(
    lows: Any,
    flat: Any,
    node_m: Any,
    plane: Any,
    order: Any,
    even: Any,
    grade: Any,
    patches_m2: Any,
    attached: Any,
    alone: Any,
) -> Any:  # pragma: no cover - compiled
    """Carry height and slope outwards; return heights (n, n) and which nodes' low points are accepted (n, n).

    Args: ``flat`` (n, n) whether all returns of a node lie within ``FLAT_M``; ``even``, ``grade`` and ``patches_m2`` as
    :func:`_patches` finds them, sizes in square meters; ``attached`` (n, n) nodes that are accepted whatever the step;
    ``alone`` (n, n) nodes that carry hardly anything on.
    """
    n = lows.shape[0]
    height, slope = np.zeros((n, n), np.float32), np.zeros((n, n, 2), np.float32)
    weight, accepted = np.zeros((n, n), np.float32), np.zeros((n, n), np.bool_)
    for k in range(order.shape[0]):
        i, j = order[k, 0], order[k, 1]
        x, y = (i + 0.5 - n / 2) * node_m, (j + 0.5 - n / 2) * node_m
        # Height and slope as the nodes nearer to the sensor predict them; the carrier's plane where there are none.
        total, z, sx, sy, mx, my = _carried(height, slope, weight, i, j, node_m)
        if total == 0.0:
            z, sx, sy, mx, my = plane[0] * x + plane[1] * y + plane[2], plane[0], plane[1], node_m, 0.0
        support = min(total / 3.0, 1.0)
        # How far the low point lies above that, and what it is.
        dx, dy = lows[i, j, 0] - x, lows[i, j, 1] - y
        step = lows[i, j, 2] - z - sx * dx - sy * dy
        a, b = grade[i, j, 0], grade[i, j, 1]
        kind = _REFUSED
        if attached[i, j]:
            kind = _PATCH if even[i, j] else _BELOW
        elif np.isfinite(step):
            gentle = even[i, j] and a * a + b * b < EVEN_SLOPE * EVEN_SLOPE
            small = 0.10 + (0.05 * min(node_m, 2.5) if flat[i, j] else 0.0) + 0.10 * (1.0 - support)
            if gentle and abs(step) < EVEN_STEP_M:
                kind = _PATCH
            elif abs(step) < small:
                kind = _FOLLOWED
            elif step < 0.0:
                # Nothing but ground lies below ground.
                is_floor = even[i, j] or (_agrees(lows, i, j) if flat[i, j] else step < -LOWER_M)
                if is_floor and not _is_buried(lows[i, j], height, accepted, node_m):
                    kind = _BELOW
            elif (gentle and patches_m2[i, j] >= LEVEL_M2) or (
                even[i, j] and patches_m2[i, j] >= FACE_M2 and _meets(lows[i, j], a, b, height, accepted, i, j, node_m)
            ):
                kind = _PATCH
        # Patches are taken as they are, with their slope if they break with the prediction; small steps in part.
        if kind == _PATCH or (kind == _BELOW and even[i, j]):
            height[i, j] = lows[i, j, 2] - a * dx - b * dy
            breaks = kind == _BELOW or abs(step) >= EVEN_STEP_M
            slope[i, j, 0] = a if breaks else 0.5 * (sx + a)
            slope[i, j, 1] = b if breaks else 0.5 * (sy + b)
            weight[i, j] = 1.0
        elif kind == _BELOW:
            height[i, j] = lows[i, j, 2] - sx * dx - sy * dy
            slope[i, j, 0], slope[i, j, 1] = 0.5 * sx, 0.5 * sy
            weight[i, j] = 1.0
        elif kind == _FOLLOWED:
            length2 = mx * mx + my * my + 0.25 * node_m * node_m
            height[i, j] = z + 0.7 * step
            slope[i, j, 0] = sx + 0.25 * step * mx / length2
            slope[i, j, 1] = sy + 0.25 * step * my / length2
            weight[i, j] = 1.0
        else:
            height[i, j] = z
            steeper_x, steeper_y = sx - plane[0], sy - plane[1]
            share, steeper2 = np.float32(0.9), steeper_x * steeper_x + steeper_y * steeper_y
            if steeper2 > CARRIED_SLOPE * CARRIED_SLOPE:
                share *= np.float32(CARRIED_SLOPE) / np.sqrt(steeper2)
            slope[i, j, 0], slope[i, j, 1] = plane[0] + share * steeper_x, plane[1] + share * steeper_y
            weight[i, j] = max(0.8 * support, 0.05)
        accepted[i, j] = kind != _REFUSED
        if alone[i, j]:
            weight[i, j] = ALONE_WEIGHT
    return height, accepted


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _carried(height: Any, slope: Any, weight: Any, i: int, j: int, node_m: Any) -> Any:  # pragma: no cover - compiled
    """Weight, height, slope (x, y) and mean step (x, y) that the nodes nearer to the sensor carry to (i, j)."""
    n = height.shape[0]
    none, half = np.float32(0.0), np.float32(0.5)
    total, z, sx, sy, mx, my = none, none, none, none, none, none
    for p in range(max(i - 1, 0), min(i + 2, n)):
        for q in range(max(j - 1, 0), min(j + 2, n)):
            w = weight[p, q]
            if w > 0.0:
                w *= half if p != i and q != j else np.float32(1.0)
                dx, dy = np.float32(i - p) * node_m, np.float32(j - q) * node_m
                z += w * (height[p, q] + slope[p, q, 0] * dx + slope[p, q, 1] * dy)
                sx += w * slope[p, q, 0]
                sy += w * slope[p, q, 1]
                mx += w * dx
                my += w * dy
                total += w
    per = np.float32(1.0) / total if total > none else none
    return total, z * per, sx * per, sy * per, mx * per, my * per


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _agrees(lows: Any, i: Any, j: Any) -> Any:  # pragma: no cover - compiled
    """Whether the low points of two of the eight nodes around (i, j) are about as high as its own."""
    n, count = lows.shape[0], 0
    for p in range(max(i - 1, 0), min(i + 2, n)):
        for q in range(max(j - 1, 0), min(j + 2, n)):
            count += abs(lows[p, q, 2] - lows[i, j, 2]) < np.float32(AGREE_M)
    return count > 2


@njit(cache=True, nogil=True, error_model="numpy")
def _is_buried(low: Any, height: Any, accepted: Any, node_m: Any) -> Any:  # pragma: no cover - compiled
    """Whether the beam to a low point (3,) would pass below accepted ground on its way."""
    middle, deep = np.float32(0.5 * height.shape[0]), np.float32(BURIED_M)
    u, v, z = low[0] / node_m, low[1] / node_m, low[2]
    steps = int(max(abs(u), abs(v)))
    for k in range(1, steps):
        share = np.float32(1.0) - np.float32(k) / np.float32(steps)
        p, q = int(middle + share * u), int(middle + share * v)
        if accepted[p, q] and share * z < height[p, q] - deep:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _meets(
    low: Any, a: Any, b: Any, height: Any, accepted: Any, i: Any, j: Any, node_m: Any
) -> Any:  # pragma: no cover - compiled
    """Whether the plane through a low point (3,) of slope (a, b) meets accepted ground within two nodes."""
    n = height.shape[0]
    tolerance = FOOT_M + 0.1 * np.sqrt(a * a + b * b)
    for p in range(max(i - 2, 0), min(i + 3, n)):
        for q in range(max(j - 2, 0), min(j + 3, n)):
            if accepted[p, q]:
                x, y = (p + 0.5 - n / 2) * node_m, (q + 0.5 - n / 2) * node_m
                if abs(low[2] + a * (x - low[0]) + b * (y - low[1]) - height[p, q]) < tolerance:
                    return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _attach(lows: Any, accepted: Any) -> None:  # pragma: no cover - compiled
    """Accept low points that go on beside accepted ones (n, n), to and fro until nothing changes.

    A ring that goes on behind a hole or a car lies beside the ring before them, whatever the walk carried there.
    """
    n, reach = lows.shape[0], BESIDE_NODES
    for turn in range(_FLOODS):
        changed = False
        for a in range(n):
            i = a if turn % 2 == 0 else n - 1 - a
            for b in range(n):
                j = b if turn % 2 == 0 else n - 1 - b
                if accepted[i, j] or not np.isfinite(lows[i, j, 2]):
                    continue
                count = 0
                for p in range(max(i - reach, 0), min(i + reach + 1, n)):
                    for q in range(max(j - reach, 0), min(j + reach + 1, n)):
                        if accepted[p, q]:
                            away = np.hypot(lows[p, q, 0] - lows[i, j, 0], lows[p, q, 1] - lows[i, j, 1])
                            count += abs(lows[p, q, 2] - lows[i, j, 2]) < BESIDE_M + BESIDE_SLOPE * away
                if count >= 2:
                    accepted[i, j] = changed = True
        if not changed:
            break
