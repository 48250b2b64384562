"""Connected regions of a mask, and how deep a cell lies in one: what polygons need to know of masks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BoolMask = NDArray[np.bool_]


def label_regions(mask: BoolMask, diagonal: bool = False) -> NDArray[np.int32]:
    """Return the number of each cell's connected region (rows, columns), 0 where ``mask`` is False.

    Regions are numbered from 1 on by their first cells in row-major order. Cells connect across sides, with
    ``diagonal`` across corners as well.

    >>> label_regions(np.array([[True, False, True], [True, False, True], [False, True, False]])).tolist()
    [[1, 0, 2], [1, 0, 2], [0, 3, 0]]
    """
    # Runs: true cells that follow one another in a row have one number, ascending in row-major order, 0 outside.
    is_start = mask & ~np.pad(mask, ((0, 0), (1, 0)))[:, :-1]
    run = np.where(mask, np.cumsum(is_start, dtype=np.int32).reshape(mask.shape), np.int32(0))
    # Links: runs of neighboring rows that touch. A shift of a column is a contact at a corner.
    pairs = [(run[:-1], run[1:])]
    if diagonal:
        pairs += [(run[:-1, 1:], run[1:, :-1]), (run[:-1, :-1], run[1:, 1:])]
    above = np.concatenate([first[(first > 0) & (second > 0)] for first, second in pairs])
    below = np.concatenate([second[(first > 0) & (second > 0)] for first, second in pairs])
    # Union: each root takes the least root that it touches, until linked runs have one root.
    root = np.arange(int(run.max(initial=0)) + 1, dtype=np.int32)
    while (root[above] != root[below]).any():
        a, b = root[above], root[below]
        np.minimum.at(root, np.maximum(a, b), np.minimum(a, b))
        while (root[root] != root).any():
            root = root[root]
    # Roots are first runs; number them in their order.
    is_root = root == np.arange(len(root))
    number = np.cumsum(is_root, dtype=np.int32) - np.int32(1)
    labels: NDArray[np.int32] = number[root[run]]
    return labels


def squared_depth(mask: BoolMask) -> NDArray[np.int64]:
    """Return the squared distance (rows, columns) from each cell to the nearest False one, in cells; 0 at those.

    Cells beyond the border count as False.

    >>> squared_depth(np.ones((3, 4), bool)).tolist()
    [[1, 1, 1, 1], [1, 4, 4, 1], [1, 1, 1, 1]]
    """
    padded = np.pad(mask, 1)
    rows = np.arange(padded.shape[0])[:, None]
    # Along columns: the nearest False cell above or below.
    before = np.maximum.accumulate(np.where(padded, -1, rows), axis=0)
    after = np.minimum.accumulate(np.where(padded, padded.shape[0], rows)[::-1], axis=0)[::-1]
    along = (np.minimum(rows - before, after - rows) ** 2).astype(np.int64)
    # Across: a column k cells away can only bring those cells nearer that are deeper than k.
    depth, flat = along.ravel().copy(), along.ravel()
    cells, k = np.flatnonzero(padded), 1
    while len(cells := cells[depth[cells] > k * k]):
        nearer = np.minimum(flat[cells - k], flat[cells + k]) + k * k
        depth[cells] = np.minimum(depth[cells], nearer)
        k += 1
    found: NDArray[np.int64] = depth.reshape(padded.shape)[1:-1, 1:-1]
    return found
