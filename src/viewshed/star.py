"""Star shapes about a point that stay inside a mask: the numerical part of :mod:`viewshed.polygons`.

How far each direction is free, and the few sectors or vertices that keep the most of it. Directions are ``bins``
equal wedges, wedge k from angle 2πk/bins to 2π(k+1)/bins, counter-clockwise from x.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.bev import BevGrid

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

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
    """Return (bins,) metres: how far each wedge reaches from ``apex_m`` without leaving the true cells of ``mask``.

    With ``whole_cells`` no part of another cell is covered, and all stay ``margin_m`` away from it; without, no
    other cell's centre is. 0 where the apex itself is not inside. ``bins`` must be a multiple of 4.
    """
    if bins % 4 or bins <= 0:
        raise ValueError(f"bins must be a positive multiple of 4, got {bins}")
    lattice = (*grid.origin_m, grid.cell_m, margin_m)
    if whole_cells:
        return np.asarray(_free_ranges(mask, lattice, apex_m, bins), np.float64)
    edge = _free_ranges(np.ones_like(mask), lattice, apex_m, bins)
    x, y = grid.centers[~mask].T - np.asarray(apex_m)[:, None]
    turns = np.arctan2(y, x) / (2 * np.pi) * bins
    for nudge in (-1e-9, 1e-9):
        np.minimum.at(edge, np.floor(turns + nudge).astype(np.intp) % bins, np.hypot(x, y) * (1 - 1e-9))
    return np.asarray(edge, np.float64)


@njit(cache=True, nogil=True)
def _free_ranges(mask: Any, lattice: Any, apex: Any, bins: int) -> Any:  # pragma: no cover - compiled
    cells = mask.shape[0]
    x0, y0, cell, margin = lattice
    ranges = np.full(bins, _FAR)
    for i in range(-1, cells + 1):
        for j in range(-1, cells + 1):
            if _is_true(mask, i, j):
                continue
            left, low = x0 + i * cell - apex[0] - margin, y0 + j * cell - apex[1] - margin
            box = (left, left + cell + 2 * margin, low, low + cell + 2 * margin)
            if box[0] <= 0.0 <= box[1] and box[2] <= 0.0 <= box[3]:
                _close_towards(box, ranges)
            elif (
                _is_true(mask, i - 1, j)
                or _is_true(mask, i + 1, j)
                or _is_true(mask, i, j - 1)
                or _is_true(mask, i, j + 1)
            ):
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
        ranges[k % len(ranges)] = min(ranges[k % len(ranges)], distance / np.cos(offset))


def best_sectors(ranges: FloatArray, sectors: int, inner_m: float = 0.0) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the at most ``sectors`` sectors of greatest area below ``ranges`` (bins,): first bin, end bin, range.

    What lies nearer than ``inner_m`` does not count.

    Exact for one cut of the circle, at the shortest range, by dynamic programming over the ends of the sectors; a
    sector's range is the smallest of its bins. An end may exceed ``bins``: it wraps.
    """
    bins, cut = len(ranges), int(np.argmin(ranges))
    rolled = np.ascontiguousarray(np.roll(ranges, -cut))
    origin = _best_ends(rolled, sectors, inner_m)
    first, end, k, j = [], [], sectors, bins
    while k > 0 and j > 0:
        i = int(origin[k, j])
        if i >= 0:
            first.append(i)
            end.append(j)
        j, k = (j - 1, k) if i < 0 else (i, k - 1)
    reach = [float(rolled[i:j].min()) for i, j in zip(first, end, strict=True)]
    begin = (np.array(first, np.int64) + cut) % bins
    widths = np.array(end, np.int64) - np.array(first, np.int64)
    order = np.argsort(begin)
    return begin[order], (begin + widths)[order], np.array(reach)[order]


@njit(cache=True, nogil=True)
def _best_ends(ranges: Any, sectors: int, inner: float) -> Any:  # pragma: no cover - compiled
    """Return (sectors + 1, bins + 1): where the k-th sector that ends at j begins, -1 where bin j - 1 is in none."""
    bins = len(ranges)
    area = np.zeros((sectors + 1, bins + 1))
    origin = np.full((sectors + 1, bins + 1), -1, np.int32)
    for k in range(1, sectors + 1):
        for j in range(1, bins + 1):
            best, begin, reach = area[k, j - 1], -1, _FAR
            for i in range(j - 1, -1, -1):
                reach = min(reach, ranges[i])
                if reach <= inner:
                    break
                value = area[k - 1, i] + (reach * reach - inner * inner) * (j - i)
                if value > best:
                    best, begin = value, i
            area[k, j], origin[k, j] = best, begin
    return origin


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
