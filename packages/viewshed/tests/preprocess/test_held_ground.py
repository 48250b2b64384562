"""What a stream holds: ground that only earlier sweeps saw, the sensor's height; and how soon it lets go."""

import gc
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from weakref import ref

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from viewshed import CAR, BevGrid, Rigid, Sweep
from viewshed.arrays import F64, Mask
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.temporal import SweepBuffer, TemporalEstimator
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.truth import Truth
from viewshed.io import read_sweeps
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.held_ground import Rest, hold, hold_over
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed_lab.sim.observe import Setting, observe
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Agent, World

GRID = BevGrid(128, 64.0)
HEIGHT_M = 1.8
Ground = Callable[[F64, F64], F64]


def crest(x: F64, y: F64) -> F64:
    """A road that climbs by 8 %, rounds a crest at x = 0 and falls again."""
    return np.asarray(-0.08 * (np.hypot(x, 6.0) - 6.0) + 0.0 * y)


def bank(x: F64, y: F64) -> F64:
    """A road that falls by 6 % beside level land on its left: from x = 20 on the land stands above the road."""
    return np.asarray(-3.0 * np.clip((x + 10.0) / 50.0, 0.0, 1.0) * np.clip((7.0 - y) / 3.0, 0.0, 1.0))


def world_of(ground: Ground) -> World:
    lines = np.linspace(-120.0, 120.0, 241)
    return World("made by hand", Terrain.of(lines, lines, ground), (), ())


def observed(world: World, x_m: float, number: int = 0, height_m: float = HEIGHT_M) -> tuple[Sweep, Truth, Mask]:
    """A sweep from above a place of the road, without its height, and what could be seen from there."""
    ground_m = float(world.terrain.at([[x_m, 0.0]])[0])
    agent = Agent("ego", "hdl32e", Rigid.from_yaw(0.0, (x_m, 0.0, ground_m + height_m)))
    seen = observe(world, agent, float(number), Setting(GRID, revolution_s=0.0), np.random.SeedSequence(number))
    return seen.image.sweep().replace(sensor_height_m=None), seen.truth, seen.known


def drive(world: World, places_m: list[float]) -> tuple[list[LeveledSweep], Truth, Mask]:
    """Leveled sweeps along the road, a second apart, with truth and where it is known of the last one."""
    all_seen = [observed(world, x_m, number=number) for number, x_m in enumerate(places_m)]
    return [level(sweep, GRID) for sweep, _, _ in all_seen], *all_seen[-1][1:]


def precision_recall(leveled: LeveledSweep, truth: Truth, known: Mask) -> tuple[float, float]:
    claimed, visible = beam_evidence(leveled, GRID, CAR).supports_claim() & known, truth.visible(CAR) & known
    both = np.count_nonzero(claimed & visible)
    return both / np.count_nonzero(claimed), both / np.count_nonzero(visible)


def ground_error_m(leveled: LeveledSweep, ground: Ground, x_m: float) -> F64:
    """Error (cells, cells) of the ground's height below the sensor."""
    x, y = GRID.centers[..., 0] + x_m, GRID.centers[..., 1]
    below_m = ground(x, y) - ground(np.array([x_m]), np.zeros(1)) - HEIGHT_M
    return np.asarray(leveled.ground.at(GRID.centers) - leveled.sensor_height_m - below_m)


def lowered(sweep: Sweep, wedge_deg: float = 30.0, by_m: float = 1.5) -> Sweep:
    """A sweep with the returns of a wedge at the left lowered."""
    away = np.abs(np.arctan2(sweep.points[:, 1], sweep.points[:, 0]) - np.pi / 2)
    points = sweep.points.copy()
    points[away < np.deg2rad(wedge_deg) / 2, 2] -= by_m
    return sweep.replace(points=points)


ACROSS_THE_CREST = (crest, [-24.0, -18.0, -12.0, -6.0, 0.0, 6.0, 12.0])
ALONG_THE_BANK = (bank, [0.0, 10.0, 20.0, 30.0, 40.0])


@pytest.mark.parametrize(
    ("scene", "gain", "loss", "share"),
    # What the bank hides is predicted as well as it was seen earlier: the stream gains nothing there.
    [(ACROSS_THE_CREST, 0.1, 0.001, 0.5), (ALONG_THE_BANK, -0.01, 0.0, 1.0)],
    ids=["crest", "bank"],
)
def test_ground_seen_only_earlier_raises_recall_at_about_the_same_precision(
    scene: tuple[Ground, list[float]], gain: float, loss: float, share: float
) -> None:
    ground, places_m = scene
    sweeps, truth, known = drive(world_of(ground), places_m)
    held = hold_over(sweeps)[-1]
    (precision, recall), (held_precision, held_recall) = (
        precision_recall(one, truth, known) for one in (sweeps[-1], held)
    )
    assert held_recall > recall + gain
    assert held_precision > precision - loss
    off, held_off = (np.abs(ground_error_m(one, ground, places_m[-1])[known]) > 0.5 for one in (sweeps[-1], held))
    assert held_off.mean() < share * off.mean()


def test_held_ground_says_how_unsure_it_is() -> None:
    ground, places_m = ACROSS_THE_CREST
    sweeps, _, _ = drive(world_of(ground), places_m)
    now, held = sweeps[-1].ground, hold_over(sweeps)[-1].ground
    taken = held.seen & ~now.seen
    assert taken.sum() > 1000
    assert (held.std_m[taken] > 0.05).all()
    assert (held.std_m[taken] < np.maximum(now.std_m[taken], 0.5)).all()
    # What the present sweep saw stays as it is.
    assert np.array_equal(held.heights_m[now.seen], now.heights_m[now.seen])
    assert np.array_equal(held.std_m[now.seen], now.std_m[now.seen])
    # A later sweep, and one from farther away, trust it less.
    last, first = sweeps[-1], sweeps[0]
    soon, late = (
        hold(replace(last, sweep=last.sweep.replace(t_ns=int(1e9 * t_s))), first).ground.std_m for t_s in (1, 20)
    )
    both = (late < now.std_m) & hold(last, first).ground.seen & ~now.seen
    assert both.sum() > 100
    assert (late[both] > soon[both] + 0.05).mean() > 0.95


@pytest.mark.parametrize(
    ("by_m", "gain"),
    # Moved far, a sweep claims a little more by itself, and more of it falsely.
    [(0.6, 0.03), (3.0, -0.04)],
)
def test_what_a_poisoned_sweep_costs_is_less_with_a_stream(by_m: float, gain: float) -> None:
    """The left side is moved as if it lay lower: alone, the sensor then seems to stand above that."""
    ground, places_m = ACROSS_THE_CREST
    sweeps, truth, known = drive(world_of(ground), places_m)
    poisoned = level(lowered(sweeps[-1].sweep, 180.0, by_m), GRID)
    assert poisoned.sensor_height_m > HEIGHT_M + 0.3
    held = hold_over([*sweeps[:-1], poisoned])[-1]
    assert held.sensor_height_m == pytest.approx(HEIGHT_M, abs=0.1)
    assert held.held.is_height_held
    alone, streamed = (precision_recall(one, truth, known) for one in (poisoned, held))
    assert streamed[0] > alone[0]
    assert streamed[1] > alone[1] + gain


def test_nothing_is_held_where_a_pose_is_off() -> None:
    sweeps, _, _ = drive(world_of(crest), [-6.0, 0.0])
    pose = sweeps[0].sweep.world_from_sensor
    wrong = Rigid(pose.rotation, pose.translation + np.array([0.0, 0.0, 3.0]))
    moved = replace(sweeps[0], sweep=sweeps[0].sweep.replace(world_from_sensor=wrong))
    assert np.array_equal(hold(sweeps[1], moved).ground.heights_m, sweeps[1].ground.heights_m)
    far = Rigid(pose.rotation, pose.translation + np.array([500.0, 0.0, 0.0]))
    away = replace(sweeps[0], sweep=sweeps[0].sweep.replace(world_from_sensor=far))
    assert np.array_equal(hold(sweeps[1], away).ground.seen, sweeps[1].ground.seen)


def test_a_carrier_that_rises_is_believed_at_once() -> None:
    world = world_of(crest)
    sweeps, _, _ = drive(world, [-40.0] * 5)
    higher = level(observed(world, -40.0, 5, HEIGHT_M + 1.2)[0], GRID)
    held = hold_over([*sweeps, higher])[-1]
    assert held.sensor_height_m == higher.sensor_height_m == pytest.approx(HEIGHT_M + 1.2, abs=0.1)


def test_a_height_that_is_given_is_no_matter_of_the_stream() -> None:
    sweeps, _, _ = drive(world_of(crest), [-6.0] * 4)
    given = level(sweeps[-1].sweep.replace(sensor_height_m=2.4), GRID)
    held = hold_over([*sweeps[:-1], given])[-1]
    assert held.sensor_height_m == 2.4
    assert not held.held.is_height_held
    assert len(held.held.estimates) == 3


def test_an_estimator_takes_what_the_stream_holds() -> None:
    ground, places_m = ACROSS_THE_CREST
    sweeps, _, _ = drive(world_of(ground), places_m)
    sweeps[-1] = level(lowered(sweeps[-1].sweep, 180.0), GRID)
    estimator = ShadowMap(GRID)
    *_, streamed = estimator.stream((one.sweep for one in sweeps), history=5)
    given = estimator.estimate(sweeps[-1], [one.sweep for one in sweeps[:-1]])
    for found in (streamed, given):
        assert found.basis.height_source == "held"
        assert abs(found.basis.sensor_height_m - HEIGHT_M) < 0.15
    assert np.array_equal(streamed.state, given.state)
    alone = estimator.estimate(sweeps[-1]).basis
    assert alone.height_source == "estimated"


def test_the_history_of_another_sweep_is_refused() -> None:
    sweeps, _, _ = drive(world_of(crest), [-6.0, 0.0, 6.0])
    history = History.of(sweeps[1], sweeps[:1])
    with pytest.raises(ValueError, match="history must be that of the sweep to estimate, got another one's"):
        ShadowMap(GRID).estimate(sweeps[2], history)


def test_a_stream_keeps_no_chain_of_sweeps() -> None:
    sweeps, _, _ = drive(world_of(crest), [-6.0, 0.0])
    estimator, alive = TemporalEstimator(ShadowMap(GRID), SweepBuffer(2)), []
    for number in range(12):
        one = sweeps[number % 2]
        later = replace(one, sweep=one.sweep.replace(t_ns=number * 1_000_000_000))
        estimator.estimate(later)
        alive.append(ref(estimator.buffer._kept["ego"][-1]))
        del later
    gc.collect()
    assert [one() is not None for one in alive] == [False] * 10 + [True] * 2


def without_pose(sweep: Sweep, t_s: float) -> LeveledSweep:
    return level(sweep.replace(world_from_sensor=None, attitude=None, t_ns=int(1e9 * t_s)), GRID)


def test_a_sensor_at_rest_keeps_its_height_without_poses() -> None:
    world = world_of(crest)
    rest = Rest()
    sweeps = [observed(world, -12.0, number=number)[0] for number in range(5)]
    for number, sweep in enumerate(sweeps[:4]):
        assert rest.hold(without_pose(sweep, 1.0 + 0.1 * number)).sensor_height_m == pytest.approx(HEIGHT_M, abs=0.05)
    off = without_pose(sweeps[4], 1.4)
    higher = Rigid(off.level_from_sensor.rotation, np.array([0.0, 0.0, HEIGHT_M + 0.7]))
    held = rest.hold(replace(off, level_from_sensor=higher))
    assert held.sensor_height_m == pytest.approx(HEIGHT_M, abs=0.05)
    assert held.held.is_height_held


def test_the_height_at_rest_is_one_number_and_changes_only_where_most_estimates_say_so() -> None:
    """Estimates of one sensor that jump between two heights, as in a room where a table is as large as the floor."""
    rest, world = Rest(), world_of(crest)
    found = []
    for number, estimate_m in enumerate([1.8, 2.4, 1.8, 2.4, 2.4, 1.8, 2.4, 2.4]):
        one = without_pose(observed(world, -12.0, number=number)[0], 1.0 + 0.1 * number)
        moved = Rigid(one.level_from_sensor.rotation, np.array([0.0, 0.0, estimate_m]))
        found.append(rest.hold(replace(one, level_from_sensor=moved)).sensor_height_m)
    # The fifth estimate is the third at 2.4 m, against two at 1.8 m.
    assert found == pytest.approx([1.8] * 4 + [2.4] * 4)


def test_the_attitude_at_rest_is_that_of_most_estimates() -> None:
    rest, world = Rest(), world_of(crest)
    pitches, found = [0.0, 8.0, 0.0, 7.5, 8.0, 0.0, 8.5, 8.0], []
    for number, pitch_deg in enumerate(pitches):
        one = without_pose(observed(world, -12.0, number=number)[0], 1.0 + 0.1 * number)
        turned = Rigid(Rotation.from_euler("y", pitch_deg, degrees=True).as_matrix(), np.array([0.0, 0.0, HEIGHT_M]))
        held = rest.hold(replace(one, level_from_sensor=turned))
        assert held.sweep is one.sweep
        found.append(
            float(np.degrees(np.arctan2(-held.level_from_sensor.rotation[2, 0], held.level_from_sensor.rotation[2, 2])))
        )
    # The fifth estimate is the third near 8°, against two of 0°.
    assert found[:4] == pytest.approx([0.0] * 4, abs=1e-6)
    assert found[4:] == pytest.approx([found[4]] * 4, abs=1e-6)
    assert 7.4 < found[4] < 8.6


@pytest.mark.parametrize(("x_m", "t_s"), [(-10.0, 1.1), (-12.0, 30.0), (-12.0, 0.5)], ids=["moved", "late", "back"])
def test_who_moves_or_whose_time_jumps_begins_anew_without_poses(x_m: float, t_s: float) -> None:
    world = world_of(crest)
    rest = Rest()
    rest.hold(without_pose(observed(world, -12.0)[0], 1.0))
    assert rest.hold(without_pose(observed(world, x_m, number=1)[0], t_s)).held is None
    assert rest.hold(without_pose(observed(world, x_m, number=2)[0], t_s + 0.1)).held is not None


def test_a_real_sensor_at_rest_that_sees_little_ground_keeps_height_and_attitude(real_data: Path) -> None:
    """Each by itself, its sweeps have heights of .3 to 1.0 m and tilts of 0 to 8°; in a stream all soon have one."""
    sweeps = list(read_sweeps(real_data / "vlp16_packets" / "einride_recording.bin"))
    alone = [ShadowMap(GRID, CAR).estimate(sweep) for sweep in sweeps]
    held = list(ShadowMap(GRID, CAR).stream(sweeps))
    alone_m, held_m = ([found.basis.sensor_height_m for found in kind] for kind in (alone, held))
    assert np.ptp(alone_m) > 0.5
    assert np.ptp(held_m[4:]) == 0.0

    def iou(kind: list[FovEstimate]) -> float:
        """Return the mean over pairs of sweeps of the last half: visible in both, of visible in either."""
        pairs = [(one.visible(), other.visible()) for one, other in pairwise(kind[5:])]
        return float(np.mean([(one & other).sum() / (one | other).sum() for one, other in pairs]))

    assert iou(held) > 0.94
    assert iou(held) > iou(alone) + 0.04
