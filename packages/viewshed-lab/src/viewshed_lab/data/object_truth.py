"""Objects that a sweep should show: boxes in the level frame, their returns, and what a detector finds of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed.detections import ObjectKind
from viewshed.grid import GRIDS
from viewshed.objects.detection_table import RANGE_M, RETURNS, DetectionTable
from viewshed.objects.detector import Detector
from viewshed.objects.matching import WITHIN_M, match_boxes
from viewshed.preprocess.evidence import expected_returns
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.recordings.write.moment import DriveTruth
from viewshed_lab.data.drive import drive_plan, drive_sweeps
from viewshed_lab.data.presets import preset_named

ROAD_WORLDS = (
    "street", "junction", "highway", "parking", "residential", "street", "junction", "residential", "country_road",
    "glass_fronts", "slope_town", "site", "parking",
)  # fmt: skip
"""Kinds of world in which a detector for roads is fitted and judged, in turns; towns more often than the rest."""

ROAD_SENSORS = (
    "hdl32e", "hdl64e", "vlp16", "vlp32c", "os1_64", "pandar40p", "xt32", "hdl32e", "hdl64e", "os1_32", "os0_32",
)  # fmt: skip
"""Sensors that take turns in these worlds."""

INDOOR_WORLDS = ("rooms", "corridors", "hall", "warehouse")
INDOOR_SENSORS = ("vlp16", "os0_32", "os1_32", "hdl32e")
_SECONDS, _HZ = 6.0, 1 / 3

KIND_OF_CATEGORY = {
    "car": ObjectKind.CAR, "van": ObjectKind.CAR,
    "truck": ObjectKind.TRUCK, "bus": ObjectKind.TRUCK, "trailer": ObjectKind.TRUCK,
    "cyclist": ObjectKind.CYCLIST, "motorcycle": ObjectKind.CYCLIST,
    "pedestrian": ObjectKind.PEDESTRIAN,
}  # fmt: skip
"""What the categories of the simulator are to a detector; every other is ``OTHER``."""


@dataclass(frozen=True, slots=True, eq=False)
class SweepObjects:
    """The true objects about one sensor at the time of one sweep, in its ``level`` frame, without its own carrier."""

    boxes: NDArray[np.float64]  # (K, 7) float64, columns :data:`viewshed.detections.BOX_COLUMNS`
    kinds: NDArray[np.uint8]  # (K,) uint8 of :class:`viewshed.detections.ObjectKind`
    returns: NDArray[np.int32]  # (K,) int32 returns that each gave
    numbers: NDArray[np.int64]  # (K,) int64 the same for one object over time

    def __len__(self) -> int:
        """Return the number of objects."""
        return len(self.boxes)

    @property
    def range_m(self) -> NDArray[np.float64]:
        """Horizontal range (K,) of the centers from the sensor."""
        return np.hypot(self.boxes[:, 0], self.boxes[:, 1])

    def take(self, chosen: NDArray[Any]) -> Self:
        """Return some of them, by a mask (K,) or by their places."""
        return type(self)(self.boxes[chosen], self.kinds[chosen], self.returns[chosen], self.numbers[chosen])


@dataclass(frozen=True, slots=True, eq=False)
class ObjectSweep:
    """A simulated sweep, leveled, with the objects that it should show."""

    world: str  # kind of world
    sensor: str  # beam table
    leveled: LeveledSweep  # the sweep
    objects: SweepObjects  # what is there


def road_sweeps(seed: int, drives: int, sensors: tuple[str, ...] = ROAD_SENSORS) -> Iterator[ObjectSweep]:
    """Yield two sweeps of each of some drives in ``ROAD_WORLDS``, one vehicle in clear weather, 3 s apart.

    Args:
        seed: of the first drive; the next ones have the next seeds.
        drives: how many.
        sensors: take turns.
    """
    yield from _sweeps("drives", "road", ROAD_WORLDS, sensors, seed, drives)


def indoor_sweeps(seed: int, drives: int) -> Iterator[ObjectSweep]:
    """Yield two sweeps of each of some drives of a robot indoors, as :func:`road_sweeps`."""
    yield from _sweeps("rooms", "indoor", INDOOR_WORLDS, INDOOR_SENSORS, seed, drives)


def _sweeps(
    preset: str, grid: str, worlds: tuple[str, ...], sensors: tuple[str, ...], seed: int, drives: int
) -> Iterator[ObjectSweep]:
    for k in range(drives):
        world, sensor = worlds[k % len(worlds)], sensors[(k + k // len(worlds)) % len(sensors)]
        one = replace(preset_named(preset), sensors=(sensor,))
        plan = drive_plan(one, seconds=_SECONDS, hz=_HZ, agents=1, world=world, seed=seed + k)
        for sweep, truth in drive_sweeps(plan):
            leveled = level(sweep, GRIDS[grid])
            yield ObjectSweep(world, sensor, leveled, objects_of_sweep(leveled, truth))


def objects_of_sweep(leveled: LeveledSweep, truth: DriveTruth) -> SweepObjects:
    """Return the objects of a simulated drive as the sensor of one sweep should see them.

    Args:
        leveled: a sweep of :func:`viewshed_lab.data.drive.drive_sweeps`, leveled.
        truth: what came with it.

    Raises:
        ValueError: the sweep has no pose.
    """
    world_from_level = leveled.world_from_level
    if world_from_level is None:
        raise ValueError("the sweep must have a pose, got none; take it as drive_sweeps gave it")
    level_from_world = world_from_level.inverse()
    poses = [level_from_world @ each.world_from_box for each in truth.objects]
    boxes = np.array(
        [(*pose.translation, *each.size_m, pose.yaw) for pose, each in zip(poses, truth.objects, strict=True)]
    ).reshape(-1, 7)
    kinds = np.array([KIND_OF_CATEGORY.get(each.category, ObjectKind.OTHER) for each in truth.objects], np.uint8)
    numbers = np.array([each.number for each in truth.objects], np.int64)
    others = np.array([each.number != truth.carrier for each in truth.objects], np.bool_)
    return SweepObjects(boxes, kinds, truth.returns, numbers).take(others)


def measure_table(detector: Detector, sweeps: Iterable[ObjectSweep], about: Mapping[str, Any]) -> DetectionTable:
    """Return the counts of a detector over simulated sweeps."""
    kinds, ranges = len(ObjectKind), len(RANGE_M) - 1
    found, total = (np.zeros((kinds, len(RETURNS), ranges), np.int64) for _ in range(2))
    matched, false = np.zeros((kinds, ranges), np.int64), np.zeros((kinds, ranges), np.int64)
    count = 0
    for each in sweeps:
        count += 1
        objects = each.objects.take(each.objects.range_m < RANGE_M[-1])
        detections = detector.detect(each.leveled)
        match = match_any(detections.boxes, objects.boxes)
        # 1. Objects by class, and which of them were found.
        is_found = np.zeros(len(objects), np.bool_)
        is_found[match[match >= 0]] = True
        place = (objects.kinds, *_classes(each, objects))
        np.add.at(total, place, 1)
        np.add.at(found, place, is_found)
        # 2. Detections of objects, by the kind of these.
        true = objects.take(match[match >= 0])
        np.add.at(matched, (true.kinds, _range_class(true.boxes)), 1)
        # 3. Detections that are nothing, or the second of one object.
        wrong = detections.take((match < 0) & (np.hypot(*detections.boxes[:, :2].T) < RANGE_M[-1]))
        np.add.at(false, (wrong.kinds, _range_class(wrong.boxes)), 1)
    return DetectionTable(found, total, matched, false, count, about)


def match_any(found: NDArray[np.float64], true: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the match (K,) of found boxes, within 2 m or, of long objects, a quarter of their length."""
    match = match_boxes(found, true)
    free = np.setdiff1d(np.flatnonzero(true[:, 3] / 4 > WITHIN_M), match)
    for t in free:
        away_m = np.hypot(*(found[:, :2] - true[t, :2]).T) + np.where(match >= 0, np.inf, 0.0)
        if away_m.size and away_m.min() <= true[t, 3] / 4:
            match[away_m.argmin()] = t
    return match


def _classes(each: ObjectSweep, objects: SweepObjects) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the classes (K,) of expected returns and of range of objects."""
    expected = expected_returns(each.leveled, objects.boxes, leave_out_own=True)
    return np.searchsorted(RETURNS, expected, "right") - 1, _range_class(objects.boxes)


def _range_class(boxes: NDArray[np.float64]) -> NDArray[np.intp]:
    return np.searchsorted(RANGE_M, np.hypot(boxes[:, 0], boxes[:, 1]), "right") - 1
