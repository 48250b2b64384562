"""Local ground: heights above it decide what is an obstacle and which beams would meet a target.

Four steps on a coarse lattice: the second-lowest return of each node, a robust plane through the near nodes, a
walk outwards from the sensor that carries height and slope and accepts a node only where the step is plausible, so
that it follows hills and does not climb walls, and a smooth surface through what then fits it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.fov.height_map import HeightMap
from viewshed.preprocess.ground_plane import MIN_HEIGHT_M, near_plane
from viewshed.preprocess.ground_surface import FLAT_M, smooth_ground

ASSUMED_HEIGHT_M = 1.8
"""Sensor height where neither the sweep nor its returns give one."""

EVEN_M = 0.12
"""Nodes whose low points lie this near to one plane are even ground, no obstacle."""

EVEN_SLOPE = 0.3
"""Steepest even ground (17°)."""

EVEN_STEP_M = 0.5
"""Even ground may lie this far from what the nodes nearer to the sensor predict."""

TRUSTED_STEP_M = 0.2
"""Even ground this near to what was predicted is trusted whatever the smooth surface does."""

BURIED_M = 0.3
"""A beam that passes this far below the ground had ended there: what it says of ground farther away is wrong."""

NEAR_SHARE = 0.16
"""Within this share of the lattice's side from the sensor, accepted nodes are trusted."""

MIN_SUPPORT = 0.22
"""A plane with a smaller share of the near nodes on it is no ground; then the lowest returns are taken as level."""


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
    node_m = 2.0 * half_extent_m / lows_m.shape[0]
    # A robust plane through the near nodes.
    known = np.nan if sensor_height_m is None else float(sensor_height_m)
    plane, support = near_plane(lows_m, known)
    # A walk outwards that accepts only steps that ground can take; low points below accepted ground are reflections.
    walked_m, trusted, accepted = _walk(lows_m, rise_m < FLAT_M, np.float32(node_m), plane, _order(lows_m.shape[0]))
    lows_m = _without_buried(lows_m, walked_m, accepted, np.float32(1.0 / node_m))
    # A smooth surface through what fits it.
    heights, seen = smooth_ground(lows_m, rise_m, walked_m, trusted, plane, half_extent_m)
    # No plane, or one at the sensor's own height: the ground is not seen.
    middle = lows_m.shape[0] // 2
    if support < MIN_SUPPORT or (sensor_height_m is None and heights[middle, middle] > -MIN_HEIGHT_M):
        return HeightMap.flat(half_extent_m, -(sensor_height_m or _lowest_m(lows_m[..., 2])))
    a, b, c = (float(value) for value in plane)
    return HeightMap(heights, half_extent_m, seen, (a, b, c), float(support))


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
def _walk(lows: Any, flat: Any, node_m: Any, plane: Any, order: Any) -> Any:  # pragma: no cover - compiled
    """Carry height and slope outwards; accept a low only within a step that ground can take.

    The step may be larger where a node and its neighbors lie on one plane: a street that begins to climb, and not
    the side of a car. It must be smaller where the node's returns are not flat. Returns the heights, the nodes that
    are trusted (accepted, and even with a small step or near the sensor), and those accepted.
    """
    n = lows.shape[0]
    height = np.zeros((n, n), np.float32)
    slope = np.zeros((n, n, 2), np.float32)
    weight = np.zeros((n, n), np.float32)
    trusted, accepted = np.zeros((n, n), np.bool_), np.zeros((n, n), np.bool_)
    even, grade = _even(lows)
    near2 = (NEAR_SHARE * n * node_m) ** 2
    for k in range(order.shape[0]):
        i, j = order[k, 0], order[k, 1]
        x, y = (i + 0.5 - n / 2) * node_m, (j + 0.5 - n / 2) * node_m
        # Height and slope as the nodes nearer to the sensor predict them; the near plane's where there are none.
        total, z, sx, sy, mx, my = _carried(height, slope, weight, i, j, node_m)
        if total == 0.0:
            z, sx, sy, mx, my = plane[0] * x + plane[1] * y + plane[2], plane[0], plane[1], node_m, 0.0
        # How far the low point lies above that.
        step = lows[i, j, 2] - z - sx * (lows[i, j, 0] - x) - sy * (lows[i, j, 1] - y)
        support = min(total / 3.0, 1.0)
        # Even ground is taken as it is; another node's step is followed in part; else the prediction goes on.
        if even[i, j] and abs(step) < EVEN_STEP_M:
            a, b = grade[i, j, 0], grade[i, j, 1]
            height[i, j] = lows[i, j, 2] - a * (lows[i, j, 0] - x) - b * (lows[i, j, 1] - y)
            slope[i, j, 0], slope[i, j, 1] = 0.5 * (sx + a), 0.5 * (sy + b)
            weight[i, j] = 1.0
            trusted[i, j] = abs(step) < TRUSTED_STEP_M or x * x + y * y < near2
        elif abs(step) < 0.10 + (0.05 * min(node_m, 2.5) if flat[i, j] else 0.0) + 0.10 * (1.0 - support):
            length2 = mx * mx + my * my + 0.25 * node_m * node_m
            height[i, j] = z + 0.7 * step
            slope[i, j, 0] = sx + 0.25 * step * mx / length2
            slope[i, j, 1] = sy + 0.25 * step * my / length2
            weight[i, j] = 1.0
            trusted[i, j] = x * x + y * y < near2
        else:
            height[i, j] = z
            slope[i, j, 0] = 0.9 * sx + 0.1 * plane[0]
            slope[i, j, 1] = 0.9 * sy + 0.1 * plane[1]
            weight[i, j] = max(0.8 * support, 0.05)
        accepted[i, j] = weight[i, j] == 1.0
    return height, trusted, accepted


@njit(cache=True, nogil=True, error_model="numpy")
def _without_buried(lows: Any, height: Any, accepted: Any, per_m: Any) -> Any:  # pragma: no cover - compiled
    """Return the lows without those that could not be seen: on the way to them a beam would pass below ground."""
    n = lows.shape[0]
    out = lows.copy()
    deep, middle = np.float32(BURIED_M), np.float32(0.5 * n)
    for i in range(n):
        for j in range(n):
            if lows[i, j, 2] < height[i, j] - deep:
                u, v, z = lows[i, j, 0] * per_m, lows[i, j, 1] * per_m, lows[i, j, 2]
                steps = int(max(abs(u), abs(v)))
                for k in range(1, steps):
                    share = np.float32(1.0) - np.float32(k) / np.float32(steps)
                    p, q = int(middle + share * u), int(middle + share * v)
                    if accepted[p, q] and share * z < height[p, q] - deep:
                        out[i, j] = np.inf
                        break
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _even(lows: Any) -> Any:  # pragma: no cover - compiled
    """Return whether each node and its neighbors lie on one plane (n, n), and that plane's slope (n, n, 2)."""
    n = lows.shape[0]
    even = np.zeros((n, n), np.bool_)
    slope = np.zeros((n, n, 2), np.float32)
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
            if count >= 7:
                fits, a, b = _one_plane(near[:count])
                even[i, j], slope[i, j, 0], slope[i, j, 1] = fits, a, b
    return even, slope


@njit(cache=True, nogil=True, error_model="numpy")
def _one_plane(points: Any) -> Any:  # pragma: no cover - compiled
    """Return whether points lie within ``EVEN_M`` of their least-squares plane, and its slope (x, y)."""
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
    if a * a + b * b > EVEN_SLOPE * EVEN_SLOPE:
        return False, a, b
    for k in range(points.shape[0]):
        if abs(points[k, 2] - mz - a * (points[k, 0] - mx) - b * (points[k, 1] - my)) > EVEN_M:
            return False, a, b
    return True, a, b


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
