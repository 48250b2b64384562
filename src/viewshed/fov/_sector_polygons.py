"""The few sectors of a circle that cover the most of what lies below a profile of ranges, exactly.

A sector of several directions reaches as far as the shortest of them, so only the widest sectors for each range
matter. Those are nested or apart: they are the nodes of the profile's Cartesian tree (Vuillemin 1980), and choosing
``k`` of them is dynamic programming over the tree with the nearest chosen ancestor as state.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray


def best_sectors(
    ranges: NDArray[np.float64], sectors: int, inner_m: float = 0.0
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return the at most ``sectors`` sectors below ``ranges`` (bins,) of largest union: first bin, end bin, range.

    They may lie upon one another: a long narrow one over a short wide one. What is nearer than ``inner_m`` does not
    count. An end may exceed ``bins``: it wraps.

    >>> [part.tolist() for part in best_sectors(np.array([1.0, 1.0, 3.0, 1.0]), 2)]
    [[0, 2], [4, 3], [1.0, 3.0]]
    """
    bins, cut = len(ranges), int(np.argmin(ranges))
    rolled = np.maximum(np.roll(ranges, -cut), inner_m)
    parent, low, high = _tree(rolled)
    chosen = _choose(rolled, parent, low, high, sectors, inner_m)
    first = (low[chosen] + cut) % bins
    order = np.argsort(first, kind="stable")
    return first[order], (first + high[chosen] - low[chosen])[order], rolled[chosen][order]


@njit(cache=True, nogil=True)
def _tree(ranges: Any) -> Any:  # pragma: no cover - compiled
    """Return parent, first bin and end bin of each bin's widest sector; bin 0 is the shortest and the root."""
    bins = len(ranges)
    parent, low, high = np.full(bins, -1), np.arange(bins), np.full(bins, bins)
    stack, top = np.empty(bins, np.int64), 0
    for k in range(bins):
        last = -1
        while top > 0 and ranges[stack[top - 1]] > ranges[k]:
            top -= 1
            last = stack[top]
            high[last] = k
        if last >= 0:
            parent[last], low[k] = k, low[last]
        if top > 0:
            parent[k] = stack[top - 1]
        stack[top] = k
        top += 1
    return parent, low, high


@njit(cache=True, nogil=True)
def _choose(
    ranges: Any, parent: Any, low: Any, high: Any, sectors: int, inner: float
) -> Any:  # pragma: no cover - compiled
    """Return the nodes of the best choice. State: node, level of the nearest chosen ancestor, sectors to spend.

    Level 0 is none, level d + 1 the ancestor at depth d. ``below[d]`` is the best of the children of the node at
    depth d that is open, ``given`` the share that a node gets of what its parent spends on the children so far.
    """
    width = high - low
    order = np.argsort((low + 1) * (len(ranges) + 1) - width, kind="mergesort")
    _drop_repeats(order, ranges, parent, width)
    depth = _depths(order, parent)
    shape = (len(ranges), depth.max() + 2, sectors + 1)
    taken, given = np.zeros(shape, np.bool_), np.zeros(shape, np.int16)
    below = np.zeros((shape[1], shape[1], sectors + 1))
    path, value = np.empty(shape[1]), np.empty(sectors + 1)
    for n in range(len(order) - 1, -1, -1):
        node = order[n]
        children = below[depth[node]]
        _squares_above(node, parent, depth, ranges, path)
        path[0] = inner * inner
        for level in range(depth[node] + 1):
            value[:] = children[level]
            gain = (ranges[node] ** 2 - path[level]) * width[node]
            for k in range(1, sectors + 1):
                if gain + children[depth[node] + 1, k - 1] > value[k]:
                    value[k] = gain + children[depth[node] + 1, k - 1]
                    taken[node, level, k] = True
            if n > 0:
                _merge(below[depth[node] - 1, level], value, width[node], given[node, level])
        children[:] = 0.0
    return _collect(order, parent, depth, taken, given)


@njit(cache=True, nogil=True)
def _drop_repeats(order: Any, ranges: Any, parent: Any, width: Any) -> None:  # pragma: no cover - compiled
    """Give the children of a sector that reaches no farther than its parent to the parent, and it no width."""
    for node in order[1:]:
        if width[parent[node]] == 0:
            parent[node] = parent[parent[node]]
        if ranges[node] == ranges[parent[node]]:
            width[node] = 0


@njit(cache=True, nogil=True)
def _depths(order: Any, parent: Any) -> Any:  # pragma: no cover - compiled
    depth = np.zeros(len(order), np.int64)
    for node in order[1:]:
        depth[node] = depth[parent[node]] + 1
    return depth


@njit(cache=True, nogil=True)
def _squares_above(node: int, parent: Any, depth: Any, ranges: Any, path: Any) -> None:  # pragma: no cover - compiled
    above = parent[node]
    while above >= 0:
        path[depth[above] + 1] = ranges[above] ** 2
        above = parent[above]


@njit(cache=True, nogil=True)
def _merge(total: Any, value: Any, width: int, given: Any) -> None:  # pragma: no cover - compiled
    """Add a child to its siblings: ``total[k]`` becomes the best split of k, ``given[k]`` the child's part of it."""
    for k in range(len(total) - 1, -1, -1):
        best = total[k]
        for c in range(1, min(k, width) + 1):
            if total[k - c] + value[c] > best:
                best, given[k] = total[k - c] + value[c], c
        total[k] = best


@njit(cache=True, nogil=True)
def _collect(order: Any, parent: Any, depth: Any, taken: Any, given: Any) -> Any:  # pragma: no cover - compiled
    """Return the chosen nodes; children are met in the reverse of the order in which they were merged."""
    chosen, used = np.empty(taken.shape[2], np.int64), 0
    left, level = np.zeros(len(order), np.int64), np.zeros(len(order), np.int64)
    for n in range(len(order)):
        node = order[n]
        k = taken.shape[2] - 1
        if n > 0:
            level[node] = level[parent[node]]
            k = given[node, level[node], left[parent[node]]]
            left[parent[node]] -= k
        if taken[node, level[node], k]:
            chosen[used] = node
            used, k, level[node] = used + 1, k - 1, depth[node] + 1
        left[node] = k
    return chosen[:used]
