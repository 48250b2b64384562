import pickle
from copy import deepcopy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewshed import BevGrid, Rigid
from viewshed.grid import polar_of_cells

grids = st.builds(BevGrid, st.integers(1, 64), st.floats(0.5, 100.0), st.tuples(st.floats(-20, 20), st.floats(-20, 20)))


@given(grids)
def test_the_center_of_a_cell_lies_in_that_cell(grid: BevGrid) -> None:
    cells, inside = grid.index(grid.centers)
    i, j = np.mgrid[: grid.cells, : grid.cells]
    assert inside.all()
    assert (cells[..., 0] == i).all()
    assert (cells[..., 1] == j).all()


def test_i_goes_forward_and_j_goes_left() -> None:
    grid = BevGrid(8, 4.0)
    assert grid.index(np.array([3.5, -3.5]))[0].tolist() == [7, 0]
    assert grid.index(np.array([-3.5, 3.5]))[0].tolist() == [0, 7]


def test_cells_are_half_open() -> None:
    cells, inside = BevGrid(4, 2.0).index(np.array([[-2.0, 0.0], [0.0, 1.0], [2.0, 0.0], [0.0, -2.01], [np.nan, 0.0]]))
    assert inside.tolist() == [True, True, False, False, False]
    assert cells.tolist() == [[0, 2], [2, 3], [-1, -1], [-1, -1], [-1, -1]]


@given(st.integers(0, 2**32 - 1))
def test_counts_agree_with_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = BevGrid(16, 8.0, (1.0, -2.0))
    points = rng.uniform(-12, 12, (200, 3)).astype(np.float32)
    edges = [np.linspace(-7, 9, 17), np.linspace(-10, 6, 17)]
    near = (points[:, 2] >= -5) & (points[:, 2] <= 6) & (np.hypot(points[:, 0], points[:, 1]) <= 9)
    oracle, *_ = np.histogram2d(points[near, 0], points[near, 1], bins=edges)
    counts = grid.count(points, max_range_m=9.0, height_m=(-5.0, 6.0))
    assert counts.dtype == np.int32
    assert (counts == oracle).all()


def test_counts_are_taken_after_the_transform() -> None:
    grid = BevGrid(8, 4.0)
    level_from_sensor = Rigid.from_yaw(np.pi / 2, (0.0, 0.0, 2.0))
    counts = grid.count(np.array([[2.5, 0.2, -1.5]], np.float32), level_from_sensor, height_m=(0.0, 1.0))
    assert np.argwhere(counts).tolist() == [[3, 6]]


def test_polar_of_cells_follows_the_offset() -> None:
    range_m, azimuth = polar_of_cells(BevGrid(1, 1.0, (3.0, 4.0)))
    assert range_m[0, 0] == pytest.approx(5.0)
    assert azimuth[0, 0] == pytest.approx(np.arctan2(4, 3))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 64.0), r"cells must lie in \[1, 4096\], got 0"),
        ((5000, 64.0), "cells must lie in"),
        ((8.0, 64.0), "cells must be a whole number, got 8.0"),
        ((4, 0.0), "half_extent_m must be positive"),
        ((4, float("nan")), "half_extent_m must be positive"),
        ((4, 1.0, (np.inf, 0.0)), "offset_m must be two finite numbers"),
    ],
)
def test_bad_grids_are_refused(arguments: tuple[int, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        BevGrid(*arguments)


@pytest.mark.parametrize("xy", [[[10.0], [5.0]], [10.0], 10.0, []])
def test_a_single_coordinate_is_no_place(xy: object) -> None:
    with pytest.raises(ValueError, match=r"points must have shape .* got"):
        BevGrid(8, 4.0).index(xy)  # type: ignore[arg-type]


def test_a_grid_is_its_numbers_whatever_their_types_and_is_pickled_without_its_centers() -> None:
    plain = BevGrid(64, 4.0, (1.0, 0.0))
    grid = BevGrid(np.int64(64), np.float32(4.0), np.array([1.0, 0.0]))  # type: ignore[arg-type]
    assert (grid, hash(grid), repr(grid)) == (plain, hash(plain), repr(plain))
    assert grid.centers.any()
    assert len(pickle.dumps(grid)) < 200
    assert not deepcopy(grid).centers.flags.writeable


def test_points_that_are_no_numbers_or_far_away_count_nowhere() -> None:
    odd = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [1e30, 0, 0], [0, -1e30, 0], [1, 1, np.nan]], np.float32)
    assert BevGrid(8, 4.0).count(odd).sum() == 0
    assert BevGrid(8, 4.0).count(np.zeros((0, 3), np.float32)).sum() == 0
