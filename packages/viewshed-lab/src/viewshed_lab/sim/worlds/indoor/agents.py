"""Agents of a building: robots with sensors, walking people, sensors below the ceiling."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.geometry import Rigid
from viewshed_lab.sim.assets.furniture import bounds
from viewshed_lab.sim.assets.shapes import Box, Cylinder, Shape
from viewshed_lab.sim.assets.street import drive, person
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Agent, AgentPlan, Thing, World, tilted
from viewshed_lab.sim.worlds.indoor.floor_plan import FloorPlan
from viewshed_lab.sim.worlds.indoor.routes import Network, RoadMap, drive_route, open_floor
from viewshed_lab.sim.worlds.layout import Rect, within

ROBOT_RADIUS_M = 0.18
_CLEAR_M, _PERSON_M, _APART_M = 0.32, 0.3, 0.5
_LEAD_S, _SENSOR_M = 12.0, (0.3, 1.85)


@dataclass(frozen=True, slots=True)
class Building:
    """Parameters of a building for its agents."""

    name: str  # kind of world
    inside: Rect  # drivable floor, in meters
    ceiling_m: float  # height of the ceiling
    walkers: int  # number of walking people
    haunts: tuple[Rect, ...] = ()  # destinations of robots, in meters; anywhere if empty


def inhabited(floor_plan: FloorPlan, terrain: Terrain, building: Building, plan: AgentPlan) -> World:
    """Return the world of a finished building with robots, walking people and sensors below its ceiling.

    Raises:
        ValueError: a robot with the plan's sensor is too low to be one, or too tall for doors.
    """
    low, high = _SENSOR_M
    if plan.moving and not low <= plan.sensor_height_m <= high:
        raise ValueError(f"sensor_height_m must lie in [{low}, {high}] indoors, got {plan.sensor_height_m}; change it")
    solids = bounds(floor_plan.things)
    roads = _roads(floor_plan, building, solids, max(1.9, min(plan.sensor_height_m, high) + 0.15))
    people, roads = _walkers(floor_plan.rng, roads, building.walkers, plan.duration_s)
    robots = [
        _robot(floor_plan.rng, network, building.haunts, plan)
        for network in _territories(roads, building.haunts, plan.moving)
    ]
    hung = _hung(floor_plan.rng, roads, solids, building.ceiling_m, plan.roadside)
    mount = Rigid(np.eye(3), np.array([0.0, 0.0, plan.sensor_height_m]))
    agents = [Agent(f"robot_{k}", plan.sensor, mount, k) for k in range(len(robots))]
    agents += [Agent(f"ceiling_{k}", plan.roadside_sensor, pose) for k, pose in enumerate(hung)]
    rods = [
        Thing("rod", (Cylinder(x, y, 0.02, building.ceiling_m, z + 0.08, "metal"),), z_m=0.0)
        for x, y, z in (pose.translation.tolist() for pose in hung)
    ]
    return World(building.name, terrain, (*robots, *people, *rods, *floor_plan.things), tuple(agents), indoor=True)


def _roads(floor_plan: FloorPlan, building: Building, solids: NDArray[np.float64], below_m: float) -> RoadMap:
    """Return the road map around all solids that begin below a height; it crosses sills and thresholds, not steps."""
    near = solids[(solids[:, 4] < below_m) & (solids[:, 5] > 0.03), :4]
    near = np.concatenate([near, np.array(floor_plan.steps).reshape(-1, 4)])
    doors = [
        (one.x_m + off * (not one.along_x), one.y_m + off * one.along_x)
        for one in floor_plan.doorways
        for off in (-0.9, 0.0, 0.9)
    ]
    floor = open_floor(building.inside).without(near, _CLEAR_M)
    return RoadMap.over(floor, floor_plan.rng, np.array([*doors, *floor_plan.spots]).reshape(-1, 2))


def _walkers(rng: np.random.Generator, roads: RoadMap, count: int, duration_s: float) -> tuple[list[Thing], RoadMap]:
    """Return people who walk to and fro, and the map that stays clear of them and is still mostly connected."""
    every, people = np.ones(len(roads.nodes_m), np.bool_), list[Thing]()
    nodes = roads.largest(every)
    least = 0.6 * len(nodes)
    for _ in range(4 * count):
        path = _beat(rng, roads, nodes)
        if len(people) == count or path is None:
            continue
        left = roads.off(path, _CLEAR_M + _PERSON_M)
        kept = left.largest(every)
        if len(kept) > max(least, 0.75 * len(nodes)):
            roads, nodes = left, kept
            people.append(_walker(rng, path, duration_s))
    return people, roads


def _beat(rng: np.random.Generator, roads: RoadMap, nodes: NDArray[np.intp]) -> F64 | None:
    """Return a path of a few meters between two of the nodes, with at most one corner."""
    start = int(rng.choice(nodes))
    apart = np.hypot(*(roads.nodes_m[nodes] - roads.nodes_m[start]).T)
    goals = nodes[(apart > 2.5) & (apart < 9.0)]
    if not goals.size:
        return None
    goal, corner = int(rng.choice(goals)), int(rng.choice(goals))
    for rows in ([start, goal], [start, corner], [start, corner, goal]):
        path = roads.nodes_m[rows]
        if len(set(rows)) == len(rows) and roads.floor.sees(path[:-1], path[1:]).all():
            return path
    return None


def _walker(rng: np.random.Generator, beat: F64, duration_s: float) -> Thing:
    speed = rng.uniform(0.7, 1.5)
    length = float(np.hypot(*np.diff(beat, axis=0).T).sum())
    rounds = int((duration_s + _LEAD_S + 2.0) * speed / (2 * length)) + 1
    path = np.concatenate([beat, *[beat[-2::-1], beat[1:]] * rounds])
    pause = np.where((path == beat[0]).all(axis=1) | (path == beat[-1]).all(axis=1), rng.uniform(0, 3, len(path)), 0.0)
    return drive(person(rng, walking=True), drive_route(path, speed, 3.0, -rng.uniform(1.0, _LEAD_S), pause))


def _territories(roads: RoadMap, haunts: tuple[Rect, ...], count: int) -> list[Network]:
    """Return one network per robot: strips of the building half a meter apart, cut along its better axis."""
    best: list[NDArray[np.intp]] = []
    sizes: list[int] = []
    every = roads.largest(np.ones(len(roads.nodes_m), np.bool_))
    liked = _within(haunts, roads.nodes_m, every)
    for axis in (0, 1):
        at = roads.nodes_m[:, axis]
        edges = np.quantile(at[liked], np.linspace(0, 1, count + 1))
        edges[0], edges[-1] = -np.inf, np.inf
        parts = [roads.largest((at > low + _APART_M / 2) & (at < high - _APART_M / 2)) for low, high in pairwise(edges)]
        counts = sorted(len(np.intersect1d(part, liked)) for part in parts)
        best, sizes = (parts, counts) if counts > sizes else (best, sizes)
    return [Network.of(roads, part) for part in best]


def _robot(rng: np.random.Generator, network: Network, haunts: tuple[Rect, ...], plan: AgentPlan) -> Thing:
    """Return a robot that drives between random haunts on its network for as long as the plan lasts."""
    speed = rng.uniform(0.2, 0.8)
    nodes = _within(haunts, network.roads.nodes_m, np.flatnonzero(network.rows))
    at = _goal(rng, haunts, network.roads.nodes_m, nodes)
    path, left = [network.roads.nodes_m[[at]]], (plan.duration_s + _LEAD_S + 2.0) * speed
    while left > 0 and len(nodes) > 1:
        goal = _goal(rng, haunts, network.roads.nodes_m, nodes[nodes != at])
        leg = network.path(at, goal)
        left -= float(np.hypot(*np.diff(leg, axis=0).T).sum())
        path.append(leg[1:])
        at = goal
    track = drive_route(np.concatenate(path), speed, rng.uniform(0.5, 1.2), -rng.uniform(1.0, _LEAD_S))
    return drive(Thing("robot", robot_parts(rng, plan.sensor_height_m)), track)


def _goal(rng: np.random.Generator, haunts: tuple[Rect, ...], nodes_m: F64, rows: NDArray[np.intp]) -> int:
    """Return a random node in the first haunt, in random order, that has any of the nodes."""
    for k in rng.permutation(len(haunts)).tolist():
        inside = rows[within(haunts[k], *nodes_m[rows].T)]
        if inside.size:
            return int(rng.choice(inside))
    return int(rng.choice(rows))


def _within(haunts: tuple[Rect, ...], nodes_m: F64, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the nodes in any of the haunts, or all nodes if there are fewer than three."""
    inside = np.array([within(rect, *nodes_m[rows].T) for rect in haunts]).reshape(-1, len(rows))
    some = rows[inside.any(axis=0)]
    return some if len(some) > 2 else rows


def robot_parts(rng: np.random.Generator, sensor_height_m: float) -> tuple[Shape, ...]:
    """Return the solids of a robot below its sensor: round body, plates on rods, a mast; often an antenna behind it.

    The body ends 0.15 m below the sensor, so that beams down to 35 degrees pass its rim.
    """
    body = max(0.08, min(rng.uniform(0.12, 0.25), sensor_height_m - 0.2))
    plate = max(body + 0.02, min(rng.uniform(0.35, 0.45), sensor_height_m - 0.17))
    rods = [Cylinder(0.13 * x, 0.13 * y, 0.012, plate, body, "metal") for x, y in ((1, 0), (-0.5, 0.8), (-0.5, -0.8))]
    base = Cylinder(0.0, 0.0, ROBOT_RADIUS_M, body, 0.03, "dark_paint")
    mast = Cylinder(0.0, 0.0, 0.03, max(sensor_height_m - 0.06, plate + 0.03), body, "metal")
    seat = Box(0.02, 0.0, 0.22, 0.16, plate + 0.02, plate, 0.0, "wood")
    mount = Cylinder(0.0, 0.0, 0.05, sensor_height_m - 0.045, sensor_height_m - 0.06, "metal")
    antenna = [Cylinder(-0.14, 0.06, 0.006, sensor_height_m + 0.1, body, "rubber")] if rng.random() < 0.6 else []
    return base, mast, seat, mount, *rods, *antenna


def _hung(
    rng: np.random.Generator, roads: RoadMap, solids: NDArray[np.float64], ceiling_m: float, count: int
) -> list[Rigid]:
    """Return poses of sensors with a free view, tilted down and apart from each other."""
    poses: list[Rigid] = []
    for _ in range(count):
        z = ceiling_m - 0.3 if ceiling_m < 4.5 else rng.uniform(3.4, 4.4)
        spots = np.column_stack([roads.nodes_m, np.full(len(roads.nodes_m), z)])[_hangs_free(roads.nodes_m, solids, z)]
        some = spots[rng.integers(len(spots), size=8)]
        gaps = [min([float(np.linalg.norm(spot - pose.translation)) for pose in poses], default=0.0) for spot in some]
        tilt, yaw = rng.uniform(0.05, 0.25), rng.uniform(-np.pi, np.pi)
        poses.append(Rigid(tilted(yaw, tilt, 0.0), some[int(np.argmax(gaps))]))
    return poses


def _hangs_free(spots: F64, solids: NDArray[np.float64], z_m: float) -> NDArray[np.bool_]:
    """Return which points have no solid within 0.3 m sideways, from 0.4 m below them up to the ceiling."""
    above = solids[(solids[:, 5] > z_m - 0.4) & (solids[:, 4] < z_m + 0.15)]
    x, y = spots[:, :1], spots[:, 1:]
    near = (x > above[:, 0] - 0.3) & (x < above[:, 2] + 0.3) & (y > above[:, 1] - 0.3) & (y < above[:, 3] + 0.3)
    return np.asarray(~near.any(axis=1))
