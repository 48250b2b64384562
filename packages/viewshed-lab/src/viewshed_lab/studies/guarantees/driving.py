"""A closed loop: a car that only drives as fast as it can stop before whatever may step out of what it does not see.

A straight street meets another one; at the right stands a van, and from behind it someone walks into the lane, stays
there for STAYS_S, and walks on. They set out so that they and the car would meet if it passes the van at PAST_MPS.
Every .2 s the car measures a sweep, which an attacker may change, and a :class:`viewshed.pipeline.Pipeline` answers it:
the speed follows from what that leaves FREE.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from queue import SimpleQueue
from typing import Any, cast

import numpy as np

from viewshed.estimators import Estimator, load_estimator
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.visibility import TARGETS
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS
from viewshed.guarantees.certificate import certify
from viewshed.guarantees.envelope import Envelope, Given, Threat
from viewshed.monitor import StreamMonitor
from viewshed.monitor.deviation import DeviationMonitor
from viewshed.monitor.stream_monitor import StreamReport
from viewshed.pipeline import Answer, Pipeline, Vehicle
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab.sim.assets.buildings import town_house
from viewshed_lab.sim.assets.street import drive, person, place_at
from viewshed_lab.sim.assets.vehicles import sensor_car, van
from viewshed_lab.sim.lidar.weather import Conditions
from viewshed_lab.sim.observe import Setting, measure_sweep
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Agent, Thing, Track, World
from viewshed_lab.sim.worlds.outdoor_ground import Ground, Road, relief
from viewshed_lab.threats.attacks import CLEAN_SPOOFER, Attack
from viewshed_lab.threats.attacks.ghosts import FarWall, GhostWall
from viewshed_lab.threats.attacks.informed import VanishedObject
from viewshed_lab.threats.attacks.wedge_attack import PhysicalRemoval

STEP_S, LAST_S = 0.2, 24.0

CAR = Vehicle(front_m=2.7, half_width_m=1.0, delay_s=0.4, braking_mps2=6.0)

CRUISE_MPS, SPEED_UP_MPS2 = 11.0, 2.0

WALK_MPS = 1.5
"""How fast the car expects someone to step out."""

STAYS_S, PAST_MPS = 4.0, 4.0

ATTACKED_S = (1.0, 15.0)

SPEED_THREATS = ("added", "window:5", "window:20", "replaced:50", "replaced:150", "wedge:1", "wedge:10", "wedge:30")

WEATHER = Conditions(extinction_per_m=0.0034, wet=0.3, noise=1.3)
"""Heavy rain without its drops near the sensor: to this car each would be a place where someone may stand."""

PASSES, FITTED = 5, 24
"""Passes of the published network, and benign sweeps that its detector is fitted on, and calibrated on."""

ATTACKS: dict[str, Callable[[float], Attack]] = {
    "vanished": lambda azimuth: VanishedObject(azimuth=azimuth, near_m=40.0),
    "vanished, 150 beams": lambda azimuth: VanishedObject(budget=150, azimuth=azimuth, near_m=40.0),
    "far wall": lambda azimuth: FarWall(azimuth=azimuth, near_m=40.0, spoofer=CLEAN_SPOOFER),
    "removal": lambda azimuth: PhysicalRemoval(azimuth=azimuth, spoofer=CLEAN_SPOOFER),
    "ghost wall": lambda _: GhostWall(azimuth=0.0, range_m=4.0, spoofer=CLEAN_SPOOFER),
}
"""By name, aimed at an azimuth: where the one who is hidden walks, but for the ghost, which stands ahead. The attacker
wins every beam. Of whom a far wall hides, the returns below .3 m stay; who vanishes leaves none."""

CASES = ("none", "weather", *ATTACKS)

ONLY = "certified only"

MONITORS = ("no monitor", "published detector", "ours", "ours + certificate", ONLY)

CERTIFIED = {"ours + certificate": Threat("wedge", 30), ONLY: Threat("replaced", 150)}
"""Against what is certified: all attacks own a wedge of 30°, or less; who counts on certified cells alone would never
drive then, and withstands 150 beams instead."""


def speed_in_view(estimate: FovEstimate) -> float:
    """Return the highest speed in m/s, of steps of .5, at which nobody who is not seen can get in the way.

    The car drives along x of ``level``. To stop takes delay + v / braking; whoever stands in a cell that is not FREE
    may walk sideways for so long.
    """
    x_m, y_m = np.moveaxis(estimate.grid.centers, -1, 0)
    ahead = (estimate.state != CellState.FREE) & (x_m > CAR.front_m) & (x_m < 40.0) & (np.abs(y_m) < 8.0)
    x_m, aside_m = x_m[ahead] - CAR.front_m, np.abs(y_m[ahead]) - CAR.half_width_m
    speeds = np.arange(0.0, CRUISE_MPS + 0.25, 0.5)[:, None]
    stop_s = CAR.delay_s + speeds / CAR.braking_mps2
    stop_m = speeds * CAR.delay_s + speeds**2 / (2 * CAR.braking_mps2) + 0.5
    unsafe = ((x_m < stop_m) & (aside_m < WALK_MPS * stop_s)).any(axis=1)
    return float(speeds[max(int(np.append(unsafe, True).argmax()) - 1, 0), 0])


@dataclass(slots=True)
class Junction:
    """A street along x with a van at its right, and who walks out from behind it."""

    number: int  # of the run; everything random follows from it
    weather: Conditions  # what air and ground do to a measurement
    lane_m: float = -1.75  # y of the middle of the car's lane
    start_m: tuple[float, float] = (0.0, 0.0)  # (x, y) where someone waits behind the van
    walk_mps: float = 1.5  # how fast they walk
    early_s: float = 0.0  # how much earlier than to meet the car they set out
    terrain: Terrain = field(init=False)
    still: list[Thing] = field(init=False)
    car: tuple[Thing, float] = field(init=False)
    walker: Thing = field(init=False)

    def __post_init__(self) -> None:
        rng = np.random.Generator(np.random.PCG64([36, self.number]))
        road = Road(rng.uniform(6.2, 6.8), rng.uniform(2.5, 3.5), 0.12)
        self.terrain = Ground(relief(rng, 0.03), road, road, 0.0, "concrete").terrain(112.0, 112.0, 11.0)
        y_m, house_m = -road.half_m + rng.uniform(1.0, 1.2), road.edge_m + 6.5
        self.still = [place_at(van(rng), -6.0, y_m)]
        self.still += [place_at(town_house(rng, 18.0, 10.0), x * 22.0, y * house_m) for x in (-1, 1) for y in (-1, 1)]
        self.car, self.walker = sensor_car(rng, 1.84), person(rng, walking=True)
        self.start_m = rng.uniform(-2.4, -1.6), y_m - rng.uniform(0.0, 0.5)
        self.walk_mps, self.early_s = rng.uniform(1.2, 1.6), rng.uniform(-0.3, 0.3)

    def sweep(self, step: int, x_m: float, speed_mps: float, walker_y_m: float, *, walks: bool) -> Sweep:
        """Return what the car measures with its middle at x."""
        t_s = (step + 0.5) * STEP_S
        about = np.array([t_s - 0.5, t_s + 0.5])

        def along(x: float, y: float, vx: float, vy: float, yaw: float) -> Track:
            shift = np.array([[-0.5], [0.5]]) * (vx, vy)
            return Track(about, np.array([x, y]) + shift, np.full(2, yaw))

        thing, ahead_m = self.car
        car = drive(thing, along(x_m, self.lane_m, speed_mps, 0.0, 0.0))
        pace = self.walk_mps if walks else 0.0
        walker = drive(self.walker, along(self.start_m[0], walker_y_m, 0.0, pace, np.pi / 2))
        agent = Agent("ego", "hdl32e", Rigid.from_yaw(0.0, (ahead_m, 0.0, 1.84)), 0)
        world = World("crossing", self.terrain, (car, walker, *self.still), (agent,))
        setting = Setting(GRIDS["road"], self.weather)
        paths, noise = np.random.SeedSequence([36, self.number, step]).spawn(2)
        return measure_sweep(world, agent, t_s, setting, paths, noise)[1].sweep()


@dataclass(frozen=True, slots=True)
class Drive:
    """How a drive went."""

    collided: bool  # whether the car hit the one who walked out
    time_s: float  # until it had passed, LAST_S if it never did
    needless_s: float  # how long it stood though nobody was in the way
    alarm_s: float  # how long the view was not fully trusted


def drive_through(
    number: int,
    case: str,
    monitor: str,
    on_step: Callable[[float, float, tuple[float, float], FovEstimate], None] = lambda *_: None,
) -> Drive:
    """Drive through a junction in a case of ``CASES`` with one of ``MONITORS``.

    ``on_step`` is called with the time, the speed, where the one who walks is (x ahead, y left), and what the car
    believes.
    """
    place = _junction(number, case)
    answers: SimpleQueue[Answer] = SimpleQueue()
    pipeline = Pipeline(
        load_estimator(grid=GRIDS["road"], target=TARGETS["pedestrian"]), answers.put, monitor=_monitor_named(monitor),
        certify=CERTIFIED.get(monitor), certified_only=monitor == ONLY, vehicle=CAR, lossless=True,
    )  # fmt: skip
    x_m, speed_mps, walker_m, walks = -60.0, CRUISE_MPS, place.start_m[1], False
    needless_s = alarm_s = stayed_s = 0.0
    with pipeline:
        for step in range(round(LAST_S / STEP_S)):
            # 1. Whoever waits sets out such that both would be in the lane at the same time, at a speed past the van.
            to_go_m = place.start_m[0] - x_m - CAR.front_m
            in_lane_s = (place.lane_m - place.start_m[1]) / place.walk_mps
            walks = walks or to_go_m < PAST_MPS * (in_lane_s + place.early_s)
            # 2. The car looks, and an attacker changes what it sees.
            pipeline.put(_sweep(number, case, step, x_m, speed_mps, walker_m, walks))
            answer = answers.get()
            wanted_mps = 0.0 if answer.estimate is None else speed_in_view(answer.estimate)
            if answer.estimate is not None:
                walker_xy = place.start_m[0] - x_m, walker_m - place.lane_m
                on_step(step * STEP_S, speed_mps, walker_xy, answer.estimate)
            # 3. It brakes or speeds up, and both move on.
            near = walks and abs(walker_m - place.lane_m) < 4.0 and x_m < place.start_m[0]
            needless_s += STEP_S * (speed_mps < 0.3 and not near)
            alarm_s += STEP_S * (answer.reaction.caution >= 2)
            change = np.clip(wanted_mps - speed_mps, -CAR.braking_mps2 * STEP_S, SPEED_UP_MPS2 * STEP_S)
            for _ in range(4):
                speed_mps = max(speed_mps + change / 4, 0.0)
                x_m += speed_mps * STEP_S / 4
                stays = walker_m >= place.lane_m and stayed_s < STAYS_S
                stayed_s += STEP_S / 4 if stays else 0.0
                walker_m += place.walk_mps * STEP_S / 4 if walks and not stays else 0.0
                met = abs(x_m - place.start_m[0]) < 2.6 and abs(walker_m - place.lane_m) < 1.1
                if met and speed_mps > 0.5:
                    return Drive(True, LAST_S, needless_s, alarm_s)
            if x_m > place.start_m[0] + 5.0:
                return Drive(False, (step + 1) * STEP_S, needless_s, alarm_s)
    return Drive(False, LAST_S, needless_s, alarm_s)


def drives_left(number: int, case: str, done: Mapping[str, Drive]) -> Iterator[tuple[str, Drive]]:
    """Yield how each monitor drives through a junction of which that is not known.

    Below WIDEN caution takes nothing back: a drive of ours without an alarm is, step by step, that of no monitor and
    that of ours + certificate, which are not driven again then.
    """
    if len(done) == len(MONITORS):
        return
    ours = done["ours"] if "ours" in done else drive_through(number, case, "ours")
    for monitor in MONITORS:
        is_same = monitor == "ours" or (ours.alarm_s == 0.0 and monitor in ("no monitor", "ours + certificate"))
        if monitor not in done:
            yield monitor, ours if is_same else drive_through(number, case, monitor)


@lru_cache(maxsize=1)
def _junction(number: int, case: str) -> Junction:
    return Junction(number, WEATHER if case == "weather" else Conditions())


@lru_cache(maxsize=round(LAST_S / STEP_S))
def _sweep(number: int, case: str, step: int, x_m: float, speed_mps: float, walker_m: float, walks: bool) -> Sweep:
    """Return what the car measures in a step, attacked or not; kept for the other monitors, which begin alike."""
    place = _junction(number, case)
    sweep = place.sweep(step, x_m, speed_mps, walker_m, walks=walks)
    if case not in ATTACKS or not ATTACKED_S[0] <= step * STEP_S < ATTACKED_S[1]:
        return sweep
    azimuth = float(np.arctan2(walker_m - place.lane_m, place.start_m[0] - x_m))
    return ATTACKS[case](azimuth).apply(sweep, np.random.Generator(np.random.PCG64([number, step]))).sweep


def certified_speeds(number: int) -> dict[str, float]:
    """Return the speed in m/s 20 m before a junction without attack: by the claim, and by what of it is certified."""
    place = Junction(number, Conditions())
    leveled = level(place.sweep(0, -20.0, CRUISE_MPS, place.start_m[1], walks=False), GRIDS["road"])
    estimate = load_estimator(grid=GRIDS["road"], target=TARGETS["pedestrian"]).estimate(leveled)
    certified = {one: certify(leveled, estimate, Threat.parse(one)).withdraw(estimate) for one in SPEED_THREATS}
    return {"the whole claim": speed_in_view(estimate)} | {one: speed_in_view(kept) for one, kept in certified.items()}


def filled_share(number: int) -> float:
    """Return the share of the beams sent through a pedestrian's box that who walks at a junction returns."""
    place, ahead_m = Junction(number, Conditions()), 10.0  # from the car's middle, in its lane
    leveled = level(place.sweep(0, place.start_m[0] - ahead_m, 0.0, place.lane_m, walks=True), GRIDS["road"])
    envelope = Envelope.of(leveled, Given.of(leveled), GRIDS["road"], TARGETS["pedestrian"])
    body = leveled.points[(leveled.points[:, 2] > 0.1) & (np.abs(leveled.points[:, 1]) < 0.8)]
    body = body[np.abs(body[:, 0] - ahead_m) < 1.5]
    apart_m = np.hypot(*np.moveaxis(envelope.grid.centers - np.median(body[:, :2], axis=0), -1, 0))
    return float(len(body) / envelope.margins[apart_m < envelope.grid.cell_m].mean())


class PublishedDetector:
    """The published detector by the deviation of dropout, as what watches a stream."""

    def __init__(self, fitted: DeviationMonitor, estimator: Estimator) -> None:
        self._fitted, self._estimator = fitted, estimator

    def fresh(self) -> PublishedDetector:
        """Return itself: it remembers nothing."""
        return self

    def check(self, leveled: LeveledSweep) -> StreamReport:
        """Return what it says of a sweep."""
        report = self._fitted.check(self._estimator.estimate(leveled))
        return StreamReport(report, report.inconsistent, suspect=report.suspect)


def _monitor_named(name: str) -> StreamMonitor | None:
    if name in ("no monitor", ONLY):
        return None
    return cast(StreamMonitor, _published()) if name == "published detector" else StreamMonitor()


@lru_cache(maxsize=1)
def _published() -> PublishedDetector:
    """Return the published detector, fitted and calibrated (5 % of sweeps) on benign sweeps of other junctions."""
    estimator = load_estimator("mc_dropout", grid=GRIDS["road"], passes=PASSES, seed=36, weights="road_int8")

    def benign(first: int) -> Any:
        for number in range(first, first + FITTED):
            place = Junction(number, Conditions())
            x_m = -60.0 + 60.0 * (number % 12) / 12
            sweep = place.sweep(0, x_m, CRUISE_MPS, place.start_m[1], walks=False)
            yield estimator.estimate(level(sweep, GRIDS["road"]))

    fitted = DeviationMonitor.fit(benign(100_000)).calibrated(benign(200_000), 0.05)
    return PublishedDetector(fitted, estimator)
