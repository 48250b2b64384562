"""Mean distance to the nearest neighbors: a balanced k-d tree whose queries follow its leaves, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_LEAF = 16
_ROOM = 96
_MANY = 48


@njit(cache=True, nogil=True, error_model="numpy")
def mean_distances(points: Any, k: int) -> Any:  # pragma: no cover - compiled
    """Return (N,) float64 metres: mean distance of each point (N, 3) to its ``k`` nearest others, 0 < k < N.

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
        leaves = _near_leaves(sorted_points, boxes, (reach, start), (leaf, start, end, depth), (near, stack))
        for n in range(start, end):
            if n == start + 1 and leaves > _MANY:
                leaves = _near_leaves(sorted_points, boxes, (reach, n), (leaf, start, end, depth), (near, stack))
            bound = _bound(sorted_points, reach, n, n)
            held = _gather(sorted_points, boxes, (n, k + 1, depth), bound, room, near[:leaves])
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
def _near_leaves(points: Any, boxes: Any, reaches: Any, rows: Any, out: Any) -> Any:  # pragma: no cover - compiled
    """Fill ``out[0]`` with the leaves that may hold neighbors of ``points[start:end]``, and return how many.

    ``reaches`` are the reaches of the points, and before which row they are known.
    """
    leaf, start, end, depth = rows
    reach, known = reaches
    near, stack = out
    bound = np.float32(0.0)
    for n in range(start, end):
        bound = max(bound, _bound(points, reach, known, n))
    first_leaf = (1 << depth) - 1
    own = boxes[first_leaf + leaf]
    found, used = 0, 1
    stack[0] = 0
    while used > 0:
        used -= 1
        node = stack[used]
        if _boxes_distance2(boxes[node], own) > bound:
            continue
        if node < first_leaf:
            stack[used], stack[used + 1] = 2 * node + 1, 2 * node + 2
            used += 2
        else:
            near[found] = node - first_leaf
            found += 1
    return found


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
    points: Any, boxes: Any, query: Any, bound: Any, room: Any, leaves: Any
) -> Any:  # pragma: no cover - compiled
    """Fill ``room`` with squared distances that hold the k smallest, that to itself among them, and return how many."""
    n, k, depth = query
    count, held = points.shape[0], 0
    first_leaf = (1 << depth) - 1
    for leaf in leaves:
        if _box_distance2(boxes[first_leaf + leaf], points[n]) > bound:
            continue
        if held + _LEAF + 1 > len(room):  # halves may differ by one
            bound = min(bound, _keep_smallest(room, held, k))
            held = k
            if bound == 0:
                return k
        for m in range((count * leaf) >> depth, (count * (leaf + 1)) >> depth):
            room[held] = _distance2(points, m, n)
            held += room[held] <= bound
    return held


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _box_distance2(box: Any, point: Any) -> Any:  # pragma: no cover - compiled
    x = max(box[0] - point[0], point[0] - box[3], np.float32(0.0))
    y = max(box[1] - point[1], point[1] - box[4], np.float32(0.0))
    z = max(box[2] - point[2], point[2] - box[5], np.float32(0.0))
    return x * x + y * y + z * z


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _boxes_distance2(a: Any, b: Any) -> Any:  # pragma: no cover - compiled
    x = max(a[0] - b[3], b[0] - a[3], np.float32(0.0))
    y = max(a[1] - b[4], b[1] - a[4], np.float32(0.0))
    z = max(a[2] - b[5], b[2] - a[5], np.float32(0.0))
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
