"""Reactions: what a worse report may never do, how fast caution falls, and which speed a view allows."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from viewshed import BevGrid
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.monitor.evidence import SECTORS
from viewshed.pipeline.reactions import (
    Caution,
    Finding,
    ReactionRules,
    ReactionState,
    Vehicle,
    react,
    speed_for_view,
    withdraw,
)

GRID = BevGrid(64, 32.0)
FRONT = np.arange(SECTORS) // 4 == 9  # the four sectors left of straight ahead


def found(level: int) -> Finding:
    """Nothing found; degraded; inconsistent in front; inconsistent, nobody knows where."""
    suspect = FRONT if level == 2 else np.zeros(SECTORS, np.bool_)
    return Finding(degraded=level == 1, inconsistent=level >= 2, suspect=suspect)


def states_after(levels: Sequence[int], rules: ReactionRules) -> list[ReactionState]:
    states = [ReactionState()]
    for level in levels:
        states.append(react(found(level), states[-1], rules))
    return states[1:]


def all_free() -> FovEstimate:
    return FovEstimate(GRID, np.ones(GRID.shape, np.float32), np.full(GRID.shape, CellState.FREE, np.uint8))


LEVELS = st.lists(st.integers(0, 3), min_size=1, max_size=40)
RULES = st.builds(ReactionRules, st.integers(1, 6), st.integers(0, 3), st.sampled_from([0.0, 0.5, 1.0]))


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=40), RULES)
@example([(2, 3), (0, 0)], ReactionRules(1, 0, 0.0))  # after an alarm of unknown place no sector is suspect
@example([(2, 2), (0, 3), (0, 0)], ReactionRules(1, 0, 0.5))
def test_worse_findings_never_claim_more(pairs: list[tuple[int, int]], rules: ReactionRules) -> None:
    better = states_after([min(pair) for pair in pairs], rules)
    worse = states_after([max(pair) for pair in pairs], rules)
    for one, other in zip(better, worse, strict=True):
        assert other.caution >= one.caution
        assert not (
            withdraw(all_free(), other, None, rules).visible() & ~withdraw(all_free(), one, None, rules).visible()
        ).any()


@given(LEVELS, RULES)
def test_calm_sweeps_bring_every_claim_back(levels: list[int], rules: ReactionRules) -> None:
    state = states_after(levels, rules)[-1]
    for _ in range(int(state.caution) * rules.recover_sweeps):
        state = react(found(0), state, rules)
    assert state.caution == Caution.KEEP
    assert withdraw(all_free(), state, None, rules).visible().all()


@given(LEVELS, RULES)
def test_between_two_rises_to_a_step_lie_at_least_as_many_sweeps_as_recovery_takes(
    levels: list[int], rules: ReactionRules
) -> None:
    cautions = [Caution.KEEP, *(state.caution for state in states_after(levels, rules))]
    for step in (Caution.ASK, Caution.WIDEN, Caution.CONFIRMED):
        rises = [n for n in range(1, len(cautions)) if cautions[n - 1] < step <= cautions[n]]
        assert all(later - earlier > rules.recover_sweeps for earlier, later in itertools.pairwise(rises))


AGED = st.lists(st.tuples(st.integers(0, 3), st.booleans()), min_size=1, max_size=40)


def aged_states(findings: Sequence[tuple[int, bool]], rules: ReactionRules) -> list[ReactionState]:
    states = [ReactionState()]
    for level, stale in findings:
        states.append(react(replace(found(level), stale=stale), states[-1], rules))
    return states


@given(AGED, RULES)
def test_a_stale_view_claims_nothing_and_keep_follows_only_by_recovery(
    findings: list[tuple[int, bool]], rules: ReactionRules
) -> None:
    states = aged_states(findings, rules)
    for (_, stale), before, state in zip(findings, states, states[1:], strict=False):
        assert (state.caution == Caution.STALE) == stale
        if stale:
            assert (withdraw(all_free(), state, GRID.centers[..., 0] < 99.0, rules).state == CellState.UNKNOWN).all()
        if before.caution == Caution.STALE:
            assert state.caution >= Caution.ASK or rules.recover_sweeps == 1


@given(AGED, RULES)
def test_a_stale_view_never_makes_caution_fall_sooner(findings: list[tuple[int, bool]], rules: ReactionRules) -> None:
    fresh = aged_states([(level, False) for level, _ in findings], rules)
    for one, other in zip(fresh, aged_states(findings, rules), strict=True):
        assert other.caution >= one.caution
        assert not (
            withdraw(all_free(), other, None, rules).visible() & ~withdraw(all_free(), one, None, rules).visible()
        ).any()


def test_after_a_stale_view_caution_is_what_it_was_before_and_falls_by_steps() -> None:
    rules = ReactionRules(recover_sweeps=2)
    after = [int(state.caution) for state in aged_states([(2, False), (0, True), *[(0, False)] * 6], rules)]
    assert after == [0, 2, 4, 2, 1, 1, 0, 0, 0]
    after = [int(state.caution) for state in aged_states([(0, True), *[(0, False)] * 4], rules)]
    assert after == [0, 4, 1, 0, 0, 0]


def test_sectors_of_an_alarm_that_is_over_are_trusted_in_the_next_one() -> None:
    rules, behind = ReactionRules(recover_sweeps=1, widen_sectors=0, most_suspect=1.0), ~FRONT
    over = states_after([2, 0, 0, 0], rules)[-1]
    again = react(Finding(inconsistent=True, suspect=behind), over, rules)
    assert np.array_equal(again.suspect, behind)
    ahead = react(Finding(inconsistent=True, suspect=behind), states_after([2], rules)[-1], rules)
    assert ahead.suspect.all()


def test_a_known_place_is_withdrawn_and_more_than_half_leaves_only_what_is_confirmed() -> None:
    rules = ReactionRules(recover_sweeps=2, widen_sectors=1)
    first, still = states_after([2, 2], rules)
    most = Finding(inconsistent=True, suspect=np.arange(SECTORS) < SECTORS // 2 + 1)
    assert react(most, first, rules).caution == Caution.CONFIRMED
    second = react(found(3), first, rules)
    assert still.caution == Caution.WIDEN, "one ghost, however long, costs its sectors alone"
    assert (first.caution, second.caution) == (Caution.WIDEN, Caution.CONFIRMED)
    # x forward is i, y left is j: 0° to 20°, and 5° on both sides, ahead of the sensor.
    left = withdraw(all_free(), first, None, rules)
    degrees = np.degrees(np.arctan2(GRID.centers[..., 1], GRID.centers[..., 0]))
    assert np.array_equal(left.state == CellState.UNKNOWN, (degrees > -5) & (degrees < 25))
    assert np.array_equal(left.visible(), left.state == CellState.FREE)
    confirmed = GRID.centers[..., 0] < 0
    assert np.array_equal(withdraw(all_free(), second, confirmed, rules).visible(), confirmed)
    assert not withdraw(all_free(), second, None, rules).visible().any()


def test_a_suspect_place_stays_withdrawn_until_caution_falls() -> None:
    rules = ReactionRules(recover_sweeps=3, widen_sectors=0)
    states = states_after([2, 0, 0, 0, 0], rules)
    assert [int(state.caution) for state in states] == [2, 2, 2, 1, 1]
    assert [bool(withdraw(all_free(), state, None, rules).visible().all()) for state in states] == [False] * 3 + [
        True
    ] * 2


def test_a_worse_view_asks_others_and_an_unknown_place_or_an_accusation_leaves_what_is_confirmed() -> None:
    assert react(found(1), ReactionState()).caution == Caution.ASK
    assert react(found(3), ReactionState()).caution == Caution.CONFIRMED
    accused = Finding(inconsistent=True, accused=True, suspect=FRONT)
    assert react(accused, ReactionState()).caution == Caution.CONFIRMED


def test_the_speed_is_that_from_which_a_car_stops_in_what_is_free() -> None:
    state = np.full(GRID.shape, CellState.FREE, np.uint8)
    free = FovEstimate(GRID, np.ones(GRID.shape, np.float32), state)
    # From the front at 4 m to the edge at 32 m: v/2 + v²/6 = 28 m.
    assert speed_for_view(free) == pytest.approx(-1.5 + np.sqrt(1.5**2 + 6 * 28.0))
    state = state.copy()
    state[(GRID.centers[..., 0] > 14.0) & (np.abs(GRID.centers[..., 1]) < 1.0)] = CellState.HIDDEN
    hidden = FovEstimate(GRID, np.ones(GRID.shape, np.float32), state)
    assert speed_for_view(hidden) == pytest.approx(-1.5 + np.sqrt(1.5**2 + 6 * 10.0))
    beside = np.where(GRID.centers[..., 1] > 2.0, np.uint8(CellState.HIDDEN), np.uint8(CellState.FREE))
    assert speed_for_view(FovEstimate(GRID, np.ones(GRID.shape, np.float32), beside)) == speed_for_view(free)
    diagonal_m = 32.0 * np.sqrt(2.0) - Vehicle().half_width_m - Vehicle().front_m
    # The same lane along any heading: the cells ahead are those turned by it.
    for quarters, heading in enumerate((0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi)):
        turned = replace(hidden, state=np.rot90(state, quarters))
        assert speed_for_view(turned, heading=heading) == pytest.approx(speed_for_view(hidden))
        assert speed_for_view(turned, heading=heading + np.pi) == pytest.approx(speed_for_view(free))
    assert speed_for_view(free, heading=0.25 * np.pi) == pytest.approx(-1.5 + np.sqrt(1.5**2 + 6 * diagonal_m))
    unknown = FovEstimate(GRID, np.zeros(GRID.shape, np.float32), np.zeros(GRID.shape, np.uint8))
    assert speed_for_view(unknown) == speed_for_view(unknown, Vehicle(front_m=-100.0)) == 0.0
    for offset_m in ((40.0, 0.0), (0.0, 31.0), (0.0, -40.0)):  # a grid without a part of the lane does not show it free
        assert speed_for_view(replace(free, grid=BevGrid(64, 32.0, offset_m))) == 0.0


def test_a_short_and_narrow_vehicle_uses_what_is_free_to_it_and_one_that_cannot_stop_is_refused() -> None:
    ahead = np.abs(GRID.centers[..., 1]) < 0.75
    state = np.where(ahead & (GRID.centers[..., 0] < 14.0), np.uint8(CellState.FREE), np.uint8(CellState.HIDDEN))
    view = FovEstimate(GRID, np.ones(GRID.shape, np.float32), state)
    assert speed_for_view(view) == 0.0
    robot = Vehicle(front_m=0.5, half_width_m=0.4, delay_s=0.2, braking_mps2=1.0)
    clear_m = GRID.centers[:, 0, 0][GRID.centers[:, 0, 0] >= 14.0].min() - GRID.cell_m / 2 - 0.5
    speed_mps = speed_for_view(view, robot)
    assert speed_mps * 0.2 + speed_mps**2 / 2.0 == pytest.approx(clear_m)
    for wrong in ({"braking_mps2": 0.0}, {"half_width_m": -1.0}, {"delay_s": -0.1}, {"front_m": np.nan}):
        with pytest.raises(ValueError, match="half_width_m and braking_mps2 must be positive"):
            Vehicle(**wrong)


@given(st.lists(st.integers(0, 3), max_size=40), RULES, st.integers(0, 2**32 - 1))
def test_certified_claims_hold_at_any_caution_until_the_view_is_stale_and_alone_where_nothing_else_counts(
    levels: list[int], rules: ReactionRules, seed: int
) -> None:
    certified = np.random.default_rng(seed).random(GRID.shape) < 0.5
    state = states_after([0, *levels], rules)[-1]
    kept = []
    for caution in Caution:
        at, holds = replace(state, caution=caution), certified & (caution != Caution.STALE)
        alone = withdraw(all_free(), at, None, rules).visible()
        kept.append(withdraw(all_free(), at, None, rules, certified).visible())
        assert (kept[-1] == alone | holds).all()
        only = withdraw(all_free(), at, None, rules, certified, certified_only=True)
        assert np.array_equal(only.visible(), holds)
        assert (only.state[~only.visible()] == CellState.UNKNOWN).all()
        assert not withdraw(all_free(), at, None, rules, certified_only=True).visible().any()
    for less, more in itertools.pairwise(kept):
        assert not (more & ~less).any()
