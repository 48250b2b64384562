from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from shapely import Polygon

from viewshed import BevGrid
from viewshed.arrays import F64
from viewshed.detections import ObjectKind, moved_boxes
from viewshed.fov.estimate import FovEstimate
from viewshed.geometry import Rigid
from viewshed.objects.association import inside
from viewshed.objects.detection_table import detection_table
from viewshed.objects.matching import corners_of
from viewshed.objects.views import (
    BeamView,
    GridView,
    PolygonView,
    SeesAll,
    View,
    hidden_within,
)
from viewshed.preprocess.evidence import expected_returns
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Scene, cast

GRID = BevGrid(64, 32.0)

POSE = Rigid.from_yaw(2.0, (300.0, -40.0, 0.0))

CAR = np.array([[12.0, 5.0, 0.75, 4.0, 2.0, 1.5, 0.3]])

KINDS = np.array([ObjectKind.CAR], np.uint8)


def _estimate(prob: F64, pose: Rigid | None = None) -> FovEstimate:
    return FovEstimate(GRID, prob.astype(np.float32), np.zeros(GRID.shape, np.uint8), world_from_level=pose)


def _leveled(pose: Rigid | None, *boxes: Box) -> LeveledSweep:
    model = LidarModel("test", np.deg2rad(np.linspace(-20, 6, 40)), azimuth_columns=1200, max_range_m=100.0)
    sweep = cast(model, Scene(boxes=boxes), 1.84)
    if pose is not None:
        sweep = sweep.replace(world_from_sensor=Rigid(pose.rotation, pose.translation + np.array([0.0, 0.0, 1.84])))
    return level(sweep, GRID)


@cache
def _all_views(pose: Rigid | None) -> list[View]:
    x, y = GRID.centers[..., 0], GRID.centers[..., 1]
    estimate = _estimate(1.0 / (1.0 + np.exp((x + 2 * y - 20.0) / 4.0)), pose)
    return [
        PolygonView.of(estimate, 0.0),
        GridView(estimate, 0.0),
        BeamView(_leveled(pose, Box(10, 3, 4, 2, 3)), 0.0),
    ]


def test_without_a_pose_tracks_are_in_the_level_frame_and_the_view_says_so() -> None:
    assert [view.in_world for view in _all_views(None)] == [False] * 3
    assert [view.in_world for view in _all_views(POSE)] == [True] * 3


@given(st.lists(st.tuples(st.floats(-25, 25), st.floats(-25, 25), st.floats(-3, 3)), min_size=1, max_size=5))
def test_views_of_one_sweep_say_the_same_in_both_frames(places: list[tuple[float, float, float]]) -> None:
    boxes = np.array([[x, y, 0.75, 4.0, 2.0, 1.5, yaw] for x, y, yaw in places])
    # Cells and counts jump where a place moves by a rounding error: off the edges of cells.
    boxes[:, :2] = np.floor(boxes[:, :2]) + 0.4
    within = np.full(len(boxes), 3.0)
    kinds = np.repeat(KINDS, len(boxes))
    moved = moved_boxes(boxes, POSE)
    for here, there in zip(_all_views(None), _all_views(POSE), strict=True):
        np.testing.assert_allclose(here.visible(boxes), there.visible(moved), atol=0.21)
        np.testing.assert_allclose(here.detectable(boxes, kinds), there.detectable(moved, kinds), atol=0.21)
        # The places about a box are others in another frame.
        assert here.hides_near(boxes, within).shape == there.hides_near(moved, within).shape == (len(boxes),)


def test_every_view_answers_for_no_boxes() -> None:
    none = np.zeros((0, 7))
    for view in [*_all_views(POSE), SeesAll(0.0)]:
        assert view.visible(none).shape == (0,)
        assert view.detectable(none, np.zeros(0, np.uint8)).shape == (0,)
        assert view.hides_near(none, np.zeros(0)).shape == (0,)


def test_a_polygon_is_asked_at_the_center() -> None:
    view = PolygonView(Polygon([(0, 0), (12.1, 0), (12.1, 10), (0, 10)]), None, 0.0)
    boxes = np.concatenate([CAR, CAR + np.array([0.2, 0, 0, 0, 0, 0, 0])])
    assert view.visible(boxes).tolist() == [1.0, 0.0]
    assert view.hides_near(boxes[:1], np.array([0.05])).tolist() == [0.0]
    assert view.hides_near(boxes[:1], np.array([0.5])).tolist() == [1.0]


def test_a_grid_gives_the_mean_of_five_lines_of_sight() -> None:
    """What lies left of the line of sight to the middle is hidden: two of the five."""
    azimuth = np.arctan2(GRID.centers[..., 1], GRID.centers[..., 0])
    middle = np.arctan2(5.0, 12.0)
    prob = np.where(azimuth > middle, 0.0, 1.0)
    visible = GridView(_estimate(prob), 0.0).visible(CAR)[0]
    assert visible == pytest.approx(0.6)
    assert GridView(_estimate(0.6 * prob), 0.0).visible(CAR)[0] == pytest.approx(0.36)


@given(st.floats(-8, 8), st.floats(-8, 8), st.floats(-3, 3), st.floats(0.5, 6), st.floats(0.5, 3))
def test_a_grid_is_asked_a_cell_before_each_line_of_sight_meets_the_box(
    x: float, y: float, yaw: float, length: float, width: float
) -> None:
    """Lines are walked in steps of 5 mm; probabilities rise evenly, so that the cell does not matter."""
    grid = BevGrid(256, 12.8)
    prob = 0.5 + grid.centers @ np.array([0.015, 0.02])
    box = np.array([[x, y, 0.75, length, width, 1.5, yaw]])
    visible = GridView(FovEstimate(grid, prob, np.ones(grid.shape, np.uint8)), 0.0).visible(box)[0]
    if inside(np.zeros((1, 2)), box + np.array([0, 0, 0, 0.05, 0.05, 0, 0]))[0, 0]:
        assert visible == pytest.approx(0.5, abs=0.005)
        return
    m = np.arctan2(y, x)
    corners = corners_of(box)[0] @ Rigid.from_yaw(m).rotation[:2, :2]
    across = np.arctan2(corners[:, 1], corners[:, 0])
    range_m = np.arange(0.0, 20.0, 0.005)
    met = []
    for part in (0.1, 0.3, 0.5, 0.7, 0.9):
        azimuth = m + across.min() + part * np.ptp(across)
        way = np.array([np.cos(azimuth), np.sin(azimuth)])
        first_m = range_m[inside(range_m[:, None] * way, box)[0].argmax()]
        met.append(0.5 + max(first_m - grid.cell_m, 0.0) * way @ np.array([0.015, 0.02]))
    assert visible == pytest.approx(np.mean(met), abs=0.005)


def test_beams_see_a_box_as_if_its_own_returns_were_not_there() -> None:
    """A car in view, one behind a wall, and one that would stand where another hides it."""
    view = BeamView(_leveled(None, Box(12, 5, 4, 2, 1.5, yaw=0.3), Box(12, -6, 1, 8, 3)), 0.0)
    boxes = np.array([CAR[0], [20.0, -10.0, 0.75, 4.0, 2.0, 1.5, 0.0], [18.0, 7.5, 0.75, 4.0, 2.0, 1.5, 0.3]])
    visible = view.visible(boxes)
    assert visible[0] > 0.99
    assert visible[1] < 0.01
    assert visible[2] < visible[0]


def test_a_detectors_table_and_the_view_multiply_to_the_table() -> None:
    def found(expected: F64, range_m: F64, kinds: NDArray[np.uint8]) -> F64:
        assert expected.shape == range_m.shape == kinds.shape
        return np.where(range_m < 20.0, 0.8, 0.3) * (expected > 0)

    leveled = _leveled(POSE, Box(12, 5, 4, 2, 1.5, yaw=0.3))
    view = BeamView(leveled, 0.0, found=found)
    boxes = moved_boxes(np.concatenate([CAR, CAR + np.array([12.0, 6, 0, 0, 0, 0, 0])]), POSE)
    kinds = np.repeat(KINDS, 2)
    product = view.visible(boxes) * view.detectable(boxes, kinds)
    np.testing.assert_allclose(product, np.minimum([0.8, 0.3], view.visible(boxes)), atol=1e-6)
    assert view.false_odds(boxes, kinds) is None


def test_a_view_of_beams_knows_the_packages_detector_unless_told_of_another() -> None:
    leveled, table = _leveled(POSE, Box(12, 5, 4, 2, 1.5, yaw=0.3)), detection_table()
    view, boxes, kinds = BeamView(leveled, 0.0), moved_boxes(CAR, POSE), KINDS
    counts, range_m = expected_returns(leveled, CAR, leave_out_own=True).astype(float), np.hypot(CAR[:, 0], CAR[:, 1])
    product = view.visible(boxes) * view.detectable(boxes, kinds)
    np.testing.assert_allclose(product, np.minimum(table.prob(counts, range_m, kinds), view.visible(boxes)), atol=1e-3)
    np.testing.assert_allclose(view.false_odds(boxes, kinds), table.false_odds(range_m, kinds), rtol=1e-6)


def test_hidden_within_finds_a_narrow_shadow_and_no_farther_one() -> None:
    x = GRID.centers[..., 0]
    view = GridView(_estimate(np.where(x > 20.0, 0.0, 1.0)), 0.0)
    near, far = hidden_within(
        view, np.repeat(CAR + np.array([0, -5.0, 0, 0, 0, 0, 0]), 2, axis=0), np.array([3.0, 12.0])
    )
    assert (near, far) == (0.0, 1.0)
