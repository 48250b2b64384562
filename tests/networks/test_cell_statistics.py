"""One pass over the returns tells what the plain functions tell, one after the other."""

import numpy as np
import pytest

from viewshed.grid import BevGrid
from viewshed.networks.features import EVIDENCE_BINS, HEIGHTS_M, cell_statistics
from viewshed.preprocess.azimuth_bins import (
    azimuth_bins_of,
    farthest_in_bins,
    measured_azimuth_bins,
    nearest_obstacle_in_bins,
)
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, level
from viewshed.sweep import Sweep

GRID = BevGrid(32, 16.0, (2.0, -1.0))
ABOVE_SENSOR_M = 1.8


def _level(columns: int) -> LeveledSweep:
    rng = np.random.default_rng(columns)
    azimuth = np.tile((np.arange(columns) + 0.4) * 2 * np.pi / columns - np.pi, 4)
    range_m = rng.uniform(1.0, 40.0, len(azimuth))
    height_m = rng.uniform(-3.0, 5.0, len(azimuth)) - ABOVE_SENSOR_M
    points = np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), height_m], axis=1).astype(np.float32)
    sweep = Sweep(points, attitude=np.array([1.0, 0.0, 0.0, 0.0]), sensor_height_m=ABOVE_SENSOR_M)
    return level(sweep, GRID)


@pytest.mark.parametrize("columns", [2000, 700, 400, 330, 190, 130, 7])
def test_azimuths_and_obstacles_are_those_of_the_plain_functions(columns: int) -> None:
    leveled = _level(columns)
    found = cell_statistics(leveled, GRID)
    assert found.bins == measured_azimuth_bins(leveled.azimuth)
    assert np.array_equal(found.blocker_m, nearest_obstacle_in_bins(leveled, found.bins, 1, OBSTACLE_HEIGHTS_M))
    assert np.array_equal(found.farthest_m, farthest_in_bins(leveled, found.bins))
    bins = azimuth_bins_of(leveled.azimuth, EVIDENCE_BINS)
    assert np.array_equal(found.returns, np.bincount(bins, minlength=EVIDENCE_BINS))
    assert np.array_equal(found.obstacle, leveled.obstacle_cells(GRID))
    assert found.obstacle.any()


def test_codes_ascend_with_the_height_of_the_lowest_and_the_highest_return() -> None:
    leveled = _level(700)
    found, (cells, inside) = cell_statistics(leveled, GRID), GRID.index(leveled.points)
    low, high = HEIGHTS_M
    code = 1 + (254 * (leveled.height_m.astype(float).clip(low, high) - low) / (high - low)).astype(int)
    for cell in np.unique(cells[inside], axis=0)[::9]:
        here = code[(cells == cell).all(axis=1)]
        assert abs(int(found.lowest[tuple(cell)]) - here.min()) <= 1
        assert abs(int(found.highest[tuple(cell)]) - here.max()) <= 1
    empty = np.ones(GRID.shape, bool)
    empty[tuple(cells[inside].T)] = False
    assert not found.lowest[empty].any()
    assert not found.highest[empty].any()


def test_no_return_tells_nothing() -> None:
    found = cell_statistics(level(Sweep(np.zeros((0, 3), np.float32)), GRID), GRID)
    for each in (found.lowest, found.highest, found.obstacle, found.returns):
        assert not each.any()
    assert np.isposinf(found.blocker_m).all()
    assert (found.farthest_m == -1.0).all()
