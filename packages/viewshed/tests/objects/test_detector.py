"""The detector on scenes by hand: where things are is known exactly, and no scene is symmetric."""

import time

import numpy as np
import pytest
from tests.objects.scenes import GRID, HEIGHT_M, car, found, of_kind, person, seen

from viewshed import Sweep, _core
from viewshed.detections import ObjectKind
from viewshed.objects.candidates import find_candidates
from viewshed.objects.completion import LEFT_HIDDEN, RIGHT_HIDDEN, USUAL_SIZE_M, complete_boxes
from viewshed.objects.detector import MAX_OBJECTS, Detector, choose_nested, first_of_overlapping
from viewshed.preprocess.leveling import level
from viewshed_lab.sim import Box

SENSORS = ("hdl64e", "hdl32e", "os1_64", "vlp16")

PLACES = ((14.0, 2.0, 0.0), (3.0, 9.0, 0.0), (-8.0, 7.0, 0.6), (-13.0, -4.0, np.pi / 2))
"""A car from behind, from its side, askew, and its side across: x, y and heading."""


@pytest.mark.parametrize(
    ("sensor", "place"), [*zip(SENSORS, PLACES, strict=True), *zip(SENSORS, PLACES[::-1], strict=True)]
)
def test_one_car_is_one_box_where_the_car_is(sensor: str, place: tuple[float, float, float]) -> None:
    x_m, y_m, yaw = place
    detections = found(*car(x_m, y_m, yaw), sensor=sensor)
    assert detections.kinds.tolist() == [ObjectKind.CAR]
    (box,) = detections.boxes
    assert np.hypot(box[0] - x_m, box[1] - y_m) < 0.6
    assert abs((box[6] - yaw + np.pi / 2) % np.pi - np.pi / 2) < np.deg2rad(12)  # a box does not say where its front is
    assert box[3:6] == pytest.approx((4.4, 1.8, 1.5), abs=0.35)
    assert box[2] == pytest.approx(box[5] / 2, abs=0.05)
    assert detections.returns[0] > 20


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_the_end_that_is_not_seen_is_completed(yaw: float) -> None:
    """Two meters of a car's side, 2 m to the left: ahead, behind, beside; then what hides its left or right end."""
    length_m, width_m, height_m = USUAL_SIZE_M[ObjectKind.CAR]
    beside = {0: 0.0, LEFT_HIDDEN: 1 - length_m / 2, RIGHT_HIDDEN: length_m / 2 - 1}  # seen to the left, left is behind
    begins = [(8, 0), (-10, 0), *((-1, hidden) for hidden in beside)]
    sides = np.array([[yaw, begin, begin + 2, 2.0, 2.2, hidden] for begin, hidden in begins], np.float32)
    boxes = complete_boxes(sides, np.full(5, ObjectKind.CAR, np.uint8), np.zeros(5, bool), np.ones(5, np.float32))
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    along = [8 + length_m / 2, -8 - length_m / 2, *beside.values()]
    np.testing.assert_allclose(boxes[:, :2] @ turn, [[x, 2 + width_m / 2] for x in along], atol=1e-5)
    assert boxes[:, 2:] == pytest.approx(np.tile([height_m / 2, length_m, width_m, height_m, yaw], (5, 1)), abs=1e-5)


def test_boxes_stand_on_the_ground_of_a_slope() -> None:
    detections = found(*car(14.0, 2.0), slope=(0.1, 0.05))
    (box,) = of_kind(detections, ObjectKind.CAR).boxes
    assert box[2] == pytest.approx(0.1 * 14 + 0.05 * 2 + 0.75, abs=0.15)


def test_people_beside_a_wall_are_people_and_the_wall_is_nothing() -> None:
    wall = Box(15.0, 6.0, 0.3, 20.0, 2.5)
    detections = found(wall, person(13.8, 5.0), person(13.8, 8.0))
    assert detections.kinds.tolist() == [ObjectKind.PEDESTRIAN] * 2
    assert sorted(detections.boxes[:, 1].round().tolist()) == [5.0, 8.0]


def test_cars_in_a_row_are_apart() -> None:
    cars = of_kind(found(*car(12.0, -3.0), *car(17.2, -3.0), *car(22.4, -3.0)), ObjectKind.CAR)
    assert np.sort(cars.boxes[:, 0]) == pytest.approx([12.0, 17.2, 22.4], abs=0.6)


def test_walls_and_poles_are_no_cars() -> None:
    from viewshed_lab.sim import Cylinder

    things = (Box(10.0, 0.0, 0.3, 30.0, 2.0), Cylinder(-9.0, 4.0, 0.12, 7.0), Box(-20.0, -14.0, 16.0, 12.0, 9.0))
    assert not len(of_kind(found(*things), ObjectKind.CAR))


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.array([[9.0, 1.0, -1.0]])])
def test_sweeps_without_objects_have_none(points: np.ndarray) -> None:
    leveled = level(Sweep(points.astype(np.float32), sensor_height_m=HEIGHT_M), GRID)
    detections = Detector().detect(leveled)
    assert detections.boxes.shape == (0, 7)


@pytest.mark.parametrize("kind", ["one spot", "grid of clumps"])
def test_a_million_points_take_bounded_work(kind: str) -> None:
    rng = np.random.default_rng(0)
    count = 1_000_000
    if kind == "one spot":
        xy = rng.normal(10, 0.3, (count, 2))
    else:
        xy = rng.integers(-50, 50, (count, 2)) * 1.6 + rng.normal(0, 0.1, (count, 2))
    points = np.column_stack([xy, rng.uniform(0.3, 2.0, count)]).astype(np.float32)
    range_m = np.hypot(*points[:, :2].T)
    began = time.thread_time()
    rows, first, last, _, sides, shapes = _core.object_candidates(points, points[:, 2].copy(), range_m, HEIGHT_M)
    assert time.thread_time() - began < 1.0
    assert len(first) <= 2000
    assert np.isfinite(shapes).all()
    assert np.isfinite(sides).all()
    assert (last > first).all()
    assert len(rows) <= count


def test_no_more_objects_than_promised_are_given() -> None:
    rng = np.random.default_rng(1)
    centers = rng.permutation(
        np.stack(np.meshgrid(np.arange(-60, 60, 2.4), np.arange(-60, 60, 2.4)), -1).reshape(-1, 2)
    )
    body = np.column_stack([rng.uniform(-0.25, 0.25, (30, 2)), np.linspace(-1.4, -0.1, 30)])
    points = np.concatenate([body + np.append(center, 0.0) for center in centers]).astype(np.float32)
    leveled = level(Sweep(points, sensor_height_m=HEIGHT_M), GRID)
    assert len(Detector(least_prob=1e-6).detect(leveled)) <= MAX_OBJECTS


def test_of_nested_candidates_the_best_mean_is_kept() -> None:
    leveled = seen(*car(14.0, 2.0), *car(18.9, 2.0))
    candidates = find_candidates(leveled)
    whole = np.flatnonzero(candidates.parent < 0)
    score = np.full(len(candidates), 0.1, np.float32)
    assert choose_nested(candidates, score).tolist() == whole.tolist()
    parts = np.flatnonzero(np.isin(candidates.parent, whole))
    assert parts.size
    score[parts] = 0.9
    assert set(parts) <= set(choose_nested(candidates, score).tolist())


def test_of_boxes_in_each_other_the_first_is_kept() -> None:
    boxes = np.array([[10.0, 0, 1, 4, 2, 1.5, 0.0], [10.5, 0.4, 1, 4, 2, 1.5, 0.3], [10, 6.0, 1, 4, 2, 1.5, 0]])
    assert first_of_overlapping(boxes, boxes[:, :2]).tolist() == [0, 2]
    seen_inside = np.array([[10.0, 0], [10.5, 0.4], [11.0, 0.5]])
    assert first_of_overlapping(boxes, seen_inside).tolist() == [0]
