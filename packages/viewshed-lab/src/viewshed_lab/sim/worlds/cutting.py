"""A road in a cutting: the ground rises steeply at both sides, or behind retaining walls."""

from __future__ import annotations

import numpy as np

from viewshed_lab.sim.assets.street import concrete_barrier
from viewshed_lab.sim.world import AgentPlan, World
from viewshed_lab.sim.worlds.layout import Contents, assembled
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
)
from viewshed_lab.sim.worlds.roadway import Bank, Roadway, Swell, masts_beside, random_bend, row
from viewshed_lab.sim.worlds.site_plan import SitePlan
from viewshed_lab.sim.worlds.traffic import driven


def cutting(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a road in a cutting of 2 to 8 m; each of its sides is a slope or a wall, as high as the land beside it."""
    high = rng.uniform(2.0, 8.0)
    walled = (rng.random() < 0.4, rng.random() < 0.4)
    rises = (high, high * rng.uniform(0.3, 1.1))
    left, right = (_walled(rise) if wall else _slope(rng, rise) for wall, rise in zip(walled, rises, strict=True))
    road = Roadway(
        random_bend(rng, 0.16, (200.0, 420.0)), climb(rng, 0.07), 2 if rng.random() < 0.25 else 1,
        rng.uniform(3.0, 3.6), rng.uniform(0.8, 2.2), (left, right),
        Swell(1.0, rng.uniform(0.0, 0.35), rng.uniform(120, 300), rng.uniform(0, 6.28)), fields(rng, 1.0),
        "grass" if rng.random() < 0.7 else "concrete",
    )  # fmt: skip
    masts = masts_beside(rng, plan.roadside, road.bend, road.edge_m - 0.2)
    site = SitePlan.along(road.bend, road.edge_m - 0.9, masts)
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
    return assembled("cutting", road.terrain(), plan, Contents(site.things, moving, masts))


def _slope(rng: np.random.Generator, high_m: float) -> Bank:
    """Return a ditch and a slope of 1 : 0.6 to 1 : 1.8, at times with a berm half way up."""
    wide, ditch = rng.uniform(0.6, 1.8) * high_m, rng.uniform(0.0, 0.5)
    berm = rng.uniform(1.0, 3.0) if high_m > 4.0 and rng.random() < 0.4 else 0.1
    beyond = (0.0, 0.8, 1.4, 1.4 + wide / 2, 1.4 + wide / 2 + berm, 1.4 + wide + berm)
    return Bank(beyond, (0.0, -ditch, -ditch, high_m / 2, high_m / 2 + 0.05, high_m))


def _walled(high_m: float) -> Bank:
    """Return level ground that jumps up behind a wall."""
    return Bank((0.0, 2.6, 3.6), (0.0, 0.0, high_m))
