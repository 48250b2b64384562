"""Surroundings of country roads: posts, rails, trees and fences along them, and fields with objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from viewshed_lab.sim.assets.country import animal, bale, dry_wall, rock, tractor, wire_fence, wire_pole, wooden_fence
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.assets.street import bush, conifer, fence, guard_rail, hedge, pick, place_at, pole, sign, tree
from viewshed_lab.sim.assets.vehicles import car, highway_vehicle, motorcycle, truck, van
from viewshed_lab.sim.world import Thing
from viewshed_lab.sim.worlds.layout import Span, spots
from viewshed_lab.sim.worlds.outdoor_ground import Relief
from viewshed_lab.sim.worlds.roadway import HALF_M, Roadway, row
from viewshed_lab.sim.worlds.site_plan import SitePlan
from viewshed_lab.sim.worlds.traffic import Pace

COUNTRY_PACE = Pace(110.0, 50.0, (7.0, 22.0), (8.0, 30.0, 130.0))
"""Traffic parameters of country roads."""

WHOLE: Span = (-HALF_M + 2.0, HALF_M - 2.0)


def climb(rng: np.random.Generator, steepest: float) -> Relief:
    """Return heights along x of a road with slopes of at most ``steepest``, including crests and dips."""
    grade, wave = rng.uniform(-0.5, 0.5) * steepest, rng.uniform(110.0, 260.0)
    high = rng.uniform(0.1, 0.5) * steepest * wave / (2 * np.pi)
    return Relief((grade, 0.0), (high, 0.0), (wave, 100.0), (rng.uniform(0, 6.28), 0.0))


def fields(rng: np.random.Generator, high_m: float, steepest: float = 0.03) -> Relief:
    """Return the relief of fields beside a road: a gentle slope with waves of at most ``high_m``."""
    ways = (rng.uniform(-steepest, steepest), rng.uniform(-steepest, steepest))
    waves, lengths = rng.uniform(0.0, high_m, 2), rng.uniform(40.0, 140.0, 2)
    phases = rng.uniform(0, 6.28, 2)
    return Relief(ways, (float(waves[0]), float(waves[1])), (float(lengths[0]), float(lengths[1])),
                  (float(phases[0]), float(phases[1])))  # fmt: skip


def country_vehicle(rng: np.random.Generator) -> Thing:
    """Return a vehicle of country traffic."""
    draw = rng.random()
    if draw < 0.12:
        return tractor(rng) if draw < 0.05 else motorcycle(rng)
    return van(rng) if draw < 0.2 else truck(rng) if draw < 0.27 else highway_vehicle(rng) if draw < 0.4 else car(rng)


def posts(road: Roadway, side: int, step_m: float) -> list[Thing]:
    """Return reflecting posts on the shoulder."""
    across = side * (road.edge_m - 0.25)
    return [road.bend.put(pole(1.0, 0.05, "sign"), x, across) for x in np.arange(*WHOLE, step_m).tolist()]


def rail(rng: np.random.Generator, road: Roadway, side: int) -> list[Thing]:
    """Return a guard rail on the shoulder along a part of the road."""
    long = rng.uniform(0.3, 1.0) * 224.0
    middle = rng.uniform(-0.5, 0.5) * (2 * HALF_M - long)
    span = (max(middle - long / 2, WHOLE[0]), min(middle + long / 2, WHOLE[1]))
    return row(road.bend, guard_rail, span, side * (road.edge_m - 0.6))


def signs(rng: np.random.Generator, road: Roadway, side: int, count: int) -> list[Thing]:
    """Return signs that face the traffic of one side, just beyond the shoulder."""
    turn = 0.0 if side < 0 else np.pi
    return [road.bend.put(sign(rng), x, side * (road.edge_m + 0.35), turn) for x in rng.uniform(*WHOLE, count).tolist()]


def border(rng: np.random.Generator, road: Roadway, side: int, across_m: float) -> list[Thing]:
    """Return a fence of wire, mesh or boards, a hedge or a wall that follows the road, with gaps."""
    high = rng.uniform(0.9, 1.6)
    makers: tuple[Callable[[float], Thing], ...] = (
        lambda long: wire_fence(long, high),
        lambda long: wooden_fence(long, high, int(2 + (high > 1.2))),
        lambda long: fence(long, high),
        lambda long: hedge(rng, long, high),
        lambda long: dry_wall(rng, long, 0.8 * high),
    )
    maker = makers[int(rng.choice(5, p=(0.3, 0.25, 0.1, 0.2, 0.15)))]
    pieces = row(road.bend, maker, WHOLE, side * across_m, 7.0)
    start, gap = rng.integers(0, len(pieces)), rng.integers(1, 5)
    return [piece for k, piece in enumerate(pieces) if not start <= k < start + gap]


def trees(rng: np.random.Generator, road: Roadway, side: int, across_m: Span, gap_m: Span) -> list[Thing]:
    """Return trees and bushes along one side, at distances from the axis between two."""
    things = []
    for x in spots(rng, WHOLE, 3.0, gap_m):
        draw = rng.random()
        thing = tree(rng, 2.2, rng.uniform(3.0, 6.5)) if draw < 0.55 else conifer(rng) if draw < 0.7 else bush(rng, 1.8)
        things.append(road.bend.put(thing, x, side * rng.uniform(*across_m)))
    return things


def in_fields(rng: np.random.Generator, site: SitePlan, busy: float) -> None:
    """Put bales, animals, rocks, lone trees, tractors and hedges, fences and walls at any angle into the fields."""
    counts = rng.poisson(np.array([4.0, 4.0, 5.0, 7.0, 0.7, 3.0]) * busy)
    spread = (WHOLE[0] + 4.0, WHOLE[0] + 4.0, WHOLE[1] - 4.0, WHOLE[1] - 4.0)
    loose: list[Thing] = []
    for maker, count in zip((bale, animal, rock), counts[:3].tolist(), strict=True):
        loose += [maker(rng) for _ in range(count)]
    loose += [tree(rng, 2.0, rng.uniform(4.0, 8.0)) if rng.random() < 0.6 else bush(rng, 2.2) for _ in range(counts[3])]
    loose += [tractor(rng) for _ in range(counts[4])]
    for _ in range(counts[5]):
        long, high = rng.uniform(5.0, 22.0), rng.uniform(0.9, 2.0)
        loose.append(pick(rng, (hedge(rng, long, high), wire_fence(long, 1.2), wooden_fence(long, 1.2),
                                dry_wall(rng, long, min(high, 1.3)))))  # fmt: skip
    site.scatter(rng, loose, spread)


def wires(rng: np.random.Generator, road: Roadway, side: int, across_m: float) -> list[Thing]:
    """Return a line of wooden poles along a road, wires from one to the next."""
    edges = np.arange(WHOLE[0], WHOLE[1], rng.uniform(35.0, 45.0)).tolist()
    things = []
    for start, end in pairwise(edges):
        (x0, y0, _), (x1, y1, _) = (road.bend.at(x, side * across_m) for x in (start, end))
        span = float(np.hypot(x1 - x0, y1 - y0))
        things.append(place_at(wire_pole(rng, span), x0, y0, float(np.arctan2(y1 - y0, x1 - x0))))
    return things


def upright(road: Roadway, thing: Thing, x_m: float, across_m: float, at_m: float, turn: float = 0.0) -> Thing:
    """Return the thing beside the axis, upright, its foot at the height of the road ``at_m`` left of the axis."""
    x, y, _ = road.bend.at(x_m, at_m)
    placed = road.bend.put(thing, x_m, across_m, turn)
    return replace(placed, tilts=False, z_m=float(road.height(np.array(x), np.array(y))))


def retaining_wall(
    rng: np.random.Generator, road: Roadway, side: int, step_m: tuple[float, float], gate: Span = (0.0, 0.0)
) -> list[Thing]:
    """Return a wall that holds the ground beside a road, in upright pieces with pilasters, and a parapet or none.

    Args:
        rng: material and parapet.
        road: along which it stands.
        side: left (1) or right (-1).
        step_m: how far beyond the shoulder its middle is, and how much higher (negative: lower) the ground behind is.
        gate: a stretch along x that stays open.
    """
    (beyond, high), piece = step_m, 4.0
    material, parapet = pick(rng, ("concrete", "brick", "concrete")), pick(rng, (0.2, 0.4, 1.0))
    things = []
    for x in np.arange(WHOLE[0] + piece / 2, WHOLE[1], piece).tolist():
        if gate[0] < x < gate[1]:
            continue
        step = high * float(road.swell.at(np.array(x)))
        top, bottom = max(step, 0.0) + parapet, min(step, 0.0) - 1.5
        parts = (Box(0.0, 0.0, 1.08 * piece, 0.5, top, bottom, 0.0, material),
                 Box(0.0, -side * 0.32, 0.5, 0.15, top - 0.1, bottom, 0.0, material))  # fmt: skip
        wall = Thing("retaining_wall", parts)
        things.append(upright(road, wall, x, side * (road.edge_m + beyond), side * (road.edge_m - 0.3)))
    return things
