"""A town on a hill: a street that climbs by 5 to 15 %, terraces behind retaining walls, steps up to them."""

from __future__ import annotations

import numpy as np

from viewshed_lab.sim.assets.buildings import family_house, town_house
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.assets.street import bin_, bush, hedge, lamp_post, person, pick, place_at, pole, sign, tree
from viewshed_lab.sim.assets.vehicles import cyclist, parked_vehicle, street_vehicle
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.layout import assembled, plots, spots
from viewshed_lab.sim.worlds.outdoor_ground import Relief
from viewshed_lab.sim.worlds.roadsides import WHOLE, retaining_wall, upright
from viewshed_lab.sim.worlds.roadway import HALF_M, Bank, Roadway, Swell, random_bend
from viewshed_lab.sim.worlds.site_plan import SitePlan, beside
from viewshed_lab.sim.worlds.traffic import Driver, Pace, Rider, driven, flow

_PACE = Pace(110.0, 50.0, (3.0, 11.0), (8.0, 30.0, 120.0))

_RUN_M = 13.0
"""Distance from one terrace to the next."""


def slope_town(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a climbing street between terraces with the agents of ``plan``."""
    walk, hill = rng.uniform(2.4, 3.6), rng.uniform(0.0, 2.6)
    steps = (hill * rng.uniform(0.7, 1.2), -hill * rng.uniform(0.5, 1.2))
    left, right = steps if rng.random() < 0.5 else steps[::-1]
    road = Roadway(
        random_bend(rng, 0.14, (160.0, 420.0)), _climbing(rng), 1, rng.uniform(2.7, 3.3), rng.uniform(2.1, 2.5),
        (_terraces(walk, left), _terraces(walk, right)),
        Swell(1.0, rng.uniform(0.0, 0.3), rng.uniform(120, 300), rng.uniform(0, 6.28)), soil="concrete",
    )  # fmt: skip
    masts, site = beside(rng, plan, road.bend, road.edge_m + 0.4, road.edge_m - 2.0)
    walks: list[Rider] = []
    for side, step in ((1, left), (-1, right)):
        gate = rng.uniform(-60, 60)
        if abs(step) > 0.4:
            gates = (gate, gate + 6.0) if rng.random() < 0.5 else (0.0, 0.0)
            site.stand(*retaining_wall(rng, road, side, (walk + 0.25, step), gates))
        if step > 0.4:
            site.put_all([_steps(road, side, walk, step, x) for x in rng.uniform(-80, 80, int(rng.integers(1, 5)))])
        walks += _walkers(rng, road, side, plan.duration_s)
        _curb(rng, site, road, side)
        _houses(rng, site, road, side, walk)
    lanes = road.lane_lines()
    moving = driven(rng, plan, lanes, _PACE, lambda r: cyclist(r) if r.random() < 0.1 else street_vehicle(r))
    return assembled("slope_town", road.terrain(5.0, 1.5), plan, site.things, [*moving, *walks], masts)


def _climbing(rng: np.random.Generator) -> Relief:
    """Return heights along a street that climbs with a varying slope of 5 to 15 %."""
    grade, wave = pick(rng, (-1, 1)) * rng.uniform(0.05, 0.125), rng.uniform(120.0, 240.0)
    return Relief((grade, 0.0), (rng.uniform(0.0, 0.025) * wave / (2 * np.pi), 0.0), (wave, 100.0),
                  (rng.uniform(0, 6.28), 0.0))  # fmt: skip


def _terraces(walk_m: float, step_m: float) -> Bank:
    """Return a sidewalk and three terraces, each ``step_m`` higher than the one before, with a wall between."""
    beyond, rise = [0.0, walk_m], [0.0, 0.05]
    for k in range(3):
        at = walk_m + 0.1 + k * _RUN_M
        beyond += [at + 0.5, at + _RUN_M]
        rise += [0.05 + (k + 1) * step_m, 0.1 + (k + 1) * step_m]
    return Bank(tuple(beyond), tuple(rise))


def _walkers(rng: np.random.Generator, road: Roadway, side: int, duration_s: float) -> list[Rider]:
    starts = sorted(rng.uniform(-60.0, 60.0, int(rng.integers(0, 4))).tolist(), reverse=True)
    lane, pace = road.bend.lane(side * (road.edge_m + 0.75), rng.random() < 0.5), rng.uniform(0.9, 1.5)
    return flow(lane, [Driver(person(rng, walking=True), start, pace) for start in starts], duration_s)


def _steps(road: Roadway, side: int, walk_m: float, step_m: float, x_m: float) -> Thing:
    """Return steps that lead along the wall up to the first terrace."""
    count = max(2, round(step_m * float(road.swell.at(np.array(x_m))) / 0.17))
    treads = tuple(
        Box(0.3 * (k - count / 2), 0.0, 0.3, 0.85, 0.17 * (k + 1), -1.2, 0.0, "concrete") for k in range(count)
    )
    across = side * (road.edge_m + walk_m - 0.55)
    return upright(road, Thing("steps", treads), x_m, across, across)


def _curb(rng: np.random.Generator, site: SitePlan, road: Roadway, side: int) -> None:
    """Put parked vehicles at the edge of the road, lamps, signs, trees and bins behind them."""
    taken = rng.uniform(0.0, 0.9)
    for x in spots(rng, WHOLE, 5.7, (0.3, 2.0)):
        if rng.random() < taken:
            across = side * (road.edge_m - 1.05)
            site.put(road.bend.put(parked_vehicle(rng), x, across, np.pi * (side > 0)), 0.05)
    for x in spots(rng, WHOLE, 1.0, (4.0, rng.uniform(8.0, 30.0))):
        thing = pick(rng, (lamp_post(rng, 1.5), sign(rng), bin_(rng), pole(0.9, 0.06), tree(rng, 2.5, 3.2)))
        site.put(road.bend.put(thing, x, side * (road.edge_m + 0.25), -side * np.pi / 2), 0.02)


def _houses(rng: np.random.Generator, site: SitePlan, road: Roadway, side: int, walk_m: float) -> None:
    """Put a house on most plots of each terrace, hedges, bushes and trees between them."""
    for terrace in range(3):
        start = road.edge_m + walk_m + terrace * _RUN_M + 1.2
        town = terrace == 0 and rng.random() < 0.6
        for middle, long in plots(rng, (-HALF_M, HALF_M), (8.0, 15.0), 5.0, 0.4):
            front = side * (start + rng.uniform(0.2, 1.2) * (1 if town else 2))
            draw, turn = rng.random(), 0.0 if side > 0 else np.pi
            if draw < 0.75:
                maker, far = (town_house if town else family_house), abs(middle) > 45.0 or terrace > 0
                house = road.bend.put(maker(rng, long - 1.0, rng.uniform(7.0, 8.5), far), middle, front, turn)
                site.put(house, 0.05)
            elif draw < 0.85:
                site.put(road.bend.put(hedge(rng, 0.7 * long, 1.2), middle, front))
            x, y, _ = road.bend.at(middle + rng.uniform(-8, 8), front + side * rng.uniform(0.0, 8.0))
            site.put(place_at(bush(rng, 1.4) if rng.random() < 0.6 else tree(rng, 2.2, 4.0), x, y))
