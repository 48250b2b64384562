"""Ranges that come again, and ranges that only look alike."""

import numpy as np
import pytest
from tests.monitor.evidence.drives import YARD, look, measure

from viewshed.sweep import Sweep


def _rounded(sweep: Sweep, step_m: float) -> Sweep:
    range_m = np.linalg.norm(sweep.points.astype(np.float64), axis=1, keepdims=True)
    return sweep.replace(points=(sweep.points / range_m * np.round(range_m / step_m) * step_m).astype(np.float32))


@pytest.mark.parametrize("before", [1, 3, 5])
def test_a_replayed_sweep_repeats_all_its_ranges(before: int) -> None:
    rng = np.random.default_rng(0)
    sweeps = [look(YARD, number, 1.0 * number, rng) for number in range(6)]
    replayed = sweeps[5 - before].replace(world_from_sensor=sweeps[5].world_from_sensor, t_ns=sweeps[5].t_ns)
    assert np.nanmin(measure("same_noise", *sweeps[:5], replayed)) > 0.95
    assert np.nanmax(measure("same_noise", *sweeps)) < 0.15


@pytest.mark.parametrize("step_m", [0.001, 0.002, 0.004, 0.005])
def test_whole_steps_of_range_repeat_no_noise(step_m: float) -> None:
    rng = np.random.default_rng(1)
    standing = [_rounded(look(YARD, number, rng=rng), step_m).replace(world_from_sensor=None) for number in range(4)]
    values = measure("same_noise", *standing)
    assert np.nanmedian(values) < 0.05
    frozen = measure("same_noise", *standing[:3], standing[1])
    assert np.nanmin(frozen) > 0.95
