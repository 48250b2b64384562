"""Sides of town streets: parked vehicles, furniture and trees on the sidewalk, buildings, people."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from viewshed_lab.sim.assets.buildings import garage, town_house
from viewshed_lab.sim.assets.street import (
    bench,
    bin_,
    bus_shelter,
    bush,
    cabinet,
    fence,
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
from viewshed_lab.sim.assets.vehicles import motorcycle, parked_vehicle
from viewshed_lab.sim.world import Thing
from viewshed_lab.sim.worlds.layout import Span, plots, spots
from viewshed_lab.sim.worlds.outdoor_ground import Road
from viewshed_lab.sim.worlds.traffic import Driver, Rider, flow, straight_lane

_BAY_M = 5.7
_WIDE_WALK_M = 3.4

PARKING_M = 2.2
"""Width of the strip of parked vehicles beside the curb."""


@dataclass(frozen=True, slots=True)
class Side:
    """One side of a street, in a frame of its own: u along the street, v outward from its axis."""

    yaw: float  # of u in the world; v is to the left of it
    road: Road  # the street
    setback_m: float  # from the sidewalk to the fronts
    depth_m: float  # largest depth of the buildings
    parked: float  # occupied share of the parking strip, 0 if there is none
    green: float  # share of trees among the objects on the sidewalk
    furniture_gap_m: Span  # smallest and largest gap between two spots
    detail_m: float = 72.0  # buildings farther along than this have plain walls

    def put(self, thing: Thing, u_m: float, v_m: float, turn: float = 0.0) -> Thing:
        """Return the thing at (u, v) of this side, turned by ``turn`` from its direction."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return place_at(thing, c * u_m - s * v_m, s * u_m + c * v_m, self.yaw + turn)


def random_side(rng: np.random.Generator, yaw: float, road: Road, parking: bool) -> Side:
    """Return a random side of a street."""
    parked = rng.uniform(0.3, 0.95) if parking else 0.0
    gap = rng.uniform(2.5, 6.0)
    return Side(yaw, road, rng.uniform(0.5, 2.5), rng.uniform(10, 14), parked, rng.uniform(0.0, 0.6), (gap, 2.5 * gap))


def parked(rng: np.random.Generator, side: Side, span_m: Span, closed: Sequence[Span] = ()) -> list[Thing]:
    """Return parked vehicles at the curb with free bays between them, heading with the traffic beside them."""
    things = []
    if side.parked:
        for u in spots(rng, span_m, _BAY_M, (0.4, 1.0), closed):
            if rng.random() < side.parked:
                across = side.road.half_m - 0.5 * PARKING_M + rng.uniform(-0.08, 0.05)
                thing = motorcycle(rng) if rng.random() < 0.04 else parked_vehicle(rng)
                things.append(side.put(thing, u + rng.uniform(-0.15, 0.15), across, np.pi + rng.normal(0, 0.015)))
    return things


def furniture(rng: np.random.Generator, side: Side, span_m: Span, closed: Sequence[Span] = ()) -> list[Thing]:
    """Return lamps, trees, signs, bins and the like on the strip behind the curb, sometimes a shelter or a group."""
    things: list[Thing] = []
    wide = side.road.walk_m >= _WIDE_WALK_M
    for u in spots(rng, span_m, 4.0 if wide else 1.9, side.furniture_gap_m, closed):
        if wide and rng.random() < 0.12:
            things += _wide_spot(rng, side, u)
        elif rng.random() < side.green:
            room = side.road.walk_m + side.setback_m - 0.9
            thing = tree(rng, 3.2, float(np.clip(2.0 * room, 2.0, 6.5)))
            things.append(side.put(thing, u, side.road.half_m + 0.55))
        else:
            thing, turn = _small(rng)
            things.append(side.put(thing, u, side.road.half_m + 0.5, turn))
    return things


def buildings(rng: np.random.Generator, side: Side, span_m: Span, gap_share: float = 0.15) -> list[Thing]:
    """Return a row of buildings; sometimes a gap with a wall or a fence, or a lot with a fence and bushes."""
    things: list[Thing] = []
    front, end = side.road.edge_m + side.setback_m, span_m[0]
    for middle, length in plots(rng, span_m, (9.0, 24.0), 5.0, gap_share):
        if middle - length / 2 - end > 1.0:
            closing = wall(middle - length / 2 - end - 0.3, rng.uniform(1.6, 2.4))
            things.append(side.put(closing, (middle - length / 2 + end) / 2, front + rng.uniform(1.0, 4.0)))
        end = middle + length / 2
        if rng.random() < 0.08:
            things += _lot(rng, side, (middle, length))
            continue
        back = rng.uniform(0.0, 1.2) if rng.random() < 0.3 else 0.0
        thing = town_house(rng, length, side.depth_m - back, abs(middle) > side.detail_m)
        things.append(side.put(thing, middle, front + back))
    return things


def walkers(rng: np.random.Generator, side: Side, reach_m: float, duration_s: float) -> list[Rider]:
    """Return pedestrians on the far part of the sidewalk, on one line and at one speed."""
    riders: list[Rider] = []
    lines = (0.5, 1.2) if side.road.walk_m >= 3.0 else (0.5,)
    for inset in lines:
        u_axis = side.put(Thing("line", ()), 0.0, side.road.edge_m - inset)
        lane = straight_lane(u_axis.x_m, u_axis.y_m, side.yaw + pick(rng, (0.0, np.pi)))
        count, pace = int(rng.integers(0, 4)), rng.uniform(0.9, 1.7)
        starts = sorted(rng.uniform(-reach_m, reach_m, count).tolist(), reverse=True)
        drivers = [Driver(person(rng, walking=True), start, pace) for start in starts]
        riders += flow(lane, drivers, duration_s)
    return riders


def _wide_spot(rng: np.random.Generator, side: Side, u_m: float) -> list[Thing]:
    across = side.road.half_m + 1.0
    if rng.random() < 0.35:
        return [side.put(bus_shelter(), u_m, across, np.pi)]
    return [side.put(one, u_m + one.x_m, across + 0.1 + one.y_m, one.yaw) for one in group(rng, 0.0, 0.0)]


def _small(rng: np.random.Generator) -> tuple[Thing, float]:
    """Return one piece of furniture and its turn; lamps reach over the road, signs face along it."""
    makers: tuple[tuple[float, Callable[[], Thing], float], ...] = (
        (0.28, lambda: lamp_post(rng), -np.pi / 2),
        (0.5, lambda: sign(rng), np.pi),
        (0.66, lambda: bin_(rng), 0.0),
        (0.74, lambda: cabinet(rng), np.pi),
        (0.82, bench, 0.0),
        (0.88, lambda: bush(rng, 0.8), 0.0),
        (0.94, lambda: person(rng), rng.uniform(-3, 3)),
        (1.0, lambda: pole(1.0, 0.05), 0.0),
    )
    draw = rng.random()
    maker, turn = next((maker, turn) for share, maker, turn in makers if draw <= share)
    return maker(), turn


def _lot(rng: np.random.Generator, side: Side, plot: Span) -> list[Thing]:
    """Return an empty lot: a mesh fence in front, behind it bushes, a tree, a garage."""
    (middle, length), front = plot, side.road.edge_m + side.setback_m
    things = [side.put(fence(length - 0.4, rng.uniform(1.0, 2.0)), middle, front + 0.2)]
    positions = spots(rng, (middle - length / 2 + 1, middle + length / 2 - 1), 2.4, (0.2, 3.0))
    for u in positions:
        thing = tree(rng, 2.3, 3.5) if rng.random() < 0.3 else bush(rng, rng.uniform(0.9, 2.0))
        things.append(side.put(thing, u, front + rng.uniform(2.5, 4.5)))
    things.append(side.put(garage(rng), middle, front + 6.5))
    return things
