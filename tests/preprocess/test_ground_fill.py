"""Ground where few returns lie on it: banks, crests, valleys and steps of known height, and simulated frames."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import GRIDS, Sweep
from viewshed.datasets.presets import preset_named
from viewshed.datasets.simulated import ScenePlan, simulate_frame, world_of
from viewshed.preprocess.leveling import LeveledSweep, level

ROAD = GRIDS["road"]
HEIGHT_M = 1.8
Relief = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


def rings(relief: Relief, first: int = 0) -> NDArray[np.float32]:
    """Returns of 32 rings (1.33° apart, as an HDL-32E's) where they first meet ``relief``; the sensor is at 0."""
    azimuth = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    slopes = np.tan(np.deg2rad(-30.67 + 1.333 * np.arange(first, 23)))
    steps = np.arange(2.0, 63.0, 0.05)
    found = []
    for slope in slopes:
        x, y = np.cos(azimuth)[:, None] * steps, np.sin(azimuth)[:, None] * steps
        below = slope * steps + HEIGHT_M <= relief(x, y)
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


def test_a_bank_that_rises_is_climbed() -> None:
    relief = _bank(1.5)
    xy = np.array([[x, y] for x in (-6.0, 0.0, 9.0) for y in (5.0, 10.0, 14.0, 16.0, 18.0)])
    assert np.abs(errors(level_points(rings(relief)), relief, xy)).max() < 0.15


def test_a_valley_between_rings_is_interpolated() -> None:
    def relief(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return 0.0006 * x**2 - 0.015 * y

    xy = np.array([[x, y] for x in (-39.0, -30.0, 12.0, 33.0, 36.0) for y in (-20.0, 0.0, 9.0)])
    assert np.abs(errors(level_points(rings(relief)), relief, xy)).max() < 0.15


def test_beyond_a_crest_the_ground_goes_on_without_a_jump() -> None:
    def relief(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(x < 20, 0.03 * x, 0.6 - 0.05 * (x - 20)) + 0.0 * y

    leveled = level_points(rings(relief))
    assert np.abs(errors(leveled, relief, np.array([[10.0, 3.0], [18.0, -5.0], [-20.0, 4.0]]))).max() < 0.12
    hidden = leveled.ground.at(np.array([[x, 2.0] for x in np.arange(22.0, 60.0, 2.0)]))
    assert (hidden < 0.03 * np.arange(22.0, 60.0, 2.0) + 0.3).all()
    assert np.abs(np.diff(hidden)).max() < 0.15


def test_a_step_of_a_curb_is_kept_within_its_height() -> None:
    def relief(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(y > 5.0, 0.16, 0.0) + 0.0 * x

    leveled = level_points(rings(relief))
    xy = np.array([[0.0, 2.0], [6.0, 1.0], [-9.0, 2.0], [0.0, 8.0], [6.0, 9.0], [-9.0, 8.5]])
    assert np.abs(errors(leveled, relief, xy)).max() < 0.06


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


def test_the_order_of_points_does_not_matter() -> None:
    points = rings(_bank(-2.0))
    mixed = np.random.default_rng(4).permutation(points)
    assert np.array_equal(level_points(points).ground.heights_m, level_points(mixed).ground.heights_m)


def test_the_solver_finds_the_minimum() -> None:
    cells = 6
    bands = _coarse_stiffness(cells)
    full = np.zeros((cells**2, cells**2))
    for k in range(2 * cells + 1):
        index = np.arange(cells**2 - k)
        full[index, index + k] = full[index + k, index] = bands[: cells**2 - k, k]
    rng = np.random.default_rng(3)
    weight = (rng.random((cells, cells)) * (rng.random((cells, cells)) < 0.4)).astype(np.float32)
    target = rng.normal(size=(cells, cells)).astype(np.float32)
    found = np.zeros((cells, cells), np.float32)
    _solve(bands, weight, target, found)
    expected = np.linalg.solve(full + np.diag(weight.ravel()), (weight * target).ravel())
    assert np.allclose(found.ravel(), expected, atol=1e-4)


def test_a_plane_costs_only_its_slope_and_is_kept_without_low_points() -> None:
    cells = 8
    bands = _coarse_stiffness(cells)
    i, j = np.mgrid[:cells, :cells].astype(np.float64)
    ramp = (2.0 * i - 3.0 * j).ravel()
    energy = bands[:, 0] @ ramp**2
    for k in range(1, 2 * cells + 1):
        energy += 2 * bands[: cells**2 - k, k] @ (ramp[k:] * ramp[:-k])
    assert energy == pytest.approx(0.01 * (2.0**2 + 3.0**2) * cells * (cells - 1) + 1e-5 * (ramp @ ramp), rel=1e-3)
    nothing = np.full((16, 16, 3), np.inf, np.float32)
    plane = np.array([0.05, -0.02, -1.6], np.float32)
    middles = (np.arange(16) + 0.5) * 4.0 - 32.0
    x, y = np.meshgrid(middles, middles, indexing="ij")
    exact = (0.05 * x - 0.02 * y - 1.6).astype(np.float32)
    heights, seen = smooth_ground(nothing, np.zeros((16, 16), np.float32), exact, seen_none(), plane, 32.0)
    assert np.allclose(heights, exact, atol=1e-4)
    assert not seen.any()


def seen_none() -> NDArray[np.bool_]:
    return np.zeros((16, 16), np.bool_)


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
        assert pose is not None
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
