from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.preprocess.test_unseen_ground import Relief, rings

from viewshed import GRIDS, Rigid, Sweep
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.geometry import quaternion_from_rotation
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sensors import LidarModel
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import ScenePlan, simulate_frame
from viewshed_lab.sim import Box, Scene, cast

ROAD = GRIDS["road"]
DENSE = LidarModel("dense", np.deg2rad(np.linspace(-25, 3, 64)), azimuth_columns=900, max_range_m=120.0)


def _cast(scene: Scene, height_m: float = 1.8) -> NDArray[np.float32]:
    return cast(DENSE, scene, height_m, rng=np.random.default_rng(1)).points


def _level(points: NDArray[np.float32]) -> LeveledSweep:
    return level(Sweep(points), ROAD)


WALLS = (Box(12, 3, 0.5, 18, 6), Box(-5, -9, 40, 1, 4), Box(20, -6, 4.2, 1.8, 1.5), Box(8, 6, 4.2, 1.8, 1.5, yaw=0.4))


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.05, -0.03), (-0.1, 0.08)])
def test_ground_of_a_sloping_street_among_walls(slope: tuple[float, float]) -> None:
    leveled = level(Sweep(_cast(Scene(WALLS, slope=slope)), attitude=np.array([1.0, 0, 0, 0])), ROAD)
    near = np.array([[6.0, -3.0], [10.0, -6.0], [-8.0, 5.0], [-15.0, 10.0], [25.0, 15.0], [-30.0, 20.0]])
    off_m = np.abs(level_heights(leveled, near) - near @ np.array(slope))
    # Beyond the walls no return shows it.
    std_m, seen = at_points(leveled, leveled.ground.std_m, near), at_points(leveled, leveled.ground.seen, near) > 0.5
    assert off_m[seen].max() < 0.05
    assert (off_m[~seen] < 0.05 + 2 * std_m[~seen]).all()
    assert leveled.sensor_height_m == pytest.approx(1.8, abs=0.06)


def level_heights(leveled: LeveledSweep, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ground z (M,) at level points, in a frame whose z = 0 is the true ground below the sensor."""
    return leveled.ground.at(xy).astype(np.float64) + 1.8 - leveled.sensor_height_m


def at_points(leveled: LeveledSweep, values: NDArray[Any], xy: NDArray[np.float64]) -> NDArray[np.float32]:
    """Values (n, n) of the ground's lattice at level points (M,)."""
    return replace(leveled.ground, heights_m=values.astype(np.float32)).at(xy)


def test_parked_vans_are_no_ground() -> None:
    vans = tuple(Box(x, 5.0, 5.5, 2.2, 2.3, bottom_m=0.25) for x in (6.0, 12.0, 18.0, 24.0))
    leveled = _level(_cast(Scene(vans)))
    under = np.array([[6.0, 5.0], [12.0, 5.0], [18.0, 5.0]])
    assert np.abs(level_heights(leveled, under)).max() < 0.2


def test_a_ceiling_is_no_ground_where_furniture_hides_the_floor() -> None:
    dome = LidarModel("dome", np.deg2rad(np.linspace(-30, 45, 64)), azimuth_columns=900, max_range_m=40.0)
    walls = (Box(13, 1, 0.3, 16, 2.7), Box(-9, 1, 0.3, 16, 2.7), Box(2, 9, 22, 0.3, 2.7), Box(2, -7, 22, 0.3, 2.7))
    ceiling, cupboard, table = Box(2, 1, 22, 16, 3.0, bottom_m=2.7), Box(4, 1, 0.6, 10, 0.9), Box(-3, 4, 2, 1, 0.8)
    points = cast(dome, Scene((*walls, ceiling, cupboard, table)), 0.5, rng=np.random.default_rng(1)).points
    leveled = level(Sweep(points), GRIDS["indoor"])
    assert leveled.sensor_height_m == pytest.approx(0.5, abs=0.05)
    assert np.abs(leveled.ground.heights_m).max() < 0.3


def test_a_deck_is_no_ground_where_lorries_hide_the_road_below_it() -> None:
    steep = LidarModel("steep", np.deg2rad(np.linspace(-25, 15, 128)), azimuth_columns=900, max_range_m=120.0)
    lorries = tuple(Box(12.0, y, 9.0, 2.9, 3.0) for y in (-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0))
    deck, end = Box(32, 0, 50, 40, 6.0, bottom_m=5.0), Box(57, 0, 0.5, 40, 5.0)
    leveled = _level(cast(steep, Scene((deck, end, *lorries)), 1.8, rng=np.random.default_rng(1)).points)
    assert leveled.sensor_height_m == pytest.approx(1.8, abs=0.05)
    assert np.abs(leveled.ground.heights_m).max() < 0.3


@pytest.mark.parametrize(("up_m", "is_seen"), [(0.7, True), (1.3, False), (2.5, False)])
def test_a_level_a_step_higher_is_seen_ground_and_one_more_than_a_meter_higher_is_a_guess(
    up_m: float, is_seen: bool
) -> None:
    rng = np.random.default_rng(4)
    xy = rng.uniform(-50, 50, (60_000, 2))
    z = np.where(xy[:, 0] > 10.0, up_m, 0.0) - 1.8 + rng.normal(0, 0.02, len(xy))
    leveled = _level(np.column_stack([xy, z]).astype(np.float32))
    higher = np.array([[14.0, 0.0], [25.0, -5.0], [35.0, 8.0]])
    assert np.allclose(at_points(leveled, leveled.ground.seen, higher), float(is_seen))
    if is_seen:
        assert np.allclose(level_heights(leveled, higher), up_m, atol=0.1)


@pytest.mark.parametrize("pitch_deg", [15.0, 28.0])
def test_a_tilted_roadside_sensor_is_leveled_without_an_attitude(pitch_deg: float) -> None:
    level_from_sensor = Rigid(_pitch(np.deg2rad(pitch_deg)), np.zeros(3))
    model = LidarModel("down", np.deg2rad(np.linspace(-45, 10, 64)), azimuth_columns=900)
    scene = Scene((Box(18, 4, 4.2, 1.8, 1.5), Box(25, -8, 10, 1, 4)))
    sweep = cast(model, scene, 6.0, quaternion_from_rotation(level_from_sensor.rotation))
    leveled = _level(sweep.points)
    assert leveled.sensor_height_m == pytest.approx(6.0, abs=0.25)
    up = leveled.level_from_sensor.rotation[2]
    assert np.rad2deg(np.arccos(up @ level_from_sensor.rotation[2])) < 1.5
    known = level(sweep, ROAD)
    assert np.allclose(known.level_from_sensor.rotation, level_from_sensor.rotation, atol=1e-6)


def _pitch(angle: float) -> NDArray[np.float64]:
    """Nose down by ``angle``."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def test_level_columns_are_those_of_the_points() -> None:
    leveled = _level(_cast(Scene(WALLS, slope=(0.03, 0.02))))
    x, y, z = leveled.points.astype(np.float64).T
    assert np.allclose(leveled.range_m, np.hypot(x, y), atol=1e-4)
    assert np.allclose(leveled.azimuth, np.arctan2(y, x), atol=2e-5)
    assert (leveled.azimuth >= -np.pi).all()
    assert (leveled.azimuth < np.pi).all()
    inside = np.maximum(np.abs(x), np.abs(y)) < 62
    assert np.allclose(leveled.height_m[inside], (z - leveled.ground.at(leveled.points))[inside], atol=1e-3)


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_a_few_points_give_flat_ground(count: int) -> None:
    points = np.array([[5.0, 2.0, -1.0]] * count, np.float32).reshape(-1, 3)
    leveled = level(Sweep(points, sensor_height_m=1.5), ROAD)
    assert (leveled.sensor_height_m, leveled.ground.support) == (1.5, 0.0)
    assert not leveled.ground.seen.any()
    assert np.allclose(leveled.ground.heights_m, 0.0)
    assert _level(points).sensor_height_m == pytest.approx(1.8)


def relief_errors(leveled: LeveledSweep, relief: Relief, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    return level_heights(leveled, xy) - relief(xy[:, 0], xy[:, 1])


@pytest.mark.parametrize(("width_m", "fall_m"), [(9.0, 4.0), (9.0, 3.0), (12.0, 2.0), (9.0, 2.0)])
def test_on_an_embankment_the_road_carries_the_sensor_and_not_the_fields_below(width_m: float, fall_m: float) -> None:
    """A road, banks at 45°, and fields on both sides that return as well."""

    def relief(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return -np.clip(np.abs(y - 0.5) - width_m / 2, 0.0, fall_m) + 0.0 * x

    points = rings(relief)
    assert (np.abs(points[:, 1] - 0.5) > width_m / 2 + fall_m).mean() > 0.1
    leveled = _level(points)
    assert leveled.sensor_height_m == pytest.approx(1.8, abs=0.1)
    road = np.array([[x, y] for x in (-20.0, -9.0, 4.0, 15.0) for y in (-2.0, 0.0, 2.5)])
    assert np.abs(relief_errors(leveled, relief, road)).max() < 0.2


def test_the_faces_of_a_cutting_are_climbed() -> None:
    """A road 12 m wide between faces at 40° that rise 4 m."""

    def relief(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.clip(0.84 * (np.abs(y) - 6.0), 0.0, 4.0) + 0.0 * x

    leveled = _level(rings(relief, np.linspace(-25, 15, 64)))
    assert leveled.sensor_height_m == pytest.approx(1.8, abs=0.06)
    face = np.array([[x, side * y] for x in (-6.0, 0.0, 5.0) for y in (7.5, 8.5, 9.5) for side in (-1.0, 1.0)])
    assert np.abs(relief_errors(leveled, relief, face)).max() < 0.3
    assert np.abs(relief_errors(leveled, relief, face * [1.0, 0.3])).max() < 0.1


@pytest.mark.parametrize(
    ("preset", "scene", "azimuth", "raised_m"),
    [
        ("nuscenes", 0, 0.8, -1.5), ("nuscenes", 3, -2.0, -1.5),
        # The road ahead is the farthest ground that is seen: what lies beside it must not follow.
        ("nuscenes", 1, 0.0, -0.8), ("carla", 5, np.pi, -0.8), ("nuscenes", 0, 0.0, 1.5),
    ],
)  # fmt: skip
def test_a_wedge_of_moved_returns_leaves_the_ground_and_the_view_of_the_rest(
    preset: str, scene: int, azimuth: float, raised_m: float
) -> None:
    sweep = simulate_frame(ScenePlan(preset_named(preset), 0, scene), 3).sweep
    away = np.abs(np.angle(np.exp(1j * (np.arctan2(sweep.points[:, 1], sweep.points[:, 0]) - azimuth))))
    wedge = np.argsort(away)[:652]
    points = sweep.points.copy()
    points[wedge, 2] += raised_m
    clear, poisoned = level(sweep, ROAD), level(sweep.replace(points=points), ROAD)
    x, y = ROAD.centers[..., 0], ROAD.centers[..., 1]
    apart = np.abs(np.angle(np.exp(1j * (np.arctan2(y, x) - azimuth))))
    # As far as a car beside the wedge reaches into it.
    rest = apart - np.arctan2(0.9, np.hypot(x, y)) > away[wedge].max() + np.deg2rad(3.0)
    assert rest.mean() > 0.8
    before, after = (ShadowMap(ROAD).estimate(leveled).visible() for leveled in (clear, poisoned))
    # Unseen ground, and beams without a return, are guessed from what lies around them: a part of the rest changes.
    assert (after & before & rest).sum() / (before & rest).sum() > 0.96
    assert (after & ~before & rest).sum() / (before & rest).sum() < 0.015
    nodes_m = np.arange(128) - 63.5
    node_x, node_y = np.meshgrid(nodes_m, nodes_m, indexing="ij")
    node_apart = np.abs(np.angle(np.exp(1j * (np.arctan2(node_y, node_x) - azimuth))))
    beside = (node_apart - np.arctan2(2.0, np.hypot(node_x, node_y)) > away[wedge].max()) & clear.ground.seen
    # Few returns beside it are no longer taken for ground, and the others show what they showed.
    assert (beside & poisoned.ground.seen).sum() > 0.95 * beside.sum()
    beside &= poisoned.ground.seen
    moved_m = np.abs(poisoned.ground.heights_m - clear.ground.heights_m)[beside]
    assert np.quantile(moved_m, 0.995) < 0.05
