"""SitePlan: place things at any angle in an outdoor world without overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely

from viewshed.arrays import F64
from viewshed_lab.sim.assets.street import footprint, place_at
from viewshed_lab.sim.world import AgentPlan, Thing
from viewshed_lab.sim.worlds.layout import Mast
from viewshed_lab.sim.worlds.roadway import HALF_M, Bend, masts_beside

_GAP_M, _TALL_M = 0.15, 3.0
_ROOM = 8192


@dataclass(slots=True)
class SitePlan:
    """The things placed so far, and the areas that further things must not touch."""

    things: list[Thing] = field(default_factory=list)  # in the world
    _taken: list[shapely.Polygon] = field(default_factory=list)
    _bounds: F64 = field(default_factory=lambda: np.empty((_ROOM, 4)))
    _open: list[shapely.Polygon] = field(default_factory=list)

    def reserve(self, *areas: shapely.Polygon) -> None:
        """Keep areas free, in meters of the world."""
        for area in areas:
            self._bounds[len(self._taken)] = area.bounds
            self._taken.append(area)

    @classmethod
    def around(cls, masts: Sequence[Mast]) -> SitePlan:
        """Return an empty plan that keeps the feet of roadside sensors free, and the air around them of crowns."""
        plan = cls()
        for post in masts:
            plan.reserve(shapely.Point(post.x_m, post.y_m).buffer(1.4))
            plan._open.append(shapely.Point(post.x_m, post.y_m).buffer(2.2))
        return plan

    def keep_road(self, bend: Bend, half_m: float) -> None:
        """Keep the road within ``half_m`` meters of an axis free."""
        x = np.arange(-HALF_M - 20.0, HALF_M + 21.0, 4.0)
        self.reserve(shapely.LineString(np.column_stack([x, bend.axis(x)])).buffer(half_m, cap_style="flat"))

    def clear(self, area: shapely.Polygon, gap_m: float = _GAP_M) -> bool:
        """Return whether an area is at least ``gap_m`` meters from all things and reserved areas."""
        x0, y0, x1, y1 = area.bounds
        # Measure only areas whose bounding rectangles are that close.
        bounds = self._bounds[: len(self._taken)]
        near = (bounds[:, 0] < x1 + gap_m) & (bounds[:, 2] > x0 - gap_m)
        near &= (bounds[:, 1] < y1 + gap_m) & (bounds[:, 3] > y0 - gap_m)
        return not any(self._taken[k].distance(area) < gap_m for k in np.flatnonzero(near))

    def put(self, thing: Thing, gap_m: float = _GAP_M) -> bool:
        """Place a thing where it is if its non-overhead parts are clear of others; return whether it was placed."""
        area = shapely.Polygon(footprint(thing))
        if not self.clear(area, gap_m) or self._blinds(thing):
            return False
        self.things.append(thing)
        self.reserve(area)
        return True

    def _blinds(self, thing: Thing) -> bool:
        """Return whether a tall thing, including its crown, is too close to a roadside sensor."""
        if not self._open or max(part.top_m for part in thing.parts) < _TALL_M:
            return False
        outline = shapely.Polygon(footprint(thing, below_m=np.inf))
        return bool(shapely.intersects(outline, np.array(self._open)).any())

    def put_all(self, things: list[Thing]) -> None:
        """Place the things that are clear of others, one by one."""
        for thing in things:
            self.put(thing)

    def stand(self, *things: Thing) -> None:
        """Place things without a check; they may touch others and each other, but later things must not touch them."""
        for thing in things:
            self.things.append(thing)
            self.reserve(shapely.Polygon(footprint(thing)))

    def scatter(
        self, rng: np.random.Generator, things: list[Thing], spread_m: tuple[float, float, float, float]
    ) -> None:
        """Place things at random poses in (x min, y min, x max, y max); leave out those without room."""
        x0, y0, x1, y1 = spread_m
        for thing in things:
            for u, v, turn in rng.random((4, 3)).tolist():
                if self.put(place_at(thing, x0 + u * (x1 - x0), y0 + v * (y1 - y0), 2 * np.pi * turn)):
                    break


def beside(
    rng: np.random.Generator, plan: AgentPlan, bend: Bend, mast_m: float, free_m: float, sides: Sequence[int] = (-1, 1)
) -> tuple[list[Mast], SitePlan]:
    """Return roadside sensors ``mast_m`` from the axis of a road, and an empty plan that keeps both free.

    The road is kept free within ``free_m`` meters of its axis.
    """
    masts = masts_beside(rng, plan.roadside, bend, mast_m, sides)
    site = SitePlan.around(masts)
    site.keep_road(bend, free_m)
    return masts, site
