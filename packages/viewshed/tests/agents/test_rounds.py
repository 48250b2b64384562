"""Reports as they come in: rounds end with the last agent, and what is late, unknown or new is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.agents.test_many import AGENTS, CARS, report

from viewshed.agents.rounds import Round, Rounds


def heard(rounds: Rounds, said: list[tuple[float, int]]) -> list[list[Round]]:
    """Return the rounds that each report (time, agent) ends; all agents see the same cars."""
    return [rounds.add(t_s, report(AGENTS[agent], CARS)) for t_s, agent in said]


def test_a_round_ends_with_the_last_of_those_that_were_heard() -> None:
    rounds = Rounds()
    ended = heard(rounds, [(0.0, 0), (0.0, 1), (0.0, 2), (0.5, 0), (0.5, 1), (0.5, 2), (1.0, 0), (1.0, 1)])
    assert [len(each) for each in ended] == [0, 0, 0, 1, 0, 1, 0, 0]
    [last] = rounds.close()
    assert [each.picture.t_s for each in (*ended[3], *ended[5], last)] == [0.0, 0.5, 1.0]
    assert [len(each.reports) for each in (*ended[3], *ended[5], last)] == [3, 3, 2]
    assert ended[5][0].picture.agents == ("a", "b", "c")
    numbers = last.numbers()
    assert set(numbers["agents"]) == {"a", "b", "c"}
    assert numbers["objects"][0]["reported_by"] == ["a", "b"]
    assert last.missing == ("c",)
    assert rounds.notes == ["c: heard lately and missing at 1.00 s; check clocks and links"]


def test_named_agents_end_the_first_round_and_others_are_left_out() -> None:
    rounds = Rounds(agents=("a", "b"))
    assert [len(each) for each in heard(rounds, [(0.0, 0), (0.0, 1), (0.5, 2)])] == [0, 1, 0]
    assert rounds.notes == ["c: is none of a, b, its report is left out"]


def test_one_that_was_away_is_waited_for_again() -> None:
    rounds = Rounds()
    said = [(0.0, 0), (0.0, 1), (0.5, 0), (0.5, 1), (2.5, 0), (3.0, 0), (3.0, 1)]
    assert [len(each) for each in heard(rounds, said)] == [0, 0, 1, 1, 1, 1, 0]
    assert rounds.notes == ["b: its report is late and left out"]
    assert [len(each) for each in heard(rounds, [(3.5, 0), (3.5, 1)])] == [0, 1]


def test_who_comes_in_is_told_and_time_that_goes_back_begins_anew() -> None:
    rounds = Rounds()
    heard(rounds, [(5.0, 0), (5.0, 1), (5.5, 0), (5.5, 1), (6.0, 0), (6.0, 2)])
    heard(rounds, [(6.0, 1)])
    assert rounds.notes == ["c came in: at the prior, the others keep their records"]
    heard(rounds, [(0.0, 0)])
    assert rounds.notes == ["time went back: the center begins anew"]


def test_who_contradicts_two_others_is_told() -> None:
    ghosts = np.repeat(CARS[:1], 24, axis=0)
    ghosts[:, 0] += np.arange(24) % 12 * 5.0 - 35.0
    ghosts[:, 1] -= np.arange(24) // 12 * 7.0 + 10.0
    rounds, done = Rounds(), list[Round]()
    for time in range(20):
        for agent, boxes in zip(AGENTS, (CARS, CARS, np.concatenate([CARS, ghosts])), strict=True):
            done += rounds.add(0.5 * time, report(agent, boxes))
    last = done[-1]
    assert last.picture.verdicts.trust.argmin() == 2
    assert last.picture.verdicts.evidence.argmax() == 2
    told = replace(last, accused=np.array([False, False, True]), disputed=np.array([True, True, False]))
    assert told.sentences() == [
        "c contradicts the others: its reports count little",
        "a, b: one of them lies, and no third view says which",
    ]  # fmt: skip
    assert told.numbers()["agents"]["c"]["accused"]
    joint = told.joint
    assert joint.agents == ("a", "b", "c")
    assert joint.seen_by.max() in {2, 3}
    # It lies about the middle of the agents, turned like the world, and holds the views of all.
    np.testing.assert_allclose(joint.world_from_grid.translation[:2], [-1 / 3, -13 / 3], atol=1e-9)
    np.testing.assert_array_equal(joint.world_from_grid.rotation, np.eye(3))
