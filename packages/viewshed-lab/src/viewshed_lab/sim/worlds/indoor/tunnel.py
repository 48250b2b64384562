"""Tunnels and basement corridors carved out of solid walls: narrow, low, with niches, pipes, pillars and dead ends."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from viewshed_lab.sim.assets import furniture
from viewshed_lab.sim.assets import warehouse as stock
from viewshed_lab.sim.assets.furniture import Maker, place_group
from viewshed_lab.sim.assets.shapes import Box, Shape
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.indoor.agents import Building, inhabited
from viewshed_lab.sim.worlds.indoor.floor_plan import FloorPlan, floor
from viewshed_lab.sim.worlds.indoor.walls import ceiling
from viewshed_lab.sim.worlds.layout import Rect

_HALF_M = 34.0

_ALONG: tuple[tuple[Maker, float], ...] = (
    (furniture.extinguisher, 3.0), (furniture.boxes, 3.0), (furniture.radiator, 2.0), (furniture.bin_, 2.0),
    (furniture.bench, 1.0), (furniture.cabinet, 2.0), (stock.cage, 2.0), (stock.pallet, 2.0), (furniture.locker, 1.0),
)  # fmt: skip


def tunnel(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a long passage with branches, below ground, with the robots of ``plan``."""
    floor_plan, top = FloorPlan(rng), rng.uniform(2.1, 3.4)
    passages = _passages(rng)
    inside = (-_HALF_M, -20.0, _HALF_M, 20.0)
    material = ("concrete", "brick", "plaster")[int(rng.integers(3))]
    floor_plan.add(_rock(inside, passages, top, material))
    floor_plan.things.extend(ceiling(inside, top, material))
    floor_plan.spots += [((a + c) / 2, (b + d) / 2) for a, b, c, d in passages]
    _pillars(floor_plan, passages, top)
    for maker, mean in _ALONG:
        for _ in range(int(rng.poisson(mean))):
            a, b, c, d = passages[int(rng.integers(len(passages)))]
            sides = (1, 3) if c - a > d - b else (0, 2)
            if min(c - a, d - b) > 1.75:
                floor_plan.against((a, b, c, d), maker, sides)
    floor_plan.things += _pipes(rng, passages, top)
    building = Building("tunnel", inside, top, 3, tuple(passages))
    return inhabited(floor_plan, floor(None, inside, "concrete", "grass"), building, plan)


def _passages(rng: np.random.Generator) -> list[Rect]:
    """Return passages as rectangles: a long one in straight, offset runs, branches, niches and chambers."""
    passages: list[Rect] = []
    x, y, wide = -_HALF_M + 1.0, rng.uniform(-8.0, 8.0), rng.uniform(1.8, 4.5)
    while x < _HALF_M - 7.0:
        long = min(rng.uniform(7.0, 26.0), _HALF_M - 1.0 - x)
        passages.append((x, y - wide / 2, x + long, y + wide / 2))
        x += long
        aside, next_wide = rng.uniform(-7.0, 7.0), rng.uniform(1.8, 4.5)
        to = float(np.clip(y + aside, -14.0, 14.0))
        if x < _HALF_M - 7.0:  # the piece across, from one run to the next
            across = rng.uniform(1.8, 3.5)
            low, high = min(y - wide / 2, to - next_wide / 2), max(y + wide / 2, to + next_wide / 2)
            passages.append((x - across, low, x, high))
            x -= across
        y, wide = to, next_wide
    for a, b, c, d in list(passages):
        if c - a < 6.0:
            continue
        for _ in range(int(rng.integers(0, 3))):  # branches that are dead ends or join another passage
            at, broad, far = rng.uniform(a + 1.5, c - 1.5), rng.uniform(1.6, 3.2), rng.uniform(4.0, 15.0)
            up = rng.random() < 0.5
            low, high = (b, min(d + far, 19.0)) if up else (max(b - far, -19.0), d)
            passages.append((at - broad / 2, low, at + broad / 2, high))
            if rng.random() < 0.5:
                end = passages[-1][3] if up else passages[-1][1]
                deep = rng.uniform(2.5, 6.0)
                low = end - deep if up else end
                passages.append((max(at - rng.uniform(2.0, 6.0), -_HALF_M + 1), max(low, -19.0),
                                 min(at + rng.uniform(2.0, 6.0), _HALF_M - 1), min(low + deep, 19.0)))  # fmt: skip
        for at in rng.uniform(a + 0.8, c - 0.8, int(rng.integers(0, 3))).tolist():  # niches
            deep = rng.uniform(0.3, 1.0)
            low, high = (b - deep, b + 0.1) if rng.random() < 0.5 else (d - 0.1, d + deep)
            passages.append((at - 0.6, low, at + 0.6, high))
    return passages


def _rock(inside: Rect, passages: list[Rect], top_m: float, material: str) -> tuple[Thing, ...]:
    """Return the solid around passages as boxes: strips between the x edges of all passages, cut at each passage."""
    x0, y0, x1, y1 = inside
    lines = sorted({x0, x1, *(min(max(edge, x0), x1) for one in passages for edge in one[::2])})
    open_strips: list[tuple[Rect, ...]] = []
    for a, b in pairwise(lines):
        middle, at = (a + b) / 2, y0
        solid: list[Rect] = []
        for low, high in sorted((one[1], one[3]) for one in passages if one[0] < middle < one[2]):
            if low > at:
                solid.append((a, at, b, low))
            at = max(at, high)
        open_strips.append((*solid, (a, at, b, y1)))
    parts = [Box((a + c) / 2, (b + d) / 2, c - a, d - b, top_m, -0.5, 0.0, material)
             for strip in open_strips for a, b, c, d in strip if c - a > 1e-6 and d - b > 1e-6]  # fmt: skip
    return (Thing("wall", tuple(parts), z_m=0.0),)


def _pillars(floor_plan: FloorPlan, passages: list[Rect], top_m: float) -> None:
    """Add pilasters along the walls of wide passages, and columns in the middle of the widest."""
    rng = floor_plan.rng
    for a, b, c, d in passages:
        if c - a > 7.0 and d - b > 2.6:
            pitch, size = rng.uniform(2.5, 6.0), rng.uniform(0.15, 0.4)
            rows = [b + size / 2, d - size / 2] if rng.random() < 0.6 else []
            rows += [(b + d) / 2] if d - b > 3.8 and rng.random() < 0.4 else []
            part: Shape = Box(0.0, 0.0, size, size, top_m, 0.0, 0.0, "concrete")
            for y in rows:
                for x in np.arange(a + 1.0, c - 0.5, pitch).tolist():
                    if not any(p < x + 0.8 and x - 0.8 < r and q < y + 0.8 and y - 0.8 < s
                               for p, q, r, s in passages if (p, q, r, s) != (a, b, c, d)):  # fmt: skip
                        floor_plan.add(place_group((Thing("pillar", (part,)),), x, y))


def _pipes(rng: np.random.Generator, passages: list[Rect], top_m: float) -> list[Thing]:
    """Return pipes, ducts and lamps below the ceiling."""
    things = []
    for a, b, c, d in passages:
        along = c - a > d - b
        if max(c - a, d - b) < 4.0 or rng.random() < 0.3:
            continue
        for _ in range(int(rng.integers(1, 4))):
            size, share = rng.uniform(0.05, 0.35), rng.uniform(0.15, 0.85)
            low = max(top_m - rng.uniform(0.05, 0.4) - size, 1.95)
            if low + size > top_m - 0.01:
                continue
            x, y = ((a + c) / 2, b + share * (d - b)) if along else (a + share * (c - a), (b + d) / 2)
            long = (c - a - 0.2, size) if along else (size, d - b - 0.2)
            things.append(Thing("duct", (Box(x, y, *long, low + size, low, 0.0, "metal"),), z_m=0.0))
    return things
