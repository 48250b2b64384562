"""A town junction: two crossing streets; one has right of way, the traffic of the other waits at the stop line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from viewshed_lab.sim.assets.street import person, pick, traffic_light
from viewshed_lab.sim.assets.vehicles import street_vehicle
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.frontage import PARKING_M, Side, buildings, furniture, parked, random_side
from viewshed_lab.sim.worlds.layout import Mast, Span, assembled, carriers, mast
from viewshed_lab.sim.worlds.outdoor_ground import Ground, Road, relief
from viewshed_lab.sim.worlds.traffic import Driver, Lane, Rider, Stream, filled, flow, right_turn, straight_lane

_HALF_M, _ROAM_M = 112.0, 50.0
_CROSSWALK_M = 4.8
_TURN_CLEARANCE_M, _BEHIND_TURN_M = 1.4, 12.0
_TURN = frozenset({"car", "robot", "cyclist", "motorcycle"})


@dataclass(frozen=True, slots=True)
class Street:
    """One of the two streets."""

    road: Road  # its cross-section
    lanes: int  # each way
    wide_m: float  # width of a lane
    yaw: float  # of its axis: 0 along x, π/2 along y
    free: bool  # whether it has right of way

    def lane(self, direction: int, number: int) -> Lane:
        """Return lane ``number`` from the axis in a direction (0 or 1); meter 0 is on the other street's axis."""
        yaw, across = self.yaw + direction * np.pi, (number + 0.5) * self.wide_m
        return straight_lane(float(across * np.sin(yaw)), float(-across * np.cos(yaw)), yaw)


def junction(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a junction with the agents of ``plan`` on its streets and at its corners."""
    curb, free = rng.uniform(0.1, 0.15), int(rng.integers(2))
    streets = [_street(rng, yaw, curb, k == free) for k, yaw in enumerate((0.0, np.pi / 2))]
    ground = Ground(relief(rng), streets[0].road, streets[1].road, 0.0, pick(rng, ("concrete", "grass")))
    masts = _masts(rng, plan.roadside, streets)
    sides = [_side(rng, one, direction) for one in streets for direction in (0, 1)]
    still = [
        thing for k, one in enumerate(sides) for thing in _lined(rng, one, streets[1 - k // 2].road, k // 2, masts)
    ]
    dealt = carriers(rng, plan, 2 * sum(one.lanes for one in streets))
    moving: list[Rider] = []
    for one, other in (streets, streets[::-1]):
        still += _lights(rng, one, other)
        for direction in (0, 1):
            seats = [dealt.pop() for _ in range(one.lanes)]
            moving += _one_way(rng, one, other, direction, seats, plan.duration_s)
    terrain = ground.terrain(_HALF_M, _HALF_M, 11.0)
    return assembled("junction", terrain, plan, still, moving, masts)


def _street(rng: np.random.Generator, yaw: float, curb_m: float, free: bool) -> Street:
    lanes, wide = 1 + int(rng.random() < 0.35), rng.uniform(3.0, 3.5)
    road = Road(lanes * wide + PARKING_M + 0.2, rng.uniform(2.2, 4.2), curb_m)
    return Street(road, lanes, wide, yaw, free)


def _side(rng: np.random.Generator, street: Street, direction: int) -> Side:
    one = random_side(rng, street.yaw + direction * np.pi, street.road, rng.random() < 0.8)
    gap = one.furniture_gap_m[0] + 2.5
    return replace(one, detail_m=42.0, furniture_gap_m=(gap, 2.5 * gap), parked=0.8 * one.parked)


def _lined(rng: np.random.Generator, one: Side, other: Road, second: int, masts: list[Mast]) -> list[Thing]:
    """Return the things on one side of a street, left and right of the other street."""
    things, c, s = [], np.cos(one.yaw), np.sin(one.yaw)
    kept = [(c * post.x_m + s * post.y_m - 3.9, c * post.x_m + s * post.y_m + 3.9) for post in masts
            if c * post.y_m - s * post.x_m > 0]  # fmt: skip
    corner = other.edge_m + 2.7
    for span in ((-_HALF_M, -corner), (corner, _HALF_M)):
        inner = _shortened(span, corner + (15.0 if second else 0.0))
        things += parked(rng, one, _shortened(span, corner + 4.0))
        things += furniture(rng, one, _shortened(span, corner + 4.0), kept)
        things += buildings(rng, one, inner, 0.1)
    return things


def _shortened(span: Span, start_m: float) -> Span:
    return (span[0], -start_m) if span[0] < 0 else (start_m, span[1])


def _masts(rng: np.random.Generator, count: int, streets: Sequence[Street]) -> list[Mast]:
    """Return masts at the corners and, from the fifth on, along the first street."""
    x, y = streets[1].road.half_m + 0.8, streets[0].road.half_m + 0.8
    positions = [(x, y), (-x, -y), (-x, y), (x, -y)]
    positions += [(direction * rng.uniform(32.0, 44.0), direction * (y - 0.25)) for direction in (1, -1)]
    turn = int(rng.integers(4))
    positions = [positions[(k + turn) % 4] for k in range(4)] + positions[4:]
    extra = [(60.0 + 9.0 * k, y - 0.25) for k in range(max(0, count - len(positions)))]
    return [mast(rng, *position, (rng.uniform(-6, 6), rng.uniform(-6, 6))) for position in (positions + extra)[:count]]


def _lights(rng: np.random.Generator, one: Street, other: Street) -> list[Thing]:
    """Return a traffic light at the right of both stop lines; on wide streets a second one hangs over the lanes."""
    at, reach = other.road.half_m + _CROSSWALK_M - 0.6, 4.5 if one.lanes > 1 and rng.random() < 0.6 else 0.0
    sides = [Side(one.yaw + direction * np.pi, one.road, 0.0, 0.0, 0.0, 0.0, (1.0, 1.0)) for direction in (0, 1)]
    turn = -np.pi / 2
    return [side.put(traffic_light(rng, reach), at, one.road.half_m + 0.4, turn) for side in sides]


def _one_way(
    rng: np.random.Generator,
    one: Street,
    other: Street,
    direction: int,
    seats: list[list[tuple[Thing, float]]],
    last_s: float,
) -> list[Rider]:
    """Return the traffic of all lanes in one direction of a street, and the pedestrians on the sidewalk beside it."""
    stop = None if one.free else -(other.road.half_m + _CROSSWALK_M)
    turned, riders = False, list[Rider]()
    for number, mine in enumerate(seats):
        speed = float(min(rng.uniform(5.5, 12.0), max(3.0, rng.uniform(0.9, 1.6) * 2 * _ROAM_M / last_s)))
        stream = Stream(_HALF_M, _ROAM_M, speed, (6.0, rng.uniform(18.0, 45.0)), stop, other.road.half_m + 1.0)
        drivers = filled(rng, stream, street_vehicle, mine, last_s)
        lane = one.lane(direction, number)
        if one.free and number == one.lanes - 1:
            drivers, turned = _turning(rng, drivers, lane, (one, other))
        riders += flow(lane, drivers, last_s)
    return riders + _walkers(rng, one, other, direction, turned, last_s)


def _turning(
    rng: np.random.Generator, drivers: list[Driver], lane: Lane, streets: tuple[Street, Street]
) -> tuple[list[Driver], bool]:
    """Let some drivers that are still before the junction turn right; return the drivers, and whether any turns."""
    _, other = streets
    corner = -(other.lanes - 0.5) * other.wide_m
    radius = _turn_radius(streets)
    line = right_turn(lane, corner, radius)
    out, turned = [], False
    for driver in drivers:
        can_turn = driver.start_m < corner - radius - 4.0 and driver.thing.kind in _TURN
        if can_turn and rng.random() < 0.3:
            turned = True
            speed, hold = min(driver.speed_mps, rng.uniform(3.5, 5.0)), driver.hold_m - _BEHIND_TURN_M
            out.append(replace(driver, lane=line, speed_mps=speed, hold_m=hold))
        else:
            out.append(driver)
    return out, turned


def _turn_radius(streets: tuple[Street, Street]) -> float:
    """Return the largest radius, 3 to 9 m, of a right turn that keeps a car clear of the curb's corner."""
    one, other = streets
    radii = np.arange(9.0, 2.9, -0.5)
    dx = radii + (other.lanes - 0.5) * other.wide_m - other.road.half_m
    dy = radii + (one.lanes - 0.5) * one.wide_m - one.road.half_m
    fits = radii[np.hypot(np.maximum(dx, 0), np.maximum(dy, 0)) < radii - _TURN_CLEARANCE_M]
    return float(fits[0]) if fits.size else 3.0


def _walkers(
    rng: np.random.Generator, one: Street, other: Street, direction: int, turned: bool, last_s: float
) -> list[Rider]:
    """Return pedestrians on the right sidewalk; they cross the other street if this one has right of way, else wait."""
    yaw, across = one.yaw + direction * np.pi, one.road.edge_m - 0.5
    start = -other.road.edge_m - 0.6 if turned or not one.free else 45.0
    if not one.free and rng.random() < 0.3:
        return []
    positions = sorted(rng.uniform(-60.0, start, int(rng.integers(1, 5))).tolist(), reverse=True)
    hold = float("inf") if start > 0 else start
    lane, pace = straight_lane(float(across * np.sin(yaw)), float(-across * np.cos(yaw)), yaw), rng.uniform(1.0, 1.6)
    return flow(lane, [Driver(person(rng, walking=True), at, pace, hold) for at in positions], last_s)
