"""Robust planes through points: RANSAC with a fixed sequence, so that the same points give the same plane."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

MAX_SLOPE = 0.21
"""Steepest ground plane that is looked for in the level frame (12°)."""

MIN_HEIGHT_M = 0.25
"""A plane nearer below the sensor than this is a desk, a hood or its own nearly level beams, not the ground."""

NEAR_M = 28.0
"""Nodes up to this far from the sensor decide which plane carries it."""

CARRIER_NODES = 2.0
"""A node with this many nearer ones in its sector counts a quarter."""

_CARRIER_SECTORS = 64

BELOW_SHARE = 0.35
"""Weight of a node below a plane against one on it: land may fall away from the road, while a roof hides it."""

LEVEL_SHARE = 0.4
"""Share of all weight by which a plane of slope 1 counts less: of two with about as much on them the flatter one."""

_TRIALS = 256


@njit(cache=True, nogil=True, error_model="numpy")
def carrier_plane(lows: Any, height: float) -> Any:  # pragma: no cover - compiled
    """Return (a, b, c) of the plane z = a x + b y + c that carries the sensor, and the share of near nodes on it.

    ``lows`` are the nodes' low points (n, n, 3), ``height`` the known height of the sensor or NaN. The best plane has
    many nodes on it and few below it; least squares on its nodes then refines it. Nodes count the more the nearer they
    are: a vehicle stands on what it sees around it, and not on the fields below the embankment. Share 0: none found.
    """
    points, weight = _near_points(lows)
    if points.shape[0] < 6:
        return np.zeros(3, np.float32), 0.0
    plane, score = _best_plane(points, weight, height)
    if score <= 0.0:
        return plane, 0.0
    for _ in range(3):
        plane = _refit(points, weight, plane)
    on = 0.0
    for k in range(points.shape[0]):
        on += weight[k] * (abs(_above(points[k], plane)) < _tolerance(points[k]))
    return plane, on / weight.sum()


@njit(cache=True, nogil=True, error_model="numpy")
def free_plane(points: Any) -> Any:  # pragma: no cover - compiled
    """Return the unit normal of the ground below a sensor tilted by up to 60°, and the share of area on it.

    ``points`` (n, 3) are in the sensor frame. Returns count by the square of their distance, as the area that a
    beam stands for; the sensor must lie above the plane and few returns below it.
    """
    normal = np.array([0.0, 0.0, 1.0], np.float32)
    best, best_on = 0.0, 0.0
    count = points.shape[0]
    if count < 50:
        return normal, best_on
    area = (points * points).sum(axis=1)
    tolerance = 0.1 + 0.005 * np.sqrt(area)
    state = np.uint32(777)
    for _ in range(_TRIALS):
        i, state = _draw(state, count)
        j, state = _draw(state, count)
        k, state = _draw(state, count)
        found = np.cross(points[j] - points[i], points[k] - points[i])
        length = np.sqrt((found * found).sum())
        if length < 1e-3:
            continue
        found = found / (length if found[2] > 0 else -length)
        offset = (found * points[i]).sum()
        if found[2] < 0.5 or offset > -0.1:
            continue
        on, below = _area_on(points, area, tolerance, found, offset)
        if on - 2.0 * below > best:
            best, best_on, normal = on - 2.0 * below, on, found.astype(np.float32)
    return normal, best_on / area.sum()


@njit(cache=True, nogil=True, error_model="numpy")
def _area_on(points: Any, area: Any, tolerance: Any, normal: Any, offset: Any) -> Any:  # pragma: no cover - compiled
    on, below = 0.0, 0.0
    for k in range(points.shape[0]):
        away = normal[0] * points[k, 0] + normal[1] * points[k, 1] + normal[2] * points[k, 2] - offset
        if abs(away) < tolerance[k]:
            on += area[k]
        elif away < -2 * tolerance[k]:
            below += area[k]
    return on, below


@njit(cache=True, nogil=True, error_model="numpy")
def _near_points(lows: Any) -> Any:  # pragma: no cover - compiled
    """Return the low points (k, 3) within ``NEAR_M`` of the sensor, and their weights (k,) by their distance."""
    n = lows.shape[0]
    points, square = np.empty((n * n, 3), np.float32), np.empty(n * n, np.float32)
    count = 0
    for i in range(n):
        for j in range(n):
            away = lows[i, j, 0] * lows[i, j, 0] + lows[i, j, 1] * lows[i, j, 1]
            if away < NEAR_M * NEAR_M:
                points[count], square[count] = lows[i, j], away
                count += 1
    points, square = points[:count], square[:count]
    weight, nearer = np.empty(count, np.float32), np.zeros(_CARRIER_SECTORS, np.int32)
    per_rad = np.float32(_CARRIER_SECTORS / (2 * np.pi))
    for k in np.argsort(square, kind="mergesort"):
        sector = int((np.arctan2(points[k, 1], points[k, 0]) + np.float32(np.pi)) * per_rad) % _CARRIER_SECTORS
        weight[k] = (1.0 / (1.0 + nearer[sector] / CARRIER_NODES)) ** 2
        nearer[sector] += 1
    return points, weight


@njit(cache=True, nogil=True, error_model="numpy")
def _best_plane(points: Any, weight: Any, height: float) -> Any:  # pragma: no cover - compiled
    """Return the best of the planes through three points each, drawn by their weights, and its score."""
    count = points.shape[0]
    stride = max(count // 400, 1)
    some, some_weight = points[::stride].T.copy(), weight[::stride].copy()
    tolerance = np.float32(0.10) + np.float32(0.006) * (np.abs(some[0]) + np.abs(some[1]))
    sums = np.cumsum(weight)
    plane = np.zeros(3, np.float32)
    best, total = np.float32(0.0), some_weight.sum()
    state = np.uint32(12345)
    for _ in range(_TRIALS):
        i, state = _draw_weighted(state, sums)
        j, state = _draw_weighted(state, sums)
        k, state = _draw_weighted(state, sums)
        candidate, fits = _plane_through(points[i], points[j], points[k])
        near = abs(candidate[2] + height) <= 0.4 if np.isfinite(height) else candidate[2] <= -MIN_HEIGHT_M
        if fits and near:
            score = _score(some[0], some[1], some[2], some_weight, tolerance, candidate)
            # Of two planes with about as much on them the flatter one: roads climb rarely.
            slope = np.sqrt(candidate[0] * candidate[0] + candidate[1] * candidate[1])
            score -= LEVEL_SHARE * slope * total
            if score > best:
                best, plane = score, candidate
    return plane, best


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_weighted(state: Any, sums: Any) -> Any:  # pragma: no cover - compiled
    """Next index of the sequence of :func:`_draw`, by weights whose running sums are given."""
    state = np.uint32(state * np.uint32(1664525) + np.uint32(1013904223))
    part = np.float32(state >> np.uint32(8)) * np.float32(2.0**-24) * sums[-1]
    return min(np.searchsorted(sums, part), sums.shape[0] - 1), state


@njit(cache=True, nogil=True, error_model="numpy")
def _draw(state: Any, count: int) -> Any:  # pragma: no cover - compiled
    """Next index in [0, count) of a linear congruential sequence (Numerical Recipes' constants)."""
    state = np.uint32(state * np.uint32(1664525) + np.uint32(1013904223))
    return np.int64(state >> np.uint32(8)) % count, state


@njit(cache=True, nogil=True, error_model="numpy")
def _above(point: Any, plane: Any) -> Any:  # pragma: no cover - compiled
    return point[2] - plane[0] * point[0] - plane[1] * point[1] - plane[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _tolerance(point: Any) -> Any:  # pragma: no cover - compiled
    return 0.10 + 0.006 * (abs(point[0]) + abs(point[1]))


@njit(cache=True, nogil=True, error_model="numpy")
def _plane_through(p: Any, q: Any, r: Any) -> Any:  # pragma: no cover - compiled
    plane = np.zeros(3, np.float32)
    x1, y1, x2, y2 = q[0] - p[0], q[1] - p[1], r[0] - p[0], r[1] - p[1]
    area = x1 * y2 - x2 * y1
    if abs(area) < 1e-3 * (x1 * x1 + y1 * y1 + x2 * x2 + y2 * y2) + 1e-6:
        return plane, False
    z1, z2 = q[2] - p[2], r[2] - p[2]
    plane[0] = (z1 * y2 - z2 * y1) / area
    plane[1] = (x1 * z2 - x2 * z1) / area
    plane[2] = p[2] - plane[0] * p[0] - plane[1] * p[1]
    return plane, plane[0] * plane[0] + plane[1] * plane[1] <= MAX_SLOPE * MAX_SLOPE and plane[2] < 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _score(x: Any, y: Any, z: Any, weight: Any, tolerance: Any, plane: Any) -> Any:  # pragma: no cover - compiled
    """Weight of the nodes on the plane, less a share of that of nodes clearly below it."""
    a, b, c = plane[0], plane[1], plane[2]
    score = np.float32(0.0)
    for k in range(x.shape[0]):
        r = z[k] - a * x[k] - b * y[k] - c
        on, below = np.float32(abs(r) < tolerance[k]), np.float32(r < np.float32(-2.0) * tolerance[k])
        score += weight[k] * (on - np.float32(BELOW_SHARE) * below)
    return score


@njit(cache=True, nogil=True, error_model="numpy")
def _refit(points: Any, weight: Any, plane: Any) -> Any:  # pragma: no cover - compiled
    """Return the plane of weighted least squares through the points on ``plane``."""
    m = np.zeros((3, 3), np.float64)
    b = np.zeros(3, np.float64)
    row = np.empty(3, np.float64)
    for k in range(points.shape[0]):
        if abs(_above(points[k], plane)) < _tolerance(points[k]):
            row[0], row[1], row[2] = points[k, 0], points[k, 1], 1.0
            for r in range(3):
                b[r] += weight[k] * row[r] * points[k, 2]
                for c in range(3):
                    m[r, c] += weight[k] * row[r] * row[c]
    for r in range(3):
        m[r, r] += 1e-6
        b[r] += 1e-6 * plane[r]
    return np.linalg.solve(m, b).astype(np.float32)
