"""What is kept of earlier sweeps when the clock of a stream jumps."""

import numpy as np

from viewshed import BevGrid, Rigid, Sweep, load_estimator, read_sweep
from viewshed.estimators.temporal import SweepBuffer, TemporalEstimator
from viewshed.io.samples import junction_path
from viewshed.preprocess.leveling import level


def test_after_a_reset_the_next_sweep_begins_a_new_stream() -> None:
    """With the history of the same sweep in the same place a claim is confirmed; after a reset nothing confirms it."""
    sweep = read_sweep(junction_path()).replace(world_from_sensor=Rigid.identity())
    stream = TemporalEstimator(load_estimator("shadow_map"), SweepBuffer(every_s=0.1), require_confirmation=True)
    first, second = (stream.estimate(sweep.replace(t_ns=number * 10**9)) for number in (1, 2))
    assert not first.visible().any()
    assert second.visible().any()
    stream.reset()
    assert not stream.estimate(sweep.replace(t_ns=3 * 10**9)).visible().any()


def test_one_agent_can_be_forgotten() -> None:
    buffer = SweepBuffer()
    for agent in ("car", "mast"):
        sweep = Sweep(np.array([[5.0, 0.0, -1.8]], np.float32), t_ns=0, world_from_sensor=Rigid.identity(), agent=agent)
        buffer.add(level(sweep, BevGrid(8, 8.0)))
    buffer.reset("car")
    assert list(buffer._kept) == ["mast"]


def test_time_that_goes_back_by_less_than_the_buffer_holds_begins_a_new_stream() -> None:
    """Sweeps are kept once a second: 2.9 s after 3.2 s is after the last kept one, but the clock went back."""
    sweep = read_sweep(junction_path()).replace(world_from_sensor=Rigid.identity())
    stream = TemporalEstimator(load_estimator("shadow_map"), require_confirmation=True)
    claims = [stream.estimate(sweep.replace(t_ns=round(1e9 * t_s))).area_m2() for t_s in (1.0, 2.0, 3.2, 2.9, 3.0)]
    assert [area_m2 > 0.0 for area_m2 in claims] == [False, True, True, False, True]
