"""Degraded and impossible: against the own past and the beam table."""

import numpy as np
import pytest
from tests.monitor.evidence.drives import GRID, YARD, look

from viewshed.monitor.degraded import NOW_SWEEPS, PAST_SWEEPS, SensorState, against_table
from viewshed.monitor.evidence import EVIDENCE, MonitoredSweep, measure_all
from viewshed.monitor.impossible import impossible_reasons
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep

USUAL = 90
"""Sweeps by which a number shows how far it goes by itself."""


def _leveled(sweep: Sweep) -> LeveledSweep:
    return level(sweep, GRID)


def test_fewer_returns_than_before_count_once_they_last() -> None:
    whole = _leveled(look(YARD))
    half = _leveled(whole.sweep.select(np.arange(0, len(whole.sweep), 2)))
    state, sweeps = SensorState(), [whole] * PAST_SWEEPS + [half] * NOW_SWEEPS
    found = [state.check(sweep, measure_all(MonitoredSweep(sweep))) for sweep in sweeps]
    assert not any(found[: PAST_SWEEPS + NOW_SWEEPS // 2])
    assert any("returns fell to 50%" in reason for reason in found[-1])


def test_noise_of_another_sensor_is_not_held_against_the_table() -> None:
    rng = np.random.default_rng(0)
    noisy = look(YARD)
    noisy = noisy.replace(points=noisy.points + rng.normal(0.0, 0.05, noisy.points.shape).astype(np.float32))
    state = SensorState()
    for _ in range(PAST_SWEEPS + NOW_SWEEPS):
        sweep = _leveled(noisy)
        assert state.check(sweep, np.full((len(EVIDENCE), 72), 1.0, np.float32)) == ()


@pytest.mark.parametrize(
    ("kind", "usual", "spread", "now", "worse"),
    [
        ("isolated", 0.02, 0.002, 0.05, True),  # drizzle: far beyond what the share does by itself
        ("isolated", 0.10, 0.03, 0.14, False),  # leaves all along
        ("isolated", 0.001, 0.0001, 0.0035, False),  # so few that they hide nothing
        ("returns", 20000.0, 300.0, 15500.0, True),
        ("returns", 20000.0, 3500.0, 15500.0, False),  # an open road and a street in turn
        ("range_noise", 0.01, 0.001, 0.04, True),
        ("range_noise", 0.01, 0.001, 0.02, False),  # noisier, and still a good sensor
    ],
)
def test_a_number_is_held_against_how_far_it_goes_by_itself(
    kind: str, usual: float, spread: float, now: float, worse: bool
) -> None:
    rng, sweep, state = np.random.default_rng(0), _leveled(look(YARD)), SensorState()
    found: tuple[str, ...] = ()
    for number in range(USUAL + NOW_SWEEPS):
        evidence = np.full((len(EVIDENCE), 72), 0.01, np.float32)
        evidence[list(EVIDENCE).index("returns")] = 20000.0
        evidence[list(EVIDENCE).index(kind)] = now if number >= USUAL else usual + spread * rng.standard_normal()
        found = state.check(sweep, evidence)
        assert number >= USUAL or not found
    assert (len(found) == 1) == worse


def test_a_dead_beam_between_others_and_an_empty_direction() -> None:
    sweep = look(YARD)
    assert against_table(_leveled(sweep)) == []
    ring, azimuth = sweep.ring, np.arctan2(sweep.points[:, 1], sweep.points[:, 0])
    assert ring is not None
    dead = against_table(_leveled(sweep.select(np.flatnonzero(ring != 9))))
    assert len(dead) == 1
    assert dead[0].startswith("1 of ")
    # 34.4° to 80.2°, and as much ahead, where a driver that writes beams without a return writes zeros.
    for middle in (1.0, 0.04):
        missing = np.abs(azimuth - middle) < 0.4
        gone = sweep.replace(points=np.where(missing[:, None], np.float32(0.0), sweep.points))
        for seen in (sweep.select(np.flatnonzero(~missing)), gone):
            assert against_table(_leveled(seen)) == ["no beam returns from 45° of azimuth"]


def test_returns_that_no_beam_makes_are_impossible() -> None:
    sweep = look(YARD)
    # Under an open sky few beams return; a driver may write zeros for the others.
    padded = np.concatenate([sweep.points, np.zeros((20 * len(sweep), 3), np.float32)])
    covered = np.where(padded == 0.0, np.float32(0.2), padded)
    assert impossible_reasons(_leveled(sweep)) == impossible_reasons(_leveled(Sweep(padded, model=sweep.model))) == ()
    assert "blinded or covered" in impossible_reasons(_leveled(Sweep(covered, model=sweep.model)))[0]
    above = np.tile(np.array([3.0, 1.0, 9.0], np.float32), (len(sweep) // 20, 1))
    forged = Sweep(np.concatenate([sweep.points, above]), model=sweep.model)
    assert "above or below all beams" in impossible_reasons(_leveled(forged))[0]
    far = np.tile(np.array([300.0, 9.0, -3.0], np.float32), (3000, 1))
    beyond = Sweep(np.concatenate([sweep.points, far]), model=sweep.model)
    assert any("beyond the range" in reason for reason in impossible_reasons(_leveled(beyond)))
