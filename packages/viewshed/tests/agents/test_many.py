"""Many agents: one picture of what they report, who is believed, and what they see together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from viewshed.agents.honest import honest_model
from viewshed.agents.many import AgentReport, CommandCenter, CommonPicture, chances, confirmed, joint_fov, match_agents
from viewshed.agents.trust import QUESTIONS
from viewshed.agents.view_message import SensorFacts, ViewMessage
from viewshed.detections import Detections
from viewshed.fov.estimate import Basis, CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed_lab.threats.view_attacks import with_objects

GRID = BevGrid(64, 32.0)

CARS = np.array([[12.0, 3.0, 0.8, 4.2, 1.8, 1.5, 0.0], [-8.0, 9.0, 0.8, 4.2, 1.8, 1.5, 1.0]])


def view(agent: str, x_m: float = 0.0, y_m: float = 0.0, yaw: float = 0.0, visible: float = 1.0) -> FovEstimate:
    """Return a view that claims the same everywhere."""
    state = CellState.FREE if visible >= 0.5 else CellState.HIDDEN
    turn = Rigid.from_yaw(yaw)
    return FovEstimate(
        GRID, np.full(GRID.shape, visible, np.float32), np.full(GRID.shape, state, np.uint8), agent=agent,
        world_from_level=Rigid(turn.rotation, np.array([x_m, y_m, 0.0])),
    )  # fmt: skip


def found(boxes: np.ndarray) -> Detections:
    return Detections(boxes, np.full(len(boxes), 3, np.uint8), np.full(len(boxes), 50, np.int32))


def report(estimate: FovEstimate, boxes: np.ndarray, *, standing: np.ndarray | None = None) -> AgentReport:
    """Return the report of an agent that sees boxes of the world; the surfaces of its view are those that stand there.

    None are those of the boxes.
    """
    level = estimate.world_from_level.inverse()
    surfaces = found(boxes if standing is None else standing).moved(level).boxes
    return AgentReport(with_objects(estimate, surfaces), found(boxes).moved(level))


AGENTS = [view("a"), view("b", 4.0, -9.0, 0.5), view("c", -5.0, -4.0, 2.0)]


def run(said: list[list[np.ndarray]], *, trusting: bool = False) -> list[CommonPicture]:
    """Return the pictures of what three agents report, time after time."""
    center = CommandCenter(("a", "b", "c"), trusting=trusting)
    return [
        center.add(
            0.5 * time, [report(agent, boxes, standing=CARS) for agent, boxes in zip(AGENTS, reports, strict=True)]
        )
        for time, reports in enumerate(said)
    ]


def test_what_all_report_is_one_track_each_and_believed() -> None:
    [*_, last] = run([[CARS] * 3] * 6)
    assert last.believed.sum() == 2
    assert last.reporters[last.believed].all()
    places = last.tracks.boxes[last.believed][:, :2]
    assert np.linalg.norm(places[:, None] - CARS[None, :, :2], axis=2).min(axis=0).max() < 0.2
    assert not last.verdicts.suspects.any()


def test_who_withholds_what_its_own_view_holds_is_told_by_how_long() -> None:
    """All report both cars; then c leaves one out for four looks, of which the first may be its detector's miss."""
    said = [[CARS] * 3] * 5 + [[CARS, CARS, CARS[:1]]] * 4 + [[CARS] * 3]
    withheld = [picture.verdicts.answers[:, QUESTIONS.index("withheld")].tolist() for picture in run(said)]
    assert withheld[4:] == [[0.0, 0.0, each] for each in (0.0, 0.0, 1.0, 2.0, 3.0, 0.0)]
    # Not yet known: reported once.
    early = run([[CARS] * 3] + [[CARS, CARS, CARS[:1]]] * 4)
    assert not early[-1].verdicts.answers[:, QUESTIONS.index("withheld")].any()


def test_who_no_longer_holds_a_surface_withholds_nothing() -> None:
    center = CommandCenter(("a", "b", "c"))
    for time in range(9):
        seen = CARS if time < 5 else CARS[:1]
        said = [report(AGENTS[0], CARS), report(AGENTS[1], CARS), report(AGENTS[2], seen)]
        answers = center.add(0.5 * time, said).verdicts.answers
    assert not answers[:, QUESTIONS.index("withheld")].any()


def test_what_one_invents_and_two_deny_is_not_believed_and_it_is_suspected() -> None:
    ghost = np.array([[6.0, -6.0, 0.8, 4.2, 1.8, 1.5, 0.0], [14.0, -12.0, 0.8, 4.2, 1.8, 1.5, 0.0]])
    said = [[CARS, CARS, np.concatenate([CARS, ghost])]] * 8
    [*_, last] = run(said)
    assert last.verdicts.suspects.tolist() == [False, False, True]
    near = np.linalg.norm(last.tracks.boxes[:, None, :2] - ghost[None, :, :2], axis=2).min(axis=1, initial=99.0) < 2.0
    assert not last.believed[near].any()
    assert last.believed.sum() == 2
    [*_, trusting] = run(said, trusting=True)
    assert trusting.tracks.confirmed.sum() >= 2


def test_what_one_conceals_stays_and_it_is_suspected() -> None:
    said = [[CARS, CARS, CARS]] * 2 + [[CARS[:0], CARS, CARS]] * 8
    [*_, last] = run(said)
    # Its own view holds something there; in the scenes of the model about half of what is denied so is no object.
    assert len(last.existence) == 2
    assert last.existence.min() > 0.4
    assert last.verdicts.evidence.argmax() == 0


def test_the_own_vehicle_is_no_missing_object() -> None:
    own = np.array([[0.0, 0.0, 0.8, 4.8, 2.0, 1.6, 0.0]])
    agent = AgentReport.of(AGENTS[0], Detections.none())
    assert agent.own_box is not None
    assert chances([agent], own, honest_model())[0] == 0.0
    assert chances([AgentReport(AGENTS[0], Detections.none())], CARS, honest_model()).min() > 0.5


def test_detections_of_two_agents_are_matched_one_to_one() -> None:
    shifted = CARS.copy()
    shifted[:, 0] += 0.5
    beside = CARS[:1] + np.array([0.0, 3.0, 0, 0, 0, 0, 0])
    near = np.concatenate([CARS, beside])
    members = match_agents([found(CARS), found(shifted), found(near)])
    assert members.tolist() == [[0, 0, 0], [1, 1, 1], [-1, -1, 2]]
    assert match_agents([Detections.none(), Detections.none()]).shape == (0, 2)


def test_reports_of_strangers_doubles_and_the_past_are_refused() -> None:
    center = CommandCenter(("a", "b"))
    with pytest.raises(ValueError, match="must be of a, b"):
        center.add(0.0, [report(view("z"), CARS)])
    with pytest.raises(ValueError, match="one each"):
        center.add(0.0, [report(view("a"), CARS), report(view("a"), CARS)])
    center.add(1.0, [report(view("a"), CARS)])
    with pytest.raises(ValueError, match="must rise"):
        center.add(1.0, [report(view("a"), CARS)])
    with pytest.raises(ValueError, match="must have a pose"):
        AgentReport(replace(view("a"), world_from_level=None), Detections.none())


def test_a_mast_that_says_nothing_for_a_time_is_judged_as_a_mast() -> None:
    mast = replace(AGENTS[1], basis=Basis(8.0, "estimated", 0.9, 0.0, 0.0, 60.0))
    center = CommandCenter(("a", "b"))
    both = center.add(0.0, [report(AGENTS[0], CARS), report(mast, CARS)])
    alone = center.add(0.5, [report(AGENTS[0], CARS)])
    assert both.elevated.tolist() == alone.elevated.tolist() == [False, True]


def test_a_message_says_on_what_the_sensor_stands_and_how_well_its_place_is_known() -> None:
    covariance = np.diag([0.04, 0.04, 0.01, 1e-4, 1e-4, 4e-4])
    sent = ViewMessage(
        "b", 1, 10**18, "map", AGENTS[1].world_from_level or Rigid.identity(), covariance,
        SensorFacts("lidar", 8.0, 60.0), view=AGENTS[1], detections=found(CARS),
    )  # fmt: skip
    mast = AgentReport.of_message(sent)
    assert mast.elevated
    heights = (1.8, 4.1, 8.0, 20.0)
    said = [AgentReport.of_message(replace(sent, sensor=SensorFacts("lidar", height, 60.0))) for height in heights]
    assert [each.height for each in said] == [0, 1, 1, 2]
    assert mast.own_box is None
    assert (mast.pose_std.place_m, mast.pose_std.yaw) == pytest.approx((0.2, 0.02))
    car = AgentReport.of_message(replace(sent, sensor=SensorFacts("lidar", 1.8), detections=None))
    assert car.own_box is not None
    assert len(car.detections) == 0
    with pytest.raises(ValueError, match="must have a view"):
        AgentReport.of_message(replace(sent, view=None))


def test_the_joint_view_is_what_any_trusted_agent_sees() -> None:
    views = [view("a", visible=0.5), view("b", visible=0.9, y_m=20.0), view("c", visible=0.0)]
    joint = joint_fov(views, GRID, Rigid.identity())
    assert joint.visible_prob[32, 50] == pytest.approx(1 - 0.5 * 0.1, abs=1e-6)
    assert joint.visible_prob[32, 2] == pytest.approx(0.5, abs=1e-6)
    assert joint.seen_by[32, 50] == 2
    assert joint.surest[32, 50] == 1
    assert joint.state[32, 50] == CellState.FREE
    doubted = joint_fov(views, GRID, Rigid.identity(), np.array([1.0, 0.1, 1.0]))
    assert doubted.surest[32, 50] == 0
    hidden = joint_fov(views[2:], GRID, Rigid.identity())
    assert (hidden.state == CellState.HIDDEN).all()
    with pytest.raises(ValueError, match="must be of 3 views"):
        joint_fov(views, GRID, Rigid.identity(), np.ones(2))


def test_a_second_view_confirms_only_where_a_trusted_agent_sees() -> None:
    wedge = np.zeros(GRID.shape, bool)
    wedge[:, 32:] = True
    own, other = view("a"), view("b", y_m=40.0)
    kept = confirmed(own, wedge, [other], np.array([0.9]), 0.5)
    assert (kept.state[:, :32] == CellState.FREE).all()  # outside of the doubtful cells nothing is asked
    assert (kept.state[:, 40:] == CellState.FREE).all()  # the other grid begins at y = 8 m
    assert (kept.state[:, 32:40] == CellState.UNKNOWN).all()
    assert not kept.visible()[:, 32:40].any()
    third = view("c", y_m=44.0)
    both = confirmed(own, wedge, [other, third], np.array([0.9, 0.9]), 0.5, votes=2)
    assert (both.state[:, 48:] == CellState.FREE).all()  # the third grid begins at y = 12 m
    assert (both.state[:, 32:44] == CellState.UNKNOWN).all()
    alone = confirmed(own, wedge, [other], np.array([0.3]), 0.5)
    assert (alone.state[:, 32:] == CellState.UNKNOWN).all()


def test_what_stands_on_a_deck_is_nothing_that_those_below_deny() -> None:
    """One agent drives 6 m above two others: each reports what is on its own level, and nobody is a liar."""
    raised = CARS + np.array([0.0, 0.0, 6.0, 0, 0, 0, 0]) + np.array([9.0, -9.0, 0, 0, 0, 0, 0])
    pose = Rigid(np.eye(3), np.array([2.0, 1.0, 6.0]))
    above = report(replace(view("c"), world_from_level=pose), raised)
    center = CommandCenter(("a", "b", "c"))
    for time in range(6):
        picture = center.add(0.5 * time, [report(AGENTS[0], CARS), report(AGENTS[1], CARS), above])
    assert not picture.deniers.any()
    assert not picture.verdicts.suspects.any()
    assert picture.verdicts.trust.min() > 0.8
