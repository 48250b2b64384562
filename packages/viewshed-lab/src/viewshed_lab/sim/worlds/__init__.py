"""Procedural worlds: one function per kind, by name in the table ``WORLDS``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from viewshed_lab.sim.world import AgentPlan, World
from viewshed_lab.sim.worlds.bridge import bridge
from viewshed_lab.sim.worlds.country_roads import country_road, cutting, embankment, open_field
from viewshed_lab.sim.worlds.drop_roads import pit, quay
from viewshed_lab.sim.worlds.garage import garage
from viewshed_lab.sim.worlds.highway import highway
from viewshed_lab.sim.worlds.indoor.corridors import corridors
from viewshed_lab.sim.worlds.indoor.halls import atrium, hall
from viewshed_lab.sim.worlds.indoor.loft import loft
from viewshed_lab.sim.worlds.indoor.rooms import rooms
from viewshed_lab.sim.worlds.indoor.tunnel import tunnel
from viewshed_lab.sim.worlds.indoor.warehouse import warehouse
from viewshed_lab.sim.worlds.junction import junction
from viewshed_lab.sim.worlds.land import land
from viewshed_lab.sim.worlds.oblique import oblique
from viewshed_lab.sim.worlds.parking import parking
from viewshed_lab.sim.worlds.residential import residential
from viewshed_lab.sim.worlds.site import site
from viewshed_lab.sim.worlds.slope_town import slope_town
from viewshed_lab.sim.worlds.street import glass_fronts, street

WorldMaker = Callable[[np.random.Generator, AgentPlan], World]
"""Makes a world with the agents of a plan; the same generator state gives the same world."""

_MAKERS = (
    street, junction, highway, parking, residential, rooms, corridors, hall, warehouse, bridge, pit, quay, garage,
    glass_fronts, oblique, slope_town, site, open_field, tunnel, loft, atrium, embankment, cutting, country_road,
    land,
)  # fmt: skip

WORLDS: dict[str, WorldMaker] = {maker.__name__: maker for maker in _MAKERS}
"""Every kind of world by name; to add one, write its function and add it to ``_MAKERS``."""

__all__ = ["WORLDS", "WorldMaker"]
