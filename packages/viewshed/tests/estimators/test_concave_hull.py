"""The concave hull by hand."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import _core

GRID = (-8.0, -8.0, 0.5, 32)


def _hull(xy: Any, length_m: float = 1.0, grid: tuple[float, float, float, int] = GRID) -> NDArray[np.float32]:
    points = np.zeros((len(xy), 3), np.float32)
    points[:, :2] = np.reshape(xy, (-1, 2))
    return _core.concave_hull(points, np.hypot(*points.T[:2]), 1.0, length_m, *grid)


def test_the_hull_of_an_l_leaves_its_notch_out() -> None:
    side = np.arange(-6.0, 6.1, 1.0)
    xy = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = _hull(xy[(xy[:, 0] <= 0) | (xy[:, 1] <= 0)] + 0.01)
    x, y = np.meshgrid(np.arange(32) * 0.5 - 7.75, np.arange(32) * 0.5 - 7.75, indexing="ij")
    assert (inside[(np.abs(x) < 5.9) & (np.abs(y) < 5.9) & ((x < -0.3) | (y < -0.3))] == 1).all()
    assert (inside[(x > 1.1) & (y > 1.1)] == 0).all()
    assert (_hull(xy[(xy[:, 0] <= 0) | (xy[:, 1] <= 0)], 20.0)[(x > 0) & (y > 0) & (x + y < 5)] == 1).all()


@pytest.mark.parametrize(
    "xy", [[], [[1, 2]], [[1, 2], [3, 4]], [[0, 0], [1, 1], [2, 2], [5, 5]], [[3, 1]] * 9, [[0, k] for k in range(7)]]
)
def test_points_on_a_line_have_no_hull(xy: list[list[float]]) -> None:
    assert not _hull(xy).any()


def test_far_points_have_a_hull() -> None:
    assert _hull([[-1e6, -1e6], [1e6, -1e6], [0, 1e6]]).all()
    assert not _core.fill_rings(np.full((3, 4), np.nan), 0.0, 0.0, 1.0, 4).any()
    assert _hull([[-1e30, -1e30], [1e30, -1e30], [0, 1e30], [1, 1], [2, 1]]).shape == (32, 32)


def test_the_order_of_points_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    xy = rng.normal(0.0, 3.0, (700, 2)).astype(np.float32)
    assert np.array_equal(_hull(xy), _hull(xy[rng.permutation(len(xy))]))
