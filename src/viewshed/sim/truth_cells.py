"""The cells of a grid in the orders in which the loops of the exact truth take them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.bev import BevGrid, polar_of_cells
from viewshed.sim.truth_bins import LANES as COLUMNS
from viewshed.sim.truth_kernels import LANES

_SIDE = 4
_ROUNDING = 1e-6
Floats = NDArray[np.float32]
Places = NDArray[np.int32]


@lru_cache(maxsize=2)
def ranges_of(grid: BevGrid) -> Floats:
    """Return the horizontal range of the centres (cells,) in metres."""
    return polar_of_cells(grid)[0].reshape(-1)


@lru_cache(maxsize=2)
def patches_of(grid: BevGrid) -> tuple[Floats, Places, Floats]:
    """Return the patches of 4 x 4 cells, as ``count_cells`` takes them; at the edge of a grid cells are repeated."""
    count = -(-grid.cells // _SIDE)
    rows = np.minimum(np.arange(count * _SIDE), grid.cells - 1).reshape(count, 1, _SIDE, 1)
    places = (rows * grid.cells + rows.reshape(1, count, 1, _SIDE)).reshape(-1, LANES)
    x, y = (grid.centers[..., axis].reshape(-1) for axis in range(2))
    some = np.maximum(ranges_of(grid), 1e-6)
    lanes = np.stack([x / some, y / some, ranges_of(grid)])[:, places].astype(np.float32).transpose(1, 0, 2)
    middle = np.arctan2(y[places].mean(axis=1), x[places].mean(axis=1))
    turned = np.arctan2(y[places], x[places]) - middle[:, None]
    spread = np.abs((turned + np.pi) % (2 * np.pi) - np.pi).max(axis=1) + _ROUNDING
    near, far = lanes[:, 2].min(axis=1), lanes[:, 2].max(axis=1)
    middles = np.stack([middle, spread, near, far], axis=1).astype(np.float32)
    return np.ascontiguousarray(lanes), places.astype(np.int32), middles


@lru_cache(maxsize=2)
def batches_of(grid: BevGrid, bins: int) -> tuple[Places, Floats, Places]:
    """Return the cells of each bin of azimuth, as ``see_cells`` takes them; the last of a bin are repeated."""
    azimuth = polar_of_cells(grid)[1].reshape(-1)
    own = ((azimuth + np.float32(np.pi)) * np.float32(bins / (2 * np.pi))).astype(np.int64).clip(0, bins - 1)
    order = np.lexsort((ranges_of(grid), own))
    starts = np.flatnonzero(np.diff(own[order], prepend=-1))
    counts = np.diff(starts, append=len(order))
    batches = -(-counts // COLUMNS)
    first = np.repeat(np.cumsum(batches) - batches, batches)
    step = (np.arange(len(first)) - first)[:, None] * COLUMNS + np.arange(COLUMNS)
    rows = np.repeat(starts, batches)[:, None] + np.minimum(step, np.repeat(counts, batches)[:, None] - 1)
    places = order[rows].astype(np.int32)
    return places, ranges_of(grid)[places], own[places[:, 0]].astype(np.int32)
