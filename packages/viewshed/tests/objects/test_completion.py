"""Completed boxes, computed by hand: what is missing lies behind what is seen."""

import numpy as np
import pytest

from viewshed.detections import ObjectKind
from viewshed.objects.completion import LEFT_HIDDEN, RIGHT_HIDDEN, USUAL_SIZE_M, complete_boxes, middles_of

CAR = np.array([ObjectKind.CAR], np.uint8)
LENGTH_M, WIDTH_M, HEIGHT_M = USUAL_SIZE_M[ObjectKind.CAR]


def completed(sides: list[float], is_end: bool, top_m: float = 1.4) -> np.ndarray:
    box: np.ndarray = complete_boxes(
        np.array([sides], np.float32), CAR, np.array([is_end]), np.array([top_m], np.float32)
    )[0]  # fmt: skip
    return box


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_a_car_from_behind_goes_on_ahead(yaw: float) -> None:
    # Its rear is seen 10 m ahead: the long side lies across, from y = -1 to y = .8, turned by yaw about the sensor.
    box = completed([yaw + np.pi / 2, -1.0, 0.8, -10.1, -10.0, 0.0], is_end=True)
    middle = 10.0 + LENGTH_M / 2, -0.1
    assert box[0] == pytest.approx(middle[0] * np.cos(yaw) - middle[1] * np.sin(yaw), abs=1e-5)
    assert box[1] == pytest.approx(middle[0] * np.sin(yaw) + middle[1] * np.cos(yaw), abs=1e-5)
    assert box[3:6] == pytest.approx((LENGTH_M, WIDTH_M, HEIGHT_M))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_car_from_its_side_is_wider_away_from_the_sensor(side: float) -> None:
    across = sorted((side * 6.0, side * 6.2))
    box = completed([0.0, 1.0, 1.0 + LENGTH_M, *across, 0.0], is_end=False)
    assert box[:2] == pytest.approx((1.0 + LENGTH_M / 2, side * (6.0 + WIDTH_M / 2)))


@pytest.mark.parametrize(("hidden", "middle_m"), [(0, 0.0), (LEFT_HIDDEN, -0.7), (RIGHT_HIDDEN, 0.7)])
def test_a_side_goes_on_where_something_hides_its_end(hidden: int, middle_m: float) -> None:
    # A side of 3 m to the left of the sensor: its left end, seen from there, is at its rear.
    box = completed([0.0, -1.5, 1.5, 6.0, 6.2, hidden], is_end=False)
    assert box[0] == pytest.approx(middle_m, abs=1e-6)
    assert box[3] == pytest.approx(LENGTH_M)


def test_what_is_larger_than_usual_stays_as_it_is() -> None:
    box = completed([0.2, 3.0, 8.3, 4.0, 6.1, LEFT_HIDDEN], is_end=False, top_m=1.9)
    assert box[3:6] == pytest.approx((5.3, 2.1, 1.9), rel=1e-6)
    assert box[2] == pytest.approx(0.95)
    assert box[:2] == pytest.approx(middles_of(np.array([[0.2, 3.0, 8.3, 4.0, 6.1, 1.0]], np.float32))[0])


def test_no_boxes_of_no_sides() -> None:
    none = complete_boxes(np.zeros((0, 6), np.float32), CAR[:0], np.zeros(0, np.bool_), np.zeros(0, np.float32))
    assert none.shape == (0, 7)
