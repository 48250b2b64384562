"""Reports as they come in: rounds end with the last agent, whatever clocks and delays are; what is odd is told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.agents.test_many import AGENTS, CARS, GRID, report, view

from viewshed.agents.many import AgentReport
from viewshed.agents.registration import PoseStd
from viewshed.agents.rounds import WHY, Round, Rounds
from viewshed.agents.trust import QUESTIONS, trust_limits
from viewshed.cli.fuse import line_of
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid

BEGIN_S, HZ = 1.76e9, 2.0

GHOSTS = np.repeat(CARS[:1], 24, axis=0)
GHOSTS[:, 0] += np.arange(24) % 12 * 5.0 - 35.0
GHOSTS[:, 1] -= np.arange(24) // 12 * 7.0 + 10.0


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
    assert rounds.notes == ["c: heard recently, missing at 1.00 s; check clocks and links"]


@pytest.mark.parametrize(("apart_s", "sizes"), [(0.099, [2]), (0.101, [1, 1])])
def test_reports_up_to_a_tenth_of_a_second_apart_are_of_one_round(apart_s: float, sizes: list[int]) -> None:
    rounds = Rounds()
    ended = heard(rounds, [(0.0, 0), (apart_s, 1)])
    assert [len(each.reports) for each in [*ended[0], *ended[1], *rounds.close()]] == sizes


def test_named_agents_end_the_first_round_and_others_are_left_out() -> None:
    rounds = Rounds(agents=("a", "b"))
    assert [len(each) for each in heard(rounds, [(0.0, 0), (0.0, 1), (0.5, 2)])] == [0, 1, 0]
    assert rounds.notes == ["c: is not one of a, b, its report is left out"]


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
    assert rounds.notes == ["c joined: its trust starts at the prior, the others keep theirs"]
    heard(rounds, [(0.0, 0), (0.0, 1)])
    assert rounds.notes == ["time went back: the center starts over"]


def test_one_time_that_goes_back_begins_nothing_anew() -> None:
    """One old time stamp among those of three leaves out that report alone; a clock that stays behind, all of its."""
    rounds = Rounds()
    heard(rounds, [(0.5 * k, agent) for k in range(8) for agent in range(3)])
    heard(rounds, [(4.0, 0), (4.0, 1), (2.4, 2)])
    assert rounds.notes[:1] == ["c: its time went back, that of others did not; its report is left out"]
    said = [(0.5 * k - 1.5 * (agent == 2), agent) for k in range(9, 17) for agent in range(3)]
    done = [each for ended in heard(rounds, said) for each in ended]
    assert len(done) >= 6
    assert all({"a", "b"} <= {one.agent for one in each.reports} for each in done)
    # A drive after another, of another agent, begins anew.
    done = [each for ended in heard(rounds, [(0.2 * k, 2) for k in range(10)]) for each in ended]
    assert [each.picture.agents for each in done] == [("c",)] * len(done) != []


@pytest.mark.parametrize("half_extent_m", [1e300, 1e-300])
def test_a_grid_that_reaches_nowhere_or_everywhere_costs_no_round(half_extent_m: float) -> None:
    rounds, odd = Rounds(agents=("a", "b", "c")), replace(view("c"), grid=BevGrid(64, half_extent_m))
    heard(rounds, [(0.0, 0), (0.0, 1)])
    rounds.add(0.0, AgentReport(odd, report(AGENTS[0], CARS).detections))
    assert rounds.notes == [f"c: its grid must reach 1 to 10000 m, got {half_extent_m:g} m; its report is left out"]
    assert [len(each.reports) for each in rounds.close()] == [2]


def test_who_contradicts_two_others_is_told() -> None:
    rounds, done = Rounds(), list[Round]()
    for time in range(20):
        for agent, boxes in zip(AGENTS, (CARS, CARS, np.concatenate([CARS, GHOSTS])), strict=True):
            done += rounds.add(0.5 * time, report(agent, boxes))
    last = done[-1]
    assert last.picture.verdicts.trust.argmin() == 2
    assert last.picture.verdicts.evidence.argmax() == 2
    told = replace(last, accused=np.array([False, False, True]), disputed=np.array([True, True, False]))
    assert told.sentences() == [
        "c is accused: its reports contradict the others; its reports count little",
        "a, b: one of them lies, and no third view says which",
    ]  # fmt: skip
    assert told.numbers()["agents"]["c"]["accused"]
    assert told.numbers()["notes"] == told.sentences()
    assert line_of(told).endswith("ACCUSED c (its reports contradict the others); disputed a, b")
    for question, name in enumerate(QUESTIONS):  # what is highest beyond usual, not what has most nats
        answers = np.array(trust_limits().usual[told.picture.elevated.astype(int)])
        answers[2, question] += 5.0 * trust_limits().spread[0, question]
        verdicts = replace(told.picture.verdicts, answers=answers)
        assert replace(told, picture=replace(told.picture, verdicts=verdicts)).reasons() == {"c": WHY[name]}
    joint = told.joint
    assert joint.agents == ("a", "b", "c")
    assert joint.seen_by.max() in {2, 3}
    # It lies about the middle of the agents, turned like the world, and holds the views of all.
    np.testing.assert_allclose(joint.world_from_grid.translation[:2], [0.0, -4.0], atol=1e-9)
    np.testing.assert_array_equal(joint.world_from_grid.rotation, np.eye(3))
    # One that is far away, or whose cells are large, makes it neither coarse nor moves it.
    *others, third = told.reports
    coarse = replace(third, estimate=replace(third.estimate, grid=replace(GRID, half_extent_m=1e300)))
    for liar in (at(third, 9e6), coarse):
        lied = replace(told, picture=replace(told.picture, reports=(*others, liar))).joint
        assert lied.grid.cell_m <= 4.0 * GRID.cell_m
        assert np.abs(lied.world_from_grid.translation[:2]).max() < 10.0


# Clocks that differ, delays, who comes, goes, raises, jumps or lies.


def fleet(count: int, liar: int | None = None) -> list[AgentReport]:
    """Return the reports of agents on a circle that see the same cars; one invents more."""
    out = []
    for number, turn in enumerate(np.arange(count) * (2 * np.pi / count)):
        estimate = view(f"agent{number:02}", 12.0 * np.cos(turn), 12.0 * np.sin(turn), turn)
        out.append(report(estimate, CARS if number != liar else np.concatenate([CARS, GHOSTS])))
    return out


def at(said: AgentReport, x_m: float, std_m: float = 0.0) -> AgentReport:
    """Return a report from another place."""
    pose = Rigid(np.eye(3), np.array([x_m, 0.0, 0.0]))
    return replace(said, estimate=replace(said.estimate, world_from_level=pose), pose_std=PoseStd(std_m))


def follow(
    rounds: Rounds, reports: list[AgentReport], clock_s: Callable[[int, int], float], *, times: int = 40,
    jitter_s: float = 0.08, begin: int = 0,
) -> list[Round]:  # fmt: skip
    """Return the rounds of reports made at one time each, by clocks (agent, time) that are ahead, and delayed."""
    rng, done = np.random.default_rng(7), list[Round]()
    for time in range(begin, begin + times):
        true_s = BEGIN_S + time / HZ
        arrived_s = true_s + 0.02 + rng.uniform(0.0, jitter_s, len(reports))
        for number in np.argsort(arrived_s).tolist():
            done += rounds.add(true_s + clock_s(number, time), reports[number], float(arrived_s[number]))
    return done + rounds.close()


def full(done: list[Round], agents: set[str]) -> int:
    """Return how many rounds hold all of some agents."""
    return sum(agents <= {report.agent for report in each.reports} for each in done)


@pytest.mark.parametrize(("count", "jitter_s"), [(3, 0.1), (5, 0.0), (10, 0.05)])
def test_rounds_hold_all_agents_whatever_their_clocks_and_the_liar_is_found(count: int, jitter_s: float) -> None:
    offsets_s, liar = np.linspace(-0.45, 0.45, count), count - 1
    reports = fleet(count, liar)
    done = follow(Rounds(), reports, lambda number, _: offsets_s[number], jitter_s=jitter_s)
    assert full(done, {each.agent for each in reports}) >= 38
    assert len(done) <= 42
    trust = done[-1].picture.verdicts.trust
    assert trust.argmin() == liar
    assert (np.delete(trust, liar) > 0.5).all()
    # Rounds have the center's time.
    assert abs(done[-1].picture.t_s - (BEGIN_S + 39 / HZ)) < 0.2


@pytest.mark.parametrize("offset_s", [-0.45, 0.15, 0.45])
@pytest.mark.parametrize("named", [False, True])
def test_one_clock_that_is_off_leaves_nobody_out(offset_s: float, named: bool) -> None:
    reports = fleet(3)
    rounds = Rounds(tuple(each.agent for each in reports) if named else ())
    done = follow(rounds, reports, lambda number, _: offset_s * (number == 0))
    assert full(done, {each.agent for each in reports}) >= 38
    assert sum(bool(each.missing) for each in done) <= 2


@pytest.mark.parametrize("delays_s", [(0.02, 0.13, 0.25), (0.2, 0.28, 0.45)])
def test_right_clocks_with_delays_that_never_vary_are_put_together(delays_s: tuple[float, ...]) -> None:
    reports, rounds, done = fleet(3), Rounds(), list[Round]()
    for time in range(40):
        for number, delay_s in enumerate(delays_s):
            done += rounds.add(BEGIN_S + time / HZ, reports[number], BEGIN_S + time / HZ + delay_s)
    assert full(done, {each.agent for each in reports}) >= 38


@pytest.mark.parametrize("jump_s", [lambda rng: rng.uniform(-0.95, 0.45), lambda rng: rng.choice([-0.9, 0.45])])
def test_who_makes_its_clock_jump_harms_nobody_else(jump_s: Callable[[np.random.Generator], float]) -> None:
    reports, rng = fleet(5), np.random.default_rng(1)
    done = follow(Rounds(), reports, lambda number, _: jump_s(rng) if number == 0 else 0.0)
    assert full(done, {each.agent for each in reports[1:]}) >= 38
    # It is missing where it is left out.
    others = [each for each in done if len(each.reports) == 4]
    assert others
    assert all(each.missing == ("agent00",) for each in others)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (40, [(0.01, 0, 0.0), (0.02, 1, 0.0), (0.03, 0, 0.0), (0.04, 0, 0.0), (0.05, 2, 0.0), (0.3, 0, 0.0)]),
        # Twenty a second, of times between those of the others.
        (6, [(0.12, 1, 0.12), (0.15, 2, 0.15), *((0.05 * n, 0, 0.055 * (7 * n % 10)) for n in range(10))]),
    ],
)
def test_who_reports_again_and_again_parts_no_others(times: int, said: list[tuple[float, int, float]]) -> None:
    reports, rounds, done = fleet(3), Rounds(), list[Round]()
    for time in range(times):
        for delay_s, number, old_s in sorted(said):
            arrived_s = BEGIN_S + time / HZ + delay_s
            done += rounds.add(arrived_s - old_s, reports[number], arrived_s)
    assert full(done, {"agent01", "agent02"}) >= times - 2


def test_agents_of_ten_a_second_are_put_together() -> None:
    reports, rounds, done = fleet(3), Rounds(), list[Round]()
    rng = np.random.default_rng(2)
    for time in range(40):
        true_s = BEGIN_S + 0.1 * time
        delays_s = 0.02 + rng.uniform(0.0, 0.03, 3)
        for number in np.argsort(delays_s).tolist():
            done += rounds.add(true_s + (0.4, 0.0, -0.3)[number], reports[number], true_s + delays_s[number])
    assert full(done, {each.agent for each in reports}) >= 38


def test_who_is_heard_and_left_out_is_an_alarm() -> None:
    reports, rounds = fleet(3), Rounds()
    follow(rounds, reports, lambda *_: 0.0, times=4)
    done, notes = list[Round](), list[str]()
    for time in (4, 5, 6):
        done += rounds.add(BEGIN_S + time / HZ, reports[0], BEGIN_S + time / HZ + 0.02)
        notes += rounds.notes
    [last] = done
    assert last.missing == ("agent01", "agent02")
    assert last.numbers()["missing"] == ["agent01", "agent02"]
    said = "agent01, agent02: heard recently, missing at "
    assert [note[: len(said)] for note in notes] == [said]
    assert last.sentences() == [
        "agent01, agent02 heard recently, missing now: they contradict nobody",
        "agent00 alone is heard: nobody contradicts it",
    ]


def test_a_round_ends_by_the_centers_clock_without_a_report() -> None:
    reports, rounds = fleet(2), Rounds()
    follow(rounds, reports, lambda *_: 0.0, times=4)
    assert rounds.add(BEGIN_S + 2.0, reports[0], BEGIN_S + 2.02) == []
    assert rounds.close(BEGIN_S + 2.5) == []
    assert [each.missing for each in rounds.close(BEGIN_S + 2.7)] == [("agent01",)]


def test_more_agents_than_a_center_has_are_refused_and_it_goes_on() -> None:
    reports, rounds = fleet(17), Rounds()
    done = follow(rounds, reports, lambda *_: 0.0, times=3, jitter_s=0.0)
    assert full(done, {each.agent for each in reports[:16]}) == 3
    rounds.add(BEGIN_S + 2.0, reports[16], BEGIN_S + 2.0)
    [note] = rounds.notes
    assert note.startswith("agent16: agents must be at most 16, got one more; its report is left out")
    # One that is silent for 10 s gives up its place, and the others keep theirs.
    done = follow(rounds, reports[1:], lambda *_: 0.0, times=30, jitter_s=0.0, begin=5)
    assert full(done[-5:], {each.agent for each in reports[1:]}) == 5
    assert "agent00" not in done[-1].picture.agents
    with pytest.raises(ValueError, match="agents must be at most 16, got 17; give"):
        Rounds(tuple(each.agent for each in reports))


def test_named_agents_have_a_place_however_long_they_are_silent() -> None:
    reports = fleet(16)
    rounds = Rounds(tuple(each.agent for each in reports))
    follow(rounds, reports[:2], lambda *_: 0.0, times=60)
    [last] = follow(rounds, reports, lambda *_: 0.0, times=1, begin=60)
    assert full([last], {each.agent for each in reports}) == 1


def test_a_report_that_raises_costs_its_round_alone() -> None:
    reports, rounds = fleet(3), Rounds()
    follow(rounds, reports, lambda *_: 0.0, times=3)
    poison = replace(reports[0], own_box=np.zeros(1))
    notes = []
    for number, each in enumerate([poison, *reports[1:]]):
        assert rounds.add(BEGIN_S + 1.5, each, BEGIN_S + 1.52 + 0.01 * number) == []
        notes += rounds.notes
    assert [note.split(" s failed")[0] for note in notes] == [f"the round of {BEGIN_S + 1.5:.2f}"]
    done = follow(rounds, reports, lambda *_: 0.0, times=5, begin=4)
    assert full(done, {each.agent for each in reports}) == 5


def test_one_time_again_and_again_fills_no_memory() -> None:
    reports, rounds = fleet(2), Rounds()
    follow(rounds, reports, lambda *_: 0.0, times=2)
    done = [len(rounds.add(BEGIN_S + 1.0, reports[0], BEGIN_S + 1.0)) for _ in range(200)]
    assert sum(done) >= 1
    assert len(rounds.close()) <= 64


def test_who_comes_in_launders_nobodys_record() -> None:
    reports, rounds = fleet(5, liar=2), Rounds()
    before = follow(rounds, reports[:4], lambda *_: 0.0, times=20)[-1]
    done = follow(rounds, reports, lambda *_: 0.0, times=2, begin=20)
    trusted = [dict(zip(each.picture.agents, each.picture.verdicts.trust, strict=True)) for each in (before, done[0])]
    assert before.picture.verdicts.trust.argmin() == 2
    assert trusted[1]["agent02"] < 0.5
    for agent, trust in trusted[0].items():
        assert trusted[1][agent] == pytest.approx(trust, abs=0.1)
    assert trusted[1]["agent04"] == pytest.approx(0.9, abs=0.1)
    assert done[0].picture.verdicts.evidence.argmax() == 2


def test_who_goes_leaves_the_records_of_others() -> None:
    """Sixteen agents, one of them a liar; another one falls silent, and a new one takes its place."""
    reports, rounds = fleet(17, liar=2), Rounds()
    follow(rounds, reports[:16], lambda *_: 0.0, times=2, jitter_s=0.0)
    before = follow(rounds, reports[1:16], lambda *_: 0.0, times=25, jitter_s=0.0, begin=2)[-1]
    after = follow(rounds, reports[1:], lambda *_: 0.0, times=2, jitter_s=0.0, begin=27)[-1]
    assert set(after.picture.agents) == {each.agent for each in reports[1:]}
    trusted = [dict(zip(each.picture.agents, each.picture.verdicts.trust, strict=True)) for each in (before, after)]
    assert min(trusted[0], key=trusted[0].__getitem__) == "agent02"
    for agent in before.picture.agents[1:]:
        assert trusted[1][agent] == pytest.approx(trusted[0][agent], abs=0.1)


def refusals(rounds: Rounds, said: list[tuple[float, AgentReport]]) -> list[str]:
    """Return the refusals of the reports of one agent, empty where one is taken."""
    out = []
    for t_s, each in said:
        rounds.add(BEGIN_S + t_s, each, BEGIN_S + t_s + 0.02)
        out += ["".join(note for note in rounds.notes if "left out" in note)]
    return out


def test_a_pose_ten_kilometers_away_and_back_is_refused() -> None:
    [said], rounds = fleet(1), Rounds()
    out = refusals(rounds, [(0.1 * n, at(said, 1e4 if n == 3 else 1.0 * n)) for n in range(6)])
    assert [bool(note) for note in out] == [False, False, False, True, False, False]
    assert out[3] == (
        "agent00: its pose must be within 7.0 m of its last one (70 m/s and 3 standard deviations), got 9998.0 m;"
        " check its localization; its report is left out"
    )
    [last] = rounds.add(BEGIN_S + 0.6, at(said, 6.0), BEGIN_S + 0.62)
    assert last.numbers()["agents"]["agent00"]["refused"] == 1


@pytest.mark.parametrize(
    ("x_m", "std_m", "rule"),
    [
        (1e300, 0.0, "coordinates must be at most 1e+07 m, got 1e+300 m"),
        (-2e7, 0.0, "coordinates must be at most 1e+07 m, got 2e+07 m"),
        (0.0, 1e15, "the standard deviation of its place must be at most 1000 m, got 1e+15 m"),
    ],
)
def test_a_place_that_is_none_is_refused(x_m: float, std_m: float, rule: str) -> None:
    [said], rounds = fleet(1), Rounds()
    out = refusals(rounds, [(0.1 * n, at(said, x_m, std_m)) for n in range(6)] + [(0.6, said)])
    assert [bool(note) for note in out] == [True] * 6 + [False]
    assert rule in out[0]


def test_three_that_agree_begin_anew_and_others_do_not() -> None:
    [said], rounds = fleet(1), Rounds()
    # A receiver of satellites jumps by 300 m and drives on there.
    assert [bool(note) for note in refusals(rounds, [(0.1 * n, at(said, 300.0 * (n > 2) + n)) for n in range(8)])] == [
        False, False, False, True, True, False, False, False,
    ]  # fmt: skip
    # Here and there: no three agree.
    there = [(1.0 + 0.1 * n, at(said, (-1e4, 1e4)[n % 2])) for n in range(8)]
    assert all(refusals(rounds, there))
    # What its covariance says is allowed for.
    assert refusals(rounds, [(1.9, at(said, 300.0, 5.0)), (2.0, at(said, 330.0, 10.0))]) == ["", ""]


def test_fast_agents_in_bursts_are_taken() -> None:
    """At 69 m/s, five reports at once after half a second."""
    [said], rounds = fleet(1), Rounds()
    for n in range(50):
        rounds.add(BEGIN_S + 0.1 * n, at(said, 6.9 * n), BEGIN_S + 0.5 * (n // 5) + 0.5)
        assert not [note for note in rounds.notes if "pose" in note]


def test_a_clock_that_runs_too_fast_buys_no_distance() -> None:
    [said], rounds = fleet(1), Rounds()
    out = []
    for n in range(20):
        rounds.add(BEGIN_S + 10.0 * n, at(said, (1.0, -1.0)[n % 2] * 300.0), BEGIN_S + 0.1 * n)
        out += [note for note in rounds.notes if "pose" in note]
    assert len(out) >= 9


def test_who_is_refused_is_missing_and_counted() -> None:
    reports, rounds = fleet(3), Rounds()
    follow(rounds, reports, lambda *_: 0.0, times=4)
    counts = Counter[tuple[str, ...]]()
    for time in range(4, 8):
        there = at(reports[2], 1e4 * (1 + time))
        for number, each in enumerate([*reports[:2], there]):
            done = rounds.add(BEGIN_S + time / HZ, each, BEGIN_S + time / HZ + 0.02 + 0.01 * number)
            counts.update(each.missing for each in done)
    assert counts == {("agent02",): 4}
    assert done[-1].numbers()["agents"]["agent02"]["refused"] == 4
    assert "agent02 (4 reports refused) heard recently, missing now: they contradict nobody" in done[-1].sentences()


def test_reports_of_one_time_are_put_together_by_the_same_rules() -> None:
    reports, rounds = fleet(5, liar=2), Rounds()
    for time in range(20):
        before = rounds.together(time / HZ, reports[:4])
    after = rounds.together(10.0, [*reports, at(reports[0], 1e300)])
    assert rounds.notes[-1] == "agent04 joined: its trust starts at the prior, the others keep theirs"
    assert rounds.notes[0].startswith("agent00: coordinates must be at most 1e+07 m, got 1e+300 m")
    assert after.refused == {"agent00": 1}
    assert after.picture.verdicts.trust[2] == pytest.approx(before.picture.verdicts.trust[2], abs=0.1)
    assert rounds.together(10.5, [at(each, 1e300) for each in reports]) is None
