"""A road bridge over another road: embankment and deck, or an underpass, with sensors on both levels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed_lab.sim.assets.shapes import Box, Cylinder, Shape, material_index
from viewshed_lab.sim.assets.street import bush, concrete_barrier, guard_rail, lamp_post, pick, place_at, sign, tree
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import DECK, AgentPlan, Thing, World
from viewshed_lab.sim.worlds.layout import Mast, assembled, lines_of, mast, spots
from viewshed_lab.sim.worlds.outdoor_ground import Relief, relief
from viewshed_lab.sim.worlds.roadsides import country_vehicle
from viewshed_lab.sim.worlds.roadway import HALF_M
from viewshed_lab.sim.worlds.site_plan import SitePlan
from viewshed_lab.sim.worlds.traffic import Lane, Pace, driven, straight_lane

_PACE = Pace(110.0, 50.0, (6.0, 18.0), (7.0, 25.0, 90.0))
_FACE_M = 0.03
_MIN_CLEAR_M = 4.4


@dataclass(frozen=True, slots=True)
class Crossing:
    """Two roads, one along x on the upper level, one along y on the lower; heights from the lower road."""

    high_m: float  # of the upper road where it crosses
    grade: float  # slope by which the upper road falls away from the crossing (negative: it rises)
    land_m: float  # height of the land between the roads
    gap_m: float  # between the abutments
    at_m: float  # x of the center of the gap
    deck_m: float  # half the width of the deck
    low_m: float  # half the width of the lower road; beyond it the land may rise
    cut: float  # slope of the land beyond that
    lane_m: float  # width of a lane
    lie: Relief  # of the land

    def road(self, x: F64) -> F64:
        """Return z of the upper road: level over the gap and 8 m to either side, then on a grade."""
        distance_m = np.clip(np.abs(x - self.at_m) - self.gap_m / 2 - 8.0, 0.0, 70.0)
        return np.asarray(self.high_m - self.grade * distance_m)

    def height(self, x: F64, y: F64) -> F64:
        """Return z of the ground: the lower road and its banks in the gap, the embankment outside."""
        off = np.abs(x - self.at_m)
        low = np.minimum(0.05 * np.clip(np.abs(y) - 28.0, 0.0, None), max(self.land_m, 0.0))
        free = np.clip((off - self.low_m - 4.0) / 30.0, 0.0, 1.0) * np.clip(
            (np.abs(y) - self.deck_m - 8) / 20, 0.0, 1.0
        )
        land = np.minimum(low + self.cut * np.clip(off - self.low_m, 0.0, None), self.land_m + self.lie.at(x, y) * free)
        land = np.where(off <= self.low_m, low - 0.02 * off, np.maximum(land, low - 0.02 * self.low_m))
        beside = np.clip(np.abs(y) - self.deck_m - 0.4, 0.0, None)
        bank = self.road(x) - 0.65 * beside
        sunk = self.road(x) + 0.65 * beside
        carried = np.clip(land, bank, np.maximum(sunk, bank))
        return np.where(off < self.gap_m / 2, land, carried)

    def top(self, x: F64, y: F64) -> F64:
        """Return z of the upper level: the road on the deck and on the embankment, else the ground."""
        return np.where(np.abs(y) <= self.deck_m, self.road(x), self.height(x, y))

    def terrains(self) -> tuple[Terrain, Terrain]:
        """Return the ground and the upper level, on the same lines."""
        faces = [self.at_m + way * self.gap_m / 2 + step for way in (-1, 1) for step in (-_FACE_M, _FACE_M)]
        lows = [self.at_m + way * (self.low_m + step) for way in (-1, 1) for step in (0.0, self.high_m / self.cut)]
        plain = np.linspace(-HALF_M, HALF_M, 27)
        x_m = lines_of([*plain, *faces, *lows, self.at_m], HALF_M, 0.02)
        edges = [way * (self.deck_m + step) for way in (-1, 1) for step in (0.0, _FACE_M, 0.4, 3.0, 6.0, 9.0, 12.0)]
        y_m = lines_of([*plain, *edges, 0.0], HALF_M, 0.02)
        return Terrain.of(x_m, y_m, self.height, self.material), Terrain.of(x_m, y_m, self.top, self.material)

    def material(self, x: F64, y: F64) -> NDArray[np.uint8]:
        """Return the material of the ground, rows (…,) of ``MATERIALS``."""
        off = np.abs(x - self.at_m)
        paved = (off < self.low_m) | ((np.abs(y) < self.deck_m) & (off > self.gap_m / 2 + _FACE_M))
        face = (np.abs(off - self.gap_m / 2) < _FACE_M) | ((off > self.low_m) & (off < self.gap_m / 2))
        green = np.where(face, material_index("concrete"), material_index("grass"))
        return np.where(paved, material_index("asphalt"), green).astype(np.uint8)

    def lanes(self) -> list[Lane]:
        """Return the two lanes of the upper road, then those of the lower one."""
        half = self.lane_m / 2
        return [
            straight_lane(0.0, -half, 0.0), straight_lane(0.0, half, np.pi),
            straight_lane(self.at_m + half, 0.0, np.pi / 2), straight_lane(self.at_m - half, 0.0, -np.pi / 2),
        ]  # fmt: skip


def bridge(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a bridge with the agents of ``plan`` on the road over it, on the road below it, and on masts below."""
    cross = _crossing(rng)
    terrain, upper = cross.terrains()
    masts = _masts(rng, plan.roadside, cross)
    site = SitePlan.around(masts)
    site.things += _structure(rng, cross)
    _land(rng, site, cross)
    moving = [
        (replace(thing, upper=True) if abs(np.cos(thing.yaw)) > 0.5 else thing, ahead)
        for thing, ahead in driven(rng, plan, cross.lanes(), _PACE, country_vehicle)
    ]
    return assembled("bridge", terrain, plan, site.things, moving, masts, upper)


def _crossing(rng: np.random.Generator) -> Crossing:
    high, lane = rng.uniform(5.6, 8.5), rng.uniform(3.0, 3.5)
    kind = rng.random()  # over level land, an underpass, or land between the two
    land = 0.0 if kind < 0.45 else high if kind < 0.75 else rng.uniform(0.3, 0.7) * high
    grade = rng.uniform(0.0, 0.06) if land < high else rng.uniform(-0.02, 0.02)
    low = lane + rng.uniform(0.8, 3.0)
    cut = rng.uniform(0.6, 1.5) if rng.random() < 0.6 else 40.0
    gap = 2 * (low + (rng.uniform(0.3, 4.0) if cut > 10 else min(high / cut, 6.0) + 0.5))
    return Crossing(high, grade, land, gap, rng.uniform(-12.0, 12.0), lane + rng.uniform(0.9, 2.6), low, cut, lane,
                    relief(rng, 0.03, 0.8))  # fmt: skip


def _masts(rng: np.random.Generator, count: int, cross: Crossing) -> list[Mast]:
    """Return masts beside the lower road, at some distance from the deck."""
    posts = []
    for k in range(count):
        x, side = cross.at_m + pick(rng, (-1, 1)) * (cross.low_m - 0.4), -1 if k % 2 else 1
        y = side * (cross.deck_m + 8.0 + 7.0 * (k // 2) + rng.uniform(0.0, 4.0))
        posts.append(mast(rng, x, y, (cross.at_m, rng.uniform(-8.0, 8.0))))
    return posts


def _structure(rng: np.random.Generator, cross: Crossing) -> list[Thing]:
    """Return deck, girders, optional piers, parapets, and the things on the upper road."""
    top, long, wide = cross.high_m, cross.gap_m + 1.2, 2 * cross.deck_m
    deep = min(rng.uniform(0.7, 1.6), top - _MIN_CLEAR_M)
    slab = 0.45 * deep
    deck = Thing(DECK, (Box(0.0, 0.0, long, wide, top, top - slab, 0.0, "asphalt"),), cross.at_m, z_m=0.0)
    count = int(rng.integers(2, 5))
    ys = np.linspace(-0.4, 0.4, count) * wide
    under: list[Shape] = [Box(0.0, y, long, 0.5, top - slab, top - deep, 0.0, "concrete") for y in ys.tolist()]
    pier = cross.low_m + 0.5
    if cross.gap_m / 2 > cross.low_m + 1.2:
        for x in (-pier, pier):
            under.append(Box(x, 0.0, 0.9, 0.95 * wide, top - deep, top - deep - 0.5, 0.0, "concrete"))
            under += [Cylinder(x, y, 0.4, top - deep - 0.5, -1.0, "concrete") for y in ys.tolist()]
    things = [deck, Thing("bridge", tuple(under), cross.at_m, z_m=0.0)]
    things += _edges(rng, cross)
    return things


def _edges(rng: np.random.Generator, cross: Crossing) -> list[Thing]:
    """Return parapets or railings on the deck, rails or barriers on the embankment beyond it, as on both its sides."""
    kind, high = int(rng.integers(3)), rng.uniform(0.9, 1.3)
    maker = pick(rng, (guard_rail, concrete_barrier, None))
    lamps = np.arange(-100.0 + rng.uniform(0, 20), 100.0, rng.uniform(24.0, 40.0)).tolist() if maker is None else []
    things = [
        replace(place_at(lamp_post(rng), x, side * (cross.deck_m - 0.5), -side * np.pi / 2), upper=True)
        for side in (-1, 1)
        for x in lamps
        if abs(x - cross.at_m) > cross.gap_m / 2 + 2.0
    ]
    for side in (-1, 1):
        y, long = side * (cross.deck_m - 0.15), cross.gap_m + 2.0
        solid = Box(0.0, 0.0, long, 0.22, high, -0.2, 0.0, "concrete")
        bars = [Box(0.0, 0.0, long, 0.05, z, z - 0.06, 0.0, "metal") for z in (high, 0.66 * high, 0.33 * high)]
        stands = [
            Box(x * long, 0.0, 0.07, 0.07, high, -0.1, 0.0, "metal") for x in np.linspace(-0.48, 0.48, 12).tolist()
        ]
        mesh = [Box(0.0, 0.0, long, 0.04, high + 0.6, 0.1, 0.0, "mesh")]
        parts = ((solid,), (*bars, *stands), (*mesh, *stands))[kind]
        things.append(Thing("parapet", parts, cross.at_m, y, upper=True))
        for way in (-1, 1):
            for k in range(int(rng.integers(2, 9)) if maker else 0):
                x = cross.at_m + way * (cross.gap_m / 2 + 1.1 + 4.0 + 8.0 * k)
                if maker and abs(x) < HALF_M - 4.0:
                    things.append(replace(place_at(maker(7.95), x, side * (cross.deck_m - 0.5)), upper=True))
    return things


def _land(rng: np.random.Generator, site: SitePlan, cross: Crossing) -> None:
    """Put signs and lamps along the lower road, trees and bushes on the land and on the slopes."""
    x0 = cross.at_m
    for side in (-1, 1):
        for y in spots(rng, (-HALF_M + 4, HALF_M - 4), 1.0, (10.0, 50.0), [(-cross.deck_m - 3.0, cross.deck_m + 3.0)]):
            thing = sign(rng) if rng.random() < 0.5 else lamp_post(rng)
            turn = side * np.pi / 2 if thing.kind == "sign" else np.pi * (side > 0)
            site.put(place_at(thing, x0 + side * (cross.low_m - 0.35), y, turn))
    for _ in range(int(rng.integers(10, 60))):
        x, y = rng.uniform(-HALF_M + 5, HALF_M - 5, 2).tolist()
        if abs(x - x0) > cross.low_m + 3.0 and abs(y) > cross.deck_m + 2.5:
            site.put(place_at(tree(rng, 2.2, rng.uniform(3.0, 7.0)) if rng.random() < 0.6 else bush(rng, 2.0), x, y))
