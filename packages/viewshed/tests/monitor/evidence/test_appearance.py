"""Things that stand, or are gone, where beams passed: speeds by hand."""

import numpy as np
import pytest
from tests.monitor.evidence.drives import HEIGHT_M, PLATE, YARD, leveled, look, measure, sector_at

from viewshed_lab.sim import Box

AHEAD = sector_at(6.0)
"""The middle of the plate: y = 1 at x = 10."""


def test_a_plate_that_appears_must_have_been_fast() -> None:
    values = measure("arrival", look(YARD, 0), look((*YARD, PLATE), 1))
    # The nearest cover is what the sensor cannot see, 2.5 m around it: 7.5 m to 7.9 m in a tenth of a second.
    assert 70.0 < values[AHEAD] < 80.0
    assert values[sector_at(90.0)] == 0.0


def test_who_came_two_sweeps_ago_is_remembered() -> None:
    sweeps = [look(YARD, 0), *(look((*YARD, PLATE), number) for number in (1, 2))]
    assert 70.0 < measure("arrival", *sweeps)[AHEAD] < 80.0


def test_a_plate_that_vanishes_is_the_reverse() -> None:
    sweeps = look((*YARD, PLATE), 0), look(YARD, 1)
    assert 70.0 < measure("departure", *sweeps)[AHEAD] < 80.0
    assert measure("arrival", *sweeps).max() < 5.0


@pytest.mark.parametrize("speed_mps", [15.0, 45.0])
def test_a_car_across_needs_no_more_than_its_speed(speed_mps: float) -> None:
    cars = [Box(12.0, y_m, 1.8, 4.5, 1.5) for y_m in (-4.0, 0.1 * speed_mps - 4.0)]
    sweeps = [look((*YARD, car), number) for number, car in enumerate(cars)]
    assert 0.3 * speed_mps < measure("arrival", *sweeps).max() < 1.4 * speed_mps
    assert measure("departure", *sweeps).max() < 1.4 * speed_mps


def test_what_comes_out_of_cover_is_no_wonder() -> None:
    # A hut hides a car that drives out at 10 m/s.
    hut = Box(8.0, 4.0, 3.0, 6.0, 4.0)
    cars = [Box(14.0, y_m, 1.8, 4.0, 1.5) for y_m in (1.2, 0.2)]
    sweeps = [look((*YARD, hut, car), number) for number, car in enumerate(cars)]
    assert measure("arrival", *sweeps).max() < 20.0


def test_the_sensor_may_move() -> None:
    boxes = (*YARD, PLATE)
    assert measure("arrival", *(look(boxes, number, 2.0 * number) for number in range(3))).max() < 8.0
    assert measure("arrival", look(YARD, 0, 0.0), look(boxes, 1, 2.0))[sector_at(7.0)] > 40.0


def test_returns_off_their_beams_appear_nowhere() -> None:
    # The mounting is stated .6 m too high; where the ground of one sweep follows that, all of it seems to stand.
    rng = np.random.default_rng(50)
    raised = [look(YARD, number, 0.2 * number, rng) for number in (10, 11, 12)]
    raised = [sweep.replace(points=sweep.points + np.array([0.0, 0.0, 0.6], np.float32)) for sweep in raised]
    now = leveled(raised[-1])
    ground = np.abs(now.sweep.points[now.rows, 2] + HEIGHT_M - 0.6) < 0.1
    assert now.height_m[ground].min() > 0.3, "this sweep's ground is wrong"
    assert measure("arrival", *raised).max() == 0.0


def test_a_surface_that_jumps_is_measured() -> None:
    def plate(x_m: float) -> Box:
        return Box(x_m, 1.0, 0.1, 4.0, 1.5)

    jumping = [look((*YARD, plate(x_m)), number) for number, x_m in enumerate((10.05, 10.35, 10.05))]
    # 10 - 2 x 10.3 + 10 = -0.6; along the beams, which look a little down.
    assert measure("frame_noise", *jumping)[AHEAD] == pytest.approx(0.6, abs=0.06)
    driving = [look((*YARD, plate(x_m)), number) for number, x_m in enumerate((10.05, 10.65, 11.25))]
    assert measure("frame_noise", *driving)[AHEAD] < 0.06
