"""Sensors that report several returns of a beam: the farthest counts, and says what a sensor with one return says."""

import time

import numpy as np
import pytest

from viewshed import Sweep, _core, lidar_model
from viewshed.arrays import F32, Mask
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.visibility import CAR
from viewshed.grid import GRIDS, BevGrid
from viewshed.guarantees.envelope import Envelope, Given
from viewshed.preprocess.leveling import level
from viewshed_lab.sim import Box, Scene, cast

GRID = BevGrid(128, 32.0)
BOXES = Box(14, 6, 1, 20, 8), Box(-20, -3, 1, 60, 9), Box(6, -9, 4.2, 1.8, 1.5)
STREET = cast(lidar_model("vlp16"), Scene(BOXES), 1.8)


def with_nearer_returns(sweep: Sweep, share: float = 0.3, seed: int = 5) -> Sweep:
    """Light of some beams meets a leaf on its way: that return follows the one of the beam's end."""
    rng = np.random.default_rng(seed)
    meets = np.flatnonzero(rng.random(len(sweep)) < share)
    rows = np.sort(np.concatenate([np.arange(len(sweep)), meets]))
    second = np.append(False, rows[1:] == rows[:-1])
    points = sweep.points[rows].copy()
    points[second] *= rng.uniform(0.3, 0.95, (int(second.sum()), 1)).astype(np.float32)
    return sweep.select(rows).replace(points=points)


def visible(sweep: Sweep) -> Mask:
    return np.asarray(ShadowMap(GRID).estimate(sweep).visible())


def rows_of(points: F32, ring: list[int] | None = None) -> list[int] | None:
    rows = _core.farthest_returns(np.asarray(points, np.float32), None if ring is None else np.array(ring, np.int16))
    return None if rows is None else list(map(int, rows))


@pytest.mark.parametrize("given", [{}, {"ring": None}, {"ring": None, "model": None}])
def test_nearer_returns_and_repeated_ones_change_nothing(given: dict[str, None]) -> None:
    sweep = STREET.replace(**given)
    once = visible(sweep)
    for several in (with_nearer_returns(sweep), sweep.select(np.repeat(np.arange(len(sweep)), 2))):
        leveled = level(several, GRID)
        assert np.array_equal(leveled.sweep.points, sweep.points)
        assert leveled.delivered is several
        assert np.array_equal(visible(several), once)


def test_a_sweep_with_one_return_a_beam_is_taken_as_it_is() -> None:
    leveled = level(STREET, GRID)
    assert leveled.sweep is STREET
    assert leveled.every_return is None


def test_the_guarantee_counts_the_nearest() -> None:
    grid, several = GRIDS["road"], with_nearer_returns(STREET)
    given = Given.of(level(STREET, grid))
    one, of_several = (Envelope.of(level(sweep, grid), given, grid, CAR) for sweep in (STREET, several))
    assert np.array_equal(of_several.nearest_m, given.nearest_returns(several))
    assert of_several.claim.sum() < one.claim.sum()


def test_directions_and_rings_tell_what_is_of_one_beam() -> None:
    ahead, behind, null = (5.0, 0.0, -1.0), (-5.0, -1e-6, -1.0), (0.0, 0.0, 0.0)
    twice = np.array([ahead, (10.0, 0.0, -2.0), (5.0, 0.02, -1.0), null, null], np.float32)
    assert rows_of(twice) == [1, 2, 3, 4]
    assert rows_of(twice, [3, 3, 3, 0, 0]) == [1, 2, 3, 4]
    assert rows_of(twice, [3, 4, 3, 0, 0]) is None
    # Of those that are as far the first counts; the turn has no seam.
    assert rows_of(np.array([ahead, ahead, ahead], np.float32)) == [0]
    assert rows_of(np.array([behind, (-10.0, 1e-6, -2.0)], np.float32)) == [1]
    # Beams of a ring begin beside the sensor's middle, so that their elevation differs with the range.
    assert rows_of(np.array([(3.0, 0.0, 0.31), (30.0, 0.0, 3.0)], np.float32), [7, 7]) == [1]
    assert rows_of(np.array([(3.0, 0.0, 0.31), (30.0, 0.0, 3.0)], np.float32)) is None
    assert rows_of(np.zeros((0, 3), np.float32)) is None


@pytest.mark.parametrize("beams", [8, 60_000])
def test_many_returns_in_one_direction_cost_no_more_than_others(beams: int) -> None:
    """All on eight rays, or all above each other: compared in pairs they would take a minute."""
    of_beam, returns = np.arange(60_000) % beams, np.linspace(2.0, 100.0, 60_000)
    azimuth = (of_beam % 8 * 128 + 32.5) / 1024 * 2 * np.pi - np.pi if beams == 8 else np.full(60_000, -2.94)
    elevation, range_m = (np.zeros(60_000), returns) if beams == 8 else (of_beam / 2e4 - 1.5, np.full(60_000, 50.0))
    flat_m = range_m * np.cos(elevation)
    points = np.stack([flat_m * np.cos(azimuth), flat_m * np.sin(azimuth), range_m * np.sin(elevation)], axis=1)
    begin = time.process_time()
    assert rows_of(np.asarray(points, np.float32)) == (list(range(59_992, 60_000)) if beams == 8 else None)
    assert time.process_time() - begin < 2.0
