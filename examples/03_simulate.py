"""Simulate a sweep at a junction, and score the shadow map against the exact truth."""

import numpy as np

from viewshed import ESTIMATORS, GRIDS, lidar_model
from viewshed_lab.sim import cast_world
from viewshed_lab.sim.lidar.measurement import measure
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.sim.world import AgentPlan
from viewshed_lab.sim.worlds import WORLDS

SEED, TIME_S, HEIGHT_M = 7, 5.0, 1.84

rng = np.random.Generator(np.random.PCG64(SEED))
world = WORLDS["junction"](rng, AgentPlan(moving=1, roadside=1, sensor_height_m=HEIGHT_M))
print(f"{world.name}: {len(world.things)} things, {len(world.agents)} agents")

agent = world.agents[0]
pose = world.world_from_sensor(agent, TIME_S)
scan = cast_world(world.snapshot(TIME_S), lidar_model(agent.sensor), pose, seed=SEED)
met = np.isfinite(scan.depth_m).mean()
print(f"scan: depth {scan.depth_m.shape} (columns, rings), {met:.0%} of the beams met something")

sweep = measure(scan, CONDITIONS["clear"], rng, sensor_height_m=HEIGHT_M).sweep()
print(f"sweep: {sweep.points.shape} points, ring 0 to {sweep.ring.max() if sweep.ring is not None else '?'}")

grid = GRIDS["road"]
truth, known = exact_truth(scan, world, grid, agent=agent)
print(f"truth: {truth.expected_returns['car'].shape} expected returns, known for {known.mean():.0%} of the cells")

for name in ("shadow_map", "first_blocker", "quantized"):
    claimed, seen = ESTIMATORS[name](grid).estimate(sweep).visible()[known], truth.visible("car")[known]
    both = (claimed & seen).sum()
    print(f"{name:<14} precision {both / claimed.sum():.3f}, recall {both / seen.sum():.3f}")
