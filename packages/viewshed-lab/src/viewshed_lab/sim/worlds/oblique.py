"""An old town: a winding lane between houses at any angle, courtyards, curved walls, small squares."""

from __future__ import annotations

import numpy as np
import shapely

from viewshed_lab.sim.assets.buildings import family_house, town_house
from viewshed_lab.sim.assets.shapes import Box, Cylinder
from viewshed_lab.sim.assets.street import (
    bench,
    bin_,
    bush,
    footprint,
    group,
    lamp_post,
    person,
    pick,
    place_at,
    pole,
    sign,
    tree,
    wall,
)
from viewshed_lab.sim.assets.vehicles import cyclist, motorcycle, parked_vehicle
from viewshed_lab.sim.assets.warehouse import stall
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.layout import assembled, plots, spots
from viewshed_lab.sim.worlds.roadsides import WHOLE, climb, fields
from viewshed_lab.sim.worlds.roadway import HALF_M, LEVEL, Roadway, random_bend
from viewshed_lab.sim.worlds.site_plan import SitePlan, beside
from viewshed_lab.sim.worlds.traffic import Driver, Pace, Rider, driven, flow

_PACE = Pace(110.0, 50.0, (2.0, 8.0), (8.0, 40.0, 160.0))


def oblique(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a winding lane of an old town with the agents of ``plan``."""
    lane_m = rng.uniform(2.3, 2.9)
    road = Roadway(
        random_bend(rng, 0.55, (70.0, 200.0)), climb(rng, 0.06), 1, lane_m, rng.uniform(0.2, 0.6), LEVEL,
        rough=fields(rng, 0.3, 0.01), soil="concrete", paved="concrete",
    )  # fmt: skip
    masts, site = beside(rng, plan, road.bend, road.edge_m + 0.5, road.edge_m + 0.3)
    for _ in range(int(rng.integers(0, 4))):
        _square(rng, site, road)
    walks = _walkers(rng, site, road, plan.duration_s)
    for side in (-1, 1):
        _houses(rng, site, road, side)
    for _ in range(int(rng.integers(2, 7))):
        _courtyard(rng, site)
    for _ in range(int(rng.integers(3, 9))):
        _curved_wall(rng, site)
    houses = [town_house(rng, rng.uniform(8.0, 16.0), rng.uniform(7.0, 11.0), True) for _ in range(40)]
    site.scatter(rng, houses, (WHOLE[0], WHOLE[0], WHOLE[1], WHOLE[1]))
    _small(rng, site, road)
    lanes = road.lane_lines()
    moving = driven(rng, plan, lanes, _PACE, lambda r: cyclist(r) if r.random() < 0.25 else parked_vehicle(r))
    return assembled("oblique", road.terrain(5.6, 2.4), plan, site.things, [*moving, *walks], masts)


def _walkers(rng: np.random.Generator, site: SitePlan, road: Roadway, duration_s: float) -> list[Rider]:
    """Return people who walk along one side of the lane, and keep their path free."""
    side = pick(rng, (-1, 1))
    across = side * (road.edge_m + 0.75)
    back = rng.random() < 0.5
    starts = sorted(rng.uniform(-70.0, 60.0, int(rng.integers(1, 7))).tolist(), reverse=True)
    site.keep_road(road.bend, road.edge_m + 1.2)
    pace = rng.uniform(0.9, 1.6)
    drivers = [Driver(person(rng, walking=True), start, pace) for start in starts]
    return flow(road.bend.lane(across, back), drivers, duration_s)


def _houses(rng: np.random.Generator, site: SitePlan, road: Roadway, side: int) -> None:
    """Put houses along one side, none quite along the lane; a wall or nothing where one finds no room."""
    for middle, long in plots(rng, (-HALF_M, HALF_M), (6.6, 16.0), 3.0, 0.3):
        depth, skew = rng.uniform(7.0, 11.0), rng.normal(0.0, 0.14)
        setback = rng.uniform(1.6, 3.0) + (rng.uniform(2.0, 8.0) if rng.random() < 0.15 else 0.0)
        across = side * (road.edge_m + setback + 0.5 * long * abs(np.sin(skew)))
        turn = skew + (0.0 if side > 0 else np.pi)
        for share in (1.0, 0.65):
            maker = town_house if rng.random() < 0.75 else family_house
            house = maker(rng, max(share * long, 6.4), max(share * depth, 7.0), abs(middle) > 50)
            if site.put(road.bend.put(house, middle, across, turn), 0.05):
                break
        else:
            site.put(road.bend.put(wall(0.5 * long, rng.uniform(1.5, 2.6)), middle, across, skew))


def _square(rng: np.random.Generator, site: SitePlan, road: Roadway) -> None:
    """Put a square beside the lane: a well or a statue, stalls, benches, trees and people, and no house."""
    side, x = pick(rng, (-1, 1)), rng.uniform(-60.0, 60.0)
    across = side * (road.edge_m + rng.uniform(8.0, 11.0))
    well = Thing("well", (Cylinder(0.0, 0.0, 1.3, 0.7, -0.3), Cylinder(0.0, 0.0, 0.25, 2.4, 0.7)))
    site.put(road.bend.put(well, x, across))
    for _ in range(int(rng.integers(3, 9))):
        one = pick(rng, (stall(rng)[0], bench(), tree(rng, 2.4, 4.0), person(rng), bush(rng, 1.0)))
        offset = across + rng.uniform(-5.0, 6.0)
        site.put(road.bend.put(one, x + rng.uniform(-9.0, 9.0), offset, rng.uniform(-3, 3)))
    x0, y0, _ = road.bend.at(x + 3.0, across)
    site.put_all(group(rng, x0, y0))


def _courtyard(rng: np.random.Generator, site: SitePlan) -> None:
    """Put wings around a yard at any angle, open at one side or closed by a wall with a gate."""
    x, y = rng.uniform(-85.0, 85.0, 2).tolist()
    yaw, half, deep = rng.uniform(-3.1, 3.1), rng.uniform(6.0, 11.0), rng.uniform(7.0, 9.0)
    wings = [(0.0, half, 0.0, 2 * half), (-half, 0.0, np.pi / 2, 2 * half), (half, 0.0, -np.pi / 2, 2 * half)]
    c, s = np.cos(yaw), np.sin(yaw)
    for u, v, turn, long in wings[: int(rng.integers(2, 4))]:
        site.put(place_at(town_house(rng, 0.96 * long, deep, rng.random() < 0.6), x + c * u - s * v, y + s * u + c * v,
                          yaw + turn))  # fmt: skip
    for end in (-1, 1):
        u, v = 0.65 * end * half, -half
        site.put(place_at(wall(0.65 * half, rng.uniform(1.8, 2.8)), x + c * u - s * v, y + s * u + c * v, yaw))
    site.put(place_at(pick(rng, (parked_vehicle(rng), tree(rng, 2.3, 4.0), bush(rng, 1.5))), x, y, rng.uniform(-3, 3)))


def _curved_wall(rng: np.random.Generator, site: SitePlan) -> None:
    """Put a wall along an arc in pieces of about 1 m, as far as there is room."""
    x, y = rng.uniform(-70.0, 70.0, 2).tolist()
    radius, start, sweep = rng.uniform(4.0, 20.0), rng.uniform(-3.1, 3.1), rng.uniform(0.6, 3.5)
    high, material = rng.uniform(0.6, 3.0), pick(rng, ("brick", "concrete", "plaster"))
    count, area = max(3, int(radius * sweep / 1.1)), list[Thing]()
    for k in range(count):
        angle = start + sweep * (k + 0.5) / count
        part = Box(0.0, 0.0, 1.02 * radius * sweep / count, 0.35, high, -1.0, 0.0, material)
        at = x + radius * np.cos(angle), y + radius * np.sin(angle)
        area.append(place_at(Thing("wall", (part,)), *at, angle + np.pi / 2))
    # Its pieces may touch each other.
    site.stand(*(one for one in area if site.clear(shapely.Polygon(footprint(one)), 0.02)))


def _small(rng: np.random.Generator, site: SitePlan, road: Roadway) -> None:
    """Put parked vehicles, lamps, bins, bollards and people along the lane."""
    for side in (-1, 1):
        for x in spots(rng, WHOLE, 1.0, (3.0, 24.0)):
            draw, across = rng.random(), side * (road.edge_m + rng.uniform(1.35, 1.7))
            if draw < 0.25:
                thing = parked_vehicle(rng) if rng.random() < 0.7 else motorcycle(rng)
                site.put(road.bend.put(thing, x, side * (road.edge_m + 2.3), np.pi * (side > 0)), 0.05)
            else:
                thing = pick(
                    rng, (lamp_post(rng, 1.0), bin_(rng), pole(0.9, 0.06), person(rng), sign(rng), bush(rng, 0.7))
                )
                site.put(road.bend.put(thing, x, across, -side * np.pi / 2), 0.05)
