"""The worlds inside buildings."""

from viewshed.sim.worlds.indoor_corridors import corridors
from viewshed.sim.worlds.indoor_hall import hall
from viewshed.sim.worlds.indoor_rooms import rooms
from viewshed.sim.worlds.indoor_warehouse import warehouse

__all__ = ["corridors", "hall", "rooms", "warehouse"]
