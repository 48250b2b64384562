"""What cells say of boxes: counted by hand on a small grid, asymmetric on purpose."""

from __future__ import annotations

import numpy as np
import pytest

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.objects.association import inside
from viewshed.objects.cells import SeenCells, footprint_points

GRID = BevGrid(256, 32.0)

PLACE = np.zeros(2)


def _cells(pose: Rigid | None = None) -> SeenCells:
    """Return a view that is free but for a car's side, 4 m wide from y = -1 to 3 at x = 10, and its shadow."""
    x, y = GRID.centers[..., 0], GRID.centers[..., 1]
    state = np.full(GRID.shape, CellState.FREE, np.uint8)
    side = (y > -1.0) & (y < 3.0) & (x > 10.0)
    state[side] = CellState.HIDDEN
    state[side & (x < 10.5)] = CellState.SURFACE
    state[x < -20.0] = CellState.UNKNOWN
    return SeenCells(GRID, state, pose or Rigid.identity())


def test_shares_of_a_car_a_ghost_and_a_box_in_the_shadow() -> None:
    """A car at the surface has surface and shadow, one in the open is free, one behind is hidden."""
    boxes = np.array([
        [11.0, 1.0, 0.75, 2.0, 4.0, 1.5, 0.0], [5.0, -9.0, 0.75, 4.0, 2.0, 1.5, 0.4],
        [20.0, 1.0, 0.75, 2.0, 2.0, 1.5, 0.0],
        [-25.0, 1.0, 0.75, 2.0, 2.0, 1.5, 0.0],
    ])  # fmt: skip
    look = _cells().look(boxes, PLACE)
    assert look.surface[0] == pytest.approx(0.2, abs=0.1)
    assert look.hidden[0] > 0.4
    assert look.free[1:3].tolist() == [1.0, 0.0]
    assert look.hidden[2] == 1.0
    assert (look.surface + look.free + look.hidden)[3] == 0.0
    assert look.first_m[0] < 1.0
    assert look.first_m[1] == 10.0
    assert look.ring_free[1] == 1.0
    assert look.range_m[1] == pytest.approx(np.hypot(5.0, 9.0))


def test_points_of_a_footprint_lie_in_it_and_span_it() -> None:
    rng = np.random.default_rng(4)
    boxes = np.column_stack([rng.uniform(-9, 9, (50, 3)), rng.uniform(1, 9, (50, 3)), rng.uniform(-3, 3, 50)])
    for box, points in zip(boxes, footprint_points(boxes, margin_m=0.0), strict=True):
        assert inside(points, box[None], 1e-9).all()
        assert not inside(points, box[None] * [1, 1, 1, 0.8, 1, 1, 1]).all()
        assert not inside(points, box[None] * [1, 1, 1, 1, 0.6, 1, 1]).all()
        np.testing.assert_allclose(points.mean(axis=0), box[:2], atol=1e-9)


def test_cells_of_an_estimate_without_a_pose_are_in_its_own_frame() -> None:
    """An estimate that knows no world is asked in ``level``."""
    estimate = FovEstimate(GRID, np.ones(GRID.shape, np.float32), _cells().state)
    assert SeenCells.of(estimate).states_at(np.array([[10.25, 2.0]])).tolist() == [CellState.SURFACE]
