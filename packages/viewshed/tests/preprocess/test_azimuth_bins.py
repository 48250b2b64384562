"""Which returns count, and the ranges of each bin, beside the plainest way to compute them."""

import numpy as np
import pytest

from viewshed import _core
from viewshed.grid import BevGrid
from viewshed.preprocess.azimuth_bins import Crop, azimuth_bins_of, measured_azimuth_bins
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, level
from viewshed.sweep import Sweep

GRID = BevGrid(32, 16.0, (2.0, -1.0))


def _level(count: int, seed: int = 4) -> LeveledSweep:
    rng = np.random.default_rng(seed)
    points = rng.uniform((-30, -30, -2), (30, 30, 2), (count, 3)).astype(np.float32)
    return level(Sweep(points, attitude=np.array([1.0, 0.0, 0.0, 0.0]), sensor_height_m=1.8), GRID)


@pytest.mark.parametrize("crop", [Crop(), Crop(12.0), Crop(100.0, (-0.5, 0.1)), Crop(6.0, (0.0, 0.2))])
def test_a_crop_knows_whether_a_return_that_counts_lies_on_the_grid(crop: Crop) -> None:
    found = []
    for seed in range(60):
        leveled = _level((0, 1, 4, 60)[seed % 4], seed)
        found.append(crop.any_on(leveled, GRID))
        assert found[-1] == GRID.index(crop.apply(leveled).points)[1].any()
    assert {True, False} == set(found)


def _rings(columns: int) -> LeveledSweep:
    rng = np.random.default_rng(columns)
    azimuth = np.tile((np.arange(columns) + 0.4) * 2 * np.pi / columns - np.pi, 4)
    range_m = rng.uniform(1.0, 40.0, len(azimuth))
    height_m = rng.uniform(-3.0, 5.0, len(azimuth)) - 1.8
    points = np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), height_m], axis=1).astype(np.float32)
    sweep = Sweep(points, attitude=np.array([1.0, 0.0, 0.0, 0.0]), sensor_height_m=1.8)
    return level(sweep, GRID)


@pytest.mark.parametrize("columns", [2000, 330, 130, 7])
def test_ranges_are_those_of_the_returns_of_each_bin(columns: int) -> None:
    leveled = _rings(columns)
    farthest_m = _core.farthest_in_bins(leveled.azimuth, leveled.range_m, None, 0)
    limit_m = _core.first_blocker(
        leveled.azimuth, leveled.range_m, leveled.height_m, *OBSTACLE_HEIGHTS_M, None, 1, 0, None, 0.0
    )
    assert len(farthest_m) == len(limit_m) == measured_azimuth_bins(leveled.azimuth)
    bins = azimuth_bins_of(leveled.azimuth, len(farthest_m))
    obstacle = (leveled.height_m > OBSTACLE_HEIGHTS_M[0]) & (leveled.height_m < OBSTACLE_HEIGHTS_M[1])
    plain = np.full(len(farthest_m), -1.0, np.float32), np.full(len(farthest_m), np.inf, np.float32)
    np.maximum.at(plain[0], bins, leveled.range_m)
    np.minimum.at(plain[1], bins[obstacle], leveled.range_m[obstacle])
    assert np.array_equal(farthest_m, plain[0])
    assert np.array_equal(limit_m, np.where(plain[0] < 0.0, -1.0, np.minimum(*plain)))


def test_bins_without_returns_have_no_range() -> None:
    nothing = np.zeros(0, np.float32)
    for bins in (None, 36):
        assert (_core.farthest_in_bins(nothing, nothing, bins, 0) == -1.0).all()
        limit_m = _core.first_blocker(nothing, nothing, nothing, *OBSTACLE_HEIGHTS_M, bins, 1, 0, None, 0.0)
        assert (limit_m == -1.0).all()
