"""Stream a simulated drive: the sweeps of several agents in time order, each with its truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.recordings.write.moment import DriveTruth, ObjectTruth
from viewshed.sweep import Sweep
from viewshed_lab._config import one_of
from viewshed_lab.data.presets import Preset, preset_named
from viewshed_lab.data.simulated import ScenePlan, scan_frame, world_of
from viewshed_lab.sim.assets.street import extent
from viewshed_lab.sim.world import Agent, Thing, World
from viewshed_lab.sim.worlds import WORLDS

OBJECT_KINDS = frozenset({
    "animal", "bus", "car", "cart", "cyclist", "forklift", "motorcycle", "pedestrian", "robot", "tractor", "trailer",
    "truck", "van",
})  # fmt: skip
"""Kinds of things that are objects even at rest; every other thing is an object if it moves."""

SEEN_RETURNS = 5
"""Smallest number of returns of a visible object."""

_DT_S = 0.05


def drive_plan(
    preset: Preset, *, seconds: float, hz: float, agents: int, world: str | None = None, seed: int | None = None
) -> ScenePlan:
    """Plan a drive: one scene of a preset in clear weather.

    Args:
        preset: source of sensors, mounting height and kinds of world.
        seconds: duration.
        hz: sweeps per second of each agent.
        agents: number of vehicles with a sensor; the preset gives the number of sensors on masts.
        world: kind of world; None is the first of the preset.
        seed: of the world and of the noise; None is the preset's.

    Raises:
        ValueError: a number is not positive, or there is no such world.
    """
    if not (seconds > 0 and 0 < hz <= 100) or agents < 1 or seconds * hz < 1:
        raise ValueError(
            "a drive must have seconds above 0, hz in (0, 100], one sweep or more and one agent or more, got"
            f" {seconds:g} s, {hz:g} Hz and {agents} agents"
        )
    name = preset.worlds[0] if world is None else world
    one_of("world", name, WORLDS)
    frames = int(seconds * hz + 1e-9) * (agents + preset.roadside)
    drive = replace(
        preset, worlds=(name,), world_weights=(1.0,), splits=("drive",), scenes=(1,), frames=(frames,), moving=agents,
        conditions=("clear",), condition_weights=(1.0,), interval_s=1 / hz,
        revolution_s=min(preset.revolution_s, 1 / hz), seed=preset.seed if seed is None else seed,
    )  # fmt: skip
    return ScenePlan(drive, 0, 0)


def drive_sweeps(plan: ScenePlan, world: World | None = None) -> Iterator[tuple[Sweep, DriveTruth]]:
    """Yield the sweeps of a drive with their truth: at each time one sweep of every agent.

    Args:
        plan: of the drive.
        world: replaces the plan's world; it must have the same agents, possibly mounted differently.
    """
    world, agents = world or world_of(plan), plan.preset.agents
    carriers = {agent.carrier for agent in world.agents}
    movable = [
        k for k, thing in enumerate(world.things)
        if k in carriers or thing.kind in OBJECT_KINDS or thing.track is not None
    ]  # fmt: skip
    mounts = {agent.name: None if agent.carrier is None else agent.mount for agent in world.agents}
    boxes = {k: box_of(world.things[k]) for k in movable}
    objects: tuple[ObjectTruth, ...] = ()
    for frame in range(plan.frames):
        time, number = divmod(frame, agents)
        t_s, agent = (time + 0.5) * plan.preset.interval_s, world.agents[number]
        if number == 0:
            objects = tuple(object_at(world, k, t_s, *boxes[k]) for k in movable)
        scan, stored = scan_frame(plan, frame, world=world)
        by_thing = np.bincount(scan.thing[(scan.thing >= 0) & (stored.steps > 0)], minlength=len(world.things))
        returns = by_thing[movable].astype(np.int32)
        seen = tuple(
            item for item, count in zip(objects, returns, strict=True)
            if count >= SEEN_RETURNS and item.number != agent.carrier
        )  # fmt: skip
        pose, velocity_mps = _carrier(world, agent, t_s)
        yield stored.sweep(), DriveTruth(mounts, objects, returns, seen, agent.carrier, pose, velocity_mps)


def _carrier(world: World, agent: Agent, t_s: float) -> tuple[Rigid, NDArray[np.float64]]:
    """Return the pose of the carrier of an agent's sensor, and the carrier's velocity (3,) in its own frame, m/s."""
    if agent.carrier is None:
        return agent.mount, np.zeros(3)
    pose = world.pose_of(agent.carrier, t_s)
    before, after = (world.pose_of(agent.carrier, t_s + step).translation for step in (-_DT_S, _DT_S))
    velocity: NDArray[np.float64] = pose.rotation.T @ ((after - before) / (2 * _DT_S))
    return pose, velocity


def box_of(thing: Thing) -> tuple[NDArray[np.float64], tuple[float, float, float]]:
    """Return center (3,) and size of the bounding box of a thing, in the thing's frame, m."""
    rear, front, right, left = extent(thing, np.inf)
    low = np.array([rear, right, min(part.bottom_m for part in thing.parts)])
    high = np.array([front, left, max(part.top_m for part in thing.parts)])
    length_m, width_m, height_m = (float(side) for side in high - low)
    return (low + high) / 2, (length_m, width_m, height_m)


def object_at(
    world: World, number: int, t_s: float, center: NDArray[np.float64], size_m: tuple[float, float, float]
) -> ObjectTruth:
    """Return the box of a thing at a time, given its center and size from :func:`box_of`."""
    pose = world.pose_of(number, t_s)
    return ObjectTruth(number, world.things[number].kind, pose @ Rigid(np.eye(3), center), size_m)


def simulated_drive(
    preset: str, *, seconds: float, hz: float, agents: int, world: str | None = None, seed: int | None = None
) -> Iterator[tuple[Sweep, DriveTruth]]:
    """Yield the sweeps of a drive of the preset with this name; see :func:`drive_plan`.

    Entry point of ``viewshed.drives``.
    """
    plan = drive_plan(preset_named(preset), seconds=seconds, hz=hz, agents=agents, world=world, seed=seed)
    return drive_sweeps(plan)
