"""Outdoor worlds: every plan works, nothing stands in anything else, traffic does not collide, seeds repeat."""

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from shapely import STRtree, area, intersection, polygons

from viewshed_lab.sim.assets.shapes import Box, Shape
from viewshed_lab.sim.assets.street import extent
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds import WORLDS
from viewshed_lab.sim.worlds.layout import with_masts_of
from viewshed_lab.sim.worlds.traffic import Driver, flow, right_turn, straight_lane

OUTDOOR = ("street", "junction", "highway", "parking", "residential")
ROWS = {"guard_rail", "barrier", "sound_wall"}
PLANS = [(1, 0, 2.0), (0, 1, 20.0), (5, 5, 60.0), (2, 3, 8.0)]


def made(name: str, seed: int, plan: tuple[int, int, float]) -> World:
    moving, roadside, duration_s = plan
    return WORLDS[name](np.random.default_rng(seed), AgentPlan(moving, roadside, duration_s=duration_s))


def corners(thing: Thing, part: Shape, t_s: float) -> NDArray[np.float64]:
    """Return the corners (4, 2) of one solid from above, turned by hand through its own yaw and that of its thing."""
    half_x, half_y, _ = part.half_sizes_m
    x, y, yaw = thing.pose_at(t_s)
    square = np.array([[-half_x, -half_y], [half_x, -half_y], [half_x, half_y], [-half_x, half_y]])
    for turn, shift in ((part.yaw, (part.x_m, part.y_m)), (yaw, (x, y))):
        c, s = np.cos(turn), np.sin(turn)
        square = np.column_stack([c * square[:, 0] - s * square[:, 1], s * square[:, 0] + c * square[:, 1]]) + shift
    return square


def overlaps(world: World, t_s: float) -> Iterator[tuple[str, str, float, float, float]]:
    """Yield pairs of things whose solids below 2 m share ground and height: kinds, shared area, and where."""
    rows = [(k, part) for k, thing in enumerate(world.things) for part in thing.parts if part.bottom_m < 2.0]
    shapes = np.atleast_1d(np.asarray(polygons(np.array([corners(world.things[k], part, t_s) for k, part in rows]))))
    for a, b in zip(*STRtree(shapes).query(shapes, predicate="intersects"), strict=True):
        (i, one), (j, other) = rows[a], rows[b]
        apart = one.bottom_m >= other.top_m or other.bottom_m >= one.top_m
        shared = float(area(intersection(shapes[a], shapes[b])))
        kinds = world.things[i].kind, world.things[j].kind
        joint = kinds[0] == kinds[1] and kinds[0] in ROWS
        if i < j and not apart and not joint and shared > 0.02:
            middle = shapes[a].centroid
            yield *kinds, shared, middle.x, middle.y


@pytest.mark.parametrize("name", OUTDOOR)
@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_nothing_stands_in_anything_else_at_any_time(name: str, plan: tuple[int, int, float]) -> None:
    found = []
    for seed in range(3):
        world = made(name, seed, plan)
        for t_s in np.linspace(0.0, plan[2], 3):
            found += [(seed, t_s, *pair) for pair in overlaps(world, float(t_s))]
    assert found == []


@pytest.mark.parametrize("name", OUTDOOR)
def test_every_plan_has_its_agents_well_inside_the_world(name: str) -> None:
    for (moving, roadside), duration_s in itertools.product([(1, 0), (5, 0), (0, 5), (5, 5)], (2.0, 20.0, 60.0)):
        world = made(name, 11, (moving, roadside, duration_s))
        names = [f"vehicle_{k}" for k in range(moving)] + [f"roadside_{k}" for k in range(roadside)]
        assert [agent.name for agent in world.agents] == names
        for agent, t_s in itertools.product(world.agents, (0.0, duration_s / 2, duration_s)):
            x, y, z = world.world_from_sensor(agent, t_s).translation
            lines_x, lines_y = world.terrain.x_m, world.terrain.y_m
            assert min(x - lines_x[0], lines_x[-1] - x) > 59.0
            assert min(y - lines_y[0], lines_y[-1] - y) > 55.0
            above = z - float(world.terrain.at([[x, y]])[0])
            assert 1.7 < above < 1.95 if agent.carrier is not None else 4.0 <= above <= 8.0


@pytest.mark.parametrize("name", OUTDOOR)
def test_a_sensor_is_inside_no_solid(name: str) -> None:
    for seed in range(4):
        world = made(name, seed, (4, 3, 10.0))
        snapshot = world.snapshot(5.0)
        for agent in world.agents:
            away = world.world_from_sensor(agent, 5.0).translation - snapshot.center_m
            local = np.abs(np.einsum("kji,kj->ki", snapshot.rotation, away))
            assert not (local < snapshot.half_m).all(axis=1).any()


@pytest.mark.parametrize("name", OUTDOOR)
def test_masts_look_down_and_cars_drive_forward(name: str) -> None:
    world = made(name, 5, (3, 3, 10.0))
    for agent in world.agents:
        ahead = world.world_from_sensor(agent, 0.0).rotation[:, 0]
        if agent.carrier is None:
            assert 0.9 < np.rad2deg(np.arcsin(-ahead[2])) < 8.1
        else:
            moved = np.subtract(
                world.things[agent.carrier].pose_at(0.5)[:2], world.things[agent.carrier].pose_at(0.0)[:2]
            )
            assert moved @ ahead[:2] >= 0.0


@pytest.mark.parametrize("name", OUTDOOR)
def test_the_same_seed_gives_the_same_world_and_another_seed_another(name: str) -> None:
    one, same, other = (made(name, seed, (2, 2, 5.0)).snapshot(1.0) for seed in (7, 7, 8))
    for field in ("kind", "center_m", "rotation", "half_m", "velocity_mps", "material", "thing"):
        assert np.array_equal(getattr(one, field), getattr(same, field))
    assert np.array_equal(one.terrain.heights_m, same.terrain.heights_m)
    assert one.center_m.shape != other.center_m.shape or not np.allclose(one.center_m, other.center_m)


@pytest.mark.parametrize("name", OUTDOOR)
def test_sizes_stay_where_casting_is_fast(name: str) -> None:
    parts, moving = [], []
    for seed in range(8):
        world = made(name, seed, (1 + seed % 5, seed % 6, (2.0, 20.0, 60.0)[seed % 3]))
        assert 2 * world.terrain.material.size <= 2500
        parts.append(len(world.snapshot(0.0).kind))
        moving.append(sum(thing.track is not None for thing in world.things))
    assert 250 < np.mean(parts) < 1000
    assert max(parts) < 1200
    assert max(moving) <= 40


@pytest.mark.parametrize("name", OUTDOOR)
def test_slopes_and_speeds_are_believable(name: str) -> None:
    for seed in range(5):
        world = made(name, seed, (2, 1, 12.0))
        z = world.terrain.heights_m
        fall = np.hypot(
            (z[-1] - z[0]).mean() / np.ptp(world.terrain.x_m), (z[:, -1] - z[:, 0]).mean() / np.ptp(world.terrain.y_m)
        )
        assert fall < 0.08
        for thing in world.things:
            if thing.track is not None:
                steps = np.diff(thing.track.xy_m, axis=0) / np.diff(thing.track.t_s)[:, None]
                assert np.hypot(*steps.T).max() < (36.0 if name == "highway" else 15.0)
                assert np.abs(np.diff(thing.track.yaw)).max() < 0.9


def test_a_follower_stops_behind_the_one_that_stops() -> None:
    box = Thing("car", (Box(0.0, 0.0, 4.0, 1.8, 1.5, 0.0),))
    lane = straight_lane(3.0, -2.0, np.pi / 2)
    riders = flow(lane, [Driver(box, 0.0, 8.0, 20.0), Driver(box, -15.0, 12.0, sensor_ahead_m=0.5)], 10.0)
    (first, ahead), (second, own) = riders
    assert (ahead, own) == (None, 0.5)
    assert first.pose_at(10.0)[:2] == pytest.approx((3.0, 18.0))
    assert second.pose_at(10.0)[:2] == pytest.approx((3.0, 12.0))
    gaps = [first.pose_at(t)[1] - second.pose_at(t)[1] for t in np.linspace(0, 10, 40).tolist()]
    assert min(gaps) > 4.0 + 1.9


def test_a_right_turn_ends_to_the_right() -> None:
    lane = right_turn(straight_lane(0.0, -2.0, 0.0), -3.0, 6.0)
    xy, yaw = lane.at(np.array([-9.0, -9.0 + 3.0 * np.pi, 20.0]))
    assert xy[0] == pytest.approx([-9.0, -2.0])
    assert xy[1] == pytest.approx([-3.0, -8.0])
    assert yaw.tolist() == pytest.approx([0.0, -np.pi / 2, -np.pi / 2])
    assert xy[2] == pytest.approx([-3.0, -8.0 - (29.0 - 3.0 * np.pi)])


def test_curbs_rise_within_centimeters_beside_the_street() -> None:
    terrain: Terrain = made("street", 3, (1, 0, 2.0)).terrain
    y = np.arange(0.0, 15.0, 0.01)
    for way in (-1, 1):
        z = terrain.at(np.column_stack([np.full_like(y, 5.0), way * y]))
        assert 0.09 < max(z[k + 4] - z[k] for k in range(len(z) - 4)) < 0.17


def test_extent_leaves_out_what_is_overhead() -> None:
    lamp = Thing("lamp", (Box(0.0, 0.0, 0.2, 0.2, 6.0), Box(1.0, 0.0, 2.0, 0.1, 6.0, 5.9)))
    assert extent(lamp) == pytest.approx((-0.1, 0.1, -0.1, 0.1))
    assert extent(lamp, 10.0)[1] == pytest.approx(2.0)


def test_masts_are_made_taller_where_they_stand() -> None:
    world = made("junction", 4, (2, 3, 8.0))
    tall = with_masts_of(world, 20.0, np.radians(30.0))
    assert [agent.name for agent in tall.agents] == [agent.name for agent in world.agents]
    assert tall.things[:-3] == world.things[:-3]
    assert tall.agents[:2] == world.agents[:2]
    for before, after, pole in zip(world.agents[2:], tall.agents[2:], tall.things[-3:], strict=True):
        place, ahead = after.mount.translation, after.mount.rotation @ np.array([1.0, 0.0, 0.0])
        assert place[:2] == pytest.approx(before.mount.translation[:2])
        assert place[2] - tall.terrain.at(place[None])[0] == pytest.approx(20.0)
        assert ahead[2] == pytest.approx(-0.5)  # 30 degrees down
        assert after.mount.yaw == pytest.approx(before.mount.yaw)
        assert pole.parts[0].top_m == pytest.approx(20.3)
        assert np.hypot(pole.x_m - place[0], pole.y_m - place[1]) == pytest.approx(0.5)
    with pytest.raises(ValueError, match="must be its 3 masts"):
        with_masts_of(replace(world, things=world.things[:-1]), 20.0, 0.5)
