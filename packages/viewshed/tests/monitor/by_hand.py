"""Estimates with a known standard deviation."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viewshed import BevGrid
from viewshed.fov.estimate import CellState, FovEstimate

GRID = BevGrid(8, 8.0, (1.0, 0.0))


def estimate_of(
    std: ArrayLike, state: NDArray[np.uint8] | None = None, method: str = "by_hand", grid: BevGrid = GRID
) -> FovEstimate:
    """Return an estimate with this standard deviation; FREE everywhere unless ``state`` is given."""
    filled = np.broadcast_to(np.asarray(std, np.float32), grid.shape)
    states = np.full(grid.shape, CellState.FREE, np.uint8) if state is None else state
    return FovEstimate(grid, np.full(grid.shape, 0.5, np.float32), states, filled, method)
