"""A parking lot: double rows of bays between aisles, islands with trees and lamps, a market, roofs on posts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed_lab.sim.assets.buildings import glass_hall, kiosk, town_house
from viewshed_lab.sim.assets.shapes import Box, material_index
from viewshed_lab.sim.assets.street import (
    bin_,
    bus_shelter,
    bush,
    cabinet,
    conifer,
    fence,
    group,
    hedge,
    lamp_post,
    person,
    pick,
    place_at,
    pole,
    tree,
    wall,
)
from viewshed_lab.sim.assets.vehicles import car, parked_vehicle
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.layout import Mast, assembled, carriers, mast, plots, spots
from viewshed_lab.sim.worlds.outdoor_ground import relief
from viewshed_lab.sim.worlds.traffic import Driver, Lane, Rider, Stream, filled, flow, straight_lane

_HALF_M, _BAY_M, _DEEP_M, _ROAD_M = 112.0, 2.6, 5.1, 7.0


@dataclass(frozen=True, slots=True)
class Lot:
    """Measures of a parking lot."""

    half_x_m: float  # half the length of the rows
    rows_m: tuple[float, ...]  # y of the axes of the double rows, from the south
    island_m: float  # width of the strip between the two halves of a row
    aisle_m: float  # width of an aisle
    taken: float  # share of occupied bays
    curb_m: float  # height of the islands

    @property
    def pitch_m(self) -> float:
        """Distance from one double row to the next."""
        return 2 * _DEEP_M + self.island_m + self.aisle_m

    @property
    def half_y_m(self) -> float:
        """Distance from the center to the edge of the asphalt, beyond the outer aisles."""
        return self.rows_m[-1] + self.pitch_m / 2 + self.aisle_m / 2

    @property
    def aisles_m(self) -> tuple[float, ...]:
        """Axes of the aisles (y); there is one aisle more than rows."""
        return (self.rows_m[0] - self.pitch_m / 2, *(y + self.pitch_m / 2 for y in self.rows_m))


def parking(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a parking lot with the agents of ``plan`` in its aisles and on its islands."""
    lot = _lot(rng)
    masts = _masts(rng, plan.roadside, lot)
    still = [thing for y in lot.rows_m for thing in _row(rng, lot, y, masts)]
    still += [*_market(rng, lot), *_rim(rng, lot)]
    moving = _traffic(rng, plan, lot)
    return assembled("parking", _terrain(rng, lot), plan, still, moving, masts)


def _lot(rng: np.random.Generator) -> Lot:
    count, island, aisle = int(rng.integers(2, 4)), rng.uniform(1.0, 2.4), rng.uniform(6.0, 7.0)
    pitch = 2 * _DEEP_M + island + aisle
    rows = tuple(float((k + 0.5 - count / 2) * pitch) for k in range(count))
    half_x = rng.uniform(0.75, 1.0) * 92.0 / count
    return Lot(half_x, rows, island, aisle, rng.uniform(0.25, 0.8), rng.uniform(0.1, 0.15))


def _terrain(rng: np.random.Generator, lot: Lot) -> Terrain:
    land, edges = relief(rng, 0.035, 0.3), [0.0, 0.03]
    out_x, out_y, tip = lot.half_x_m + _ROAD_M, lot.half_y_m, lot.half_x_m - 0.4
    isles = [(y - lot.island_m / 2 - d, y + lot.island_m / 2 + d) for y in lot.rows_m for d in edges]
    y_m = [*np.array(isles).ravel(), *(way * (out_y + d) for way in (-1, 1) for d in edges)]
    x_m = [way * (at + d) for way in (-1, 1) for at in (tip, out_x) for d in edges]

    def raised(x: F64, y: F64) -> F64:
        isle = np.min([np.abs(y - row) for row in lot.rows_m], axis=0) < lot.island_m / 2 + 0.01
        outside = (np.abs(x) > out_x + 0.02) | (np.abs(y) > out_y + 0.02)
        return np.asarray(outside | (isle & (np.abs(x) < tip + 0.01)), np.float64)

    def material(x: F64, y: F64) -> NDArray[np.uint8]:
        walk = (y > out_y) & (y < out_y + 8.0)
        green = np.where(walk, material_index("concrete"), material_index("grass"))
        return np.where(raised(x, y) > 0, green, material_index("asphalt")).astype(np.uint8)

    def height(x: F64, y: F64) -> F64:
        return np.asarray(land.at(x, y) + lot.curb_m * raised(x, y))

    plain = np.linspace(-_HALF_M, _HALF_M, 24)
    return Terrain.of([*plain, *x_m], [*plain[::2], *y_m], height, material)


def _masts(rng: np.random.Generator, count: int, lot: Lot) -> list[Mast]:
    masts_placed = []
    for k in range(count):
        x = (k + 0.5 - count / 2) * 1.6 * lot.half_x_m / count + rng.uniform(-2, 2)
        y = pick(rng, lot.rows_m)
        masts_placed.append(mast(rng, x, y, (rng.uniform(-10, 10), y + pick(rng, (-15, 15)))))
    return masts_placed


def _row(rng: np.random.Generator, lot: Lot, y_m: float, masts: list[Mast]) -> list[Thing]:
    """Return a double row: cars in its bays, and on its island lamps, trees and bushes, or a roof on posts."""
    things: list[Thing] = []
    bays = int((2 * lot.half_x_m - 1.0) / _BAY_M)
    for way in (-1, 1):
        across = y_m + way * (lot.island_m / 2 + _DEEP_M / 2 + 0.1)
        fill, trolleys = float(np.clip(lot.taken + rng.normal(0, 0.15), 0.1, 0.95)), int(rng.integers(bays * 3))
        for k in range(bays):
            x = (k + 0.5 - bays / 2) * _BAY_M
            if k == trolleys:
                things.append(place_at(bus_shelter(), x, across, np.pi / 2))
            elif rng.random() < fill and k != trolleys + 1 and k != trolleys - 1:
                turn = pick(rng, (-1, 1)) * np.pi / 2 + rng.normal(0, 0.025)
                things.append(place_at(car(rng), x + rng.uniform(-0.12, 0.12), across + rng.uniform(-0.1, 0.05), turn))
    closed = [(post.x_m - 3.4, post.x_m + 3.4) for post in masts if abs(post.y_m - y_m) < 1.0]
    return things + (_roof(lot, y_m) if rng.random() < 0.2 and not closed else _island(rng, lot, y_m, closed))


def _island(rng: np.random.Generator, lot: Lot, y_m: float, closed: list[tuple[float, float]]) -> list[Thing]:
    things: list[Thing] = []
    green = rng.random()
    for x in spots(rng, (1.0 - lot.half_x_m, lot.half_x_m - 1.0), 1.0, (2.0, 9.0), closed):
        draw = rng.random()
        if draw < 0.3:
            things.append(place_at(lamp_post(rng, 1.5), x, y_m, pick(rng, (-1, 1)) * np.pi / 2))
        elif draw < 0.3 + 0.4 * green:
            things.append(place_at(tree(rng, 2.4, 4.5), x, y_m))
        else:
            things.append(place_at(bush(rng, 0.9) if draw < 0.9 else pole(1.2, 0.08), x, y_m))
    return things


def _roof(lot: Lot, y_m: float) -> list[Thing]:
    """Return a roof over the whole row on posts along its island."""
    high, long = 2.9, 2 * lot.half_x_m - 4.0
    deck = Box(0.0, 0.0, long, 2 * _DEEP_M + lot.island_m, high + 0.25, high, 0.0, "metal")
    posts = tuple(Box(x, 0.0, 0.25, 0.25, high) for x in np.linspace(-0.48, 0.48, 8) * long)
    return [place_at(Thing("roof", (deck, *posts)), 0.0, y_m)]


def _market(rng: np.random.Generator, lot: Lot) -> list[Thing]:
    """Return the market north of the lot with people, bins and sometimes a kiosk before it."""
    y = lot.half_y_m
    long = rng.uniform(0.9, 1.7) * lot.half_x_m
    at = rng.uniform(-0.3, 0.3) * lot.half_x_m
    things = [place_at(glass_hall(rng, long, rng.uniform(18, 30)), at, y + 8.5)]
    for x in spots(rng, (at - long / 2, at + long / 2), 2.0, (3.0, 15.0)):
        draw = rng.random()
        if draw < 0.3:
            things += group(rng, x, y + 2.0)
        else:
            things.append(place_at(cabinet(rng) if draw < 0.5 else bin_(rng) if draw < 0.8 else pole(1.0), x, y + 1.0))
    if rng.random() < 0.6:
        things.append(place_at(kiosk(rng), at - long / 2 - 5.0, y + 3.0))
    return things


def _rim(rng: np.random.Generator, lot: Lot) -> list[Thing]:
    """Return the surroundings of the other sides: hedge, fence or wall, then trees, then plain buildings."""
    things: list[Thing] = []
    reach_x, reach_y = lot.half_x_m + _ROAD_M + 1.2, lot.half_y_m + 1.2
    for yaw, out, half in ((np.pi, reach_y, reach_x), (-np.pi / 2, reach_x, reach_y), (np.pi / 2, reach_x, reach_y)):
        c, s = np.cos(yaw), np.sin(yaw)
        kind, high = int(rng.integers(4)), rng.uniform(0.8, 2.0)
        for u in spots(rng, (-half + 1, half - 1), 8.0, (0.0, 0.1), [(-3.5, 3.5)]):
            if kind < 3:
                thing = (hedge(rng, 7.9, high), fence(7.9, high), wall(7.9, min(high, 1.2)))[kind]
                things.append(place_at(thing, c * u - s * out, s * u + c * out, yaw))
        for u in spots(rng, (-half, half), 3.0, (1.0, 14.0)):
            v = out + 4.0 + rng.uniform(0, 3)
            one = conifer(rng) if rng.random() < 0.25 else tree(rng, 2.0, 5.0)
            things.append(place_at(one, c * u - s * v, s * u + c * v))
        for u, length in plots(rng, (-half, half), (12.0, 26.0), 9.0, 0.6):
            v = out + 13.0
            things.append(place_at(town_house(rng, length, 11.0, True), c * u - s * v, s * u + c * v, yaw))
    return things


def _traffic(rng: np.random.Generator, plan: AgentPlan, lot: Lot) -> list[Rider]:
    """Return the cars in the aisles, which are one-way in alternating directions, and on the end roads; pedestrians."""
    east, roam = lot.half_x_m + _ROAD_M / 2, lot.half_x_m - 4.0
    ends = [(straight_lane(way * east, 0.0, way * np.pi / 2), lot.half_y_m - 6.0) for way in (1, -1)]
    lanes = [(straight_lane(0.0, y - 1.2 * (-1) ** k, np.pi * (k % 2)), roam) for k, y in enumerate(lot.aisles_m)]
    riders = aisles_driven(rng, plan, [*lanes, *ends], (10.0, 40.0, 160.0))
    for k, y in enumerate(lot.aisles_m):
        riders += aisle_walkers(rng, y + 1.9 * (-1) ** k, roam, lot.half_x_m, plan.duration_s)
    return riders


def aisles_driven(
    rng: np.random.Generator, plan: AgentPlan, routes: list[tuple[Lane, float]], gap_m: tuple[float, float, float]
) -> list[Rider]:
    """Return the slow traffic of aisles, given as lane and reach from its middle; no vehicle leaves them.

    ``gap_m``: smallest gap between two vehicles, and bounds of the largest gap.
    """
    riders: list[Rider] = []
    for seats, (lane, reach) in zip(carriers(rng, plan, len(routes)), routes, strict=True):
        speed = float(min(rng.uniform(1.5, 5.5), max(1.0, 1.8 * reach / plan.duration_s)))
        stream = Stream(reach, reach, speed, (gap_m[0], rng.uniform(*gap_m[1:])), upstream_m=0.0)
        drivers = filled(rng, stream, parked_vehicle, seats, plan.duration_s)
        held = [Driver(d.thing, d.start_m, d.speed_mps, reach, None, d.sensor_ahead_m) for d in drivers]
        riders += flow(lane, held, plan.duration_s)
    return riders


def aisle_walkers(rng: np.random.Generator, y_m: float, roam_m: float, end_m: float, duration_s: float) -> list[Rider]:
    """Return up to three people who walk along x at ``y_m`` in one direction, up to ``end_m``."""
    starts = sorted(rng.uniform(-roam_m, roam_m, int(rng.integers(0, 4))).tolist(), reverse=True)
    walk = [Driver(person(rng, walking=True), at, 1.2, end_m) for at in starts]
    return flow(straight_lane(0.0, y_m, pick(rng, (0.0, np.pi))), walk, duration_s)
