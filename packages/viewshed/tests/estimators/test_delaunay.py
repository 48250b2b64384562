import numpy as np
import pytest
from scipy import spatial

from viewshed.estimators.concave_hull import fill
from viewshed.estimators.delaunay import Delaunay
from viewshed.grid import BevGrid

GRID = BevGrid(64, 16.0)


@pytest.mark.parametrize("count", [3, 10, 400])
def test_the_triangles_kept_are_those_of_qhull(count: int) -> None:
    points = np.random.default_rng(count).uniform(-15.0, 15.0, (count, 2))
    estimator = Delaunay(GRID, max_edge_m=12.0 if count == 10 else 4.0 if count == 400 else 60.0)
    corners = points[spatial.Delaunay(points).simplices]
    sides = np.concatenate([corners, np.roll(corners, -1, axis=1)], axis=2)
    length_m = np.hypot(sides[..., 2] - sides[..., 0], sides[..., 3] - sides[..., 1])
    expected = fill(sides[length_m.max(axis=1) <= estimator.max_edge_m].reshape(-1, 4), GRID)
    assert expected.any()
    np.testing.assert_array_equal(fill(estimator._edges(points), GRID), expected)


def test_points_on_a_lattice_fill_their_square() -> None:
    """Four points on one circle may be split along either diagonal: the union is the same."""
    side = np.arange(-5.0, 6.0)
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    filled = fill(Delaunay(GRID, max_edge_m=1.5)._edges(points), GRID)
    inside = np.abs(GRID.centers).max(axis=-1) < 5.0
    np.testing.assert_array_equal(filled, inside)
    assert not Delaunay(GRID, max_edge_m=1.2)._edges(points).size


@pytest.mark.parametrize("points", [[[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]])
def test_points_on_a_line_make_no_triangle(points: list[list[float]]) -> None:
    assert Delaunay(GRID)._edges(np.array(points)).shape == (0, 4)
