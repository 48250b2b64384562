"""Furniture of rooms and offices, detailed enough for single beams; fittings and people in buildings.

A maker takes a generator for the sizes and returns a group around one origin: front along x, back at the lowest x.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from viewshed_lab.sim.assets.shapes import Box, Cylinder, Ellipsoid, ends_of
from viewshed_lab.sim.assets.street import group, person, pick
from viewshed_lab.sim.world import Thing

Group = tuple[Thing, ...]
"""Things that are placed together, around a common origin."""

Maker = Callable[[np.random.Generator], Group]
"""Makes one group; the generator gives sizes and materials."""


def place_group(group: Iterable[Thing], x_m: float, y_m: float, yaw: float = 0.0) -> Group:
    """Return the group turned by ``yaw`` about its origin, then moved to (x, y) in meters.

    >>> [(round(one.x_m, 6), round(one.y_m, 6)) for one in place_group((Thing("a", (), x_m=1.0),), 5.0, 2.0, np.pi / 2)]
    [(5.0, 3.0)]
    """
    c, s = math.cos(yaw), math.sin(yaw)
    return tuple(
        replace(one, x_m=x_m + c * one.x_m - s * one.y_m, y_m=y_m + s * one.x_m + c * one.y_m, yaw=one.yaw + yaw)
        for one in group
    )


def bounds(group: Iterable[Thing]) -> NDArray[np.float64]:
    """Return (k, 6) meters: x, y from, x, y to in the world, bottom and top above its ground, of each solid."""
    rows = [
        (*ends_of(part, one.x_m, one.y_m, one.yaw), part.bottom_m, part.top_m) for one in group for part in one.parts
    ]
    return np.array(rows, np.float64).reshape(-1, 6)


def footprint(group: Iterable[Thing]) -> tuple[float, float, float, float]:
    """Return (x min, y min, x max, y max) in meters of a group.

    >>> footprint((Thing("table", (Box(0.0, 0.0, 1.0, 2.0, 0.7),), x_m=3.0),))
    (2.5, -1.0, 3.5, 1.0)
    """
    x0, y0, x1, y1 = bounds(group)[:, :4].T.tolist()
    return min(x0), min(y0), max(x1), max(y1)


def legs(
    length_m: float, width_m: float, top_m: float, side_m: float = 0.05, material: str = "wood"
) -> tuple[Box, ...]:
    """Return four legs flush with the corners of a rectangle about the origin, sizes in meters."""
    x, y = (length_m - side_m) / 2, (width_m - side_m) / 2
    return tuple(Box(a * x, b * y, side_m, side_m, top_m, 0.0, 0.0, material) for a in (-1, 1) for b in (-1, 1))


def slab(length_m: float, width_m: float, bottom_m: float, top_m: float, material: str = "wood") -> Box:
    """Return an upright box about the origin of its thing, sizes in meters."""
    return Box(0.0, 0.0, length_m, width_m, top_m, bottom_m, 0.0, material)


def table(rng: np.random.Generator) -> Group:
    """Return a table on four legs."""
    length, width = rng.uniform(0.7, 0.9), rng.uniform(1.1, 1.7)
    top = slab(length, width, 0.70, 0.74)
    return (Thing("table", (top, *legs(length - 0.1, width - 0.1, 0.70))),)


def low_table(rng: np.random.Generator) -> Group:
    """Return a low table, of wood or of glass."""
    length, width = rng.uniform(0.5, 0.7), rng.uniform(0.8, 1.2)
    top = slab(length, width, 0.40, 0.43, pick(rng, ("wood", "glass")))
    return (Thing("table", (top, *legs(length, width, 0.40, 0.04, "metal"))),)


def chair(rng: np.random.Generator) -> Group:
    """Return a chair on four legs."""
    material = pick(rng, ("wood", "paint", "dark_paint"))
    back = Box(-0.2, 0.0, 0.03, 0.42, 0.88, 0.46, 0.0, material)
    return (Thing("chair", (slab(0.43, 0.43, 0.43, 0.46, material), back, *legs(0.42, 0.42, 0.43, 0.03, "metal"))),)


def office_chair(rng: np.random.Generator) -> Group:
    """Return a swivel chair: a star of six feet, stem, seat and back."""
    material = pick(rng, ("clothes", "dark_paint", "rubber"))
    feet = tuple(Box(0.0, 0.0, 0.58, 0.05, 0.11, 0.03, k * np.pi / 3, "dark_paint") for k in range(3))
    seat = slab(0.46, 0.48, 0.44, 0.51, material)
    back = Box(-0.24, 0.0, 0.07, 0.44, rng.uniform(0.92, 1.1), 0.56, 0.0, material)
    return (Thing("chair", (*feet, Cylinder(0.0, 0.0, 0.03, 0.44, 0.11, "metal"), seat, back)),)


def desk(rng: np.random.Generator) -> Group:
    """Return a work place at a wall: desk, chair in front of it and a monitor or two."""
    depth, width = 0.75, rng.uniform(1.3, 1.7)
    sides = tuple(Box(0.0, y * (width / 2 - 0.03), depth - 0.1, 0.04, 0.71, 0.0, 0.0, "metal") for y in (-1, 1))
    drawers = Box(-0.05, width / 2 - 0.28, 0.55, 0.42, 0.62, 0.04, 0.0, "metal")
    one = Thing("desk", (slab(depth, width, 0.71, 0.74), *sides, drawers))
    seat = place_group(office_chair(rng), 0.62, -0.15, np.pi + rng.uniform(-0.5, 0.5))
    screens = place_group(monitor(rng), -0.18, rng.uniform(-0.3, 0.1))
    return (one, *(seat if rng.random() < 0.85 else ()), *screens)


def monitor(rng: np.random.Generator) -> Group:
    """Return a screen on its foot, for a desk 0.74 m high; screens give almost no returns."""
    width = rng.uniform(0.5, 0.7)
    screen = Box(0.0, 0.0, 0.03, width, 1.2, 0.84, 0.0, pick(rng, ("absorber", "dark_paint")))
    return (Thing("monitor", (screen, Box(-0.04, 0.0, 0.14, 0.2, 0.9, 0.745, 0.0, "dark_paint"))),)


def dining(rng: np.random.Generator) -> Group:
    """Return a table with four to six chairs drawn up to it, some pulled out."""
    top = table(rng)
    _, y0, x1, y1 = footprint(top)
    spots = [(side, y) for side in (-1, 1) for y in np.linspace(y0 + 0.27, y1 - 0.27, 2)]
    if rng.random() < 0.4:
        spots += [(0, y0), (0, y1)]
    return (*top, *(one for side, y in spots for one in _drawn_up(rng, side, float(y), x1, chair(rng))))


def meeting(rng: np.random.Generator) -> Group:
    """Return a long table with swivel chairs along both sides."""
    length, width = rng.uniform(1.1, 1.3), rng.uniform(2.2, 3.2)
    ends = tuple(Box(0.0, s * (width / 2 - 0.4), 0.6, 0.08, 0.71, 0.0, 0.0, "metal") for s in (-1, 1))
    top = Thing("table", (slab(length, width, 0.71, 0.74, pick(rng, ("wood", "paint"))), *ends))
    spots = [(side, y) for side in (-1, 1) for y in np.linspace(-width / 2 + 0.45, width / 2 - 0.45, int(width / 0.75))]
    kept = [spot for spot in spots if rng.random() < 0.85]
    chairs = (_drawn_up(rng, side, float(y), length / 2 + 0.1, office_chair(rng)) for side, y in kept)
    return (top, *(one for seat in chairs for one in seat))


def _drawn_up(rng: np.random.Generator, side: int, y_m: float, edge_m: float, seat: Group) -> Group:
    """Return a seat at the edge of a table: ``side`` -1 or 1 along x, or 0 at its end at ``y_m``."""
    out = rng.uniform(0.12, 0.35)
    if side:
        return place_group(seat, side * (edge_m + out), y_m, np.pi * (side > 0) + rng.uniform(-0.1, 0.1))
    return place_group(seat, 0.0, y_m + np.sign(y_m) * (0.1 + out), -np.sign(y_m) * np.pi / 2 + rng.uniform(-0.1, 0.1))


def shelf(rng: np.random.Generator) -> Group:
    """Return an open shelf with boards and rows of books."""
    depth, width, top = 0.32, rng.uniform(0.8, 1.6), rng.uniform(1.7, 2.1)
    sides = tuple(Box(0.0, s * (width / 2 - 0.01), depth, 0.02, top, 0.0) for s in (-1, 1))
    boards = tuple(slab(depth, width - 0.04, z, z + 0.02, "wood") for z in (0.08, top / 2, top - 0.02))
    back = Box(-depth / 2 + 0.005, 0.0, 0.01, width - 0.04, top, 0.0)
    books = tuple(_books(rng, width, z + 0.021) for z in (0.08, top / 2) if rng.random() < 0.7)
    wood = tuple(replace(part, material="wood") for part in (*sides, back))
    return (Thing("shelf", (*wood, *boards, *books)),)


def _books(rng: np.random.Generator, width_m: float, bottom_m: float) -> Box:
    long = rng.uniform(0.3, 0.9) * (width_m - 0.06)
    slack = (width_m - 0.06 - long) / 2
    y, high = rng.uniform(-slack, slack), rng.uniform(0.2, 0.5)
    return Box(-0.02, y, 0.2, long, bottom_m + high, bottom_m, 0.0, pick(rng, ("clothes", "paint", "dark_paint")))


def cabinet(rng: np.random.Generator) -> Group:
    """Return a closed cabinet on a plinth, waist-high or tall."""
    depth, width = rng.uniform(0.4, 0.55), rng.uniform(0.8, 1.4)
    top = rng.uniform(0.75, 1.1) if rng.random() < 0.5 else rng.uniform(1.6, 2.0)
    body = slab(depth, width, 0.08, top, pick(rng, ("wood", "metal", "paint")))
    return (Thing("cabinet", (body, slab(depth - 0.08, width - 0.04, 0.0, 0.08, "dark_paint"))),)


def sofa(rng: np.random.Generator) -> Group:
    """Return a sofa or an armchair: base, back and two arms."""
    width, material = rng.uniform(0.95, 2.3), pick(rng, ("clothes", "clothes", "absorber"))
    base = slab(0.85, width, 0.06, 0.42, material)
    back = Box(-0.325, 0.0, 0.2, width, 0.85, 0.42, 0.0, material)
    arms = tuple(Box(0.1, s * (width / 2 - 0.09), 0.65, 0.18, 0.6, 0.42, 0.0, material) for s in (-1, 1))
    return (Thing("sofa", (base, back, *arms)),)


def bed(rng: np.random.Generator) -> Group:
    """Return a bed with headboard and a table beside it."""
    width = rng.uniform(0.95, 1.85)
    frame, mattress = slab(2.05, width, 0.12, 0.32), slab(1.98, width - 0.06, 0.32, 0.52, "clothes")
    head = Box(-1.06, 0.0, 0.06, width, rng.uniform(0.8, 1.1), 0.0, 0.0, "wood")
    pillow = Box(-0.7, 0.0, 0.4, width - 0.3, 0.62, 0.52, 0.0, "clothes")
    beside = Thing("cabinet", (slab(0.4, 0.42, 0.0, 0.5, "wood"),), x_m=-0.87, y_m=width / 2 + 0.3)
    return (Thing("bed", (frame, mattress, head, pillow, *legs(2.0, width, 0.12, 0.08))), beside)


def counter(rng: np.random.Generator) -> Group:
    """Return a kitchen row: counter, fridge at its end, cupboards above."""
    width = rng.uniform(1.6, 2.8)
    front = pick(rng, ("paint", "wood"))
    row = (slab(0.6, width, 0.1, 0.86, front), slab(0.5, width, 0.0, 0.1, "dark_paint"))
    top = slab(0.63, width, 0.86, 0.9, "concrete")
    cupboards = Box(-0.13, 0.0, 0.34, width, 2.1, 1.4, 0.0, front)
    low = Thing("counter", (*row, top, cupboards))
    cold = Thing("fridge", (slab(0.62, 0.6, 0.02, rng.uniform(1.5, 1.9), "metal"),), y_m=width / 2 + 0.32)
    return low, cold


def bath(rng: np.random.Generator) -> Group:
    """Return a bath tub: four walls and a bottom."""
    rim = tuple(Box(0.0, s * 0.81, 0.75, 0.06, 0.58, 0.0, 0.0, "plaster") for s in (-1, 1))
    long = tuple(Box(s * 0.345, 0.0, 0.06, 1.56, 0.58, 0.0, 0.0, "plaster") for s in (-1, 1))
    return (Thing("bath", (*rim, *long, slab(0.63, 1.56, 0.0, 0.18, "plaster"))),)


def basin(rng: np.random.Generator) -> Group:
    """Return a wash basin on its column below a mirror, which reflects beams away."""
    mirror = Box(-0.2, 0.0, 0.02, rng.uniform(0.5, 1.0), 1.85, 1.05, 0.0, "absorber")
    bowl = Box(0.0, 0.0, 0.42, 0.55, 0.86, 0.7, 0.0, "plaster")
    return (Thing("basin", (bowl, Cylinder(-0.08, 0.0, 0.09, 0.7, 0.0, "plaster"))), Thing("mirror", (mirror,)))


def toilet(rng: np.random.Generator) -> Group:
    """Return a toilet bowl with its cistern."""
    bowl = Ellipsoid(0.08, 0.0, 0.5, 0.38, 0.42, -0.1, 0.0, "plaster")
    return (Thing("toilet", (bowl, Box(-0.27, 0.0, 0.18, 0.38, 0.82, 0.38, 0.0, "plaster"))),)


def plant(rng: np.random.Generator) -> Group:
    """Return a plant in a pot."""
    size, top = rng.uniform(0.5, 0.9), rng.uniform(1.0, 1.9)
    pot = Cylinder(0.0, 0.0, size / 3.2, 0.38, 0.0, pick(rng, ("concrete", "paint", "dark_paint")))
    crown = Ellipsoid(0.0, 0.0, size, size, top, top - min(0.8 * top, 1.1))
    return (Thing("plant", (pot, Cylinder(0.0, 0.0, 0.025, top - 0.35, 0.38, "bark"), crown)),)


def bin_(rng: np.random.Generator) -> Group:
    """Return a waste bin."""
    return (Thing("bin", (Cylinder(0.0, 0.0, rng.uniform(0.13, 0.2), rng.uniform(0.3, 0.65), 0.0, "metal"),)),)


def boxes(rng: np.random.Generator) -> Group:
    """Return one to three cardboard boxes, piled askew."""
    top, parts = 0.0, []
    for size in np.sort(rng.uniform(0.3, 0.6, int(rng.integers(1, 4))))[::-1]:
        x, y = rng.uniform(-0.04, 0.04, 2)
        parts.append(
            Box(x, y, size, size * rng.uniform(0.7, 1.0), top + size * 0.7, top, rng.uniform(-0.2, 0.2), "wood")
        )
        top += size * 0.7
    return (Thing("box", tuple(parts)),)


DOOR_TOP_M = 2.05
"""Height of a door's opening; above it is the lintel."""


def door(width_m: float, angle: float, material: str = "wood") -> Group:
    """Return a door leaf hinged at the origin: closed along x, turned open by ``angle`` radians counter-clockwise."""
    leaf = Box(width_m / 2, 0.0, width_m, 0.04, DOOR_TOP_M - 0.02, 0.01, 0.0, material)
    return (Thing("door", (leaf,), yaw=angle),)


def whiteboard(rng: np.random.Generator) -> Group:
    """Return a board on a wall."""
    return (Thing("board", (Box(0.0, 0.0, 0.03, rng.uniform(1.0, 2.2), 1.95, 0.95, 0.0, "paint"),)),)


def mirror(rng: np.random.Generator) -> Group:
    """Return a mirror or a dark screen on a wall: it gives no return."""
    bottom = 0.15 if rng.random() < 0.5 else 0.9
    return (Thing("mirror", (Box(0.0, 0.0, 0.04, rng.uniform(0.6, 1.4), 1.8, bottom, 0.0, "absorber"),)),)


def radiator(rng: np.random.Generator) -> Group:
    """Return a radiator, as it hangs below a window."""
    return (Thing("radiator", (Box(0.0, 0.0, 0.1, rng.uniform(0.8, 1.6), 0.7, 0.12, 0.0, "metal"),)),)


def extinguisher(rng: np.random.Generator) -> Group:
    """Return a fire extinguisher on its hook with the sign above it."""
    bottle = Cylinder(0.02, 0.0, 0.08, 1.0, 0.45, "paint")
    return (Thing("extinguisher", (bottle, Box(-0.07, 0.0, 0.02, 0.2, 1.9, 1.7, 0.0, "sign"))),)


def locker(rng: np.random.Generator) -> Group:
    """Return a row of lockers, or one machine that sells drinks."""
    if rng.random() < 0.4:
        front = Box(0.36, 0.05, 0.02, 0.6, 1.65, 0.6, 0.0, "absorber")
        return (Thing("machine", (Box(0.0, 0.0, 0.7, 0.9, 1.83, 0.04, 0.0, "paint"), front)),)
    return (Thing("locker", (Box(0.0, 0.0, 0.5, rng.uniform(1.2, 3.0), 1.8, 0.1, 0.0, "metal"),)),)


def bench(rng: np.random.Generator) -> Group:
    """Return a bench without a back."""
    width = rng.uniform(1.2, 1.8)
    feet = tuple(Box(0.0, s * (width / 2 - 0.2), 0.3, 0.06, 0.42, 0.0, 0.0, "metal") for s in (-1, 1))
    return (Thing("bench", (Box(0.0, 0.0, 0.42, width, 0.46, 0.42, 0.0, "wood"), *feet)),)


def pillar(rng: np.random.Generator, top_m: float, side_m: float) -> Group:
    """Return a pillar up to ``top_m``: round or square, ``side_m`` across."""
    if rng.random() < 0.5:
        return (Thing("pillar", (Cylinder(0.0, 0.0, side_m / 2, top_m),)),)
    return (Thing("pillar", (Box(0.0, 0.0, side_m, side_m, top_m, -1.0, 0.0, "concrete"),)),)


def standing(rng: np.random.Generator) -> Group:
    """Return a standing person."""
    return (person(rng),)


def sitting(rng: np.random.Generator) -> Group:
    """Return a person on a chair."""
    tall = rng.uniform(0.8, 0.92)
    shins = tuple(Cylinder(0.3, side * 0.12, 0.06, 0.47, 0.0, "clothes") for side in (-1, 1))
    thighs = Box(0.12, 0.0, 0.44, 0.36, 0.61, 0.47, 0.0, "clothes")
    trunk = Box(-0.06, 0.0, 0.22, 0.44, 0.46 + tall - 0.27, 0.61, 0.0, "clothes")
    head = Ellipsoid(-0.03, 0.0, 0.2, 0.16, 0.46 + tall, 0.46 + tall - 0.26, 0.0, "clothes")
    return (*chair(rng), Thing("pedestrian", (*shins, thighs, trunk, head)))


def talking(rng: np.random.Generator) -> Group:
    """Return two to four people in a ring, facing each other."""
    return tuple(group(rng, 0.0, 0.0))
