"""What the estimators share in azimuth bins, beside the plainest way to compute it."""

import numpy as np
import pytest

from viewshed.grid import BevGrid, polar_of_cells
from viewshed.preprocess.azimuth_bins import (
    Crop,
    azimuth_bins_of,
    bins_of_cells,
    farthest_in_bins,
    measured_azimuth_bins,
    within_limits,
)
from viewshed.preprocess.leveling import LeveledSweep, level
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


def test_the_farthest_return_of_a_bin_is_the_first_of_the_ordered_ones() -> None:
    leveled = _level(3000)
    bins = azimuth_bins_of(leveled.azimuth, 90)
    plain = [max(leveled.range_m[bins == b], default=-1.0) for b in range(90)]
    assert np.array_equal(farthest_in_bins(leveled, 90), np.array(plain, np.float32))
    second = [np.sort(np.append(leveled.range_m[bins == b], [-1.0, -1.0]))[-2] for b in range(90)]
    assert np.array_equal(farthest_in_bins(leveled, 90, drop=1), np.array(second, np.float32))


def test_without_a_number_of_bins_they_are_those_that_the_returns_fill() -> None:
    for count in (0, 3, 400, 3000):
        leveled = _level(count)
        bins = measured_azimuth_bins(leveled.azimuth)
        assert np.array_equal(farthest_in_bins(leveled, None), farthest_in_bins(leveled, bins))


def test_cells_within_a_limit_are_those_no_farther() -> None:
    limit_m = np.random.default_rng(3).uniform(-1.0, 25.0, 90).astype(np.float32)
    plain = polar_of_cells(GRID)[0] <= limit_m[bins_of_cells(GRID, 90)]
    assert np.array_equal(within_limits(GRID, limit_m), plain)
    assert plain.any()
