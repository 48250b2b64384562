"""A smooth surface below low points of which only some are ground: stiff where nothing is seen, drawn to the lowest.

Kraus & Pfeifer (1998) find terrain below trees in the same way: fit, weigh each point by how far it lies above the
fit, fit again. A point below the surface is ground or near it, because nothing is seen below the ground; one above
counts less the higher it lies (Geman & McClure 1985), and less still where the returns of its node are not flat.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

FLAT_M = 0.2
"""A node whose returns all lie within this height may be a patch of ground; a higher one is a car or a wall."""

_LEVELNESS = 0.01
"""Price of a slope against the near plane, per cell, against a weight of 1 for a low point."""

_STIFFNESS = (0.3, 0.1)
"""Price of a bend, per cell, on the coarse and on the fine cells."""

_SCALES_M = (0.2, 0.2, 0.15)
"""Height above the surface, for nodes of 2 m, at which a flat node has lost three quarters of its weight: twice on the
coarse cells, then on the fine ones."""

_NOT_FLAT = 0.4
"""The same where a node is not flat, as a share."""

_FALL_M = (2.0, 8.0)
"""Depth below the surface at which a low point has lost three quarters of its weight: one that may be a ghost, and one
that two neighbors agree with ..."""

_AGREE_M = 0.3
"""... to within this: land below a bank, and not a reflection."""

_LEAST_WEIGHT = 0.2
"""Low points of less weight do not count."""

_MOST_RESIDUAL_M = 0.2
"""The residual of a low point to the surface counts no more than this."""

_RELAXATIONS = 4
"""Passes over the fine cells, alternating in direction, ..."""

_OVER = 1.3
"""... each of which goes so many times as far as the cell's own optimum (over-relaxation)."""

_KEEP_PLANE = 1e-5
"""Price of leaving the near plane, so that the equations have one solution without any low point."""

_VECTOR = 16

Floats = NDArray[np.float32]

Mask = NDArray[np.bool_]


def smooth_ground(
    lows_m: Floats, rise_m: Floats, start_m: Floats, trusted: Mask, plane: Floats, half_extent_m: float
) -> tuple[Floats, Mask]:
    """Return heights (n, n) of a smooth ground at the middle of each node, and whether its low point is on it (n, n).

    The surface minimizes Σ w (h - z)² + a |∇h|² + b |∇²h|², h being the height above ``plane`` and w the weights of
    the low points z: over n / 4 cells per side (solved exactly, twice, with weights from the surface before), then
    over n / 2 (improved only). The residuals at the nodes are averaged and added.

    Args:
        lows_m: (n, n, 3) float32 a low point of each node; +inf where there is none. n is a multiple of 4.
        rise_m: (n, n) float32 from that point up to the highest return of the node.
        start_m: (n, n) float32 heights to start from.
        trusted: (n, n) bool, whether a low point counts in full whatever the surface does.
        plane: (a, b, c) float32 of the plane z = a x + b y + c, whose slope holds where nothing is seen.
        half_extent_m: half the side of the lattice in meters.
    """
    half_m = np.float32(half_extent_m)
    heights, on_surface = np.empty(trusted.shape, np.float32), np.zeros(trusted.shape, np.bool_)
    samples = _samples(lows_m, rise_m, trusted, half_m, plane)
    _fit(samples, start_m, _coarse_stiffness(trusted.shape[0] // 4), half_m, plane, heights, on_surface)
    return heights, on_surface


@lru_cache(maxsize=4)
def _coarse_stiffness(cells: int) -> NDArray[np.float32]:
    """Return the matrix a ∇ᵀ∇ + b (∇²)ᵀ∇² of cells × cells heights by its upper bands (cells², 2 cells + 1)."""
    one, first, second = np.eye(cells), np.diff(np.eye(cells), axis=0), np.diff(np.eye(cells), 2, axis=0)
    slopes = np.concatenate([np.kron(first, one), np.kron(one, first)])
    bends = np.concatenate([np.kron(second, one), np.kron(one, second), np.sqrt(2) * np.kron(first, first)])
    matrix = _LEVELNESS * slopes.T @ slopes + _STIFFNESS[0] * bends.T @ bends + _KEEP_PLANE * np.eye(cells**2)
    bands = np.zeros((cells**2, 2 * cells + 1), np.float32)
    for k in range(2 * cells + 1):
        bands[: cells**2 - k, k] = np.diagonal(matrix, k)
    bands.setflags(write=False)
    return bands


@njit(cache=True, nogil=True, error_model="numpy")
def _samples(lows: Any, rise: Any, trusted: Any, half_m: Any, plane: Any) -> Any:  # pragma: no cover - compiled
    """Return a row for each low point: u and v in nodes, z above the plane, share of the scales, least weight, fall."""
    n = lows.shape[0]
    per_m, last = np.float32(n / (2.0 * half_m)), np.float32(n - 0.001)
    # Scales are given for nodes of 2 m; smaller nodes have smaller ones.
    share = np.float32(0.5) + np.float32(0.25) * min(np.float32(1.0) / per_m, np.float32(2.0))
    out = np.empty((n * n, 6), np.float32)
    m = 0
    for i in range(n):
        for j in range(n):
            x, y, z = lows[i, j, 0], lows[i, j, 1], lows[i, j, 2]
            if np.isfinite(z):
                out[m, 0], out[m, 1] = min((x + half_m) * per_m, last), min((y + half_m) * per_m, last)
                out[m, 2] = z - plane[0] * x - plane[1] * y - plane[2]
                out[m, 3] = share if rise[i, j] < FLAT_M else share * np.float32(_NOT_FLAT)
                out[m, 4] = trusted[i, j]
                out[m, 5] = _FALL_M[1] if _agrees(lows, i, j) else _FALL_M[0]
                m += 1
    return out[:m]


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _agrees(lows: Any, i: Any, j: Any) -> Any:  # pragma: no cover - compiled
    """Whether the low points of two of the eight nodes around (i, j) are about as high as its own."""
    n, count = lows.shape[0], 0
    for p in range(max(i - 1, 0), min(i + 2, n)):
        for q in range(max(j - 1, 0), min(j + 2, n)):
            count += abs(lows[p, q, 2] - lows[i, j, 2]) < np.float32(_AGREE_M)
    return count > 2


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(
    samples: Any, start: Any, stiffness: Any, half_m: Any, plane: Any, heights: Any, on_surface: Any
) -> None:  # pragma: no cover - compiled
    """Fit the surface to samples, and write heights (n, n) and which nodes' low points are on it (n, n)."""
    n = heights.shape[0]
    weights = np.empty(samples.shape[0], np.float32)
    # Coarse cells, each solved exactly: weights from the start, then from the first solution.
    surface = np.zeros((n // 4, n // 4), np.float32)
    weight, target = np.empty_like(surface), np.empty_like(surface)
    _start_surface(start, half_m, plane, surface)
    for k in range(2):
        _weigh(samples, surface, n, np.float32(_SCALES_M[k]), weights)
        _gather(samples, weights, surface, n, weight, target)
        _solve(stiffness, weight, target, surface)
    # Fine cells: the coarse solution is so near that a few passes suffice.
    surface = _finer(surface)
    weight, target = np.empty_like(surface), np.empty_like(surface)
    _weigh(samples, surface, n, np.float32(_SCALES_M[2]), weights)
    _gather(samples, weights, surface, n, weight, target)
    _relax(weight, target, surface)
    _write_nodes(samples, weights, surface, half_m, plane, heights, on_surface)


@njit(cache=True, nogil=True, error_model="numpy")
def _start_surface(start: Any, half_m: Any, plane: Any, surface: Any) -> None:  # pragma: no cover - compiled
    """Set the surface to the mean height of the nodes of each cell above the plane."""
    n, cells = start.shape[0], surface.shape[0]
    node_m, size = np.float32(2.0 * half_m / n), n // cells
    surface[:] = 0.0
    for i in range(n):
        x = (np.float32(i) + np.float32(0.5)) * node_m - half_m
        for j in range(n):
            y = (np.float32(j) + np.float32(0.5)) * node_m - half_m
            surface[i // size, j // size] += start[i, j] - plane[0] * x - plane[1] * y - plane[2]
    surface /= np.float32(size * size)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _at(surface: Any, u: Any, v: Any) -> Any:  # pragma: no cover - compiled
    """Height of the bilinear surface at cells (u, v), 0 in the middle of the first one; the edge holds."""
    last = np.float32(surface.shape[0] - 1.001)
    u, v = min(max(u, np.float32(0.0)), last), min(max(v, np.float32(0.0)), last)
    i, j = int(u), int(v)
    fu, fv = u - np.float32(i), v - np.float32(j)
    low = surface[i, j] + fv * (surface[i, j + 1] - surface[i, j])
    high = surface[i + 1, j] + fv * (surface[i + 1, j + 1] - surface[i + 1, j])
    return low + fu * (high - low)


@njit(cache=True, nogil=True, error_model="numpy")
def _weigh(samples: Any, surface: Any, n: int, scale: Any, weights: Any) -> None:  # pragma: no cover - compiled
    """Weigh each low point by its height above the surface (or, far more gently, its depth below)."""
    per = np.float32(surface.shape[0] / n)
    half, one = np.float32(0.5), np.float32(1.0)
    above = one / scale
    least = np.float32(_LEAST_WEIGHT)
    for k in range(samples.shape[0]):
        away = samples[k, 2] - _at(surface, samples[k, 0] * per - half, samples[k, 1] * per - half)
        below = one / samples[k, 5]
        away *= above / samples[k, 3] if away > 0 else below
        weight = one / (one + away * away)
        weight *= weight
        weights[k] = max(weight if weight >= least else np.float32(0.0), samples[k, 4])


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(
    samples: Any, weights: Any, surface: Any, n: int, weight: Any, target: Any
) -> None:  # pragma: no cover - compiled
    """Sum the weights of each cell, and set its target: the surface plus the mean height of its low points above it."""
    per, half = np.float32(surface.shape[0] / n), np.float32(0.5)
    weight[:] = 0.0
    target[:] = 0.0
    for k in range(samples.shape[0]):
        if weights[k] > 0:
            u, v = samples[k, 0] * per, samples[k, 1] * per
            i, j = int(u), int(v)
            weight[i, j] += weights[k]
            target[i, j] += weights[k] * (samples[k, 2] - _at(surface, u - half, v - half))
    for i in range(surface.shape[0]):
        for j in range(surface.shape[0]):
            if weight[i, j] > 0:
                target[i, j] /= weight[i, j]
            target[i, j] += surface[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(stiffness: Any, weight: Any, target: Any, surface: Any) -> None:  # pragma: no cover - compiled
    """Solve (stiffness + weights) heights = weights * targets by elimination within the band.

    Rows are padded with zeros, so that whole vectors are taken from each.
    """
    count, width = stiffness.shape
    wide = (width + _VECTOR - 1) // _VECTOR * _VECTOR
    upper, pivot, heights = np.zeros((count, wide), np.float32), np.zeros(2 * wide, np.float32), surface.reshape(-1)
    weights, targets = weight.reshape(-1), target.reshape(-1)
    # The matrix with the weights on its diagonal, and the right side.
    upper[:, :width] = stiffness
    for k in range(count):
        upper[k, 0] += weights[k]
        heights[k] = weights[k] * targets[k]
    # Eliminate forwards: subtract each row from those below it that the band reaches.
    for k in range(count):
        inverse = np.float32(1.0) / upper[k, 0]
        pivot[:wide] = upper[k]
        for m in range(1, min(width, count - k)):
            factor = pivot[m] * inverse
            row, above = upper[k + m], pivot[m : m + wide]
            for q in range(np.uint32(width - m + _VECTOR - 1) // np.uint32(_VECTOR) * np.uint32(_VECTOR)):
                row[q] -= factor * above[q]
            heights[k + m] -= factor * heights[k]
    # Substitute backwards.
    for k in range(count - 1, -1, -1):
        height = heights[k]
        for m in range(1, min(width, count - k)):
            height -= upper[k, m] * heights[k + m]
        heights[k] = height / upper[k, 0]


@njit(cache=True, nogil=True, error_model="numpy")
def _finer(surface: Any) -> Any:  # pragma: no cover - compiled
    """Return the surface on half the cells' size."""
    n = 2 * surface.shape[0]
    out = np.empty((n, n), np.float32)
    half, quarter = np.float32(0.5), np.float32(0.25)
    for i in range(n):
        for j in range(n):
            out[i, j] = _at(surface, half * np.float32(i) - quarter, half * np.float32(j) - quarter)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _relax(weight: Any, target: Any, h: Any) -> None:  # pragma: no cover - compiled
    """Improve the surface cell by cell (successive over-relaxation, to and fro); the outer two cells stay."""
    slope, bend, over = np.float32(_LEVELNESS), np.float32(_STIFFNESS[1]), np.float32(_OVER)
    eight, two = np.float32(8.0), np.float32(2.0)
    own = np.float32(4.0) * slope + np.float32(20.0) * bend
    n = h.shape[0]
    for turn in range(_RELAXATIONS):
        for a in range(2, n - 2):
            i = a if turn % 2 == 0 else n - 1 - a
            for b in range(2, n - 2):
                j = b if turn % 2 == 0 else n - 1 - b
                near = h[i - 1, j] + h[i + 1, j] + h[i, j - 1] + h[i, j + 1]
                corners = h[i - 1, j - 1] + h[i - 1, j + 1] + h[i + 1, j - 1] + h[i + 1, j + 1]
                far = h[i - 2, j] + h[i + 2, j] + h[i, j - 2] + h[i, j + 2]
                pull = weight[i, j] * target[i, j] + slope * near + bend * (eight * near - two * corners - far)
                h[i, j] += over * (pull / (weight[i, j] + own) - h[i, j])


@njit(cache=True, nogil=True, error_model="numpy")
def _write_nodes(
    samples: Any, weights: Any, surface: Any, half_m: Any, plane: Any, heights: Any, on_surface: Any
) -> None:  # pragma: no cover - compiled
    """Write the heights of the nodes: plane, surface, and the mean of the residuals around (3 x 3, binomial)."""
    n = heights.shape[0]
    node_m = np.float32(2.0 * half_m / n)
    per, half, most = np.float32(surface.shape[0] / n), np.float32(0.5), np.float32(_MOST_RESIDUAL_M)
    # The residual of each low point on the surface, with a rim of one node.
    residual, counted = np.zeros((n + 2, n + 2), np.float32), np.zeros((n + 2, n + 2), np.float32)
    for k in range(samples.shape[0]):
        if weights[k] > 0:
            u, v = samples[k, 0], samples[k, 1]
            i, j = int(u), int(v)
            away = samples[k, 2] - _at(surface, u * per - half, v * per - half)
            residual[i + 1, j + 1], counted[i + 1, j + 1] = min(max(away, -most), most), 1.0
            on_surface[i, j] = True
    for i in range(n):
        for j in range(n):
            u, v = np.float32(i) + half, np.float32(j) + half
            total = _binomial(counted, i, j)
            x, y = u * node_m - half_m, v * node_m - half_m
            z = _at(surface, u * per - half, v * per - half) + plane[0] * x + plane[1] * y + plane[2]
            heights[i, j] = z + _binomial(residual, i, j) / (total + np.float32(2.0))


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _binomial(values: Any, i: Any, j: Any) -> Any:  # pragma: no cover - compiled
    """Sum of 3 x 3 values with weights 1 2 1, of an array with a rim of one."""
    two = np.float32(2.0)
    top = values[i, j] + two * values[i, j + 1] + values[i, j + 2]
    middle = values[i + 1, j] + two * values[i + 1, j + 1] + values[i + 1, j + 2]
    return top + two * middle + values[i + 2, j] + two * values[i + 2, j + 1] + values[i + 2, j + 2]
