"""An open field, a large lot or a plain with almost nothing in range: few returns, and those from the ground."""

from __future__ import annotations

import numpy as np

from viewshed_lab.sim.assets.street import lamp_post, place_at
from viewshed_lab.sim.world import AgentPlan, World
from viewshed_lab.sim.worlds.layout import Contents, assembled
from viewshed_lab.sim.worlds.roadsides import climb, country_vehicle, fields, in_fields
from viewshed_lab.sim.worlds.roadway import HALF_M, Bank, Roadway, masts_beside, random_bend
from viewshed_lab.sim.worlds.site_plan import SitePlan
from viewshed_lab.sim.worlds.traffic import Pace, driven

_PACE = Pace(110.0, 50.0, (2.0, 12.0), (20.0, 150.0, 600.0))


def open_field(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a track over open land, level or undulating, or an empty lot of asphalt, with the agents of ``plan``."""
    lot = rng.random() < 0.35
    land = fields(rng, 0.15 if lot else 1.8, 0.015 if lot else 0.05)
    ground = "asphalt" if lot and rng.random() < 0.7 else "concrete" if lot else "grass"
    level = Bank((0.0, 1.0), (0.0, 0.0))
    bend, grade = random_bend(rng, 0.25), climb(rng, 0.01 if lot else 0.07)
    road = Roadway(
        bend, grade, 1, 2.6, 0.3, (level, level), rough=land, soil=ground, paved="asphalt" if lot else "grass"
    )
    masts = masts_beside(rng, plan.roadside, road.bend, road.edge_m + 1.6)
    site = SitePlan.along(road.bend, road.edge_m, masts)
    if lot:
        spots = rng.uniform(-0.9, 0.9, (int(rng.integers(0, 5)), 3)) * (HALF_M, HALF_M, np.pi)
        site.put_all([place_at(lamp_post(rng), *spot) for spot in spots.tolist()])
    elif rng.random() < 0.7:
        in_fields(rng, site, rng.uniform(0.05, 0.35))
    moving = driven(rng, plan, road.lane_lines(), _PACE, country_vehicle)
    return assembled("open_field", road.terrain(8.0, 3.0), plan, Contents(site.things, moving, masts))
