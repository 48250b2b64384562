"""Evidence of the sensor's state, by scenes whose changes are known by hand."""

import numpy as np
import pytest
from tests.monitor.evidence.drives import YARD, look, measure

from viewshed import _core
from viewshed.monitor.evidence import EVIDENCE, SECTORS
from viewshed.sweep import Sweep
from viewshed_lab.sim import Box


def _drive(rng: np.random.Generator | None = None) -> list[Sweep]:
    """Six sweeps, 1 m apart, without poses."""
    return [look(YARD, number, 1.0 * number, rng).replace(world_from_sensor=None) for number in range(6)]


@pytest.mark.parametrize("axis", [0, 1])
def test_points_that_are_all_shifted_make_the_sensor_jump(axis: int) -> None:
    sweeps = _drive()
    assert measure("jump", *sweeps).max() < 0.3
    shift = np.zeros(3, np.float32)
    shift[axis] = 1.0
    shifted = sweeps[-1].replace(points=sweeps[-1].points + shift)
    assert measure("jump", *sweeps[:-1], shifted)[0] == pytest.approx(1.0, abs=0.3)


def test_where_obstacles_do_not_show_the_shift_nothing_is_said_of_a_jump() -> None:
    for world in ((), (Box(30.0, 20.0, 0.5, 0.5, 2.0),)):
        sweeps = [look(world, number, 1.0 * number).replace(world_from_sensor=None) for number in range(6)]
        assert np.isnan(measure("jump", *sweeps)).all()


def test_noise_is_measured_by_its_size() -> None:
    noises = [measure("range_noise", _noisy(look(YARD), sigma_m))[0] for sigma_m in (0.0, 0.02, 0.04)]
    # The lower quartile of |e1 - 2 e2 + e3|, a normal variable of √6 σ: .3186 √6 σ.
    assert noises[0] < 0.005
    assert noises[1] == pytest.approx(0.3186 * 6**0.5 * 0.02, rel=0.1)
    assert noises[2] == pytest.approx(0.3186 * 6**0.5 * 0.04, rel=0.1)


def _noisy(sweep: Sweep, sigma_m: float) -> Sweep:
    range_m = np.linalg.norm(sweep.points, axis=1, keepdims=True)
    noise = np.random.default_rng(0).normal(0.0, sigma_m, range_m.shape)
    return sweep.replace(points=(sweep.points * (1.0 + noise / range_m)).astype(np.float32))


def test_heights_and_shares_of_the_whole_sweep() -> None:
    sweep = look(YARD)
    assert measure("sensor_height", sweep)[0] == pytest.approx(1.8, abs=0.02)
    near = np.concatenate([sweep.points, np.full((len(sweep), 3), 0.5, np.float32)])
    assert measure("near_returns", Sweep(near))[0] == pytest.approx(0.5 + 0.5 * measure("near_returns", sweep)[0])


def test_a_reason_says_unlike_before_where_less_is_as_suspicious_as_more() -> None:
    nothing = {name: kind.reason(np.zeros(SECTORS, np.float32)) for name, kind in EVIDENCE.items()}
    assert {name for name, reason in nothing.items() if reason.endswith("unlike before")} == {
        name for name, kind in EVIDENCE.items() if kind.two_sided
    }
    assert nothing["isolated"] == "0.0% of the returns are isolated, unlike before"


@pytest.mark.parametrize("seed", range(4))
def test_the_best_shift_is_that_of_the_circular_correlation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before = rng.random((40, 40)) < 0.1
    now = np.roll(before, (3 - seed, -2), (0, 1)) ^ (rng.random((40, 40)) < 0.05)
    overlap = np.fft.irfft2(np.fft.rfft2(now) * np.conj(np.fft.rfft2(before)), (40, 40))
    about = np.round(np.roll(overlap, (6, 6), (0, 1))[:13, :13])
    row, column, cells, elsewhere = _core.best_shift(now, before, 6)
    down, across = divmod(int(about.argmax()), 13)
    assert (row, column) == (down - 6, across - 6) == (3 - seed, -2)
    assert cells == about.max()
    about[max(down - 2, 0) : down + 3, max(across - 2, 0) : across + 3] = 0
    assert elsewhere == about.max()


@pytest.mark.parametrize("count", [7, 8, 500])
def test_the_noise_of_range_is_a_quartile_of_second_differences(count: int) -> None:
    rng = np.random.default_rng(count)
    range_m = np.where(np.arange(count) % 50 < 25, 10.0, 20.0) + rng.normal(0.0, 0.02, count)
    azimuth = np.linspace(0.0, 1.0, count)
    points = (range_m[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth])).astype(np.float32)
    steps = np.diff(np.linalg.norm(points, axis=1))
    smooth = np.abs(steps) < 0.03 * range_m[1:] + 0.05
    bends = np.abs(np.diff(steps))[smooth[1:] & smooth[:-1]]
    assert _core.range_noise(points, 0.03, 0.05, 1) == pytest.approx(np.quantile(bends, 0.25), abs=1e-5)
    assert np.isnan(_core.range_noise(points, 0.03, 0.05, len(bends) + 1))
