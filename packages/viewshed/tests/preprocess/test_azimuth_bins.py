"""Which returns count: whether one of them lies on a grid, beside the plainest way to compute it."""

import numpy as np
import pytest

from viewshed.grid import BevGrid
from viewshed.preprocess.azimuth_bins import Crop
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
