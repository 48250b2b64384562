"""Truth where the ground is not one plane: a pit, an edge, a bridge, glass; counted beam by beam by brute force.

The oracle takes its depths from ``tests.sim.oracle``, the ground from a formula, and counts in double precision.
"""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.sim.oracle import opaque_depth, rays_of, solid_interval

from viewshed import CAR, PEDESTRIAN, BevGrid, CellState, Target
from viewshed.arrays import F64
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.truth.count import BELOW_GROUND_M
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.sim.world import DECK, Agent, Thing, World

Ground = Callable[[F64, F64], F64]

MODEL = LidarModel("even", np.deg2rad(np.arange(-25.0, 4.0, 1.25)), azimuth_columns=480, max_range_m=60.0)
GRID = BevGrid(60, 30.0)
FACE_M = 0.01


def reached(scan: ExactScan, depth: F64, ground: Ground, target: Target, cell: tuple[int, int]) -> tuple[int, int]:
    """Return least and most beams that reach a target in a cell, each limit moved by 0.2 mm inwards and outwards.

    Beams and ``ground`` are in the world, cells along the sensor's heading.
    """
    place, turned = scan.world_from_sensor.translation, Rigid.from_yaw(scan.world_from_sensor.yaw).rotation[:2, :2]
    start, way, _ = rays_of(scan)
    center = turned @ GRID.centers[cell]
    r = np.hypot(*center)
    normal, across = np.append(center / r, 0.0), np.array([-center[1] / r, center[0] / r, 0.0])
    z = float(ground(*(place[:2] + center)))
    with np.errstate(divide="ignore", invalid="ignore"):
        point = start + way * (r / (way @ normal))[:, None]
    stop = np.minimum(depth, scan.model.max_range_m) * (way @ normal)
    low, high = (
        int(
            (
                (way @ normal > 0)
                & (np.abs((point - place) @ across) <= target.width_m / 2 + slack)
                & (point[:, 2] >= z - BELOW_GROUND_M - slack)
                & (point[:, 2] <= z + target.height_m + slack)
                & (stop >= r - GRID.cell_m - slack)
            ).sum()
        )
        for slack in (-2e-4, 2e-4)
    )
    return min(low, 255), min(high, 255)


def agrees(world: World, scan: ExactScan, depth: F64, ground: Ground, agent: Agent | None = None) -> float:
    """Check every third cell against the oracle for both targets; return the share of cells it is sure of."""
    truth, _ = exact_truth(scan, world, GRID, agent=agent)
    sure, cells = 0, 0
    for cell in np.ndindex(GRID.shape):
        if (cell[0] + 2 * cell[1]) % 3 or np.hypot(*GRID.centers[cell]) < 1.5:
            continue
        for target in (CAR, PEDESTRIAN):
            low, high = reached(scan, depth, ground, target, cell)
            found = int(truth.expected_returns[target.name][cell])
            assert low <= found <= high, (GRID.centers[cell], target.name, low, found, high)
            sure, cells = sure + (low == high), cells + 1
    return sure / cells


def look(world: World, height_m: float = 2.0, agent: Agent | None = None) -> ExactScan:
    pose = Rigid.from_yaw(0.0, (0.0, 0.0, height_m)) if agent is None else world.world_from_sensor(agent, 0.0)
    return cast_world(world.snapshot(0.0), MODEL, pose, seed=3)


def edged(rect: tuple[float, float, float, float], z_m: float) -> tuple[Ground, Terrain]:
    """Return level ground at 0 with a rectangle at ``z_m``: as a formula, and as a terrain with upright faces."""
    x0, y0, x1, y1 = rect

    def ground(x: F64, y: F64) -> F64:
        return np.where((x > x0) & (x < x1) & (y > y0) & (y < y1), z_m, 0.0)

    xs, ys = ([-90.0, *(at + step for at in pair for step in (-FACE_M, FACE_M)), 90.0] for pair in ((x0, x1), (y0, y1)))
    return ground, Terrain.of(xs, ys, ground)


def at(array: NDArray[np.uint8] | NDArray[np.bool_], x: float, y: float) -> int:
    return int(array[tuple(GRID.index(np.array([x, y]))[0])])


def test_a_target_in_a_pit() -> None:
    """Sensor 2 m up, pit 3 m deep from 8 m ahead: the line over its edge is at the roof of a car (-1.5 m) at 14 m."""
    ground, terrain = edged((8.0, -6.3, 20.2, 6.3), -3.0)
    world = World("pit", terrain)
    scan = look(world)
    depth, _ = opaque_depth(world.snapshot(0.0), rays_of(scan), MODEL.max_range_m)
    assert agrees(world, scan, depth, ground) > 0.9
    truth, _ = exact_truth(scan, world, GRID)
    reached, state = truth.expected_returns["car"], truth.state["car"]
    assert [at(reached, x, 0.5) for x in (9.5, 11.5, 13.5)] == [0, 0, 0]
    assert at(state, 11.5, 0.5) == CellState.HIDDEN
    assert at(state, 19.5, 0.5) == CellState.FREE
    assert at(state, 6.5, 0.5) == at(state, 22.5, 0.5) == CellState.FREE


def test_a_target_below_the_edge_of_an_embankment() -> None:
    """The ground falls by 4 m at y = -5: the line over the edge falls 2 in 5, so a car's roof shows from 11.25 m on."""
    ground, terrain = edged((-89.0, -89.0, 89.0, -5.0), -4.0)
    world = World("edge", terrain, (Thing("rail", (Box(0.0, 0.0, 30.0, 0.1, 0.75, 0.45),), 0.0, -4.0),))
    scan = look(world)
    depth, _ = opaque_depth(world.snapshot(0.0), rays_of(scan), MODEL.max_range_m)
    assert agrees(world, scan, depth, ground) > 0.9
    truth, _ = exact_truth(scan, world, GRID)
    assert [at(truth.expected_returns["car"], 0.5, y) for y in (-6.5, -8.5, -10.5)] == [0, 0, 0]
    assert at(truth.state["car"], 0.5, -20.5) == CellState.FREE


def bridge() -> World:
    """A deck along x, 6 m up and 7 m wide, over a trench of 16 m along y; the road beyond it is at 6 m as well."""
    lines = [-90.0, -8.0 - FACE_M, -8.0 + FACE_M, 8.0 - FACE_M, 8.0 + FACE_M, 90.0]
    across = [-90.0, -3.5 - FACE_M, -3.5, 3.5, 3.5 + FACE_M, 90.0]
    terrain = Terrain.of(lines, across, lower)
    upper = Terrain.of(lines, across, carried)
    deck = Thing(DECK, (Box(0.0, 0.0, 16.0, 7.0, 6.0, 5.2, 0.0, "asphalt"),), z_m=0.0)
    rail = Thing("rail", (Box(0.0, 0.0, 16.0, 0.1, 0.9, 0.4, 0.0, "metal"),), 0.0, 3.3, upper=True)
    box = Box(0.0, 0.0, 1.0, 1.0, 0.4, 0.2)
    cars = (Thing("car", (box,), -3.0, -1.0, 0.0, upper=True), Thing("car", (box,), 2.0, -12.0, np.pi / 2))
    mount = Rigid.from_yaw(0.0, (0.0, 0.0, 1.9))
    return World("bridge", terrain, (*cars, deck, rail), (Agent("up", "x", mount, 0), Agent("down", "x", mount, 1)),
                 upper=upper)  # fmt: skip


def lower(x: F64, y: F64) -> F64:
    return np.where(np.abs(x) < 8.0, 0.0, 6.0) + 0.0 * y


def carried(x: F64, y: F64) -> F64:
    return np.where((np.abs(x) < 8.0) & (np.abs(y) > 3.5), 0.0, 6.0)


@pytest.mark.parametrize(("who", "ground"), [(0, carried), (1, lower)], ids=["on the deck", "below it"])
def test_the_ground_of_a_target_is_the_level_of_the_sensor(who: int, ground: Ground) -> None:
    """On the bridge a target on the deck counts, beside it one in the trench; from below only one in the trench."""
    world = bridge()
    agent = world.agents[who]
    scan = look(world, agent=agent)
    assert scan.world_from_sensor.translation[2] == pytest.approx((7.9, 1.9)[who])
    depth, _ = opaque_depth(world.snapshot(0.0), rays_of(scan), MODEL.max_range_m)
    truth, _ = exact_truth(scan, world, GRID, agent=agent)
    assert agrees(world, scan, depth, ground, agent) > 0.9
    if who == 0:
        assert at(truth.state["car"], 8.0 + 2.5, 1.0) == CellState.FREE  # on the road beyond the deck
        assert at(truth.state["car"], 3.5, -14.5) == CellState.FREE  # 6 m below, past the edge without a rail
        blocked = truth.definitions["first_blocker"]
        assert bool(at(blocked, 5.5, -1.0))  # the deck is ground, it blocks nothing
        assert at(truth.state["car"], 3.5, -1.0) == CellState.FREE
    else:
        assert at(truth.state["car"], 12.5, 0.5) == CellState.FREE  # below the deck
        assert (
            at(truth.state["car"], 5.5, 12.5) == CellState.UNKNOWN
        )  # on the land above the trench: no beam goes up there


def test_a_target_behind_glass_gets_the_beams_that_pass() -> None:
    """A pane of 2 cm at x = 8, a wall at x = 20: beams stop in the pane or where brute force says without it."""
    pane = Thing("pane", (Box(0.0, 0.0, 0.02, 24.0, 3.0, 0.0, 0.0, "glass"),), 8.0, 2.0)
    wall = Thing("wall", (Box(0.0, 0.0, 0.5, 40.0, 4.0),), 20.0, 0.0)
    world = World("glass", Terrain.plane(90.0), (pane, wall))
    scan = look(world)
    rays = rays_of(scan)
    behind, _ = opaque_depth(world.snapshot(0.0), rays, MODEL.max_range_m)
    near, far = solid_interval(world.snapshot(0.0), 0, *rays)
    crossed = (near > 0) & (near < behind)
    got, stopped = scan.depth_m.reshape(-1).astype(np.float64), scan.thing.reshape(-1) == 0
    assert (crossed[stopped]).all()
    assert ((got >= near - 1e-4) & (got <= far + 1e-4))[stopped].all()
    np.testing.assert_allclose(got[~stopped], behind[~stopped], atol=1e-3)
    chance = np.exp(-18.0 * (far - near))[crossed]
    assert (~stopped)[crossed].sum() == pytest.approx(chance.sum(), rel=0.05)
    assert agrees(world, scan, np.where(stopped, got, behind), lambda x, y: 0.0 * x * y) > 0.9
    truth, _ = exact_truth(scan, world, GRID)
    empty = World("wall", Terrain.plane(90.0), (wall,))
    clear, _ = exact_truth(look(empty), empty, GRID)
    through, open_ = at(truth.expected_returns["car"], 12.5, 1.0), at(clear.expected_returns["car"], 12.5, 1.0)
    assert 0.5 * open_ < through < 0.9 * open_
    assert at(truth.state["car"], 12.5, 1.0) == CellState.FREE
    assert at(truth.state["car"], 22.5, 1.0) == CellState.HIDDEN
