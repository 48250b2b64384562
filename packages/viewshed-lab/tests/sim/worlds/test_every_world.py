"""What every outdoor world keeps: plans work, nothing stands in anything else, seeds repeat, casting stays fast."""

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from shapely import STRtree, area, intersection, polygons

from viewshed_lab.sim.assets.shapes import BOX
from viewshed_lab.sim.world import AgentPlan, World
from viewshed_lab.sim.worlds import WORLDS

TOWN = ("street", "junction", "highway", "parking", "residential")
"""Worlds on ground that is nearly flat."""
WILD = (
    "country_road", "open_field", "embankment", "cutting", "bridge", "pit", "quay", "garage", "glass_fronts", "oblique",
    "slope_town", "site",
)  # fmt: skip
ROWS = {"guard_rail", "barrier", "sound_wall"}
LIE_TOGETHER = {
    "guard_rail", "barrier", "fence", "hedge", "wall", "retaining_wall", "parapet", "deck", "bridge", "pole", "ceiling",
    "duct", "pillar", "stop",
}  # fmt: skip
INDOOR = ("rooms", "corridors", "hall", "warehouse", "atrium", "loft", "tunnel")
PLANS = [(5, 5, 60.0), (2, 3, 8.0)]


def made(name: str, seed: int, plan: tuple[int, int, float] = (1, 0, 10.0)) -> World:
    moving, roadside, duration_s = plan
    return WORLDS[name](np.random.default_rng(seed), AgentPlan(moving, roadside, duration_s=duration_s))


def outlines(world: World, t_s: float) -> tuple[NDArray[np.object_], NDArray[np.float64], NDArray[np.int32]]:
    """Return polygons of all solids from above, their lowest and highest z (n, 2), and the things they belong to."""
    snapshot = world.snapshot(t_s)
    turn = np.linspace(0, 2 * np.pi, 13)[:-1]
    square, circle = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]), np.column_stack([np.cos(turn), np.sin(turn)])
    rows = [
        (square if kind == BOX else circle) * half[:2] @ rotation[:2, :2].T + center[:2]
        for kind, center, rotation, half in zip(
            snapshot.kind, snapshot.center_m, snapshot.rotation, snapshot.half_m, strict=True
        )
    ]
    tall = np.abs(snapshot.rotation[:, 2] * snapshot.half_m).sum(axis=1)
    shapes = np.array([polygons(row) for row in rows])
    return shapes, np.stack([snapshot.center_m[:, 2] - tall, snapshot.center_m[:, 2] + tall], axis=1), snapshot.thing


def overlaps(world: World, t_s: float) -> Iterator[tuple[str, str, float, float, float]]:
    """Yield pairs of things whose solids below 2 m share ground and height: kinds, shared area, and where."""
    shapes, z, thing = outlines(world, t_s)
    i, j = STRtree(shapes).query(shapes, predicate="intersects")
    deep = np.minimum(z[i, 1], z[j, 1]) - np.maximum(z[i, 0], z[j, 0])
    ground = world.terrain.at(np.array([[one.centroid.x, one.centroid.y] for one in shapes]))
    overhead = np.maximum(z[i, 0] - ground[i], z[j, 0] - ground[j]) > 2.0
    flat = world.name in TOWN
    rows = (thing[i] < thing[j]) & (deep > (0.0 if flat else 0.03)) & ~overhead
    for a, b in zip(i[rows], j[rows], strict=True):
        kinds = {world.things[thing[a]].kind, world.things[thing[b]].kind}
        joint = kinds <= ROWS and len(kinds) == 1 if flat else kinds <= LIE_TOGETHER
        shared = float(area(intersection(shapes[a], shapes[b])))
        if shared > (0.02 if flat else 0.03) and not joint:
            yield *sorted(kinds), shared, shapes[a].centroid.x, shapes[a].centroid.y


def in_the_way(world: World, times_s: NDArray[np.float64]) -> Iterator[tuple[str, float, str]]:
    """Yield what still solids a carrier's box meets, from 0.45 m above its ground to 1.8 m: agent, time, kind."""
    shapes, z, thing = outlines(world, 0.0)
    still = np.array([world.things[k].track is None for k in thing], np.bool_)
    tree = STRtree(shapes[still])
    square = np.array([[2.3, 0.85], [-2.3, 0.85], [-2.3, -0.85], [2.3, -0.85]])
    for agent in (one for one in world.agents if one.carrier is not None):
        for t_s in times_s.tolist():
            pose = world.pose_of(agent.carrier or 0, t_s)
            near = tree.query(polygons(square @ pose.rotation[:2, :2].T + pose.translation[:2]), predicate="intersects")
            low, high = z[still][near].T - pose.translation[2]
            for k in thing[still][near[(high > 0.45) & (low < 1.8)]]:
                yield agent.name, t_s, world.things[k].kind


@pytest.mark.parametrize("name", TOWN + WILD)
@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_nothing_stands_in_anything_else_at_any_time(name: str, plan: tuple[int, int, float]) -> None:
    found = []
    for seed in range(2):
        world = made(name, seed, plan)
        for t_s in np.linspace(0.0, plan[2], 3):
            found += [(seed, t_s, *pair) for pair in overlaps(world, float(t_s))]
    assert found == []


@pytest.mark.parametrize("name", TOWN + WILD)
def test_every_plan_has_its_agents_on_the_ground_well_inside_the_world(name: str) -> None:
    for moving, roadside, duration_s in ((1, 0, 2.0), (0, 5, 20.0), (5, 5, 60.0)):
        world = made(name, 11, (moving, roadside, duration_s))
        names = [f"vehicle_{k}" for k in range(moving)] + [f"roadside_{k}" for k in range(roadside)]
        assert [agent.name for agent in world.agents] == names
        for agent, t_s in itertools.product(world.agents, (0.0, duration_s / 2, duration_s)):
            x, y, z = world.world_from_sensor(agent, t_s).translation
            lines_x, lines_y = world.terrain.x_m, world.terrain.y_m
            assert min(x - lines_x[0], lines_x[-1] - x) > (59.0 if name in TOWN else 54.0)
            assert min(y - lines_y[0], lines_y[-1] - y) > (55.0 if name in TOWN else 54.0)
            above = z - float(world.ground_of(agent).at([[x, y]])[0])
            lowest = 4.0 if name in TOWN else 1.5
            assert 1.7 < above < 1.95 if agent.carrier is not None else lowest <= above <= 8.0


@pytest.mark.parametrize("name", TOWN + WILD)
def test_a_sensor_is_inside_no_solid(name: str) -> None:
    for seed in range(4):
        world = made(name, seed, (4, 3, 10.0))
        snapshot = world.snapshot(5.0)
        for agent in world.agents:
            away = world.world_from_sensor(agent, 5.0).translation - snapshot.center_m
            local = np.abs(np.einsum("kji,kj->ki", snapshot.rotation, away))
            assert not (local < snapshot.half_m).all(axis=1).any()


@pytest.mark.parametrize("name", TOWN + WILD + INDOOR)
def test_the_same_seed_gives_the_same_world_and_another_seed_another(name: str) -> None:
    one, same, other = (made(name, seed, (2, 2, 5.0)).snapshot(1.0) for seed in (7, 7, 8))
    for field in ("kind", "center_m", "rotation", "half_m", "velocity_mps", "material", "thing"):
        assert np.array_equal(getattr(one, field), getattr(same, field))
    assert np.array_equal(one.terrain.heights_m, same.terrain.heights_m)
    assert one.center_m.shape != other.center_m.shape or not np.allclose(one.center_m, other.center_m)
