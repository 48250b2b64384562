"""From a world to a sample in one call."""

import numpy as np
import pytest

from viewshed import GRIDS
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.observe import Setting, observe, pose_and_motion
from viewshed_lab.sim.world import AgentPlan
from viewshed_lab.sim.worlds import WORLDS

WORLD = WORLDS["street"](np.random.default_rng(5), AgentPlan(moving=1, roadside=1, sensor="vlp16"))
SETTING = Setting(GRIDS["road"], CONDITIONS["clear"], 0.1)


def test_a_driving_agent_observes_where_its_pose_says() -> None:
    """Ground returns, taken to the world, lie on the terrain."""
    agent = WORLD.agents[0]
    seen = observe(WORLD, agent, 4.0, SETTING, np.random.SeedSequence(1))
    sweep = seen.image.sweep()
    column, ring = np.nonzero(seen.image.steps)
    ground = seen.scan.thing[column, ring] == -1
    world = (sweep.world_from_sensor @ sweep.points)[ground]
    assert len(world) > 1000
    assert np.abs(world[:, 2] - WORLD.terrain.at(world)).max() < 0.1
    assert (sweep.t_ns, sweep.agent) == (4_000_000_000, agent.name)


def test_weather_changes_the_sweep_and_not_the_truth() -> None:
    clear, fog = (
        observe(WORLD, WORLD.agents[0], 2.0, Setting(GRIDS["road"], CONDITIONS[name]), np.random.SeedSequence(3))
        for name in ("clear", "dense_fog")
    )
    far = round(30.0 / clear.image.step_m)
    assert (fog.image.steps > far).sum() < 0.5 * (clear.image.steps > far).sum()
    assert (clear.truth.expected_returns["car"] == fog.truth.expected_returns["car"]).all()


def test_motion_is_that_of_the_carrier_and_masts_stand_still() -> None:
    driver, mast = WORLD.agents
    t = next(t for t in np.arange(0.5, 20.0, 0.5) if WORLD.pose_of(driver.carrier or 0, t + 1).translation[0] != 0)
    _, motion = pose_and_motion(WORLD, driver, float(t), 0.1)
    before, after = (WORLD.world_from_sensor(driver, t + step) for step in (-0.05, 0.05))
    assert motion.velocity_mps == pytest.approx(tuple((after.translation - before.translation) / 0.1))
    assert motion.yaw_rate == pytest.approx((after.yaw - before.yaw) / 0.1, abs=1e-3)
    assert pose_and_motion(WORLD, mast, 3.0, 0.1)[1].velocity_mps == (0.0, 0.0, 0.0)
    assert pose_and_motion(WORLD, driver, 3.0, 0.0)[1].period_s == 0.0
