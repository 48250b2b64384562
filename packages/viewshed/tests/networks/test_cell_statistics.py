"""What the returns of a cell and of an azimuth say, beside the plainest way to compute it."""

import numpy as np
import pytest

from viewshed.fov.visibility import CAR
from viewshed.grid import BevGrid
from viewshed.networks.features import FeatureContext
from viewshed.preprocess.azimuth_bins import azimuth_bins_of, measured_azimuth_bins
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, level
from viewshed.sweep import Sweep

GRID = BevGrid(32, 16.0, (2.0, -1.0))
ABOVE_SENSOR_M = 1.8
LOW_M, HIGH_M = -2.0, 4.0


def _level(columns: int) -> LeveledSweep:
    rng = np.random.default_rng(columns)
    azimuth = np.tile((np.arange(columns) + 0.4) * 2 * np.pi / columns - np.pi, 4)
    range_m = rng.uniform(1.0, 40.0, len(azimuth))
    height_m = rng.uniform(-3.0, 5.0, len(azimuth)) - ABOVE_SENSOR_M
    points = np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), height_m], axis=1).astype(np.float32)
    sweep = Sweep(points, attitude=np.array([1.0, 0.0, 0.0, 0.0]), sensor_height_m=ABOVE_SENSOR_M)
    return level(sweep, GRID)


def _shown(leveled: LeveledSweep) -> FeatureContext:
    return FeatureContext(leveled, GRID, CAR, None)


@pytest.mark.parametrize("columns", [2000, 330, 130, 7])
def test_ranges_are_those_of_the_returns_of_each_bin(columns: int) -> None:
    leveled = _level(columns)
    farthest_m, blocker_m = _shown(leveled).ranges_m
    assert len(farthest_m) == len(blocker_m) == measured_azimuth_bins(leveled.azimuth)
    bins = azimuth_bins_of(leveled.azimuth, len(farthest_m))
    obstacle = (leveled.height_m > OBSTACLE_HEIGHTS_M[0]) & (leveled.height_m < OBSTACLE_HEIGHTS_M[1])
    plain = np.full(len(farthest_m), -1.0, np.float32), np.full(len(farthest_m), np.inf, np.float32)
    np.maximum.at(plain[0], bins, leveled.range_m)
    np.minimum.at(plain[1], bins[obstacle], leveled.range_m[obstacle])
    assert np.array_equal(farthest_m, plain[0])
    assert np.array_equal(blocker_m, plain[1])


def test_codes_ascend_with_the_height_of_the_lowest_and_the_highest_return() -> None:
    leveled = _level(700)
    (lowest, highest), (cells, inside) = _shown(leveled).height_codes, GRID.index(leveled.points)
    height_m = leveled.height_m.astype(float).clip(LOW_M, HIGH_M)
    code = 1 + (254 * (height_m - LOW_M) / (HIGH_M - LOW_M)).astype(int)
    for cell in np.unique(cells[inside], axis=0)[::9]:
        here = code[(cells == cell).all(axis=1)]
        assert abs(int(lowest[tuple(cell)]) - here.min()) <= 1
        assert abs(int(highest[tuple(cell)]) - here.max()) <= 1
    empty = np.ones(GRID.shape, bool)
    empty[tuple(cells[inside].T)] = False
    assert not lowest[empty].any()
    assert not highest[empty].any()


def test_no_return_says_nothing() -> None:
    shown = _shown(level(Sweep(np.zeros((0, 3), np.float32)), GRID))
    assert not np.any(shown.height_codes)
    farthest_m, blocker_m = shown.ranges_m
    assert np.isposinf(blocker_m).all()
    assert (farthest_m == -1.0).all()
