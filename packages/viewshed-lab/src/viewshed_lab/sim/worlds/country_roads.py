"""Roads out of town that bend and climb: through fields, over open land, on an embankment, in a cutting."""

from __future__ import annotations

import numpy as np

from viewshed_lab.sim.assets.street import concrete_barrier, lamp_post, place_at
from viewshed_lab.sim.world import AgentPlan, World
from viewshed_lab.sim.worlds.layout import assembled
from viewshed_lab.sim.worlds.roadsides import (
    COUNTRY_PACE,
    WHOLE,
    border,
    climb,
    country_vehicle,
    fields,
    in_fields,
    posts,
    rail,
    retaining_wall,
    signs,
    trees,
    wires,
)
from viewshed_lab.sim.worlds.roadway import HALF_M, LEVEL, Bank, Roadway, Swell, random_bend, row
from viewshed_lab.sim.worlds.site_plan import beside
from viewshed_lab.sim.worlds.traffic import Pace, driven


def country_road(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a country road, sometimes of gravel, with the agents of ``plan`` on it and beside it.

    A country road that bends and climbs through fields: ditches, trees, hedges, fences, walls at any angle.
    """
    slope = rng.uniform(-0.18, 0.18)
    road = Roadway(
        random_bend(rng, 0.38, (130.0, 320.0)), climb(rng, 0.12), 1, rng.uniform(2.6, 3.4), rng.uniform(0.4, 1.3),
        (_bank(rng, slope), _bank(rng, -slope)), Swell(1.0, rng.uniform(0.0, 0.6), rng.uniform(90, 200), 0.0),
        fields(rng, 1.4), "grass", "asphalt" if rng.random() < 0.8 else "concrete",
    )  # fmt: skip
    masts, site = beside(rng, plan, road.bend, road.edge_m + 1.6, road.edge_m - 0.4)
    for side in (-1, 1):
        beyond = road.edge_m + road.bank(side).beyond_m[-2]  # where the ditch ends
        if rng.random() < 0.6:
            site.put_all(posts(road, side, rng.uniform(12.0, 40.0)))
        site.put_all(signs(rng, road, side, int(rng.integers(0, 3))))
        if rng.random() < 0.75:
            site.put_all(border(rng, road, side, beyond + rng.uniform(0.3, 2.0)))
        if rng.random() < 0.25:
            site.put_all(wires(rng, road, side, beyond + 2.8))
        near = beyond + (0.6 if rng.random() < 0.5 else 3.0)
        site.put_all(trees(rng, road, side, (near, near + rng.uniform(0.5, 9.0)), (2.0, rng.uniform(6.0, 60.0))))
    in_fields(rng, site, rng.uniform(0.2, 1.6))
    moving = driven(rng, plan, road.lane_lines(), COUNTRY_PACE, country_vehicle)
    return assembled("country_road", road.terrain(6.2, 1.6), plan, site.things, moving, masts)


def _bank(rng: np.random.Generator, slope: float) -> Bank:
    """Return a ditch or none, and then the hillside, which rises or falls by ``slope``."""
    deep = rng.uniform(0.3, 0.9) if rng.random() < 0.7 else 0.0
    wide, out = rng.uniform(0.8, 1.6), rng.uniform(18.0, 40.0)
    lip = rng.uniform(-0.2, 0.6)
    beyond = (0.0, wide, wide + 0.4, 2 * wide + 0.6, 2 * wide + out)
    return Bank(beyond, (0.0, -deep, -deep, lip, lip + slope * out))


_PACE = Pace(110.0, 50.0, (2.0, 12.0), (20.0, 150.0, 600.0))


def open_field(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a track over open land, level or undulating, or an empty lot of asphalt, with the agents of ``plan``.

    An open field, a large lot or a plain with almost nothing in range: few returns, and those from the ground.
    """
    lot = rng.random() < 0.35
    land = fields(rng, 0.15 if lot else 1.8, 0.015 if lot else 0.05)
    ground = "asphalt" if lot and rng.random() < 0.7 else "concrete" if lot else "grass"
    bend, grade = random_bend(rng, 0.25), climb(rng, 0.01 if lot else 0.07)
    road = Roadway(bend, grade, 1, 2.6, 0.3, LEVEL, rough=land, soil=ground, paved="asphalt" if lot else "grass")
    masts, site = beside(rng, plan, road.bend, road.edge_m + 1.6, road.edge_m)
    if lot:
        spots = rng.uniform(-0.9, 0.9, (int(rng.integers(0, 5)), 3)) * (HALF_M, HALF_M, np.pi)
        site.put_all([place_at(lamp_post(rng), *spot) for spot in spots.tolist()])
    elif rng.random() < 0.7:
        in_fields(rng, site, rng.uniform(0.05, 0.35))
    moving = driven(rng, plan, road.lane_lines(), _PACE, country_vehicle)
    return assembled("open_field", road.terrain(8.0, 3.0), plan, site.things, moving, masts)


def embankment(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a road on an embankment, sometimes with a hillside or level ground at one of its sides.

    A road on an embankment: beside it the ground falls away by 2 to 8 m, behind a guard rail or behind nothing.
    """
    high = rng.uniform(2.0, 8.0)
    sides = (_fall(rng, high), _fall(rng, rng.uniform(0.4, 1.0) * high) if rng.random() < 0.75 else
             Bank((0.0, 1.0, 1.0 + rng.uniform(2.0, 8.0)), (0.0, -0.3, rng.uniform(-0.3, 3.0))))  # fmt: skip
    road = Roadway(
        random_bend(rng, 0.2, (180.0, 420.0)), climb(rng, 0.06), 2 if rng.random() < 0.2 else 1,
        rng.uniform(3.0, 3.6), rng.uniform(1.3, 2.6), sides if rng.random() < 0.5 else sides[::-1],
        Swell(1.0, rng.uniform(0.0, 0.25), rng.uniform(120, 260), rng.uniform(0, 6.28)), fields(rng, 0.8),
    )  # fmt: skip
    masts, site = beside(rng, plan, road.bend, road.edge_m - 0.3, road.edge_m - 1.1)
    for side in (-1, 1):
        if rng.random() < 0.5:
            site.put_all(rail(rng, road, side))
        if rng.random() < 0.6:
            site.put_all(posts(road, side, rng.uniform(15.0, 40.0)))
        site.put_all(signs(rng, road, side, int(rng.integers(0, 2))))
        foot = road.foot_m(side)
        if rng.random() < 0.5:
            site.put_all(border(rng, road, side, foot + rng.uniform(1.5, 6.0)))
        site.put_all(trees(rng, road, side, (foot + 1.0, foot + 12.0), (3.0, rng.uniform(10.0, 70.0))))
        if rng.random() < 0.4:  # bushes and trees on the slope itself
            site.put_all(trees(rng, road, side, (road.edge_m + 1.5, foot), (4.0, rng.uniform(15.0, 60.0))))
    in_fields(rng, site, rng.uniform(0.2, 1.2))
    moving = driven(rng, plan, road.lane_lines(), COUNTRY_PACE, country_vehicle)
    return assembled("embankment", road.terrain(), plan, site.things, moving, masts)


def _fall(rng: np.random.Generator, high_m: float) -> Bank:
    """Return a slope of 1 : 1 to 1 : 2 that falls by ``high_m``."""
    wide = rng.uniform(1.0, 2.0) * high_m
    return Bank((0.0, 0.3, 0.3 + wide, 0.3 + wide + 2.0), (0.0, -0.05, -0.97 * high_m, -high_m))


def cutting(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a road in a cutting of 2 to 8 m; each of its sides is a slope or a wall, as high as the land beside it.

    A road in a cutting: the ground rises steeply at both sides, or behind retaining walls.
    """
    high = rng.uniform(2.0, 8.0)
    walled = (rng.random() < 0.4, rng.random() < 0.4)
    rises = (high, high * rng.uniform(0.3, 1.1))
    left, right = (Bank((0.0, 2.6, 3.6), (0.0, 0.0, rise)) if wall else _slope(rng, rise)
                   for wall, rise in zip(walled, rises, strict=True))  # fmt: skip
    road = Roadway(
        random_bend(rng, 0.16, (200.0, 420.0)), climb(rng, 0.07), 2 if rng.random() < 0.25 else 1,
        rng.uniform(3.0, 3.6), rng.uniform(0.8, 2.2), (left, right),
        Swell(1.0, rng.uniform(0.0, 0.35), rng.uniform(120, 300), rng.uniform(0, 6.28)), fields(rng, 1.0),
        "grass" if rng.random() < 0.7 else "concrete",
    )  # fmt: skip
    masts, site = beside(rng, plan, road.bend, road.edge_m - 0.2, road.edge_m - 0.9)
    for side, wall, rise in ((1, walled[0], rises[0]), (-1, walled[1], rises[1])):
        if wall:
            site.stand(*retaining_wall(rng, road, side, (1.25, rise)))
        elif rng.random() < 0.35:
            site.put_all(row(road.bend, concrete_barrier, WHOLE, side * (road.edge_m - 0.4)))
        elif rng.random() < 0.3:
            site.put_all(rail(rng, road, side))
        if rng.random() < 0.5:
            site.put_all(posts(road, side, rng.uniform(15.0, 40.0)))
        site.put_all(signs(rng, road, side, int(rng.integers(0, 2))))
        foot = road.foot_m(side)
        if rng.random() < 0.6:
            site.put_all(border(rng, road, side, foot + rng.uniform(1.0, 3.0)))
        site.put_all(trees(rng, road, side, (foot + 1.5, foot + 10.0), (2.0, rng.uniform(6.0, 50.0))))
        if not wall:
            site.put_all(trees(rng, road, side, (road.edge_m + 1.5, foot), (3.0, rng.uniform(10.0, 60.0))))
    in_fields(rng, site, rng.uniform(0.1, 0.7))
    moving = driven(rng, plan, road.lane_lines(), COUNTRY_PACE, country_vehicle)
    return assembled("cutting", road.terrain(), plan, site.things, moving, masts)


def _slope(rng: np.random.Generator, high_m: float) -> Bank:
    """Return a ditch and a slope of 1 : 0.6 to 1 : 1.8, sometimes with a berm half way up."""
    wide, ditch = rng.uniform(0.6, 1.8) * high_m, rng.uniform(0.0, 0.5)
    berm = rng.uniform(1.0, 3.0) if high_m > 4.0 and rng.random() < 0.4 else 0.1
    beyond = (0.0, 0.8, 1.4, 1.4 + wide / 2, 1.4 + wide / 2 + berm, 1.4 + wide + berm)
    return Bank(beyond, (0.0, -ditch, -ditch, high_m / 2, high_m / 2 + 0.05, high_m))
