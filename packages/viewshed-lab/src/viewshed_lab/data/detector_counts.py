"""Counts what a detector does in simulated sweeps: its detection table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.detections import ObjectKind
from viewshed.objects.detection_table import BLOCKED, RANGE_M, RETURNS, DetectionTable, blocked_share
from viewshed.objects.detector import Detector
from viewshed.objects.matching import WITHIN_M, match_boxes
from viewshed.preprocess.evidence import expected_returns
from viewshed_lab.data.object_truth import ObjectSweep, SweepObjects


def measure_table(detector: Detector, sweeps: Iterable[ObjectSweep], about: Mapping[str, Any]) -> DetectionTable:
    """Return the counts of a detector over simulated sweeps."""
    kinds, ranges = len(ObjectKind), len(RANGE_M) - 1
    found, total = (np.zeros((kinds, len(RETURNS), ranges, len(BLOCKED) - 1), np.int64) for _ in range(2))
    errors_m2 = np.zeros((kinds, ranges, 2))
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
        # 2. Errors of the centers along the line of sight and across it.
        true = objects.boxes[match[match >= 0], :2]
        away = detections.boxes[match >= 0, :2] - true
        sight = true / np.maximum(np.hypot(*true.T), 1e-6)[:, None]
        along = (away * sight).sum(axis=1)
        across = away[:, 1] * sight[:, 0] - away[:, 0] * sight[:, 1]
        where = objects.kinds[match[match >= 0]], _range_class(true)
        np.add.at(errors_m2, where, np.column_stack([along, across]) ** 2)
        np.add.at(matched, where, 1)
        # 3. Detections that are nothing, or the second of one object.
        wrong = detections.take((match < 0) & (np.hypot(*detections.boxes[:, :2].T) < RANGE_M[-1]))
        np.add.at(false, (wrong.kinds, _range_class(wrong.boxes)), 1)
    return DetectionTable(found, total, errors_m2, matched, false, count, about)


def match_any(found: NDArray[np.float64], true: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the match (K,) of found boxes, within 2 m or, of long objects, a quarter of their length."""
    match = match_boxes(found, true)
    free = np.setdiff1d(np.flatnonzero(true[:, 3] / 4 > WITHIN_M), match)
    for t in free:
        away_m = np.hypot(*(found[:, :2] - true[t, :2]).T) + np.where(match >= 0, np.inf, 0.0)
        if away_m.size and away_m.min() <= true[t, 3] / 4:
            match[away_m.argmin()] = t
    return match


def _classes(each: ObjectSweep, objects: SweepObjects) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Return the classes (K,) of expected returns, range and blocking of objects."""
    expected = expected_returns(each.leveled, objects.boxes, leave_out_own=True)
    blocked = blocked_share(each.leveled, objects.boxes)
    return (
        np.searchsorted(RETURNS, expected, "right") - 1, _range_class(objects.boxes),
        np.digitize(blocked, BLOCKED[1:-1]),
    )  # fmt: skip


def _range_class(boxes: NDArray[np.float64]) -> NDArray[np.intp]:
    return np.searchsorted(RANGE_M, np.hypot(boxes[:, 0], boxes[:, 1]), "right") - 1
