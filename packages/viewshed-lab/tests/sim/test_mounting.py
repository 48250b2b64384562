"""Mountings: where the sensor sits, what it sees of its carrier, and in which frame its points are given."""

import numpy as np
import pytest

from viewshed.geometry import Rigid
from viewshed.grid import GRIDS
from viewshed_lab.data.wild import wild_tables
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.mounting import MountingFamily, draw_mounting
from viewshed_lab.sim.observe import Observation, Setting, observe
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Agent, AgentPlan, Thing, World
from viewshed_lab.sim.worlds import WORLDS

FAMILIES = wild_tables().mountings
SETTING = Setting(GRIDS["road"], CONDITIONS["clear"], 0.0)


def flat_world(height_m: float) -> World:
    """Return a plane with one car in its middle, heading along x."""
    car = Thing("car", WORLDS["street"](np.random.default_rng(0), AgentPlan()).things[0].parts)
    agent = Agent("vehicle_0", "vlp16", Rigid.from_yaw(0.0, (0.0, 0.0, height_m)), 0)
    return World("plane", Terrain.plane(300.0), (car,), (agent,))


def observed(family: MountingFamily, seed: int = 1) -> tuple[Observation, Agent, World]:
    """Return what a sensor sees that is mounted by a family on a plane."""
    mounting = draw_mounting(family, np.random.default_rng(seed))
    world, agent = mounting.mounted(flat_world(mounting.height_m), 0)
    return observe(world, agent, 0.0, SETTING, np.random.SeedSequence(0)), agent, world


@pytest.mark.parametrize("name", FAMILIES)
def test_a_drawn_mounting_lies_within_its_family(name: str) -> None:
    family = FAMILIES[name]
    for seed in range(5):
        one = draw_mounting(family, np.random.default_rng(seed))
        assert family.height_m[0] <= one.height_m <= family.height_m[1]
        assert family.yaw_deg[0] - 1e-9 <= abs(np.rad2deg(one.yaw)) <= family.yaw_deg[1] + 1e-9
        assert family.pitch_deg[0] - 1e-9 <= np.rad2deg(one.pitch) <= family.pitch_deg[1] + 1e-9
        assert abs(np.rad2deg(one.roll)) <= family.roll_deg[1] + 1e-9
        assert one.rotation @ one.rotation.T == pytest.approx(np.eye(3))
        # A sensor pitched down looks below the horizon, whichever way it is turned.
        assert one.rotation[2, 0] == pytest.approx(-np.sin(one.pitch))


@pytest.mark.parametrize("name", [name for name in FAMILIES if FAMILIES[name].height_m[0] > 1.4])
def test_points_given_lie_where_the_frame_says(name: str) -> None:
    """On a plane, ground returns in a base frame lie at one z; taken from the sensor's frame to the world, at 0."""
    family = FAMILIES[name]
    mounting = draw_mounting(family, np.random.default_rng(1))
    seen, agent, _ = observed(family)
    sweep = seen.image.sweep()
    given = mounting.given(sweep, agent)
    column, ring = np.nonzero(seen.image.steps)
    ground = seen.scan.thing[column, ring] == -1
    assert ground.sum() > 500
    if family.frame == "sensor":
        assert given is sweep
        z = (seen.scan.world_from_sensor @ given.points)[ground, 2]
    else:
        z = given.points[ground, 2] + mounting.origin_m(agent)[2]
    assert np.abs(z).max() < 0.1


def test_a_base_frame_has_its_origin_on_the_axle_or_at_the_sensor() -> None:
    known, unknown = (
        draw_mounting(FAMILIES[f"sealed_base_{name}"], np.random.default_rng(1)) for name in ("known", "unknown")
    )
    world, agent = unknown.mounted(flat_world(unknown.height_m), 0)
    assert unknown.origin_m(agent) == (-1.35, 0.0, 0.32)
    world, agent = known.mounted(flat_world(known.height_m), 0)
    assert known.origin_m(agent) == pytest.approx(tuple(agent.mount.translation))
    assert world.agents == (agent,)


def test_a_sensor_at_the_roof_edge_sees_its_own_carrier() -> None:
    """Far more than one on a mast in the middle of the roof does, and more on one side than on the other."""
    counts = {}
    for name in ("sealed_edge", "sealed_roof"):
        seen, agent, _ = observed(FAMILIES[name])
        own = seen.scan.thing == agent.carrier
        counts[name] = own.sum()
        assert not seen.known[127:129, 127:129].any()
    assert counts["sealed_edge"] > 2 * counts["sealed_roof"]
