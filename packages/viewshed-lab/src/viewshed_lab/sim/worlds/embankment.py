"""A road on an embankment: beside it the ground falls away by 2 to 8 m, behind a guard rail or behind nothing."""

from __future__ import annotations

import numpy as np

from viewshed_lab.sim.world import AgentPlan, World
from viewshed_lab.sim.worlds.layout import Contents, assembled
from viewshed_lab.sim.worlds.roadsides import (
    COUNTRY_PACE,
    border,
    climb,
    country_vehicle,
    fields,
    in_fields,
    posts,
    rail,
    signs,
    trees,
)
from viewshed_lab.sim.worlds.roadway import Bank, Roadway, Swell, masts_beside, random_bend
from viewshed_lab.sim.worlds.site_plan import SitePlan
from viewshed_lab.sim.worlds.traffic import driven


def embankment(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a road on an embankment, at times with a hillside or level ground at one of its sides."""
    high = rng.uniform(2.0, 8.0)
    sides = (_fall(rng, high), _fall(rng, rng.uniform(0.4, 1.0) * high) if rng.random() < 0.75 else _other(rng))
    road = Roadway(
        random_bend(rng, 0.2, (180.0, 420.0)), climb(rng, 0.06), 2 if rng.random() < 0.2 else 1,
        rng.uniform(3.0, 3.6), rng.uniform(1.3, 2.6), sides if rng.random() < 0.5 else sides[::-1],
        Swell(1.0, rng.uniform(0.0, 0.25), rng.uniform(120, 260), rng.uniform(0, 6.28)), fields(rng, 0.8),
    )  # fmt: skip
    masts = masts_beside(rng, plan.roadside, road.bend, road.edge_m - 0.3)
    site = SitePlan.along(road.bend, road.edge_m - 1.1, masts)
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
    return assembled("embankment", road.terrain(), plan, Contents(site.things, moving, masts))


def _fall(rng: np.random.Generator, high_m: float) -> Bank:
    """Return a slope of 1 : 1 to 1 : 2 that falls by ``high_m``."""
    wide = rng.uniform(1.0, 2.0) * high_m
    return Bank((0.0, 0.3, 0.3 + wide, 0.3 + wide + 2.0), (0.0, -0.05, -0.97 * high_m, -high_m))


def _other(rng: np.random.Generator) -> Bank:
    wide = rng.uniform(2.0, 8.0)
    return Bank((0.0, 1.0, 1.0 + wide), (0.0, -0.3, rng.uniform(-0.3, 3.0)))
