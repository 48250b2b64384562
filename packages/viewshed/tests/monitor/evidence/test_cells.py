"""What the cells of the last ten seconds contradict, and beams with new ranges: lengths, areas and shares by hand."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.monitor.evidence.drives import PLATE, YARD, leveled, look, sector_at

from viewshed.geometry import Rigid
from viewshed.monitor.evidence import EVIDENCE, CellMemory, MonitoredSweep
from viewshed.monitor.evidence.cells import MIN_SWEEPS
from viewshed.monitor.evidence.history import view_of
from viewshed.monitor.stream_monitor import EvidenceStream
from viewshed.sweep import Sweep
from viewshed_lab.sim import Box

SWEEPS = 30
"""Sweeps of the past: three seconds."""


def after(boxes: Sequence[Box], count: int = SWEEPS, step_m: float = 0.1) -> EvidenceStream:
    """Return the stream of a sensor that drove by ``step_m`` a sweep among boxes."""
    stream, rng = EvidenceStream(), np.random.default_rng(0)
    for number in range(count):
        stream.add(leveled(look(boxes, number, step_m * number, rng)))
    return stream


def measured(stream: EvidenceStream, name: str, sweep: Sweep) -> NDArray[np.float32]:
    """Return what one kind of evidence says (SECTORS,) of the next sweep."""
    found: NDArray[np.float32] = stream.measure(leveled(sweep))[list(EVIDENCE).index(name)]
    return found


def test_a_plate_that_stood_and_is_gone_has_its_width() -> None:
    plate = replace(PLATE, x_m=PLATE.x_m + 0.25)  # not on the border of two rows of cells
    stream = after((*YARD, plate), step_m=0.0)
    gone = measured(stream, "gone", look(YARD, SWEEPS))
    # 4 m in cells of half a meter, of which those at its ends are cut.
    assert gone.sum() == pytest.approx(4.0, abs=0.5)
    assert gone[sector_at(90.0)] == 0.0
    assert measured(stream, "gone", look((*YARD, plate), SWEEPS)).max() == 0.0


def test_a_plate_out_of_nowhere_has_its_area() -> None:
    stream = after(YARD)
    x_m = 0.1 * SWEEPS
    found = measured(stream, "out_of_nowhere", look((*YARD, replace(PLATE, x_m=x_m + 10.0)), SWEEPS, x_m))
    assert found.sum() == pytest.approx(4.0 * 1.2, rel=0.25)
    assert found[sector_at(90.0)] == 0.0


def test_what_was_there_before_is_no_wonder_when_it_comes_back() -> None:
    stream = after((*YARD, PLATE), step_m=0.0)
    for number in range(SWEEPS, SWEEPS + 3):
        stream.add(leveled(look(YARD, number)))
    assert measured(stream, "out_of_nowhere", look((*YARD, PLATE), SWEEPS + 3)).max() == 0.0


def test_a_parked_car_may_drive_off_but_not_vanish() -> None:
    car = Box(12.0, -4.0, 4.5, 1.8, 1.5)
    vanished = measured(after((*YARD, car), step_m=0.0), "gone", look(YARD, SWEEPS)).sum()
    stream, rng, found = after((*YARD, car), step_m=0.0), np.random.default_rng(1), []
    for number in range(SWEEPS, SWEEPS + 20):
        since_s = 0.1 * (number - SWEEPS)
        sweep = look((*YARD, replace(car, x_m=car.x_m + 1.5 * since_s**2)), number, rng=rng)  # 3 m/s²
        found.append(measured(stream, "gone", sweep).sum())
        stream.add(leveled(sweep))
    assert max(found) < 0.3 * vanished


def test_a_stream_remembers_a_second_at_least_and_needs_poses() -> None:
    young = after(YARD, MIN_SWEEPS - 1)
    assert np.isnan(measured(young, "gone", look(YARD, MIN_SWEEPS, 1.2))).all()
    stream = after(YARD)
    assert np.isnan(measured(stream, "gone", look(YARD, SWEEPS).replace(world_from_sensor=None))).all()
    assert np.isnan(EVIDENCE["gone"].measure(MonitoredSweep(leveled(look(YARD))))).all()


def test_a_copy_goes_on_by_itself_and_what_is_looked_through_is_forgotten() -> None:
    memory = CellMemory()
    for number in range(15):
        memory.add(leveled(look((*YARD, PLATE), number)))
    branch, cells = memory.copy(), memory._cells.cells
    for number in range(15, 23):
        branch.add(leveled(look(YARD, number)))
    # A plate of 4 m is in eight or nine cells, and the walls behind it are seen for the first time.
    assert memory._cells.cells == cells
    assert (memory.sweeps, branch.sweeps) == (15, 23)
    monitored = MonitoredSweep(leveled(look(YARD, 23)), (leveled(look(YARD, 22)),), branch)
    assert EVIDENCE["gone"].measure(monitored).max() == 0.0


def test_far_from_where_it_began_the_memory_begins_anew() -> None:
    memory = CellMemory()
    for number in range(3):
        memory.add(leveled(look(YARD, number)))
    memory.add(leveled(look(YARD, 3, 3000.0)))
    assert memory.sweeps == 1


def test_a_pose_that_jumps_out_of_the_world_is_answered() -> None:
    stream = after(YARD)
    jumped = look(YARD, SWEEPS).replace(world_from_sensor=Rigid(np.eye(3), np.array([1e9, -1e9, 0.0])))
    assert np.isnan(measured(stream, "gone", jumped)).all()
    view, far = view_of(leveled(look(YARD))), np.full((3, 4), 1e8, np.float32)
    assert view is not None
    with pytest.raises(ValueError, match="transforms must be less than 1e7"):
        stream._memory._cells.add(view, far, far, 0.0)
    with pytest.raises(ValueError, match="turned must have one value for each view"):
        view.new_ranges([view], [], 72)


def _without(sweep: Sweep, degrees: float, half: float) -> Sweep:
    azimuth = np.rad2deg(np.arctan2(sweep.points[:, 1], sweep.points[:, 0]))
    kept = np.abs(azimuth - degrees) > half
    assert sweep.ring is not None
    assert sweep.azimuth is not None
    return sweep.replace(points=sweep.points[kept], ring=sweep.ring[kept], azimuth=sweep.azimuth[kept])


def test_beams_that_fall_silent_are_found_on_the_ground_as_well() -> None:
    stream = after(YARD, step_m=0.0)
    now = _without(look(YARD, SWEEPS), 90.0, 17.5)
    lost = measured(stream, "no_return", now)
    assert lost[sector_at(90.0)] > 0.95
    assert lost[sector_at(45.0)] == 0.0


@pytest.mark.parametrize("silent", range(3))
def test_beams_that_were_silent_in_any_of_three_sweeps_before_are_not_lost_now(silent: int) -> None:
    stream = EvidenceStream()
    for number in range(3):
        sweep = look(YARD, number)
        stream.add(leveled(_without(sweep, 90.0, 17.5) if number == silent else sweep))
    assert measured(stream, "no_return", _without(look(YARD, 3), 90.0, 17.5))[sector_at(90.0)] == 0.0


def test_where_a_turning_sweep_begins_no_beam_is_lost() -> None:
    # The sensor turns by 8.6° in a revolution, so 8.6° behind it are not looked at.
    stream = after(YARD, 5, 0.0)
    now = look(YARD, 5, yaw=0.15)
    azimuth = np.arctan2(now.points[:, 1], now.points[:, 0])
    gap = np.abs(azimuth) > np.pi - 0.075
    assert now.ring is not None
    assert now.azimuth is not None
    turning = now.replace(
        points=now.points[~gap], ring=now.ring[~gap], azimuth=now.azimuth[~gap],
        time_s=((azimuth[~gap] + np.pi) / (2 * np.pi) * 0.1).astype(np.float32),
    )  # fmt: skip
    assert measured(stream, "no_return", turning).max() < 0.1
    still = turning.replace(world_from_sensor=look(YARD, 5).world_from_sensor)
    assert measured(stream, "no_return", still).max() > 0.12


@pytest.mark.parametrize(("name", "degrees", "share"), [("nearer", 30.0, 0.6), ("farther", -30.0, 0.6)])
def test_ranges_that_are_new_in_a_narrow_room(name: str, degrees: float, share: float) -> None:
    # Cover is near everywhere, so no speed is suspicious; half of the beams of a wedge are won.
    room = (Box(5.0, 0.0, 0.2, 10.0, 4.0), Box(-5.0, 0.0, 0.2, 10.0, 4.0), Box(0.0, 5.0, 10.0, 0.2, 4.0),
            Box(0.0, -5.0, 10.0, 0.2, 4.0))  # fmt: skip
    stream, now = after(room, step_m=0.0), look(room, SWEEPS)
    azimuth = np.rad2deg(np.arctan2(now.points[:, 1], now.points[:, 0]))
    won = (np.abs(azimuth - degrees) < 15.0) & (np.random.default_rng(3).random(len(now)) < share)
    factor = np.where(won, 0.5 if name == "nearer" else 1.8, 1.0).astype(np.float32)
    found = measured(stream, name, now.replace(points=now.points * factor[:, None]))
    assert found[sector_at(degrees)] == pytest.approx(share, abs=0.15)
    assert found[sector_at(degrees + 90.0)] == 0.0
    assert measured(stream, "arrival", now).max() < 5.0


def test_a_sensor_that_turns_sees_no_new_ranges() -> None:
    stream, rng = EvidenceStream(), np.random.default_rng(0)
    for number in range(10):
        stream.add(leveled(look(YARD, number, 0.0, rng, yaw=0.1 * number)))
    sweep = look(YARD, 10, 0.0, rng, yaw=1.0)
    assert max(measured(stream, name, sweep).max() for name in ("nearer", "farther")) < 0.1
    otherwise = sweep.replace(world_from_sensor=look(YARD, 9, yaw=0.5).world_from_sensor)
    assert measured(stream, "nearer", otherwise).max() > 0.15


def test_who_passes_near_by_makes_no_new_ranges_but_a_far_thing_that_is_gone_does() -> None:
    # A truck beside the sensor drives on by 1 m in each sweep: it covers, and uncovers, 15° at once.
    def truck(x_m: float) -> Box:
        return Box(x_m, 3.5, 8.0, 2.0, 3.0)

    stream = EvidenceStream()
    for number in range(3):
        stream.add(leveled(look((*YARD, truck(number - 4.0)), number)))
    passing = look((*YARD, truck(-1.0)), 3)
    assert max(measured(stream, name, passing).max() for name in ("nearer", "farther")) < 0.1
    before = EvidenceStream()
    plate = Box(12.0, 1.0, 0.2, 8.0, 4.0)
    for number in range(3):
        before.add(leveled(look((*YARD, plate), number)))
    assert measured(before, "farther", look(YARD, 3))[sector_at(6.0)] > 0.3
