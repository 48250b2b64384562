"""Floors: flat, with a part that is raised by a step and reached over a ramp."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed_lab.sim.assets.shapes import material_index
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.worlds.indoor.floor_plan import FloorPlan, Rect

_EDGE_M = 0.01

_HALF_M, _SLOPE = 60.0, 0.09

Heights = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class Rise:
    """A raised part of the floor."""

    rect: Rect  # where, in meters
    height_m: float  # above the floor around it
    ramp: Rect  # where the floor rises from 0 at one end to ``height_m`` at the other, within ``rect``
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
    """Note a raised floor on a floor plan: its steps, its ramp, and room to turn at both ends of that."""
    floor_plan.steps += rise.steps()
    floor_plan.spots += rise.path()
    floor_plan.reserve(rise.ramp, *((x - 0.5, y - 0.5, x + 0.5, y + 0.5) for x, y in (rise.path()[0], rise.path()[-1])))


def floor(rise: Rise | None, inside: Rect, material: str, outside: str = "asphalt") -> Terrain:
    """Return the ground of a building: level at 0 but for ``rise``, of ``material`` within ``inside``."""
    xs, ys = [-_HALF_M, inside[0], inside[2], _HALF_M], [-_HALF_M, inside[1], inside[3], _HALF_M]
    if rise is not None:
        for k, lines in ((0, xs), (1, ys)):
            for rect in (rise.rect, rise.ramp):
                lines += [rect[k] - _EDGE_M, rect[k] + _EDGE_M, rect[k + 2] - _EDGE_M, rect[k + 2] + _EDGE_M]
    within, beyond = material_index(material), material_index(outside)

    def made_of(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.uint8]:
        inner = (x > inside[0]) & (x < inside[2]) & (y > inside[1]) & (y < inside[3])
        return np.where(inner, within, beyond).astype(np.uint8)

    return Terrain.of(_apart(xs), _apart(ys), _heights(rise), made_of)


def _apart(lines: list[float]) -> NDArray[np.float64]:
    """Return the lines in ascending order without those that differ by rounding only."""
    ordered = np.sort(np.array(lines))
    return ordered[np.r_[True, np.diff(ordered) > 1e-6]]


def _heights(rise: Rise | None) -> Heights:
    def height(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        if rise is None:
            return np.zeros_like(x)
        a, b, c, d = rise.ramp
        share = ((x - a) / (c - a), (y - b) / (d - b), (c - x) / (c - a), (d - y) / (d - b))[rise.side]
        on_ramp = _within(rise.ramp, x, y)
        raised = np.where(on_ramp, rise.height_m * np.clip(share, 0.0, 1.0), rise.height_m)
        return np.where(_within(rise.rect, x, y), raised, 0.0)

    return height


def _within(rect: Rect, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (x > rect[0]) & (x < rect[2]) & (y > rect[1]) & (y < rect[3])
