"""Layout of outdoor worlds: fill strips without overlap, place agents, assemble the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.geometry import Rigid
from viewshed_lab.sim.assets.shapes import Cylinder
from viewshed_lab.sim.assets.street import place_at
from viewshed_lab.sim.assets.vehicles import sensor_car
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Agent, AgentPlan, Thing, World, tilted

Span = tuple[float, float]
Rect = tuple[float, float, float, float]
"""(x min, y min, x max, y max), meters."""

MAX_MOVING = 40
"""Largest number of moving things of a world."""


def within(rect: Sequence[float], x: F64, y: F64, by_m: float = 0.0) -> NDArray[np.bool_]:
    """Return which points lie in a rectangle, enlarged by ``by_m`` on each side."""
    return (x > rect[0] - by_m) & (x < rect[2] + by_m) & (y > rect[1] - by_m) & (y < rect[3] + by_m)


def lines_of(lines: list[float], half_m: float, apart_m: float = 0.01) -> F64:
    """Return the ascending lines of a terrain within ±half_m, at least ``apart_m`` apart."""
    ordered = np.unique(np.clip(np.array(lines), -half_m, half_m))
    return ordered[np.r_[True, np.diff(ordered) > apart_m]]


def spots(
    rng: np.random.Generator, span_m: Span, size_m: float, gap_m: Span, closed: Sequence[Span] = ()
) -> list[float]:
    """Return the centers in meters of pieces of equal size along a strip, with random gaps, outside closed parts.

    >>> spots(np.random.default_rng(0), (0.0, 10.0), 2.0, (0.0, 0.0), [(3.0, 5.0)])
    [1.0, 6.0, 8.0]
    """
    at, middles = span_m[0] + rng.uniform(0.0, gap_m[1]), []
    while at + size_m <= span_m[1]:
        blocked = [end for start, end in closed if at < end and at + size_m > start]
        if blocked:
            at = max(blocked)
            continue
        middles.append(at + size_m / 2)
        at += size_m + rng.uniform(*gap_m)
    return middles


def plots(rng: np.random.Generator, span_m: Span, length_m: Span, gap_m: float, gap_share: float) -> list[Span]:
    """Return center and length in meters of plots along a strip; some are followed by a gap of about ``gap_m``."""
    at, lots = span_m[0], []
    while at < span_m[1] - length_m[0]:
        length = min(rng.uniform(*length_m), span_m[1] - at)
        lots.append((at + length / 2, length))
        at += length + (gap_m * rng.uniform(0.6, 1.4) if rng.random() < gap_share else 0.0)
    return lots


@dataclass(frozen=True, slots=True)
class Mast:
    """A roadside sensor."""

    x_m: float  # where the sensor is
    y_m: float  # see ``x_m``
    height_m: float  # above the ground
    yaw: float  # toward the scene
    pitch: float  # downward, radians
    roll: float  # radians

    @property
    def pole(self) -> Thing:
        """The pole that carries it, 0.5 m behind it and a little taller."""
        back_x, back_y = self.x_m - 0.5 * np.cos(self.yaw), self.y_m - 0.5 * np.sin(self.yaw)
        thing = Thing("mast", (Cylinder(0.0, 0.0, 0.07, self.height_m + 0.3, material="metal"),))
        return place_at(thing, float(back_x), float(back_y), self.yaw)

    def pose(self, terrain: Terrain) -> Rigid:
        """Return ``world_from_sensor``."""
        ground = float(terrain.at([[self.x_m, self.y_m]])[0])
        return Rigid(tilted(self.yaw, self.pitch, self.roll), np.array([self.x_m, self.y_m, ground + self.height_m]))


def mast(rng: np.random.Generator, x_m: float, y_m: float, toward_m: Span) -> Mast:
    """Return a mast of 4 to 8 m at (x, y) that looks toward a point, 1 to 8° down, with a small roll.

    The roadside beam table ends at the horizon: with a larger tilt, the sensor would be blind beyond 40 m ahead.
    """
    yaw = np.arctan2(toward_m[1] - y_m, toward_m[0] - x_m) + rng.normal(0.0, 0.15)
    pitch, roll = np.deg2rad(rng.uniform(1.0, 8.0)), np.deg2rad(np.clip(rng.normal(0.0, 1.2), -4, 4))
    return Mast(x_m, y_m, rng.uniform(4.0, 8.0), float(yaw), float(pitch), float(roll))


def with_masts_of(world: World, height_m: float, pitch: float) -> World:
    """Return a world whose masts have another height in meters and pitch down in radians, without roll.

    Raises:
        ValueError: its masts are not its last things, as :func:`assembled` leaves them.
    """
    mounts = [agent.mount for agent in world.agents if agent.carrier is None]
    kept = len(world.things) - len(mounts)
    if [thing.kind for thing in world.things[kept:]] != ["mast"] * len(mounts):
        raise ValueError(f"the last objects of a world must be its {len(mounts)} masts, got others")
    posts = [
        Mast(float(mount.translation[0]), float(mount.translation[1]), height_m, mount.yaw, pitch, 0.0)
        for mount in mounts
    ]
    poses = iter(post.pose(world.terrain) for post in posts)
    agents = tuple(agent if agent.carrier is not None else replace(agent, mount=next(poses)) for agent in world.agents)
    return replace(world, things=(*world.things[:kept], *(post.pole for post in posts)), agents=agents)


def carriers(rng: np.random.Generator, plan: AgentPlan, lanes: int) -> list[list[tuple[Thing, float]]]:
    """Distribute the vehicles of the plan's agents randomly over ``lanes`` lanes."""
    dealt: list[list[tuple[Thing, float]]] = [[] for _ in range(lanes)]
    order = rng.permutation(lanes)
    for k in range(plan.moving):
        dealt[int(order[k % lanes])].append(sensor_car(rng, plan.sensor_height_m))
    return dealt


Riders = Sequence[tuple[Thing, float | None]]
"""Things with tracks, and for agents the offset of the sensor ahead of the thing's center."""


def assembled(
    name: str, terrain: Terrain, plan: AgentPlan, still: Sequence[Thing], riders: Riders, masts: Sequence[Mast] = (),
    upper: Terrain | None = None,
) -> World:  # fmt: skip
    """Assemble the world; agents are named ``vehicle_0``, … and masts ``roadside_0``, ….

    ``still`` are static things. ``upper`` is the ground of the upper level, if there is one.
    """
    agents, moving = [], _nearest(riders, masts, plan.duration_s)
    ridden = [(k, ahead) for k, (_, ahead) in enumerate(moving) if ahead is not None]
    for number, (index, ahead) in enumerate(ridden):
        mount = Rigid.from_yaw(0.0, (ahead, 0.0, plan.sensor_height_m))
        agents.append(Agent(f"vehicle_{number}", plan.sensor, mount, index))
    for number, post in enumerate(masts):
        agents.append(Agent(f"roadside_{number}", plan.roadside_sensor, post.pose(terrain)))
    things = [thing for thing, _ in moving] + [*still, *(post.pole for post in masts)]
    return World(name, terrain, tuple(things), tuple(agents), upper=upper)


def _nearest(riders: Riders, masts: Sequence[Mast], duration_s: float) -> Riders:
    """Return the agents' vehicles and those that come closest to a sensor, up to the limit of moving things."""
    times = (0.0, duration_s / 2, duration_s)
    positions = np.array([[one.pose_at(t)[:2] for t in times] for one, _ in riders]).reshape(-1, 3, 2)
    ridden = np.array([ahead is not None for _, ahead in riders], bool)
    rests = np.array([one.track is None for one, _ in riders], bool)
    posts = np.array([[(post.x_m, post.y_m)] * 3 for post in masts]).reshape(-1, 3, 2)
    eyes = np.concatenate([positions[ridden], posts])
    gaps = np.hypot(*np.moveaxis(positions[:, None] - eyes[None], -1, 0)).min(axis=(1, 2))
    order = np.argsort(np.where(ridden | rests, -1.0, gaps), kind="stable")
    kept = set(order[: MAX_MOVING + int((rests & ~ridden).sum())].tolist())
    return [rider for k, rider in enumerate(riders) if k in kept]
