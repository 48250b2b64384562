"""A grid of corridors between blocks of offices: doors, niches, panes of glass, fire doors, people."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from viewshed_lab.sim.assets.furniture import standing
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.indoor.agents import Building, inhabited
from viewshed_lab.sim.worlds.indoor.floor_plan import FloorPlan, Rise, floor, lay, raised_room
from viewshed_lab.sim.worlds.indoor.furnishing import furnish, furnish_all
from viewshed_lab.sim.worlds.indoor.walls import DOORS, Opening, Wall, around, build, ceiling
from viewshed_lab.sim.worlds.layout import Rect, Span

_THICK_M, _NICHE_M = 0.12, 0.9
_USES = ("office", "office", "meeting", "office", "store", "lounge")


@dataclass(frozen=True, slots=True)
class Office:
    """A room in a block."""

    rect: Rect  # outer faces of its walls, in meters
    free: tuple[int, ...]  # sides that face a corridor: 0 lowest x, 1 lowest y, 2 highest x, 3 highest y

    @property
    def inner(self) -> Rect:
        """Inner faces of its walls."""
        x0, y0, x1, y1 = self.rect
        return x0 + _THICK_M, y0 + _THICK_M, x1 - _THICK_M, y1 - _THICK_M

    def face(self, side: int) -> Wall:
        """Return the wall on one side, without openings."""
        inward = _THICK_M / 2 if side < 2 else -_THICK_M / 2
        start, stop = (self.rect[0], self.rect[2]) if side % 2 else (self.rect[1], self.rect[3])
        return Wall(side % 2 == 1, self.rect[side] + inward, start, stop, _THICK_M)


def corridors(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a floor of offices in blocks, with a grid of corridors between them."""
    floor_plan, top = FloorPlan(rng), rng.uniform(2.5, 2.9)
    xs, ys = _spans(rng, rng.uniform(19.0, 22.0)), _spans(rng, rng.uniform(17.0, 20.0))
    inside = (xs[0][0], ys[0][0], xs[-1][1], ys[-1][1])
    offices, walls = _offices(rng, xs, ys)
    walls += _outer(rng, inside, xs, ys)
    niches: list[tuple[Rect, int]] = []
    entries: list[tuple[Office, int]] = []
    for office in offices:
        entries.append((office, office.free[int(rng.integers(len(office.free)))]))
        walls += _faces(rng, *entries[-1], niches)
    rise = _raised(rng, walls, entries) if rng.random() < 0.5 else None
    passages: list[tuple[Rect, tuple[int, int]]] = [  # each stretch between two crossings, and its sides with walls
        *(((a[1], y[0], b[0], y[1]), (0, 2)) for (a, b), y in product(pairwise(xs), ys)),
        *(((x[0], a[1], x[1], b[0]), (1, 3)) for x, (a, b) in product(xs, pairwise(ys))),
    ]
    build(floor_plan, [*walls, *_fire_doors(rng, passages)], top)
    if rise is not None:
        lay(floor_plan, rise)
    for rect, side in niches:
        furnish(floor_plan, rect, "niche", (side,))
    for rect, sides in passages:
        furnish(floor_plan, rect, "corridor", sides)
        if rng.random() < 0.12:
            floor_plan.inside(rect, standing)
    hub = (rng.uniform(-8.0, 8.0), rng.uniform(-8.0, 8.0))
    lived = furnish_all(floor_plan, [(one.inner, _USES[k % len(_USES)]) for k, one in enumerate(offices)], hub, 520)
    floor_plan.things.extend((*ceiling(inside, top), *_ducts(rng, passages, top)))
    haunts = (*(rect for rect, _ in passages), *lived, *((rise.rect,) * 3 if rise else ()))
    building = Building("corridors", inside, top, 4, haunts)
    return inhabited(floor_plan, floor(rise, inside, "concrete", "grass"), building, plan)


def _spans(rng: np.random.Generator, half_m: float) -> list[Span]:
    """Return where blocks begin and end along one axis, with corridors between them."""
    count = int(rng.integers(3, 5))
    wide, share = rng.uniform(1.8, 2.8, count - 1), rng.uniform(0.75, 1.25, count)
    long = share / share.sum() * (2 * half_m - wide.sum())
    stops = -half_m + np.cumsum(long) + np.r_[0.0, np.cumsum(wide)]
    return [(stop - size, stop) for stop, size in zip(stops.tolist(), long.tolist(), strict=True)]


def _offices(rng: np.random.Generator, xs: list[Span], ys: list[Span]) -> tuple[list[Office], list[Wall]]:
    """Return the offices of all blocks and the walls between those of one block."""
    offices, walls = [], []
    for (i, x), (j, y) in product(enumerate(xs), enumerate(ys)):
        free = [k for k, has in enumerate((i > 0, j > 0, i < len(xs) - 1, j < len(ys) - 1)) if has]
        axis = next((axis for axis in rng.permutation(2).tolist() if axis in free or axis + 2 in free), 0)
        low, high = (y, x)[axis]
        if high - low < 7.0 or rng.random() < 0.35:
            offices.append(Office((x[0], y[0], x[1], y[1]), tuple(free)))
            continue
        cut = low + (high - low) * rng.uniform(0.38, 0.62)
        across = (x, y)[axis]
        walls.append(Wall(axis == 0, cut, *across))
        inner = (x[1], cut, x[0], cut) if axis == 0 else (cut, y[1], cut, y[0])
        for rect, gone in (((x[0], y[0], *inner[:2]), 3 - axis), ((*inner[2:], x[1], y[1]), 1 - axis)):
            offices.append(Office(rect, tuple(side for side in free if side != gone)))
    return offices, walls


def _outer(rng: np.random.Generator, inside: Rect, xs: list[Span], ys: list[Span]) -> list[Wall]:
    """Return the outer walls: windows in most offices, and where a corridor ends."""
    walls = []
    for wall in around(inside, 0.3):
        spans = xs if wall.along_x else ys
        ends = [(low[1] + 0.3, high[0] - 0.3) for low, high in pairwise(spans)]
        rooms = [(low + 1.0, (low + high) / 2 - 0.5) for low, high in spans]
        windows = [Opening((a + b) / 2, b - a, "window") for a, b in (*rooms, *ends) if rng.random() < 0.7]
        walls.append(replace(wall, openings=tuple(windows)))
    return walls


def _faces(rng: np.random.Generator, office: Office, entry: int, niches: list[tuple[Rect, int]]) -> list[Wall]:
    """Return the walls of an office toward corridors: ``entry`` with a door, some of glass, some with a niche."""
    walls = []
    for side in office.free:
        face, chance = office.face(side), rng.random()
        middle, length = (face.start_m + face.stop_m) / 2, face.stop_m - face.start_m
        if side == entry:
            door, *panes = _entry(rng, face, chance < 0.35)
            walls.append(replace(face, openings=(replace(door, swing=1 if side < 2 else -1), *panes)))
        elif chance < 0.25:
            walls.append(replace(face, openings=(Opening(middle, length - 1.0, "pane"),)))
        elif chance < 0.6 and length > 4.0:
            walls += _niche(rng, face, side, niches)
        else:
            walls.append(face)
    return walls


def _entry(rng: np.random.Generator, face: Wall, glazed: bool) -> tuple[Opening, ...]:
    """Return a door near one end of a wall, and glass along the rest of it if it is glazed."""
    width, first = rng.uniform(0.98, 1.15), rng.random() < 0.5
    near = 0.5 + width / 2 + rng.uniform(0.0, 0.4)
    kind = ("open", "ajar", "shut")[int(rng.choice(3, p=(0.55, 0.2, 0.25)))]
    door = Opening(face.start_m + near if first else face.stop_m - near, width, kind)
    start, stop = (door.middle_m + width, face.stop_m - 0.5) if first else (face.start_m + 0.5, door.middle_m - width)
    return (door, Opening((start + stop) / 2, stop - start, "pane")) if glazed and stop - start > 1.0 else (door,)


def _niche(rng: np.random.Generator, face: Wall, side: int, niches: list[tuple[Rect, int]]) -> list[Wall]:
    """Return a wall that steps back for a stretch; the niche is noted with the side of its back."""
    inward = _NICHE_M if side < 2 else -_NICHE_M
    half = rng.uniform(0.7, 1.5)
    middle = (face.start_m + face.stop_m) / 2 + rng.uniform(-0.4, 0.4)
    a, b, back = middle - half, middle + half, face.at_m + inward
    rect = Wall(face.along_x, face.at_m + inward / 2, a, b).rect(Opening(middle, b - a), _NICHE_M / 2 - _THICK_M / 2)
    niches.append((rect, (side + 2) % 4))
    cheeks = [replace(face, along_x=not face.along_x, at_m=u, start_m=min(face.at_m, back), stop_m=max(face.at_m, back))
              for u in (a - _THICK_M / 2, b + _THICK_M / 2)]  # fmt: skip
    behind = replace(face, at_m=back, start_m=a - _THICK_M, stop_m=b + _THICK_M)
    return [replace(face, stop_m=a), replace(face, start_m=b), behind, *cheeks]


def _fire_doors(rng: np.random.Generator, passages: Iterable[tuple[Rect, tuple[int, int]]]) -> list[Wall]:
    """Return walls across a few corridors, where they meet a crossing, with a wide door."""
    walls = []
    for (x0, y0, x1, y1), sides in passages:
        if rng.random() < 0.14:
            start, stop, at = (y0, y1, x0 + 0.15) if sides[0] else (x0, x1, y0 + 0.15)
            kind = "open" if rng.random() < 0.6 else "passage"
            door = Opening((start + stop) / 2, min(1.5, stop - start - 0.3), kind)
            walls.append(Wall(bool(not sides[0]), at, start, stop, 0.1, "paint", (door,)))
    return walls


def _raised(rng: np.random.Generator, walls: list[Wall], entries: list[tuple[Office, int]]) -> Rise | None:
    """Return an office with a raised floor, as over cables, and take its door off its hinges."""
    office, side = entries[int(rng.integers(len(entries)))]
    face = office.face(side)
    for k, wall in enumerate(walls):
        doors = [one for one in wall.openings if one.kind in DOORS]
        if doors and (wall.along_x, wall.at_m, wall.start_m) == (face.along_x, face.at_m, face.start_m):
            panes = [one for one in wall.openings if one.kind not in DOORS]
            walls[k] = replace(wall, openings=(replace(doors[0], kind="passage"), *panes))
            return raised_room(office.rect, side, (doors[0].middle_m, doors[0].width_m), rng.uniform(0.1, 0.25))
    return None


def _ducts(rng: np.random.Generator, passages: Iterable[tuple[Rect, tuple[int, int]]], top_m: float) -> list[Thing]:
    """Return ducts that hang along some corridors."""
    ducts = []
    for (x0, y0, x1, y1), sides in passages:
        if rng.random() < 0.3:
            size = (x1 - x0, 0.4) if sides[0] else (0.4, y1 - y0)
            box = Box((x0 + x1) / 2, (y0 + y1) / 2, *size, top_m - 0.05, top_m - 0.3, 0.0, "metal")
            ducts.append(Thing("duct", (box,), z_m=0.0))
    return ducts
