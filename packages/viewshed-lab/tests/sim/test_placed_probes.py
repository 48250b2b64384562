"""Placed probes against geometry by hand, and the exact truth against placed probes."""

import numpy as np
import pytest
from placed_probes import (
    GAP_M,
    REASONS,
    Boxes,
    Setting,
    apart,
    free_of,
    meets,
    place,
    plates,
    reason,
    with_boxes,
)

from viewshed import CAR, PEDESTRIAN, BevGrid, Target
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed_lab.sim.assets.shapes import Box, Cylinder, Ellipsoid
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import Motion
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.sim.world import Thing, World

MODEL = LidarModel("test", np.deg2rad(np.linspace(-24, 6, 32)), azimuth_columns=900, max_range_m=80.0)
GROUND = Terrain.of(np.linspace(-60, 60, 25), np.linspace(-60, 60, 25), lambda x, y: 0.3 * np.sin(x / 8) + 0.02 * y)
WORLD = World(
    "test", GROUND,
    (
        Thing("wall", (Box(0, 0, 0.6, 14, 5),), 12, 3, 0.2), Thing("car", (Box(0, 0, 4.2, 1.8, 1.5),), -6, 6, 0.7),
        Thing("pole", (Cylinder(0, 0, 0.15, 6),), 6, -9), Thing("bus", (Box(0, 0, 11, 2.5, 3),), -14, -9, 1.1),
        Thing("tree", (Ellipsoid(0, 0, 3, 3, 5, 2), Cylinder(0, 0, 0.2, 2.5)), 9, 16),
    ),
)  # fmt: skip
GRID = BevGrid(128, 32.0)
MOVING = Motion((5.0, 1.0, 0.0), 0.2, 0.1)


def _setting() -> Setting:
    height = float(GROUND.at(np.array([[1.0, -1.0]]))[0]) + 1.8
    snapshot = WORLD.snapshot(0.0)
    scan = cast_world(snapshot, MODEL, Rigid.from_yaw(0.4, (1.0, -1.0, height)), MOVING, seed=3)
    return Setting(snapshot, scan, 3, *exact_truth(scan, WORLD, GRID))


def _box(x: float, y: float, yaw: float = 0.0, sizes: tuple[float, float, float] = (2.0, 1.0, 1.0)) -> Boxes:
    ground = float(GROUND.at(np.array([[x, y]]))[0])
    return Boxes(
        np.zeros((1, 2), int), np.array([[x, y, ground + sizes[2] / 2]]), np.array([yaw]), np.array([sizes]) / 2
    )


@pytest.mark.parametrize("target", [CAR, PEDESTRIAN])
def test_truth_and_placed_probes_say_the_same(target: Target) -> None:
    setting = _setting()
    probes = place(setting, target, 900, np.random.default_rng(0))
    assert len(probes.agree) > 500
    assert 0.1 < (probes.met >= target.min_returns).mean() < 0.9
    assert probes.agree.mean() >= 0.985
    different = np.flatnonzero(~probes.agree)
    assert all(reason(setting, probes.boxes.select(np.array([k])), target) in REASONS[:3] for k in different)


def test_a_truth_of_a_mirrored_scene_does_not_agree() -> None:
    setting = _setting()
    mirrored = setting.truth.visible(CAR)[:, ::-1]
    probes = place(setting, CAR, 600, np.random.default_rng(0))
    cells = probes.boxes.cell
    assert (mirrored[cells[:, 0], cells[:, 1]] == (probes.met >= CAR.min_returns)).mean() < 0.95


def test_beams_on_a_probe_are_those_of_its_solid_angle() -> None:
    """A wall of 4 m across the line of sight, 10 m before a still sensor on level ground, nothing else."""
    world = World("flat", Terrain.plane(60.0))
    model = LidarModel("test", np.deg2rad(np.arange(-20.0, 21.0)), azimuth_columns=720, max_range_m=80.0)
    scan = cast_world(world.snapshot(0.0), model, Rigid.from_yaw(0.0, (0.0, 0.0, 2.0)))
    setting = Setting(world.snapshot(0.0), scan, 0, *exact_truth(scan, world, GRID))
    wall = Boxes(np.zeros((1, 2), int), np.array([[10.5, 0.0, 1.5]]), np.zeros(1), np.array([[0.5, 2.0, 1.5]]))
    azimuth = np.arange(720) * 0.5 - 179.75
    columns = np.abs(10 * np.tan(np.deg2rad(azimuth))) < 2.0
    columns &= np.abs(azimuth) < 90
    rise = np.tan(np.deg2rad(np.arange(-20.0, 21.0)))[None] * 10 / np.cos(np.deg2rad(azimuth))[:, None]
    inside = columns[:, None] & (rise > -2.0) & (rise < 1.0)
    assert meets(setting, wall).tolist() == [int(inside.sum())]


def test_added_boxes_leave_all_other_beams_as_they_were() -> None:
    setting = _setting()
    box = _box(8.0, -2.0)
    snapshot = with_boxes(setting.snapshot, box, 99)
    scan = cast_world(snapshot, MODEL, setting.scan.world_from_sensor, setting.scan.motion, setting.seed)
    same = scan.thing != 99
    assert (~same).sum() > 10
    np.testing.assert_array_equal(scan.depth_m[same], setting.scan.depth_m[same])


def test_probes_that_would_touch_something_are_not_placed() -> None:
    snapshot = WORLD.snapshot(0.0)
    c, s = np.cos(0.7), np.sin(0.7)
    for gap, free in ((GAP_M + 0.02, True), (GAP_M - 0.02, False), (-0.3, False)):
        off = 0.9 + 0.5 + gap
        assert free_of(snapshot, _box(-6 - s * off, 6 + c * off, 0.7)).tolist() == [free]
    assert free_of(snapshot, _box(-6, 6, sizes=(0.1, 0.1, 0.1))).tolist() == [False]
    assert free_of(snapshot, _box(10.6, 16)).tolist() == [True]
    assert free_of(snapshot, _box(10.4, 16, sizes=(2.0, 1.0, 2.5))).tolist() == [False]


def test_a_moving_solid_keeps_probes_further_away() -> None:
    thing = WORLD.snapshot(0.0)
    moving = World("one", GROUND, (WORLD.things[1],)).snapshot(0.0)
    fast = type(moving)(
        moving.terrain, moving.kind, moving.center_m, moving.rotation, moving.half_m,
        moving.velocity_mps + np.array([10.0, 0.0, 0.0]), moving.material, moving.thing,
    )  # fmt: skip
    box = _box(-6 - np.sin(0.7) * 1.8, 6 + np.cos(0.7) * 1.8, 0.7)
    assert free_of(thing, box, 0.1).tolist() == [True]
    assert free_of(fast, box, 0.1).tolist() == [False]


def test_probes_of_one_cast_never_share_a_beam() -> None:
    setting = _setting()
    cells = np.argwhere(setting.known)[::37]
    boxes = plates(setting.scan, setting.snapshot, GRID, CAR, cells)
    rows = apart(setting.scan, boxes, 30)
    assert 5 < len(rows) <= 30
    together = meets(setting, boxes.select(rows))
    alone = [int(meets(setting, boxes.select(np.array([row])))[0]) for row in rows]
    assert together.tolist() == alone


def test_a_plate_stands_across_the_line_of_sight_with_its_back_in_the_cell() -> None:
    setting = _setting()
    cells = np.array([[100, 90], [20, 40]])
    boxes = plates(setting.scan, setting.snapshot, GRID, CAR, cells)
    pose = setting.scan.world_from_sensor
    for k, cell in enumerate(cells):
        x, y = GRID.centers[tuple(cell)]
        center = Rigid.from_yaw(0.4, pose.translation) @ np.array([x, y, 0.0])
        away = (center - pose.translation)[:2] / np.hypot(x, y)
        np.testing.assert_allclose(boxes.center_m[k, :2] + away * 0.25, center[:2], atol=1e-9)
        np.testing.assert_allclose([np.cos(boxes.yaw[k]), np.sin(boxes.yaw[k])], away, atol=1e-9)
    np.testing.assert_allclose(boxes.half_m * 2, [[0.5, 1.8, 1.52]] * 2)
