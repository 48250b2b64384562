import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import poisson

from viewshed import _core
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import (
    CAR,
    PEDESTRIAN,
    Beams,
    Target,
    cell_windows,
    expected_returns,
    probability_of_visible,
)
from viewshed.grid import BevGrid

GRID = BevGrid(32, 16.0, (2.0, -1.0))


def _random_beams(rng: np.random.Generator, count: int) -> Beams:
    depth = rng.uniform(2, 25, count).astype(np.float32)
    depth[rng.random(count) < 0.1] = np.inf
    azimuth = rng.uniform(-np.pi, np.pi, count).astype(np.float32)
    return Beams(azimuth, rng.uniform(-0.5, 0.1, count).astype(np.float32), depth)


def _by_hand(beams: Beams, height_m: float, cell: tuple[int, int], target: Target) -> tuple[int, int]:
    """The definition, beam by beam, on flat ground: beams that reach the cell, and that aim at it."""
    x, y = GRID.centers[cell]
    r = (np.floor(np.hypot(x, y) / GRID.cell_m) + 0.5) * GRID.cell_m
    away = np.angle(np.exp(1j * (beams.azimuth.astype(float) - np.arctan2(y, x))))
    z = height_m + beams.slope.astype(float) * r
    aims = (np.abs(away) <= np.arctan2(target.width_m / 2, r)) & (z >= -0.3) & (z <= target.height_m)
    return int((aims & (beams.depth_m >= r - GRID.cell_m)).sum()), int(aims.sum())


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sampled_from([CAR, PEDESTRIAN]), st.sampled_from([0.6, 1.8, 5.0]))
def test_expected_returns_agree_with_the_definition_beam_by_beam(seed: int, target: Target, height_m: float) -> None:
    rng = np.random.default_rng(seed)
    beams = _random_beams(rng, 20_000)
    returns, aimed = expected_returns(beams, height_m, HeightMap.flat(20.0), GRID, target)
    for cell in [(int(i), int(j)) for i, j in rng.integers(0, 32, (10, 2))]:
        reach, aim = _by_hand(beams, height_m, cell, target)
        assert abs(returns[cell] - reach) <= 1 + np.sqrt(reach)
        # `aimed` is averaged over neighboring sectors, so random beams differ from the window's own by chance
        assert abs(aimed[cell] - aim) <= 4 + 4 * np.sqrt(aim)


def test_windows_wrap_behind_the_sensor() -> None:
    azimuth = np.array([np.pi - 0.01, -np.pi + 0.01, np.pi - 0.02], np.float32)
    beams = Beams(azimuth, np.full(3, -0.15, np.float32), np.full(3, 12.0, np.float32))
    grid = BevGrid(32, 16.0)
    returns, aimed = expected_returns(beams, 1.8, HeightMap.flat(16.0), grid, CAR)
    behind = tuple(grid.index(np.array([-10.5, 0.2]))[0])
    assert returns[behind] == pytest.approx(3.0, abs=0.05)
    assert aimed[behind] > 1.0
    assert returns.sum() == returns[:16].sum()


@pytest.mark.parametrize("needed", [1, 3, 5, 40, 200])
def test_probability_is_poisson_and_crosses_a_half_at_the_definition(needed: int) -> None:
    counts = np.arange(0, 3 * needed, dtype=np.float32)
    found = probability_of_visible(counts, needed)
    if needed <= 100:
        assert np.allclose(found, poisson.sf(needed - 1, counts), atol=1e-4)
    assert ((found >= 0.5) == (counts >= needed)).all()
    assert (np.diff(found) >= 0).all()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (("x", 1.0, 0.0, 1.0, 5), "width_m must lie in"),
        (("x", 1.0, 1.0, float("nan"), 5), "height_m must lie in"),
        (("x", 1.0, 1.0, 1.0, 0), "min_returns must lie in"),
        (("x", 1.0, 1.0, 1.0, 2.5), "min_returns must be a whole number"),
    ],
)
def test_bad_targets_are_refused(values: tuple[str, float, float, float, int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Target(*values)


def test_beams_need_one_shape() -> None:
    short: NDArray[np.float32] = np.zeros(2, np.float32)
    with pytest.raises(ValueError, match="one shape"):
        Beams(np.zeros(3, np.float32), short, short)


def test_a_beam_reaches_cells_up_to_one_cell_beyond_its_end() -> None:
    """Level beams that end at 5.3 m: the target at 5.75 m (less one cell, 5.25 m) is met, that at 6.25 m is not."""
    azimuth = np.linspace(-0.3, 0.3, 400).astype(np.float32)
    beams = Beams(azimuth, np.zeros(400, np.float32), np.full(400, 5.3, np.float32))
    grid = BevGrid(64, 16.0)
    returns, aimed = expected_returns(beams, 1.0, HeightMap.flat(16.0), grid, CAR)
    reached, beyond = (tuple(grid.index(np.array([x_m, 0.25]))[0]) for x_m in (5.75, 6.25))
    assert returns[reached] > 50
    assert returns[beyond] == 0
    assert min(aimed[reached], aimed[beyond]) > 50


# The core refuses what it cannot count, and answers whatever the numbers are.

TABLE = _core.poisson_table(5)
FLAT = np.zeros((8, 8), np.float32)


def _evidence(
    measured: Any, lost: Any, heights_m: Any = FLAT, std_m: Any = FLAT, table: Any = TABLE, half_m: float = 20.0
) -> Any:
    return _core.beam_evidence(
        cell_windows(GRID, 1.8), measured, lost, measured, heights_m, std_m, half_extent_m=half_m, sensor_height_m=1.8,
        target_height_m=1.5, low_m=0.3, high_m=3.0, table=table, reach_m=60.0,
    )  # fmt: skip


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_evidence_is_that_of_each_kind_height_and_end_counted_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    measured, likely, *_ = beams = [_random_beams(rng, count) for count in (3000, 500, 500, 500)]
    # The beams without a return have three depths, in any order.
    early, late = (Beams(likely.azimuth, likely.slope, other.depth_m) for other in beams[2:])
    heights_m, std_m = rng.uniform(-0.3, 0.3, (8, 8)).astype(np.float32), rng.uniform(0, 0.4, (8, 8)).astype(np.float32)
    ground = HeightMap(heights_m, 20.0, np.ones((8, 8), np.bool_), std_m=std_m)
    found = _evidence(measured.arrays, (*likely.arrays, early.depth_m, late.depth_m), heights_m, std_m)
    for one, kind in zip(found[:3], (measured, likely, late), strict=True):
        assert np.abs(one - expected_returns(kind, 1.8, ground, GRID, CAR)[0]).max() < 1e-3
    both = measured + likely
    counted = [expected_returns(both, 1.8, ground.shifted(deviations), GRID, CAR) for deviations in (0.0, -1.22, 1.22)]
    assert np.abs(found[3] - counted[0][1]).max() < 1e-3
    enough, lower, higher = (probability_of_visible(returns, 5) for returns, _ in counted)
    prob = 0.4 * enough + 0.3 * lower + 0.3 * higher
    for weight, ends in zip((0.3, 0.3), (early, late), strict=True):
        returns = expected_returns(measured + ends, 1.8, ground, GRID, CAR)[0]
        prob += weight * (probability_of_visible(returns, 5) - enough)
    # A beam may pass just at the edge of a target, and probabilities are told apart by steps of 1/32 of a return.
    assert (np.abs(found[4] - np.clip(prob, 0.0, 1.0)) > 0.01).mean() < 0.01


def test_places_that_are_no_numbers_or_far_away_have_height_zero() -> None:
    assert HeightMap(FLAT, 8.0, FLAT > 0).at(np.array([[np.nan, 1e30], [-np.inf, 3.0]])).tolist() == [0.0, 0.0]


def test_no_windows_are_left_at_exit_whoever_keeps_the_function() -> None:
    """nanobind would report each as leaked."""
    code = """
import ctypes
from viewshed.fov.visibility import cell_windows
from viewshed.grid import BevGrid
cell_windows(BevGrid(16, 8.0), 1.8)
ctypes.pythonapi.Py_IncRef(ctypes.py_object(cell_windows))
"""
    ended = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=True, timeout=60)
    assert (ended.stdout, ended.stderr) == ("", "")
