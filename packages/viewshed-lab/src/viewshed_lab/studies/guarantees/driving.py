"""Closed-loop driving: a car that drives only as fast as it can stop for anyone who steps out of unseen cells.

At a junction a van stands on the right; from behind it a pedestrian walks into the lane, stays there for STAYS_S, and
walks on. The start is timed so that pedestrian and car meet if the car passes the van at PAST_MPS. Every .2 s the car
measures a sweep, which an attacker may change, and a :class:`viewshed.pipeline.Pipeline` processes it: the speed
follows from the cells that are FREE.
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
"""Walking speed of pedestrians that the car assumes."""

STAYS_S, PAST_MPS = 4.0, 4.0

ATTACKED_S = (1.0, 15.0)

SPEED_THREATS = ("added", "window:5", "window:20", "replaced:50", "replaced:150", "wedge:1", "wedge:10", "wedge:30")

WEATHER = Conditions(extinction_per_m=0.0034, wet=0.3, noise=1.3)
"""Heavy rain without drops near the sensor: to this car each drop would be a cell where someone may stand."""

PASSES, FITTED = 5, 24
"""Passes of the published network; number of benign sweeps for fitting its detector, and for calibrating it."""

ATTACKS: dict[str, Callable[[float], Attack]] = {
    "vanished": lambda azimuth: VanishedObject(azimuth=azimuth, near_m=40.0),
    "vanished, 150 beams": lambda azimuth: VanishedObject(budget=150, azimuth=azimuth, near_m=40.0),
    "far wall": lambda azimuth: FarWall(azimuth=azimuth, near_m=40.0, spoofer=CLEAN_SPOOFER),
    "removal": lambda azimuth: PhysicalRemoval(azimuth=azimuth, spoofer=CLEAN_SPOOFER),
    "ghost wall": lambda _: GhostWall(azimuth=0.0, range_m=4.0, spoofer=CLEAN_SPOOFER),
}
"""By name, attacks aimed at the azimuth of the hidden pedestrian; the ghost wall stands ahead instead. The attacker
wins every beam. A far wall keeps the pedestrian's returns below .3 m; a vanished pedestrian has none."""

CASES = ("none", "weather", *ATTACKS)

ONLY = "certified only"

MONITORS = ("no monitor", "published detector", "ours", "ours + certificate", ONLY)

CERTIFIED = {"ours + certificate": Threat("wedge", 30), ONLY: Threat("replaced", 150)}
"""Certified threats: all attacks are within a wedge of 30°. A car that uses certified cells alone would never drive
then; it certifies against 150 replaced beams instead."""


def speed_in_view(estimate: FovEstimate) -> float:
    """Return the highest speed in m/s, in steps of .5, at which no unseen pedestrian can get in the way.

    The car drives along x of ``level`` and stops in delay + v / braking; a pedestrian in any cell that is not FREE may
    walk sideways during that time.
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
    """A street along x with a van on its right, and a pedestrian who walks out from behind it."""

    number: int  # of the run; seeds all random draws
    weather: Conditions
    lane_m: float = -1.75  # y of the center of the car's lane
    start_m: tuple[float, float] = (0.0, 0.0)  # (x, y) where the pedestrian waits behind the van
    walk_mps: float = 1.5  # walking speed
    early_s: float = 0.0  # how much earlier the pedestrian starts than to meet the car
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
        """Return the sweep that the car measures with its center at ``x_m``."""
        t_s = (step + 0.5) * STEP_S
        times_s = np.array([t_s - 0.5, t_s + 0.5])

        def along(x: float, y: float, vx: float, vy: float, yaw: float) -> Track:
            shift = np.array([[-0.5], [0.5]]) * (vx, vy)
            return Track(times_s, np.array([x, y]) + shift, np.full(2, yaw))

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
    """Result of a drive."""

    collided: bool  # whether the car hit the pedestrian
    time_s: float  # time until it passed, LAST_S if it never did
    needless_s: float  # time that it stood with nobody in the way
    alarm_s: float  # time that the view was not fully trusted


def drive_through(
    number: int,
    case: str,
    monitor: str,
    on_step: Callable[[float, float, tuple[float, float], FovEstimate], None] = lambda *_: None,
) -> Drive:
    """Drive through a junction in a case of ``CASES`` with one of ``MONITORS``.

    ``on_step`` is called with the time, the speed, the place of the pedestrian (x ahead, y left), and the estimate.
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
            # 1. The pedestrian starts so that both would meet in the lane if the car passed the van at PAST_MPS.
            to_go_m = place.start_m[0] - x_m - CAR.front_m
            in_lane_s = (place.lane_m - place.start_m[1]) / place.walk_mps
            walks = walks or to_go_m < PAST_MPS * (in_lane_s + place.early_s)
            # 2. The car measures a sweep, which an attacker may change.
            pipeline.put(_sweep(number, case, step, x_m, speed_mps, walker_m, walks))
            answer = answers.get()
            target_mps = 0.0 if answer.estimate is None else speed_in_view(answer.estimate)
            if answer.estimate is not None:
                walker_xy = place.start_m[0] - x_m, walker_m - place.lane_m
                on_step(step * STEP_S, speed_mps, walker_xy, answer.estimate)
            # 3. It brakes or accelerates, and both move.
            near = walks and abs(walker_m - place.lane_m) < 4.0 and x_m < place.start_m[0]
            needless_s += STEP_S * (speed_mps < 0.3 and not near)
            alarm_s += STEP_S * (answer.reaction.caution >= 2)
            change = np.clip(target_mps - speed_mps, -CAR.braking_mps2 * STEP_S, SPEED_UP_MPS2 * STEP_S)
            for _ in range(4):
                speed_mps = max(speed_mps + change / 4, 0.0)
                x_m += speed_mps * STEP_S / 4
                stays = walker_m >= place.lane_m and stayed_s < STAYS_S
                stayed_s += STEP_S / 4 if stays else 0.0
                walker_m += place.walk_mps * STEP_S / 4 if walks and not stays else 0.0
                touches = abs(x_m - place.start_m[0]) < 2.6 and abs(walker_m - place.lane_m) < 1.1
                if touches and speed_mps > 0.5:
                    return Drive(True, LAST_S, needless_s, alarm_s)
            if x_m > place.start_m[0] + 5.0:
                return Drive(False, (step + 1) * STEP_S, needless_s, alarm_s)
    return Drive(False, LAST_S, needless_s, alarm_s)


def drives_left(number: int, case: str, done: Mapping[str, Drive]) -> Iterator[tuple[str, Drive]]:
    """Yield the missing drives of each monitor through a junction.

    Below WIDEN, caution withdraws nothing: if ours drives without an alarm, no monitor and ours + certificate drive
    identically, and are not simulated again.
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
    """Return the sweep of a step, attacked or not; cached for the other monitors, whose drives begin alike."""
    place = _junction(number, case)
    sweep = place.sweep(step, x_m, speed_mps, walker_m, walks=walks)
    if case not in ATTACKS or not ATTACKED_S[0] <= step * STEP_S < ATTACKED_S[1]:
        return sweep
    azimuth = float(np.arctan2(walker_m - place.lane_m, place.start_m[0] - x_m))
    return ATTACKS[case](azimuth).apply(sweep, np.random.Generator(np.random.PCG64([number, step]))).sweep


def certified_speeds(number: int) -> dict[str, float]:
    """Return speeds in m/s 20 m before a junction without attack: by the whole claim, and by its certified parts."""
    place = Junction(number, Conditions())
    leveled = level(place.sweep(0, -20.0, CRUISE_MPS, place.start_m[1], walks=False), GRIDS["road"])
    estimate = load_estimator(grid=GRIDS["road"], target=TARGETS["pedestrian"]).estimate(leveled)
    certified = {one: certify(leveled, estimate, Threat.parse(one)).withdraw(estimate) for one in SPEED_THREATS}
    return {"the whole claim": speed_in_view(estimate)} | {one: speed_in_view(kept) for one, kept in certified.items()}


def filled_share(number: int) -> float:
    """Return the share of the beams through a pedestrian's box that a pedestrian at a junction returns."""
    place, ahead_m = Junction(number, Conditions()), 10.0  # from the car's middle, in its lane
    leveled = level(place.sweep(0, place.start_m[0] - ahead_m, 0.0, place.lane_m, walks=True), GRIDS["road"])
    envelope = Envelope.of(leveled, Given.of(leveled), GRIDS["road"], TARGETS["pedestrian"])
    body = leveled.points[(leveled.points[:, 2] > 0.1) & (np.abs(leveled.points[:, 1]) < 0.8)]
    body = body[np.abs(body[:, 0] - ahead_m) < 1.5]
    apart_m = np.hypot(*np.moveaxis(envelope.grid.centers - np.median(body[:, :2], axis=0), -1, 0))
    return float(len(body) / envelope.margins[apart_m < envelope.grid.cell_m].mean())


class PublishedDetector:
    """The published detector (deviation of dropout) with the interface of a stream monitor."""

    def __init__(self, fitted: DeviationMonitor, estimator: Estimator) -> None:
        self._fitted, self._estimator = fitted, estimator

    def fresh(self) -> PublishedDetector:
        """Return itself: it has no state."""
        return self

    def check(self, leveled: LeveledSweep) -> StreamReport:
        """Return the report on a sweep."""
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
