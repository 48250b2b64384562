"""A costmap in the plane, for tests: what was marked stays until it is cleared, by a frustum or along beams."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed.grid import BevGrid


class Costmap:
    """Marks obstacles and clears them; the robot stands still at the origin."""

    def __init__(self, grid: BevGrid) -> None:
        self.grid = grid
        self.marked = np.zeros(grid.shape, np.bool_)

    def mark(self, points: NDArray[np.float64]) -> None:
        """Mark the cells of points (N, 2)."""
        cells, inside = self.grid.index(points)
        self.marked[cells[inside, 0], cells[inside, 1]] = True

    def clear_frustum(self, range_m: float) -> None:
        """Clear all that lies within the sensor's range, as a layer does that takes no occlusion into account."""
        self.marked[np.hypot(self.grid.centers[..., 0], self.grid.centers[..., 1]) <= range_m] = False

    def clear_beams(self, ends: NDArray[np.float64], least_m: float) -> None:
        """Clear the cells between ``least_m`` and the ends (N, 2) of beams from the origin, without the ends' own."""
        for end in ends:
            length = float(np.hypot(*end))
            along = np.arange(least_m, length - self.grid.cell_m / 2, self.grid.cell_m / 4)
            cells, inside = self.grid.index(end * (along[:, None] / max(length, 1e-9)))
            self.marked[cells[inside, 0], cells[inside, 1]] = False
