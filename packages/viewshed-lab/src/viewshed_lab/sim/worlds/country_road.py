"""A country road that bends and climbs through fields: ditches, trees, hedges, fences, walls at any angle."""

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
    signs,
    trees,
    wires,
)
from viewshed_lab.sim.worlds.roadway import Bank, Roadway, Swell, masts_beside, random_bend
from viewshed_lab.sim.worlds.site_plan import SitePlan
from viewshed_lab.sim.worlds.traffic import driven


def country_road(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a country road, now and then of gravel, with the agents of ``plan`` on it and beside it."""
    slope = rng.uniform(-0.18, 0.18)
    road = Roadway(
        random_bend(rng, 0.38, (130.0, 320.0)), climb(rng, 0.12), 1, rng.uniform(2.6, 3.4), rng.uniform(0.4, 1.3),
        (_bank(rng, slope), _bank(rng, -slope)), Swell(1.0, rng.uniform(0.0, 0.6), rng.uniform(90, 200), 0.0),
        fields(rng, 1.4), "grass", "asphalt" if rng.random() < 0.8 else "concrete",
    )  # fmt: skip
    masts = masts_beside(rng, plan.roadside, road.bend, road.edge_m + 1.6)
    site = SitePlan.along(road.bend, road.edge_m - 0.4, masts)
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
    return assembled("country_road", road.terrain(6.2, 1.6), plan, Contents(site.things, moving, masts))


def _bank(rng: np.random.Generator, slope: float) -> Bank:
    """Return a ditch or none, and then the hillside, which rises or falls by ``slope``."""
    deep = rng.uniform(0.3, 0.9) if rng.random() < 0.7 else 0.0
    wide, out = rng.uniform(0.8, 1.6), rng.uniform(18.0, 40.0)
    lip = rng.uniform(-0.2, 0.6)
    beyond = (0.0, wide, wide + 0.4, 2 * wide + 0.6, 2 * wide + out)
    return Bank(beyond, (0.0, -deep, -deep, lip, lip + slope * out))
