"""Worlds of towns: masts look down, traffic does not collide, slopes and speeds are believable."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sim.worlds.test_every_world import TOWN, made

from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Thing
from viewshed_lab.sim.worlds.layout import with_masts_of
from viewshed_lab.sim.worlds.traffic import Driver, flow, right_turn, straight_lane


@pytest.mark.parametrize("name", TOWN)
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


@pytest.mark.parametrize("name", TOWN)
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
