"""Makers of what stands in the country: fences of posts and rails, bales, poles with wires, rocks, cattle."""

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
