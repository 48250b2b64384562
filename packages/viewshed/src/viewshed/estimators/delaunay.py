"""Delaunay triangulation of the returns in bird's-eye view, without triangles that have long edges."""

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

    Source: Castagno and Atkins 2020 (PolyLidar, edge filter ``lmax``), cited in arXiv 2503.07375. Returns are thinned
    as for the concave hull. A cell is visible if its center lies inside such a triangle; outside is UNKNOWN.
    Fewer than three points, or all on one line, give an empty estimate.

    Limits: unsuitable for LiDAR in bird's-eye view, as the paper says: beyond about 20 m rings on flat ground are
    farther apart than ``max_edge_m``, so the polygon breaks into islands; a larger value fills the narrower shadows.

    >>> import viewshed
    >>> corners = np.array([[3.0, -2.0, -1.7], [3.0, 2.0, -1.7], [6.0, 0.0, -1.7], [-9.0, 0.0, -1.7]])
    >>> estimate = Delaunay(BevGrid(32, 16.0)).estimate(viewshed.Sweep(corners, sensor_height_m=1.7))
    >>> estimate.at(np.array([[4.5, 0.5], [-4.5, 0.5]])).tolist()
    [1.0, 0.0]
    """

    grid: BevGrid  # grid of the estimate
    target: Target = CAR  # copied to the estimate; does not change the result
    max_edge_m: float = 4.0  # maximum edge length of a triangle
    crop: Crop = ALL_RETURNS  # filter of the returns
    name: str = "delaunay"  # becomes the estimate's ``method``

    def __post_init__(self) -> None:
        require("max_edge_m", self.max_edge_m, 0.01, 1e6)

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return 1 in the union of the small triangles between the returns, 0 elsewhere."""
        leveled = self.crop.apply(leveled)
        points, spans_area = thinned(leveled, self.grid)
        visible = fill(self._edges(points) if spans_area else np.zeros((0, 4)), self.grid)
        return visible.astype(np.float32)

    def _edges(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the edges (E, 4) of the kept triangles, three per triangle, as x0, y0, x1, y1 in meters."""
        try:
            triangles = shapely.get_parts(shapely.delaunay_triangles(shapely.MultiPoint(points)))
        except shapely.GEOSException:  # all but on one line
            return np.zeros((0, 4))
        # Each triangle is a closed ring of four points; drop the last, which repeats the first.
        corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
        sides = np.concatenate([corners, np.roll(corners, -1, axis=1)], axis=2)
        length_m = np.hypot(sides[..., 2] - sides[..., 0], sides[..., 3] - sides[..., 1])
        kept: NDArray[np.float64] = sides[length_m.max(axis=1) <= self.max_edge_m].reshape(-1, 4)
        return kept
