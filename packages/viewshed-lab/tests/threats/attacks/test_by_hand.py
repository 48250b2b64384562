"""Each family on flat ground where everything is known: a wall ahead that reaches farther left than right."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.threats.attacks.conftest import MODEL, SENSOR_M, FlatScene

from viewshed import lidar_model
from viewshed.arrays import F32
from viewshed.geometry import Rigid
from viewshed_lab.threats.attacks import RELIABILITY, Spoofer, Tampered, Wedge, at_severity
from viewshed_lab.threats.attacks.ghosts import FarWall, GhostCar, GhostWall, RemovalAndFarWall
from viewshed_lab.threats.attacks.points import Cluster, Frustum, Mode, Uniform, WedgeCluster
from viewshed_lab.threats.attacks.replay import CoherentPhantom, PoseSpoof, Replay
from viewshed_lab.threats.attacks.wedge_attack import HighFrequencyRemoval, Jamming, PhysicalRemoval, Relay

SURE = Spoofer(1.0, 0.0, 0.0)


def _azimuth(points: F32) -> NDArray[np.float32]:
    return np.arctan2(points[:, 1], points[:, 0])


def _new(tampered: Tampered) -> F32:
    return tampered.sweep.points[tampered.added]


def test_a_ghost_wall_is_a_plane_with_nothing_behind_it(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    clean = flat_scene()
    tampered = GhostWall(sector_deg=20.0, range_m=12.0, azimuth=np.pi / 2, spoofer=SURE).apply(clean, rng)
    new, points = _new(tampered), tampered.sweep.points
    assert np.abs(new[:, 1] - 12.0).max() < 0.003
    assert new[:, 2].max() < 3.0 - SENSOR_M
    in_wedge = Wedge(np.pi / 2, np.deg2rad(20.0)).holds(_azimuth(points))
    assert points[in_wedge, 1].max() < 12.003
    # 40 columns; the rings from -8° (ground at 12.8 m) to +3° (0.63 m above the sensor) meet the wall
    assert len(new) == 40 * 12
    assert int(tampered.removed.sum()) == 40 * 7  # rings from -8° to -2° had met the ground within 60 m


def test_a_ghost_car_stands_left_and_shows_its_rear(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    tampered = GhostCar(range_m=10.0, azimuth=0.6, spoofer=SURE).apply(flat_scene(), rng)
    new = _new(tampered)
    c, s = np.cos(0.6), np.sin(0.6)
    ahead, left = c * new[:, 0] + s * new[:, 1], c * new[:, 1] - s * new[:, 0]
    assert np.abs(left).max() < 0.9 + 0.003
    assert ahead.min() == pytest.approx(10.0 - 2.1, abs=0.003)
    top = np.abs(new[:, 2] - (1.5 - SENSOR_M)) < 0.003
    assert (top | (np.abs(ahead - 7.9) < 0.003)).all()
    assert top.any()


def test_a_budget_takes_the_beams_nearest_to_the_middle(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    tampered = GhostWall(60, 40.0, 12.0, azimuth=1.0, spoofer=SURE).apply(flat_scene(), rng)
    new = _new(tampered)
    assert len(new) == 60
    assert np.abs(_azimuth(new) - 1.0).max() < 6 * MODEL.azimuth_step / 2 + 1e-3


def test_what_stands_nearer_hides_a_ghost(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    tampered = GhostWall(sector_deg=10.0, range_m=15.0, azimuth=0.0, spoofer=SURE).apply(flat_scene(8.0), rng)
    # only what passes over the wall at 8 m, 0.7 m above the sensor: nothing below 3° does
    assert not tampered.added.any()


def test_a_far_wall_leaves_free_road(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    clean = flat_scene(8.0)
    tampered = FarWall(sector_deg=40.0, near_m=20.0, far_m=40.0, azimuth=0.0, spoofer=SURE).apply(clean, rng)
    new, gone = _new(tampered), clean.points[tampered.removed]
    assert np.abs(gone[:, 0] - 8.0).max() < 0.001
    assert gone[:, 2].min() > 0.3 - SENSOR_M - 0.01
    on_road = np.abs(new[:, 2] + SENSOR_M) < 0.1  # as well as the attacker knows the ground
    at_end = np.abs(np.hypot(new[:, 0], new[:, 1]) - 40.0) < 0.01
    assert (on_road | at_end).all()
    assert on_road.any()
    assert at_end.any()
    assert len(new) == len(gone)


def test_removal_then_injection_empties_the_wedge_of_obstacles(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    clean = flat_scene(30.0)
    tampered = RemovalAndFarWall(sector_deg=10.0, far_m=50.0, azimuth=0.0, spoofer=SURE).apply(clean, rng)
    points = tampered.sweep.points[Wedge(0.0, np.deg2rad(10.0)).holds(_azimuth(tampered.sweep.points))]
    standing = points[:, 2] > 0.35 - SENSOR_M
    assert (np.hypot(points[standing, 0], points[standing, 1]) > 49.9).all()
    assert int(tampered.added.sum()) > int(tampered.removed.sum()) > 0
    lossy = replace(RemovalAndFarWall(azimuth=0.0), spoofer=Spoofer(0.5, 0.0, 0.0)).apply(clean, rng)
    sure = replace(RemovalAndFarWall(azimuth=0.0), spoofer=SURE).apply(clean, rng)
    assert int(lossy.removed.sum()) == pytest.approx(int(sure.removed.sum()) / 2, abs=40)
    assert int(lossy.added.sum()) == pytest.approx(int(sure.added.sum()) / 4, abs=40)


def test_high_frequency_removal_leaves_noise(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    clean = flat_scene(8.0)
    tampered = HighFrequencyRemoval(sector_deg=80.0, azimuth=0.0, spoofer=SURE).apply(clean, rng)
    inside = np.abs(_azimuth(clean.points)) < np.deg2rad(40.0)
    assert (tampered.removed == inside).all()
    beams = 160 * 28
    depth_m = np.linalg.norm(_new(tampered), axis=1)
    assert len(depth_m) == pytest.approx(0.3 * beams * (1 - 0.5 / 50), abs=4 * np.sqrt(0.21 * beams))
    assert depth_m.max() <= 50.0
    assert depth_m.mean() == pytest.approx(25.25, abs=4 * 14.4 / np.sqrt(len(depth_m)))


def test_jamming_takes_its_share_of_all_beams(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    beams = 720 * 28
    noisy = Jamming(spoofer=SURE).apply(flat_scene(8.0), rng)
    assert int(noisy.added.sum()) == pytest.approx(0.3 * beams, abs=4 * np.sqrt(0.21 * beams))
    blind = Jamming(share=1.0, blind_share=1.0, spoofer=SURE).apply(flat_scene(8.0), rng)
    assert len(blind.sweep) == 0


def test_a_relay_adds_its_offset(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    clean = flat_scene(8.0)
    tampered = Relay(offset_m=4.0, sector_deg=20.0, azimuth=-0.2, spoofer=SURE).apply(clean, rng)
    before, after = clean.points[tampered.removed], _new(tampered)
    farther = np.linalg.norm(after, axis=1) - np.linalg.norm(before, axis=1)
    assert len(before) > 100
    assert np.abs(farther - 4.0).max() < 0.0015  # whole steps of 2 mm
    nearer = Relay(offset_m=-7.9, sector_deg=20.0, azimuth=-0.2, spoofer=SURE).apply(clean, rng)
    assert int(nearer.added.sum()) < int(nearer.removed.sum())


def test_a_frustum_moves_an_object_back_or_forth(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    clean = flat_scene(12.0)
    behind = Frustum(side="behind", apart_m=6.0, spoofer=SURE).apply(clean, rng)
    moved = np.linalg.norm(_new(behind), axis=1) - np.linalg.norm(clean.points[behind.removed], axis=1)
    assert len(moved) > 20
    assert moved.max() == pytest.approx(6.0, abs=0.003)
    assert _new(behind)[:, 2].min() > -SENSOR_M - 0.05
    before = Frustum(side="before", apart_m=6.0, spoofer=SURE).apply(clean, rng)
    assert np.hypot(*_new(before)[:, :2].T).max() < 12.5 * 1.2 - 5.0
    free = Frustum(mode="free_form").apply(clean, rng)
    assert not free.removed.any()
    assert _new(free)[:, 0].max() > 13.0


def test_clusters_lie_where_they_are_told(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    clean, middle = flat_scene(), 20.0 * np.array([np.cos(2.0), np.sin(2.0)])
    for mode in get_args(Mode):
        attack = Cluster(80, range_m=(20.0, 20.0), azimuth=2.0, mode=mode, spoofer=SURE)
        new = _new(attack.apply(clean, rng))
        assert 20 < len(new) <= 80
        assert np.abs(new[:, :2] - middle).max() < 3.01
    for mode in get_args(Mode):
        wedge = WedgeCluster(60, azimuth=2.0, mode=mode, spoofer=SURE)
        new = _new(wedge.apply(clean, rng))
        assert len(new) == 60
        assert np.abs(_azimuth(new) - 2.0).max() <= np.deg2rad(4.0) + 1e-6
        assert np.abs(np.hypot(new[:, 0], new[:, 1]) - 10.0).max() < 0.01
        assert ((new[:, 2] > 0.15 - SENSOR_M) & (new[:, 2] < 1.85 - SENSOR_M)).all()


def test_uniform_points_fill_the_extent(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    square = _new(Uniform(4000, 30.0).apply(flat_scene(), rng))
    assert np.abs(square[:, :2]).max() <= 30.001
    quarters = np.histogram2d(square[:, 0], square[:, 1], bins=2, range=[[-30, 30], [-30, 30]])[0]
    assert np.abs(quarters - 1000).max() < 4 * np.sqrt(750)
    disc = np.hypot(*_new(Uniform(4000, 30.0, "beam_constrained", SURE).apply(flat_scene(), rng))[:, :2].T)
    assert disc.max() <= 30.01
    assert (disc < 30 / np.sqrt(2)).mean() == pytest.approx(0.5, abs=0.04)


def test_a_clean_spoofer_has_the_sensors_noise_and_no_other(flat_scene: FlatScene) -> None:
    """A sensor that no table knows has 1 cm; an HDL-32E has 5 mm."""
    clean = flat_scene()
    for model, sigma_m in ((MODEL, 0.01), (replace(MODEL, name="HDL-32E"), 0.005)):
        attack = at_severity("ghost_wall_clean", "azimuth", 0.0)
        deviation_m, offset_m = [], []
        for seed in range(8):
            new = _new(attack.apply(clean.replace(model=model), np.random.Generator(np.random.PCG64(seed))))
            depth_m = np.linalg.norm(new, axis=1)
            off_m = depth_m - 15.0 * depth_m / new[:, 0]
            deviation_m.append(off_m.std())
            offset_m.append(off_m.mean())
        assert np.mean(deviation_m) == pytest.approx(sigma_m, rel=0.05)
        assert np.abs(offset_m).max() < 0.1 * sigma_m


def test_noise_is_shared_by_a_sweep_and_own_to_a_point(flat_scene: FlatScene) -> None:
    clean, means, spreads = flat_scene(), [], []
    for seed in range(200):
        wall = GhostWall(sector_deg=10.0, range_m=12.0, azimuth=0.0, spoofer=Spoofer(1.0))
        new = _new(wall.apply(clean, np.random.Generator(np.random.PCG64(seed))))
        off_m = np.linalg.norm(new, axis=1) * (1 - 12.0 / new[:, 0])
        means.append(off_m.mean())
        spreads.append(off_m.std())
    assert np.std(means) == pytest.approx(0.35, abs=0.07)
    assert np.mean(spreads) == pytest.approx(0.10, abs=0.01)


@pytest.mark.parametrize("sensor", ["vlp16", "vlp32c", "os1_32", "hdl32e"])
def test_how_many_beams_are_won_depends_on_the_sensor(sensor: str, flat_scene: FlatScene) -> None:
    sweep = flat_scene().replace(ring=None, model=lidar_model(sensor))
    tampered = PhysicalRemoval(sector_deg=90.0, azimuth=0.3).apply(sweep, np.random.default_rng(1))
    aimed = int((np.abs(_azimuth(sweep.points) - 0.3) < np.pi / 4).sum())
    expected = {"VLP-16": 0.985, "VLP-32C": 0.83, "OS1-32": 0.44}.get(lidar_model(sensor).name, 0.985)
    assert RELIABILITY.get(lidar_model(sensor).name, 0.985) == expected
    assert int(tampered.removed.sum()) / aimed == pytest.approx(expected, abs=0.03)


def test_a_spoofed_pose_is_turned_and_shifted(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    pose = Rigid.from_quaternion([0.9, 0.1, -0.05, np.sqrt(1 - 0.81 - 0.0125)], (5.0, -3.0, 2.0))
    clean = flat_scene(pose=pose)
    spoofed = PoseSpoof(yaw_deg=5.0, shift_m=2.0).apply(clean, rng).sweep
    turned = spoofed.world_from_sensor.rotation @ pose.rotation.T
    assert abs(np.rad2deg(np.arctan2(turned[1, 0], turned[0, 0]))) == pytest.approx(5.0)
    assert turned[2, 2] == pytest.approx(1.0)
    shift = spoofed.world_from_sensor.translation - pose.translation
    assert np.hypot(shift[0], shift[1]) == pytest.approx(2.0)
    assert shift[2] == 0.0
    assert spoofed.points.tobytes() == clean.points.tobytes()
    tilted = at_severity("pose_spoof", "tilt_deg", 3.0).apply(clean.replace(attitude=[1.0, 0, 0, 0]), rng).sweep
    assert 2 * np.rad2deg(np.arccos(tilted.attitude[0])) == pytest.approx(3.0)


def test_a_replay_gives_the_earlier_ranges(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    clean, earlier = flat_scene(), flat_scene(8.0)
    tampered = Replay(earlier, sector_deg=60.0, azimuth=0.5, spoofer=SURE).apply(clean, rng)
    inside = np.abs(_azimuth(earlier.points) - 0.5) < np.deg2rad(30.0)
    old, new = earlier.points[inside], _new(tampered)
    assert len(new) == len(old)
    assert np.abs(new - old).max() < 0.0015
    outside = np.abs(_azimuth(clean.points) - 0.5) > np.deg2rad(30.0)
    assert (tampered.removed == ~outside).all()
    whole = Replay(earlier, mode="free_form").apply(clean, rng)
    assert whole.sweep.points.tobytes() == earlier.points.tobytes()
    assert whole.added.all()
    assert whole.removed.all()


def test_a_phantom_keeps_its_place(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    first = Rigid(np.eye(3), np.array([0.0, 0.0, SENSOR_M]))
    later = Rigid.from_yaw(0.4, (3.0, -1.0, SENSOR_M))
    ghost = CoherentPhantom(first, range_m=14.0, azimuth=0.3, spoofer=SURE)
    here = 14.0 * np.array([np.cos(0.3), np.sin(0.3)])
    for pose in (first, later):
        clean = flat_scene(pose=pose)
        world = pose @ _new(ghost.apply(clean, rng))
        assert len(world) > 20
        along = (world[:, :2] - here) @ np.array([[np.cos(0.3)], [np.sin(0.3)]])
        across = (world[:, :2] - here) @ np.array([[-np.sin(0.3)], [np.cos(0.3)]])
        assert np.abs(along).max() < 2.1 + 0.005
        assert np.abs(across).max() < 0.9 + 0.005
    fixed = replace(ghost, anchor="sensor")
    one, other = (_new(fixed.apply(flat_scene(pose=pose), np.random.default_rng(1))) for pose in (first, later))
    assert one.tobytes() == other.tobytes()
    moving = replace(ghost, first_ns=0, velocity_mps=(-2.0, 0.0))
    moved = _new(moving.apply(flat_scene(pose=first).replace(t_ns=2_000_000_000), rng))
    assert moved[:, 0].mean() < here[0] - 3.0


def test_removal_aims_at_an_obstacle(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    tampered = PhysicalRemoval().apply(flat_scene(8.0), rng)
    assert np.arctan2(-4, 8) - 0.01 < tampered.wedge.azimuth < np.arctan2(6, 8) + 0.01
