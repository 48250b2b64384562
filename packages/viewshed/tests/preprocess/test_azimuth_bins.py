"""What the estimators share in azimuth bins, beside the plainest way to compute it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import _core
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
BIG = BevGrid(256, 64.0)


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


def _answers(azimuth: NDArray[np.float32], range_m: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """What each function of azimuth bins answers."""
    height_m = (range_m * np.float32(0.01)).astype(np.float32)
    cells = polar_of_cells(BIG)
    return [
        np.array([_core.azimuth_bins_filled(azimuth)], np.float32),
        *(_core.farthest_in_bins(azimuth, range_m, bins, 0) for bins in (None, 1, 36, 777)),
        _core.farthest_in_bins(azimuth, range_m, 360, 3),
        *_core.ranges_in_bins(azimuth, range_m, height_m, 0.3, 3.0),
        _core.first_blocker(azimuth, range_m, height_m, 0.3, 3.0, None, 2, 5, None, 0.5),
        _core.first_blocker(azimuth, range_m, height_m, -0.5, 0.5, 216, 1, 0, 40.0, 0.0),
        _core.cells_within(_core.farthest_in_bins(azimuth, range_m, 360, 0), cells[0], bins_of_cells(BIG, 360)),
        _core.trace_windows(azimuth, range_m, 5027, 0.01, 0.5, *cells, bins_of_cells(BIG, 5027)),
        _core.trace_windows(azimuth, range_m, 34, 1.5, 0.0, *cells, bins_of_cells(BIG, 34)),
    ]


def test_answers_do_not_depend_on_the_number_of_threads() -> None:
    rng = np.random.default_rng(8)
    azimuth = rng.uniform(-np.pi, np.pi, 70_000).astype(np.float32)
    range_m = rng.gamma(2.0, 12.0, 70_000).astype(np.float32)
    before, answers = _core.threads(), []
    try:
        for threads in (1, 2, 4):
            _core.set_threads(threads)
            answers.append(_answers(azimuth, range_m))
    finally:
        _core.set_threads(before)
    for one, two, four in zip(*answers, strict=True):
        assert np.array_equal(one, two)
        assert np.array_equal(one, four)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, 1e-40, 0.0])
@pytest.mark.parametrize("count", [0, 1, 5])
def test_azimuths_and_ranges_of_any_value_have_an_answer(value: float, count: int) -> None:
    wild, tame = np.full(count, value, np.float32), np.ones(count, np.float32)
    for azimuth, range_m in ((wild, tame), (tame, wild), (wild, wild)):
        answers = _answers(azimuth, range_m)
        assert len(answers[-1]) == BIG.cells


def test_arrays_that_do_not_fit_are_refused() -> None:
    three, two = np.zeros(3, np.float32), np.zeros(2, np.float32)
    cells, bins = polar_of_cells(GRID), bins_of_cells(GRID, 90)
    calls: list[tuple[str, Callable[[], object]]] = [
        ("azimuth and range_m", lambda: _core.farthest_in_bins(three, two, 5, 0)),
        ("bins must lie", lambda: _core.farthest_in_bins(three, three, 0, 0)),
        ("bins must lie", lambda: _core.farthest_in_bins(three, three, 40_000, 0)),
        ("drop must lie", lambda: _core.farthest_in_bins(three, three, 5, 1001)),
        ("bins must be given", lambda: _core.farthest_in_bins(three, three, None, 1)),
        ("must be as long", lambda: _core.ranges_in_bins(three, three, two, 0.0, 1.0)),
        ("must be as long", lambda: _core.first_blocker(three, two, three, 0.0, 1.0, None, 1, 0, None, 0.0)),
        ("rank must lie", lambda: _core.first_blocker(three, three, three, 0.0, 1.0, None, 0, 0, None, 0.0)),
        ("median_bins must", lambda: _core.first_blocker(three, three, three, 0.0, 1.0, None, 1, 1001, None, 0.0)),
        ("one shape", lambda: _core.cells_within(three, cells[0][:5], bins)),
        (r"cell_bin must lie in \[0, 2\]", lambda: _core.cells_within(three, cells[0], bins)),
        ("bins must lie", lambda: _core.cells_within(three[:0], cells[0], bins)),
        ("as long", lambda: _core.trace_windows(three, two, 90, 0.5, 0.0, *cells, bins)),
        ("one shape", lambda: _core.trace_windows(three, three, 90, 0.5, 0.0, *cells, bins[:4])),
        ("window must", lambda: _core.trace_windows(three, three, 90, np.nan, 0.0, *cells, bins)),
        ("margin_m must", lambda: _core.trace_windows(three, three, 90, 0.5, -1.0, *cells, bins)),
        ("slices must be finer", lambda: _core.trace_windows(three, three, 90, 0.01, 0.0, *cells, bins)),
        ("slices must be finer", lambda: _core.trace_windows(three, three, 90, 3.1, 0.0, *cells, bins)),
        (r"cell_slice must lie in \[0, 88\]", lambda: _core.trace_windows(three, three, 89, 0.5, 0.0, *cells, bins)),
        ("as long", lambda: _core.any_return_on(np.zeros((2, 3), np.float32), three, 1, 0, 1, 0, 0, 0, 1, 4)),
    ]
    for message, call in calls:
        with pytest.raises(ValueError, match=message):
            call()
    wrongs: list[Any] = [three.astype(np.float64), three[None], three.astype(np.int32), np.zeros(6, np.float32)[::2]]
    for wrong in wrongs:
        with pytest.raises(TypeError):
            _core.azimuth_bins_filled(wrong)
        with pytest.raises(TypeError):
            _core.farthest_in_bins(wrong, three, 5, 0)
