"""Fuse signed messages of a car, a car that lies and a sensor on a mast, and estimate the trust in each.

The second car reports three cars that are not there. Its messages are correctly signed, so the receiver accepts them;
trust falls because its reports contradict what the other two see.
"""

from dataclasses import replace

import numpy as np

from viewshed import GRIDS, load_estimator
from viewshed.agents.many import AgentReport, CommandCenter, joint_fov
from viewshed.agents.receiver import Receiver
from viewshed.agents.signing import KeyRing, SigningKey, sign_message
from viewshed.agents.view_message import SensorFacts, ViewMessage
from viewshed.objects.detector import Detector
from viewshed.preprocess.leveling import level
from viewshed_lab.data.drive import drive_plan, drive_sweeps
from viewshed_lab.data.presets import preset_named
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS

LIAR, SECONDS, HZ, SEED = "vehicle_1", 6.0, 2.0, 5
START_NS = 1_760_000_000_000_000_000

# A junction with two cars and a mast, each with a sensor and a key; the center knows the public keys.
preset = replace(preset_named("carla"), roadside=1, sensors=("hdl32e",))
plan = drive_plan(preset, seconds=SECONDS, hz=HZ, agents=2, world="junction", seed=SEED)
agents = ("vehicle_0", LIAR, "roadside_0")
keys = {agent: SigningKey.generate(agent) for agent in agents}
receiver = Receiver(KeyRing(tuple(key.verifying() for key in keys.values())), start_ns=START_NS - 1_000_000_000)
center = CommandCenter(agents)
estimator, detector = load_estimator("shadow_map", grid=GRIDS["road"]), Detector()
lie = OBJECT_ATTACKS["fabricate_static"](counts="exact", mean_count=3.0).begin(np.random.default_rng(SEED))

reports: list[AgentReport] = []
sent_bytes = 0
for number, (sweep, _) in enumerate(drive_sweeps(plan)):
    # 1. Each agent estimates its view and detects objects; the liar adds false ones after two seconds.
    leveled = level(sweep, estimator.grid)
    view, found = estimator.estimate(leveled), detector.detect(leveled)
    pose, t_ns = view.world_from_level, START_NS + (sweep.t_ns or 0)
    assert pose is not None
    if sweep.agent == LIAR:
        found = lie.apply(found.moved(pose), (sweep.t_ns or 0) / 1e9, pose.translation).detections.moved(pose.inverse())

    # 2. It sends view and objects in a signed message of a few kilobytes.
    height_m, reach_m = (view.basis.sensor_height_m, view.basis.reach_m) if view.basis else (np.nan, np.nan)
    message = ViewMessage(
        sweep.agent, number, t_ns, "map", pose, np.diag([0.01, 0.01, 0.01, 1e-4, 1e-4, 1e-4]),
        SensorFacts("lidar", height_m, reach_m), view=view, ground=leveled.ground, detections=found,
    )  # fmt: skip
    data = sign_message(message, keys[sweep.agent])
    sent_bytes += len(data)

    # 3. The center verifies it, and fuses the reports once all agents have sent one for the same time.
    taken = receiver.receive(data, t_ns + 20_000_000).message
    assert taken is not None
    reports.append(AgentReport.of_message(taken))
    if len(reports) == len(agents):
        picture = center.add((t_ns - START_NS) / 1e9, reports)
        trust = ", ".join(f"{agent} {one:.2f}" for agent, one in zip(agents, picture.verdicts.trust, strict=True))
        print(f"{picture.t_s:.2f} s: {picture.believed.sum():2} of {len(picture.tracks):2} objects; {trust}")
        last, reports = reports, []

joint = joint_fov([one.estimate for one in last], estimator.grid, last[0].world_from_level, picture.verdicts.trust)
alone_m2, joint_m2 = last[0].estimate.area_m2(), joint.estimate().area_m2()
print(f"{receiver.taken} messages of {sent_bytes / receiver.taken / 1e3:.1f} kB, {receiver.refused.total()} refused")
print(f"within 64 m of {agents[0]}: {alone_m2:.0f} m² visible to it alone, {joint_m2:.0f} m² to all that are trusted")
print(f"least trusted: {agents[int(picture.verdicts.trust.argmin())]}")
assert picture.verdicts.trust.argmin() == agents.index(LIAR)
