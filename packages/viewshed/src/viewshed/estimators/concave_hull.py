"""Concave hull of the returns in bird's-eye view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.estimators.classical import ClassicalEstimator
from viewshed.fov.visibility import CAR, Target
from viewshed.grid import BevGrid
from viewshed.preprocess.azimuth_bins import ALL_RETURNS, Crop, require
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep


@dataclass(frozen=True, slots=True)
class ConcaveHull(ClassicalEstimator):
    """Visible inside the concave hull of the returns. Source: arXiv 2503.07375; Park and Oh 2012 (concaveman).

    Only the farthest return in each cell of a lattice is used; the lattice has the grid's resolution (coarser if the
    returns spread over more than 1024 cells). A cell is visible if its center lies inside the hull, by the even-odd
    rule. Outside is UNKNOWN. Fewer than three cells with returns, or all on one line, give an empty estimate.

    Limits: the hull ignores the sensor's position; it does not enter gaps narrower than ``length_threshold_m``, so
    shadows of cars are called visible; one far point adds a spike to the hull; a rotation of the points may change the
    result by slivers.

    >>> import numpy as np
    >>> import viewshed
    >>> corners = np.array([[6.0, -6.0, -1.7], [6.0, 6.0, -1.7], [-6.0, 0.0, -1.7]])
    >>> estimate = ConcaveHull(BevGrid(32, 16.0)).estimate(viewshed.Sweep(corners, sensor_height_m=1.7))
    >>> estimate.at(np.array([[4.5, 3.5], [-4.5, 3.5]])).tolist()
    [1.0, 0.0]
    """

    grid: BevGrid  # grid of the estimate
    target: Target = CAR  # copied to the estimate; does not change the result
    concavity: float = 1.0  # 1 follows the points closely, larger values approach the convex hull
    length_threshold_m: float = 4.0  # shorter edges are not bent inward
    crop: Crop = ALL_RETURNS  # filter of the returns
    name: str = "concave_hull"  # becomes the estimate's ``method``

    def __post_init__(self) -> None:
        require("concavity", self.concavity, 0.1, 1e6)
        require("length_threshold_m", self.length_threshold_m, 0.0, 1e6)

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return 1 inside the hull of the returns, 0 elsewhere."""
        leveled, grid = self.crop.apply(leveled), self.grid
        return _core.concave_hull(
            leveled.points, leveled.range_m, self.concavity, self.length_threshold_m, *grid.origin_m, grid.cell_m,
            grid.cells,
        )  # fmt: skip


def thinned(leveled: LeveledSweep, grid: BevGrid) -> tuple[NDArray[np.float64], bool]:
    """Return the farthest return of each cell, (K, 2) meters, and whether these points span an area.

    The result does not depend on the order of the returns.
    """
    return _core.thin_returns(leveled.points, leveled.range_m, *grid.origin_m, grid.cell_m)


def fill(edges: NDArray[np.float64], grid: BevGrid) -> NDArray[np.bool_]:
    """Return the mask (cells, cells) of cell centers inside closed rings of edges (E, 4), by the even-odd rule.

    An edge that occurs twice, in either direction, cancels out: adjacent triangles become their union.

    >>> square = np.array([[0.0, 0, 2, 0], [2, 0, 2, 1], [2, 1, 0, 1], [0, 1, 0, 0]])
    >>> fill(square, BevGrid(4, 2.0)).astype(int).tolist()
    [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 1, 0], [0, 0, 1, 0]]
    """
    return _core.fill_rings(edges, *grid.origin_m, grid.cell_m, grid.cells)
