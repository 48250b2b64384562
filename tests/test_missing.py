import numpy as np
import pytest

from viewshed import BevGrid, Sweep
from viewshed.level import level_sweep
from viewshed.missing import missing_beams
from viewshed.sensors import LidarModel
from viewshed.sim import Box, Scene, cast

MODEL = LidarModel("test", np.deg2rad(np.linspace(-20, -2, 16)), azimuth_columns=360, max_range_m=200.0)
SWEEP = cast(MODEL, Scene((Box(15, 4, 1, 8, 3),)), 1.8)
GRID = BevGrid(64, 32.0)


def _without(kept: np.ndarray) -> Sweep:
    return SWEEP.select(kept)


def test_a_full_sweep_misses_nothing() -> None:
    assert len(missing_beams(level_sweep(SWEEP, GRID), fill=False).azimuth) == 0


def test_the_beams_left_out_are_found_where_they_aimed() -> None:
    assert SWEEP.ring is not None
    azimuth = np.arctan2(SWEEP.points[:, 1], SWEEP.points[:, 0])
    gone = (SWEEP.ring == 5) & (np.abs(azimuth - 1.0) < 0.05)
    missing = missing_beams(level_sweep(_without(~gone), GRID), fill=False)
    assert len(missing.azimuth) == gone.sum()
    assert np.allclose(np.sort(missing.azimuth), np.sort(azimuth[gone]), atol=np.deg2rad(1.0))
    assert np.allclose(missing.slope, np.tan(MODEL.elevation[5]), atol=2e-3)
    assert np.isinf(missing.depth_m).all()


def test_fill_gives_the_depth_of_the_nearer_neighbor() -> None:
    assert SWEEP.ring is not None
    azimuth = np.arctan2(SWEEP.points[:, 1], SWEEP.points[:, 0])
    gone = (SWEEP.ring == 5) & (np.abs(azimuth - 1.0) < 0.03)
    filled = missing_beams(level_sweep(_without(~gone), GRID), fill=True)
    ground_m = 1.8 / -np.tan(MODEL.elevation[5])
    assert len(filled.depth_m) == gone.sum()
    assert np.allclose(filled.depth_m, ground_m, rtol=0.02)


def test_a_gap_wider_than_the_neighbors_reach_stays_open() -> None:
    azimuth = np.arctan2(SWEEP.points[:, 1], SWEEP.points[:, 0])
    cropped = _without(np.abs(azimuth) < 1.0)
    filled = missing_beams(level_sweep(cropped, GRID), fill=True)
    unfilled = missing_beams(level_sweep(cropped, GRID), fill=False)
    assert 0 < len(filled.azimuth) < 0.25 * len(unfilled.azimuth)
    assert (np.abs(filled.azimuth) < 1.0 + np.deg2rad(18)).all()


@pytest.mark.parametrize("count", [0, 1])
def test_almost_nothing_is_no_failure(count: int) -> None:
    level = level_sweep(SWEEP.select(np.arange(count)), GRID)
    assert missing_beams(level, fill=True).azimuth.dtype == np.float32
