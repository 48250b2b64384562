"""A floor of rooms along a hallway: offices or apartments, furnished, with doors open, ajar and shut."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viewshed_lab.sim.world import AgentPlan, World
from viewshed_lab.sim.worlds.indoor.agents import Building, inhabited
from viewshed_lab.sim.worlds.indoor.floor_plan import FloorPlan, Rise, floor, lay, raised_room, shrunk
from viewshed_lab.sim.worlds.indoor.furnishing import furnish, furnish_all
from viewshed_lab.sim.worlds.indoor.walls import DOORS, Opening, Wall, around, build, ceiling
from viewshed_lab.sim.worlds.layout import Rect

_MIN_SIDE_M, _DOOR_M = 3.0, 1.6
_OFFICES = ("office", "meeting", "office", "office", "lounge", "office")
_HOMES = ("living", "bedroom", "kitchen", "study", "bedroom")
_SMALL = ("bathroom", "store", "office")


@dataclass(frozen=True, slots=True)
class Shared:
    """A part of a cut between two rooms, long enough for a door."""

    cut: int
    low: int
    high: int
    start_m: float
    stop_m: float


def rooms(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a floor of rooms along a hallway: offices or apartments."""
    floor_plan = FloorPlan(rng)
    half_x, half_y, top = rng.uniform(18.0, 22.0), rng.uniform(17.0, 20.0), rng.uniform(2.45, 3.1)
    inside = (-half_x, -half_y, half_x, half_y)
    hub = (rng.uniform(-8.0, 8.0), rng.uniform(-6.0, 6.0))
    spaces, cuts = _layout(rng, inside, hub)
    doors = _doors(rng, _stretches(spaces, cuts))
    rise = _raised(rng, spaces, doors) if rng.random() < 0.5 else None
    walls = [_inner(rng, cut, [d for d in doors if d[0].cut == k], rise) for k, cut in enumerate(cuts)]
    outer = [_with_windows(rng, wall, spaces) for wall in around(inside, 0.3)]
    build(floor_plan, [*walls, *outer], top)
    if rise is not None:
        lay(floor_plan, rise)
    wishes = [(shrunk(space, 0.07), use) for space, use in zip(spaces[1:], _uses(rng, spaces[1:]), strict=True)]
    furnish(floor_plan, shrunk(spaces[0], 0.07), "hallway", (1, 3))
    lived = furnish_all(floor_plan, wishes, hub, 560)
    floor_plan.things.extend(ceiling(inside, top))
    ground = floor(rise, inside, "wood" if rng.random() < 0.6 else "concrete", "grass")
    building = Building("rooms", inside, top, 2, (*lived, spaces[0], *((rise.rect,) if rise else ())))
    return inhabited(floor_plan, ground, building, plan)


def _uses(rng: np.random.Generator, spaces: list[Rect]) -> list[str]:
    """Return the use of each room, by its size and the house: offices, or apartments with each use in turn."""
    turns = _OFFICES if rng.random() < 0.5 else _HOMES
    first, uses = int(rng.integers(len(turns))), []
    for k, (x0, y0, x1, y1) in enumerate(spaces):
        small = (x1 - x0) * (y1 - y0) < 15.0
        uses.append(_SMALL[k % len(_SMALL)] if small else turns[(first + k) % len(turns)])
    return uses


def _layout(rng: np.random.Generator, inside: Rect, hub_m: tuple[float, float]) -> tuple[list[Rect], list[Wall]]:
    """Return rooms, the hallway first, and the cuts between them; rooms farther from the hub are larger."""
    x0, y0, x1, y1 = inside
    wide, at = rng.uniform(1.7, 2.4), rng.uniform(0.4, 0.6)
    low = y0 + at * (y1 - y0) - wide / 2
    spaces, cuts = [(x0, low, x1, low + wide)], [Wall(True, low, x0, x1), Wall(True, low + wide, x0, x1)]
    waiting = [(x0, y0, x1, low), (x0, low + wide, x1, y1)]
    while waiting:
        rect = waiting.pop()
        away = np.hypot((rect[0] + rect[2]) / 2 - hub_m[0], (rect[1] + rect[3]) / 2 - hub_m[1])
        parts = _split(rng, rect, rng.uniform(24.0, 75.0) * (1.0 + (away / 15.0) ** 2), cuts)
        waiting += parts
        spaces += [] if parts else [rect]
    return spaces, cuts


def _split(rng: np.random.Generator, rect: Rect, min_m2: float, cuts: list[Wall]) -> list[Rect]:
    """Return both halves of a rectangle that is cut across its longer side, or nothing if it is small enough."""
    x0, y0, x1, y1 = rect
    wide, deep = x1 - x0, y1 - y0
    if wide * deep < min_m2 or max(wide, deep) < 2 * _MIN_SIDE_M:
        return []
    share = rng.uniform(0.32, 0.68)
    if wide > deep:
        at = float(np.clip(x0 + share * wide, x0 + _MIN_SIDE_M, x1 - _MIN_SIDE_M))
        cuts.append(Wall(False, at, y0, y1))
        return [(x0, y0, at, y1), (at, y0, x1, y1)]
    at = float(np.clip(y0 + share * deep, y0 + _MIN_SIDE_M, y1 - _MIN_SIDE_M))
    cuts.append(Wall(True, at, x0, x1))
    return [(x0, y0, x1, at), (x0, at, x1, y1)]


def _stretches(spaces: list[Rect], cuts: list[Wall]) -> list[Shared]:
    """Return every part of a cut that two rooms share and that a door fits in."""
    shared = []
    for k, cut in enumerate(cuts):
        across, along = (1, 0) if cut.along_x else (0, 1)
        low = [i for i, one in enumerate(spaces) if abs(one[across + 2] - cut.at_m) < 1e-9]
        high = [i for i, one in enumerate(spaces) if abs(one[across] - cut.at_m) < 1e-9]
        for i, j in ((i, j) for i in low for j in high):
            start = max(spaces[i][along], spaces[j][along], cut.start_m)
            stop = min(spaces[i][along + 2], spaces[j][along + 2], cut.stop_m)
            if stop - start >= _DOOR_M:
                shared.append(Shared(k, i, j, start, stop))
    return shared


def _doors(rng: np.random.Generator, stretches: list[Shared]) -> list[tuple[Shared, Opening]]:
    """Return the doors of a random spanning tree over all rooms (Kruskal), hallway first, and some more."""
    cost = rng.random(len(stretches)) - np.array([0.8 * (one.low == 0 or one.high == 0) for one in stretches])
    part = list(range(1 + max(max(one.low, one.high) for one in stretches)))
    doors = []
    for k in np.argsort(cost, kind="stable").tolist():
        one = stretches[k]
        joins = part[one.low] != part[one.high]
        if joins or rng.random() < 0.18:
            doors.append((one, _door(rng, one, joins)))
            old, new = part[one.high], part[one.low]
            part = [new if value == old else value for value in part]
    return doors


def _door(rng: np.random.Generator, one: Shared, needed: bool) -> Opening:
    width = rng.uniform(1.0, 1.2) if rng.random() < 0.8 else min(1.6, one.stop_m - one.start_m - 0.4)
    slack = (one.stop_m - one.start_m - width) / 2 - 0.15
    middle = (one.start_m + one.stop_m) / 2 + rng.uniform(-slack, slack)
    chances = (0.76, 0.06, 0.02, 0.16) if needed else (0.3, 0.25, 0.4, 0.05)
    kind = DOORS[int(rng.choice(4, p=chances))]
    return Opening(middle, width, kind, swing=int(one.low == 0) - int(one.high == 0))


def _raised(rng: np.random.Generator, spaces: list[Rect], doors: list[tuple[Shared, Opening]]) -> Rise | None:
    """Return a room off the hallway that lies a step higher, with a ramp behind its door."""
    fit = [d for d in doors if d[0].low == 0 or d[0].high == 0]
    if not fit:
        return None
    one, opening = fit[int(rng.integers(len(fit)))]
    up = one.low == 0
    door = (opening.middle_m, opening.width_m)
    return raised_room(spaces[one.high if up else one.low], 1 if up else 3, door, rng.uniform(0.08, 0.2))


def _inner(rng: np.random.Generator, cut: Wall, doors: list[tuple[Shared, Opening]], rise: Rise | None) -> Wall:
    """Return the wall on a cut with its doors; none is hung where the ramp begins."""
    openings = []
    for _, one in doors:
        at_ramp = rise is not None and cut.along_x and rise.rect[rise.side] == cut.at_m
        kind = "passage" if at_ramp and rise is not None and rise.ramp[0] < one.middle_m < rise.ramp[2] else one.kind
        openings.append(replace(one, kind=kind))
    material = "plaster" if rng.random() < 0.85 else "wood"
    return replace(cut, material=material, openings=tuple(openings))


def _with_windows(rng: np.random.Generator, wall: Wall, spaces: list[Rect]) -> Wall:
    """Return an outer wall with a window in most of the rooms behind it."""
    across, along = (1, 0) if wall.along_x else (0, 1)
    windows = []
    for one in spaces:
        touches = min(abs(one[across] - wall.at_m), abs(one[across + 2] - wall.at_m)) < wall.thick_m
        room = one[along + 2] - one[along]
        if touches and rng.random() < 0.75:
            width = rng.uniform(0.35, 0.7) * room
            windows.append(Opening((one[along] + one[along + 2]) / 2, width, "window"))
    return replace(wall, openings=tuple(windows))
