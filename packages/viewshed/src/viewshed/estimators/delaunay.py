"""Polygons fitted by Delaunay triangulation, without the long triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from viewshed.estimators.classical import ClassicalEstimator
from viewshed.estimators.concave_hull import fill, thinned
from viewshed.fov.visibility import CAR, Target
from viewshed.grid import BevGrid
from viewshed.preprocess.azimuth_bins import ALL_RETURNS, Crop, require
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep


@dataclass(frozen=True, slots=True)
class Delaunay(ClassicalEstimator):
    """Visible inside the triangles of the returns' Delaunay triangulation that have no edge above ``max_edge_m``.

    Source: Castagno and Atkins 2020 (PolyLidar), named in arXiv 2503.07375; there the edge filter is called ``lmax``.
    Returns are thinned out as for the concave hull. A cell is visible if its center lies inside a triangle that is
    kept. Degenerate returns give an empty estimate. Outside is UNKNOWN.

    Limits: unsuitable for LiDAR in bird's-eye view, as the paper says: rings on flat ground lie farther apart than
    ``max_edge_m`` from some 20 m on, so the polygon breaks into islands there, while a larger value fills shadows
    that are narrower than it.

    >>> import viewshed
    >>> corners = np.array([[3.0, -2.0, -1.7], [3.0, 2.0, -1.7], [6.0, 0.0, -1.7], [-9.0, 0.0, -1.7]])
    >>> estimate = Delaunay(BevGrid(32, 16.0)).estimate(viewshed.Sweep(corners, sensor_height_m=1.7))
    >>> estimate.at(np.array([[4.5, 0.5], [-4.5, 0.5]])).tolist()
    [1.0, 0.0]
    """

    grid: BevGrid  # where the cells are
    target: Target = CAR  # passed on; this estimator does not depend on it
    max_edge_m: float = 4.0  # longest edge of a triangle that is kept
    crop: Crop = ALL_RETURNS  # which returns count at all
    name: str = "delaunay"  # goes into the estimate's ``method``

    def __post_init__(self) -> None:
        require("max_edge_m", self.max_edge_m, 0.01, 1e6)

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return 1 in the union of the small triangles between the returns, 0 elsewhere."""
        leveled = self.crop.apply(leveled)
        points, spans_area = thinned(leveled, self.grid)
        visible = fill(self._edges(points) if spans_area else np.zeros((0, 4)), self.grid)
        return visible.astype(np.float32)

    def _edges(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the edges (E, 4) of all triangles kept, three a triangle, as x0, y0, x1, y1 in meters."""
        try:
            triangles = shapely.get_parts(shapely.delaunay_triangles(shapely.MultiPoint(points)))
        except shapely.GEOSException:  # all but on one line
            return np.zeros((0, 4))
        # A triangle's ring is closed: its last corner is the first again.
        corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
        sides = np.concatenate([corners, np.roll(corners, -1, axis=1)], axis=2)
        length_m = np.hypot(sides[..., 2] - sides[..., 0], sides[..., 3] - sides[..., 1])
        kept: NDArray[np.float64] = sides[length_m.max(axis=1) <= self.max_edge_m].reshape(-1, 4)
        return kept
