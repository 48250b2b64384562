"""Returns far from all others: statistical, radius and clustering outlier removal.

Two compiled searches serve them. Whether a point has enough neighbors within a radius is counted in a hashed grid of
cubes; mean distances to the nearest neighbors come from a k-d tree whose queries follow its leaves. Both are here
because scipy's tree takes two to three times as long for the 50 nearest and five to fifteen times as long for a radius.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from viewshed.sweep import Sweep
from viewshed.threats.defenses.base import Defended, without

_FARTHEST = 1e9
"""Cubes are numbered up to here, so that their numbers stay whole."""

_LEAF = 16
"""Points of a leaf, about."""

_ROOM = 96
"""Distances that are collected beside the k smallest before they are thinned out to these."""

_MANY = 48
"""With more leaves near a leaf than this, they are searched again once its first point gives a better bound."""

_ROUNDING = 1e-6
"""Share of the limit by which mean distances may exceed it: rounding makes no outlier of a lattice."""

_FARTHEST_M = 1e9
"""Coordinates are clipped here: their squares must stay finite."""


@dataclass(frozen=True, slots=True)
class StatisticalOutlierRemoval:
    """Drops returns whose mean distance to their nearest neighbors exceeds mean + ``deviations`` σ over the sweep.

    Rusu et al. 2008 ("Towards 3D point cloud based object maps for household environments"), as PCL's
    ``StatisticalOutlierRemoval`` with the parameters of its tutorial.

    Attributes:
        neighbors: nearest others of each return; all others where there are fewer.
        deviations: multiples of the standard deviation (of N - 1).
    """

    neighbors: int = 50
    deviations: float = 1.0

    def __post_init__(self) -> None:
        if not (1 <= self.neighbors <= 1000 and np.isfinite(self.deviations)):
            raise ValueError(f"neighbors must lie in [1, 1000] and deviations be finite, got {self}")

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without statistical outliers; one of fewer than three returns is kept."""
        count = len(sweep)
        if count < 3:
            return without(sweep, np.zeros(count, np.bool_))
        points = np.clip(sweep.points, -_FARTHEST_M, _FARTHEST_M)
        means = mean_distances(points, min(self.neighbors, count - 1))
        ordered = np.sort(means)  # so that the order of the points has no say in the sums
        limit = ordered.mean() + self.deviations * ordered.std(ddof=1)
        return without(sweep, means > limit * (1 + _ROUNDING))


@dataclass(frozen=True, slots=True)
class RadiusOutlierRemoval:
    """Drops returns with fewer than ``neighbors`` others within ``radius_m``.

    As PCL's ``RadiusOutlierRemoval`` with the parameters of its tutorial.

    Attributes:
        radius_m: the distance itself counts as within.
        neighbors: others that a return needs.
    """

    radius_m: float = 0.8
    neighbors: int = 2

    def __post_init__(self) -> None:
        if not (0 < self.radius_m < 1e3 and self.neighbors >= 1):
            raise ValueError(f"radius_m must lie in (0, 1000) and neighbors be at least 1, got {self}")

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without lonely returns."""
        every = np.ones(len(sweep), np.bool_)
        return without(sweep, ~have_neighbors(sweep.points, every, every, self.radius_m, self.neighbors))


@dataclass(frozen=True, slots=True)
class ClusteringOutlierRemoval:
    """Drops returns that DBSCAN calls noise: no cluster's core lies within ``radius_m``.

    Ester et al. 1996 with scikit-learn's parameters: a core has ``fewest`` returns within the radius, itself included.
    The clusters themselves are not needed to know what belongs to none.

    Attributes:
        radius_m: the distance itself counts as within (``eps``).
        fewest: returns about a core (``min_samples``).
    """

    radius_m: float = 0.5
    fewest: int = 5

    def __post_init__(self) -> None:
        if not (0 < self.radius_m < 1e3 and self.fewest >= 2):
            raise ValueError(f"radius_m must lie in (0, 1000) and fewest be at least 2, got {self}")

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without noise."""
        every = np.ones(len(sweep), np.bool_)
        core = have_neighbors(sweep.points, every, every, self.radius_m, self.fewest - 1)
        border = have_neighbors(sweep.points, core, ~core, self.radius_m, 1)
        return without(sweep, ~(core | border))


@njit(cache=True, nogil=True, error_model="numpy")
def have_neighbors(
    points: Any, marked: Any, queried: Any, radius_m: float, fewest: int
) -> Any:  # pragma: no cover - compiled
    """Return (N,) bool: ``queried`` points with at least ``fewest`` other ``marked`` points within ``radius_m``.

    ``points`` (N, 3); ``marked``, ``queried`` (N,) bool. Cubes of that side are hashed into a table; those that share a
    slot differ in their own indices. A point's own cube is counted first, and counting stops at ``fewest``.
    """
    count = points.shape[0]
    slots = 64
    while slots < 2 * count:
        slots *= 2
    cubes = np.empty((count, 3), np.int64)
    for n in range(count):
        for axis in range(3):
            cubes[n, axis] = int(np.floor(min(max(points[n, axis] / radius_m, -_FARTHEST), _FARTHEST)))
    starts, rows = _table(cubes, marked, slots)
    enough = np.zeros(count, np.bool_)
    for n in range(count):
        if queried[n]:
            enough[n] = _count(points, cubes, starts, rows, n, radius_m * radius_m, fewest) >= fewest
    return enough


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _slot(x: Any, y: Any, z: Any, slots: Any) -> Any:  # pragma: no cover - compiled
    """Hash of a cube (Teschner et al. 2003)."""
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (slots - 1)


@njit(cache=True, nogil=True, error_model="numpy")
def _table(cubes: Any, marked: Any, slots: int) -> Any:  # pragma: no cover - compiled
    """Return where each slot starts (slots + 1,) and the marked rows, slot by slot."""
    count = cubes.shape[0]
    starts = np.zeros(slots + 1, np.int32)
    slot = np.empty(count, np.int32)
    for n in range(count):
        slot[n] = _slot(cubes[n, 0], cubes[n, 1], cubes[n, 2], slots)
        starts[slot[n] + 1] += marked[n]
    for s in range(slots):
        starts[s + 1] += starts[s]
    filled, rows = starts[:-1].copy(), np.empty(starts[slots], np.int32)
    for n in range(count):
        if marked[n]:
            rows[filled[slot[n]]] = n
            filled[slot[n]] += 1
    return starts, rows


@njit(cache=True, nogil=True, error_model="numpy")
def _count(
    points: Any, cubes: Any, starts: Any, rows: Any, n: int, radius2: float, fewest: int
) -> Any:  # pragma: no cover - compiled
    """Count the neighbors of point ``n``, up to ``fewest``, from its own cube outward."""
    neighbors = 0
    for offset in range(27):
        cell = (offset + 13) % 27  # 13 is the cube itself
        x, y, z = cubes[n, 0] + cell // 9 - 1, cubes[n, 1] + cell // 3 % 3 - 1, cubes[n, 2] + cell % 3 - 1
        slot = _slot(x, y, z, len(starts) - 1)
        for k in range(starts[slot], starts[slot + 1]):
            m = rows[k]
            if m == n or cubes[m, 0] != x or cubes[m, 1] != y or cubes[m, 2] != z:
                continue
            apart2 = 0.0
            for axis in range(3):
                step = np.float64(points[m, axis]) - np.float64(points[n, axis])
                apart2 += step * step
            if apart2 <= radius2:
                neighbors += 1
                if neighbors >= fewest:
                    return neighbors
    return neighbors


@njit(cache=True, nogil=True, error_model="numpy")
def mean_distances(points: Any, k: int) -> Any:  # pragma: no cover - compiled
    """Return (N,) float64 meters: mean distance of each point (N, 3) to its ``k`` nearest others, 0 < k < N.

    Points are visited leaf by leaf. A point's k-th neighbor is at most as far as that of the point before plus the step
    between the two, so that the leaves near one leaf, found once, hold the neighbors of all its points.
    """
    count = points.shape[0]
    depth = 0
    while (count >> depth) > _LEAF:
        depth += 1
    order, sorted_points, boxes = _build(points, depth)
    means = np.empty(count, np.float64)
    room = np.empty(k + _ROOM, np.float32)
    near, stack = np.empty(1 << depth, np.int64), np.empty(2 * depth + 2, np.int64)
    reach = np.full(count, np.inf, np.float32)
    for leaf in range(1 << depth):
        start, end = (count * leaf) >> depth, (count * (leaf + 1)) >> depth
        leaves = _near_leaves(sorted_points, boxes, depth, leaf, start, end, reach, start, near, stack)
        for n in range(start, end):
            if n == start + 1 and leaves > _MANY:
                leaves = _near_leaves(sorted_points, boxes, depth, leaf, start, end, reach, n, near, stack)
            bound = _bound(sorted_points, reach, n, n)
            # The k + 1 smallest squared distances: a point is its own nearest, at 0.
            held = _gather(sorted_points, boxes, depth, n, k + 1, bound, near[:leaves], room)
            reach[n] = np.sqrt(_keep_smallest(room, held, k + 1))
            total = 0.0
            for j in range(k + 1):
                total += np.sqrt(room[j])
            means[order[n]] = total / k
    return means


@njit(cache=True, nogil=True, error_model="numpy")
def _bound(points: Any, reach: Any, known: Any, n: Any) -> Any:  # pragma: no cover - compiled
    """Squared distance within which the k nearest of point ``n`` lie, by the reaches of the points before ``known``."""
    best = np.float32(np.inf)
    for m in range(max(known - _LEAF, 0), known):
        best = min(best, reach[m] + np.sqrt(_distance2(points, m, n)))
    return best * best * np.float32(1.0001) + np.float32(1e-12)


@njit(cache=True, nogil=True, error_model="numpy")
def _near_leaves(
    points: Any, boxes: Any, depth: int, leaf: int, start: int, end: int, reach: Any, known: int, near: Any, stack: Any
) -> Any:  # pragma: no cover - compiled
    """Fill ``near`` with the leaves that may hold neighbors of ``points[start:end]``, and return how many.

    Those points are the ``leaf``'s; ``reach`` (N,) is how far the k-th neighbor of a point lies, known before row
    ``known``; ``stack`` is room.
    """
    bound = np.float32(0.0)
    for n in range(start, end):
        bound = max(bound, _bound(points, reach, known, n))
    first_leaf = (1 << depth) - 1
    own = boxes[first_leaf + leaf]
    leaves, used = 0, 1
    stack[0] = 0
    while used > 0:
        used -= 1
        node = stack[used]
        if _boxes_distance2(boxes[node], own[:3], own[3:]) > bound:
            continue
        if node < first_leaf:
            stack[used], stack[used + 1] = 2 * node + 1, 2 * node + 2
            used += 2
        else:
            near[leaves] = node - first_leaf
            leaves += 1
    return leaves


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _distance2(points: Any, a: Any, b: Any) -> Any:  # pragma: no cover - compiled
    x, y, z = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
    return x * x + y * y + z * z


@njit(cache=True, nogil=True, error_model="numpy")
def _build(points: Any, depth: int) -> Any:  # pragma: no cover - compiled
    """Return the order of the leaves (N,), the points in it, and the boxes (nodes, 6) of low and high corners.

    Node i has the children 2i + 1 and 2i + 2; each has half of its points.
    """
    count = points.shape[0]
    order = np.arange(count)
    boxes = np.empty(((2 << depth) - 1, 6), np.float32)
    for level in range(depth + 1):
        for k in range(1 << level):
            start, end = (count * k) >> level, (count * (k + 1)) >> level
            box = boxes[(1 << level) - 1 + k]
            box[:3], box[3:] = np.inf, -np.inf
            for n in range(start, end):
                for axis in range(3):
                    value = points[order[n], axis]
                    box[axis], box[3 + axis] = min(box[axis], value), max(box[3 + axis], value)
            if level < depth:
                axis = int(np.argmax(box[3:] - box[:3]))
                _halve(points[:, axis], order, start, end, (count * (2 * k + 1)) >> (level + 1))
    return order, points[order], boxes


@njit(cache=True, nogil=True, error_model="numpy")
def _halve(values: Any, order: Any, start: int, end: int, middle: int) -> None:  # pragma: no cover - compiled
    """Reorder ``order[start:end]`` so that no value before ``middle`` exceeds one from there on (Hoare's FIND)."""
    low, high = start, end - 1
    while low < high:
        pivot = values[order[(low + high) // 2]]
        i, j = low, high
        while i <= j:
            while values[order[i]] < pivot:
                i += 1
            while values[order[j]] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(
    points: Any, boxes: Any, depth: int, n: int, k: int, bound: Any, leaves: Any, room: Any
) -> Any:  # pragma: no cover - compiled
    """Fill ``room`` with squared distances from point ``n`` that hold the ``k`` smallest, and return how many.

    ``leaves`` may hold points within the squared distance ``bound``; the point itself is one of them.
    """
    count, held = points.shape[0], 0
    first_leaf = (1 << depth) - 1
    for leaf in leaves:
        if _boxes_distance2(boxes[first_leaf + leaf], points[n], points[n]) > bound:
            continue
        if held + _LEAF + 1 > len(room):  # halves may differ by one
            bound = min(bound, _keep_smallest(room, held, k))
            held = k
            if bound == 0:
                return k
        for m in range((count * leaf) >> depth, (count * (leaf + 1)) >> depth):
            room[held] = _distance2(points, m, n)
            held += room[held] <= bound  # kept only if it is near enough: no branch
    return held


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _boxes_distance2(box: Any, low: Any, high: Any) -> Any:  # pragma: no cover - compiled
    """Squared distance of a box (6,) and the one from ``low`` to ``high`` (3,), which are one point for a point."""
    x = max(box[0] - high[0], low[0] - box[3], np.float32(0.0))
    y = max(box[1] - high[1], low[1] - box[4], np.float32(0.0))
    z = max(box[2] - high[2], low[2] - box[5], np.float32(0.0))
    return x * x + y * y + z * z


@njit(cache=True, nogil=True, error_model="numpy")
def _keep_smallest(room: Any, held: int, k: int) -> Any:  # pragma: no cover - compiled
    """Move the ``k`` smallest of ``room[:held]`` to its front and return the largest of them (Hoare's FIND)."""
    low, high, middle = 0, held - 1, k - 1
    while low < high:
        pivot = room[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while room[i] < pivot:
                i += 1
            while room[j] > pivot:
                j -= 1
            if i <= j:
                room[i], room[j] = room[j], room[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    return room[middle]
