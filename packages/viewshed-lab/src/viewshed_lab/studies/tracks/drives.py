"""Simulated drives with exact truth: objects, detections, and the views of each field of view."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.detections import Detections, ObjectKind, moved_boxes
from viewshed.estimators import DEFAULT_ESTIMATOR, load_estimator
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.visibility import probability_of_visible
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.monitor import IntegrityReport, StreamMonitor
from viewshed.objects.cells import SeenCells
from viewshed.objects.detection_table import detection_table
from viewshed.objects.detector import Detector
from viewshed.objects.metrics import match_objects
from viewshed.objects.sensor_view import SensorView
from viewshed.objects.views import BeamView, PolygonView, SeesAll, View
from viewshed.preprocess.evidence import expected_returns
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed_lab.data.drive import OBJECT_KINDS, box_of, object_at
from viewshed_lab.data.simulated import ScenePlan, scan_frame, world_of
from viewshed_lab.studies.tracks.lidar_level import SweepForger

FOVS = ("none", "published", "polygon", "default")
"""No field of view; the published tracker with its polygon; our tracker with that polygon, or the default method."""

POLYGON = "paper_concave_hull"
"""Name of the estimator of the published polygon."""

HZ = 10.0

GRID = BevGrid(512, 64.0)
"""The extent of the road grid, with cells of 0.25 m, so that a car covers many cells."""

KINDS = {
    "car": ObjectKind.CAR, "van": ObjectKind.CAR, "truck": ObjectKind.TRUCK, "bus": ObjectKind.TRUCK,
    "trailer": ObjectKind.TRUCK, "tractor": ObjectKind.TRUCK, "pedestrian": ObjectKind.PEDESTRIAN,
    "cyclist": ObjectKind.CYCLIST, "motorcycle": ObjectKind.CYCLIST,
}  # fmt: skip
"""Kinds of detections by kind of simulated thing; all others are ``OTHER``."""


@dataclass(frozen=True, slots=True, eq=False)
class ObjectsTruth:
    """The objects in the world at the time of a sweep."""

    numbers: NDArray[np.int32]  # (N,) int32 ids, constant over time
    boxes: F64  # (N, 7) in the world
    kinds: NDArray[np.uint8]  # (N,) uint8 of ``ObjectKind``
    returns: NDArray[np.int32]  # (N,) int32 number of returns


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One sweep of a drive."""

    t_s: float  # time
    ground: F64  # (3,) point on the ground below the sensor, in the world
    truth: ObjectsTruth  # all objects except the vehicle that carries the sensor
    detections: Detections  # honest ones, in the world
    of_object: NDArray[np.int32]  # (K,) int32 number of each detection's object, -1 for false detections
    visible: F64  # (N,) visibility of each object in the truth, by the default field of view
    views: dict[str, SensorView]  # by name of ``FOVS``
    false_odds: F64  # (K,) ratio of false to true detections like this one
    ghost: NDArray[np.bool_]  # (K,) bool, detections of an object that an attack on the LiDAR created
    gone: frozenset[int] = frozenset()  # numbers of the objects that an attack on the LiDAR removed from the sweep
    report: IntegrityReport | None = None  # of the sensor's monitor, if there is one


SEEN_FROM = 5
"""Minimum number of (expected) returns of a visible object."""


def simulate_drive(
    plan: ScenePlan, fovs: tuple[str, ...] = FOVS, forger: SweepForger | None = None
) -> Iterator[Moment]:
    """Yield the sweeps of a drive of one vehicle with truth, detections and fields of view of ``FOVS``.

    A ``forger`` attacks the sweeps before anything is computed from them. The truth is unchanged; the shipped monitor
    runs as well.
    """
    grid, detector = GRID, Detector()
    world, agent = world_of(plan), world_of(plan).agents[0]
    estimator, polygon = load_estimator(DEFAULT_ESTIMATOR, grid=grid), load_estimator(POLYGON, grid=grid)
    monitor = None if forger is None else StreamMonitor()
    movable = [
        k for k, thing in enumerate(world.things)
        if k != agent.carrier and (thing.kind in OBJECT_KINDS or thing.track is not None)
    ]  # fmt: skip
    about = {k: box_of(world.things[k]) for k in movable}
    kinds = np.array([KINDS.get(world.things[k].kind, ObjectKind.OTHER) for k in movable], np.uint8)
    for frame in range(plan.frames):
        # 1. The objects and their numbers of returns.
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
        # 2. The sweep, attacked if there is a forger, from which everything else is computed.
        if forger is not None:
            tampered = forger.apply(clean, t_s, truth.numbers, truth.boxes, truth.returns)
            sweep, ghost_at = tampered.sweep, forger.ghost_at(clean)
            left = _counts_of(of_return[~tampered.removed], len(world.things))[movable]
            gone = frozenset(truth.numbers[(returns >= SEEN_FROM) & (left <= _GONE_SHARE * returns)].tolist())
            leveled = level(sweep, grid)
        # 3. Fields of view and detections.
        estimate = estimator.estimate(leveled)
        hull = polygon.estimate(leveled) if {"polygon", "published"} & set(fovs) else None
        pose = leveled.world_from_level or world_from_level
        place, yaw = pose.translation[:2], pose.yaw
        views: dict[str, SensorView] = {}
        for fov in fovs:
            cells = SeenCells.of(estimate) if fov == "default" else None
            views[fov] = SensorView("top", _view_of(fov, t_s, leveled, hull), place, cells, yaw=yaw)
        here = detector.detect(leveled)
        detections = here.moved(pose)
        of_object = _objects_of(detections, truth)
        odds = detection_table().false_odds(np.hypot(here.boxes[:, 0], here.boxes[:, 1]), here.kinds)
        ghost = np.zeros(len(detections), np.bool_)
        if ghost_at is not None:
            ghost = (np.hypot(*(detections.boxes[:, :2] - ghost_at).T) < _GHOST_WITHIN_M) & (of_object < 0)
        report = None if monitor is None else monitor.check(leveled).now
        yield Moment(t_s, pose.translation, truth, detections, of_object, visible, views, odds, ghost, gone, report)


_GONE_SHARE = 0.3
"""An object counts as gone if an attack leaves at most this share of its returns."""

_GHOST_WITHIN_M = 2.5
"""A detection of no object within this distance of a ghost is a detection of the ghost."""


def _counts_of(things: NDArray[Any], count: int) -> NDArray[np.intp]:
    """Return the number of returns (count,) of each thing, from the thing (R,) of each return, -1 for none."""
    return np.bincount(things[things >= 0], minlength=count)


def _objects_of(detections: Detections, truth: ObjectsTruth) -> NDArray[np.int32]:
    """Return the number (K,) of the object of each detection, matched by centers within 2 m; -1 for none."""
    count = np.arange(len(detections))
    matched = match_objects(detections.boxes, count, truth.boxes, truth.numbers.astype(np.int64)).truth_of_track
    return np.append(truth.numbers, np.int32(-1))[matched]


def _view_of(fov: str, t_s: float, leveled: LeveledSweep, hull: FovEstimate | None) -> View:
    """Return the view of a field of view, by name."""
    if fov == "none":
        return SeesAll(t_s)
    return BeamView(leveled, t_s) if hull is None or fov == "default" else PolygonView.of(hull, t_s)


def _row(world_from_box: Rigid, size_m: tuple[float, float, float]) -> list[float]:
    return [*world_from_box.translation, *size_m, world_from_box.yaw]
