"""A building site or an industrial yard: uneven ground, heaps, containers, scaffolds, building shells, cranes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed_lab.sim.assets.country import (
    barrels,
    container,
    dumper,
    excavator,
    heap,
    pipes,
    scaffold,
    shell,
    site_office,
    tower_crane,
)
from viewshed_lab.sim.assets.shapes import material_index
from viewshed_lab.sim.assets.street import cone, fence, group, lamp_post, person, pick, place_at, work_barrier
from viewshed_lab.sim.assets.vehicles import car, truck, van
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.layout import assembled
from viewshed_lab.sim.worlds.roadsides import WHOLE, climb, fields
from viewshed_lab.sim.worlds.roadway import HALF_M, LEVEL, Roadway, random_bend
from viewshed_lab.sim.worlds.site_plan import SitePlan, beside
from viewshed_lab.sim.worlds.traffic import Pace, driven

_PACE = Pace(110.0, 50.0, (2.0, 7.0), (10.0, 50.0, 200.0))

_LOOSE: tuple[tuple[Callable[[np.random.Generator], Thing], float], ...] = (
    (container, 9.0), (site_office, 3.0), (pipes, 7.0), (barrels, 6.0), (excavator, 3.0), (dumper, 2.5), (person, 7.0),
    (van, 3.0), (truck, 2.0), (car, 4.0), (lambda rng: cone(), 6.0), (lambda rng: work_barrier(), 4.0),
    (lamp_post, 2.0), (lambda rng: heap(rng, rng.uniform(2.5, 10.0)), 8.0),
    (lambda rng: fence(rng.uniform(4.0, 16.0), 2.0), 6.0),
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Grounds:
    """A haul road over uneven ground."""

    road: Roadway  # the haul road
    mounds: F64  # (k, 4) x, y, height (negative: a hollow) and radius in meters

    def terrain(self) -> Terrain:
        """Return the ground, its lines 4.8 m apart."""
        lines = np.linspace(-HALF_M, HALF_M, 48)
        return Terrain.of(lines, lines, self._height, self._material)

    def _height(self, x: F64, y: F64) -> F64:
        z = self.road.height(x, y)
        free = np.clip((np.abs(self.road.bend.coordinates(x, y)[1]) - self.road.edge_m - 2.5) / 6.0, 0.0, 1.0)
        for at_x, at_y, high, wide in self.mounds.tolist():
            z = z + free * high * np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / (2 * wide**2))
        return np.asarray(z)

    def _material(self, x: F64, y: F64) -> NDArray[np.uint8]:
        loose = np.where(
            np.sin(x / 11.0 + 1.6 * np.sin(y / 17.0)) > 0.2, material_index("concrete"), material_index("grass")
        )
        return np.where(np.abs(self.road.bend.coordinates(x, y)[1]) < 6.0, material_index("concrete"), loose).astype(
            np.uint8
        )


def site(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a building site or a yard with the agents of ``plan`` on its haul road."""
    yard = rng.random() < 0.35
    road = Roadway(
        random_bend(rng, 0.4, (110.0, 260.0)), climb(rng, 0.02 if yard else 0.1), 1, rng.uniform(3.0, 4.0),
        rng.uniform(0.4, 1.5), LEVEL, rough=fields(rng, 0.2 if yard else 1.2, 0.01),
    )  # fmt: skip
    count = 0 if yard else int(rng.integers(6, 26))
    spread, highs = rng.uniform(-95, 95, (count, 2)), rng.uniform(-2.0, 3.5, count)
    grounds = Grounds(road, np.column_stack([spread, highs, rng.uniform(4.0, 12.0, count)]))
    masts, place = beside(rng, plan, road.bend, road.edge_m + 0.8, road.edge_m + 0.2)
    for _ in range(int(rng.integers(0, 4)) if not yard else 1):
        _raw(rng, place)
    if yard:
        _stacks(rng, place)
    for _ in range(int(rng.integers(0, 3))):
        place.put(place_at(tower_crane(rng), rng.uniform(-70, 70), rng.uniform(-70, 70), rng.uniform(-3, 3)))
    for _ in range(int(rng.integers(0, 4))):
        place.put_all(group(rng, *rng.uniform(-60, 60, 2).tolist()))
    loose = [maker(rng) for maker, mean in _LOOSE for _ in range(rng.poisson(mean * rng.uniform(0.5, 2.2)))]
    place.scatter(rng, loose, (WHOLE[0] + 4, WHOLE[0] + 4, WHOLE[1] - 4, WHOLE[1] - 4))
    moving = driven(rng, plan, road.lane_lines(), _PACE, lambda rng: pick(rng, (dumper, truck, van, car))(rng))
    return assembled("site", grounds.terrain(), plan, place.things, moving, masts)


def _raw(rng: np.random.Generator, place: SitePlan) -> None:
    """Put the shell of a building at any angle, with scaffolds before its front."""
    x, y, yaw = rng.uniform(-65, 65), rng.uniform(-65, 65), rng.uniform(-3.1, 3.1)
    long, deep = rng.uniform(12.0, 30.0), rng.uniform(9.0, 16.0)
    if place.put(place_at(shell(rng, long, deep), x, y, yaw), 2.0) and rng.random() < 0.7:
        out, wide = 1.2, rng.uniform(0.4, 0.95) * long
        place.put(
            place_at(scaffold(rng, wide, int(rng.integers(1, 4))), x + out * np.sin(yaw), y - out * np.cos(yaw), yaw)
        )


def _stacks(rng: np.random.Generator, place: SitePlan) -> None:
    """Put rows of containers, all along one direction, with lanes between them."""
    yaw, pitch, gap = rng.uniform(-3.1, 3.1), rng.uniform(5.5, 12.0), rng.uniform(0.3, 3.0)
    c, s = np.cos(yaw), np.sin(yaw)
    for v in np.arange(-80.0, 80.0, pitch).tolist():
        u = -80.0
        while u < 80.0:
            if rng.random() < 0.55:
                place.put(place_at(container(rng), c * u - s * v, s * u + c * v, yaw))
            u += 12.3 + gap
