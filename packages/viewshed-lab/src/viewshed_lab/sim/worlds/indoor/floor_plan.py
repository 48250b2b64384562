"""FloorPlan: place things in a building without overlap; raised floors with ramps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from viewshed_lab.sim.assets.furniture import Group, Maker, bounds, footprint, place_group
from viewshed_lab.sim.assets.shapes import material_index
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Thing
from viewshed_lab.sim.worlds.layout import Rect, lines_of, within

_GAP_M, _OVERHEAD_M = 0.04, 2.0
_ROOM = 4096


@dataclass(frozen=True, slots=True)
class Doorway:
    """A passable opening: its center in meters, and whether the wall around it runs along x."""

    x_m: float
    y_m: float
    along_x: bool


@dataclass(slots=True)
class FloorPlan:
    """The things placed so far, and the rectangles that further things must not touch."""

    rng: np.random.Generator  # of all random choices in this building
    things: list[Thing] = field(default_factory=list)  # standing, hanging and walking things
    doorways: list[Doorway] = field(default_factory=list)  # passable openings
    steps: list[Rect] = field(default_factory=list)  # edges of the floor that a robot cannot cross
    spots: list[tuple[float, float]] = field(default_factory=list)  # points that a robot should be able to reach
    _taken: NDArray[np.float64] = field(default_factory=lambda: np.empty((_ROOM, 4)))
    _count: int = 0

    @property
    def parts(self) -> int:
        """Number of solids so far."""
        return sum(len(one.parts) for one in self.things)

    def clear(self, rect: Rect, gap_m: float = _GAP_M) -> bool:
        """Return whether a rectangle is at least ``gap_m`` meters from all things and reserved areas."""
        taken, (x0, y0, x1, y1) = self._taken[: self._count], rect
        separate = (taken[:, 0] >= x1 + gap_m) | (taken[:, 2] <= x0 - gap_m)
        separate |= (taken[:, 1] >= y1 + gap_m) | (taken[:, 3] <= y0 - gap_m)
        return bool(separate.all())

    def reserve(self, *rects: Rect) -> None:
        """Keep rectangles free of furniture."""
        for rect in rects:
            self._taken[self._count] = rect
            self._count += 1

    def add(self, group: Group) -> None:
        """Place a group where it is; overhead parts do not occupy floor."""
        self.things.extend(group)
        rows = bounds(group)
        rows = rows[rows[:, 4] < _OVERHEAD_M, :4]
        self._taken[self._count : self._count + len(rows)] = rows
        self._count += len(rows)

    def put(self, group: Group, gap_m: float = _GAP_M) -> bool:
        """Place a group where it is if its footprint is clear; return whether it was placed."""
        rect = footprint(group)
        if not self.clear(rect, gap_m):
            return False
        self.things.extend(group)
        self.reserve(rect)
        return True

    def against(self, room: Rect, maker: Maker, sides: tuple[int, ...] = (0, 1, 2, 3), corner: bool = False) -> bool:
        """Place a group with its back to a wall of a room; return whether it was placed.

        Args:
            room: inner faces of the walls.
            maker: makes the group.
            sides: walls to try: 0 at the lowest x, then 1 at the lowest y, 2 at the highest x, 3 at the highest y.
            corner: whether it should stand in a corner.
        """
        group = maker(self.rng)
        outline = footprint(group)
        for _ in range(6):
            side = sides[int(self.rng.integers(len(sides)))]
            share = float(self.rng.integers(2)) if corner else float(self.rng.random())
            spot = _at_wall(room, turned(outline, side * math.pi / 2), side, share)
            if spot is not None and self._stand(group, outline, (*spot, side * math.pi / 2)):
                return True
        return False

    def inside(self, room: Rect, maker: Maker, yaws: tuple[float, ...] = (), gap_m: float = 0.2) -> bool:
        """Place a group anywhere in a room at one of ``yaws`` or any yaw, ``gap_m`` from others, if it fits."""
        group = maker(self.rng)
        outline = footprint(group)
        for _ in range(8):
            u, v, w = self.rng.random(3).tolist()
            yaw = yaws[int(w * len(yaws))] if yaws else w * 2 * math.pi
            a, b, c, d = turned(outline, yaw)
            wide, deep = room[2] - room[0] - (c - a), room[3] - room[1] - (d - b)
            spot = (room[0] - a + u * wide, room[1] - b + v * deep, yaw)
            if min(wide, deep) > 0 and self._stand(group, outline, spot, gap_m):
                return True
        return False

    def _stand(self, group: Group, outline: Rect, pose: tuple[float, float, float], gap_m: float = _GAP_M) -> bool:
        x, y, yaw = pose
        a, b, c, d = turned(outline, yaw)
        rect = (x + a, y + b, x + c, y + d)
        if not self.clear(rect, gap_m):
            return False
        self.things.extend(place_group(group, x, y, yaw))
        self.reserve(rect)
        return True


def turned(rect: Rect, yaw: float) -> Rect:
    """Return the rectangle around one that was turned by ``yaw`` radians about the origin.

    >>> [round(value, 6) for value in turned((0.0, 0.0, 2.0, 1.0), math.pi / 2)]
    [-1.0, 0.0, 0.0, 2.0]
    """
    c, s = math.cos(yaw), math.sin(yaw)
    xs = [c * x - s * y for x, y in product(rect[::2], rect[1::2])]
    ys = [s * x + c * y for x, y in product(rect[::2], rect[1::2])]
    return min(xs), min(ys), max(xs), max(ys)


def shrunk(rect: Rect, margin_m: float) -> Rect:
    """Return a rectangle with all four sides moved inward."""
    return rect[0] + margin_m, rect[1] + margin_m, rect[2] - margin_m, rect[3] - margin_m


def _at_wall(room: Rect, outline: Rect, side: int, share: float) -> tuple[float, float] | None:
    """Return the origin of a group whose rotated footprint touches a wall, or None if it is too large."""
    gap = 1.1 * _GAP_M
    x0, y0 = room[0] + gap - outline[0], room[1] + gap - outline[1]
    x1, y1 = room[2] - gap - outline[2], room[3] - gap - outline[3]
    if x1 < x0 or y1 < y0:
        return None
    if side % 2:
        return x0 + share * (x1 - x0), y0 if side == 1 else y1
    return x0 if side == 0 else x1, y0 + share * (y1 - y0)


_EDGE_M = 0.01
_HALF_M, _SLOPE = 60.0, 0.09

Heights = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class Rise:
    """A raised part of the floor."""

    rect: Rect  # its area, in meters
    height_m: float  # above the floor around it
    ramp: Rect  # area within ``rect`` in which the floor rises from 0 to ``height_m``
    side: int  # end at which the ramp begins: 0 lowest x, 1 lowest y, 2 highest x, 3 highest y; a side of ``rect``

    def steps(self) -> list[Rect]:
        """Return the edges that are too high for wheels: around it except where the ramp begins, and along the ramp."""
        x0, y0, x1, y1 = self.rect
        a, b, c, d = self.ramp
        sides: list[Rect] = [(x0, y0, x0, y1), (x0, y0, x1, y0), (x1, y0, x1, y1), (x0, y1, x1, y1)]
        if self.side % 2:
            at = sides[self.side][1]
            split: list[Rect] = [(x0, at, a, at), (c, at, x1, at), (a, b, a, d), (c, b, c, d)]
        else:
            at = sides[self.side][0]
            split = [(at, y0, at, b), (at, d, at, y1), (a, b, c, b), (a, d, c, d)]
        return [*sides[: self.side], *sides[self.side + 1 :], *split]

    def path(self) -> list[tuple[float, float]]:
        """Return points (x, y) in meters up the ramp: before it, three on it, behind it."""
        a, b, c, d = self.ramp
        long = (d - b) if self.side % 2 else (c - a)
        ahead = [-0.6, 0.1 * long, 0.5 * long, 0.9 * long, long + 0.6]
        if self.side % 2:
            return [((a + c) / 2, b + u if self.side == 1 else d - u) for u in ahead]
        return [(a + u if self.side == 0 else c - u, (b + d) / 2) for u in ahead]


def raised_room(rect: Rect, side: int, door_m: tuple[float, float], height_m: float) -> Rise:
    """Return a room that lies higher, with a ramp behind a door in one of its sides.

    Args:
        rect: the room, in meters.
        side: which wall has the door, as in :class:`Rise`.
        door_m: middle and width of the door along that wall.
        height_m: how much higher.
    """
    low, high = door_m[0] - door_m[1] / 2, door_m[0] + door_m[1] / 2
    x0, y0, x1, y1 = rect
    long = min(height_m / _SLOPE, (y1 - y0 if side % 2 else x1 - x0) - 1.2)
    ramp = ((x0, low, x0 + long, high), (low, y0, high, y0 + long),
            (x1 - long, low, x1, high), (low, y1 - long, high, y1))[side]  # fmt: skip
    return Rise(rect, height_m, ramp, side)


def lay(floor_plan: FloorPlan, rise: Rise) -> None:
    """Add a raised floor to a floor plan: its steps, its ramp, and room to turn at both ends of the ramp."""
    floor_plan.steps += rise.steps()
    floor_plan.spots += rise.path()
    floor_plan.reserve(rise.ramp, *((x - 0.5, y - 0.5, x + 0.5, y + 0.5) for x, y in (rise.path()[0], rise.path()[-1])))


def floor(rise: Rise | None, inside: Rect, material: str, outside: str = "asphalt") -> Terrain:
    """Return the ground of a building: level at 0 except for ``rise``, of ``material`` within ``inside``."""
    xs, ys = [-_HALF_M, inside[0], inside[2], _HALF_M], [-_HALF_M, inside[1], inside[3], _HALF_M]
    if rise is not None:
        for k, lines in ((0, xs), (1, ys)):
            for rect in (rise.rect, rise.ramp):
                lines += [rect[k] - _EDGE_M, rect[k] + _EDGE_M, rect[k + 2] - _EDGE_M, rect[k + 2] + _EDGE_M]
    inner, beyond = material_index(material), material_index(outside)

    def made_of(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.uint8]:
        return np.where(within(inside, x, y), inner, beyond).astype(np.uint8)

    return Terrain.of(lines_of(xs, _HALF_M, 1e-6), lines_of(ys, _HALF_M, 1e-6), _heights(rise), made_of)


def _heights(rise: Rise | None) -> Heights:
    def height(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        if rise is None:
            return np.zeros_like(x)
        a, b, c, d = rise.ramp
        share = ((x - a) / (c - a), (y - b) / (d - b), (c - x) / (c - a), (d - y) / (d - b))[rise.side]
        on_ramp = within(rise.ramp, x, y)
        raised = np.where(on_ramp, rise.height_m * np.clip(share, 0.0, 1.0), rise.height_m)
        return np.where(within(rise.rect, x, y), raised, 0.0)

    return height
