"""Earlier sweeps: obstacles that stood there end the beams now, what moved does not, and only poses tell where."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from viewshed import BevGrid, Sweep, _core
from viewshed.arrays import Mask
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.temporal import SweepBuffer, TemporalEstimator, where_confirmed
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import CAR, PEDESTRIAN, Beams
from viewshed.geometry import Rigid
from viewshed.preprocess.basis import basis_of
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.history import History, history_of
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Scene, cast

MODEL = LidarModel("sparse", np.deg2rad(np.linspace(-24, 8, 33)), azimuth_columns=720, max_range_m=100.0)
GRID = BevGrid(128, 32.0)
HEIGHT_M = 1.8
WALL, FAR = Box(12, 2, 1, 6, 3), Box(24, 2, 1, 12, 5)
NOTHING = Sweep(np.zeros((0, 3), np.float32))


def at(x: float, y: float, yaw: float = 0.0) -> Rigid:
    return Rigid.from_yaw(yaw, (x, y, HEIGHT_M))


def seen(solids: Sequence[Box], pose: Rigid, t_s: float = 0.0) -> Sweep:
    """A sweep of solids that are given in the map, by a sensor at ``pose``."""
    back = pose.inverse()
    turn = float(np.arctan2(back.rotation[1, 0], back.rotation[0, 0]))
    turned = []
    for box in solids:
        x, y, _ = back @ np.array([box.x_m, box.y_m, 0.0])
        turned.append(replace(box, x_m=float(x), y_m=float(y), yaw=box.yaw + turn))
    sweep = cast(MODEL, Scene(tuple(turned)), HEIGHT_M)
    return sweep.replace(world_from_sensor=pose, t_ns=int(1e9 * t_s), sensor_height_m=HEIGHT_M)


def level_of(sweep: Sweep) -> LeveledSweep:
    return level(sweep, GRID)


def behind_wall(from_m: float = 15.0) -> Mask:
    """Cells behind the wall; up to 15 m beams below its lowest return reach some."""
    centers = np.asarray(GRID.centers)
    return np.asarray((centers[..., 0] > from_m) & (centers[..., 0] < 22) & (np.abs(centers[..., 1] - 3) < 1.5))


def claimed(sweep: Sweep, earlier: Sequence[Sweep] = ()) -> Mask:
    return np.asarray(ShadowMap(GRID).estimate(sweep, earlier).visible())


POSES = (at(-6, -1), at(-3, 4, np.pi / 2), at(0, -5, -np.pi / 2), at(-8, 2))


def drive() -> list[Sweep]:
    """Sweeps of the wall and of what lies behind it, a second apart."""
    return [seen([WALL, FAR], pose, t_s) for t_s, pose in enumerate(POSES)]


def test_a_wall_that_stood_there_hides_what_the_beams_now_claim_to_see() -> None:
    """The wall is gone from the sweep now, as if its returns had been spoofed farther away."""
    truth, lie, earlier = seen([WALL, FAR], at(0, 0)), seen([FAR], at(0, 0)), drive()
    hidden = behind_wall()
    assert not claimed(truth)[hidden].any()
    assert claimed(lie)[hidden].all()
    assert claimed(lie, earlier)[hidden].mean() < 0.1
    elsewhere = np.asarray(GRID.centers)[..., 0] < 9
    assert (claimed(lie, earlier) == claimed(lie))[elsewhere].mean() > 0.98


@pytest.mark.parametrize("poses", [(at(20, -10, 2.5), at(18, -12, 2.3)), (at(22, 10, -2.5), at(20, 8, -2.5))])
def test_a_wall_seen_from_beyond_hides_though_they_saw_what_stands_behind_it(poses: Sequence[Rigid]) -> None:
    """From here what they saw behind the wall lies in the gaps between the wall's returns."""
    lie = seen([FAR], at(0, 0))
    hidden = behind_wall()
    assert claimed(lie)[hidden].all()
    assert claimed(lie, [seen([WALL, FAR], pose) for pose in poses])[hidden].mean() < 0.15
    assert claimed(lie, [seen([FAR], pose) for pose in poses])[hidden].mean() > 0.95


def test_what_moved_was_seen_there_once_and_hides_nothing() -> None:
    moving = [seen([Box(12, 2 + 9 * step, 1, 6, 3), FAR], pose) for step, pose in enumerate(POSES, start=-1)]
    now = seen([FAR], at(0, 0))
    assert claimed(now, moving)[behind_wall()].mean() > 0.9
    assert claimed(now, moving[1:2])[behind_wall()].mean() < 0.5  # a single earlier sweep is believed


def test_confirmations_count_the_earlier_sweeps_that_see_a_cell_past_what_they_saw_on_the_way() -> None:
    now = seen([FAR], at(0, 0))
    poses = (at(0, 0), at(20, -10, 2.5), at(22, 10, -2.5))
    earlier = [seen([WALL, FAR], pose) for pose in poses]
    past = history_of(level_of(now), earlier, GRID)
    confirmations = past.confirmations(GRID, CAR)
    # Two stood beyond the wall and saw the cells there; but they also saw the wall between those cells and here.
    # Seen obliquely, its returns leave a few gaps.
    assert (confirmations[behind_wall()] == 0).mean() > 0.8
    assert np.array_equal(confirmations, past.confirmations(GRID, CAR))
    # Where no wall stood, what they see is confirmed, from wherever they were.
    open_past = history_of(level_of(now), [seen([FAR], pose) for pose in poses], GRID)
    assert (open_past.confirmations(GRID, CAR)[behind_wall()] >= 2).mean() > 0.9
    alone = History.of(level_of(now), [level_of(earlier[0])])
    assert (alone.confirmations(GRID, CAR) == claimed(earlier[0])).mean() > 0.98
    assert (alone.confirmations(GRID, PEDESTRIAN) != alone.confirmations(GRID, CAR)).any()


def test_nothing_is_confirmed_past_an_obstacle_that_the_last_sweep_alone_saw() -> None:
    """It moved there, and may still stand there; where it was before only earlier sweeps saw it."""
    now, poses = level_of(seen([FAR], at(0, 0))), (at(20, -10, 2.5), at(22, 10, -2.5))
    before, with_it = [seen([FAR], pose) for pose in poses], seen([WALL, FAR], at(0, 0))
    last, first = history_of(now, [*before, with_it], GRID), history_of(now, [with_it, *before], GRID)
    assert (last.confirmations(GRID, CAR)[behind_wall()] == 0).mean() > 0.8
    assert (first.confirmations(GRID, CAR)[behind_wall()] > 0).mean() > 0.9


def returns_at(*xyz: tuple[float, float, float], t_s: float = 0.0, agent: str = "ego") -> LeveledSweep:
    """A leveled sweep with these returns (x, y, height above the ground) alone, on level ground."""
    points = np.array(xyz, np.float32).reshape(-1, 3)
    x, y, z = points.T
    sweep = Sweep(points, world_from_sensor=at(0, 0), t_ns=int(1e9 * t_s), agent=agent)
    ground, level_from_sensor = HeightMap.flat(32.0), Rigid(np.eye(3), np.array([0.0, 0.0, HEIGHT_M]))
    rows = np.arange(len(points), dtype=np.int32)
    height_m = np.ascontiguousarray(z)
    return LeveledSweep(sweep, points, np.hypot(x, y), np.arctan2(y, x), height_m, rows, level_from_sensor, ground)


def remembered(earlier: Sequence[LeveledSweep], x: float, y: float, z: float) -> float:
    """The remembered range in the direction of a point."""
    past = History.of(returns_at(), earlier)
    direction = np.array([np.arctan2(y, x)], np.float32), np.array([(z - HEIGHT_M) / np.hypot(x, y)], np.float32)
    return float(past.within(Beams(*direction, np.full(1, np.inf, np.float32))).depth_m[0])


@pytest.mark.parametrize(("range_m", "known"), [(0.8, False), (1.2, True), (3.0, True), (4.9, True)])
def test_obstacles_are_remembered_from_one_meter_on(range_m: float, known: bool) -> None:
    """Nearer ones are the vehicle itself, and a direction to them says nothing."""
    around = np.radians([-0.5, 0.0, 0.5])
    points = [
        (range_m * float(np.cos(0.6 + turn)), range_m * float(np.sin(0.6 + turn)), HEIGHT_M + range_m * float(up))
        for turn in around for up in around
    ]  # fmt: skip
    assert (remembered([returns_at(*points)] * 2, *points[4]) < np.inf) == known


def test_without_earlier_sweeps_there_is_no_past_and_without_poses_no_way_to_see_them_together() -> None:
    sweep = seen([WALL], at(0, 0))
    assert history_of(level_of(sweep), [], GRID) is None
    assert history_of(level_of(sweep), [NOTHING], GRID) is None
    for now, before in ((sweep, sweep.replace(world_from_sensor=None)), (sweep.replace(world_from_sensor=None), sweep)):
        with pytest.raises(ValueError, match=r"must have poses.*world_from_sensor"):
            ShadowMap(GRID).estimate(now, [before])


@given(st.lists(st.floats(-4, 5), min_size=1, max_size=12), st.integers(1, 5), st.floats(0.1, 3))
def test_a_memory_keeps_the_last_sweeps_that_lie_apart_and_begins_anew_where_time_goes_back(
    steps_s: list[float], sweeps: int, every_s: float
) -> None:
    buffer, times = SweepBuffer(sweeps, every_s), np.cumsum(steps_s)
    kept: list[int] = []
    empty = level_of(NOTHING.replace(world_from_sensor=at(0, 0)))
    for t_s in times:
        buffer.add(replace(empty, sweep=empty.sweep.replace(t_ns=int(1e9 * t_s))))
        if kept and int(1e9 * t_s) < kept[-1]:
            kept.clear()
        if not kept or int(1e9 * t_s) - kept[-1] >= every_s * 1e9:
            kept.append(int(1e9 * t_s))
    assert [leveled.sweep.t_ns for leveled in buffer._kept["ego"]] == kept[-sweeps:]


def test_agents_that_are_gone_are_dropped() -> None:
    buffer = SweepBuffer(forget_s=10.0)
    for number in range(300):
        buffer.add(returns_at(t_s=float(number), agent=f"agent {number}"))
        assert buffer.history(returns_at(t_s=number + 0.5, agent=f"agent {number}")) is not None
    assert len(buffer._kept) <= 11
    for number in range(5):
        buffer.history(returns_at(t_s=400.0, agent=f"stranger {number}"))
        buffer.add(level_of(NOTHING.replace(agent=f"stranger without a pose {number}", t_ns=0)))
    assert len(buffer._kept) <= 11


def test_of_too_many_agents_at_once_the_ones_seen_last_are_kept() -> None:
    buffer = SweepBuffer(agents=3)
    for number in [0, 1, 2, 0, 3, 4]:
        buffer.add(returns_at(t_s=0.1 * number, agent=f"agent {number}"))
    assert set(buffer._kept) == {"agent 0", "agent 3", "agent 4"}
    with pytest.raises(ValueError, match="agents must be at least 1, got 0"):
        SweepBuffer(agents=0)


def test_a_stream_is_estimated_with_its_own_past_and_a_new_one_begins_anew() -> None:
    stream, lie = drive(), seen([FAR], at(0, 0), 10.0)
    estimator = TemporalEstimator(ShadowMap(GRID), SweepBuffer(every_s=1.0))
    found: list[FovEstimate] = [estimator.estimate(sweep) for sweep in stream]
    assert all(each.visible().any() for each in found)
    assert np.array_equal(estimator.estimate(lie).visible(), claimed(lie, stream))
    other = TemporalEstimator(ShadowMap(GRID))
    for sweep in stream:
        other.estimate(sweep.replace(agent="b"))
    assert np.array_equal(other.estimate(lie).visible(), claimed(lie))
    assert np.array_equal(estimator.estimate(lie.replace(t_ns=-1)).visible(), claimed(lie))
    assert estimator.grid == GRID


def test_the_wary_claim_what_an_earlier_sweep_sees_as_well_and_nothing_at_first() -> None:
    stream, lie = drive(), seen([FAR], at(0, 0), 10.0)
    estimator = TemporalEstimator(ShadowMap(GRID), require_confirmation=True)
    trusting = TemporalEstimator(ShadowMap(GRID))
    first = estimator.estimate(stream[0])
    assert not first.visible().any()
    assert (first.basis.unsure_ground_share, first.basis.inferred_share) == (0.0, 0.0)
    assert first.share(CellState.HIDDEN) == ShadowMap(GRID).estimate(stream[0]).share(CellState.HIDDEN)
    for sweep in stream:
        found, other = estimator.estimate(sweep), trusting.estimate(sweep)
    found, other = estimator.estimate(lie), trusting.estimate(lie)
    past = history_of(level_of(lie), stream, GRID)
    assert np.array_equal(found.visible(), other.visible() & (past.confirmations(GRID, CAR) > 0))
    refused = other.visible() & ~found.visible()
    assert (found.state[refused] == CellState.UNKNOWN).all()
    assert refused[behind_wall(14.0)].any()
    assert np.array_equal(where_confirmed(other, past).visible(), found.visible())
    evidence = beam_evidence(past.now, GRID, CAR, past)
    assert found.basis == basis_of(past.now, evidence, found.state)


def test_a_sweep_is_not_its_own_past() -> None:
    estimator = TemporalEstimator(ShadowMap(GRID))
    estimator.estimate(seen([WALL, FAR], at(0, 0)))
    lie = seen([FAR], at(0, 0))
    assert np.array_equal(estimator.estimate(lie).visible(), claimed(lie))


def test_what_lies_long_before_is_forgotten() -> None:
    stream = drive()
    for late_s, known in ((12.0, True), (14.0, False)):
        estimator = TemporalEstimator(ShadowMap(GRID))
        for sweep in stream:
            estimator.estimate(sweep)
        lie = seen([FAR], at(0, 0), late_s)
        assert np.array_equal(estimator.estimate(lie).visible(), claimed(lie)) != known


def test_sweeps_without_pose_or_time_are_estimated_by_themselves() -> None:
    estimator = TemporalEstimator(ShadowMap(GRID))
    sweep = seen([WALL], at(0, 0))
    for bare in (sweep.replace(world_from_sensor=None), sweep.replace(t_ns=None)):
        assert np.array_equal(estimator.estimate(bare).visible(), claimed(bare))
    assert not any(estimator.buffer._kept.values())


def image_of(*pixels: tuple[int, int, float]) -> NDArray[np.float32]:
    """The image that one sweep leaves of obstacles at a row, a column and a range: 320 rows from -0.75 to 0.35."""
    row, column, range_m = np.array(pixels).T
    azimuth, slope = (column + 0.5) * (2 * np.pi / 1440) - np.pi, (row + 0.5) * (1.1 / 320) - 0.75
    points = np.column_stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), HEIGHT_M + slope * range_m])
    cloud = points.astype(np.float32), np.ones(len(points), np.float32), np.eye(3, 4, dtype=np.float32)
    return _core.obstacle_image([cloud], 0.3, HEIGHT_M)


def test_the_left_right_and_upper_edges_of_an_obstacle_hide_nothing() -> None:
    """A beam that shares a pixel with an edge may pass beside it."""
    block = [(row, column, 10.0) for row in range(40, 44) for column in range(7, 12)]
    before, post = [(row, column, 5.0) for row in range(38, 42) for column in range(9, 12)], [(42, 30, 9.0)]
    image = image_of(*block, *before, *post)
    inside = np.zeros(image.shape, np.bool_)
    inside[40:42, 8] = inside[42, 8:11] = True
    inside[38:41, 10] = True  # what is nearer has edges of its own, and makes none behind it
    assert np.array_equal(np.isfinite(image), inside)
    assert image[38:41, 10] == pytest.approx(5.0)
    assert image[40:43, 8] == pytest.approx(10.0)


def test_the_columns_gaps_of_an_obstacle_are_closed_and_others_are_not() -> None:
    columns = (40, 7, 10.0), (40, 15, 11.0), (40, 24, 11.0), (90, 7, 10.0), (90, 15, 30.0)
    image = image_of(*columns, *((row + 1, column, range_m) for row, column, range_m in columns))
    assert image[40, 8:15] == pytest.approx(11.0)
    assert np.isfinite(image).sum() == 7


def test_a_narrow_gap_is_closed_where_something_farther_was_seen_in_it() -> None:
    """A meter is 291 rows wide at a range of one meter: 26 rows at 11 m, 14 rows at 20 m."""
    rows = (
        (40, 7, 10.0), (44, 7, 30.0), (50, 7, 11.0),  # the farther pixel was seen from elsewhere
        (40, 107, 20.0), (44, 107, 60.0), (55, 107, 20.0),  # the gap is more than a meter wide
        (40, 207, 10.0), (44, 207, 5.0), (50, 207, 11.0),  # something nearer has an end of its own
    )  # fmt: skip
    image = image_of(*((row, column + k, range_m) for row, column, range_m in rows for k in range(3)))
    assert image[40:50, 8] == pytest.approx([10.0] + [11.0] * 9)
    assert np.isfinite(image).sum() == 10
