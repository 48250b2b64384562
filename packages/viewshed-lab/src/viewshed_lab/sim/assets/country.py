"""Makers of country objects: fences of posts and rails, bales, poles with wires, rocks, cattle.

Makers of objects on building sites and in yards: containers, piles, scaffolds, cranes, machines.
"""

from __future__ import annotations

import numpy as np

from viewshed_lab.sim.assets.shapes import Box, Cylinder, Ellipsoid, Shape
from viewshed_lab.sim.assets.street import pick
from viewshed_lab.sim.world import Thing

_POST_STEP_M = 2.8


def wooden_fence(length_m: float, height_m: float, rails: int = 3) -> Thing:
    """Return a fence along x of round posts and ``rails`` boards, open between them."""
    tops = np.linspace(0.35, 1.0, rails) * height_m
    boards = [Box(0.0, 0.0, length_m, 0.04, float(top), float(top) - 0.1, 0.0, "wood") for top in tops]
    return Thing("fence", (*boards, *_posts(length_m, 0.06, height_m + 0.08)), tilts=True)


def wire_fence(length_m: float, height_m: float) -> Thing:
    """Return a fence along x of thin posts and wires of 5 mm."""
    tops = np.linspace(0.25, 1.0, 4) * height_m
    lines = [Box(0.0, 0.0, length_m, 0.005, float(top), float(top) - 0.005, 0.0, "metal") for top in tops]
    return Thing("fence", (*lines, *_posts(length_m, 0.04, height_m + 0.1)), tilts=True)


def dry_wall(rng: np.random.Generator, length_m: float, height_m: float) -> Thing:
    """Return a wall of field stones along x: broad at its foot, its top uneven."""
    pieces = max(1, round(length_m / 2.5))
    step = length_m / pieces
    parts: list[Shape] = [Box(0.0, 0.0, length_m, 0.6, 0.5 * height_m, -0.6, 0.0, "concrete")]
    for k, top in enumerate((rng.uniform(0.85, 1.05, pieces) * height_m).tolist()):
        parts.append(Box((k + 0.5 - pieces / 2) * step, 0.0, step, 0.42, top, 0.4 * height_m, 0.0, "concrete"))
    return Thing("wall", tuple(parts), tilts=True)


def bale(rng: np.random.Generator) -> Thing:
    """Return a round bale of straw on its end, or a stack of square ones."""
    if rng.random() < 0.6:
        return Thing("bale", (Cylinder(0.0, 0.0, rng.uniform(0.6, 0.8), rng.uniform(1.1, 1.3), -0.2, "wood"),))
    high = int(rng.integers(1, 4))
    sizes = [(2.4 - 0.3 * k, 0.9 * k, 0.9 * (k + 1)) for k in range(high)]
    return Thing("bale", tuple(Box(0.0, 0.0, size, 1.2, top, low - 0.2 * (low == 0), 0.0, "wood")
                               for size, low, top in sizes))  # fmt: skip


def wire_pole(rng: np.random.Generator, span_m: float) -> Thing:
    """Return a wooden pole with a cross-arm and the wires that lead ``span_m`` ahead from it."""
    high = rng.uniform(7.0, 9.0)
    wires = [Box(span_m / 2, y, span_m, 0.02, high - 0.3, high - 0.32, 0.0, "metal") for y in (-0.7, 0.0, 0.7)]
    arm = Box(0.0, 0.0, 0.12, 1.6, high - 0.2, high - 0.35, 0.0, "wood")
    return Thing("pole", (Cylinder(0.0, 0.0, 0.13, high, -1.0, "wood"), arm, *wires))


def rock(rng: np.random.Generator) -> Thing:
    """Return a boulder of 0.5 to 2 m."""
    long, wide, tall = rng.uniform(0.5, 2.0), rng.uniform(0.5, 1.6), rng.uniform(0.3, 1.2)
    return Thing("rock", (Ellipsoid(0.0, 0.0, long, wide, tall, -0.6 * tall, 0.0, "concrete"),))


def animal(rng: np.random.Generator) -> Thing:
    """Return a cow, a horse or a sheep that stands in a field: body, neck, four legs."""
    size = pick(rng, (0.55, 1.0, 1.15)) * rng.uniform(0.9, 1.1)
    legs = [Cylinder(x * size, y * size, 0.06 * size, 0.75 * size, -0.1, "clothes")
            for x in (-0.6, 0.6) for y in (-0.18, 0.18)]  # fmt: skip
    body = Ellipsoid(0.0, 0.0, 1.9 * size, 0.66 * size, 1.4 * size, 0.65 * size, 0.0, "clothes")
    head = Ellipsoid(1.05 * size, 0.0, 0.6 * size, 0.26 * size, 1.55 * size, 1.1 * size, 0.0, "clothes")
    return Thing("animal", (body, head, *legs))


def tractor(rng: np.random.Generator) -> Thing:
    """Return a tractor with a cabin of glass and large rear wheels; often a trailer or a plow behind it."""
    wheels = [Box(-0.9, y, 1.6, 0.45, 1.6, 0.0, 0.0, "rubber") for y in (-0.85, 0.85)]
    wheels += [Box(1.2, y, 1.0, 0.35, 1.0, 0.0, 0.0, "rubber") for y in (-0.75, 0.75)]
    parts: list[Shape] = [
        *wheels,
        Box(0.9, 0.0, 2.2, 0.8, 1.55, 0.55, 0.0, "paint"),
        Box(-0.7, 0.0, 1.3, 1.25, 2.6, 1.0, 0.0, "cabin"),
        Box(-0.7, 0.0, 1.5, 1.4, 2.72, 2.6, 0.0, "paint"),
    ]
    if rng.random() < 0.5:
        parts += [
            Box(-4.6, 0.0, 4.4, 2.2, rng.uniform(1.4, 2.4), 0.8, 0.0, "wood"),
            Box(-4.9, 0.0, 1.9, 2.1, 0.8, 0.0, 0.0, "rubber"),
        ]
    return Thing("tractor", tuple(parts), tilts=True)


def _posts(length_m: float, radius_m: float, top_m: float) -> list[Cylinder]:
    count = max(2, int(np.ceil(length_m / _POST_STEP_M)) + 1)
    ends = np.linspace(-length_m / 2 + radius_m, length_m / 2 - radius_m, count)[:-1]
    return [Cylinder(float(x), 0.0, radius_m, top_m, -0.5, "wood" if radius_m > 0.05 else "metal") for x in ends]


def container(rng: np.random.Generator) -> Thing:
    """Return a container of 6.1 or 12.2 m along x, sometimes two or three on top of each other."""
    long, count = pick(rng, (6.06, 6.06, 12.19)), int(rng.integers(1, 4)) if rng.random() < 0.35 else 1
    parts = [Box(0.0, 0.0, long, 2.44, 2.6 * (k + 1), 2.6 * k - 0.3 * (k == 0), 0.0,
                 pick(rng, ("paint", "metal", "dark_paint"))) for k in range(count)]  # fmt: skip
    return Thing("container", tuple(parts))


def site_office(rng: np.random.Generator) -> Thing:
    """Return a cabin of 6 m with windows, sometimes a second one on it with a stair before it."""
    parts: list[Shape] = []
    for k in range(2 if rng.random() < 0.3 else 1):
        low = 2.7 * k
        parts += [
            Box(0.0, 0.0, 6.0, 2.4, low + 1.0, low - 0.3 * (k == 0), 0.0, "paint"),
            Box(0.0, 0.0, 6.0, 2.4, low + 2.6, low + 2.0, 0.0, "paint"),
            *(Box(x, 0.0, wide, 2.4, low + 2.0, low + 1.0, 0.0, "paint")
              for x, wide in ((-2.4, 1.2), (0.2, 1.0), (2.7, 0.6))),
            *(Box(0.0, y, 5.8, 0.02, low + 2.0, low + 1.0, 0.0, "glass") for y in (-1.17, 1.17)),
        ]  # fmt: skip
    return Thing("cabin", tuple(parts))


def heap(rng: np.random.Generator, wide_m: float) -> Thing:
    """Return a heap of earth, sand or rubble about ``wide_m`` across, as steep as such heaps are."""
    high, material = wide_m * rng.uniform(0.22, 0.36), pick(rng, ("grass", "concrete", "brick"))
    parts = [Ellipsoid(0.0, 0.0, wide_m, 0.9 * wide_m, high, -high, rng.uniform(0, 3), material)]
    for _ in range(int(rng.integers(0, 3))):
        x, y = (rng.uniform(-0.22, 0.22, 2) * wide_m).tolist()
        size = rng.uniform(0.3, 0.55) * wide_m
        parts.append(Ellipsoid(x, y, size, size, 0.9 * high, -0.5 * high, 0.0, material))
    return Thing("heap", tuple(parts))


def pipes(rng: np.random.Generator) -> Thing:
    """Return a stack of beams, planks or formwork along x."""
    long, rows = rng.uniform(3.0, 8.0), int(rng.integers(1, 4))
    material = pick(rng, ("metal", "wood", "concrete"))
    parts = [Box(0.0, 0.0, long, 1.6 - 0.25 * k, 0.12 + 0.35 * (k + 1), 0.12 + 0.35 * k + 0.04, 0.0, material)
             for k in range(rows)]  # fmt: skip
    feet = [Box(x * long, 0.0, 0.12, 1.6, 0.14, -0.1, 0.0, "wood") for x in (-0.35, 0.35)]
    return Thing("stack", (*parts, *feet))


def scaffold(rng: np.random.Generator, length_m: float, lifts: int) -> Thing:
    """Return a scaffold along x: standards 2.5 m apart in two rows, decks every 2 m, rails; 1 m deep to both sides."""
    bays = max(1, round(length_m / 2.5))
    ends, top = np.linspace(-length_m / 2, length_m / 2, bays + 1).tolist(), 2.0 * lifts + 1.0
    parts: list[Shape] = [Cylinder(x, y, 0.025, top, -0.2, "metal") for x in ends for y in (-0.45, 0.45)]
    for k in range(1, lifts + 1):
        parts.append(Box(0.0, 0.0, length_m, 0.7, 2.0 * k, 2.0 * k - 0.06, 0.0, "wood"))
        parts += [Box(0.0, -0.45, length_m, 0.04, 2.0 * k + h, 2.0 * k + h - 0.04, 0.0, "metal") for h in (0.5, 1.0)]
    if rng.random() < 0.4:
        parts.append(Box(0.0, -0.52, length_m, 0.03, top, 0.3, 0.0, "mesh"))
    return Thing("scaffold", tuple(parts))


def shell(rng: np.random.Generator, length_m: float, depth_m: float) -> Thing:
    """Return the shell of a building: slabs on columns, some walls, empty openings."""
    floors, rise = int(rng.integers(1, 4)), rng.uniform(2.9, 3.4)
    parts: list[Shape] = []
    across = [
        (x, y) for x in np.linspace(-0.46, 0.46, max(3, round(length_m / 5.0))).tolist() for y in (0.04, 0.5, 0.96)
    ]
    for k in range(floors):
        low = k * rise
        parts += [Box(x * length_m, y * depth_m, 0.35, 0.35, low + rise - 0.22, low - 2.0 * (k == 0), 0.0, "concrete")
                  for x, y in across]  # fmt: skip
        parts.append(Box(0.0, depth_m / 2, length_m, depth_m, low + rise, low + rise - 0.22, 0.0, "concrete"))
        if rng.random() < 0.6:
            wide = rng.uniform(0.2, 0.5) * length_m
            at = rng.uniform(-0.5, 0.5) * (length_m - wide)
            parts.append(Box(at, 0.15, wide, 0.2, low + rise - 0.22, low - 2.0 * (k == 0), 0.0, "brick"))
    parts.append(Box(0.2 * length_m, 0.6 * depth_m, 3.0, 3.0, floors * rise + 2.2, -2.0, 0.0, "concrete"))
    return Thing("building", tuple(parts))


def tower_crane(rng: np.random.Generator) -> Thing:
    """Return a tower crane: ballast, a lattice mast, a jib overhead with its hook."""
    high, reach = rng.uniform(16.0, 24.0), rng.uniform(18.0, 30.0)
    mast = [Box(x, y, 0.16, 0.16, high, 0.0, 0.0, "metal") for x in (-0.75, 0.75) for y in (-0.75, 0.75)]
    braces = [Box(0.0, y, 1.5, 0.06, float(z) + 0.08, float(z), 0.0, "metal")
              for z in np.arange(1.5, high - 1.0, 1.8) for y in (-0.75, 0.75)]  # fmt: skip
    jib = Box(reach / 2 - 4.0, 0.0, reach + 8.0, 1.0, high + 0.8, high, 0.0, "mesh")
    hook = Box(rng.uniform(0.4, 0.9) * reach, 0.0, 0.5, 0.5, high - rng.uniform(4.0, 12.0), high - 13.0, 0.0, "metal")
    return Thing("crane", (Box(0.0, 0.0, 4.2, 4.2, 0.7, -0.4, 0.0, "concrete"), *mast, *braces, jib, hook))


def excavator(rng: np.random.Generator) -> Thing:
    """Return a tracked excavator: tracks, body, cabin, and an arm in two pieces ahead of it."""
    reach = rng.uniform(3.0, 4.5)
    parts = (
        *(Box(0.0, y, 3.6, 0.55, 0.85, 0.0, 0.0, "rubber") for y in (-1.05, 1.05)),
        Box(-0.5, 0.0, 3.0, 2.5, 1.9, 0.95, 0.0, "paint"),
        Box(0.4, 0.7, 1.4, 0.95, 2.9, 1.9, 0.0, "cabin"),
        Box(1.0 + reach / 4, -0.2, reach / 2, 0.4, 3.4, 2.3, 0.0, "paint"),
        Box(1.0 + 0.75 * reach, -0.2, reach / 2, 0.35, 3.3, 2.6, 0.0, "paint"),
        Box(1.0 + reach, -0.2, 0.4, 0.3, 2.9, 0.6, 0.0, "paint"),
        Box(1.0 + reach, -0.2, 0.9, 0.9, 0.7, 0.05, 0.0, "metal"),
    )
    return Thing("excavator", parts, tilts=True)


def dumper(rng: np.random.Generator) -> Thing:
    """Return a tipper of 7 m: cab, bed with or without its load."""
    wheels = [Box(x, 0.0, 1.1, 2.3, 1.1, 0.0, 0.0, "rubber") for x in (-2.4, -1.0, 2.3)]
    bed = [Box(-1.3, 0.0, 4.4, 2.4, rng.uniform(1.9, 2.4), 1.15, 0.0, "metal")]
    load = [Ellipsoid(-1.3, 0.0, 4.0, 2.2, rng.uniform(2.5, 3.0), 1.4, 0.0, "concrete")] if rng.random() < 0.6 else []
    cab = Box(2.4, 0.0, 1.9, 2.4, 2.9, 0.6, 0.0, pick(rng, ("paint", "sign", "paint")))
    return Thing("truck", (*wheels, *bed, *load, cab, Box(0.0, 0.0, 6.0, 0.9, 1.1, 0.6, 0.0, "dark_paint")), tilts=True)


def barrels(rng: np.random.Generator) -> Thing:
    """Return a few barrels or a mixer on the ground."""
    spots = [(0.0, 0.0), (0.65, 0.1), (0.25, 0.6)][: int(rng.integers(1, 4))]
    return Thing("barrels", tuple(Cylinder(x, y, 0.29, 0.88, -0.1, pick(rng, ("paint", "metal"))) for x, y in spots))
