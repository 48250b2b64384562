"""Ground where few returns lie on it: banks, crests, valleys and steps of known height, and simulated frames."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import GRIDS, Sweep
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import ScenePlan, simulate_frame, world_of

ROAD = GRIDS["road"]
HEIGHT_M = 1.8
HDL_32E_DEG = -30.67 + 1.333 * np.arange(23)
"""Elevations of those rings of an HDL-32E that look down."""
Relief = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


def rings(relief: Relief, elevation_deg: NDArray[np.floating] = HDL_32E_DEG) -> NDArray[np.float32]:
    """Returns of rings where they first meet ``relief``, if within 63 m; the sensor is at 0."""
    azimuth = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    steps = np.arange(2.0, 63.0, 0.05)
    x, y = np.cos(azimuth)[:, None] * steps, np.sin(azimuth)[:, None] * steps
    ground_m, found = relief(x, y), []
    for slope in np.tan(np.deg2rad(elevation_deg)):
        below = slope * steps + HEIGHT_M <= ground_m
        rows = np.nonzero(below.any(axis=1))[0]
        k = below[rows].argmax(axis=1)
        found.append(np.stack([x[rows, k], y[rows, k], slope * steps[k]], axis=1))
    noise = np.random.default_rng(8).normal(0, 0.01, sum(map(len, found)))
    points = np.concatenate(found)
    points[:, 2] += noise
    return points.astype(np.float32)


def level_points(points: NDArray[np.float32]) -> LeveledSweep:
    return level(Sweep(points, sensor_height_m=HEIGHT_M, attitude=np.array([1.0, 0, 0, 0])), ROAD)


def errors(leveled: LeveledSweep, relief: Relief, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    return leveled.ground.at(xy).astype(np.float64) - relief(xy[:, 0], xy[:, 1])


def _bank(rise_m: float) -> Relief:
    """Level to 12 m left, then a bank 7 m wide, then level land ``rise_m`` higher; a gentle slope to the right."""
    return lambda x, y: rise_m * np.clip((y - 12.0) / 7.0, 0.0, 1.0) + 0.01 * np.minimum(y, 0.0) + 0.0 * x


def test_land_below_a_bank_is_followed_and_the_road_is_not_drawn_down_to_it() -> None:
    relief = _bank(-2.0)
    leveled = level_points(rings(relief))
    beyond = np.array([[0.0, 24.0], [8.0, 24.0], [-12.0, 26.0], [5.0, 30.0]])
    assert np.abs(errors(leveled, relief, beyond)).max() < 0.35
    road = np.array([[x, y] for x in (-15.0, 0.0, 15.0) for y in (-8.0, 0.0, 6.0)])
    assert np.abs(errors(leveled, relief, road)).max() < 0.12


@pytest.mark.parametrize("fall_m", [2.3, 3.2])
def test_land_far_below_a_bank_is_believed_where_its_returns_agree(fall_m: float) -> None:
    def relief(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return -fall_m * np.clip((y - 8.0) / 7.0, 0.0, 1.0) + 0.0 * x

    beyond = np.array([[0.0, 24.0], [8.0, 24.0], [-12.0, 26.0], [5.0, 30.0]])
    assert np.abs(errors(level_points(rings(relief)), relief, beyond)).max() < 0.15


@pytest.mark.parametrize(("x", "y"), [(12.0, 3.0), (25.0, -10.0)])
@pytest.mark.parametrize("deep_m", [2.5, 4.0])
def test_a_reflection_below_the_road_is_not_believed_though_its_returns_agree(
    x: float, y: float, deep_m: float
) -> None:
    rng = np.random.default_rng(3)
    around = rng.uniform((x, y), (x + 6, y + 6), (200, 2))
    mirrored = np.column_stack([around, rng.normal(-HEIGHT_M - deep_m, 0.02, 200)]).astype(np.float32)

    def flat(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return 0.0 * x

    leveled = level_points(np.concatenate([rings(flat), mirrored]))
    assert np.abs(errors(leveled, flat, np.array([[x + 1, y + 1], [x + 3, y + 3], [x + 5, y + 5]]))).max() < 0.1


def test_cars_that_one_ring_meets_far_away_do_not_raise_the_ground() -> None:
    def relief(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return 0.0 * x + 0.004 * y

    rng = np.random.default_rng(5)
    middles = np.array([[x, y] for x in np.arange(28.0, 56.0, 6.0) for y in (-14.0, -4.0, 6.0, 16.0)])
    ends = np.repeat(middles, 40, axis=0) + rng.uniform(-1, 1, (len(middles) * 40, 2)) * [0.1, 0.9]
    hoods = np.column_stack([ends, relief(ends[:, 0], ends[:, 1]) + rng.uniform(0.45, 0.6, len(ends)) - HEIGHT_M])
    points = np.concatenate([rings(relief), hoods.astype(np.float32)])
    xy = np.array([[x, y] for x in np.arange(20.0, 38.0, 3.0) for y in (-15.0, -5.0, 0.0, 9.0)])
    assert np.abs(errors(level_points(points), relief, xy)).max() < 0.25


@pytest.mark.parametrize(("sensor", "far_m"), [("hdl32e", 0.9), ("hdl64e", 0.3)])
def test_the_ground_of_simulated_frames_is_near_the_exact_one(sensor: str, far_m: float) -> None:
    preset = replace(
        preset_named("nuscenes"), sensors=(sensor,), conditions=("clear",), condition_weights=(1.0,), seed=21
    )
    near, far = [], []
    for scene in range(5):
        plan = ScenePlan(preset, 0, scene)
        frame = simulate_frame(plan, 12)
        leveled = level(frame.sweep, ROAD)
        pose = frame.sweep.world_from_sensor
        shown = (frame.known & frame.truth.visible("car")).ravel()
        xy = ROAD.centers.reshape(-1, 2)[shown]
        c, s = np.cos(pose.yaw), np.sin(pose.yaw)
        world = np.stack([c * xy[:, 0] - s * xy[:, 1], s * xy[:, 0] + c * xy[:, 1]], axis=1) + pose.translation[:2]
        exact = world_of(plan).terrain.at(world) - pose.translation[2]
        error = np.abs(leveled.ground.at(xy) - leveled.sensor_height_m - exact)
        range_m = np.hypot(xy[:, 0], xy[:, 1])
        near.append(error[range_m < 30])
        far.append(error[(range_m > 30) & (range_m < 60)])
    assert np.quantile(np.concatenate(near), 0.95) < 0.15
    assert np.quantile(np.concatenate(far), 0.95) < far_m
