"""Concave hull of the returns in bird's-eye view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.estimators.base import ClassicalEstimator
from viewshed.fov.visibility import CAR, Target
from viewshed.grid import BevGrid
from viewshed.preprocess.azimuth_bins import ALL_RETURNS, Crop, require
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep

MAX_LATTICE = 1024
"""Most cells per side of the lattice on which the returns are thinned out."""

_MIN_SPREAD_M2 = 1e-4

_SCATTER, _TURN = np.uint64(2654435761), np.uint64(2**32)
"""Knuth's multiplicative hash: the hull library's search tree is 1.5 times faster on points in scattered order."""


@dataclass(frozen=True, slots=True)
class ConcaveHull(ClassicalEstimator):
    """Visible inside the concave hull of the returns. Source: arXiv 2503.07375; Park and Oh 2012 (concaveman).

    The returns are thinned out to the farthest one in each cell of a lattice as fine as the grid (coarser if they
    spread over more than 1024 cells). A cell is visible if its center lies inside the hull, by the even-odd rule.
    Fewer than three cells with returns, or all on one line, give an empty estimate. Outside is UNKNOWN.

    Limits: the hull does not know where the sensor is; ``length_threshold_m`` keeps it from entering gaps narrower
    than that, so shadows of cars are called visible; one far point pulls a spike of hull behind it; the result may
    change by slivers if the points are turned.

    Attributes:
        grid: where the cells are.
        target: passed on; this estimator does not depend on it.
        concavity: 1 follows the points closely, larger values approach the convex hull.
        length_threshold_m: edges shorter than this are not bent inward.
        crop: which returns count at all.
        name: goes into the estimate's ``method``.

    >>> import numpy as np
    >>> import viewshed
    >>> corners = np.array([[6.0, -6.0, -1.7], [6.0, 6.0, -1.7], [-6.0, 0.0, -1.7]])
    >>> estimate = ConcaveHull(BevGrid(32, 16.0)).estimate(viewshed.Sweep(corners, sensor_height_m=1.7))
    >>> estimate.at(np.array([[4.5, 3.5], [-4.5, 3.5]])).tolist()
    [1.0, 0.0]
    """

    grid: BevGrid
    target: Target = CAR
    concavity: float = 1.0
    length_threshold_m: float = 4.0
    crop: Crop = ALL_RETURNS
    name: str = "concave_hull"

    def __post_init__(self) -> None:
        require("concavity", self.concavity, 0.1, 1e6)
        require("length_threshold_m", self.length_threshold_m, 0.0, 1e6)

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return 1 inside the hull of the returns, 0 elsewhere."""
        leveled = self.crop.apply(leveled)
        points = thinned(leveled, self.grid)
        visible = fill(self._edges(points), self.grid) if spans_area(points) else np.zeros(self.grid.shape, np.bool_)
        return visible.astype(np.float32)

    def _edges(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the hull's edges (E, 4) as x0, y0, x1, y1 in meters."""
        from concave_hull import concave_hull_indexes

        points = points[np.argsort(np.arange(len(points), dtype=np.uint64) * _SCATTER % _TURN)]
        found = concave_hull_indexes(points, concavity=self.concavity, length_threshold=self.length_threshold_m)
        ring = points[found]
        return np.hstack([ring, np.roll(ring, -1, axis=0)])


def thinned(leveled: LeveledSweep, grid: BevGrid) -> NDArray[np.float64]:
    """Return the points (K, 2) in meters: the farthest return of each cell, whatever the order of the returns."""
    if not len(leveled.points):
        return np.zeros((0, 2))
    x, y = leveled.points[:, 0], leveled.points[:, 1]
    low, high = np.array([x.min(), y.min()], np.float64), np.array([x.max(), y.max()], np.float64)
    cell_m = max(grid.cell_m, float((high - low).max()) / (MAX_LATTICE - 2))
    origin = np.array(grid.origin_m)
    origin = origin + np.floor((low - origin) / cell_m) * cell_m
    sides = np.floor((high - origin) / cell_m).astype(np.int64) + 1
    farthest = np.full((int(sides[0]), int(sides[1])), -1, np.int32)
    _thin(leveled.points, leveled.range_m, np.array([*origin, 1.0 / cell_m]), farthest)
    rows = farthest.ravel()
    return leveled.points[rows[rows >= 0], :2].astype(np.float64)


def spans_area(points: NDArray[np.float64]) -> bool:
    """Tell whether points (K, 2) are three or more that do not lie on one line."""
    if len(points) < 3:
        return False
    away = points - points.mean(axis=0)
    return bool(np.linalg.eigvalsh(away.T @ away)[0] > _MIN_SPREAD_M2)


def fill(edges: NDArray[np.float64], grid: BevGrid) -> NDArray[np.bool_]:
    """Return the mask (cells, cells) of cell centers inside closed rings of edges (E, 4), by the even-odd rule.

    An edge that occurs twice, in either direction, cancels out: adjacent triangles make their union.

    >>> square = np.array([[0.0, 0, 2, 0], [2, 0, 2, 1], [2, 1, 0, 1], [0, 1, 0, 0]])
    >>> fill(square, BevGrid(4, 2.0)).astype(int).tolist()
    [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 1, 0], [0, 0, 1, 0]]
    """
    inside = np.zeros(grid.shape, np.bool_)
    _fill(edges, np.array([*grid.origin_m, grid.cell_m]), inside)
    return inside


@njit(cache=True, nogil=True)
def _thin(points: Any, range_m: Any, lattice: Any, farthest: Any) -> None:  # pragma: no cover - compiled
    for n in range(points.shape[0]):
        i = min(max(int((points[n, 0] - lattice[0]) * lattice[2]), 0), farthest.shape[0] - 1)
        j = min(max(int((points[n, 1] - lattice[1]) * lattice[2]), 0), farthest.shape[1] - 1)
        m = farthest[i, j]
        tie = m >= 0 and range_m[n] == range_m[m] and (points[n, 0], points[n, 1]) > (points[m, 0], points[m, 1])
        if m < 0 or range_m[n] > range_m[m] or tie:
            farthest[i, j] = n


@njit(cache=True, nogil=True)
def _fill(edges: Any, lattice: Any, inside: Any) -> None:  # pragma: no cover - compiled
    """Flip each row from the edge's crossing on; half-open in x, so that shared corners count once."""
    cells = inside.shape[0]
    x_low, y_low, cell_m = lattice
    for e in range(edges.shape[0]):
        x0, y0, x1, y1 = edges[e]
        if x0 > x1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        first = int(np.ceil(min(max((x0 - x_low) / cell_m - 0.5, 0.0), cells)))
        end = int(np.ceil(min(max((x1 - x_low) / cell_m - 0.5, 0.0), cells)))
        for i in range(first, end):
            y = y0 + (y1 - y0) * ((x_low + (i + 0.5) * cell_m - x0) / (x1 - x0))
            j = int(np.ceil(min(max((y - y_low) / cell_m - 0.5, 0.0), cells)))
            if j < cells:
                inside[i, j] = not inside[i, j]
    for i in range(cells):
        for j in range(1, cells):
            inside[i, j] = inside[i, j] != inside[i, j - 1]
