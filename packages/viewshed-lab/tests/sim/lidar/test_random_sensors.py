"""Sensors drawn at random obey the bounds of their family, and their sweeps obey their own beams."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.sim.oracle import opaque_depth, rays_of

from viewshed.fov.estimate import CellState
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS, polar_of_cells
from viewshed.sensors import LidarModel, lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.data.wild import wild_tables
from viewshed_lab.sim import Box, Scene, junction
from viewshed_lab.sim.lidar.measurement import measure
from viewshed_lab.sim.lidar.random_sensors import DrawnSensor, SensorFamily, draw_sensor
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import ExactScan, Motion
from viewshed_lab.sim.truth.exact import exact_truth

FAMILIES = wild_tables().sensors
SCENE = junction().world()
POSE = Rigid.from_quaternion((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.9))


def drawn(family: SensorFamily, seed: int = 3, sweep: int = 0) -> DrawnSensor:
    """Return a sensor of a family by its seed."""
    return draw_sensor(family, np.random.default_rng(seed), sweep)


def scanned(model: LidarModel, pose: Rigid = POSE, motion: Motion | None = None) -> ExactScan:
    """Return what a sensor's beams meet in the junction."""
    return cast_world(SCENE.snapshot(0.0), model, pose, motion or Motion())


def swept(model: LidarModel, conditions: str = "clear") -> Sweep:
    """Return what a sensor measures in the junction."""
    return measure(scanned(model), CONDITIONS[conditions], np.random.default_rng(1)).sweep()


@pytest.mark.parametrize("name", FAMILIES)
def test_a_drawn_sensor_lies_within_the_bounds_of_its_family(name: str) -> None:
    family = FAMILIES[name]
    for seed in range(5):
        model = drawn(family, seed).model
        assert family.columns[0] <= model.azimuth_columns <= family.columns[1]
        assert family.max_range_m[0] <= model.max_range_m <= family.max_range_m[1]
        if family.pattern == "rings":
            assert family.rings[0] <= model.rings <= family.rings[1]
        low, high = (model.elevation if model.shots is None else model.shots[..., 1]).ravel()[[0, -1]]
        if family.pattern == "rings" and model.shots is None:
            slack = np.deg2rad(5 * family.calibration_deg + 0.01)
            assert np.deg2rad(family.lowest_deg[0]) - slack <= low < high <= np.deg2rad(family.highest_deg[1]) + slack
        if model.shots is not None:
            azimuth, elevation = np.moveaxis(model.shots, -1, 0)
            widest = family.field_deg[1] / 2 + 5 * (family.azimuth_offset_deg + family.calibration_deg) + 1
            assert np.rad2deg(np.nanmax(np.abs(azimuth))) <= widest
            assert np.nanmin(elevation) >= np.deg2rad(family.lowest_deg[0] - 5 * family.calibration_deg - 1e-6)
            assert np.nanmax(elevation) <= np.deg2rad(family.highest_deg[1] + 5 * family.calibration_deg + 1e-6)


@pytest.mark.parametrize("name", FAMILIES)
def test_every_return_lies_on_a_beam_of_its_own_sensor(name: str) -> None:
    sensor = drawn(FAMILIES[name])
    model, sweep = sensor.model, swept(sensor.model)
    assert len(sweep) > 300
    range_m = np.linalg.norm(sweep.points, axis=1)
    assert range_m.min() >= model.min_range_m - 0.01
    assert range_m.max() <= model.max_range_m + 0.01
    if model.shots is None:
        columns = -np.pi + (np.arange(model.azimuth_columns) + 0.5) * model.azimuth_step
        azimuth = columns[:, None] + model.azimuth_offset
        elevation = np.broadcast_to(model.elevation, azimuth.shape)
    else:
        azimuth, elevation = np.moveaxis(model.shots[model.fired], -1, 0)
    flat = np.cos(elevation)
    beams = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)
    assert cKDTree(beams).query(sweep.points / range_m[:, None])[0].max() < 1e-5


@pytest.mark.parametrize("name", FAMILIES)
def test_what_is_handed_out_obeys_the_family(name: str) -> None:
    family, sensor = FAMILIES[name], drawn(FAMILIES[name])
    sweep = swept(sensor.model)
    given = sensor.deliver(sweep, np.random.default_rng(0))
    assert len(given) == len(sweep)
    assert [key for key in ("ring", "time_s", "intensity") if getattr(given, key) is None] == [
        key for key in ("ring", "time_s", "intensity") if key in family.leaves_out
    ]
    assert (given.model is None) == (family.pattern != "rings")
    # Directions stay, ranges are off by what their ring is off.
    ways, old_ways = (one.points / np.linalg.norm(one.points, axis=1)[:, None] for one in (given, sweep))
    away, rows = cKDTree(old_ways).query(ways)
    assert away.max() < 1e-5
    assert len(np.unique(rows)) > 0.99 * len(rows)
    if family.order == "fired":
        assert (np.linalg.norm(ways - old_ways, axis=1) < 1e-5).all()
    if family.order == "by_ring" and given.ring is not None:
        assert (np.diff(given.ring) >= 0).all()
    if family.order == "shuffled":
        assert np.linalg.norm(ways - old_ways, axis=1).mean() > 0.3


def test_ranges_of_a_ring_are_off_by_its_offset() -> None:
    sensor = DrawnSensor("two", lidar_model("vlp16"), None, np.linspace(-0.05, 0.05, 16))
    sweep = swept(sensor.model)
    given = sensor.deliver(sweep, np.random.default_rng(0))
    off = np.linalg.norm(given.points, axis=1) - np.linalg.norm(sweep.points, axis=1)
    assert sweep.ring is not None
    assert off == pytest.approx(sensor.range_offset_m[sweep.ring], abs=2e-5)


def test_shots_at_the_angles_of_the_rings_meet_what_the_rings_meet() -> None:
    model = lidar_model("vlp16")
    columns = -np.pi + (np.arange(model.azimuth_columns) + 0.5) * model.azimuth_step
    azimuth = columns[:, None] + model.azimuth_offset
    shots = np.stack([azimuth, np.broadcast_to(model.elevation, azimuth.shape)], axis=-1)
    tilted = Rigid.from_quaternion((np.cos(0.05), 0.0, np.sin(0.05), 0.0), (0.0, 0.0, 1.9))
    moving = Motion((8.0, 1.0, 0.0), 0.3, 0.1)
    one, other = (scanned(sensor, tilted, moving) for sensor in (model, replace(model, shots=shots)))
    assert one.depth_m.tobytes() == other.depth_m.tobytes()
    assert one.thing.tobytes() == other.thing.tobytes()


@pytest.mark.parametrize("name", ["sealed_rosette", "sealed_weave"])
def test_patterns_meet_what_brute_force_meets(name: str) -> None:
    model = drawn(FAMILIES[name]).model
    few = replace(model, azimuth_columns=150, shots=None if model.shots is None else model.shots[:150])
    scan = scanned(few, Rigid.from_quaternion((np.cos(0.06), 0.0, np.sin(0.06), 0.0), (0.0, 0.0, 1.9)),
                   Motion((8.0, 1.0, 0.0), 0.3, 0.1))  # fmt: skip
    depth, _ = opaque_depth(SCENE.snapshot(0.0), rays_of(scan), few.max_range_m)
    fired = few.fired
    assert fired is not None
    expected = np.where(fired, depth.reshape(scan.depth_m.shape), np.inf)
    both = np.isfinite(expected) & np.isfinite(scan.depth_m)
    assert (np.isfinite(expected) != np.isfinite(scan.depth_m)).mean() < 2e-3
    assert both.sum() > 500
    assert np.quantile(np.abs(expected[both] - scan.depth_m[both]) / expected[both], 0.999) < 1e-4


def test_nothing_is_seen_outside_of_the_field() -> None:
    """Nor does fog return light there; the truth calls cells UNKNOWN where no part of a car reaches into the field."""
    model = drawn(FAMILIES["dev_front_70_95"]).model
    fog = swept(model, "dense_fog")
    assert np.abs(np.arctan2(fog.points[:, 1], fog.points[:, 0])).max() < np.deg2rad(50)
    world = Scene(boxes=(Box(-10.0, 0.0, 2.0, 8.0, 3.0), Box(12.0, 5.0, 2.0, 2.0, 2.0))).world()
    scan = cast_world(world.snapshot(0.0), model, POSE)
    truth, known = exact_truth(scan, world, GRIDS["road"])
    range_m, azimuth = polar_of_cells(GRIDS["road"])
    outside = known & (np.abs(azimuth) > np.deg2rad(60)) & (range_m > 8.0)
    assert (truth.state["car"][outside] == CellState.UNKNOWN).all()
    assert (truth.expected_returns["car"][outside] == 0).all()
    assert truth.visible()[~outside].sum() > 500
