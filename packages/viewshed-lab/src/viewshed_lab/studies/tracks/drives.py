"""Drives with exact truth: what stands where, what a detector says of it, and what each field of view lets be seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from viewshed import _core
from viewshed.arrays import F64
from viewshed.detections import Detections, ObjectKind, moved_boxes
from viewshed.estimators import DEFAULT_ESTIMATOR, load_estimator
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.visibility import CAR, Beams, probability_of_visible
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.monitor import IntegrityReport, StreamMonitor
from viewshed.objects.cells import SeenCells
from viewshed.objects.detection_table import detection_table
from viewshed.objects.detector import Detector
from viewshed.objects.metrics import match_objects
from viewshed.objects.sensor_view import SensorView
from viewshed.objects.tracker import MOTION, ExistenceRules
from viewshed.objects.views import BeamView, DetectionProb, GridView, PolygonView, SeesAll, View, hidden_within
from viewshed.preprocess.evidence import expected_returns
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab.data.drive import OBJECT_KINDS, box_of, object_at
from viewshed_lab.data.simulated import ScenePlan, scan_frame, world_of
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.sim.world import Agent, World
from viewshed_lab.studies.tracks.lidar_level import SweepForger

FOVS = ("none", "published", "polygon", "default_hard", "default", "exact")
"""No field of view; the published tracker with its polygon; that polygon used by ours; the default method's as a mask;
its probability; the exact one."""

POLYGON = "paper_concave_hull"
"""The estimator that is the published polygon."""

DETECTORS = ("simulated", "perception")
"""A detector by tables, at the object level; or that of ``viewshed.objects``, on the returns of each sweep."""

HZ = 10.0

GRID = BevGrid(512, 64.0)
"""As far as the grid for roads, with cells of 0.25 m: a car is more than a handful of them."""

KINDS = {
    "car": ObjectKind.CAR, "van": ObjectKind.CAR, "truck": ObjectKind.TRUCK, "bus": ObjectKind.TRUCK,
    "trailer": ObjectKind.TRUCK, "tractor": ObjectKind.TRUCK, "pedestrian": ObjectKind.PEDESTRIAN,
    "cyclist": ObjectKind.CYCLIST, "motorcycle": ObjectKind.CYCLIST,
}  # fmt: skip
"""Of the things of a simulated world; all others are ``OTHER``."""


@dataclass(frozen=True, slots=True, eq=False)
class ObjectsTruth:
    """What stands in the world at the time of a sweep."""

    numbers: NDArray[np.int32]  # (N,) int32, the same for one object over time
    boxes: F64  # (N, 7) in the world
    kinds: NDArray[np.uint8]  # (N,) uint8 of ``ObjectKind``
    returns: NDArray[np.int32]  # (N,) int32 that each gave


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One sweep of a drive."""

    t_s: float  # its time
    ground: F64  # (3,) place on the ground below the sensor, in the world
    truth: ObjectsTruth  # all objects but the vehicle that carries the sensor
    detections: Detections  # honest ones, in the world
    of_object: NDArray[np.int32]  # (K,) int32 number of the object that each is of, -1 for false ones
    visible: F64  # (N,) probability that the default field of view gives for each object of the truth
    views: dict[str, SensorView]  # by name of ``FOVS``
    false_odds: F64  # (K,) how many false detections there are like each for one of an object
    ghost: NDArray[np.bool_]  # (K,) bool, detections of an object that an attack on the LiDAR made
    gone: frozenset[int] = frozenset()  # numbers of the objects that an attack on the LiDAR took from the sweep
    report: IntegrityReport | None = None  # of the monitor of the sensor, where one watches


SEEN_FROM = 5
"""Expected returns from which an object can be seen."""

_FOUND = ((0, 0.0), (2, 0.1), (5, 0.6), (10, 0.85), (20, 0.95), (60, 0.98))
"""Returns of an object, and the probability that the simulated detector finds it; straight lines between."""

_STEADY_S = 1.0
"""How long the luck of the detector with one object lasts."""

_CENTER_STD_M, _YAW_STD_DEG, _SIZE_STD = 0.15, 3.0, 0.05
"""Errors of its boxes: each axis of the center, the heading, and the share of each side."""

_FALSE_PER_SWEEP, _FALSE_S = 0.3, 0.5
"""False detections at obstacle surfaces that are no object: how many at a time, and how long one lasts."""


def found_probability(returns: NDArray[Any]) -> F64:
    """Return the probability (N,) that the simulated detector finds objects by their number of returns (N,)."""
    counts, shares = np.array(_FOUND).T
    return np.asarray(np.interp(np.asarray(returns, np.float64), counts, shares))


class ExactView:
    """A view by exact beams: how many would meet a box without its own returns."""

    def __init__(self, t_s: float, scan: ExactScan, world_from_level: Rigid, found: DetectionProb) -> None:
        """Make the view of a scan without noise; ``found`` says what the detector finds."""
        self.t_s, self.in_world, self._found = t_s, True, found
        self._level_from_world = world_from_level.inverse()
        self._height_m = float(scan.world_from_sensor.translation[2] - world_from_level.translation[2])
        direction = scan.direction.reshape(-1, 3) @ world_from_level.rotation
        flat = np.hypot(direction[:, 0], direction[:, 1])
        azimuth = np.arctan2(direction[:, 1], direction[:, 0])
        depth_m = (scan.depth_m.reshape(-1) * flat).astype(np.float32)
        beams = Beams(azimuth.astype(np.float32), (direction[:, 2] / flat).astype(np.float32), depth_m)
        self._beams = _core.BeamsByAzimuth(*beams.arrays)

    def visible(self, boxes: F64) -> F64:
        """Return 1 (K,) where enough beams meet a box, else 0."""
        return (self._counts(boxes) >= SEEN_FROM).astype(np.float64)

    def detectable(self, boxes: F64, kinds: NDArray[np.uint8]) -> F64:
        """Return the probability (K,) that the detector finds an object in each box where it can be seen."""
        level = moved_boxes(boxes, self._level_from_world)
        counts = np.maximum(self._counts(boxes), SEEN_FROM).astype(np.float64)
        return self._found(counts, np.hypot(level[:, 0], level[:, 1]), kinds)

    def false_odds(self, boxes: F64, kinds: NDArray[np.uint8]) -> None:
        """Return None: trackers are given those of the detector."""

    def hides_near(self, boxes: F64, within_m: F64) -> F64:
        """Return 1 (K,) where a box could be somewhere unseen within (K,) meters, else 0."""
        return hidden_within(self, boxes, within_m)

    def _counts(self, boxes: F64) -> NDArray[np.int32]:
        level = moved_boxes(boxes, self._level_from_world)
        return self._beams.expected_returns(np.ascontiguousarray(level, np.float32), self._height_m, True)


@dataclass(slots=True, eq=False)
class SimulatedDetector:
    """A detector by tables: finds objects by their returns, errs a little, and now and then finds one that is none.

    Its luck with an object lasts about a second, as that of detectors does.
    """

    rng: np.random.Generator  # draws all that is random
    _luck: dict[int, float] = field(default_factory=dict, repr=False)
    _false: list[tuple[float, F64]] = field(default_factory=list, repr=False)
    _last_s: float = field(default=0.0, repr=False)

    def detect(self, truth: ObjectsTruth, surface: F64, t_s: float) -> tuple[Detections, NDArray[np.int32]]:
        """Return the detections of a sweep and the number (K,) of the object of each, -1 for false ones.

        Args:
            truth: what stands there.
            surface: (S, 3) places of obstacle surfaces, where false detections are.
            t_s: time of the sweep.
        """
        rng, kept = self.rng, float(np.exp(-(t_s - self._last_s) / _STEADY_S))
        self._last_s = t_s
        for number in truth.numbers.tolist():
            before = self._luck.get(number)
            drawn = rng.normal()
            self._luck[number] = drawn if before is None else kept * before + np.sqrt(1 - kept**2) * drawn
        luck = np.array([self._luck[number] for number in truth.numbers.tolist()])
        found = ndtr(luck) < found_probability(truth.returns)
        boxes = truth.boxes[found].copy()
        boxes[:, :2] += rng.normal(0.0, _CENTER_STD_M, (len(boxes), 2))
        boxes[:, 3:6] *= np.exp(rng.normal(0.0, _SIZE_STD, (len(boxes), 3)))
        boxes[:, 6] += np.deg2rad(rng.normal(0.0, _YAW_STD_DEG, len(boxes)))
        self._false = [one for one in self._false if one[0] > t_s]
        if len(surface):
            for _ in range(rng.poisson(_FALSE_PER_SWEEP / _FALSE_S / HZ)):
                place = surface[rng.integers(len(surface))]
                row = np.array([*place, 4.2, 1.8, 1.5, rng.uniform(-np.pi, np.pi)])
                self._false.append((t_s + rng.exponential(_FALSE_S), row))
        false = np.array([row for _, row in self._false]).reshape(-1, 7)
        count = len(false)
        detections = Detections(
            np.concatenate([boxes, false]),
            np.concatenate([truth.kinds[found], np.full(count, ObjectKind.CAR, np.uint8)]),
            np.concatenate([truth.returns[found], np.full(count, SEEN_FROM, np.int32)]),
        )
        return detections, np.concatenate([truth.numbers[found], np.full(count, -1, np.int32)])


RULES = {
    "simulated": ExistenceRules(
        motion=replace(MOTION, center_std_m=2 * _CENTER_STD_M, outlier_share=0.0), false_odds=0.03, lasting_share=0.3,
        doubt_s=0.5, surest=0.998,
    ),
    "perception": ExistenceRules(),
}  # fmt: skip
"""What the tracker knows of each detector: its errors, how often it errs, and how long its luck lasts."""


def simulate_drive(
    plan: ScenePlan,
    fovs: tuple[str, ...] = FOVS,
    detector: str = "simulated",
    sensor: str = "top",
    forger: SweepForger | None = None,
) -> Iterator[Moment]:
    """Yield the sweeps of a drive of one vehicle with truth, detections and fields of view.

    Args:
        plan: of its scene.
        fovs: of ``FOVS``.
        detector: one of ``DETECTORS``.
        sensor: name of the sensor in its views.
        forger: forges the sweeps before anything is computed from them; the truth stays, and the shipped monitor
            watches.
    """
    grid, by_tables = GRID, detector == "simulated"
    found = _found if by_tables else detection_table().prob
    world, agent = world_of(plan), world_of(plan).agents[0]
    estimator, polygon = load_estimator(DEFAULT_ESTIMATOR, grid=grid), load_estimator(POLYGON, grid=grid)
    simulated, perception = SimulatedDetector(np.random.Generator(np.random.PCG64(plan.seed(99)))), Detector()
    monitor = None if forger is None else StreamMonitor()
    movable = [
        k for k, thing in enumerate(world.things)
        if k != agent.carrier and (thing.kind in OBJECT_KINDS or thing.track is not None)
    ]  # fmt: skip
    about = {k: box_of(world.things[k]) for k in movable}
    kinds = np.array([KINDS.get(world.things[k].kind, ObjectKind.OTHER) for k in movable], np.uint8)
    for frame in range(plan.frames):
        # 1. What stands there, and what each object returned.
        t_s = (frame + 0.5) * plan.preset.interval_s
        scan, stored = scan_frame(plan, frame)
        of_return = scan.thing.reshape(-1)[stored.steps.reshape(-1) > 0]
        boxes = [_row(object_at(world, k, t_s, *about[k]).world_from_box, about[k][1]) for k in movable]
        returns = _counts_of(of_return, len(world.things))[movable]
        truth = ObjectsTruth(
            np.array(movable, np.int32), np.array(boxes, np.float64).reshape(-1, 7), kinds, returns.astype(np.int32)
        )
        clean = stored.sweep()
        sweep, gone, ghost_at = clean, frozenset[int](), None
        leveled = level(clean, grid)
        world_from_level = leveled.world_from_level
        if world_from_level is None:
            raise ValueError("a drive must have poses, got a sweep without one")
        aimed = expected_returns(leveled, moved_boxes(truth.boxes, world_from_level.inverse()))
        visible = probability_of_visible(aimed.astype(np.float32), SEEN_FROM).astype(np.float64)
        # 2. The sweep that everything else is computed from.
        if forger is not None:
            tampered = forger.apply(clean, t_s, truth.numbers, truth.boxes, truth.returns)
            sweep, ghost_at = tampered.sweep, forger.ghost_at(clean)
            left = _counts_of(of_return[~tampered.removed], len(world.things))[movable]
            gone = frozenset(truth.numbers[(returns >= SEEN_FROM) & (left <= _GONE_SHARE * returns)].tolist())
            leveled = level(sweep, grid)
        # 3. Fields of view, and detections.
        estimate = estimator.estimate(leveled)
        hull = polygon.estimate(leveled) if {"polygon", "published"} & set(fovs) else None
        pose = leveled.world_from_level or world_from_level
        place, yaw = pose.translation[:2], pose.yaw
        views: dict[str, SensorView] = {}
        for fov in fovs:
            if fov == "exact":
                cells, view = _exact_view(scan, sweep, world, agent, grid, found)
            else:
                cells = SeenCells.of(estimate) if fov in ("default", "default_hard") else None
                view = _view_of(fov, t_s, leveled, estimate, hull, found)
            views[fov] = SensorView(sensor, view, place, cells, yaw=yaw)
        surface = grid.centers[estimate.state == CellState.SURFACE]
        surface_xyz = pose @ np.column_stack([surface, np.full(len(surface), 0.75)])
        if by_tables:
            detections, of_object = simulated.detect(truth, surface_xyz, t_s)
            odds = np.full(len(detections), RULES[detector].false_odds)
        else:
            here = perception.detect(leveled)
            detections = here.moved(pose)
            of_object = _objects_of(detections, truth)
            odds = detection_table().false_odds(np.hypot(here.boxes[:, 0], here.boxes[:, 1]), here.kinds)
        ghost = np.zeros(len(detections), np.bool_)
        if ghost_at is not None:
            ghost = (np.hypot(*(detections.boxes[:, :2] - ghost_at).T) < _GHOST_WITHIN_M) & (of_object < 0)
        report = None if monitor is None else monitor.check(leveled).now
        yield Moment(t_s, pose.translation, truth, detections, of_object, visible, views, odds, ghost, gone, report)


_GONE_SHARE = 0.3
"""An object of whose returns an attack leaves no more than this is gone from the sweep."""

_GHOST_WITHIN_M = 2.5
"""A detection within this distance of a ghost, and of no object, is of the ghost."""


def _counts_of(things: NDArray[Any], count: int) -> NDArray[np.intp]:
    """Return how many returns (count,) things gave, by the thing (R,) of each return, -1 for none."""
    return np.bincount(things[things >= 0], minlength=count)


def _objects_of(detections: Detections, truth: ObjectsTruth) -> NDArray[np.int32]:
    """Return the number (K,) of the object of each detection, by centers at most 2 m apart; -1 for none."""
    count = np.arange(len(detections))
    matched = match_objects(detections.boxes, count, truth.boxes, truth.numbers.astype(np.int64)).truth_of_track
    return np.append(truth.numbers, np.int32(-1))[matched]


def _view_of(
    fov: str, t_s: float, leveled: LeveledSweep, estimate: FovEstimate, hull: FovEstimate | None, found: DetectionProb
) -> View:
    """Return the view of a field of view by its name."""
    if fov == "none":
        return SeesAll(t_s)
    if fov == "default_hard":
        return GridView(estimate, t_s, hard=True)
    return BeamView(leveled, t_s, found=found) if hull is None or fov == "default" else PolygonView.of(hull, t_s)


def _found(counts: F64, _range_m: F64, _kinds: NDArray[np.uint8]) -> F64:
    return found_probability(counts)


def _exact_view(
    scan: ExactScan, sweep: Sweep, world: World, agent: Agent, grid: BevGrid, found: DetectionProb
) -> tuple[SeenCells | None, View]:
    """Return what a scan without noise lets be seen: the exact states of the cells, and the view by its beams."""
    pose = scan.world_from_sensor
    below = np.array([0.0, 0.0, sweep.sensor_height_m or 0.0])
    world_from_level = Rigid.from_yaw(pose.yaw, pose.translation - below)
    truth, _ = exact_truth(scan, world, grid, (CAR,), agent)
    t_s = (sweep.t_ns or 0) * 1e-9
    return SeenCells(grid, truth.state[CAR.name], world_from_level), ExactView(t_s, scan, world_from_level, found)


def _row(world_from_box: Rigid, size_m: tuple[float, float, float]) -> list[float]:
    return [*world_from_box.translation, *size_m, world_from_box.yaw]
