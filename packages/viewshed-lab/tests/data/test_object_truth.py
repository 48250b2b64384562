"""True objects of simulated sweeps: their returns lie in their boxes, and counts of a detector are those by hand."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fit_detector
import numpy as np
import pytest

from viewshed.detections import Detections, ObjectKind
from viewshed.objects.detection_table import RANGE_M, RETURNS, DetectionTable
from viewshed.objects.detector import Detector
from viewshed_lab.data.object_truth import ObjectSweep, match_any, measure_table, road_sweeps


@pytest.fixture(scope="module")
def sweeps() -> list[ObjectSweep]:
    return list(road_sweeps(777, 2, ("hdl32e",)))


def test_returns_of_objects_lie_in_their_boxes(sweeps: list[ObjectSweep]) -> None:
    for each in sweeps:
        objects = each.objects.take((each.objects.returns >= 20) & (each.objects.range_m < 40))
        points, height_m, shares = each.leveled.points, each.leveled.height_m, []
        for box, returns in zip(objects.boxes, objects.returns, strict=True):
            away = points[:, :2] - box[:2]
            c, s = np.cos(box[6]), np.sin(box[6])
            inside = np.abs(away[:, 0] * c + away[:, 1] * s) < box[3] / 2 + 0.3
            inside &= np.abs(away[:, 1] * c - away[:, 0] * s) < box[4] / 2 + 0.3
            shares.append((inside & (height_m > 0.05)).sum() / returns)
        # What drives by moves by a meter and more within a revolution: not all of them.
        assert np.median(shares) > 0.9


def test_most_cars_are_found(sweeps: list[ObjectSweep]) -> None:
    """Cars within 40 m from which 20 returns are expected; detections there are mostly cars."""
    table, car = measure_table(Detector(), sweeps, {}), ObjectKind.CAR
    near, many = np.array(RANGE_M[1:]) <= 40.0, np.array(RETURNS) >= 20
    wanted, found = (counts[car][many][:, near].sum() for counts in (table.total, table.found))
    assert wanted > 20
    assert found / wanted > 0.8
    right, false = (counts[car][near].sum() for counts in (table.matched, table.false))
    assert right / (right + false) > 0.7


def test_counts_by_hand(sweeps: list[ObjectSweep]) -> None:
    """Every object is found one meter beyond where it is; one more detection is nothing."""
    one = sweeps[0]
    objects = one.objects.take(one.objects.range_m < RANGE_M[-1] - 1)
    boxes = objects.boxes.copy()
    boxes[:, :2] *= 1 + 1 / np.hypot(*boxes[:, :2].T)[:, None]
    found = Detections(
        np.concatenate([boxes, [[-60.0, -40.0, 0.75, 4, 2, 1.5, 0]]]), np.append(objects.kinds, ObjectKind.CAR),
        np.full(len(boxes) + 1, 30),
    )  # fmt: skip
    detector: Any = SimpleNamespace(detect=lambda leveled: found)
    table = measure_table(detector, [replace(one, objects=objects)], {})
    assert table.total.sum() == table.found.sum() == table.matched.sum() == len(objects) > 5
    assert table.false.sum() == 1


def test_long_objects_are_found_by_a_quarter_of_their_length() -> None:
    true = np.array([[20.0, 0, 1.5, 12, 2.5, 3, 0], [0.0, 9, 0.75, 4, 2, 1.5, 0]])
    found = np.array([[17.5, 0, 1.5, 8, 2.5, 3, 0], [0.0, 11.5, 0.75, 4, 2, 1.5, 0]])
    assert match_any(found, true).tolist() == [0, -1]


@pytest.mark.slow
def test_the_tool_measures_a_table_again(tmp_path: Path) -> None:
    fit_detector.main(["--keep", "--drives", "1", "--table", str(tmp_path / "table.json")])
    table = DetectionTable.load(tmp_path / "table.json")
    assert table.sweeps == 4
    assert "60000" in table.about["worlds"]
