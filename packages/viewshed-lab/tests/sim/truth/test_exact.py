"""Exact truth against sums over every beam, and against cases counted by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import CAR, PEDESTRIAN, BevGrid, CellState, Target
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.sensors import LidarModel
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import STILL, ExactScan, Motion
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.truth.count import BELOW_GROUND_M
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.sim.world import Agent, Thing, World

FAST = Motion((6.0, -3.0, 0.4), 0.5, 0.1)
HILLS = Terrain.of(
    np.linspace(-60, 60, 41),
    np.linspace(-50, 70, 41),
    lambda x, y: 0.6 * np.sin(x / 9) + 0.04 * y + 0.3 * np.cos(y / 7),
)
BOXES = (
    Thing("wall", (Box(0, 0, 0.6, 14, 4),), 11, 4, 0.2), Thing("car", (Box(0, 0, 4.2, 1.8, 1.5),), -7, 5, 0.7),
    Thing("sign", (Box(0, 0, 0.1, 1.2, 3.0, bottom_m=2.0),), 4, -6, 1.0),
    Thing("curtain", (Box(0, 0, 0.4, 8, 2, material="hedge"),), -3, -12, 1.4),
)  # fmt: skip
WORLD = World("test", HILLS, BOXES)


def _model(columns: int, rings: int, spread_deg: float = 0.0) -> LidarModel:
    rng = np.random.default_rng(columns)
    return LidarModel(
        "test", np.deg2rad(np.linspace(-28, 9, rings)), columns,
        azimuth_offset=np.deg2rad(rng.uniform(-spread_deg, spread_deg, rings)),
        origin_m=rng.uniform(-0.05, 0.05, rings), max_range_m=40.0,
    )  # fmt: skip


def _pose(tilt_deg: float, height_m: float, yaw: float = 0.8) -> Rigid:
    half = np.deg2rad(tilt_deg) / 2
    tilt = rotation_from_quaternion((np.cos(half), 0.3 * np.sin(half), np.sqrt(0.91) * np.sin(half), 0.0))
    ground = float(HILLS.at(np.array([[1.0, 2.0]]))[0])
    return Rigid(Rigid.from_yaw(yaw).rotation @ tilt, np.array([1.0, 2.0, ground + height_m]))


BUS = Target("bus", 12.0, 2.5, 3.2, 1)
CASES = {
    "still": (_model(720, 24), _pose(0, 1.8), STILL),
    "moving, offsets": (_model(541, 16, 6.0), _pose(2, 1.8), FAST),
    "mast, tilted": (_model(360, 40), _pose(20, 6.0), STILL),
    "tilted on its side": (_model(400, 16, 2.0), _pose(75, 3.0), FAST),
    "few columns": (_model(20, 12), _pose(0, 1.2), STILL),
}


def _scan(name: str) -> ExactScan:
    model, pose, motion = CASES[name]
    return cast_world(WORLD.snapshot(0.0), model, pose, motion, seed=5)


def _by_hand(scan: ExactScan, grid: BevGrid, target: Target, slack_m: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Aimed and reached beams of every cell in double precision, each limit moved outwards by ``slack_m``."""
    pose = scan.world_from_sensor
    place, turn = pose.translation, Rigid.from_yaw(pose.yaw).rotation
    start = scan.origin_m.reshape(-1, 3).astype(np.float64)
    way = scan.direction.reshape(-1, 3).astype(np.float64)
    stop = np.minimum(scan.depth_m.reshape(-1).astype(np.float64), scan.model.max_range_m)
    counts = np.zeros((2, *grid.shape), int)
    for cell in np.ndindex(grid.shape):
        center = turn[:2, :2] @ grid.centers[cell]
        r = np.hypot(*center)
        normal = np.append(center / r, 0.0)
        across = np.array([-normal[1], normal[0], 0.0])
        ground = float(HILLS.at((place[:2] + center)[None])[0]) - place[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (r - start @ normal) / (way @ normal)
            point = start + way * depth[:, None]
            aimed = (way @ normal > 0) & (depth > 0) & (np.abs(point @ across) <= target.width_m / 2 + slack_m)
            aimed &= (point[:, 2] >= ground - BELOW_GROUND_M - slack_m) & (
                point[:, 2] <= ground + target.height_m + slack_m
            )
            reached = aimed & ((start + way * stop[:, None]) @ normal >= r - grid.cell_m - slack_m)
        counts[0][cell], counts[1][cell] = aimed.sum(), reached.sum()
    return counts[0], counts[1]


@pytest.mark.parametrize(
    ("name", "target"), list(zip(CASES, (CAR, PEDESTRIAN, BUS, PEDESTRIAN, CAR), strict=True)), ids=list(CASES)
)
def test_counts_are_those_of_every_beam_tested_by_itself(name: str, target: Target) -> None:
    scan = _scan(name)
    grid = BevGrid(26, 32.0, (3.0, -2.0))
    truth, _ = exact_truth(scan, WORLD, grid, (PEDESTRIAN, target))
    found = truth.expected_returns[target.name].astype(int)
    low, high = (np.minimum(_by_hand(scan, grid, target, slack)[1], 255) for slack in (-2e-4, 2e-4))
    far = np.hypot(*np.moveaxis(grid.centers, -1, 0)) > 1.0
    assert (found >= low)[far].all()
    assert (found <= high)[far].all()
    assert (low == high).mean() > 0.9
    assert 0 < (found > 0).mean() < 1


FLAT = Terrain.plane(60.0)
EVEN = LidarModel("even", np.deg2rad(np.arange(-20.0, 1.0)), azimuth_columns=720, max_range_m=50.0)
ROAD = BevGrid(120, 30.0)


def _look(world: World, grid: BevGrid = ROAD, yaw: float = 0.0) -> ExactScan:
    return cast_world(world.snapshot(0.0), EVEN, Rigid.from_yaw(yaw, (0.0, 0.0, 2.0)))


def _at(array: NDArray[Any], x: float, y: float, grid: BevGrid = ROAD) -> Any:
    return array[tuple(grid.index(np.array([x, y]))[0])]


def test_states_of_cells_before_on_and_behind_a_wall_and_out_of_range() -> None:
    wall = World("wall", FLAT, (Thing("wall", (Box(0, 0, 1.0, 8, 3),), 12.0, 4.0),))
    truth, _ = exact_truth(_look(wall), wall, BevGrid(220, 55.0))
    grid = truth.grid
    names = {
        name: CellState(_at(truth.state["car"], *xy, grid)).name
        for name, xy in {
            "before": (8.0, 3.0), "on": (11.6, 2.0), "behind": (16.0, 3.0), "aside": (16.0, -12.0), "far": (-54.0, 0.1),
            "below the rings": (0.6, 0.6),
        }.items()
    }  # fmt: skip
    assert names == {
        "before": "FREE", "on": "SURFACE", "behind": "HIDDEN", "aside": "FREE", "far": "UNKNOWN",
        "below the rings": "UNKNOWN",
    }  # fmt: skip
    assert _at(truth.state["car"], 16.0, -3.0, grid) == CellState.FREE


def test_other_definitions_by_hand() -> None:
    """A wall 1 m high at x = 12 in front, glass at y = 6 on the left, a roof at 3 m on the right, nothing behind."""
    things = (
        Thing("low", (Box(0, 0, 0.5, 8, 1.0),), 12.0, 0.0),
        Thing("pane", (Box(0, 0, 8, 1.0, 4, material="absorber"),), 0, 6.5),
        Thing("roof", (Box(0, 0, 1.0, 6, 3.2, bottom_m=3.0),), 0.0, -8.0),
    )  # fmt: skip
    world = World("made", FLAT, things)
    truth, _ = exact_truth(_look(world), world, ROAD)
    masks = truth.definitions
    ahead, far_left, left = (20.0, 0.5), (0.3, 10.0), (0.3, 5.0)
    assert [_at(masks[name], *ahead) for name in ("farthest", "first_blocker", "line_of_sight")] == [True, False, True]
    assert [_at(masks[name], *far_left) for name in ("farthest", "first_blocker", "line_of_sight")] == [False] * 3
    assert [_at(masks[name], *left) for name in ("farthest", "first_blocker", "line_of_sight")] == [True, True, True]
    assert [_at(masks[name], 0.3, -20.0) for name in ("farthest", "line_of_sight")] == [True, True]
    assert _at(masks["first_blocker"], 11.8, 0.5)


def test_gaps_between_rings_do_not_block_a_line_of_sight() -> None:
    sparse = LidarModel("sparse", np.deg2rad([-15.0, 2.0]), azimuth_columns=720, max_range_m=50.0)
    scan = cast_world(World("flat", FLAT).snapshot(0.0), sparse, Rigid.from_yaw(0.0, (0.0, 0.0, 2.0)))
    truth, _ = exact_truth(scan, FLAT, ROAD)
    assert _at(truth.expected_returns["car"], 20.0, 0.3) == 0
    assert _at(truth.state["car"], 20.0, 0.3) == CellState.UNKNOWN
    assert _at(truth.definitions["line_of_sight"], 20.0, 0.3)


def test_the_own_vehicle_is_not_known_and_blocks_no_bin() -> None:
    """Hood ahead of a sensor that sits 0.5 m behind the middle of its car, which heads along 0.6 rad."""
    car = Thing("car", (Box(0, 0, 4.4, 1.8, 1.3), Box(-0.4, 0, 2.0, 1.6, 1.4, bottom_m=1.3)), 3.0, -2.0, 0.6)
    world = World("own", FLAT, (BOXES[0], car))
    agent = Agent("a", "even", Rigid.from_yaw(0.0, (-0.5, 0.0, 1.9)), carrier=1)
    scan = cast_world(world.snapshot(0.0), EVEN, world.world_from_sensor(agent, 0.0))
    truth, known = exact_truth(scan, world, ROAD, agent=agent)
    away = np.abs(ROAD.centers - [0.5, 0.0])
    np.testing.assert_array_equal(known, ~((away[..., 0] <= 2.2 + 0.25) & (away[..., 1] <= 0.9 + 0.25)))
    strangers, _ = exact_truth(scan, world, ROAD)
    first = [one.definitions["first_blocker"] for one in (truth, strangers)]
    assert [bool(_at(mask, 7.0, 0.3)) for mask in first] == [True, False]
    np.testing.assert_array_equal(truth.expected_returns["car"], strangers.expected_returns["car"])


def test_beyond_the_terrain_and_where_the_sensor_drives_nothing_is_known() -> None:
    scan = _scan("moving, offsets")
    grid = BevGrid(100, 100.0)
    _, known = exact_truth(scan, HILLS, grid)
    place = Rigid.from_yaw(0.8, (1.0, 2.0, 0.0)) @ np.concatenate([grid.centers, np.zeros((100, 100, 1))], axis=-1)
    inside = (np.abs(place[..., 0]) <= 60) & (place[..., 1] >= -50) & (place[..., 1] <= 70)
    np.testing.assert_array_equal(known, inside)
    _, near = exact_truth(scan, HILLS, BevGrid(40, 1.0))
    moved = np.hypot(scan.origin_m[..., 0], scan.origin_m[..., 1]).max()
    assert moved > 0.2
    np.testing.assert_array_equal(near, np.hypot(*np.moveaxis(BevGrid(40, 1.0).centers, -1, 0)) > moved)


def test_order_and_number_of_targets_do_not_matter() -> None:
    scan = _scan("still")
    other = replace(CAR, name="van", width_m=2.1, height_m=2.4)
    three, _ = exact_truth(scan, WORLD, BevGrid(40, 20.0), (PEDESTRIAN, other, CAR))
    for target in (CAR, PEDESTRIAN, other):
        alone, _ = exact_truth(scan, WORLD, BevGrid(40, 20.0), (target,))
        np.testing.assert_array_equal(alone.expected_returns[target.name], three.expected_returns[target.name])
        np.testing.assert_array_equal(alone.state[target.name], three.state[target.name])
    with pytest.raises(ValueError, match="targets must be at least one, got none"):
        exact_truth(scan, WORLD, BevGrid(40, 20.0), ())
