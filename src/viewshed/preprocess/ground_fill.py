"""Ground between and beyond the returns that lie on it, with a standard deviation.

Heights above a base surface are averaged over coarser and coarser nodes, and nodes without returns take the height of
the finest level that has some (pull-push; Gortler et al., The Lumigraph, SIGGRAPH 1996). The deviation is the spread of
what was averaged, plus a doubt that grows with the size of the nodes. Along a line of sight it is at least half of the
difference between the heights before and behind a gap: an edge hides what lies below it.

A level that only a narrow sector shows is not carried to its sides: one wedge of false returns would move the ground of
half the view.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

SEEN_STD_M = 0.05
"""Standard deviation where returns lie on the ground."""

GROWTH = 0.015
"""Doubt of a node's height per meter of its side."""

BEYOND_GROWTH = 0.01
"""The least doubt per meter beyond the last return of a direction."""

STEP_M = 0.3
"""Where the ground before and behind a gap differs by more than twice this, it may be as high as either."""

PLANE_M, TILT_M = 30.0, 20.0
"""From this range on the slope of the carrier's plane fades, over this distance: land is mostly level."""

LOWER_LEVEL_M, LOWEST_SHARE = 1.0, 0.05
"""Where so large a share of what is seen lies this far below the carrier's plane, the land has a lower level."""

FALL = 0.03
"""Beyond the last return of a direction the ground may fall to that level: it is taken half way, by this slope."""

GAP_SLOPE = 0.02
"""Between two returns of a direction ground lies between their heights, to this slope from the nearer one."""

LEVEL_M = 0.3
"""Ground this far above or below the carrier's plane is a level of its own, which another direction must confirm."""

CONFIRM_M, CONFIRM_SLOPE = 0.4, 0.02
"""It does if its own ground is as high to within this, and this slope across, ..."""

CONFIRM_SECTORS = 9, 40
"""... at about the same range and so many sectors away (13° to 56°): a wedge cannot confirm itself."""

UNCONFIRMED_WEIGHT = 0.1
"""Weight of the carrier's plane where returns show a level that no other direction confirms."""

_SMOOTHINGS = 2
"""Passes in which nodes without returns take the mean of their neighbors, for each size of nodes."""

_BLIND_WEIGHT = 0.9
"""Weight of the carrier's plane in the nodes below the sensor, which no beam meets."""

_SECTORS = 256
"""Sectors of azimuth in which gaps are looked for."""

Floats = NDArray[np.float32]

Mask = NDArray[np.bool_]


class _Level(NamedTuple):
    """Mean, weight in [0, 1] and variance (m, m) of the nodes of one size."""

    mean: Floats
    weight: Floats
    variance: Floats


def fill_ground(walked_m: Floats, accepted: Mask, plane: Floats, half_extent_m: float) -> tuple[Floats, Floats]:
    """Return heights (n, n) of the ground at the middle of each node, and their standard deviations (n, n).

    Args:
        walked_m: (n, n) float32 heights of the nodes that are ``accepted``; those of others do not matter.
        accepted: (n, n) bool, nodes on which returns lie.
        plane: (a, b, c) float32 of the carrier's plane z = a x + b y + c.
        half_extent_m: half the side of the lattice in meters.
    """
    nodes = len(walked_m)
    node_m = 2.0 * half_extent_m / nodes
    range_m = _middles(nodes, half_extent_m)[1]
    nearest_m = range_m[accepted].min() if accepted.any() else 0.0
    base, above = _over_base(walked_m, accepted, plane, half_extent_m)
    # No beam meets the ground just below the sensor: there the base counts.
    weight = accepted.astype(np.float32)
    weight[(range_m < max(nearest_m, 2.0 * node_m) + 0.5 * node_m) & ~accepted] = _BLIND_WEIGHT
    known = weight > 0.0
    seen, seen_base = _profiles(above, base, known)
    # So it does, weakly, where returns show a level that no other direction confirms. They hold for their own nodes.
    alone = _unconfirmed(above, accepted, seen, np.float32(node_m))
    weight[alone] = UNCONFIRMED_WEIGHT
    std = np.where(alone, np.float32(LEVEL_M), np.float32(SEEN_STD_M))
    level = _Level(np.where(alone, np.float32(0.0), above), weight, std * std)
    _fill(level, node_m)
    heights, std = level.mean + base, np.sqrt(level.variance)
    heights[alone], std[alone] = walked_m[alone], SEEN_STD_M
    lower_m = _lower_level(above[accepted & ~alone])
    _doubt_gaps(seen, seen_base, base, known, np.float32(node_m), lower_m, heights, std)
    return heights, std


def unconfirmed_levels(walked_m: Floats, accepted: Mask, plane: Floats, half_extent_m: float) -> Mask:
    """Return which accepted nodes (n, n) lie on a level that no other direction confirms; see :func:`fill_ground`."""
    base, above = _over_base(walked_m, accepted, plane, half_extent_m)
    seen, _ = _profiles(above, base, accepted)
    return np.asarray(_unconfirmed(above, accepted, seen, np.float32(2.0 * half_extent_m / len(accepted))))


def _lower_level(above_m: Floats) -> np.float32:
    """Return how far below the base heights (k,) over it show a lower level, 0 for none."""
    if not above_m.size:
        return np.float32(0.0)
    k = int(LOWEST_SHARE * above_m.size)
    lower_m = -np.partition(above_m, k)[k]
    return lower_m if lower_m > LOWER_LEVEL_M else np.float32(0.0)


def _over_base(walked_m: Floats, accepted: Mask, plane: Floats, half_extent_m: float) -> tuple[Floats, Floats]:
    """Return the base (n, n), which is the carrier's plane that levels off, and accepted heights above it, else 0."""
    xy, _, fade = _middles(len(walked_m), half_extent_m)
    base = (xy[0] * plane[0] + xy[1] * plane[1]) * fade + plane[2]
    return base, np.where(accepted, walked_m - base, np.float32(0.0))


@lru_cache(maxsize=4)
def _middles(nodes: int, half_extent_m: float) -> tuple[Floats, Floats, Floats]:
    """Return x and y (2, n, n) of the nodes' middles, their range (n, n), and the share of the plane's slope there."""
    middles = (np.arange(nodes) + 0.5) * (2 * half_extent_m / nodes) - half_extent_m
    xy = np.stack(np.meshgrid(middles, middles, indexing="ij")).astype(np.float32)
    range_m = np.hypot(*xy)
    beyond_m = np.maximum(range_m - np.float32(PLANE_M), np.float32(0.0))
    fade = 1.0 - (beyond_m + TILT_M * np.expm1(-beyond_m / TILT_M)) / range_m
    return xy, range_m, fade.astype(np.float32)


def _fill(level: _Level, node_m: float) -> None:
    """Fill nodes without weight from the level of nodes twice as large, which is filled first."""
    half = (len(level.mean) + 1) // 2
    coarse = _Level(*np.zeros((3, half, half), np.float32))
    _pull(*level, np.float32((GROWTH * node_m) ** 2), *coarse)
    if half > 1:
        _fill(coarse, 2.0 * node_m)
    _push(*coarse, *level)
    _smooth(level.mean, level.weight)


@njit(cache=True, nogil=True, error_model="numpy")
def _pull(
    mean: Any, weight: Any, variance: Any, doubt: Any, coarse_mean: Any, coarse_weight: Any, coarse_variance: Any
) -> None:  # pragma: no cover - compiled
    """Average each two by two nodes (n, n) into coarse arrays of zeros, with the variance of all, plus ``doubt``."""
    for i in range(mean.shape[0]):
        for j in range(mean.shape[1]):
            p, q, w, z = i // 2, j // 2, weight[i, j], mean[i, j]
            coarse_weight[p, q] += w
            coarse_mean[p, q] += w * z
            coarse_variance[p, q] += w * (variance[i, j] + z * z)
    for p in range(coarse_mean.shape[0]):
        for q in range(coarse_mean.shape[1]):
            w = coarse_weight[p, q]
            if w > 0.0:
                coarse_mean[p, q] /= w
                square = coarse_mean[p, q] * coarse_mean[p, q]
                coarse_variance[p, q] = max(coarse_variance[p, q] / w - square, np.float32(0.0))
            coarse_variance[p, q] += doubt
            coarse_weight[p, q] = min(w, np.float32(1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def _push(
    coarse_mean: Any, coarse_weight: Any, coarse_variance: Any, mean: Any, weight: Any, variance: Any
) -> None:  # pragma: no cover - compiled
    """Fill what the weight of each node lacks from the coarse nodes around it, bilinear."""
    half, quarter, one = np.float32(0.5), np.float32(0.25), np.float32(1.0)
    last = coarse_mean.shape[0] - 1
    for i in range(mean.shape[0]):
        u = min(max(half * np.float32(i) - quarter, np.float32(0.0)), np.float32(last))
        p, fu = int(u), u - np.float32(int(u))
        below = min(p + 1, last)
        for j in range(mean.shape[1]):
            w = weight[i, j]
            if w < one:
                v = min(max(half * np.float32(j) - quarter, np.float32(0.0)), np.float32(last))
                q, fv = int(v), v - np.float32(int(v))
                right = min(q + 1, last)
                a, b, c, d = (one - fu) * (one - fv), (one - fu) * fv, fu * (one - fv), fu * fv
                z = a * coarse_mean[p, q] + b * coarse_mean[p, right]
                z += c * coarse_mean[below, q] + d * coarse_mean[below, right]
                s = a * coarse_variance[p, q] + b * coarse_variance[p, right]
                s += c * coarse_variance[below, q] + d * coarse_variance[below, right]
                mean[i, j] = w * mean[i, j] + (one - w) * z
                variance[i, j] = w * variance[i, j] + (one - w) * s


@njit(cache=True, nogil=True, error_model="numpy")
def _smooth(mean: Any, weight: Any) -> None:  # pragma: no cover - compiled
    """Draw nodes without weight to the mean of the four beside them, to and fro: straight lines between returns."""
    n, one, quarter = mean.shape[0], np.float32(1.0), np.float32(0.25)
    for turn in range(_SMOOTHINGS):
        for a in range(1, n - 1):
            i = a if turn % 2 == 0 else n - 1 - a
            for b in range(1, n - 1):
                j = b if turn % 2 == 0 else n - 1 - b
                around = quarter * (mean[i - 1, j] + mean[i + 1, j] + mean[i, j - 1] + mean[i, j + 1])
                mean[i, j] += (one - weight[i, j]) * (around - mean[i, j])


@njit(cache=True, nogil=True, error_model="numpy")
def _profiles(above: Any, base: Any, known: Any) -> Any:  # pragma: no cover - compiled
    """Return known heights over ``base`` by sector and range in nodes (sectors, bins), NaN for none; and the base."""
    n = known.shape[0]
    bins = int(0.75 * n) + 1
    seen, seen_base = np.full((_SECTORS, bins), np.nan, np.float32), np.zeros((_SECTORS, bins), np.float32)
    for i in range(n):
        for j in range(n):
            if known[i, j]:
                at, r = _polar(i, j, n)
                b, wide = min(int(r), bins - 1), _width(r)
                # A node covers every sector that it lies in.
                for k in range(int(np.floor(at - wide)), int(np.floor(at + wide)) + 1):
                    s = k % _SECTORS
                    if not seen[s, b] <= above[i, j]:  # the lowest of those that share a bin, NaN for none so far
                        seen[s, b], seen_base[s, b] = above[i, j], base[i, j]
    return seen, seen_base


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _polar(i: int, j: int, n: int) -> Any:  # pragma: no cover - compiled
    """Return azimuth in sectors and range in nodes of the middle of node (i, j)."""
    u, v = np.float32(i + 0.5 - n / 2), np.float32(j + 0.5 - n / 2)
    return (np.arctan2(v, u) + np.float32(np.pi)) * np.float32(_SECTORS / (2 * np.pi)), np.sqrt(u * u + v * v)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _width(r: Any) -> Any:  # pragma: no cover - compiled
    """Return half the width of a node at a range in nodes, in sectors."""
    return np.float32(0.6 * _SECTORS / (2 * np.pi)) / max(r, np.float32(1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def _unconfirmed(above: Any, accepted: Any, seen: Any, node_m: Any) -> Any:  # pragma: no cover - compiled
    """Return which accepted nodes (n, n) lie on a level of their own that no other direction in ``seen`` confirms."""
    n = accepted.shape[0]
    alone = np.zeros((n, n), np.bool_)
    for i in range(n):
        for j in range(n):
            if accepted[i, j] and abs(above[i, j]) > LEVEL_M:
                at, r = _polar(i, j, n)
                alone[i, j] = not _confirms(seen, int(at), r, above[i, j], node_m)
    return alone


@njit(cache=True, nogil=True, error_model="numpy")
def _confirms(seen: Any, at: int, r: Any, level: Any, node_m: Any) -> Any:  # pragma: no cover - compiled
    """Whether ground about as high over the base is seen on a side of sector ``at``, at about this range in nodes."""
    bins, about = seen.shape[1], 2 + int(r) // 8
    across_m = r * node_m * np.float32(CONFIRM_SECTORS[0] * 2 * np.pi / _SECTORS)
    tolerance = np.float32(CONFIRM_M) + np.float32(CONFIRM_SLOPE) * across_m
    first = CONFIRM_SECTORS[0] + int(2 * _width(r))  # near the sensor a node is as wide as some sectors
    for away in range(first, first + CONFIRM_SECTORS[1] - CONFIRM_SECTORS[0]):
        for s in ((at - away) % _SECTORS, (at + away) % _SECTORS):
            for b in range(max(int(r) - about, 1), min(int(r) + about + 1, bins)):
                if abs(seen[s, b] - level) < tolerance:
                    return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _doubt_gaps(
    seen: Any, seen_base: Any, base: Any, known: Any, node_m: Any, lower: Any, heights: Any, std: Any
) -> None:  # pragma: no cover - compiled
    """Raise ``std`` (n, n) in gaps along the lines of sight, and mend ``heights`` (n, n) there.

    Behind an edge the ground lies below the beam that passes it, and not far below where that beam meets the ground.
    Beyond the last return it may lie as it does nearby, or at a level that is ``lower`` than the base by so much.

    Args: ``seen`` and ``seen_base`` of :func:`_profiles`; ``base`` (n, n); all z are from the sensor.
    """
    n, bins = known.shape[0], seen.shape[1]
    # The bin of the last height before each bin (the first bin where there is none), and of the next (-1 for none).
    before, behind = np.zeros((_SECTORS, bins), np.int32), np.full((_SECTORS, bins), -1, np.int32)
    for s in range(_SECTORS):
        seen[s, 0] = np.float32(0.0) if np.isnan(seen[s, 0]) else seen[s, 0]
        for b in range(1, bins):
            before[s, b] = before[s, b - 1] if np.isnan(seen[s, b]) else b
        for b in range(bins - 2, -1, -1):
            behind[s, b] = behind[s, b + 1] if np.isnan(seen[s, b + 1]) else b + 1
    growth, half, step = np.float32(BEYOND_GROWTH) * node_m, np.float32(0.5), np.float32(STEP_M)
    for i in range(n):
        for j in range(n):
            if known[i, j]:
                continue
            at, r = _polar(i, j, n)
            s, b = int(at) % _SECTORS, min(int(r), bins - 1)
            near, far = before[s, b], behind[s, b]
            if far < 0:
                away = r - np.float32(near)
                std[i, j] = max(std[i, j], growth * away)
                if lower > 0.0:
                    fall = min(half * (heights[i, j] - base[i, j] + lower), np.float32(FALL) * node_m * away)
                    heights[i, j] -= max(fall, np.float32(0.0))
                    std[i, j] = max(std[i, j], fall)
                continue
            high, low = max(seen[s, near], seen[s, far]) + base[i, j], min(seen[s, near], seen[s, far]) + base[i, j]
            if seen[s, far] < seen[s, near]:
                beam = (seen[s, far] + seen_base[s, far]) * r / (np.float32(far) + half)
                high = max(min(high, beam), low)
            apart = half * (high - low)
            std[i, j] = max(std[i, j], apart)
            if half * abs(seen[s, near] - seen[s, far]) > step:
                heights[i, j] = half * (high + low)
            else:
                # What other directions show does not lead out of what this one shows on both sides.
                slack = np.float32(SEEN_STD_M) + np.float32(GAP_SLOPE) * node_m * min(np.float32(far) - r, r - near)
                heights[i, j] = min(max(heights[i, j], low - slack), high + slack)
