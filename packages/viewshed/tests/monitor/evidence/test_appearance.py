"""Things that stand, or are gone, where beams passed: areas and speeds by hand."""

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.monitor.evidence.drives import PLATE, YARD, look, measure, sector_at

from viewshed.sweep import Sweep
from viewshed_lab.sim import Box

_COLUMNS = 1084

AHEAD = sector_at(6.0)
"""The middle of the plate: y = 1 at x = 10."""


def _ring_and_column(sweep: Sweep) -> list[tuple[int, int]]:
    """Return the pixel of each return."""
    assert sweep.ring is not None
    assert sweep.azimuth is not None
    columns = np.rint((sweep.azimuth + np.pi) * (_COLUMNS / (2 * np.pi)))
    return [(int(ring), int(column)) for ring, column in zip(sweep.ring, columns, strict=True)]


def _kept(sweep: Sweep, kept: NDArray[np.bool_]) -> Sweep:
    assert sweep.ring is not None
    assert sweep.azimuth is not None
    return sweep.replace(points=sweep.points[kept], ring=sweep.ring[kept], azimuth=sweep.azimuth[kept])


def test_a_plate_that_appears_has_its_area() -> None:
    values = measure("seen_through", look(YARD, 0), look((*YARD, PLATE), 1))
    # 4 m wide, from 0.3 m to 1.5 m high; the five sectors around its middle hold all of it.
    assert values[AHEAD] == pytest.approx(4.0 * 1.2, rel=0.25)
    assert values[sector_at(90.0)] == 0.0


def test_a_plate_that_appears_must_have_been_fast() -> None:
    values = measure("arrival", look(YARD, 0), look((*YARD, PLATE), 1))
    # The nearest cover is what the sensor cannot see, 2.5 m around it: 7.5 m to 7.9 m in a tenth of a second.
    assert 70.0 < values[AHEAD] < 80.0
    assert values[sector_at(90.0)] == 0.0


def test_who_came_two_sweeps_ago_is_remembered() -> None:
    sweeps = [look(YARD, 0), *(look((*YARD, PLATE), number) for number in (1, 2))]
    assert measure("seen_through", *sweeps).max() == 0.0
    assert 70.0 < measure("arrival", *sweeps)[AHEAD] < 80.0


def test_a_plate_that_vanishes_is_the_reverse() -> None:
    sweeps = look((*YARD, PLATE), 0), look(YARD, 1)
    assert measure("vanished", *sweeps)[AHEAD] == pytest.approx(4.0 * 1.2, rel=0.25)
    assert 70.0 < measure("departure", *sweeps)[AHEAD] < 80.0
    assert measure("seen_through", *sweeps).max() == 0.0


@pytest.mark.parametrize(("speed_mps", "share"), [(15.0, 0.0), (45.0, 1.0)])
def test_a_car_across_counts_by_the_speed_that_it_needs(speed_mps: float, share: float) -> None:
    # 1.2 m of its height stand where the last sweep looked through, and came from next to it.
    driven_m = 0.1 * speed_mps
    cars = [Box(12.0, y_m, 1.8, 4.5, 1.5) for y_m in (-4.0, driven_m - 4.0)]
    sweeps = [look((*YARD, car), number) for number, car in enumerate(cars)]
    # The part farthest from where the car was needs all of that speed, the nearest hardly any.
    most_m2 = share * driven_m * 1.2
    for name in ("seen_through", "vanished"):
        assert 0.1 * most_m2 <= measure(name, *sweeps).max() <= most_m2 + 0.05
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
    assert measure("seen_through", *(look(boxes, number, 2.0 * number) for number in range(3))).max() < 0.3
    values = measure("seen_through", look(YARD, 0, 0.0), look(boxes, 1, 2.0))
    assert values[sector_at(7.0)] == pytest.approx(4.0 * 1.2, rel=0.25)


def test_beams_that_fall_silent_are_lost() -> None:
    before, now = look(YARD, 0), look(YARD, 1)
    azimuth = np.rad2deg(np.arctan2(now.points[:, 1], now.points[:, 0]))
    kept = np.abs(azimuth - 90.0) > 12.5
    values = measure("lost_view", before, _kept(now, kept))
    assert values[sector_at(90.0)] == 1.0
    assert values[sector_at(60.0)] == 0.0


def test_what_a_window_hides_is_not_lost() -> None:
    # A low wall comes before another one; beams above it and at its glass return nothing.
    before, near = look(YARD, 0), look((*YARD, Box(0.0, 4.0, 6.0, 0.2, 1.0)), 1)
    azimuth = np.rad2deg(np.arctan2(near.points[:, 1], near.points[:, 0]))
    kept = (np.abs(azimuth - 90.0) > 30.0) | (near.points[:, 1] < 5.0)
    assert measure("lost_view", before, _kept(near, kept))[sector_at(90.0)] == 0.0


def test_a_surface_that_jumps_is_measured() -> None:
    def plate(x_m: float) -> Box:
        return Box(x_m, 1.0, 0.1, 4.0, 1.5)

    jumping = [look((*YARD, plate(x_m)), number) for number, x_m in enumerate((10.05, 10.35, 10.05))]
    # 10 - 2 x 10.3 + 10 = -0.6; along the beams, which look a little down.
    assert measure("frame_noise", *jumping)[AHEAD] == pytest.approx(0.6, abs=0.06)
    driving = [look((*YARD, plate(x_m)), number) for number, x_m in enumerate((10.05, 10.65, 11.25))]
    assert measure("frame_noise", *driving)[AHEAD] < 0.06


def test_where_a_turning_sweep_begins_nothing_is_lost() -> None:
    # The sensor turns by 8.6° in a revolution, so 8.6° behind it are not looked at.
    before, now = look(YARD, 0), look(YARD, 1, yaw=0.15)
    azimuth = np.arctan2(now.points[:, 1], now.points[:, 0])
    gap = np.abs(azimuth) > np.pi - 0.075
    turning = _kept(now, ~gap).replace(time_s=((azimuth[~gap] + np.pi) / (2 * np.pi) * 0.1).astype(np.float32))
    assert measure("lost_view", before, turning).max() < 0.3
    assert measure("lost_view", before, turning.replace(world_from_sensor=before.world_from_sensor)).max() > 0.5
