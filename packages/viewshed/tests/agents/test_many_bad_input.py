"""What a center does with agents that come and go, see nothing, use other grids, flood it, or have broken clocks."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from tests.agents.test_many import AGENTS, CARS, GRID, report, view

from viewshed.agents.many import AgentReport, CommandCenter, CommonPicture, joint_fov
from viewshed.agents.rounds import Round
from viewshed.agents.view_message import MAX_DETECTIONS
from viewshed.detections import Detections
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid

NAMES = ("a", "b", "c")


def follow(center: CommandCenter, said: list[list[AgentReport]], hz: float = 2.0) -> list[CommonPicture]:
    return [center.add(number / hz, reports) for number, reports in enumerate(said)]


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


def test_no_report_is_an_answer_too() -> None:
    pictures = follow(CommandCenter(NAMES), [[], [report(AGENTS[0], CARS)], [], []])
    assert [len(picture.tracks) > 0 for picture in pictures][:2] == [False, True]
    assert not pictures[-1].reporters.any()


def test_a_replayed_time_is_refused_and_the_next_one_taken() -> None:
    center = CommandCenter(NAMES)
    honest = [report(agent, CARS) for agent in AGENTS]
    for number in range(4):
        center.add(86_400.0 + number, honest)
    with pytest.raises(ValueError, match=r"must rise, got 3\.000 s after 86403\.000 s"):
        center.add(3.0, honest)
    assert center.add(86_404.0, honest).believed.sum() == 2


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


def odd(kind: str) -> tuple[list[AgentReport], str]:
    """Return what three agents say where something is odd and nobody lies, and the note about it."""
    said, apart = [report(agent, CARS) for agent in AGENTS], ""
    match kind:
        case "a class that nobody knows":
            said[0] = replace(said[0], detections=replace(said[0].detections, kinds=np.full(len(CARS), 200, np.uint8)))
        case "views without objects":
            said = [report(agent, CARS[:0]) for agent in AGENTS]
        case "one agent only":
            said, apart = said[:1], "a alone is heard: nobody contradicts it"
        case "agents that never overlap":
            said = [
                report(view(name, 500.0 * k), CARS + 500.0 * k * np.eye(7)[0]) for k, name in enumerate(("a", "b", "c"))
            ]
            apart = "a, b, c: farther than 100 m from all others, so that nobody contradicts it"
    return said, apart


def test_a_center_of_one_agent_says_that_nobody_contradicts_it() -> None:
    [*_, last] = follow(CommandCenter(("a",)), [[report(AGENTS[0], CARS)]] * 4)
    done = Round.of(last)
    assert done.sentences() == ["a alone is heard: nobody contradicts it"]
    assert not (done.accused | done.disputed).any()


@pytest.mark.parametrize(
    "kind", ["a class that nobody knows", "views without objects", "one agent only", "agents that never overlap"]
)
def test_what_is_odd_is_noted_and_nobody_is_accused(kind: str) -> None:
    said, note = odd(kind)
    done = [Round.of(picture) for picture in follow(CommandCenter(NAMES), [said] * 8)]
    assert not any((each.accused | each.disputed).any() for each in done)
    assert done[-1].sentences() == ([note] if note else [])
    cars = {"views without objects": 0, "agents that never overlap": 6}
    assert done[-1].picture.believed.sum() == cars.get(kind, 2)
