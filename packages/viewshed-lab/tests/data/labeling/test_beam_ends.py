"""What became of beams that did not return: scenes by hand over level ground."""

import numpy as np
import pytest

from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import level
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep
from viewshed_lab.data.labeling.beam_ends import OPEN, SURFACE, SWALLOWED, BeamEnds, beam_ends_of
from viewshed_lab.data.labeling.beam_image import AT_REST, beam_image
from viewshed_lab.data.labeling.ground_map import lows_of, patch_of

GRID = BevGrid(64, 32.0)
HEIGHT_M, WALL_M, FADES_M = 1.5, 10.0, 30.0
MODEL = LidarModel("hand", np.deg2rad(np.linspace(-20, 4, 25)), 360, max_range_m=60.0)
AZIMUTH = ((np.arange(360) + 0.5) / 360 - 0.5) * 2 * np.pi
SLOPE = np.tan(MODEL.elevation)
WALL = slice(200, 260)
"""Columns at 20° to 80° to the left, where a wall stands ten meters away, across every line of sight."""


def _ranges() -> np.ndarray:
    """Horizontal ranges (360, 25): the wall, else the ground as far as it returns, else nothing (0)."""
    with np.errstate(divide="ignore"):
        ground = np.where(SLOPE < 0, -HEIGHT_M / SLOPE, np.inf)
    range_m = np.tile(np.where(ground < FADES_M, ground, 0.0), (360, 1))
    range_m[WALL] = np.where(ground < WALL_M, ground, WALL_M)
    return range_m


def _stops(range_m: np.ndarray) -> BeamEnds:
    column, ring = np.nonzero(range_m)
    r, a = range_m[column, ring], AZIMUTH[column]
    points = np.stack([r * np.cos(a), r * np.sin(a), r * SLOPE[ring]], axis=-1)
    upright = np.array([1.0, 0, 0, 0])
    sweep = Sweep(
        points.astype(np.float32), ring=ring.astype(np.int16), model=MODEL, sensor_height_m=HEIGHT_M, attitude=upright
    )
    leveled = level(sweep, GRID)
    patch = patch_of(leveled, [lows_of(leveled.points, Rigid.identity(), 0.5, 48.0)], 32.0, 0.5)
    return beam_ends_of(beam_image(sweep, np.eye(3), AT_REST), patch)


def _length(range_m: float, ring: int) -> float:
    return float(range_m / np.cos(MODEL.elevation[ring]))


def test_far_ground_that_gives_no_light_back_is_open_up_to_the_ground() -> None:
    stops = _stops(_ranges())
    ring = 18  # two degrees down, 43 m to the ground
    assert stops.kind[100, ring] == OPEN
    assert stops.best_m[100, ring] == pytest.approx(-HEIGHT_M / np.sin(MODEL.elevation[ring]), rel=0.03)
    assert stops.best_m[100, 24] == pytest.approx(60.0)  # upwards: the maximum range


def test_one_lost_return_on_the_ground_is_ground() -> None:
    range_m = _ranges()
    lost = range_m[100, 8]
    range_m[100, 8] = 0
    stops = _stops(range_m)
    assert stops.kind[100, 8] == OPEN
    assert stops.min_m[100, 8] == pytest.approx(_length(lost, 8), rel=0.02)
    assert stops.max_m[100, 8] == pytest.approx(_length(lost, 8), rel=0.02)


def test_one_lost_return_on_a_wall_is_surely_wall_a_window_only_likely() -> None:
    range_m = _ranges()
    range_m[215, 22] = 0
    range_m[230:240, 16:23] = 0
    stops = _stops(range_m)
    assert stops.kind[215, 22] == SURFACE
    assert stops.max_m[215, 22] == pytest.approx(_length(WALL_M, 22), rel=0.01)
    assert stops.kind[234, 20] == SURFACE
    assert stops.best_m[234, 20] == pytest.approx(_length(WALL_M, 20), rel=0.01)
    assert stops.max_m[234, 20] > 3 * WALL_M


def test_a_black_car_on_near_ground_swallows_beams() -> None:
    range_m = _ranges()
    range_m[90:110, 4:14] = 0
    stops = _stops(range_m)
    assert (stops.kind[92:108, 6:12] == SWALLOWED).all()
    assert (stops.min_m[92:108, 6:12] == 0).all()
    assert stops.max_m[100, 8] == pytest.approx(-HEIGHT_M / np.sin(MODEL.elevation[8]), rel=0.03)


def test_a_lost_sector_tells_nothing() -> None:
    range_m = _ranges()
    range_m[40:80] = 0
    stops = _stops(range_m)
    assert (stops.kind[42:78] == SWALLOWED).all()
    assert (stops.best_m[42:78] == 0).all()
    assert stops.max_m[60, 24] == pytest.approx(60.0)


def test_snow_in_the_air_stops_no_beam() -> None:
    range_m, rng = _ranges(), np.random.default_rng(3)
    clear = _stops(range_m)
    flakes = rng.random(range_m.shape) < 0.1
    range_m[flakes] = rng.uniform(2.0, 5.0, int(flakes.sum()))
    snowy = _stops(range_m)
    leveled = (slice(None), slice(18, 25))  # beams that end far away
    assert (np.abs(snowy.best_m - clear.best_m) < 1.0)[leveled].mean() > 0.97
    assert (snowy.best_m < 6.0)[leveled].mean() < 0.02


def test_a_dead_ring_tells_nothing() -> None:
    range_m = _ranges()
    range_m[:, 8] = 0
    stops = _stops(range_m)
    assert (stops.min_m[:, 8] == 0).all()
