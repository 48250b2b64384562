"""Counts what a detector does in simulated sweeps: its detection table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.detections import ObjectKind
from viewshed.objects.detection_table import RANGE_M, RETURNS, DetectionTable
from viewshed.objects.detector import Detector
from viewshed.objects.matching import WITHIN_M, match_boxes
from viewshed.preprocess.evidence import expected_returns
from viewshed_lab.data.object_truth import ObjectSweep, SweepObjects


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
