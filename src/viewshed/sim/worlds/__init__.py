"""Procedural worlds: one file a kind, one line a kind in the table ``WORLDS``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from viewshed.sim.world import AgentPlan, World
from viewshed.sim.worlds.bridge import bridge
from viewshed.sim.worlds.country_road import country_road
from viewshed.sim.worlds.cutting import cutting
from viewshed.sim.worlds.embankment import embankment
from viewshed.sim.worlds.garage import garage
from viewshed.sim.worlds.glass_fronts import glass_fronts
from viewshed.sim.worlds.highway import highway
from viewshed.sim.worlds.indoor.atrium import atrium
from viewshed.sim.worlds.indoor.corridors import corridors
from viewshed.sim.worlds.indoor.hall import hall
from viewshed.sim.worlds.indoor.loft import loft
from viewshed.sim.worlds.indoor.rooms import rooms
from viewshed.sim.worlds.indoor.tunnel import tunnel
from viewshed.sim.worlds.indoor.warehouse import warehouse
from viewshed.sim.worlds.junction import junction
from viewshed.sim.worlds.oblique import oblique
from viewshed.sim.worlds.open_field import open_field
from viewshed.sim.worlds.parking import parking
from viewshed.sim.worlds.pit import pit
from viewshed.sim.worlds.quay import quay
from viewshed.sim.worlds.residential import residential
from viewshed.sim.worlds.site import site
from viewshed.sim.worlds.slope_town import slope_town
from viewshed.sim.worlds.street import street

WorldMaker = Callable[[np.random.Generator, AgentPlan], World]
"""Makes a world with the agents of a plan; the same state of the generator gives the same world."""

WORLDS: dict[str, WorldMaker] = {
    "street": street,
    "junction": junction,
    "highway": highway,
    "parking": parking,
    "residential": residential,
    "rooms": rooms,
    "corridors": corridors,
    "hall": hall,
    "warehouse": warehouse,
    "bridge": bridge,
    "pit": pit,
    "quay": quay,
    "garage": garage,
    "glass_fronts": glass_fronts,
    "oblique": oblique,
    "slope_town": slope_town,
    "site": site,
    "open_field": open_field,
    "tunnel": tunnel,
    "loft": loft,
    "atrium": atrium,
    "embankment": embankment,
    "cutting": cutting,
    "country_road": country_road,
}
"""Every kind of world by name; to add one, write a file and add a line."""

__all__ = ["WORLDS", "WorldMaker"]
