"""True objects of simulated sweeps: their returns lie in their boxes, and counts of a detector are those by hand."""

from pathlib import Path

import fit_detector
import numpy as np
import pytest

from viewshed.detections import Detections, ObjectKind
from viewshed.objects.detection_table import DetectionTable
from viewshed.objects.detector import Detector
from viewshed_lab.data.detector_counts import Score, match_any, measure_table, score
from viewshed_lab.data.object_truth import ObjectSweep, SweepObjects, road_sweeps


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


def test_the_carrier_is_no_object(sweeps: list[ObjectSweep]) -> None:
    for each in sweeps:
        assert (each.objects.range_m > 1.5).all()
        assert len(np.unique(each.objects.numbers)) == len(each.objects)


def test_most_cars_are_found(sweeps: list[ObjectSweep]) -> None:
    detector, total = Detector(), Score()
    for each in sweeps:
        total += score(detector.detect(each.leveled), each.objects)
    assert total.wanted > 20
    assert total.recall > 0.8
    assert total.precision > 0.7


def objects_at(*boxes: tuple[float, ...], returns: int = 50) -> SweepObjects:
    rows, count = np.array(boxes).reshape(-1, 7), len(boxes)
    kinds, numbers = np.full(count, ObjectKind.CAR, np.uint8), np.arange(count)
    return SweepObjects(rows, kinds, np.full(count, returns, np.int32), numbers)


def test_scores_by_hand() -> None:
    true = objects_at((10, 0, 0.75, 4, 2, 1.5, 0), (20, 5, 0.75, 4, 2, 1.5, 0), (60, 0, 0.75, 4, 2, 1.5, 0))
    boxes = np.array([
        [10.2, 0.1, 0.75, 4, 2, 1.5, 0], [10.0, 1.9, 0.75, 4, 2, 1.5, 0], [20.0, 3.2, 0.75, 4, 2, 1.5, 0],
        [59.0, 0, 0.75, 4, 2, 1.5, 0], [-30.0, 0, 0.75, 4, 2, 1.5, 0],
    ])  # fmt: skip
    found = Detections(boxes, np.full(5, ObjectKind.CAR), np.full(5, 30))
    # Two within 40 m, both found, one of them with an overlap; of four detections there two are cars.
    assert score(found, true) == Score(wanted=2, found=2, overlapping=1, called=4, right=2)
    assert score(found, true).precision == 0.5
    assert score(Detections.none(), true) == Score(wanted=2)
    assert score(found, true, ObjectKind.PEDESTRIAN) == Score()
    few = objects_at((10, 0, 0.75, 4, 2, 1.5, 0), returns=19)
    assert score(found, few) == Score(wanted=0, found=0, overlapping=0, called=4, right=1)


def test_long_objects_are_found_by_a_quarter_of_their_length() -> None:
    true = np.array([[20.0, 0, 1.5, 12, 2.5, 3, 0], [0.0, 9, 0.75, 4, 2, 1.5, 0]])
    found = np.array([[17.5, 0, 1.5, 8, 2.5, 3, 0], [0.0, 11.5, 0.75, 4, 2, 1.5, 0]])
    assert match_any(found, true).tolist() == [0, -1]


def test_a_table_counts_every_object_once(sweeps: list[ObjectSweep]) -> None:
    table = measure_table(Detector(), sweeps, {"seed": 777})
    assert table.sweeps == len(sweeps)
    assert table.total.sum() == sum((each.objects.range_m < 80).sum() for each in sweeps)
    assert table.found.sum() == table.matched.sum()
    assert 0 < table.found.sum() < table.total.sum()


@pytest.mark.slow
def test_the_tool_measures_a_table_again(tmp_path: Path) -> None:
    fit_detector.main(["--keep", "--drives", "1", "--table", str(tmp_path / "table.json")])
    table = DetectionTable.load(tmp_path / "table.json")
    assert table.sweeps == 4
    assert "60000" in table.about["worlds"]
