"""Is someone lying? Run the monitor on a stream of honest sweeps that an attacker begins to forge.

The monitor compares each sweep with the stream's past. It does not find every attack: docs/results/monitor.md has its
detection and false-alarm rates.
"""

import numpy as np

from viewshed import GRIDS, Sweep, attacks, lidar_model
from viewshed.monitor import StreamMonitor
from viewshed.preprocess.leveling import level
from viewshed_lab.sim import cast_world
from viewshed_lab.sim.lidar.measurement import measure
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.world import AgentPlan
from viewshed_lab.sim.worlds import WORLDS

HONEST, FORGED, HZ = 20, 5, 10.0

rng = np.random.default_rng(3)
world = WORLDS["junction"](rng, AgentPlan(sensor="vlp16", sensor_height_m=1.84))
agent, model = world.agents[0], lidar_model("vlp16")


def sweep_at(number: int) -> Sweep:
    """Return a simulated sweep of a car that drives, with its pose and time."""
    pose = world.world_from_sensor(agent, number / HZ)
    scan = cast_world(world.snapshot(number / HZ), model, pose, seed=number)
    sweep = measure(scan, CONDITIONS["clear"], rng, sensor_height_m=1.84).sweep()
    return sweep.replace(t_ns=int(number * 1e9 / HZ), world_from_sensor=pose)


sweeps = [sweep_at(number) for number in range(HONEST + FORGED)]
lies = {
    "a pose that is off by 1 m": attacks.PoseSpoof(yaw_deg=0.0, shift_m=1.0),
    "a jammed sensor": attacks.Jamming(share=0.6),
    "a wedge 5 m too far": attacks.Relay(sector_deg=30.0),
}
for name, attack in lies.items():
    stream, alarms = StreamMonitor(), []
    for number, sweep in enumerate(sweeps):
        seen = sweep if number < HONEST else attack.apply(sweep, np.random.default_rng(0)).sweep
        report = stream.check(level(seen, GRIDS["road"]))
        if report.alarm:
            alarms.append(f"sweep {number}, {'; '.join(report.now.reasons[:1]) or 'latched'}")
    said = f"alarm at {alarms[0]}" if alarms else "nothing found"
    print(f"{name}, from sweep {HONEST} on: {said}")
