"""A highway: two carriageways on a gentle bend, median, guard rails, sound walls, gantries, woods beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed_lab.sim.assets.shapes import Box, material_index
from viewshed_lab.sim.assets.street import (
    bush,
    concrete_barrier,
    cone,
    conifer,
    gantry,
    guard_rail,
    lamp_post,
    pick,
    pole,
    sign,
    sound_wall,
    tree,
    work_barrier,
)
from viewshed_lab.sim.assets.vehicles import highway_vehicle, van
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.layout import Mast, assembled, carriers, spots
from viewshed_lab.sim.worlds.outdoor_ground import Relief, relief
from viewshed_lab.sim.worlds.roadway import Bend, masts_beside
from viewshed_lab.sim.worlds.traffic import Lane, Rider, Stream, filled, flow

_LANE_M, _SHOULDER_M, _MARGIN_M = 3.6, 2.8, 66.0
_SHORTEST_ROAM_M, _LONGEST_ROAM_M = 50.0, 240.0
_LATTICE = 34


@dataclass(frozen=True, slots=True)
class Route:
    """Axis and cross-section of the highway."""

    bend: Bend  # the axis
    median_m: float  # from the axis to the innermost lane
    lanes: int  # each way
    bank_m: float  # depth of the land beside the road below the shoulder (negative: height above it)
    slope_m: float  # width of the embankment

    @property
    def edge_m(self) -> float:
        """From the axis to the outer edge of the shoulder."""
        return self.median_m + self.lanes * _LANE_M + _SHOULDER_M

    def lane(self, number: int, back: bool) -> Lane:
        """Return lane ``number`` from the median; its meter 0 is at x = 0."""
        return self.bend.lane((1 if back else -1) * (self.median_m + (number + 0.5) * _LANE_M), back)


def highway(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a highway long enough for the agents of ``plan`` to drive along it."""
    route = Route(Bend(rng.uniform(0, 14), rng.uniform(420, 700), rng.uniform(0, 6.28)), rng.uniform(1.2, 3.5),
                  int(rng.integers(2, 4)), pick(rng, (-1.5, 0.3, 0.8, 2.0)) * rng.uniform(0.7, 1.3),
                  rng.uniform(5.0, 9.0))  # fmt: skip
    fastest = rng.uniform(20.0, 35.0)
    roam = float(np.clip(0.5 * fastest * plan.duration_s + 25.0, _SHORTEST_ROAM_M, _LONGEST_ROAM_M))
    speed = min(fastest, 2.0 * (roam - 20.0) / plan.duration_s)
    half = roam + _MARGIN_M
    masts = masts_beside(rng, plan.roadside, route.bend, route.edge_m + 2.2)
    moving = _traffic(rng, plan, route, (roam, speed))
    still = [*_median(rng, route, half), *_overhead(rng, route), *_works(rng, route)]
    for side in (-1, 1):
        still += _roadside(rng, route, half, side, masts)
    return assembled("highway", _terrain(relief(rng, 0.04), route, half), plan, still, moving, masts)


def _terrain(land: Relief, route: Route, half_m: float) -> Terrain:
    reach = route.edge_m + route.slope_m + float(np.abs(route.bend.axis(np.linspace(-half_m, half_m, 40))).max())
    near = np.linspace(-reach, reach, _LATTICE - 6)
    y_m = np.concatenate([[-110.0, -80.0, -reach - 8], near, [reach + 8, 80.0, 110.0]])

    def height(x: F64, y: F64) -> F64:
        off = np.abs(y - route.bend.axis(x))
        beyond = np.clip((off - route.edge_m - 1.0) / route.slope_m, 0.0, 1.0)
        return land.at(x, 0.0 * y) - 0.02 * np.clip(off, 0.0, route.edge_m) - route.bank_m * beyond

    def material(x: F64, y: F64) -> NDArray[np.uint8]:
        off = np.abs(y - route.bend.axis(x))
        green = (off > route.edge_m + 0.5) | (off < route.median_m - 0.5)
        return np.where(green, material_index("grass"), material_index("asphalt")).astype(np.uint8)

    return Terrain.of(np.linspace(-half_m, half_m, _LATTICE), y_m, height, material)


def _traffic(rng: np.random.Generator, plan: AgentPlan, route: Route, pace: tuple[float, float]) -> list[Rider]:
    roam, fastest = pace
    riders: list[Rider] = []
    for k, seats in enumerate(carriers(rng, plan, 2 * route.lanes)):
        number, back = k // 2, k % 2 == 1
        speed = fastest * (1.0 - 0.12 * number) * rng.uniform(0.94, 1.0)
        gaps = (6.0 + 0.7 * speed, 20.0 + rng.uniform(1.5, 4.0) * speed)
        stream = Stream(roam + _MARGIN_M, roam, speed, gaps, upstream_m=speed * plan.duration_s)
        drivers = filled(rng, stream, highway_vehicle, seats, plan.duration_s)
        riders += flow(route.lane(number, back), drivers, plan.duration_s)
    return riders


def _median(rng: np.random.Generator, route: Route, half_m: float) -> list[Thing]:
    """Return the barrier between the carriageways, and on some highways lamps beside it."""
    step = 16.0
    maker = pick(rng, (concrete_barrier, concrete_barrier, guard_rail))
    things = [route.bend.put(maker(step - 0.05), x, 0.0) for x in np.arange(-half_m + step / 2, half_m, step).tolist()]
    if rng.random() < 0.4:
        lamps = np.arange(-half_m + rng.uniform(5, 30), half_m, rng.uniform(35, 50)).tolist()
        things += [route.bend.put(lamp_post(rng), x, 0.7, np.pi / 2) for x in lamps]
    return things


def _overhead(rng: np.random.Generator, route: Route) -> list[Thing]:
    """Return at random a sign bridge over one carriageway and a road bridge over both."""
    things, span = [], route.edge_m + 0.25
    if rng.random() < 0.5:
        things.append(route.bend.put(gantry(rng, span), rng.uniform(-60, 60), -span - 0.75))
    if rng.random() < 0.2:
        x, half = pick(rng, (-1, 1)) * rng.uniform(75, 95), route.edge_m + 2.2
        ends = tuple(Box(0.0, y, 8.0, 1.5, 5.4, -3.0, 0.0, "concrete") for y in (-half, half))
        deck = Box(0.0, 0.0, 9.0, 2 * half + 24.0, 6.6, 5.4, 0.0, "concrete")
        rails = tuple(Box(dx, 0.0, 0.1, 2 * half + 24.0, 7.6, 6.6, 0.0, "metal") for dx in (-4.4, 4.4))
        things.append(route.bend.put(Thing("bridge", (*ends, deck, *rails)), x, 0.0))
    return things


def _works(rng: np.random.Generator, route: Route) -> list[Thing]:
    """Return at random a van on the shoulder with cones behind it and a barrier."""
    if rng.random() > 0.3:
        return []
    x, across = rng.uniform(-50, 50), -(route.edge_m - 1.2)
    cones = [route.bend.put(cone(), x - 6.0 - 4.0 * k, across + 0.2 * k - 0.6) for k in range(4)]
    barrier = route.bend.put(work_barrier(), x - 4.2, across, np.pi / 2)
    return [route.bend.put(van(rng), x, across), barrier, *cones]


def _roadside(rng: np.random.Generator, route: Route, half_m: float, side: int, masts: list[Mast]) -> list[Thing]:
    """Return one roadside: posts, rails along a part, a sound wall along a part, signs, then woods."""
    edge, step = route.edge_m, 16.0
    positions = np.arange(-half_m + step / 2, half_m, step)
    things = [
        route.bend.put(pole(1.0, 0.06, "sign"), x, side * (edge + 0.1)) for x in (positions[1::3] + step / 2).tolist()
    ]
    rail = np.abs(positions - rng.uniform(-half_m, half_m)) < rng.uniform(40, 160)
    things += [route.bend.put(guard_rail(step - 0.05), x, side * (edge + 0.4)) for x in positions[rail].tolist()]
    for x in rng.uniform(-half_m, half_m, int(rng.integers(1, 4))).tolist():
        if all(abs(post.x_m - x) > 2.0 for post in masts) and not 70.0 < abs(x) < 100.0:
            things.append(route.bend.put(sign(rng), x, side * (edge + 1.7), 0.0 if side < 0 else np.pi))
    walled = np.abs(positions - rng.uniform(-half_m, half_m)) < (rng.uniform(60, 200) if rng.random() < 0.4 else 0.0)
    high = rng.uniform(2.5, 5.0)
    things += [route.bend.put(sound_wall(step, high), x, side * (edge + 4.2)) for x in positions[walled].tolist()]
    return things + _woods(rng, route, half_m, side)


def _woods(rng: np.random.Generator, route: Route, half_m: float, side: int) -> list[Thing]:
    """Return trees and bushes in two loose rows beyond the embankment, clear of bridges."""
    things, sparse = [], half_m / 110.0
    start = route.edge_m + route.slope_m + 3.0
    for row, share in ((0.0, 0.7), (9.0, 0.4)):
        for x in spots(rng, (-half_m, half_m), 5.0, (0.5, 26.0 * sparse), [(-100.0, -70.0), (70.0, 100.0)]):
            maker = rng.random()
            thing = tree(rng, 1.8, 5.0) if maker < share else conifer(rng) if maker < 0.8 else bush(rng, 2.4)
            things.append(route.bend.put(thing, x, side * (start + row + rng.uniform(0.0, 4.0))))
    return things
