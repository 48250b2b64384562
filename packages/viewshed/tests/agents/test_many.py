"""Many agents: one picture of what they report, who is believed, and what they see together."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from viewshed.agents.honest import honest_model
from viewshed.agents.many import (
    LOOK_S,
    AgentReport,
    CommandCenter,
    CommonPicture,
    chances,
    confirmed,
    joint_fov,
    match_agents,
)
from viewshed.agents.rounds import NO_OBJECTS, Round
from viewshed.agents.trust import QUESTIONS, SCENE_S
from viewshed.agents.view_message import MAX_DETECTIONS, SensorFacts, ViewMessage
from viewshed.cli.fuse import note_gaps
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


NAMES = ("a", "b", "c")


def follow(center: CommandCenter, said: list[list[AgentReport]]) -> list[CommonPicture]:
    return [center.add(0.5 * number, reports) for number, reports in enumerate(said)]


def run(said: list[list[np.ndarray]], *, trusting: bool = False) -> list[CommonPicture]:
    """Return the pictures of what three agents report, time after time."""
    reports = [
        [report(agent, boxes, standing=CARS) for agent, boxes in zip(AGENTS, each, strict=True)] for each in said
    ]
    return follow(CommandCenter(NAMES, trusting=trusting), reports)


def test_what_all_report_is_one_track_each_and_believed() -> None:
    [*_, last] = run([[CARS] * 3] * 6)
    assert last.believed.sum() == 2
    assert last.reporters[last.believed].all()
    assert last.reported.all()
    places = last.tracks.boxes[last.believed][:, :2]
    assert np.linalg.norm(places[:, None] - CARS[None, :, :2], axis=2).min(axis=0).max() < 0.2
    assert not last.verdicts.suspects.any()


def withheld(said: list[list[AgentReport]]) -> np.ndarray:
    """Return the evidence (T, A) that agents withhold objects."""
    pictures = follow(CommandCenter(NAMES), said)
    return np.array([picture.verdicts.answers[:, QUESTIONS.index("withheld")] for picture in pictures])


def test_who_withholds_what_it_had_reported_is_told_by_how_long() -> None:
    """All report both cars; then c leaves one out for some looks, of which the first may be its detector's miss."""
    honest = [report(agent, CARS) for agent in AGENTS]
    without = [*honest[:2], report(AGENTS[2], CARS[:1], standing=CARS)]
    evidence = withheld([honest] * 5 + [without] * 6 + [honest] * 13)
    assert (evidence[:, :2] < 0.0).all()
    assert (np.diff(evidence[4:9, 2]) > -0.2).all()
    assert evidence[10, 2] > evidence[5, 2] + 0.5
    # What spoke against it counts for as long as the scenes of the limits last.
    looks = round(SCENE_S / LOOK_S)
    assert evidence[10 + looks - 1, 2] > 0.0
    assert evidence[10 + looks, 2] < 0.0
    # Where its view shows that the place is empty now, it says less.
    gone = withheld([honest] * 5 + [[*honest[:2], report(AGENTS[2], CARS[:1])]] * 6)
    assert gone[-1, 2] < evidence[10, 2]
    # Not yet known: reported once.
    assert (withheld([honest] + [without] * 6)[-1] <= 0.0).all()


def test_looks_are_counted_and_not_reports() -> None:
    honest = [report(agent, CARS) for agent in AGENTS]
    without = [*honest[:2], report(AGENTS[2], CARS[:1], standing=CARS)]
    center, often = CommandCenter(NAMES), CommandCenter(NAMES)
    for look in range(10):
        said = honest if look < 5 else without
        slow = center.add(0.5 * look, said)
        for part in range(5):
            fast = often.add(0.5 * look + 0.1 * part, said)
    assert np.abs(slow.said.silent - fast.said.silent).max() <= 1
    assert np.abs(slow.said.before - fast.said.before).max() <= 2  # of 10 looks and 50 reports


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
    assert len(last.existence) == 2
    assert last.believed.all()
    assert last.verdicts.evidence.argmax() == 0


def test_the_own_vehicle_is_no_missing_object() -> None:
    own = np.array([[0.0, 0.0, 0.8, 4.8, 2.0, 1.6, 0.0]])
    agent = AgentReport.of(AGENTS[0], Detections.none())
    assert agent.own_box is not None
    assert chances([agent], own, honest_model())[0] == 0.0
    there = AgentReport.of(AGENTS[1], Detections.none()).is_own(own + np.array([[4.0, -9.0, 0, 0, 0, 0, 0], [0] * 7]))
    assert there.tolist() == [True, False]
    assert chances([AgentReport(AGENTS[0], Detections.none())], CARS, honest_model()).min() > 0.5


def test_detections_of_two_agents_are_matched_one_to_one() -> None:
    shifted = CARS.copy()
    shifted[:, 0] += 0.5
    beside = CARS[:1] + np.array([0.0, 3.0, 0, 0, 0, 0, 0])
    near = np.concatenate([CARS, beside])
    members = match_agents([found(CARS), found(shifted), found(near)])
    assert members.tolist() == [[0, 0, 0], [1, 1, 1], [-1, -1, 2]]
    assert match_agents([Detections.none(), Detections.none()]).shape == (0, 2)
    # A third is matched with the mean of two, 1.5 m ahead of the first; the gate is 4 m.
    for ahead_m in (-2.4, 5.4):
        places = [found(CARS[:1] + np.array([x_m, 0, 0, 0, 0, 0, 0])) for x_m in (0.0, 3.0, ahead_m)]
        assert match_agents(places).tolist() == [[0, 0, 0]]


def test_reports_of_strangers_doubles_and_the_past_are_refused() -> None:
    center = CommandCenter(("a", "b"))
    with pytest.raises(ValueError, match="must be of a, b"):
        center.add(0.0, [report(view("z"), CARS)])
    with pytest.raises(ValueError, match="one each"):
        center.add(0.0, [report(view("a"), CARS), report(view("a"), CARS)])
    center.add(1.0, [report(view("a"), CARS)])
    for t_s, words in ((1.0, "must increase"), (0.5, r"must increase, got 0\.500 s after 1\.000 s")):
        with pytest.raises(ValueError, match=words):
            center.add(t_s, [report(view("a"), CARS)])
    assert len(center.add(1.5, [report(view("a"), CARS)]).tracks) == 2
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
    # Not a distrusted one by a low threshold, not a probability in cells that are called hidden, not two doubts.
    low, odd = replace(views[1], threshold=0.01), replace(views[1], state=views[2].state)
    doubts = [view("d", visible=0.45), view("e", visible=0.45)]
    for said, trust in (([views[2], low], [1.0, 0.05]), ([views[2], odd], [1.0, 1.0]), (doubts, [1.0, 1.0])):
        joint = joint_fov(said, GRID, Rigid.identity(), np.array(trust))
        assert not joint.estimate().visible().any()
        assert not joint.seen_by.any()
        assert (joint.state == CellState.HIDDEN).all()
    assert not confirmed(view("f", y_m=20.0), np.ones(GRID.shape, bool), [odd], np.ones(1), 0.5).visible().any()
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
    picture = follow(CommandCenter(NAMES), [[report(AGENTS[0], CARS), report(AGENTS[1], CARS), above]] * 6)[-1]
    assert not picture.deniers.any()
    assert not picture.verdicts.suspects.any()
    assert picture.verdicts.trust.min() > 0.8


def test_an_agent_that_appears_and_vanishes_each_second_harms_nobody() -> None:
    honest = [report(agent, CARS) for agent in AGENTS]
    said = [honest[: 3 if number // 2 % 2 else 2] for number in range(24)]
    pictures = follow(CommandCenter(NAMES), said)
    assert not any(picture.verdicts.suspects.any() for picture in pictures)
    assert pictures[-1].believed.sum() == 2
    assert (pictures[-1].verdicts.trust > 0.8).all()


def test_who_sees_nothing_is_no_liar() -> None:
    nothing = FovEstimate(
        GRID, np.zeros(GRID.shape, np.float32), np.full(GRID.shape, CellState.UNKNOWN, np.uint8), agent="c",
        world_from_level=Rigid.identity(),
    )  # fmt: skip
    said = [[report(AGENTS[0], CARS), report(AGENTS[1], CARS), AgentReport(nothing, Detections.none())]] * 8
    last = follow(CommandCenter(NAMES), said)[-1]
    assert not last.verdicts.suspects.any()
    assert last.believed.sum() == 2


def test_views_of_other_grids_are_put_together() -> None:
    coarse = BevGrid(16, 32.0)
    other = replace(
        view("b"), grid=coarse, visible_prob=np.ones(coarse.shape, np.float32),
        state=np.full(coarse.shape, CellState.FREE, np.uint8), std=None,
    )  # fmt: skip
    joint = joint_fov([view("a", visible=0.0), other], GRID, Rigid.identity())
    assert (joint.surest == 1).all()
    last = follow(CommandCenter(("a", "b")), [[report(view("a"), CARS), report(other, CARS)]] * 4)[-1]
    assert last.believed.sum() == 2
    assert Round.of(last).joint.grid.cell_m == 1.0
    third = replace(other, agent="c")
    last = follow(CommandCenter(NAMES), [[report(one, CARS) for one in (view("a"), other, third)]])[-1]
    assert Round.of(last).joint.grid.cell_m == 4.0


def test_one_agent_can_neither_fill_the_tracks_nor_end_a_round() -> None:
    """One of three reports 500 boxes of its own, with as many returns as a number holds."""
    x, y = np.meshgrid(np.arange(-30.0, 30.0, 2.4), np.arange(-30.0, 30.0, 3.0))
    boxes = np.column_stack([x.ravel(), y.ravel(), np.tile([0.8, 0.9, 0.9, 1.6, 0.0], (x.size, 1))])
    flood = report(AGENTS[2], np.concatenate([CARS, boxes]), standing=CARS)
    many = replace(flood.detections, returns=np.full(x.size + 2, np.iinfo(np.int32).max, np.int32))
    flood = replace(flood, detections=many)
    honest = [report(agent, CARS) for agent in AGENTS[:2]]
    late = CARS + np.array([4.0, 6.0, 0, 0, 0, 0, 0])
    [*_, last] = follow(CommandCenter(NAMES), [[*honest, flood]] * 4 + [[*honest[:1], report(AGENTS[1], late), flood]])
    assert last.notes[0].startswith("c: 3")
    assert "objects that no other agent reports are left out" in last.notes[0]
    for cars, agent in ((CARS, 0), (late, 1)):
        near = np.linalg.norm(last.tracks.boxes[:, None, :2] - cars[None, :, :2], axis=2) < 2.0
        assert (near & last.reporters[:, [agent]]).any(axis=0).all()


def test_no_report_is_an_answer_too() -> None:
    pictures = follow(CommandCenter(NAMES), [[], [report(AGENTS[0], CARS)], [], []])
    assert [len(picture.tracks) > 0 for picture in pictures][:2] == [False, True]
    assert not pictures[-1].reporters.any()
    assert not any(picture.notes for picture in pictures)


def test_as_many_objects_as_a_message_holds_take_a_bounded_time() -> None:
    rng = np.random.default_rng(3)
    flood = np.tile(CARS[:1], (MAX_DETECTIONS, 1))
    flood[:, :2] = rng.uniform(-28.0, 28.0, (MAX_DETECTIONS, 2))
    center = CommandCenter(NAMES)
    said = [report(AGENTS[0], CARS), report(AGENTS[1], CARS), report(AGENTS[2], flood)]
    center.add(0.0, said)
    begin = time.process_time()
    picture = center.add(0.5, said)
    assert time.process_time() - begin < 2.0
    assert len(picture.tracks) <= 2 * MAX_DETECTIONS


ODD = (
    "a class that nobody knows", "views without objects", "one agent only", "a center of one agent",
    "agents that never overlap",
)  # fmt: skip


def odd(kind: str) -> tuple[list[AgentReport], str]:
    """Return what three agents say where something is odd and nobody lies, and the note about it."""
    said, apart = [report(agent, CARS) for agent in AGENTS], ""
    match kind:
        case "a class that nobody knows":
            said[0] = replace(said[0], detections=replace(said[0].detections, kinds=np.full(len(CARS), 200, np.uint8)))
        case "views without objects":
            said, apart = [report(agent, CARS[:0]) for agent in AGENTS], NO_OBJECTS
        case "one agent only" | "a center of one agent":
            said, apart = said[:1], "a alone is heard: nobody contradicts it"
        case "agents that never overlap":
            said = [report(view(name, 500.0 * k), CARS + 500.0 * k * np.eye(7)[0]) for k, name in enumerate(NAMES)]
            apart = "a, b, c: farther than 100 m from all others, so that nobody contradicts it"
    return said, apart


@pytest.mark.parametrize("kind", ODD)
def test_what_is_odd_is_noted_once_and_nobody_is_accused(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    said, note = odd(kind)
    center = CommandCenter(NAMES[:1] if kind == "a center of one agent" else NAMES)
    done = [Round.of(picture) for picture in follow(center, [said] * 8)]
    assert not any((each.accused | each.disputed).any() for each in done)
    assert done[-1].sentences() == done[-1].numbers()["notes"] == ([note] if note else [])
    note_gaps(done[-2], None)
    note_gaps(done[-1], done[-2])
    assert capsys.readouterr().err == (f"viewshed: note: {note}\n" if note else "")
    cars = {"views without objects": 0, "agents that never overlap": 6}
    assert done[-1].picture.believed.sum() == cars.get(kind, 2)
