"""A hall: pillars, rows of seats, stalls, a glass front, a gallery with stairs, and many people.

An atrium: galleries at several levels around it, stairs, glass, and often a well in its floor with a level below.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from viewshed_lab.sim.assets import furniture
from viewshed_lab.sim.assets import warehouse as stock
from viewshed_lab.sim.assets.furniture import Group, Maker, place_group
from viewshed_lab.sim.assets.shapes import Box, Cylinder, Shape, material_index
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.indoor.agents import Building, inhabited
from viewshed_lab.sim.worlds.indoor.floor_plan import FloorPlan, Rise, floor, lay, shrunk
from viewshed_lab.sim.worlds.indoor.walls import Opening, Wall, around, build, ceiling
from viewshed_lab.sim.worlds.layout import Rect, within

_QUARTERS = (0.0, np.pi / 2, np.pi, -np.pi / 2)

_WISHES = (
    (stock.totem, 5, "inside"), (stock.planter, 5, "inside"), (furniture.bench, 3, "inside"),
    (stock.bistro, 6, "inside"), (stock.queue, 1, "inside"), (furniture.bin_, 4, "inside"), (stock.cart, 1, "inside"),
    (furniture.talking, 6, "free"), (furniture.standing, 8, "free"), (furniture.plant, 3, "wall"),
    (furniture.locker, 4, "wall"), (furniture.extinguisher, 3, "wall"), (furniture.mirror, 3, "wall"),
    (furniture.bench, 3, "wall"),
)  # fmt: skip


def hall(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a large hall, like that of a station or a fair.

    A hall: pillars, rows of seats, stalls, a glass front, a gallery with stairs, and many people.
    """
    floor_plan, top = FloorPlan(rng), rng.uniform(5.0, 9.5)
    half_x, half_y = rng.uniform(19.0, 24.0), rng.uniform(17.0, 21.0)
    inside = (-half_x, -half_y, half_x, half_y)
    front = int(rng.integers(4))
    build(floor_plan, [glass_wall(rng, wall, top) if k == front else back_wall(rng, wall)
                 for k, wall in enumerate(around(inside, 0.35, "concrete"))], top)  # fmt: skip
    floor_plan.things.extend(ceiling(inside, top, "concrete"))
    if rng.random() < 0.6:
        side = (front + 2) % 4
        deep, level = rng.uniform(2.5, 4.0), rng.uniform(2.9, 3.6)
        floor_plan.add(gallery(inside, side, deep, level))
        stairs_up(floor_plan, inside, side, deep, level)
    rise = _stage(floor_plan, inside) if rng.random() < 0.5 else None
    _pillars(floor_plan, inside, top)
    _seating(floor_plan, inside)
    sides = tuple(side for side in range(4) if side != front)
    for maker, count, sides_ in ((stock.reception, 1, None), (stock.stall, 3, None), (stock.stall, 3, sides)):
        for _ in range(int(rng.integers(1, count + 1))):
            if sides_:
                floor_plan.against(inside, maker, sides_)
            else:
                floor_plan.inside(shrunk(inside, 4.0), maker, _QUARTERS)
    scattered(floor_plan, inside, sides)
    _overhead(floor_plan, inside, top)
    building = Building("hall", inside, top, 7, (inside,) * 3 + ((rise.rect,) if rise else ()))
    return inhabited(floor_plan, floor(rise, inside, "concrete"), building, plan)


def glass_wall(rng: np.random.Generator, wall: Wall, top_m: float) -> Wall:
    """Return a wall of tall panes between piers, with one or two ways in."""
    count = int((wall.stop_m - wall.start_m - 2.0) / rng.uniform(3.5, 5.5))
    edges = np.linspace(wall.start_m + 1.0, wall.stop_m - 1.0, count + 1)
    ways_in = set(rng.choice(count, size=int(rng.integers(1, 3)), replace=False).tolist())
    head = min(top_m - 0.4, rng.uniform(2.8, 6.0))
    openings = [
        Opening((a + b) / 2, 2.2 if k in ways_in else b - a - 0.35, "passage" if k in ways_in else "pane", head)
        for k, (a, b) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    ]
    return replace(wall, openings=tuple(openings))


def back_wall(rng: np.random.Generator, wall: Wall) -> Wall:
    """Return a wall with a few doors."""
    spots = np.linspace(wall.start_m, wall.stop_m, 6)[1:-1]
    doors = [Opening(float(u), 1.2, str(rng.choice(("shut", "ajar", "open"), p=(0.7, 0.2, 0.1)))) for u in spots]
    return replace(wall, openings=tuple(one for one in doors if rng.random() < 0.45))


def _pillars(floor_plan: FloorPlan, inside: Rect, top_m: float) -> None:
    pitch, side = floor_plan.rng.uniform(6.0, 9.0, 2), floor_plan.rng.uniform(0.4, 0.8)
    one = furniture.pillar(floor_plan.rng, top_m, side)
    for x in np.arange(inside[0] + pitch[0] / 1.5, inside[2] - 2.0, pitch[0]).tolist():
        for y in np.arange(inside[1] + pitch[1] / 1.5, inside[3] - 2.0, pitch[1]).tolist():
            floor_plan.put(place_group(one, x, y))


def gallery(inside: Rect, side: int, deep: float, level: float, foot: float = -1.0) -> Group:
    """Return a gallery along a wall, on posts that begin at ``foot``, with a balustrade of glass.

    ``side`` is the wall as in :meth:`FloorPlan.against`; the gallery is ``deep`` meters wide, ``level`` up.
    """
    x0, y0, x1, y1 = inside
    along_x = side % 2 == 1
    half = (x1 - x0 if along_x else y1 - y0) / 2
    edge = inside[side] + (deep if side < 2 else -deep)
    lines = np.linspace(-half + 1.0, half - 1.0, int(half / 3.0))
    at = [(u, edge) if along_x else (edge, u) for u in lines.tolist()]
    posts = [Cylinder(x, y, 0.12, level, foot) for x, y in at]
    middle = (inside[side] + edge) / 2
    size = (2 * half, deep) if along_x else (deep, 2 * half)
    slab = Box(0.0 if along_x else middle, middle if along_x else 0.0, *size, level + 0.3, level, 0.0, "concrete")
    rail = Wall(along_x, edge, -half, half).box(-half, half, (level + 0.3, level + 1.35), "glass", 0.02)
    return (Thing("gallery", (slab, rail, *posts), z_m=0.0),)


def stairs_up(floor_plan: FloorPlan, inside: Rect, side: int, deep: float, level: float) -> None:
    """Add stairs that lead up to a gallery, where there is room beside it."""
    strip, along_x = _beside(inside, side, deep), side % 2 == 1
    floor_plan.inside(strip, lambda rng: stock.stairs(rng, level), (np.pi / 2 if along_x else 0.0,), 0.01)


def _beside(inside: Rect, side: int, deep_m: float) -> Rect:
    """Return the strip of floor that the stairs in front of a gallery occupy."""
    rect = list(inside)
    rect[side] += deep_m + 0.14 if side < 2 else -deep_m - 0.14
    rect[(side + 2) % 4] = rect[side] + (2.5 if side < 2 else -2.5)
    return rect[0], rect[1], rect[2], rect[3]


def _stage(floor_plan: FloorPlan, inside: Rect) -> Rise | None:
    """Return a raised part of the floor with a ramp; place its furniture and a glass rail."""
    rng = floor_plan.rng
    wide, deep, height = rng.uniform(6.0, 9.0), rng.uniform(4.0, 7.0), rng.uniform(0.12, 0.4)
    for _ in range(8):
        x, y = (
            rng.uniform(inside[0] + 2.0, inside[2] - 2.0 - wide),
            rng.uniform(inside[1] + 2.0, inside[3] - 2.0 - deep),
        )
        rect = (x, y, x + wide, y + deep)
        if floor_plan.clear(rect, 0.4):
            ramp = (x, y + 0.3, x + min(height / 0.1, wide - 1.5), y + 1.8)
            rise = Rise(rect, height, ramp, 0)
            lay(floor_plan, rise)
            rails = Wall(True, y + deep - 0.1, x + 0.2, x + wide - 0.2).box(
                x + 0.2, x + wide - 0.2, (0.0, 1.0), "glass", 0.02
            )
            floor_plan.add((Thing("rail", (rails,), z_m=height),))
            for _ in range(3):
                floor_plan.inside(shrunk(rect, 0.4), stock.bistro)
            floor_plan.reserve(*((a - 0.3, b - 0.3, c + 0.3, d + 0.3) for a, b, c, d in rise.steps()))
            return rise
    return None


def _seating(floor_plan: FloorPlan, inside: Rect) -> None:
    """Add a field of seats in rows, all turned the same way."""
    rng = floor_plan.rng
    maker = stock.double_seats if rng.random() < 0.6 else stock.seats
    group = maker(rng)
    a, b, c, d = furniture.footprint(group)
    turn = rng.random() < 0.5
    pitch = (c - a + rng.uniform(1.3, 1.8), d - b + (0.25 if rng.random() < 0.5 else 1.4))
    rows, columns = int(rng.integers(3, 6)), int(rng.integers(2, 4))
    x, y = rng.uniform(inside[0] * 0.6, 0.0), rng.uniform(inside[1] * 0.6, 0.0)
    for i in range(rows):
        for j in range(columns):
            u, v = (i * pitch[0], j * pitch[1])
            x_m, y_m = (x + v, y + u) if turn else (x + u, y + v)
            floor_plan.put(place_group(group, x_m, y_m, np.pi / 2 if turn else 0.0))


def scattered(floor_plan: FloorPlan, inside: Rect, sides: tuple[int, ...]) -> None:
    """Add the furniture of a hall, free-standing or along the walls ``sides``."""
    for maker, limit, spot in _WISHES:
        for _ in range(int(floor_plan.rng.integers(0, limit + 1))):
            if spot == "wall":
                floor_plan.against(inside, maker, sides)
            else:
                floor_plan.inside(shrunk(inside, 2.0), maker, _QUARTERS if spot == "inside" else (), 0.5)


def _overhead(floor_plan: FloorPlan, inside: Rect, top_m: float) -> None:
    """Add beams below the ceiling, hanging signs, and things outside the glass."""
    for x in np.linspace(inside[0] + 3.0, inside[2] - 3.0, int(floor_plan.rng.integers(3, 7))).tolist():
        beam = Box(x, 0.0, 0.3, inside[3] - inside[1], top_m, top_m - 0.5, 0.0, "concrete")
        floor_plan.things.append(Thing("beam", (beam,), z_m=0.0))
    for x, y in floor_plan.rng.uniform(-12.0, 12.0, (int(floor_plan.rng.integers(2, 6)), 2)).tolist():
        wide, yaw = floor_plan.rng.uniform(1.5, 3.0), float(floor_plan.rng.choice(_QUARTERS))
        if floor_plan.clear((x - wide / 2, y - wide / 2, x + wide / 2, y + wide / 2)):
            plate = Box(0.0, 0.0, 0.12, wide, 3.3, 2.7, 0.0, "paint")
            floor_plan.reserve((x - 1.5, y - 1.5, x + 1.5, y + 1.5))
            floor_plan.things.append(Thing("sign", (plate,), x_m=x, y_m=y, yaw=yaw, z_m=0.0))
    floor_plan.things.extend(_outside(floor_plan.rng, inside))


def _outside(rng: np.random.Generator, inside: Rect) -> Iterator[Thing]:
    """Return the houses opposite and planters before the hall."""
    far = rng.uniform(9.0, 16.0)
    for x, y, length, width in ((0.0, inside[3] + far, 50.0, 6.0), (0.0, inside[1] - far, 46.0, 6.0),
                                (inside[2] + far, 0.0, 6.0, 44.0), (inside[0] - far, 0.0, 6.0, 40.0)):  # fmt: skip
        yield Thing("building", (Box(x, y, length, width, rng.uniform(6.0, 15.0), -1.0, 0.0, "brick"),))
    for x in (inside[0] * 0.6, 0.0, inside[2] * 0.6):
        planter, at = stock.planter(rng), x + rng.uniform(-2.0, 2.0)
        yield from place_group(planter, at, inside[3] + 3.0 if rng.random() < 0.5 else inside[1] - 3.0, np.pi / 2)


_HALF_M, _FACE_M = 60.0, 0.02

_BELOW: tuple[Maker, ...] = (
    stock.bistro, stock.planter, stock.totem, furniture.talking, furniture.standing, furniture.plant, stock.stall,
)  # fmt: skip


def atrium(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return an atrium of two to four storeys with the robots of ``plan`` on its ground floor.

    An atrium: galleries at several levels around it, stairs, glass, and often a well in its floor with a level below.
    """
    floor_plan, rise, storeys = FloorPlan(rng), rng.uniform(3.0, 4.2), int(rng.integers(2, 5))
    half_x, half_y = rng.uniform(17.0, 24.0), rng.uniform(17.0, 21.0)
    inside, top = (-half_x, -half_y, half_x, half_y), storeys * rise + rng.uniform(-0.4, 0.6)
    glazed = {k for k in range(4) if rng.random() < 0.45}
    build(floor_plan, [glass_wall(rng, wall, top) if k in glazed else back_wall(rng, wall)
                 for k, wall in enumerate(around(inside, 0.35, "concrete"))], top)  # fmt: skip
    floor_plan.things.extend(ceiling(inside, top, "metal"))
    well: Rect | None = None
    if rng.random() < 0.65:  # an opening in the floor, somewhere near the middle
        wide, long = rng.uniform(5.0, 13.0), rng.uniform(5.0, 13.0)
        x, y = rng.uniform(6.5 - half_x, half_x - 6.5 - wide), rng.uniform(6.5 - half_y, half_y - 6.5 - long)
        well = (x, y, x + wide, y + long)
        floor_plan.steps += _edges(well)
        floor_plan.reserve(tuple(np.add(well, (-0.5, -0.5, 0.5, 0.5)).tolist()))
        floor_plan.things += _balustrade(rng, well)
    deep = rng.uniform(2.5, 4.5, 4)
    sides = [side for side in range(4) if rng.random() < 0.75]
    for storey in range(1, storeys):
        for side in sides:
            level, foot = storey * rise - 0.3, -1.0 if storey == 1 else (storey - 1) * rise
            floor_plan.add(gallery(inside, side, float(deep[side]), level, foot))
            if storey == 1 and rng.random() < 0.6:
                stairs_up(floor_plan, inside, side, float(deep[side]), level)
    scattered(floor_plan, inside, tuple(side for side in range(4) if side not in glazed) or (0,))
    _bridges(floor_plan, inside, rise, storeys)
    depth = rng.uniform(3.0, 4.5)
    if well is not None:
        floor_plan.things += _down_there(rng, well)
    building = Building("atrium", inside, top, 5, (inside,) * 3)
    return inhabited(floor_plan, _floor(inside, well, depth), building, plan)


def _edges(rect: Rect) -> list[Rect]:
    x0, y0, x1, y1 = rect
    return [(x0, y0, x0, y1), (x0, y0, x1, y0), (x1, y0, x1, y1), (x0, y1, x1, y1)]


def _balustrade(rng: np.random.Generator, well: Rect) -> list[Thing]:
    """Return a balustrade around the well: panes, or bars, or a low wall."""
    kind, things = int(rng.integers(3)), []
    for x0, y0, x1, y1 in _edges(tuple(np.add(well, (-0.15, -0.15, 0.15, 0.15)).tolist())):
        x, y, long, wide = (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0 + 0.02, y1 - y0 + 0.02
        parts: list[Shape] = [Box(x, y, max(long, 0.05), max(wide, 0.05), 1.1, 1.05, 0.0, "metal")]
        if kind == 0:
            parts.append(Box(x, y, long, wide, 1.05, 0.05, 0.0, "glass"))
        elif kind == 1:
            ends = np.linspace(-0.5, 0.5, max(2, round(max(long, wide) / 0.45)))
            parts += [Cylinder(x + float(u) * long, y + float(u) * wide, 0.015, 1.05, 0.0, "metal") for u in ends]
        else:
            parts.append(Box(x, y, max(long, 0.15), max(wide, 0.15), 1.0, 0.0, 0.0, "plaster"))
        things.append(Thing("balustrade", tuple(parts), z_m=0.0))
    return things


def _down_there(rng: np.random.Generator, well: Rect) -> Group:
    """Return the things on the lower level, which is visible from above only."""
    things: list[Thing] = []
    middle = ((well[0] + well[2]) / 2, (well[1] + well[3]) / 2)
    for k in range(int(rng.integers(1, 5))):
        maker = _BELOW[int(rng.integers(len(_BELOW)))]
        angle, away = rng.uniform(0, 2 * np.pi), min(well[2] - well[0], well[3] - well[1]) / 4
        x, y = middle[0] + away * np.cos(angle + k * np.pi / 2), middle[1] + away * np.sin(angle + k * np.pi / 2)
        things += place_group(maker(rng), float(x), float(y), rng.uniform(-3, 3))[:1]
    return tuple(things)


def _bridges(floor_plan: FloorPlan, inside: Rect, rise_m: float, storeys: int) -> None:
    """Add footbridges overhead from side to side, with balustrades of glass, at any storey."""
    rng = floor_plan.rng
    for storey in range(1, storeys):
        if rng.random() < 0.35:
            y, z = rng.uniform(inside[1] + 5.0, inside[3] - 5.0), storey * rise_m
            long = inside[2] - inside[0] - 5.0
            rails = [Box(0.0, y + w * 1.2, long, 0.02, z + 1.05, z, 0.0, "glass") for w in (-1, 1)]
            slab = Box(0.0, y, long, 2.4, z, z - 0.3, 0.0, "concrete")
            floor_plan.things.append(Thing("gallery", (slab, *rails), z_m=0.0))


def _floor(inside: Rect, well: Rect | None, depth_m: float) -> Terrain:
    """Return the ground floor with the well in it, ``depth_m`` deep with upright faces."""
    hole = shrunk(well, 0.0) if well is not None else (0.0, 0.0, 0.0, 0.0)
    xs, ys = ([-_HALF_M, *inside[k::2], _HALF_M] for k in (0, 1))
    if well is not None:
        xs += [edge + step for edge in hole[::2] for step in (-_FACE_M / 2, _FACE_M / 2)]
        ys += [edge + step for edge in hole[1::2] for step in (-_FACE_M / 2, _FACE_M / 2)]

    def height(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(within(hole, x, y), -depth_m, 0.0)

    def material(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.uint8]:
        return np.where(within(inside, x, y), material_index("concrete"), material_index("asphalt")).astype(np.uint8)

    return Terrain.of(xs, ys, height, material)
