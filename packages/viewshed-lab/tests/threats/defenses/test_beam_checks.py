"""Checks of ranges, beams and sectors by hand, and of time against a scene whose answer is known."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.threats.corruptions.test_hand_cases import fan

from viewshed.geometry import Rigid
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.scene import Scene, cast
from viewshed_lab.threats.defenses import (
    DEFENSES,
    Defended,
    EmptySectorCheck,
    OneReturnPerBeam,
    RangeValidation,
    TemporalConsistency,
)

MODEL = replace(lidar_model("vlp16"), azimuth_columns=720)


def with_returns(sweep: Sweep, azimuth_deg: list[float], range_m: list[float]) -> Sweep:
    """The sweep and some more returns of ring 0."""
    angle = np.deg2rad(azimuth_deg)
    extra = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * np.array(range_m)[:, None]
    points = np.concatenate([sweep.points, extra.astype(np.float32)])
    return sweep.replace(points=points, ring=np.zeros(len(points), np.int16))


def rows(defended: Defended) -> list[int]:
    return np.flatnonzero(defended.dropped).tolist()


@pytest.mark.parametrize(("model", "kept"), [(None, [1, 2, 3]), (lidar_model("vlp16"), [1, 2])])
def test_ranges_are_the_sensors(model: object, kept: list[int]) -> None:
    points = np.array([[0.1, -0.3, 0.2], [0.0, 0.0, 0.7], [-60, 70, 3], [0, -130, 1], [200, 0, 190]], np.float32)
    found = RangeValidation().apply(Sweep(points, model=model))  # type: ignore[arg-type]
    assert [row for row in range(5) if row not in rows(found)] == kept


def test_of_two_returns_in_a_beam_the_nearest_stays() -> None:
    # Steps are half a degree, beams at the quarter degrees: 10.25, 10.75, ...
    sweep = with_returns(fan(720), [10.25, 10.75, -100.30, -99.5], [35.0, 6.0, 19.0, 5.0])
    beam_of = {10.75: 381, -100.30: 159}
    assert rows(OneReturnPerBeam().apply(sweep)) == sorted([720, beam_of[10.75], beam_of[-100.30]])


def test_a_beam_behind_the_sensor_is_one_beam_on_both_sides_of_the_seam() -> None:
    sweep = with_returns(fan(720), [179.99, -179.99], [9.0, 30.0])
    assert rows(OneReturnPerBeam(0.4).apply(sweep)) == [721]


def test_firing_azimuths_come_before_those_of_the_points() -> None:
    sweep = with_returns(fan(720), [10.25], [35.0])
    azimuth = np.arctan2(sweep.points[:, 1], sweep.points[:, 0])
    azimuth[-1] = np.deg2rad(10.5)  # between two firings, half a step from each
    assert rows(OneReturnPerBeam().apply(sweep.replace(azimuth=azimuth))) == []
    assert rows(OneReturnPerBeam().apply(sweep)) == [720]


def _without_sector(width_deg: float) -> Sweep:
    sweep = fan(7200)
    azimuth = np.rad2deg(np.arctan2(sweep.points[:, 1], sweep.points[:, 0]))
    return sweep.select(np.abs((azimuth - 170 + 180) % 360 - 180) > width_deg / 2)


@pytest.mark.parametrize(("width_deg", "alarm"), [(0, False), (4, False), (6.1, True), (40, True), (360, True)])
def test_an_empty_sector_raises_the_alarm(width_deg: float, alarm: bool) -> None:
    sweep = _without_sector(width_deg)
    found = EmptySectorCheck().apply(sweep)
    assert found.alarm is alarm
    assert found.score == pytest.approx(width_deg / 360, abs=1.1 / 360)
    assert found.sweep.points.tobytes() == sweep.points.tobytes()


SCENE = (Box(25, -6, 2, 60, 9), Box(-14, 12, 8, 4, 3))


def _seen(boxes: tuple[Box, ...], x: float = 0.0) -> Sweep:
    """The scene from (x, -1), heading 0.3 rad to the left in the map."""
    pose = Rigid.from_yaw(0.3, (x, -1.0, 0.0))
    moved = tuple(
        replace(box, x_m=float(local[0]), y_m=float(local[1]), yaw=box.yaw - 0.3)
        for box in boxes
        for local in (pose.inverse() @ np.array([[box.x_m, box.y_m, 0.0]]))
    )
    sweep = cast(MODEL, Scene(boxes=moved, cylinders=()), 1.8)
    return sweep.replace(world_from_sensor=pose)


def _of_box(sweep: Sweep, box: Box) -> NDArray[np.bool_]:
    world = sweep.world_from_sensor @ sweep.points
    inside = (np.abs(world[:, 0] - box.x_m) < box.length_m / 2 + 0.1) & (
        np.abs(world[:, 1] - box.y_m) < box.width_m / 2 + 0.1
    )
    return np.asarray(inside & (world[:, 2] > -1.7), np.bool_)


def test_what_earlier_sweeps_saw_through_goes() -> None:
    newcomer = Box(12, 3, 3, 3, 2.5)
    past = TemporalConsistency((_seen(SCENE), _seen(SCENE, 1.0)))
    now = _seen((*SCENE, newcomer), 2.0)
    found = past.apply(now)
    new = _of_box(now, newcomer)
    assert new.sum() > 100
    # Seen through are those of its returns that have the wall behind, between two rings of the past.
    assert found.dropped[new].mean() > 0.6
    assert not found.dropped[~new].any()
    assert found.score == pytest.approx(found.dropped.mean())


def test_one_sweep_that_saw_the_surface_speaks_against_the_others() -> None:
    newcomer = Box(12, 3, 3, 3, 2.5)
    now = _seen((*SCENE, newcomer), 2.0)
    split = TemporalConsistency((_seen(SCENE), _seen((*SCENE, newcomer), 1.0))).apply(now)
    assert split.dropped.sum() < 0.1 * TemporalConsistency((_seen(SCENE),)).apply(now).dropped.sum()


def test_what_was_hidden_is_not_contradicted() -> None:
    behind = Box(32, -6, 2, 8, 3)
    now = _seen((behind,), 2.0)  # the wall is gone, and what stood behind it shows
    found = TemporalConsistency((_seen((*SCENE, behind)),)).apply(now)
    assert _of_box(now, behind).any()
    assert not found.dropped[_of_box(now, behind)].any()


def test_sweeps_without_poses_are_one_clear_line() -> None:
    sweep = _seen(SCENE)
    with pytest.raises(ValueError, match=r"^every sweep must have a pose to be compared with others, got none; .*$"):
        TemporalConsistency((sweep.replace(world_from_sensor=None),))
    with pytest.raises(ValueError, match=r"^every sweep must have a pose"):
        TemporalConsistency((sweep,)).apply(sweep.replace(world_from_sensor=None))
    assert not DEFENSES["temporal"]().apply(sweep.replace(world_from_sensor=None)).dropped.any()


def test_null_returns_and_other_rings_are_left_alone() -> None:
    sweep = with_returns(fan(720), [10.25, 10.25, 20.25], [0.6, 0.7, 50.0])
    ring = np.array(sweep.ring)
    ring[-1] = 1
    assert rows(OneReturnPerBeam().apply(sweep.replace(ring=ring))) == []


def test_a_few_returns_do_not_fill_a_sector() -> None:
    stray = with_returns(_without_sector(30), [160.0, 168.5, 171.5, 180.0], [20.0, 3.0, 50.0, 7.0])
    near = with_returns(_without_sector(30), np.linspace(155, 185, 600).tolist(), [0.4] * 600)
    assert EmptySectorCheck().apply(stray).alarm
    assert EmptySectorCheck().apply(near).alarm  # the housing's own returns


def test_a_surface_that_the_past_saw_stays() -> None:
    now = _seen(SCENE, 2.0)
    assert not TemporalConsistency((_seen(SCENE), _seen(SCENE, 1.0))).apply(now).dropped.any()
