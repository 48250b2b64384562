"""Corruptions computed by hand, and beside the simulator's own motion and weather."""

import numpy as np
import pytest

from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.sim import cast_world
from viewshed_lab.sim.lidar.firing import column_poses, still_firing
from viewshed_lab.sim.lidar.measurement import measure
from viewshed_lab.sim.lidar.weather import CONDITIONS, Conditions
from viewshed_lab.sim.raycast.scan import Motion
from viewshed_lab.sim.world import AgentPlan
from viewshed_lab.sim.worlds import WORLDS
from viewshed_lab.threats.corruptions import (
    DeadRings,
    DroppedBeams,
    DroppedSectors,
    FewerBeams,
    GlassPatches,
    InTheWorld,
    Miscalibration,
    MotionDistortion,
    RangeNoise,
    Slope,
    Vegetation,
    Weather,
)


def rng(seed: int = 3) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def fan(columns: int = 3600, range_m: float = 20.0) -> Sweep:
    """One level ring of returns at the same range."""
    azimuth = (np.arange(columns) + 0.5) * 2 * np.pi / columns - np.pi
    points = range_m * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(columns)], axis=1)
    return Sweep(points.astype(np.float32), ring=np.zeros(columns, np.int16))


def test_dropped_beams_are_the_share_to_the_return(street: Sweep) -> None:
    assert len(DroppedBeams(0.25).apply(fan(400), rng())) == 300
    assert len(DroppedBeams(1.0).apply(street, rng())) == 0
    assert len(DroppedBeams(0.0).apply(street, rng())) == len(street)


def test_a_dropped_sector_is_one_gap_of_its_width() -> None:
    gaps = []
    for seed in range(8):
        left = DroppedSectors(1, 30.0).apply(fan(), rng(seed))
        azimuth = np.sort(np.arctan2(left.points[:, 1], left.points[:, 0]))
        gap = np.diff(azimuth, append=azimuth[0] + 2 * np.pi)
        assert np.rad2deg(gap.max()) == pytest.approx(30.0, abs=0.21)
        assert np.rad2deg(np.sort(gap)[-2]) == pytest.approx(0.1, abs=0.01)
        gaps.append(azimuth[gap.argmax()])
    assert np.std(gaps) > 0.5  # anywhere


def test_dead_rings_are_whole_and_as_many_as_the_share(street: Sweep) -> None:
    assert street.ring is not None
    left = DeadRings(0.25).apply(street, rng())
    assert left.ring is not None
    counts, clean = (np.bincount(s, minlength=16) for s in (left.ring, street.ring))
    assert set(np.unique(counts[counts != clean])) <= {0}
    assert 16 - 4 - (clean == 0).sum() <= (counts > 0).sum() <= 12


def test_fewer_beams_keep_the_lowest_of_each_group() -> None:
    ring = np.arange(8, dtype=np.int16)
    sweep = Sweep(np.stack([np.full(8, 5.0), ring, ring], axis=1).astype(np.float32), ring=ring)
    kept = {
        (k, n): np.array(FewerBeams(k, n).apply(sweep, rng()).ring).tolist()
        for k, n in ((1, 2), (3, 4), (1, 4), (1, 8))
    }
    assert kept == {(1, 2): [0, 2, 4, 6], (3, 4): [0, 1, 2, 4, 5, 6], (1, 4): [0, 4], (1, 8): [0]}


def test_range_noise_has_its_standard_deviation_and_no_bias() -> None:
    error = np.linalg.norm(RangeNoise(0.2).apply(fan(), rng()).points, axis=1) - 20.0
    assert error.std() == pytest.approx(0.2, rel=0.05)
    assert abs(error.mean()) < 0.015
    nearest = np.linalg.norm(RangeNoise(5.0).apply(fan(range_m=1.0), rng()).points, axis=1)
    assert nearest.min() == pytest.approx(0.05, rel=1e-3)  # never behind the sensor


def test_times_of_the_sweep_come_first() -> None:
    points = np.array([[0.0, 8.0, 1.0], [6.0, 0.0, -1.0], [0.0, -8.0, 2.0]], np.float32)
    found = MotionDistortion(10.0, 0.0).apply(Sweep(points, time_s=np.array([0.0, 0.2, 0.1])), rng())
    np.testing.assert_allclose(found.points[:, 0], [1.0, 5.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_distortion_undoes_what_the_simulator_undid(seed: int) -> None:
    model, pose = lidar_model("vlp16"), Rigid.from_yaw(0.4)
    speed, degps = 12.0, 20.0
    depth = np.random.default_rng(1).uniform(5, 40, (model.azimuth_columns, model.rings, 1)).astype(np.float32)
    own = (still_firing(model)[1] * depth)[:, 3]
    errors = []
    for sign in (1, -1):
        motion = Motion((speed * np.cos(0.4), speed * np.sin(0.4), 0.0), sign * np.deg2rad(degps), 0.1)
        turn, shift_m, time_s = column_poses(model, motion, pose)
        undone = np.einsum("cij,cj->ci", turn, own) + shift_m
        found = MotionDistortion(speed, degps).apply(Sweep(undone, time_s=time_s), rng(seed))
        errors.append(np.abs(found.points - own).max())
    assert min(errors) < 0.002  # to one of the two sides
    assert max(errors) > 0.1


@pytest.mark.parametrize("known", [True, False])
def test_miscalibration_tilts_the_vertical_by_its_angle(street: Sweep, known: bool) -> None:
    tilted = rotation_from_quaternion(np.array([np.cos(0.05), 0.0, np.sin(0.05), 0.0]))
    sweep = street.replace(world_from_sensor=Rigid(Rigid.from_yaw(2.0).rotation @ tilted, np.ones(3)), attitude=None)
    found = Miscalibration(2.0).apply(sweep if known else sweep.replace(world_from_sensor=None), rng())
    claimed, true = rotation_from_quaternion(found.attitude)[2], (tilted if known else np.eye(3))[2]
    assert np.rad2deg(np.arccos(claimed @ true)) == pytest.approx(2.0, abs=1e-4)
    assert np.array_equal(found.points, street.points)
    if known:
        of_pose = found.replace(attitude=None).known_attitude
        assert of_pose is not None
        np.testing.assert_allclose(of_pose, found.attitude, atol=1e-9)
        np.testing.assert_array_equal(found.world_from_sensor.translation, np.ones(3))


def test_a_slope_raises_one_side_only() -> None:
    rise = Slope(0.1, 5.0).apply(fan(), rng()).points - fan().points
    assert not rise[:, :2].any()
    assert rise[:, 2].max() == pytest.approx(0.1 * (20 - 5), abs=1e-3)
    assert rise[:, 2].min() == 0
    assert (rise[:, 2] > 0).mean() == pytest.approx(np.arccos(5 / 20) / np.pi, abs=0.002)


def test_glass_takes_one_patch_of_a_raised_surface(street: Sweep) -> None:
    for seed in range(6):
        left = GlassPatches(1, 2.0).apply(street, rng(seed))
        assert street.azimuth is not None
        here = {row.tobytes() for row in left.points}
        gone = np.array([row for row in street.points if row.tobytes() not in here])
        assert len(gone) > 0
        middle = min(gone, key=lambda row: float(np.linalg.norm(gone - row, axis=1).max()))
        assert np.linalg.norm(gone - middle, axis=1).max() <= 2.0 + 1e-4
        assert gone[:, 2].max() > -1.8 + 0.3


def _wall() -> Sweep:
    azimuth, elevation = np.meshgrid(np.linspace(0.9, 1.4, 400), np.linspace(-0.2, 0.25, 400))
    way = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=-1).reshape(-1, 3)
    return Sweep((way * (20.0 / way[:, 1:2])).astype(np.float32))


def _sphere_of(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Center and radius of the sphere through the points (least squares)."""
    table = np.column_stack([2 * points, np.ones(len(points))])
    found = np.linalg.lstsq(table, (points**2).sum(axis=1), rcond=None)[0]
    return found[:3], float(np.sqrt(found[3] + found[:3] @ found[:3]))


def test_leaves_stop_what_beers_law_says() -> None:
    wall = _wall()
    dense, thin = (Vegetation(1, 0.8, per_m=per_m).apply(wall, rng()) for per_m in (1e6, 0.9))
    met = np.linalg.norm(dense.points - wall.points, axis=1) > 1e-3
    center, _ = _sphere_of(dense.points[met].astype(np.float64))
    way = wall.points / np.linalg.norm(wall.points, axis=1)[:, None]
    half = np.sqrt(np.maximum(0.8**2 - (center @ center - (way @ center) ** 2), 0))
    expected = 1 - np.exp(-0.9 * 2 * half)
    stopped = np.linalg.norm(thin.points - wall.points, axis=1) > 1e-3
    assert stopped.sum() == pytest.approx(expected.sum(), abs=4 * np.sqrt(expected.sum()))
    assert (np.linalg.norm(thin.points[stopped] - center, axis=1) < 0.81).all()


@pytest.mark.parametrize("name", ["heavy_rain", "dense_fog", "snow"])
def test_as_many_particles_as_in_the_simulator(name: str) -> None:
    model = lidar_model("hdl32e")
    world = WORLDS["street"](rng(1), AgentPlan(moving=1))
    agent = world.agents[0]
    scan = cast_world(world.snapshot(0.0), model, world.world_from_sensor(agent, 0.0))
    clear = measure(scan, Conditions(mixed_share=0.0), rng(2))
    wild = measure(scan, CONDITIONS[name], rng(3))
    spoilt = Weather(CONDITIONS[name]).apply(clear.sweep(), rng(4))
    returned = clear.steps > 0
    depth = np.where(returned, scan.depth_m, 0)
    simulated = int(((wild.steps > 0) & returned & (wild.steps * wild.step_m < depth - 1.0)).sum())
    before = np.linalg.norm(clear.sweep().points, axis=1)
    exact = {(r, t): d for r, t, d in zip(*_columns(clear.sweep()), before, strict=True)}
    ring, time_s = _columns(spoilt)
    after = np.linalg.norm(spoilt.points, axis=1)
    apart = np.array([exact[r, t] for r, t in zip(ring, time_s, strict=True)]) - after
    assert (apart > 1.0).sum() == pytest.approx(simulated, rel=0.15, abs=30)


def _columns(sweep: Sweep) -> tuple[list[int], list[tuple[float, ...]]]:
    """Ring and a key of the direction of each return."""
    assert sweep.ring is not None
    way = sweep.points / np.linalg.norm(sweep.points, axis=1)[:, None]
    azimuth = np.round(np.arctan2(way[:, 1], way[:, 0]) / np.deg2rad(0.05)).astype(int)
    return [int(r) for r in sweep.ring], [(int(a),) for a in azimuth]


def test_fog_weakens_far_returns_most_and_dims_all() -> None:
    points = np.concatenate([fan(2000, 15.0).points, fan(2000, 70.0).points])
    fog = Weather(Conditions(extinction_per_m=0.03))
    found = fog.apply(Sweep(points, intensity=np.full(4000, 50.0, np.float32)), rng())
    range_m = np.linalg.norm(found.points, axis=1)
    near, far = (range_m < 30), (range_m > 30)
    assert near.sum() > 1900
    # s = 2 (70 / 70)², in fog 2 exp(-4.2): F(s') / F(s) = s'⁴ / (1 + s'⁴) · 17 / 16
    weak = (2 * np.exp(-4.2)) ** 4
    assert far.sum() == pytest.approx(2000 * weak / (1 + weak) * 17 / 16, abs=3)
    assert np.median(np.array(found.intensity)[near]) == pytest.approx(50 * np.exp(-2 * 0.03 * 15), rel=0.01)


@pytest.mark.parametrize("corruption", [GlassPatches(3, 2.0), Slope(0.1, 5.0), Vegetation(4, 1.5, per_m=1e6)])
def test_what_stands_in_the_world_is_the_same_from_elsewhere(corruption: InTheWorld) -> None:
    """A sensor turned by a quarter sees the same things in the same places; the leaves stop every beam at once."""
    azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 360, endpoint=False), [-0.1, 0.0, 0.1])
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=-1).reshape(-1, 3)
    sweep = Sweep((30.0 * directions).astype(np.float32))
    places = corruption.place(sweep, rng())
    now_from_before = Rigid.from_yaw(np.pi / 2)
    turned = sweep.replace(points=now_from_before @ sweep.points)
    expected = now_from_before @ corruption.apply_at(sweep, places, rng()).points
    seen = corruption.apply_at(turned, now_from_before @ places, rng()).points
    assert len(seen) == len(expected)
    np.testing.assert_allclose(seen, expected, atol=1e-4)
    assert not np.array_equal(expected, now_from_before @ sweep.points)
