"""Objects of halls and warehouses, as groups around one origin (see ``furniture``)."""

from __future__ import annotations

import numpy as np

from viewshed_lab.sim.assets.furniture import Group, legs, place_group, slab
from viewshed_lab.sim.assets.shapes import Box, Cylinder, Shape
from viewshed_lab.sim.world import Thing

PALLET_M = (0.8, 1.2, 0.144)
"""Depth, width and height of a European pallet."""

BAY_M = 2.8
"""Clear width between two frames of a rack: three pallets side by side."""


def pallet(rng: np.random.Generator) -> Group:
    """Return a pallet with its load, or a pile of empty ones; wrapped loads are not quite square."""
    depth, width, top = PALLET_M
    if rng.random() < 0.15:
        return (Thing("pallet", (slab(depth, width, 0.0, top * int(rng.integers(2, 9)), "wood"),)),)
    load = rng.uniform(0.5, 1.7)
    body = slab(depth - rng.uniform(0, 0.15), width - rng.uniform(0, 0.2), top, top + load, _load(rng))
    runners = [Box(0.0, s * (width / 2 - 0.05), depth, 0.1, 0.1, 0.0, 0.0, "wood") for s in (-1, 1)]
    return (Thing("pallet", (*runners, slab(depth, width, 0.1, 0.144, "wood"), body)),)


def stack(rng: np.random.Generator) -> Group:
    """Return one to three loaded pallets on top of each other, as goods are stored without a rack."""
    depth, width, foot = PALLET_M
    count, high = int(rng.integers(1, 3)), rng.uniform(0.5, 1.1)
    floors = [k * (high + foot) for k in range(count)]
    decks = [slab(depth, width, z, z + foot - 0.001, "wood") for z in floors]
    body = _load(rng)
    loads = [slab(depth - 0.06, width - 0.08, z + foot, z + foot + high - 0.001, body) for z in floors]
    return (Thing("pallet", (*decks, *loads)),)


def _load(rng: np.random.Generator) -> str:
    return ("wood", "paint", "clothes", "dark_paint", "metal")[int(rng.choice(5, p=(0.45, 0.25, 0.12, 0.1, 0.08)))]


def rack(rng: np.random.Generator, bays: int, levels: int) -> Group:
    """Return a row of pallet racks along y, ``levels`` of beams above the floor, and the goods in it."""
    pitch, rise, depth = BAY_M + 0.1, float(rng.uniform(1.5, 2.0)), 1.1
    ends = (np.arange(bays + 1) - bays / 2) * pitch
    top, middle = levels * rise + 0.6, bays * pitch
    posts = [Box(s * (depth / 2 - 0.04), y, 0.07, 0.09, top, 0.0, 0.0, "metal") for y in ends for s in (-1, 1)]
    beams = [Box(s * (depth / 2 - 0.04), 0.0, 0.05, middle - 0.1, k * rise, k * rise - 0.12, 0.0, "paint")
             for k in range(1, levels + 1) for s in (-1, 1)]  # fmt: skip
    goods = [part for y in ends[:-1] + pitch / 2 for part in _bay(rng, float(y), levels, rise)]
    return Thing("rack", (*posts, *beams)), *((Thing("goods", tuple(goods)),) if goods else ())


def _bay(rng: np.random.Generator, middle_m: float, levels: int, rise_m: float) -> list[Shape]:
    """Return the loads between two frames: single ones on the floor, one load for all side by side above."""
    parts: list[Shape] = []
    for y in (middle_m - 0.92, middle_m, middle_m + 0.92):
        if rng.random() < 0.5:
            top = 0.144 + rng.uniform(0.4, rise_m - 0.45)
            parts.append(Box(0.0, y, 1.0, 0.82, top, 0.144, 0.0, _load(rng)))
    if parts:
        parts.append(Box(0.0, middle_m, 1.05, 2.66, 0.143, 0.05, 0.0, "wood"))
    for k in range(1, levels + 1):
        if rng.random() < 0.6:
            # One, two or three thirds of a bay, anywhere in it.
            thirds, room = int(rng.integers(1, 4)), BAY_M - 0.2
            wide, slack = thirds * room / 3, float(rng.integers(-1, 2)) * (3 - thirds) / 2 * room / 3
            bottom = k * rise_m + 0.001
            top = bottom + rng.uniform(0.5, rise_m - 0.35)
            parts.append(Box(0.0, middle_m + slack, rng.uniform(0.8, 1.0), wide, top, bottom, 0.0, _load(rng)))
    return parts


def forklift(rng: np.random.Generator) -> Group:
    """Return a forklift: body, mast, forks along x, roof on four posts; sometimes with a load."""
    up = rng.uniform(0.08, 0.5)
    body = Box(-0.6, 0.0, 1.7, 1.1, 0.95, 0.18, 0.0, "sign" if rng.random() < 0.2 else "paint")
    weight = Box(-1.25, 0.0, 0.4, 1.05, 1.15, 0.95, 0.0, "dark_paint")
    wheels = [Box(x, s * 0.48, 0.55, 0.2, 0.55, 0.0, 0.0, "rubber") for x in (-1.1, 0.1) for s in (-1, 1)]
    posts = [Box(x, s * 0.46, 0.06, 0.06, 2.1, 0.95, 0.0, "dark_paint") for x in (-1.0, 0.1) for s in (-1, 1)]
    mast = [Box(0.32, s * 0.3, 0.12, 0.1, 2.2, 0.1, 0.0, "metal") for s in (-1, 1)]
    forks = [Box(0.95, s * 0.25, 1.1, 0.1, up, up - 0.05, 0.0, "metal") for s in (-1, 1)]
    roof = Box(-0.45, 0.0, 1.2, 1.0, 2.15, 2.1, 0.0, "mesh")
    load = [Box(1.0, 0.0, 0.9, 1.1, up + rng.uniform(0.6, 1.4), up, 0.0, _load(rng))] if rng.random() < 0.5 else []
    return (Thing("forklift", (body, weight, roof, *wheels, *posts, *mast, *forks, *load)),)


def cart(rng: np.random.Generator) -> Group:
    """Return a platform cart with a handle at its back and something on it."""
    handle = [Box(-0.45, s * 0.26, 0.03, 0.03, 1.0, 0.22, 0.0, "metal") for s in (-1, 1)]
    wheels = [Cylinder(x, s * 0.22, 0.06, 0.16, 0.0, "rubber") for x in (-0.36, 0.36) for s in (-1, 1)]
    bar = Box(-0.45, 0.0, 0.03, 0.49, 1.03, 1.0, 0.0, "metal")
    load = Box(0.03, 0.0, 0.6, 0.45, rng.uniform(0.4, 0.9), 0.221, 0.0, _load(rng))
    return (Thing("cart", (slab(0.95, 0.6, 0.16, 0.22, "metal"), *handle, bar, *wheels, load)),)


def cage(rng: np.random.Generator) -> Group:
    """Return a roll cage of wire mesh, partly full."""
    walls = [Box(0.0, s * 0.39, 0.7, 0.02, 1.65, 0.2, 0.0, "mesh") for s in (-1, 1)]
    walls.append(Box(-0.34, 0.0, 0.02, 0.76, 1.65, 0.2, 0.0, "mesh"))
    wheels = [Cylinder(x, s * 0.34, 0.05, 0.15, 0.0, "rubber") for x in (-0.28, 0.28) for s in (-1, 1)]
    load = Box(0.02, 0.0, 0.62, 0.7, rng.uniform(0.4, 1.4), 0.2, 0.0, _load(rng))
    return (Thing("cage", (slab(0.7, 0.8, 0.15, 0.2, "metal"), *walls, *wheels, load)),)


def bollard(rng: np.random.Generator) -> Group:
    """Return a bright guard post."""
    return (Thing("bollard", (Cylinder(0.0, 0.0, 0.06, rng.uniform(0.6, 1.1), 0.0, "sign"),)),)


def conveyor(rng: np.random.Generator) -> Group:
    """Return a belt along y on its legs."""
    length, high = rng.uniform(3.0, 7.0), rng.uniform(0.6, 0.85)
    rails = [Box(s * 0.33, 0.0, 0.06, length, high + 0.08, high - 0.08, 0.0, "metal") for s in (-1, 1)]
    load = [Box(0.0, y, 0.4, 0.5, high + rng.uniform(0.25, 0.45), high + 0.001, 0.0, "wood")
            for y in np.arange(-length / 2 + 0.5, length / 2 - 0.4, 1.1) if rng.random() < 0.5]  # fmt: skip
    feet = legs(0.66, length - 0.4, high - 0.08, 0.06, "metal")
    return (Thing("conveyor", (slab(0.6, length, high - 0.05, high, "rubber"), *rails, *feet, *load)),)


def seats(rng: np.random.Generator) -> Group:
    """Return a row of three to five seats on one rail, facing x, as in a waiting hall."""
    count = int(rng.integers(3, 6))
    width = 0.58 * count
    ys = (np.arange(count) - (count - 1) / 2) * 0.58
    pans = [Box(0.05, y, 0.46, 0.5, 0.46, 0.42, 0.0, "metal") for y in ys]
    backs = [Box(-0.2, y, 0.05, 0.5, 0.88, 0.5, 0.0, "mesh" if rng.random() < 0.2 else "dark_paint") for y in ys]
    rail = Box(0.0, 0.0, 0.08, width, 0.4, 0.32, 0.0, "metal")
    feet = [Box(0.0, s * (width / 2 - 0.3), 0.55, 0.06, 0.32, 0.0, 0.0, "metal") for s in (-1, 1)]
    return (Thing("seats", (*pans, *backs, rail, *feet)),)


def stall(rng: np.random.Generator) -> Group:
    """Return a stall: counter in front, wall behind, roof on two posts, a case of glass on the counter."""
    width, top = rng.uniform(2.4, 3.6), rng.uniform(2.4, 2.8)
    counter = Box(0.9, 0.0, 0.6, width, 1.0, 0.0, 0.0, "wood")
    case = Box(0.9, width / 4, 0.4, width / 3, 1.4, 1.0, 0.0, "glass")
    back = Box(-1.15, 0.0, 0.1, width, top, 0.0, 0.0, "paint")
    posts = [Box(1.15, s * (width / 2 - 0.04), 0.08, 0.08, top, 1.0, 0.0, "metal") for s in (-1, 1)]
    roof = slab(2.5, width + 0.2, top, top + 0.12, "paint")
    goods = Box(-0.9, 0.0, 0.38, width * 0.8, rng.uniform(0.9, 1.9), 0.0, 0.0, _load(rng))
    return (Thing("stall", (counter, case, back, *posts, roof, goods)),)


def reception(rng: np.random.Generator) -> Group:
    """Return a reception desk with two wings and a screen."""
    width = rng.uniform(2.5, 4.5)
    front = Box(0.35, 0.0, 0.3, width, 1.1, 0.0, 0.0, "wood")
    wings = [Box(-0.3, s * (width / 2 - 0.15), 1.0, 0.3, 1.1, 0.0, 0.0, "wood") for s in (-1, 1)]
    desk = Box(-0.1, 0.0, 0.6, width - 0.6, 0.74, 0.70, 0.0, "wood")
    return (Thing("reception", (front, *wings, desk, Box(0.0, 0.5, 0.04, 0.5, 1.2, 0.8, 0.0, "absorber"))),)


def totem(rng: np.random.Generator) -> Group:
    """Return an upright screen or a ticket machine."""
    if rng.random() < 0.5:
        screen = Box(0.08, 0.0, 0.02, 0.6, 1.85, 0.7, 0.0, "absorber")
        return (Thing("totem", (slab(0.14, 0.7, 0.0, 1.95, "dark_paint"), screen)),)
    body, top = slab(0.5, 0.7, 0.0, 1.6, "paint"), Box(-0.1, 0.0, 0.3, 0.7, 1.8, 1.6, 0.0, "paint")
    return (Thing("machine", (body, top)),)


def queue(rng: np.random.Generator) -> Group:
    """Return posts with belts between them, two lanes along y."""
    count = int(rng.integers(3, 5))
    ys = (np.arange(count) - (count - 1) / 2) * 1.6
    posts = [Cylinder(x, y, 0.03, 0.98, 0.02, "metal") for x in (-0.6, 0.6) for y in ys]
    feet = [Cylinder(x, y, 0.16, 0.02, 0.0, "metal") for x in (-0.6, 0.6) for y in ys]
    belts = [Box(x, 0.0, 0.01, ys[-1] - ys[0], 0.94, 0.89, 0.0, "clothes") for x in (-0.6, 0.6)]
    return (Thing("queue", (*posts, *feet, *belts)),)


def planter(rng: np.random.Generator) -> Group:
    """Return a long trough with a hedge in it."""
    width = rng.uniform(1.2, 2.6)
    plants = slab(0.46, width - 0.1, 0.5, rng.uniform(0.9, 1.4), "hedge")
    return (Thing("plant", (slab(0.5, width, 0.0, 0.5, "concrete"), plants)),)


def double_seats(rng: np.random.Generator) -> Group:
    """Return two rows of seats back to back."""
    return (*place_group(seats(rng), 0.32, 0.0), *place_group(seats(rng), -0.32, 0.0, np.pi))


def bistro(rng: np.random.Generator) -> Group:
    """Return a small round table with two to four stools."""
    table = Thing("table", (Cylinder(0.0, 0.0, 0.4, 0.75, 0.72, "wood"), Cylinder(0.0, 0.0, 0.04, 0.72, 0.03, "metal"),
                            Cylinder(0.0, 0.0, 0.25, 0.03, 0.0, "metal")))  # fmt: skip
    turns = rng.uniform(0, 2 * np.pi) + np.arange(int(rng.integers(2, 5))) * np.pi / 2
    seat = (Cylinder(0.0, 0.0, 0.19, 0.48, 0.44, "wood"), Cylinder(0.0, 0.0, 0.03, 0.44, 0.02, "metal"),
            Cylinder(0.0, 0.0, 0.18, 0.02, 0.0, "metal"))  # fmt: skip
    stools = [Thing("stool", seat, x_m=0.65 * float(np.cos(turn)), y_m=0.65 * float(np.sin(turn))) for turn in turns]
    return (table, *stools)


def stairs(rng: np.random.Generator, top_m: float) -> Group:
    """Return a flight of stairs that climbs along y from its lowest end to ``top_m``, with a rail at its front."""
    steps = round(top_m / 0.2)
    rise, tread, wide = top_m / steps, 0.28, rng.uniform(1.8, 2.4)
    ys = (np.arange(steps) - (steps - 1) / 2) * tread
    treads = [Box(0.0, y, wide, tread, (k + 1) * rise, 0.0 if k < 9 else (k - 3) * rise, 0.0, "concrete")
              for k, y in enumerate(ys.tolist())]  # fmt: skip
    return (Thing("stairs", tuple(treads)),)


def trailer(rng: np.random.Generator) -> Group:
    """Return the inside of a trailer at a gate, with its open end toward the highest x."""
    long, wide, top = 8.0, 2.5, 2.7
    sides = [Box(0.0, s * (wide / 2 - 0.03), long, 0.06, top, 0.02, 0.0, "metal") for s in (-1, 1)]
    front = Box(-long / 2 + 0.03, 0.0, 0.06, wide - 0.12, top, 0.02, 0.0, "metal")
    roof = slab(long, wide, top, top + 0.06, "metal")
    load = Box(-long / 2 + 1.5, 0.0, 2.6, 2.2, rng.uniform(1.2, 2.3), 0.15, 0.0, _load(rng))
    return (Thing("trailer", (*sides, front, roof, load)),)
