"""A residential street: houses with gardens, hedges, fences, driveways with cars, garages, trees and bushes."""

from __future__ import annotations

import numpy as np

from viewshed_lab.sim.assets.buildings import family_house, garage
from viewshed_lab.sim.assets.street import bin_, bush, conifer, fence, hedge, lamp_post, person, pick, sign, tree, wall
from viewshed_lab.sim.assets.vehicles import car, cyclist, parked_vehicle, street_vehicle, van
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.frontage import PARKING_M, Side, parked, walkers
from viewshed_lab.sim.worlds.layout import Mast, Span, assembled, mast, spots
from viewshed_lab.sim.worlds.outdoor_ground import Ground, Road, relief
from viewshed_lab.sim.worlds.traffic import Pace, driven, straight_lane

_HALF_X_M, _HALF_Y_M, _ROAM_M = 112.0, 70.0, 50.0
_DRIVE_M = 3.6
_PACE = Pace(_HALF_X_M, _ROAM_M, (4.0, 9.0), (15.0, 40.0, 120.0))


def residential(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a residential street with the agents of ``plan``."""
    wide = rng.uniform(2.6, 3.1)
    road = Road(wide + PARKING_M + 0.1, rng.uniform(1.5, 2.4), rng.uniform(0.1, 0.13))
    bumps = tuple(rng.uniform(-45, 45, int(rng.integers(0, 3))).tolist())
    ground = Ground(relief(rng, wave_m=0.8), road, None, rng.uniform(0.0, 0.3), "grass", bumps)
    sides = [Side(yaw, road, rng.uniform(3.5, 8.0), rng.uniform(8.0, 11.0), rng.uniform(0.05, 0.6),
                  rng.uniform(0.1, 0.9), (6.0, 18.0)) for yaw in (0.0, np.pi)]  # fmt: skip
    masts = _masts(rng, plan.roadside, road)
    still = [thing for one in sides for thing in _lined(rng, one, masts, bumps)]
    lanes = [straight_lane(0.0, -wide / 2, 0.0), straight_lane(0.0, wide / 2, np.pi)]
    moving = driven(rng, plan, lanes, _PACE, _vehicle)
    moving += [rider for one in sides for rider in walkers(rng, one, 60.0, plan.duration_s)]
    return assembled("residential", ground.terrain(_HALF_X_M, _HALF_Y_M), plan, still, moving, masts)


def _masts(rng: np.random.Generator, count: int, road: Road) -> list[Mast]:
    masts_placed = []
    for k in range(count):
        x, side = (k + 0.5 - count / 2) * 80.0 / count + rng.uniform(-5, 5), pick(rng, (-1, 1))
        masts_placed.append(mast(rng, x, side * (road.half_m + 0.55), (x + rng.uniform(-15, 15), -side)))
    return masts_placed


def _lined(rng: np.random.Generator, one: Side, masts: list[Mast], bumps: tuple[float, ...]) -> list[Thing]:
    """Return one side of the street: plots, and at the curb cars and furniture clear of driveways and masts."""
    flip, drives, things = np.cos(one.yaw), list[Span](), list[Thing]()
    closed = [(flip * post.x_m - 2.4, flip * post.x_m + 2.4) for post in masts if post.y_m * flip > 0]
    at = -_HALF_X_M
    while at < _HALF_X_M - 12.0:
        length = rng.uniform(15.0, 24.0)
        plot, drive = _plot(rng, one, (at, at + length), closed)
        things += plot
        drives.append(drive)
        at += length
    humps = [(flip * bump - 1.2, flip * bump + 1.2) for bump in bumps]
    things += parked(rng, one, (-_HALF_X_M, _HALF_X_M), drives + humps)
    for u in spots(rng, (-_HALF_X_M, _HALF_X_M), 1.0, one.furniture_gap_m, drives + closed):
        thing, turn = _small(rng)
        things.append(one.put(thing, u, one.road.half_m + 0.4, turn))
    return things


def _small(rng: np.random.Generator) -> tuple[Thing, float]:
    draw = rng.random()
    if draw < 0.35:
        return lamp_post(rng, 1.2), -np.pi / 2
    if draw < 0.55:
        return sign(rng), np.pi
    return (bin_(rng), 0.0) if draw < 0.85 else (person(rng), rng.uniform(-3, 3))


def _plot(rng: np.random.Generator, one: Side, span: Span, closed: list[Span]) -> tuple[list[Thing], Span]:
    """Return the things on a plot (driveway and garage at its start, the house beside it), and the driveway's span."""
    blocked = any(a < span[0] + _DRIVE_M + 0.4 and b > span[0] for a, b in closed)
    drive = (span[0] + 0.3, span[0] + 0.3 + _DRIVE_M)
    front = one.road.edge_m + one.setback_m + rng.uniform(-1.0, 2.0)
    things: list[Thing] = []
    if not blocked:
        things += _drive(rng, one, sum(drive) / 2, front)
    long = min(rng.uniform(8.0, 13.0), span[1] - drive[1] - 2.4)
    middle = drive[1] + 0.9 + long / 2 + rng.uniform(0.0, max(0.0, span[1] - drive[1] - long - 2.0))
    things.append(one.put(family_house(rng, long, one.depth_m, abs(middle) > 60.0), middle, front))
    garden = (span[0] if blocked else drive[1], span[1])
    things += _boundary(rng, one, garden)
    things += _garden(rng, one, (drive[1] + 0.6, span[1] - 0.6), front)
    return things, (0.0, 0.0) if blocked else drive


def _drive(rng: np.random.Generator, one: Side, middle_m: float, front_m: float) -> list[Thing]:
    """Return a garage, set back behind the front of the house, and often a car before it."""
    back = front_m + rng.uniform(1.0, 3.0)
    things = [one.put(garage(rng), middle_m, back)] if rng.random() < 0.75 else []
    room = back - one.road.edge_m
    if rng.random() < 0.6 and room > 6.5:
        thing = van(rng) if rng.random() < 0.07 and room > 7.5 else car(rng)
        turn = pick(rng, (-1, 1)) * np.pi / 2 + rng.normal(0, 0.02)
        things.append(one.put(thing, middle_m, back - 3.4, turn))
    return things


def _boundary(rng: np.random.Generator, one: Side, garden: Span) -> list[Thing]:
    """Return a hedge, fence, wall or nothing along the sidewalk, with a gate left open."""
    start, end, draw, across = garden[0] + 0.1, garden[1] - 0.1, rng.random(), one.road.edge_m + 0.5
    gate = rng.uniform(start + 2.0, end - 3.0)
    things: list[Thing] = []
    high, mesh = rng.uniform(0.7, 1.9), pick(rng, ("mesh", "wood"))
    for a, b in ((start, gate), (gate + 1.2, end)):
        if draw < 0.4:
            things.append(one.put(hedge(rng, b - a, high), (a + b) / 2, across))
        elif draw < 0.62:
            things.append(one.put(fence(b - a, min(high, 1.4), mesh), (a + b) / 2, across))
        elif draw < 0.8:
            things.append(one.put(wall(b - a, min(high, 1.2)), (a + b) / 2, across))
    return things


def _garden(rng: np.random.Generator, one: Side, span: Span, front_m: float) -> list[Thing]:
    """Return trees and bushes before and behind the house, and sometimes a hedge at the end of the plot."""
    things, before = [], front_m - one.road.edge_m - 1.2
    for u in spots(rng, span, 2.6, (0.8, 11.0)):
        if before > 2.8:
            crown = float(np.clip(before + 1.2, 2.0, 6.0))
            thing = tree(rng, 2.2, crown) if rng.random() < one.green * 0.7 else bush(rng, rng.uniform(0.8, 1.7))
            things.append(one.put(thing, u, one.road.edge_m + 1.2 + before / 2 + rng.uniform(-0.2, 0.2)))
    back = front_m + one.depth_m + 3.5
    for u in spots(rng, span, 3.6, (3.0, 20.0)):
        thing = conifer(rng) if rng.random() < 0.3 else tree(rng, 1.8, rng.uniform(4.0, 7.0))
        things.append(one.put(thing, u, back + rng.uniform(0.0, 6.0)))
    return things


def _vehicle(rng: np.random.Generator) -> Thing:
    draw = rng.random()
    return cyclist(rng) if draw < 0.2 else parked_vehicle(rng) if draw < 0.9 else street_vehicle(rng)
