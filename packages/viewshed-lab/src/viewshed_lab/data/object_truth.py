"""True objects of a sweep: boxes in the level frame and their returns; counts of what a detector finds."""

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
"""Kinds of world to fit and evaluate a road detector in, used in turn; towns occur more often."""

ROAD_SENSORS = (
    "hdl32e", "hdl64e", "vlp16", "vlp32c", "os1_64", "pandar40p", "xt32", "hdl32e", "hdl64e", "os1_32", "os0_32",
)  # fmt: skip
"""Sensors in these worlds, used in turn."""

INDOOR_WORLDS = ("rooms", "corridors", "hall", "warehouse")
INDOOR_SENSORS = ("vlp16", "os0_32", "os1_32", "hdl32e")
_SECONDS, _HZ = 6.0, 1 / 3

KIND_OF_CATEGORY = {
    "car": ObjectKind.CAR, "van": ObjectKind.CAR,
    "truck": ObjectKind.TRUCK, "bus": ObjectKind.TRUCK, "trailer": ObjectKind.TRUCK,
    "cyclist": ObjectKind.CYCLIST, "motorcycle": ObjectKind.CYCLIST,
    "pedestrian": ObjectKind.PEDESTRIAN,
}  # fmt: skip
"""Detector kind of each simulator category; every other category is ``OTHER``."""


@dataclass(frozen=True, slots=True, eq=False)
class SweepObjects:
    """True objects around a sensor at the time of a sweep, in its ``level`` frame, without the sensor's carrier."""

    boxes: NDArray[np.float64]  # (K, 7) float64, columns :data:`viewshed.detections.BOX_COLUMNS`
    kinds: NDArray[np.uint8]  # (K,) uint8 of :class:`viewshed.detections.ObjectKind`
    returns: NDArray[np.int32]  # (K,) int32 number of returns
    numbers: NDArray[np.int64]  # (K,) int64 identity of the object, constant over time

    def __len__(self) -> int:
        """Return the number of objects."""
        return len(self.boxes)

    @property
    def range_m(self) -> NDArray[np.float64]:
        """Horizontal range (K,) of the box centers from the sensor, m."""
        return np.hypot(self.boxes[:, 0], self.boxes[:, 1])

    def take(self, index: NDArray[Any]) -> Self:
        """Return the objects that a mask (K,) or an array of indices selects."""
        return type(self)(self.boxes[index], self.kinds[index], self.returns[index], self.numbers[index])


@dataclass(frozen=True, slots=True, eq=False)
class ObjectSweep:
    """A simulated, leveled sweep with its true objects."""

    world: str  # kind of world
    sensor: str  # beam table
    leveled: LeveledSweep  # the sweep
    objects: SweepObjects  # true objects


def road_sweeps(seed: int, drives: int, sensors: tuple[str, ...] = ROAD_SENSORS) -> Iterator[ObjectSweep]:
    """Yield two sweeps, 3 s apart, of each drive in ``ROAD_WORLDS``, with one vehicle in clear weather.

    Args:
        seed: of the first drive; the following drives have the following seeds.
        drives: number of drives.
        sensors: beam tables, used in turn.
    """
    yield from _sweeps("drives", "road", ROAD_WORLDS, sensors, seed, drives)


def indoor_sweeps(seed: int, drives: int) -> Iterator[ObjectSweep]:
    """Yield two sweeps of each drive of an indoor robot; see :func:`road_sweeps`."""
    yield from _sweeps("rooms", "indoor", INDOOR_WORLDS, INDOOR_SENSORS, seed, drives)


def _sweeps(
    preset: str, grid: str, worlds: tuple[str, ...], sensors: tuple[str, ...], seed: int, drives: int
) -> Iterator[ObjectSweep]:
    for k in range(drives):
        world, sensor = worlds[k % len(worlds)], sensors[(k + k // len(worlds)) % len(sensors)]
        with_sensor = replace(preset_named(preset), sensors=(sensor,))
        plan = drive_plan(with_sensor, seconds=_SECONDS, hz=_HZ, agents=1, world=world, seed=seed + k)
        for sweep, truth in drive_sweeps(plan):
            leveled = level(sweep, GRIDS[grid])
            yield ObjectSweep(world, sensor, leveled, objects_of_sweep(leveled, truth))


def objects_of_sweep(leveled: LeveledSweep, truth: DriveTruth) -> SweepObjects:
    """Return the true objects of a sweep of a simulated drive, in the sweep's ``level`` frame.

    Args:
        leveled: a leveled sweep of :func:`viewshed_lab.data.drive.drive_sweeps`.
        truth: the truth that came with it.

    Raises:
        ValueError: the sweep has no pose.
    """
    world_from_level = leveled.world_from_level
    if world_from_level is None:
        raise ValueError("the sweep must have a pose, got none; use a sweep from drive_sweeps")
    level_from_world = world_from_level.inverse()
    poses = [level_from_world @ item.world_from_box for item in truth.objects]
    boxes = np.array(
        [(*pose.translation, *item.size_m, pose.yaw) for pose, item in zip(poses, truth.objects, strict=True)]
    ).reshape(-1, 7)
    kinds = np.array([KIND_OF_CATEGORY.get(item.category, ObjectKind.OTHER) for item in truth.objects], np.uint8)
    numbers = np.array([item.number for item in truth.objects], np.int64)
    others = np.array([item.number != truth.carrier for item in truth.objects], np.bool_)
    return SweepObjects(boxes, kinds, truth.returns, numbers).take(others)


def measure_table(detector: Detector, sweeps: Iterable[ObjectSweep], about: Mapping[str, Any]) -> DetectionTable:
    """Count a detector's hits, misses and false detections over simulated sweeps."""
    kinds, ranges = len(ObjectKind), len(RANGE_M) - 1
    found, total = (np.zeros((kinds, len(RETURNS), ranges), np.int64) for _ in range(2))
    matched, false = np.zeros((kinds, ranges), np.int64), np.zeros((kinds, ranges), np.int64)
    count = 0
    for sweep in sweeps:
        count += 1
        objects = sweep.objects.take(sweep.objects.range_m < RANGE_M[-1])
        detections = detector.detect(sweep.leveled)
        match = match_any(detections.boxes, objects.boxes)
        # 1. Count the objects, and the detected ones, by kind, expected returns and range.
        is_found = np.zeros(len(objects), np.bool_)
        is_found[match[match >= 0]] = True
        bins = (objects.kinds, *_bins(sweep, objects))
        np.add.at(total, bins, 1)
        np.add.at(found, bins, is_found)
        # 2. Count the true detections by kind and range of their objects.
        true = objects.take(match[match >= 0])
        np.add.at(matched, (true.kinds, _range_bin(true.boxes)), 1)
        # 3. Count the false detections, including second detections of an object.
        wrong = detections.take((match < 0) & (np.hypot(*detections.boxes[:, :2].T) < RANGE_M[-1]))
        np.add.at(false, (wrong.kinds, _range_bin(wrong.boxes)), 1)
    return DetectionTable(found, total, matched, false, count, about)


def match_any(detected: NDArray[np.float64], true: NDArray[np.float64]) -> NDArray[np.intp]:
    """Match detected boxes (K) to true ones, within 2 m or, for long objects, within a quarter of their length."""
    match = match_boxes(detected, true)
    unmatched = np.setdiff1d(np.flatnonzero(true[:, 3] / 4 > WITHIN_M), match)
    for t in unmatched:
        distance_m = np.hypot(*(detected[:, :2] - true[t, :2]).T) + np.where(match >= 0, np.inf, 0.0)
        if distance_m.size and distance_m.min() <= true[t, 3] / 4:
            match[distance_m.argmin()] = t
    return match


def _bins(sweep: ObjectSweep, objects: SweepObjects) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the bins (K,) of the objects' expected returns and ranges."""
    expected = expected_returns(sweep.leveled, objects.boxes, leave_out_own=True)
    return np.searchsorted(RETURNS, expected, "right") - 1, _range_bin(objects.boxes)


def _range_bin(boxes: NDArray[np.float64]) -> NDArray[np.intp]:
    return np.searchsorted(RANGE_M, np.hypot(boxes[:, 0], boxes[:, 1]), "right") - 1
