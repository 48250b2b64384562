"""Observe a world with an agent's sensor: exact hits, stored sweep, and exact visibility."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.sensors import LidarModel, lidar_model
from viewshed_lab.sim.lidar.measurement import measure
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep
from viewshed_lab.sim.lidar.weather import CONDITIONS, Conditions
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import ExactScan, Motion
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.sim.world import Agent, World

_shared_snapshot = lru_cache(maxsize=1)(World.snapshot)
"""Snapshot of a world at one time, shared by all agents."""


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One revolution of one agent's sensor."""

    scan: ExactScan  # exact hit of every beam, without noise
    image: StoredSweep  # range image that the sensor stores; ``image.sweep()`` is the sweep
    truth: Truth  # what the sensor could have seen
    known: NDArray[np.bool_]  # (cells, cells) bool, where the truth is known


@dataclass(frozen=True, slots=True)
class Setting:
    """Grid, conditions and duration of an observation."""

    grid: BevGrid  # of the truth
    conditions: Conditions = CONDITIONS["clear"]  # weather and faults
    revolution_s: float = 0.1  # duration of a sweep; 0 fires all beams at once


def observe(
    world: World,
    agent: Agent,
    t_s: float,
    setting: Setting,
    seed: np.random.SeedSequence,
    model: LidarModel | None = None,
) -> Observation:
    """Observe a world in the revolution around ``t_s``; the same seed gives the same bytes.

    Args:
        world: the world to observe.
        agent: one of the world's agents.
        t_s: time of the middle of the revolution, seconds.
        setting: grid, weather, duration of the revolution.
        seed: of free paths in volumes and of measurement noise.
        model: replaces the agent's beam table.
    """
    for_paths, for_noise = seed.spawn(2)
    scan, image = measure_sweep(world, agent, t_s, setting, for_paths, for_noise, model)
    return Observation(scan, image, *exact_truth(scan, world, setting.grid, agent=agent))


def measure_sweep(
    world: World,
    agent: Agent,
    t_s: float,
    setting: Setting,
    for_paths: np.random.SeedSequence,
    for_noise: np.random.SeedSequence,
    model: LidarModel | None = None,
) -> tuple[ExactScan, StoredSweep]:
    """Return the exact hit of every beam and the stored sweep; like :func:`observe`, but without truth.

    Args:
        world: the world to observe.
        agent: one of the world's agents.
        t_s: time of the middle of the revolution, seconds.
        setting: weather, duration of the revolution.
        for_paths: seed of free paths in volumes.
        for_noise: seed of measurement noise.
        model: replaces the agent's beam table.
    """
    pose, motion = pose_and_motion(world, agent, t_s, setting.revolution_s)
    paths = int(for_paths.generate_state(1)[0])
    scan = cast_world(_shared_snapshot(world, t_s), model or lidar_model(agent.sensor), pose, motion, paths)
    image = measure(
        scan,
        setting.conditions,
        np.random.Generator(np.random.PCG64(for_noise)),
        sensor_height_m=float(pose.translation[2] - world.ground_of(agent).at(pose.translation[None])[0]),
        t_ns=round(t_s * 1e9),
        agent=agent.name,
    )
    return scan, image


def pose_and_motion(world: World, agent: Agent, t_s: float, period_s: float) -> tuple[Rigid, Motion]:
    """Return the sensor's pose at ``t_s``, and its motion as the difference over a revolution of ``period_s``."""
    if period_s == 0.0 or agent.carrier is None:
        return world.world_from_sensor(agent, t_s), Motion(period_s=period_s)
    turns, positions = world.sensor_path(agent, np.array([t_s - period_s / 2, t_s, t_s + period_s / 2]))
    vx, vy, vz = (float(value) for value in (positions[2] - positions[0]) / period_s)
    turned = turns[2] @ turns[0].T
    yaw = float(np.arctan2(turned[1, 0], turned[0, 0]))
    return Rigid(turns[1], positions[1]), Motion((vx, vy, vz), yaw / period_s, period_s)
