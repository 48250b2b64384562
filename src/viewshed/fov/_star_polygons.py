"""Star shapes about a point that stay inside a mask: the numerical part of :mod:`viewshed.fov.polygons`.

How far each direction is free, and the few vertices that keep the most of it. Directions are ``bins``
equal wedges, wedge k from angle 2πk/bins to 2π(k+1)/bins, counter-clockwise from x.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.grid import BevGrid

FloatArray = NDArray[np.float64]

_WINDOWS = (1, 2, 4, 8, 16, 32)

_SHRINK = (0.98, 0.95, 0.9)

_FAR = 1e18


def free_ranges(
    mask: NDArray[np.bool_],
    grid: BevGrid,
    apex_m: tuple[float, float],
    bins: int,
    *,
    margin_m: float = 0.0,
    whole_cells: bool = True,
) -> FloatArray:
    """Return (bins,) meters: how far each wedge reaches from ``apex_m`` without leaving the true cells of ``mask``.

    With ``whole_cells`` no part of another cell is covered, and all stay ``margin_m`` away from it; without, no
    other cell's center is, nor anything off the grid. 0 where the apex itself is not inside. ``bins`` must be a
    multiple of 4.
    """
    if bins % 4 or bins <= 0:
        raise ValueError(f"bins must be a positive multiple of 4, got {bins}")
    lattice = (*grid.origin_m, grid.cell_m, 0.5 * grid.cell_m + margin_m)
    if whole_cells:
        return np.asarray(_free_ranges(mask, lattice, apex_m, bins, True), np.float64)
    edge = _free_ranges(np.ones_like(mask), lattice, apex_m, bins, True)
    lattice = (*grid.origin_m, grid.cell_m, max(margin_m, 1e-6))
    return np.asarray(np.minimum(edge, _free_ranges(mask, lattice, apex_m, bins, False)), np.float64)


@njit(cache=True, nogil=True)
def _free_ranges(mask: Any, lattice: Any, apex: Any, bins: int, solid: bool) -> Any:  # pragma: no cover - compiled
    """Return (bins,) ranges up to boxes of half side ``lattice[3]`` about the centers of the false cells.

    Where the boxes are ``solid``, those with no true cell beside them lie behind others and are left out.
    """
    cells = mask.shape[0]
    x0, y0, cell, half = lattice
    ranges = np.full(bins, _FAR)
    for i in range(-1, cells + 1):
        for j in range(-1, cells + 1):
            if _is_true(mask, i, j):
                continue
            x, y = x0 + (i + 0.5) * cell - apex[0], y0 + (j + 0.5) * cell - apex[1]
            box = (x - half, x + half, y - half, y + half)
            if box[0] <= 0.0 <= box[1] and box[2] <= 0.0 <= box[3]:
                _close_towards(box, ranges)
            elif not solid or _is_true(mask, i - 1, j) or _is_true(mask, i + 1, j) or _beside(mask, i, j):
                _limit_by_face(box[0], box[1], box[2], box[3], 0.0, ranges)
                _limit_by_face(box[2], box[3], -box[1], -box[0], 0.5 * np.pi, ranges)
    return ranges


@njit(cache=True, nogil=True)
def _is_true(mask: Any, i: int, j: int) -> bool:  # pragma: no cover - compiled
    cells = mask.shape[0]
    return bool(0 <= i < cells and 0 <= j < cells and mask[i, j])


@njit(cache=True, nogil=True)
def _beside(mask: Any, i: int, j: int) -> bool:  # pragma: no cover - compiled
    return _is_true(mask, i, j - 1) or _is_true(mask, i, j + 1)


@njit(cache=True, nogil=True)
def _close_towards(box: Any, ranges: Any) -> None:  # pragma: no cover - compiled
    """Set to 0 the wedges that enter a box which touches or holds the apex."""
    step = 2.0 * np.pi / len(ranges)
    for k in range(len(ranges)):
        c, s = np.cos((k + 0.5) * step), np.sin((k + 0.5) * step)
        if (box[0] < 0 or c > 0) and (box[1] > 0 or c < 0) and (box[2] < 0 or s > 0) and (box[3] > 0 or s < 0):
            ranges[k] = 0.0


@njit(cache=True, nogil=True)
def _limit_by_face(
    near: float, far: float, low: float, high: float, base: float, ranges: Any
) -> None:  # pragma: no cover - compiled
    """Limit the wedges that meet a box's face across the axis at ``base``: d/cos φ away at angle φ off the axis."""
    if near <= 0.0 <= far:
        return
    distance = near
    if far < 0.0:
        distance, base, low, high = -far, base + np.pi, -high, -low
    step = 2.0 * np.pi / len(ranges)
    first, last = np.arctan(low / distance), np.arctan(high / distance)
    for k in range(int(np.floor((base + first) / step + 1e-9)), int(np.ceil((base + last) / step - 1e-9))):
        start, end = max(first, k * step - base), min(last, (k + 1) * step - base)
        offset = 0.0 if start <= 0.0 <= end else min(abs(start), abs(end))
        if offset == abs(first):  # a corner: seen along the face, the cosine of its angle has no digits left
            reach = np.hypot(distance, low)
        elif offset == abs(last):
            reach = np.hypot(distance, high)
        else:
            reach = distance / np.cos(offset)
        ranges[k % len(ranges)] = min(ranges[k % len(ranges)], reach)


def star_vertices(ranges: FloatArray, price_m2: float) -> FloatArray:
    """Return (V, 2) angle and range of the star polygon below ``ranges`` with the most area less ``price_m2`` a vertex.

    Vertices stand on the wedges' borders at a few dozen candidate ranges; among those the choice is optimal but for
    its first vertex, which a first pass finds. Empty where some direction is not free or nothing pays.
    """
    if ranges.min() <= 0.0:
        return np.empty((0, 2))
    radii = candidate_ranges(ranges)
    start = int(np.argmin(ranges))
    corner = np.searchsorted(radii[start], min(ranges[start - 1], ranges[start]) * (1 + 1e-9)) - 1
    draft = _star(ranges, radii, price_m2, start, int(corner))
    if len(draft) < 3:
        return np.empty((0, 2))
    start, corner = draft[len(draft) // 2]
    if radii[start, corner] <= ranges[start - 1]:
        final = _star(ranges, radii, price_m2, int(start), int(corner))
        draft = final if len(final) >= 3 else draft
    angles = draft[:, 0] * (2 * np.pi / len(ranges))
    return np.stack([angles, radii[draft[:, 0], draft[:, 1]]], axis=1)


def candidate_ranges(ranges: FloatArray) -> FloatArray:
    """Return (bins, C) ascending candidate ranges of a vertex on each wedge's first border.

    The smallest of the next 1, 2, 4 … 32 wedges on either side, and shares of the nearest.
    """
    columns = []
    for width in _WINDOWS:
        columns.append(np.min([np.roll(ranges, 1 + d) for d in range(width)], axis=0))
        columns.append(np.min([np.roll(ranges, -d) for d in range(width)], axis=0))
    for share in _SHRINK:
        columns += [np.roll(ranges, 1) * share, ranges * share]
    return np.ascontiguousarray(np.sort(np.stack(columns, axis=1), axis=1))


@njit(cache=True, nogil=True)
def _star(ranges: Any, radii: Any, price: float, start: int, corner: int) -> Any:  # pragma: no cover - compiled
    """Return (V, 2) ray and candidate of the best closed chain through candidate ``corner`` of ray ``start``."""
    bins, count = radii.shape
    arrive, leave = np.full((bins + 1, count), -_FAR), np.full((bins + 1, count), -_FAR)
    previous = np.full((bins + 1, count, 2), -1, np.int32)
    inward = np.full((bins + 1, count), -1, np.int32)
    arrive[0, corner] = 0.0
    for step in range(bins):
        ray = (start + step) % bins
        _turn(radii[ray], ranges[ray], price, arrive[step], leave[step], inward[step])
        for c in range(count):
            if leave[step, c] > -_FAR:
                _spread(ranges, radii, (start, step, c), leave[step, c], arrive, previous)
    return _walk_back(radii, start, corner, previous, inward)


@njit(cache=True, nogil=True)
def _turn(
    radii: Any, limit: float, price: float, arrive: Any, leave: Any, inward: Any
) -> None:  # pragma: no cover - compiled
    """Fill ``leave``: from where each candidate of a ray is best reached, by one vertex or by two and a radial edge."""
    best = np.argmax(arrive)
    if arrive[best] <= -_FAR:
        return
    for c in range(len(leave)):
        if radii[c] > limit:
            break
        leave[c], inward[c] = arrive[best] - 2.0 * price, best
        if arrive[c] - price > leave[c]:
            leave[c], inward[c] = arrive[c] - price, c


@njit(cache=True, nogil=True)
def _spread(
    ranges: Any, radii: Any, node: Any, gain: float, arrive: Any, previous: Any
) -> None:  # pragma: no cover - compiled
    """Relax every edge that leaves a vertex and stays below the ranges.

    A line in polar coordinates is 1/r = u cos φ + b sin φ, so that the edge is bounded by the largest b needed so far.
    """
    start, step, c = node
    bins, count = radii.shape
    radius = radii[(start + step) % bins, c]
    slope = -_FAR
    for d in range(1, min(bins // 3, bins - step) + 1):
        ray, sine, cosine = (start + step + d) % bins, np.sin(2 * np.pi * d / bins), np.cos(2 * np.pi * d / bins)
        inverse = cosine / radius + slope * sine
        limit = ranges[ray - 1] if inverse <= 0.0 else min(ranges[ray - 1], (1.0 + 1e-12) / inverse)
        for e in range(count):
            if radii[ray, e] > limit:
                break
            value = gain + 0.5 * radius * radii[ray, e] * sine
            if value > arrive[step + d, e]:
                arrive[step + d, e] = value
                previous[step + d, e, 0], previous[step + d, e, 1] = step, c
        slope = max(slope, (1.0 / min(ranges[ray - 1], ranges[ray]) - cosine / radius) / sine)


@njit(cache=True, nogil=True)
def _walk_back(radii: Any, start: int, corner: int, previous: Any, inward: Any) -> Any:  # pragma: no cover - compiled
    bins = len(radii)
    chain = np.empty((2 * bins + 2, 2), np.int64)
    used, step, c = 0, bins, corner
    while step > 0:
        chain[used, 0], chain[used, 1] = (start + step) % bins, c
        used += 1
        origin, left = previous[step, c]
        if origin < 0:
            return chain[:0]
        c = inward[origin, left]
        if radii[(start + origin) % bins, c] != radii[(start + origin) % bins, left]:
            chain[used, 0], chain[used, 1] = (start + origin) % bins, left
            used += 1
        step = origin
    return chain[:used][::-1]
