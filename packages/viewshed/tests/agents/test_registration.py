"""Poses put right within their stated errors: by surfaces that others see, and never farther than they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.agents.test_view_evidence import honest

from viewshed.agents.many import AgentReport, registered
from viewshed.agents.registration import MAX_STD_M, MAX_YAW_STD, REACH, UNSTATED, PoseStd, registered_poses
from viewshed.detections import Detections
from viewshed.fov.estimate import FovEstimate
from viewshed.geometry import Rigid
from viewshed.sweep import Sweep

STD = PoseStd(0.2, float(np.radians(0.5)))

EXACT = [honest("a", 0.0, 0.0, 1.0), honest("b", 2.0, 5.0, 0.3), honest("c", -6.0, -3.0, 2.0)]


def moved(view: FovEstimate, x_m: float, y_m: float, yaw: float = 0.0) -> FovEstimate:
    """Return a view that says it is somewhere else."""
    pose = Rigid(np.eye(3), np.array([x_m, y_m, 0.0])) @ view.world_from_level @ Rigid.from_yaw(yaw)
    return replace(view, world_from_level=pose)


def off_m(pose: Rigid, view: FovEstimate) -> float:
    return float(np.linalg.norm(pose.translation - view.world_from_level.translation))


def test_a_pose_that_is_off_within_its_stated_errors_comes_back() -> None:
    wrong = moved(EXACT[0], 0.3, -0.2, np.radians(0.6))
    poses = registered_poses([wrong, *EXACT[1:]], [STD, PoseStd(), PoseStd()])
    assert off_m(poses[0], wrong) > 0.1
    assert off_m(poses[0], EXACT[0]) < 0.6 * off_m(wrong.world_from_level or poses[0], EXACT[0])
    assert poses[1] is EXACT[1].world_from_level  # who states no errors stays


def test_no_error_stated_no_pose_moved() -> None:
    wrong = moved(EXACT[0], 0.5, 0.0)
    assert registered_poses([wrong, *EXACT[1:]], [PoseStd()] * 3)[0] is wrong.world_from_level
    assert registered_poses([wrong], [STD])[0] is wrong.world_from_level


def test_nobody_moves_farther_by_stating_larger_errors() -> None:
    wrong = moved(EXACT[0], 3.0, 0.0)
    for std in (STD, PoseStd(50.0, 1.0)):
        pose = registered_poses([wrong, *EXACT[1:]], [std, PoseStd(), PoseStd()])[0]
        assert off_m(pose, wrong) <= REACH * min(std.place_m, MAX_STD_M) * np.sqrt(2) + 1e-9
        turn = pose.yaw - (wrong.world_from_level or pose).yaw
        assert abs(turn) <= REACH * min(std.yaw, MAX_YAW_STD) + 1e-9
    assert off_m(pose, EXACT[0]) > 1.0  # a pose 3 m off stays one that is off


def test_the_deviations_of_a_covariance_are_those_of_place_and_heading() -> None:
    covariance = np.diag([0.04, 0.01, 9.0, 9.0, 9.0, 1e-4])
    std = PoseStd.of(covariance)
    assert (std.place_m, std.yaw) == pytest.approx((0.2, 0.01))
    with pytest.raises(ValueError, match="finite and not negative"):
        PoseStd(-1.0, 0.0)
    with pytest.raises(ValueError, match="finite numbers, got nan"):
        PoseStd.of(np.diag([0.04, np.nan, 9.0, 9.0, 9.0, 1e-4]))
    with pytest.raises(ValueError, match=r"must have no negative eigenvalue, got -0\.04"):
        PoseStd.of(np.diag([-0.04, 0.01, 9.0, 9.0, 9.0, 1e-4]))


def test_what_a_sweep_takes_for_a_covariance_has_deviations() -> None:
    rounded = np.diag([1e-6, 0.0, -5e-10, 0.0, 0.0, 0.0])
    stated = PoseStd.stated_by(Sweep(np.ones((1, 3), np.float32), pose_covariance=rounded))
    assert stated.place_m == pytest.approx(1e-3)


def test_reports_keep_all_but_their_poses() -> None:
    wrong = moved(EXACT[0], 0.3, -0.2)
    said = [
        AgentReport.of(wrong, Detections.none(), STD),
        *(AgentReport.of(one, Detections.none()) for one in EXACT[1:]),
    ]
    right = registered(said)
    assert right[0].agent == "a"
    assert np.array_equal(right[0].estimate.state, wrong.state)
    assert right[0].world_from_level is not wrong.world_from_level
    assert right[1] is said[1]


def test_a_pose_is_as_certain_as_its_sweep_states_and_its_turn_as_usual_where_only_a_place_is_stated() -> None:
    sweep = Sweep(np.ones((1, 3), np.float32))
    assert PoseStd.stated_by(sweep) == UNSTATED
    place = np.diag([0.04, 0.09, 0.01, 0.0, 0.0, 0.0])
    stated = PoseStd.stated_by(sweep.replace(pose_covariance=place))
    assert stated.place_m == pytest.approx(0.3)
    assert stated.yaw == UNSTATED.yaw
    both = PoseStd.stated_by(sweep.replace(pose_covariance=place + np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 0.0025])))
    assert both.yaw == pytest.approx(0.05)
