"""Indoor worlds: the same from a seed, solid walls, nothing in each other, robots that get through."""

from itertools import combinations

import numpy as np
import pytest
import shapely
from tests.sim.worlds.test_every_world import INDOOR, outlines

from viewshed_lab.sim.world import AgentPlan, World
from viewshed_lab.sim.worlds import WORLDS
from viewshed_lab.sim.worlds.indoor.floor_plan import Rise, floor
from viewshed_lab.sim.worlds.indoor.walls import Opening, Wall, wall_parts

PLAN = AgentPlan(moving=2, roadside=2, sensor="vlp16", sensor_height_m=0.7, duration_s=60.0)
HOUSE = {"wall", "ceiling", "beam", "pillar", "duct", "gallery", "threshold", "balustrade"}


def make(name: str, seed: int, plan: AgentPlan = PLAN) -> World:
    return WORLDS[name](np.random.default_rng(seed), plan)


@pytest.mark.parametrize("name", INDOOR)
@pytest.mark.parametrize("seed", [0])
def test_a_world_has_the_size_and_the_agents_that_were_asked_for(name: str, seed: int) -> None:
    plan = AgentPlan(moving=3, roadside=1, sensor="vlp16", sensor_height_m=0.6, duration_s=5.0)
    world = make(name, seed, plan)
    snapshot = world.snapshot(0.0)
    assert world.name == name
    assert world.indoor
    assert [agent.name for agent in world.agents] == ["robot_0", "robot_1", "robot_2", "ceiling_0"]
    assert 150 <= len(snapshot.kind) <= 900
    assert (world.terrain.material.size) * 2 <= 200
    assert sum(one.track is not None for one in world.things) <= 12
    walls = np.array([world.things[k].kind == "wall" for k in snapshot.thing])
    reach = np.abs(snapshot.rotation[walls] * snapshot.half_m[walls][:, None]).sum(axis=2)
    assert ((snapshot.center_m[walls] + reach).max(axis=0)[:2] > 16.0).all()
    assert ((snapshot.center_m[walls] - reach).min(axis=0)[:2] < -16.0).all()
    for agent in world.agents[:3]:
        pose = world.world_from_sensor(agent, 2.0).translation
        assert pose[2] - world.terrain.at(pose[None, :2])[0] == pytest.approx(0.6)


@pytest.mark.parametrize("name", INDOOR)
@pytest.mark.parametrize("seed", [3, 4])
def test_no_two_things_are_in_each_other(name: str, seed: int) -> None:
    """Prisms around solids, by shapely; only the shell of the house may touch itself."""
    world = make(name, seed)
    snapshot = world.snapshot(0.0)
    polygons, _, _ = outlines(world, 0.0)
    top, bottom = snapshot.center_m[:, 2] + snapshot.half_m[:, 2], snapshot.center_m[:, 2] - snapshot.half_m[:, 2]
    i, j = shapely.STRtree(polygons).query(polygons, predicate="intersects")
    deep = np.minimum(top[i], top[j]) - np.maximum(bottom[i], bottom[j])
    rows = (snapshot.thing[i] < snapshot.thing[j]) & (deep > 0.02)
    i, j = i[rows], j[rows]
    area = shapely.area(shapely.intersection(polygons[i], polygons[j]))
    kinds = [
        (world.things[a].kind, world.things[b].kind) for a, b in zip(snapshot.thing[i], snapshot.thing[j], strict=True)
    ]
    met = [pair for pair, size in zip(kinds, area, strict=True) if size > 0.004 and not set(pair) <= HOUSE]
    seated = [pair for pair in met if set(pair) == {"chair", "pedestrian"}]
    assert sorted(set(met) - set(seated)) == []


@pytest.mark.parametrize("name", INDOOR)
@pytest.mark.parametrize("seed", [0])
def test_robots_touch_nothing_on_their_way(name: str, seed: int) -> None:
    world = make(name, seed)
    snapshot = world.snapshot(0.0)
    moves = np.array([world.things[k].track is not None for k in snapshot.thing])
    ground = world.terrain.at(snapshot.center_m[:, :2])
    top = snapshot.center_m[:, 2] + snapshot.half_m[:, 2] - ground
    bottom = snapshot.center_m[:, 2] - snapshot.half_m[:, 2] - ground
    tree = shapely.STRtree(outlines(world, 0.0)[0][~moves & (top > 0.04) & (bottom < 0.75)])
    for robot in (one for one in world.things if one.kind == "robot"):
        places = np.array([robot.pose_at(t) for t in np.arange(0.0, PLAN.duration_s, 0.2)])
        nearest = tree.query_nearest(shapely.points(places[:, :2]), return_distance=True, all_matches=False)[1]
        assert nearest.min() > 0.19
        steps = np.diff(places, axis=0)
        assert np.hypot(*steps[:, :2].T).max() < 0.8 * 0.2 + 1e-6
        assert np.abs(np.diff(world.terrain.at(places[:, :2]))).max() < 0.03


@pytest.mark.parametrize("name", INDOOR)
def test_whoever_moves_keeps_apart_for_ten_minutes(name: str) -> None:
    world = make(name, 2, AgentPlan(moving=3, sensor="vlp16", sensor_height_m=0.5, duration_s=600.0))
    movers = [one for one in world.things if one.track is not None]
    times = np.arange(0.0, 600.0, 0.1)
    paths = np.array([[np.interp(times, m.track.t_s, xy) for xy in m.track.xy_m.T] for m in movers if m.track])
    for a, b in combinations(range(len(movers)), 2):
        assert np.hypot(*(paths[a] - paths[b])).min() > 0.45, (movers[a].kind, movers[b].kind)
    assert [m.kind for m in movers[:3]] == ["robot"] * 3
    driven = np.hypot(*np.diff(paths[:3], axis=2).transpose(1, 0, 2)).sum(axis=1)
    assert (driven > 60.0).all()
    assert all(m.track is not None and m.track.t_s[0] <= 0 and m.track.t_s[-1] > 600.0 for m in movers)


def test_a_doorway_is_a_gap_below_a_lintel_with_posts_at_both_ends() -> None:
    wall = Wall(True, 3.0, -4.0, 6.0, 0.2, "brick", (Opening(1.0, 1.2, "passage"),))
    parts = wall_parts(wall, 2.7)
    inside = [p for p in parts if p.bottom_m < 2.0 and abs(p.x_m - 1.0) - p.length_m / 2 < 0.6 - 1e-9]
    lintel = [p for p in parts if abs(p.bottom_m - 2.05) < 1e-9]
    assert len(lintel) == 1
    assert (lintel[0].x_m, lintel[0].y_m, lintel[0].length_m, lintel[0].top_m) == pytest.approx((1.0, 3.0, 1.2, 2.7))
    assert sorted(round(p.x_m, 3) for p in inside) == [0.43, 1.57]
    pieces = sorted(
        (p.x_m - p.length_m / 2, p.x_m + p.length_m / 2) for p in parts if p.material == "brick" and p.bottom_m < 0
    )
    assert np.allclose(pieces, [(-4.0, 0.4), (1.6, 6.0)])


def test_a_raised_floor_has_a_ramp_and_steps_elsewhere() -> None:
    rise = Rise((2.0, 1.0, 8.0, 5.0), 0.2, (2.0, 2.0, 4.0, 3.0), 0)
    ground = floor(rise, (-9.0, -9.0, 9.0, 9.0), "wood")
    points = [[0.0, 2.5], [3.0, 2.5], [4.5, 2.5], [3.0, 4.0], [7.9, 1.2], [8.1, 1.2], [5.0, 5.1]]
    assert np.allclose(ground.at(points), [0.0, 0.1, 0.2, 0.2, 0.2, 0.0, 0.0], atol=1e-6)
    assert rise.path()[0] == pytest.approx((1.4, 2.5))
    assert np.allclose(ground.at(rise.path()), [0.0, 0.02, 0.1, 0.18, 0.2], atol=1e-6)
    edges = shapely.MultiLineString([((a, b), (c, d)) for a, b, c, d in rise.steps()])
    assert edges.distance(shapely.Point(2.0, 2.5)) == pytest.approx(0.5)
    assert edges.distance(shapely.Point(2.0, 4.0)) == 0.0
    assert edges.distance(shapely.Point(8.0, 2.5)) == 0.0


@pytest.mark.parametrize("height_m", [0.1, 2.4])
def test_robots_that_are_too_low_or_too_tall_are_refused(height_m: float) -> None:
    with pytest.raises(
        ValueError, match=rf"sensor_height_m must lie in \[0\.3, 1\.85\] indoors, got {height_m}; change"
    ):
        make("rooms", 0, AgentPlan(sensor_height_m=height_m))
    assert len(make("rooms", 0, AgentPlan(moving=0, roadside=2, sensor_height_m=height_m)).agents) == 2


def test_robots_drive_up_ramps() -> None:
    climbed = set()
    for name, seed in ((name, seed) for name in INDOOR for seed in range(8)):
        world = make(name, seed, AgentPlan(moving=1, sensor="vlp16", sensor_height_m=0.5, duration_s=200.0))
        heights = world.terrain.at([world.things[0].pose_at(t)[:2] for t in np.arange(0.0, 200.0, 0.5)])
        if heights.max() > 0.06:
            climbed.add(name)
            assert np.abs(np.diff(heights)).max() < 0.08
    assert len(climbed) >= 3
