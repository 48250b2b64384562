"""What is kept of earlier sweeps when the clock of a stream jumps."""

import numpy as np

from viewshed import BevGrid, Rigid, Sweep, load_estimator, read_sweep
from viewshed.estimators.temporal import SweepBuffer, TemporalEstimator
from viewshed.io.samples import junction_path
from viewshed.preprocess.leveling import level

S = 1_000_000_000


def kept_times(times_s: list[float]) -> list[float]:
    """Times of the sweeps that a buffer keeps after a stream with these times, by the poses that it gave them."""
    points = np.array([[5.0, 1.0, -1.5], [8.0, -2.0, -1.5], [-4.0, 3.0, -1.5]], np.float32)
    buffer = SweepBuffer(sweeps=5, every_s=1.0, forget_s=100.0)
    for time_s in times_s:
        pose = Rigid.from_yaw(0.0, (time_s, 0.0, 1.5))
        sweep = Sweep(points, t_ns=round(time_s * S), world_from_sensor=pose, sensor_height_m=1.5)
        buffer.add(level(sweep, BevGrid(16, 16.0)))
    return [round(kept.world_from_level.translation[0], 3) for kept in buffer._kept["ego"] if kept.world_from_level]


def test_time_that_goes_back_begins_a_new_stream() -> None:
    assert kept_times([10.0, 11.0, 12.0]) == [10.0, 11.0, 12.0]
    assert kept_times([10.0, 11.0, 12.0, 3.0]) == [3.0]
    assert kept_times([10.0, 11.0, 12.0, 3.0, 4.0]) == [3.0, 4.0]


def test_sweeps_too_near_in_time_are_not_kept() -> None:
    assert kept_times([10.0, 10.4, 11.0, 11.9, 12.5]) == [10.0, 11.0, 12.5]


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
