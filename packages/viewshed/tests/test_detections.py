"""Detections: classes that nobody knows are OTHER, and what no object has is refused by name."""

from __future__ import annotations

import re

import numpy as np
import pytest

from viewshed.detections import Detections, ObjectKind

CAR = [4.0, -2.0, 0.8, 4.2, 1.8, 1.5, 0.3]


def test_a_class_that_nobody_knows_is_other_and_none_wraps_into_another() -> None:
    kinds = np.array([3.0, np.nan, 259.0, -1.0, 5.0, 4.0])
    made = Detections(np.tile(CAR, (6, 1)), kinds, np.zeros(6, np.int32))
    other = ObjectKind.OTHER
    assert made.kinds.tolist() == [ObjectKind.CAR, other, other, other, other, ObjectKind.TRUCK]


@pytest.mark.parametrize("count", [-1, np.nan, 2.0**31])
def test_counts_of_returns_that_are_none_are_refused(count: float) -> None:
    rule = f"returns must be counts of 0 or more, got {np.float64(count)}; give 0 where none is known"
    with pytest.raises(ValueError, match=re.escape(rule)):
        Detections(np.tile(CAR, (2, 1)), np.full(2, 3), np.array([5.0, count]))


def test_the_first_bad_box_is_named_with_its_numbers() -> None:
    boxes = np.tile(CAR, (3, 1))
    boxes[1, 4], boxes[2, 0] = 0.0, np.nan
    numbers = "box 1: x_m 4, y_m -2, z_m 0.8, length_m 4.2, width_m 0, height_m 1.5, yaw 0.3; leave it out"
    with pytest.raises(ValueError, match=re.escape(f"positive sizes, got {numbers}")):
        Detections(boxes, np.full(3, 3), np.zeros(3, np.int32))
