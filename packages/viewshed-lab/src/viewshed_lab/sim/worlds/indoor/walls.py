"""Walls with thickness, and their openings: doors with frame, lintel and leaf, windows, panes and niches."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed_lab.sim.assets.furniture import DOOR_TOP_M, Group, bounds, door, footprint, place_group
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.world import Thing
from viewshed_lab.sim.worlds.indoor.floor_plan import Doorway, FloorPlan
from viewshed_lab.sim.worlds.layout import Rect

DOORS = ("open", "ajar", "shut", "passage")
"""Openings with a lintel above :data:`DOOR_TOP_M`; the others are ``window`` and ``pane``."""

_POST_M, _ZONE_M = 0.06, 0.9
_PANE_M = 0.02


@dataclass(frozen=True, slots=True)
class Opening:
    """A gap in a wall."""

    middle_m: float  # center along the wall, in the world's x or y
    width_m: float  # between the ends of the wall on both sides
    # one of ``DOORS``, ``window``, ``pane`` for glass from the floor up, ``gate`` for a wide gap, or ``roller`` for one
    # that is shut
    kind: str = "open"
    top_m: float = 2.4  # its upper edge, except for doors
    swing: int = 0  # side to which a door opens: 1 the higher x or y, -1 the lower, 0 either


@dataclass(frozen=True, slots=True)
class Wall:
    """A straight wall along x or y."""

    along_x: bool  # whether it runs along x
    at_m: float  # y of its center plane if it runs along x, else x
    start_m: float  # lower end along itself
    stop_m: float  # upper end
    thick_m: float = 0.12  # thickness
    material: str = "plaster"  # a name of ``MATERIALS``
    openings: tuple[Opening, ...] = ()  # gaps that do not overlap

    def box(self, start_m: float, stop_m: float, z_m: tuple[float, float], material: str, thick_m: float) -> Box:
        """Return the box that fills a stretch of the wall from ``z_m[0]`` to ``z_m[1]``, all in meters."""
        middle, length = (start_m + stop_m) / 2, stop_m - start_m
        if self.along_x:
            return Box(middle, self.at_m, length, thick_m, z_m[1], z_m[0], 0.0, material)
        return Box(self.at_m, middle, thick_m, length, z_m[1], z_m[0], 0.0, material)

    def rect(self, opening: Opening, reach_m: float) -> Rect:
        """Return the rectangle of an opening, extended to both sides of the wall, in meters."""
        u, half = opening.middle_m, opening.width_m / 2
        if self.along_x:
            return u - half, self.at_m - reach_m, u + half, self.at_m + reach_m
        return self.at_m - reach_m, u - half, self.at_m + reach_m, u + half


def wall_parts(wall: Wall, top_m: float) -> tuple[Box, ...]:
    """Return the solids of a wall up to ``top_m``: pieces between openings, lintels, frames, sills and panes."""
    parts, at = [], wall.start_m
    for one in sorted(wall.openings, key=lambda opening: opening.middle_m):
        start, stop = one.middle_m - one.width_m / 2, one.middle_m + one.width_m / 2
        if start - at > 0.01:
            parts.append(wall.box(at, start, (-1.0, top_m), wall.material, wall.thick_m))
        parts.extend(_filled(wall, one, start, stop, top_m))
        at = stop
    if wall.stop_m - at > 0.01:
        parts.append(wall.box(at, wall.stop_m, (-1.0, top_m), wall.material, wall.thick_m))
    return tuple(parts)


def _filled(wall: Wall, one: Opening, start: float, stop: float, top_m: float) -> Iterator[Box]:
    head, thick = (DOOR_TOP_M if one.kind in DOORS else min(one.top_m, top_m - 0.05)), wall.thick_m
    yield wall.box(start, stop, (head, top_m), wall.material, thick)
    if one.kind in DOORS:
        for edge in (start, stop - _POST_M):
            yield wall.box(edge, edge + _POST_M, (0.0, head), "wood", thick + 0.04)
    elif one.kind == "window":
        yield wall.box(start, stop, (-1.0, 0.9), wall.material, thick)
        yield wall.box(start, stop, (0.9, head), "glass", _PANE_M)
    elif one.kind == "roller":
        yield wall.box(start, stop, (-1.0, head), "metal", 0.06)
    elif one.kind == "pane":
        yield wall.box(start, stop, (-1.0, 0.08), "metal", 0.08)
        yield wall.box(start, stop, (0.08, head), "glass", _PANE_M)
        for edge in np.linspace(start + 0.025, stop - 0.025, max(2, round((stop - start) / 2.2) + 1)).tolist():
            yield wall.box(edge - 0.025, edge + 0.025, (0.08, head), "metal", 0.07)


def build(floor_plan: FloorPlan, walls: Iterable[Wall], top_m: float) -> None:
    """Add walls up to ``top_m`` meters to a floor plan, hang the doors and keep the doorways free."""
    walls = list(walls)
    gates = [wall.rect(one, 1.6) for wall in walls for one in wall.openings if one.kind in ("gate", "roller")]
    panes = [wall.rect(one, 0.15) for wall in walls for one in wall.openings if one.kind == "pane"]
    doors = [(k, wall, one) for k, wall in enumerate(walls) for one in wall.openings if one.kind in DOORS]
    zones = np.array([wall.rect(one, wall.thick_m / 2 + _ZONE_M) for _, wall, one in doors]).reshape(-1, 4)
    shells = [Thing("wall", wall_parts(wall, top_m), z_m=0.0) for wall in walls]
    solids = [bounds((shell,))[:, :4] for shell in shells]
    for row, (k, wall, one) in enumerate(doors):
        middle = (one.middle_m, wall.at_m) if wall.along_x else (wall.at_m, one.middle_m)
        floor_plan.doorways.append(Doorway(*middle, wall.along_x))
        others = np.concatenate([zones[:row], zones[row + 1 :], *solids[:k], *solids[k + 1 :]])
        if one.kind == "passage" or not _hang(floor_plan, wall, one, others):
            _threshold(floor_plan, wall, one)
    floor_plan.reserve(*gates, *panes, *((a, b, c, d) for a, b, c, d in zones.tolist()))
    for shell in shells:
        floor_plan.add((shell,))


def _hang(floor_plan: FloorPlan, wall: Wall, one: Opening, others: NDArray[np.float64]) -> bool:
    """Hang the leaf of a door so that it blocks no other doorway and touches no other leaf or wall, if possible."""
    angle = {"open": floor_plan.rng.uniform(1.5, 1.9), "ajar": floor_plan.rng.uniform(0.25, 1.1), "shut": 0.0}[one.kind]
    for path in floor_plan.rng.permutation(4).tolist():
        if one.swing == (-1 if path % 2 else 1):
            continue
        leaf = _leaf(wall, one, angle, path)
        x0, y0, x1, y1 = footprint(leaf)
        disjoint = (others[:, 0] >= x1) | (others[:, 2] <= x0) | (others[:, 1] >= y1) | (others[:, 3] <= y0)
        if disjoint.all() and floor_plan.clear((x0, y0, x1, y1)):
            floor_plan.add(leaf)
            return True
    return False


def _leaf(wall: Wall, one: Opening, angle: float, path: int) -> Group:
    """Return the leaf of a door: ``way`` 0 to 3 says at which end it is hinged and to which side it opens."""
    far, side = path // 2, 1 if path % 2 else -1
    offset = (one.width_m / 2 - _POST_M - 0.03) * (1 if far else -1)
    across = side * (wall.thick_m / 2 + 0.045)
    turn = (math.pi - side * angle) if far else side * angle
    leaf = place_group(door(one.width_m - 2 * _POST_M - 0.04, 0.0), offset, across, turn)
    if wall.along_x:
        return place_group(leaf, one.middle_m, wall.at_m)
    return place_group(leaf, wall.at_m, one.middle_m, math.pi / 2)


def _threshold(floor_plan: FloorPlan, wall: Wall, one: Opening) -> None:
    if floor_plan.rng.random() < 0.4:
        half = one.width_m / 2 - _POST_M
        heights = (-0.01, floor_plan.rng.uniform(0.008, 0.02))
        strip = wall.box(one.middle_m - half, one.middle_m + half, heights, "metal", 0.1)
        floor_plan.things.append(Thing("threshold", (strip,)))


def around(rect: Rect, thick_m: float, material: str = "plaster") -> list[Wall]:
    """Return four outer walls whose inner faces are the sides of ``rect``: lowest x, lowest y, highest x, highest y."""
    x0, y0, x1, y1 = rect
    h = thick_m / 2
    return [
        Wall(False, x0 - h, y0 - thick_m, y1 + thick_m, thick_m, material),
        Wall(True, y0 - h, x0, x1, thick_m, material),
        Wall(False, x1 + h, y0 - thick_m, y1 + thick_m, thick_m, material),
        Wall(True, y1 + h, x0, x1, thick_m, material),
    ]


def ceiling(rect: Rect, bottom_m: float, material: str = "plaster") -> Group:
    """Return the ceiling over ``rect``, ``bottom_m`` above the floor."""
    x0, y0, x1, y1 = rect
    slab = Box((x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0, bottom_m + 0.25, bottom_m, 0.0, material)
    return (Thing("ceiling", (slab,), z_m=0.0),)
