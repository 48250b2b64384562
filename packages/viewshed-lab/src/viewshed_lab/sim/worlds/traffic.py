"""Traffic: lanes, vehicles that follow one another along them without collisions, and their tracks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from viewshed.arrays import F64
from viewshed_lab.sim.assets.street import drive, extent, place_at
from viewshed_lab.sim.world import AgentPlan, Thing, Track
from viewshed_lab.sim.worlds.layout import carriers

_STEP_S = 0.5
_SMOOTH_STEPS = 2
_LEAD_S = 3.0
_FAR_M = 1500.0
_QUEUE_GAP_M = 2.0
_DELAY_STEPS = 2
_REACTION_S = _DELAY_STEPS * _STEP_S


@dataclass(frozen=True, slots=True, eq=False)
class Lane:
    """A line that vehicles follow."""

    xy_m: F64  # (k, 2) corners in meters of the world
    arc_m: F64  # (k,) where they lie along the line
    yaw: F64  # (k,) heading at the corners, continuous, radians

    def at(self, s_m: F64) -> tuple[F64, F64]:
        """Return positions (n, 2) and headings (n,) at ``s_m`` (n,) meters along the line."""
        x, y = np.interp(s_m, self.arc_m, self.xy_m[:, 0]), np.interp(s_m, self.arc_m, self.xy_m[:, 1])
        return np.column_stack([x, y]), np.interp(s_m, self.arc_m, self.yaw)


def straight_lane(x_m: float, y_m: float, yaw: float) -> Lane:
    """Return the straight lane through (x, y), where its meter 0 is.

    >>> straight_lane(0.0, -2.0, 0.0).at(np.array([5.0]))[0].tolist()
    [[5.0, -2.0]]
    """
    ends = np.array([-_FAR_M, _FAR_M])
    xy = np.array([x_m, y_m]) + ends[:, None] * np.array([np.cos(yaw), np.sin(yaw)])
    return Lane(xy, ends, np.full(2, yaw))


def line_lane(xy_m: F64) -> Lane:
    """Return the lane through points (k, 2), its meter 0 where it starts."""
    steps = np.diff(xy_m, axis=0)
    arc = np.concatenate([[0.0], np.hypot(steps[:, 0], steps[:, 1]).cumsum()])
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    yaw = np.concatenate([headings[:1], (headings[1:] + headings[:-1]) / 2, headings[-1:]])
    return Lane(xy_m, arc, yaw)


def right_turn(lane: Lane, corner_m: float, radius_m: float) -> Lane:
    """Return the lane that follows a straight one and turns right by a quarter circle.

    ``corner_m``: where along ``lane`` the line of the new lane crosses. Meter 0 stays where it is.
    """
    (start,), (yaw,) = lane.at(np.array([corner_m - radius_m]))
    forward, right = np.array([np.cos(yaw), np.sin(yaw)]), np.array([np.sin(yaw), -np.cos(yaw)])
    angles = np.linspace(0.0, np.pi / 2, 13)[:, None]
    bend = start + radius_m * (np.sin(angles) * forward + (1 - np.cos(angles)) * right)
    xy = np.concatenate([(start - _FAR_M * forward)[None], bend, (bend[-1] + _FAR_M * right)[None]])
    arc = corner_m - radius_m + np.concatenate([[-_FAR_M], angles[:, 0] * radius_m, [np.pi / 2 * radius_m + _FAR_M]])
    turns = yaw - np.concatenate([[0.0], angles[:, 0], [np.pi / 2]])
    return Lane(xy, arc, turns)


@dataclass(frozen=True, slots=True)
class Driver:
    """A vehicle in a lane."""

    thing: Thing  # the vehicle, at the origin
    start_m: float  # position of its center along the lane at time 0
    speed_mps: float  # free speed
    hold_m: float = float("inf")  # position at which it stops for good; infinite if it leaves
    lane: Lane | None = None  # its own lane if it turns off
    sensor_ahead_m: float | None = None  # offset of its sensor ahead of its center, or None if it is no agent


def clock(duration_s: float) -> F64:
    """Return the seconds (k,) of the knots of tracks: from 1 s before 0 to 1 s after ``duration_s``."""
    return np.arange(-1.0, duration_s + 1.0 + _STEP_S, _STEP_S)


Rider = tuple[Thing, float | None]
"""A moving thing, and for an agent the offset of its sensor ahead of the thing's center."""


def flow(lane: Lane, drivers: Sequence[Driver], duration_s: float) -> list[Rider]:
    """Return the vehicles of one lane with their tracks, in the order of ``drivers`` (leader first).

    Newell's car-following (Transportation Research B 36, 2002): each vehicle drives at its free speed, or repeats the
    path of its leader with a delay and a distance, whichever is less far.
    """
    track_s = clock(duration_s)
    times = np.arange(track_s[0] - _LEAD_S, track_s[-1] + _LEAD_S + _STEP_S / 2, _STEP_S)
    keep = slice(round(_LEAD_S / _STEP_S), round(_LEAD_S / _STEP_S) + len(track_s))
    ahead, rear_m = np.full(len(times), np.inf), 0.0
    riders: list[Rider] = []
    for driver in drivers:
        rear, front, *_ = extent(driver.thing)
        gap = _QUEUE_GAP_M + front + rear_m
        free = np.minimum(driver.start_m + driver.speed_mps * times, driver.hold_m)
        delayed = np.concatenate([np.full(_DELAY_STEPS, ahead[0]), ahead[:-_DELAY_STEPS]])
        path = np.minimum(free, delayed - gap)
        track = Track(track_s, *(driver.lane or lane).at(_smooth(path)[keep]))
        stands = float(np.ptp(track.xy_m, axis=0).max()) < 0.02
        thing = place_at(driver.thing, *track.at(0.0)) if stands else drive(driver.thing, track)
        riders.append((thing, driver.sensor_ahead_m))
        ahead, rear_m = path, -rear
    return riders


@dataclass(frozen=True, slots=True)
class Stream:
    """Parameters of the vehicles of a lane."""

    reach_m: float  # vehicles are placed within ± this position along the lane
    roam_m: float  # agents stay within ± this
    speed_mps: float  # of all vehicles
    gap_m: tuple[float, float]  # smallest and largest gap between two vehicles
    stop_m: float | None = None  # stop line at which vehicles before it wait for good, or None
    clear_m: float = 0.0  # no vehicle is placed between the stop line and this
    upstream_m: float = 60.0  # distance before the reach in which later vehicles are placed


Maker = Callable[[np.random.Generator], Thing]


def filled(
    rng: np.random.Generator, stream: Stream, maker: Maker, carriers: Sequence[tuple[Thing, float]], duration_s: float
) -> list[Driver]:
    """Return the drivers of a lane, leader first: agents around its middle, others from ``maker`` ahead and behind.

    ``carriers``: vehicle of each agent, and the offset of its sensor ahead of the vehicle's center.
    """
    travel = stream.speed_mps * duration_s
    entry = -stream.reach_m - min(travel, stream.upstream_m)
    if not carriers:
        return _others(rng, stream, maker, (entry, stream.reach_m))
    end = stream.roam_m if stream.stop_m is None else min(stream.roam_m, stream.stop_m - 3.0)
    room = end + stream.roam_m
    min_gap_m = 8.0 + _REACTION_S * stream.speed_mps
    steps = [min(min_gap_m + rng.uniform(0.0, 16.0), room / len(carriers)) for _ in carriers[1:]]
    lead = rng.uniform(-stream.roam_m + sum(steps), max(end - travel, -stream.roam_m + sum(steps)))
    positions = lead - np.concatenate([[0.0], np.cumsum(steps)])
    agents = [Driver(thing, float(at), stream.speed_mps, end, None, ahead)
              for (thing, ahead), at in zip(carriers, positions, strict=True)]  # fmt: skip
    ahead_of_agents = _others(rng, stream, maker, (lead + min_gap_m, stream.reach_m))
    return [*ahead_of_agents, *agents, *_others(rng, stream, maker, (entry, float(positions[-1]) - min_gap_m))]


@dataclass(frozen=True, slots=True)
class Pace:
    """Traffic parameters of the lanes of a road."""

    reach_m: float  # vehicles are placed within ± this position along each lane
    roam_m: float  # agents stay within ± this
    speed_mps: tuple[float, float]  # slowest and fastest speed
    gap_m: tuple[float, float, float]  # smallest gap between two vehicles, and bounds of the largest gap
    share: tuple[float, float] = (0.8, 1.5)  # bounds of the share of 2 · ``roam_m`` that agents drive in the duration


def driven(rng: np.random.Generator, plan: AgentPlan, lanes: Sequence[Lane], pace: Pace, maker: Maker) -> list[Rider]:
    """Return the traffic of lanes: the plan's agents, distributed over the lanes, and others from ``maker``.

    Speeds are limited so that agents drive most of the time within their part of the road.
    """
    riders: list[Rider] = []
    for lane, seats in zip(lanes, carriers(rng, plan, len(lanes)), strict=True):
        free_speed = rng.uniform(*pace.speed_mps)
        speed = float(min(free_speed, max(2.0, rng.uniform(*pace.share) * 2 * pace.roam_m / plan.duration_s)))
        min_gap, low, high = pace.gap_m
        stream = Stream(pace.reach_m, pace.roam_m, speed, (min_gap, rng.uniform(low, high)))
        riders += flow(lane, filled(rng, stream, maker, seats, plan.duration_s), plan.duration_s)
    return riders


def _others(rng: np.random.Generator, stream: Stream, maker: Maker, span_m: tuple[float, float]) -> list[Driver]:
    at, drivers = span_m[1] - rng.uniform(0.0, stream.gap_m[1]), []
    while at > span_m[0]:
        thing = maker(rng)
        rear, front, *_ = extent(thing)
        at -= front
        if stream.stop_m is not None and stream.stop_m - front < at < stream.clear_m - rear:
            at = stream.stop_m - front
        if at + rear < span_m[0]:
            break
        waits = stream.stop_m is not None and at < stream.stop_m
        hold = stream.stop_m - front if waits and stream.stop_m is not None else float("inf")
        drivers.append(Driver(thing, at, stream.speed_mps, hold))
        at += rear - max(rng.uniform(*stream.gap_m), _QUEUE_GAP_M + _REACTION_S * stream.speed_mps)
    return drivers


def _smooth(path: F64) -> F64:
    """Return the moving average of a path over two seconds, so that vehicles stop smoothly."""
    padded = np.pad(path, _SMOOTH_STEPS, mode="reflect", reflect_type="odd")
    width = 2 * _SMOOTH_STEPS + 1
    total = np.cumsum(np.concatenate([[0.0], padded]))
    return np.asarray((total[width:] - total[:-width]) / width)
