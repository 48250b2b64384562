"""Worlds that are neither flat nor square: whoever drives has room and stands on what carries it, sweeps make sense."""

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.sim.worlds.test_every_world import WILD, in_the_way, made

from viewshed.sensors import lidar_model
from viewshed_lab.sim.assets.shapes import material_index
from viewshed_lab.sim.assets.street import footprint
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.world import World

STANDING = {
    "car", "van", "truck", "bus", "container", "cabin", "excavator", "stack", "barrels", "pedestrian", "scaffold",
}  # fmt: skip


@pytest.mark.parametrize("name", WILD)
def test_the_way_of_a_vehicle_is_free(name: str) -> None:
    for seed in range(2):
        assert list(in_the_way(made(name, seed, (4, 3, 10.0)), np.linspace(0.0, 10.0, 21))) == [], seed


@pytest.mark.parametrize("name", WILD)
def test_vehicles_stand_on_what_carries_them(name: str) -> None:
    """Each corner of a car's wheelbase is within 0.3 m of the ground of its level; none is tilted by over 20°."""
    for seed in range(2):
        world = made(name, seed, (2, 0, 10.0))
        for k, one in enumerate(world.things):
            if one.kind not in ("car", "van"):
                continue
            ground = world.upper if one.upper and world.upper is not None else world.terrain
            for t_s in (0.0, 5.0) if one.track is not None else (0.0,):
                pose = world.pose_of(k, t_s)
                if np.abs(pose.translation[:2]).max() > 105.0:
                    continue
                corners = np.array([[1.4, 0.7, 0], [1.4, -0.7, 0], [-1.4, 0.7, 0], [-1.4, -0.7, 0]])
                feet = corners @ pose.rotation.T + pose.translation
                gaps = feet[:, 2] - ground.at(feet)
                assert np.abs(gaps).max() < 0.3, (seed, one.kind, pose.translation, gaps)
                assert pose.rotation[2, 2] > np.cos(np.deg2rad(20.0))


@pytest.mark.parametrize("name", WILD)
def test_sweeps_have_a_sane_number_of_stops(name: str) -> None:
    """The beams below the horizon mostly meet something, and those that meet the carrier are few."""
    model = lidar_model("vlp16")
    for seed in range(5):
        world = made(name, seed)
        agent = world.agents[0]
        scan = cast_world(world.snapshot(5.0), model, world.world_from_sensor(agent, 5.0), seed=seed)
        met = np.isfinite(scan.depth_m)
        assert 0.2 < met.mean() <= 1.0, seed
        assert met[:, : model.rings // 2 - 1].mean() > 0.6, seed
        assert (scan.thing == agent.carrier).mean() < 0.3, seed
        assert float(scan.depth_m.min()) > 0.05


def beside(world: World, forward_m: float, left_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the ground's heights from that below the sensor, at places beside the first agent at 5 s."""
    agent = world.agents[0]
    pose, ground = world.world_from_sensor(agent, 5.0), world.ground_of(agent)
    c, s = np.cos(pose.yaw), np.sin(pose.yaw)
    x, y = c * forward_m - s * left_m, s * forward_m + c * left_m
    here = ground.at(pose.translation[None])[0]
    return np.asarray(ground.at(np.stack([x, y], axis=-1) + pose.translation[:2]) - here)


def scan_of(world: World, sensor: str = "hdl32e") -> ExactScan:
    agent = world.agents[0]
    return cast_world(world.snapshot(5.0), lidar_model(sensor), world.world_from_sensor(agent, 5.0), seed=1)


@pytest.mark.parametrize("name", ["pit", "quay"])
def test_ground_drops_within_centimeters_next_to_the_lane_and_hides_what_stands_at_its_foot(name: str) -> None:
    """The tallest upright face beside the sensor is 1 to 8 m; no beam meets the floor just behind it."""
    steps = np.arange(0.0, 60.0, 0.04)
    found = 0
    for seed in range(12):
        world = made(name, seed)
        z = np.array([beside(world, 0.0, way * steps) for way in (-1, 1)])
        way, k = np.unravel_index(int(np.argmin(np.diff(z, axis=1))), (2, len(steps) - 1))
        deep = float(z[way, k] - z[way, k + 1])
        if deep < 1.0:  # no pit just here
            continue
        found += 1
        assert 1.0 < deep < 8.0
        agent = world.agents[0]
        scan = scan_of(world)
        pose = world.world_from_sensor(agent, 5.0)
        stops = (scan.origin_m + scan.direction * scan.depth_m[..., None])[np.isfinite(scan.depth_m)] @ pose.rotation
        side = (1, -1)[1 - int(way)] * stops[:, 1]
        foot = (np.abs(stops[:, 0]) < 2.0) & (side > steps[k] + 0.1) & (side < steps[k] + 0.3)
        assert not (foot & (stops[:, 2] < -1.84 - 0.9 * deep)).any()
    assert found > 3


def test_under_a_bridge_beams_meet_the_deck_and_on_it_the_road() -> None:
    up, down = 0, 0
    for seed in range(30):
        world = made("bridge", seed, (4, 0, 6.0))
        deck = next(k for k, thing in enumerate(world.things) if thing.kind == "deck")
        snapshot = world.snapshot(3.0)
        row = int(np.flatnonzero(snapshot.thing == deck)[0])
        for agent in world.agents:
            pose = world.world_from_sensor(agent, 3.0)
            off = np.abs((pose.translation - snapshot.center_m[row]) @ snapshot.rotation[row])
            if (off[:2] > snapshot.half_m[row, :2] - 1.0).any():
                continue
            scan = cast_world(snapshot, lidar_model("os0_128"), pose, seed=0)
            at_deck = scan.thing == deck
            upward = scan.direction[..., 2] > 0
            if world.ground_of(agent) is world.upper:
                up += 1
                assert at_deck[~upward].mean() > 0.05
                assert not at_deck[upward].any()
                assert pose.translation[2] > snapshot.center_m[row, 2]
            else:
                down += 1
                assert at_deck[upward].mean() > 0.02
                assert not at_deck[~upward].any()
                assert snapshot.center_m[row, 2] - snapshot.half_m[row, 2] - pose.translation[2] > 1.5
    assert up > 2
    assert down > 2


def test_a_garage_has_a_ceiling_within_reach_and_an_open_field_has_none() -> None:
    for seed in range(6):
        scan = scan_of(made("garage", seed), "os0_128")
        upward = scan.direction[..., 2] > 0.5
        assert np.isfinite(scan.depth_m[upward]).mean() > 0.95
        assert np.median((scan.depth_m * scan.direction[..., 2])[upward & np.isfinite(scan.depth_m)]) < 1.6
        world = made("open_field", seed)
        field = scan_of(world, "os0_128")
        assert not np.isfinite(field.depth_m[upward]).any()
        assert ((field.thing >= 0) & (field.thing != world.agents[0].carrier)).mean() < 0.06


def test_beams_pass_glass_fronts_and_some_stop_in_the_panes() -> None:
    glass = [material_index(name) for name in ("glass", "window", "tinted")]
    for seed in range(4):
        world = made("glass_fronts", seed)
        scan = scan_of(world)
        buildings = [k for k, thing in enumerate(world.things) if thing.kind == "building"]
        met = np.isin(scan.thing, buildings)
        panes = np.isin(scan.material, glass) & met
        assert panes.sum() > 300
        assert (met & ~panes).sum() > 1000
        assert (scan.cos_incidence[panes & (scan.material != glass[0])] < 0.999).any() or (
            scan.material[panes] == glass[0]
        ).all()


@pytest.mark.parametrize("name", ["pit", "quay", "site", "bridge", "embankment"])
def test_nothing_that_stands_reaches_over_an_edge(name: str) -> None:
    """Below vehicles, goods and people the ground is within 0.9 m of the plane that goes on from below their middle."""
    for seed in range(6):
        world = made(name, seed)
        for thing in world.things:
            if thing.track is None and not thing.upper and thing.kind in STANDING:
                middle = np.array([thing.x_m, thing.y_m])
                inside = 0.98 * (footprint(thing) - middle)
                normal = world.terrain.normals_at(middle[None], 0.4)[0]
                rise = world.terrain.at(inside + middle) - world.terrain.at(middle[None])[0]
                assert np.abs(rise + inside @ normal[:2] / normal[2]).max() < 0.9, (seed, thing.kind)
