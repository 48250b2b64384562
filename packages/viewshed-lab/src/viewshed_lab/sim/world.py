"""Worlds: ground, static and moving things on it, and agents with sensors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed_lab.sim.assets.shapes import KINDS, Shape, material_index
from viewshed_lab.sim.terrain import Terrain

GROUND, NOTHING = -1, -2
"""Thing index of a beam that hit the ground, or nothing within range."""

DECK = "deck"
"""Kind of a thing whose top is ground for the things on the upper level of a world."""

_DT_S, _WHEELBASE_M = 0.05, 3.0
"""Half step of the central differences for velocities; length over which the ground tilts a vehicle."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Position and yaw over time: linear between knots, constant before the first and after the last."""

    t_s: NDArray[np.float64]  # (k,) ascending seconds
    xy_m: NDArray[np.float64]  # (k, 2) meters in the world
    yaw: NDArray[np.float64]  # (k,) radians, continuous (may exceed π)

    def __post_init__(self) -> None:
        for name in ("t_s", "xy_m", "yaw"):
            array = np.array(getattr(self, name), np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        count = len(self.t_s)
        if count < 1 or self.xy_m.shape != (count, 2) or self.yaw.shape != (count,) or (np.diff(self.t_s) <= 0).any():
            raise ValueError("a track must have ascending t_s (k,), xy_m (k, 2) and yaw (k,)")

    def at(self, t_s: float) -> tuple[float, float, float]:
        """Return x and y in meters and yaw in radians at ``t_s``."""
        x, y, yaw = self.over(np.array([t_s]))[0]
        return float(x), float(y), float(yaw)

    def over(self, t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (n, 3) x and y in meters and yaw in radians at times (n,)."""
        out = np.empty((len(t_s), 3))
        interpolate_track(np.asarray(t_s, np.float64), self.t_s, self.knots, 0, len(self.t_s), out)
        return out

    @property
    def knots(self) -> NDArray[np.float64]:
        """(k, 3) x, y and yaw."""
        return np.column_stack([self.xy_m, self.yaw])


@dataclass(frozen=True, slots=True)
class Thing:
    """A static or moving object on the ground."""

    kind: str  # for example ``car``
    parts: tuple[Shape, ...]  # solids in the thing's frame: x forward, y left, z up from the ground below its origin
    x_m: float = 0.0  # of its origin in the world (at rest)
    y_m: float = 0.0  # see ``x_m``
    yaw: float = 0.0  # heading in the world (at rest)
    track: Track | None = None  # motion over time, or None at rest
    tilts: bool = False  # whether it follows the ground's slope (vehicles) or stands upright
    z_m: float | None = None  # height of its origin in the world, or None for the ground's
    upper: bool = False  # whether it is on the world's upper level, if there is one

    def pose_at(self, t_s: float) -> tuple[float, float, float]:
        """Return x and y in meters and yaw in radians at ``t_s``."""
        return (self.x_m, self.y_m, self.yaw) if self.track is None else self.track.at(t_s)


@dataclass(frozen=True, slots=True, eq=False)
class Agent:
    """A sensor on a vehicle or on a mast."""

    name: str
    sensor: str  # name of the beam table
    mount: Rigid  # ``carrier_from_sensor``, or ``world_from_sensor`` without a carrier
    carrier: int | None = None  # index of the thing that carries the sensor, or None for a mast


@dataclass(frozen=True, slots=True)
class AgentPlan:
    """Sensors that a world must have."""

    moving: int = 1  # driving vehicles (outdoors) or robots (indoors) with a sensor
    roadside: int = 0  # sensors on masts, elevated and tilted
    sensor: str = "hdl32e"  # beam table of the moving sensors
    roadside_sensor: str = "roadside"  # beam table of the sensors on masts
    sensor_height_m: float = 1.84  # of the moving sensors, above the ground
    duration_s: float = 20.0  # required duration of the tracks

    def __post_init__(self) -> None:
        if min(self.moving, self.roadside) < 0 or self.moving + self.roadside < 1:
            raise ValueError(f"a plan needs at least one agent, got {self.moving} moving and {self.roadside} roadside")
        if not (self.duration_s > 0 and self.sensor_height_m > 0):
            raise ValueError("duration_s and sensor_height_m must be positive")


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """All solids of a world at one time, as arrays, in the world frame."""

    terrain: Terrain  # the ground
    kind: NDArray[np.uint8]  # (n,) uint8: ``BOX``, ``CYLINDER`` or ``ELLIPSOID``
    center_m: NDArray[np.float64]  # (n, 3) float64
    rotation: NDArray[np.float64]  # (n, 3, 3) float64, ``world_from_shape``
    half_m: NDArray[np.float64]  # (n, 3) float64 half sizes along the shape's own axes
    velocity_mps: NDArray[np.float64]  # (n, 3) float64; solids do not turn within a revolution
    material: NDArray[np.uint8]  # (n,) uint8 rows of ``MATERIALS``
    thing: NDArray[np.int32]  # (n,) int32 index of the thing of each solid


@dataclass(frozen=True, eq=False)
class World:
    """Ground, things and agents, made from a seed."""

    name: str  # kind of world
    terrain: Terrain  # the ground
    things: tuple[Thing, ...] = ()  # all static and moving things, including the agents' vehicles
    agents: tuple[Agent, ...] = ()  # sensors
    indoor: bool = False  # whether it is a building
    # in a world with two levels the ground of the upper one: the top of its decks, and the terrain beside them. The
    # decks are solids, things of kind :data:`DECK`.
    upper: Terrain | None = None

    def ground_of(self, agent: Agent | None) -> Terrain:
        """Return the ground under an agent's targets: the upper level for an agent there, otherwise the terrain.

        On the upper level, a cell beside the deck has the land below as its ground. Masts and agents below a deck use
        the terrain.
        """
        if self.upper is None or agent is None or agent.carrier is None or not self.things[agent.carrier].upper:
            return self.terrain
        return self.upper

    def pose_of(self, thing: int, t_s: float) -> Rigid:
        """Return ``world_from_thing`` at ``t_s``."""
        rotation, origin = self._poses(np.array([t_s]), np.array([thing]))
        return Rigid(rotation[0, 0], origin[0, 0])

    def world_from_sensor(self, agent: Agent, t_s: float) -> Rigid:
        """Return the pose of an agent's sensor at ``t_s``."""
        rotation, origin = self.sensor_path(agent, np.array([t_s]))
        return Rigid(rotation[0], origin[0])

    def sensor_path(self, agent: Agent, t_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return rotations (n, 3, 3) and origins (n, 3) of ``world_from_sensor`` at times (n,)."""
        mount, carrier = agent.mount, agent.carrier
        if carrier is None:
            return np.tile(mount.rotation, (len(t_s), 1, 1)), np.tile(mount.translation, (len(t_s), 1))
        turns, positions = (part[:, 0] for part in self._poses(t_s, np.array([carrier])))
        origins = [turn @ mount.translation + position for turn, position in zip(turns, positions, strict=True)]
        return np.stack([turn @ mount.rotation for turn in turns]), np.stack(origins)

    def snapshot(self, t_s: float) -> Snapshot:
        """Return all solids at ``t_s``, with their velocities."""
        (center, rotation), (kind, thing, material, half) = self._rest, self._parts[:4]
        velocity = np.zeros((len(kind), 3))
        things, rows, which = self._moving
        if rows.size:
            turn, origin = self._poses(np.array([t_s, t_s - _DT_S, t_s + _DT_S]), things)
            center, rotation = center.copy(), rotation.copy()
            center[rows], rotation[rows] = self._solid_poses(rows, turn[0, which], origin[0, which])
            velocity[rows] = ((origin[2] - origin[1]) / (2 * _DT_S))[which]
        return Snapshot(self.terrain, kind, center, rotation, half, velocity, material, thing)

    @cached_property
    def _courses(self) -> tuple[Any, ...]:
        """x, y, yaw at rest, height (NaN: the ground's), tilts and upper flags, and knots of all things."""
        tracks = [thing.track for thing in self.things]
        counts = np.array([0 if track is None else len(track.t_s) for track in tracks], np.intp)
        spans = np.stack([np.cumsum(counts) - counts, np.cumsum(counts)], axis=-1)
        at_rest = np.array([(thing.x_m, thing.y_m, thing.yaw) for thing in self.things]).reshape(-1, 3)
        z_m = np.array([np.nan if thing.z_m is None else thing.z_m for thing in self.things])
        moving = [track for track in tracks if track is not None]
        times = np.concatenate([np.zeros(0), *(track.t_s for track in moving)])
        knots = (times, np.concatenate([np.zeros((0, 3)), *(track.knots for track in moving)]))
        flags = np.array([(thing.tilts, thing.upper) for thing in self.things], np.bool_).reshape(-1, 2).T
        return at_rest, z_m, flags, spans, knots

    @cached_property
    def _moving(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Indices of moving things, rows of their solids, and for each row the position of its thing in the first."""
        things = np.flatnonzero([thing.track is not None for thing in self.things])
        rows = np.flatnonzero(np.isin(self._parts[1], things))
        return things, rows, np.searchsorted(things, self._parts[1][rows])

    @cached_property
    def _parts(self) -> tuple[NDArray[np.uint8], NDArray[np.int32], NDArray[np.uint8], NDArray[np.float64],
                              NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
        """Kind, thing, material, half sizes, and center and yaw in the thing's frame, of every solid."""
        parts = [(index, part) for index, thing in enumerate(self.things) for part in thing.parts]
        kind = np.array([KINDS[type(part)] for _, part in parts], np.uint8)
        thing = np.array([index for index, _ in parts], np.int32)
        material = np.array([material_index(part.material) for _, part in parts], np.uint8)
        half = np.array([part.half_sizes_m for _, part in parts]).reshape(-1, 3)
        center = np.array([(part.x_m, part.y_m, (part.top_m + part.bottom_m) / 2) for _, part in parts]).reshape(-1, 3)
        return kind, thing, material, half, center, np.array([part.yaw for _, part in parts])

    @cached_property
    def _rest(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Centers and rotations of all solids at time 0."""
        thing = self._parts[1]
        rotation, origin = self._poses(np.zeros(1), np.arange(len(self.things)))
        return self._solid_poses(np.arange(len(thing)), rotation[0, thing], origin[0, thing])

    def _solid_poses(
        self, rows: NDArray[np.intp], rotation: NDArray[np.float64], origin: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        center, yaw = self._parts[4][rows], self._parts[5][rows]
        return (rotation @ center[..., None])[..., 0] + origin, rotation @ turns_of(yaw)

    def _poses(
        self, t_s: NDArray[np.float64], which: NDArray[np.intp]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return rotations (n, k, 3, 3) and origins (n, k, 3) of k things at n times."""
        at_rest, z_m, (tilts, upper), spans, (times, knots) = self._courses
        positions = np.empty((len(t_s), len(which), 3))
        poses_of_things(t_s, which, at_rest, spans, times, knots, positions)
        origin, rotation = positions.copy(), turns_of(positions[..., 2])
        origin[..., 2] = self.terrain.at(positions)
        for ground, rows in ((self.terrain, ~upper[which]), (self.upper, upper[which])):
            if ground is None or not rows.any():
                continue
            if ground is not self.terrain:
                origin[:, rows, 2] = ground.at(positions[:, rows])
            tilting = np.flatnonzero(tilts[which] & rows)
            if tilting.size:
                normals = ground.normals_at(positions[:, tilting], _WHEELBASE_M)
                rotation[:, tilting] = _tilted_by_ground(normals, positions[:, tilting, 2])
        origin[..., 2] = np.where(np.isnan(z_m[which]), origin[..., 2], z_m[which])
        return rotation, origin


def tilted(yaw: float, pitch: float, roll: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of a sensor with yaw to the left, pitch down, and roll, in radians."""
    c, s, cr, sr = np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    down = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    lean = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return np.asarray(Rigid.from_yaw(yaw).rotation @ down @ lean)


def turns_of(yaw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotations (…, 3, 3) about z by yaw (…), radians."""
    turns = np.zeros((*yaw.shape, 3, 3))
    turns[..., 0, 0] = turns[..., 1, 1] = np.cos(yaw)
    turns[..., 1, 0] = np.sin(yaw)
    turns[..., 0, 1] = -turns[..., 1, 0]
    turns[..., 2, 2] = 1.0
    return turns


def _tilted_by_ground(normals: NDArray[np.float64], yaw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotations (…, 3, 3) with heading ``yaw`` (…) and z along the ground's normals (…, 3)."""
    forward = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    forward = forward - (forward * normals).sum(axis=-1, keepdims=True) * normals
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    return np.stack([forward, np.cross(normals, forward), normals], axis=-1)


@njit(cache=True, nogil=True, error_model="numpy")
def poses_of_things(t_s: Any, which: Any, at_rest: Any, spans: Any, times: Any, values: Any, out: Any) -> None:
    """Fill x, y and yaw (n, k, 3) of k things ``which`` at n times, from their rest pose or their knots.

    For all things: ``at_rest`` (things, 3) x, y, yaw; ``spans`` (things, 2) first and last knot; ``times`` (knots,) and
    ``values`` (knots, 3).
    """
    for k in range(which.shape[0]):
        thing = which[k]
        if spans[thing, 0] < spans[thing, 1]:
            interpolate_track(t_s, times, values, spans[thing, 0], spans[thing, 1], out[:, k])
        else:
            out[:, k] = at_rest[thing]


@njit(cache=True, nogil=True, error_model="numpy")
def interpolate_track(t_s: Any, times: Any, values: Any, begin: Any, end: Any, out: Any) -> None:
    """Fill x, y and yaw (n, 3) at n times, linear between the knots ``begin`` to ``end``, constant outside."""
    for n in range(t_s.shape[0]):
        t = t_s[n]
        j = begin + np.searchsorted(times[begin:end], t, side="right") - 1
        for k in range(3):
            if j < begin:
                out[n, k] = values[begin, k]
            elif j == end - 1 or times[j] == t:
                out[n, k] = values[j, k]
            else:
                slope = (values[j + 1, k] - values[j, k]) / (times[j + 1] - times[j])
                out[n, k] = slope * (t - times[j]) + values[j, k]
