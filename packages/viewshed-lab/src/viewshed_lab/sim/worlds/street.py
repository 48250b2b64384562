"""Street canyons in town: lanes both ways along x, parked rows, sidewalks, rows of buildings or of glass fronts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from viewshed_lab.sim.assets.buildings import glass_front, glass_hall
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.assets.street import cone, place_at, wall, work_barrier
from viewshed_lab.sim.assets.vehicles import cyclist, street_vehicle
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.frontage import PARKING_M, Side, buildings, furniture, parked, random_side, walkers
from viewshed_lab.sim.worlds.layout import Mast, Span, assembled, mast, plots
from viewshed_lab.sim.worlds.outdoor_ground import Ground, Road, relief
from viewshed_lab.sim.worlds.traffic import Driver, Pace, Rider, driven, flow, straight_lane

_HALF_X_M, _HALF_Y_M, _ROAM_M = 112.0, 70.0, 50.0
_PACE = Pace(_HALF_X_M, _ROAM_M, (5.0, 14.0), (6.0, 20.0, 60.0), (0.8, 1.6))


Houses = Callable[[np.random.Generator, Side, Span], list[Thing]]
"""Makes the row of buildings on one side of a street."""


def street(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a street canyon with the agents of ``plan`` in its lanes and on its sidewalks.

    A street canyon in town: lanes both ways along x, parked rows, sidewalks, closed rows of buildings.
    """
    return street_of(rng, plan, "street", buildings)


def street_of(rng: np.random.Generator, plan: AgentPlan, name: str, houses: Houses, steepest: float = 0.06) -> World:
    """Return a street in town with lanes, parked vehicles, sidewalks and traffic, between two rows of ``houses``."""
    lanes, wide, biking = 1 + int(rng.random() < 0.4), rng.uniform(3.0, 3.5), rng.random() < 0.35
    half = lanes * wide + (1.6 if biking else 0.0) + PARKING_M + 0.2
    road = Road(half, rng.uniform(2.1, 4.8), rng.uniform(0.1, 0.15))
    bumps = (rng.uniform(-40, 40),) if lanes == 1 and rng.random() < 0.3 else ()
    ground = Ground(relief(rng, steepest), road, None, rng.uniform(0.0, 0.05), "concrete", bumps)
    sides = [random_side(rng, yaw, road, rng.random() < 0.85) for yaw in (0.0, np.pi)]
    masts = _masts(rng, plan.roadside, road)
    still = [thing for one in sides for thing in _lined(rng, one, masts, bumps, houses)]
    across = [(k + 0.5) * wide for k in range(lanes) for _ in range(2)]
    ways = [straight_lane(0.0, at * (-1) ** (k + 1), np.pi * (k % 2)) for k, at in enumerate(across)]
    moving = driven(rng, plan, ways, _PACE, street_vehicle)
    if biking:
        moving += _cyclists(rng, plan, lanes * wide + 0.8)
    moving += [rider for one in sides for rider in walkers(rng, one, 70.0, plan.duration_s)]
    if not sides[0].parked and rng.random() < 0.5:
        still += _works(rng, half)
    return assembled(name, ground.terrain(_HALF_X_M, _HALF_Y_M), plan, still, moving, masts)


def _masts(rng: np.random.Generator, count: int, road: Road) -> list[Mast]:
    masts_placed = []
    for k in range(count):
        x = (k + 0.5 - count / 2) * 80.0 / max(count, 1) + rng.uniform(-5, 5)
        side = -1 if (k + rng.integers(2)) % 2 else 1
        masts_placed.append(mast(rng, x, side * (road.half_m + 0.55), (x + rng.uniform(-15, 15), -side * 2.0)))
    return masts_placed


def _lined(
    rng: np.random.Generator, one: Side, masts: list[Mast], bumps: tuple[float, ...], houses: Houses
) -> list[Thing]:
    flip = np.cos(one.yaw)
    kept = [(flip * post.x_m - 3.9, flip * post.x_m + 3.9) for post in masts if post.y_m * flip > 0]
    humps = [(flip * at - 1.2, flip * at + 1.2) for at in bumps]
    span = (-_HALF_X_M, _HALF_X_M)
    return [
        *parked(rng, one, span, humps),
        *furniture(rng, one, span, kept),
        *houses(rng, one, (-_HALF_X_M + rng.uniform(-8, 0), _HALF_X_M)),
    ]


def _cyclists(rng: np.random.Generator, plan: AgentPlan, across_m: float) -> list[Rider]:
    riders: list[Rider] = []
    for y, yaw in ((-across_m, 0.0), (across_m, np.pi)):
        starts = sorted(rng.uniform(-90, 90, int(rng.integers(0, 4))).tolist(), reverse=True)
        drivers = [Driver(cyclist(rng), start, 4.5) for start in starts]
        riders += flow(straight_lane(0.0, y, yaw), drivers, plan.duration_s)
    return riders


def _works(rng: np.random.Generator, half_m: float) -> list[Thing]:
    """Return a construction site in the parking strip: barriers around it and cones before it."""
    x, y = rng.uniform(-40, 40), half_m - 1.1
    rows = [place_at(work_barrier(), x + dx, y - 0.8) for dx in (-3.4, -1.2, 1.0, 3.2)]
    ends = [place_at(work_barrier(), x + dx, y + 0.35, np.pi / 2) for dx in (-4.8, 4.6)]
    return [*rows, *ends, *(place_at(cone(), x + dx, y + 0.2 * dx - 1.0 * np.sign(dx)) for dx in (6.0, -6.0))]


def glass_fronts(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a street between glass fronts with the agents of ``plan``.

    A street of glass: shops, showrooms and offices with furnished rooms behind fronts that beams pass.
    """
    return street_of(rng, plan, "glass_fronts", _fronts, 0.02)


def _fronts(rng: np.random.Generator, side: Side, span_m: Span) -> list[Thing]:
    """Return a row of glass fronts; between some of them walls, and before some of them balustrades of glass."""
    things: list[Thing] = []
    front, end = side.road.edge_m + side.setback_m, span_m[0]
    for middle, length in plots(rng, span_m, (9.0, 26.0), 6.0, 0.25):
        if middle - length / 2 - end > 1.0:
            closing = wall(middle - length / 2 - end - 0.3, rng.uniform(1.0, 2.4))
            things.append(side.put(closing, (middle - length / 2 + end) / 2, front + rng.uniform(1.0, 4.0)))
        end = middle + length / 2
        back = rng.uniform(0.0, 3.0) if rng.random() < 0.4 else 0.0
        maker = glass_hall if rng.random() < 0.15 and back > 1.7 else glass_front
        things.append(side.put(maker(rng, length, side.depth_m), middle, front + back))
        if back > 1.2 and maker is glass_front and rng.random() < 0.5:
            things.append(side.put(_balustrade(0.6 * length), middle, front + 0.2))
    return things


def _balustrade(length_m: float) -> Thing:
    """Return a waist-high balustrade of glass along x with posts and a handrail."""
    stands = [Box(float(x), 0.0, 0.05, 0.05, 1.05, -0.3, 0.0, "metal")
              for x in np.linspace(-0.5, 0.5, max(2, round(length_m / 1.5))) * length_m]  # fmt: skip
    rail = Box(0.0, 0.0, length_m, 0.05, 1.1, 1.05, 0.0, "metal")
    return Thing("balustrade", (Box(0.0, 0.0, length_m, 0.02, 1.05, 0.1, 0.0, "window"), *stands, rail))
