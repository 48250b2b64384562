"""Trust of agents: who lies, who is disputed, and that honest agents are not convicted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from viewshed.agents.trust import Reports, Trust, TrustLimits, TrustRules, Verdicts
from viewshed.arrays import F64

STD_M = 0.3


def reports_of(seen: np.ndarray, chance: np.ndarray, rng: np.random.Generator | None = None, first: int = 0) -> Reports:
    """Return reports about objects that stand 20 m apart, with the noise of an honest detector.

    Boxes lie on the surfaces of their views, as honest ones do, and what one agent alone reports is as little odd as
    that the others are silent; ``chance`` is that of an honest agent to report what another one reports.
    """
    count, agents = seen.shape
    xy_m = np.zeros((count, agents, 2)) + 20.0 * np.arange(first, first + count)[:, None, None]
    if rng is not None:
        xy_m += rng.normal(0.0, STD_M, xy_m.shape)
    able, odds = (chance > 0) | seen, np.clip(chance, 0.01, 0.99)
    there = np.where(seen, 2.0, np.where(able, -2.0, 0.0))
    return Reports(
        np.arange(first, first + count), seen, able, able, np.log(odds / (1 - odds)),
        np.zeros((5, 3)), np.zeros(seen.shape), np.zeros((2, *seen.shape)), np.zeros(2), np.full(seen.shape, -3.0),
        there, 0.0, xy_m, np.full(seen.shape, STD_M), np.zeros(seen.shape, np.int8),
    )  # fmt: skip


def told(reports: Reports, seconds: int = 3, trust: Trust | None = None) -> Verdicts:
    """Return the verdicts once the same was said each second, to new trust if none is given."""
    trust = Trust(reports.seen.shape[1]) if trust is None else trust
    for _ in range(seconds):
        verdicts = trust.add(reports, 1.0)
    return verdicts


def after(agents: int, seen: list[list[int]], chance: float | np.ndarray = 0.95, seconds: int = 3) -> Verdicts:
    said = np.array(seen, bool).reshape(-1, agents)
    return told(reports_of(said, np.broadcast_to(chance, said.shape)), seconds)


def test_two_who_contradict_each_other_are_disputed_and_not_convicted() -> None:
    verdicts = after(2, [[1, 0], [1, 0], [1, 0]])
    assert verdicts.suspects.tolist() == [True, True]
    assert verdicts.doubt > 1.0
    assert verdicts.evidence[0] == pytest.approx(verdicts.evidence[1], abs=0.7)
    assert verdicts.evidence.max() < 0.7  # neither can be told from the other
    benign = np.tile(np.linspace(-1.0, 0.7, 199)[:, None, None], (1, 2, 5))
    limits = TrustLimits.of(benign, np.zeros(2, bool), np.linspace(0.0, 1.0, 199))
    accused = limits.accused(verdicts.answers, np.zeros(2, bool), 0.01)
    assert not accused.any()
    assert limits.disputed(verdicts, accused, 0.01).tolist() == [True, True]


@pytest.mark.parametrize("said", [[1, 1, 1, 0], [0, 0, 0, 1]])
def test_a_third_view_tells_who_lies(said: list[int]) -> None:
    verdicts = after(4, [said, said], seconds=6)
    assert verdicts.evidence.argmax() == 3
    assert verdicts.suspects.tolist() == [False, False, False, True]
    assert verdicts.trust[3] < 0.45
    assert (verdicts.trust[:3] > 0.9).all()
    assert np.allclose(verdicts.existence, said[0], atol=0.05)


def test_a_lie_that_lasts_explains_silence_that_lasts() -> None:
    """An honest silence lasts, so that each further look says little; a lie lasts as well, and explains it as well."""
    said, trust, follows = np.array([[1, 1, 1, 0]], bool), Trust(4), Trust(4)
    for look in range(8):
        reports = reports_of(said, np.array([[0.95, 0.95, 0.95, 0.95 if look == 0 else 0.1]]))
        again = replace(reports, repeats=np.full((1, 4), look > 0, np.int8))
        forgets, keeps = trust.add(reports, 0.5).evidence[3], follows.add(again, 0.5).evidence[3]
        assert keeps >= forgets
    assert keeps > forgets + 0.1


def test_who_withholds_objects_is_trusted_less() -> None:
    reports = reports_of(np.ones((2, 4), bool), np.full((2, 4), 0.95))
    honest, liar = (Trust(4).add(reports, 0.5, withheld=np.array([0.0, 0.0, 0.0, nats])) for nats in (0.0, 12.0))
    assert liar.trust[3] < honest.trust[3] - 0.2
    assert (liar.trust[:3] > 0.8).all()


@pytest.mark.parametrize("said", [[1, 1, 1, 0], [0, 0, 0, 1]])
def test_a_liar_that_goes_on_stays_as_suspicious(said: list[int]) -> None:
    """What one object says is bounded for all hypotheses together: the wrong ones do not catch up."""
    lied = [after(4, [said, said], seconds=seconds) for seconds in (3, 10, 30)]
    evidence = [verdicts.evidence[3] for verdicts in lied]
    assert evidence[-1] > 0.9 * max(evidence)
    assert lied[-1].trust[3] < 0.2
    assert (lied[-1].trust[:3] > 0.9).all()


def test_two_who_lie_together_are_found_by_three_honest_ones() -> None:
    verdicts = after(5, [[1, 1, 0, 0, 0], [1, 1, 0, 0, 0], [0, 0, 1, 1, 1]])
    assert set(np.argsort(verdicts.evidence)[-2:]) == {0, 1}
    assert verdicts.suspects.tolist() == [True, True, False, False, False]


def test_a_miss_where_nothing_could_be_seen_costs_nothing() -> None:
    seen = [[1, 1, 0]] * 4
    hidden = np.array([[0.95, 0.95, 0.0]] * 4)
    assert after(3, seen, hidden).evidence[2] <= 1e-9
    assert after(3, seen).evidence[2] > 3.0


def test_one_object_alone_convicts_nobody_beyond_its_bound() -> None:
    rules = TrustRules()
    verdicts = after(4, [[1, 1, 1, 0]], seconds=60)
    assert verdicts.evidence.max() <= rules.most_of_object + 1e-9
    assert after(4, [[1, 1, 1, 0]] * 3, seconds=60).evidence.max() > rules.most_of_object


def test_objects_that_look_invented_in_the_own_view_convict() -> None:
    seen = np.eye(3, dtype=bool)[np.repeat([0, 1, 2], 3)]
    ratios = np.where(seen & (np.arange(3) == 1), 6.0, -2.0)
    verdicts = told(replace(reports_of(seen, np.where(seen, 0.95, 0.0)), invented=ratios), 12)
    assert verdicts.evidence.argmax() == 1
    assert verdicts.suspects.tolist() == [False, True, False]


def test_a_forged_view_vouches_little_for_its_own_reports() -> None:
    """Three agents see a place free; whether the reporter's own view shows a surface there hardly matters."""
    seen = np.array([[True, False, False, False]] * 3)
    reports = reports_of(seen, np.full(seen.shape, 0.95))
    found = [told(replace(reports, invented=np.where(seen, own, 0.0))) for own in (-6.0, 0.0, 6.0)]
    agrees, neutral, denies = (verdicts.evidence[0] for verdicts in found)
    assert agrees > 0.5 * neutral  # a view that agrees takes little away
    assert denies > neutral  # one that does not adds to it
    assert found[-1].suspects.tolist() == [True, False, False, False]


@pytest.mark.parametrize("reporters", [[0], [1, 2, 3]])
def test_views_of_those_silent_tell_who_lies(reporters: list[int]) -> None:
    """Free ground in silent views speaks against one reporter; against three it speaks of the one that claims it."""
    seen = np.zeros((3, 4), bool)
    seen[:, reporters] = True
    reports = reports_of(seen, np.where(seen, 0.9, 0.02))
    free = np.broadcast_to(np.where(seen, 0.0, 3.0), (2, 3, 4))
    verdicts = told(replace(reports, silent_views=free))
    assert verdicts.evidence.argmax() == 0
    assert verdicts.suspects.tolist() == [True, False, False, False]


@pytest.mark.parametrize("seconds", [4, 40])
def test_a_lie_may_begin_after_any_time_of_honesty(seconds: int) -> None:
    """All report three objects; from then on one denies them."""
    trust = Trust(4)
    for number in range(seconds + 3):
        seen = np.ones((3, 4), bool)
        seen[:, 3] = number < seconds
        verdicts = trust.add(reports_of(seen, np.full(seen.shape, 0.95)), 1.0)
    assert verdicts.evidence.argmax() == 3
    assert verdicts.evidence[3] > 5.0


def compared(pairs: dict[tuple[int, int], float], own: dict[int, float], agents: int = 4) -> tuple[F64, F64]:
    """Return surprises in nats of pairs and of single views; where none is given nothing is compared or odd."""
    of_pairs, of_own = np.full((agents, agents, 2), np.nan), np.zeros((agents, 3))
    for (one, other), nats in pairs.items():
        of_pairs[one, other, 0] = nats
    for one, nats in own.items():
        of_own[one, 2] = nats
    return of_pairs, of_own


def test_a_view_that_contradicts_two_others_takes_the_trust_in_its_reports() -> None:
    trust = Trust(4)
    for _ in range(8):
        verdicts = trust.add(silent(4), 0.5, compared({(2, 0): 4.5, (2, 1): 4.5, (3, 2): 4.5}, {}))
    assert verdicts.suspects.tolist() == [False, False, True, False]
    assert verdicts.trust[2] < 0.5
    assert (verdicts.trust[[0, 1, 3]] > 0.85).all()
    assert verdicts.against[2] == pytest.approx([4.5, 4.5, 0.0, 4.5], abs=0.2)


def test_each_question_is_answered_by_itself() -> None:
    """One view opens, one closes, one lies elsewhere, one is seen through: each shows in one answer of one agent."""
    of_pairs, of_own = np.zeros((4, 4, 2)), np.zeros((4, 3))
    of_own[0, 0], of_own[1, 1], of_own[2, 2], of_pairs[3, :3, 0], of_pairs[0, 3, 1] = 4.0, 4.0, 3.0, 2.0, 4.0
    trust = Trust(4)
    for _ in range(20):
        verdicts = trust.add(silent(4), 1.0, (of_pairs, of_own))
    by_hand = np.zeros((4, 3))
    by_hand[0, 0], by_hand[2, 1], by_hand[3, 2] = 4.0, 3.0, 2.0
    assert verdicts.answers[:, 1:4] == pytest.approx(by_hand, abs=1e-3)
    # Nobody reported anything, whatever views say of their agents.
    assert verdicts.answers[:, 0] == pytest.approx(0.0, abs=1e-9)
    assert verdicts.evidence.max() > 1.0


@pytest.mark.parametrize("ratio", [-3.0, 5.0])
def test_boxes_beside_those_of_others_convict_if_the_own_view_shows_no_surface_there(ratio: float) -> None:
    reports = reports_of(np.ones((3, 3), bool), np.full((3, 3), 0.95))
    xy_m = reports.xy_m.copy()
    xy_m[:, 1, 0] += 1.0
    displaced = np.where(np.arange(3) == 1, ratio, reports.displaced)
    verdicts = told(replace(reports, xy_m=xy_m, displaced=displaced))
    assert verdicts.suspects.tolist() == [False, ratio > 0, False]


def test_agents_may_come_in_any_order() -> None:
    rng = np.random.default_rng(3)
    seen, chance = rng.random((5, 4)) < 0.6, rng.uniform(0.2, 0.95, (5, 4))
    seen[:, 0] = True
    order = np.array([2, 0, 3, 1])
    reports = reports_of(seen, chance, rng)
    names = ("seen", "able", "sees", "reported", "invented", "displaced", "there", "xy_m", "std_m")
    views = rng.normal(size=(2, *seen.shape))
    in_order: dict[str, Any] = {name: getattr(reports, name)[:, order] for name in names}
    turned = replace(reports, silent_views=views[..., order], **in_order)
    reports = replace(reports, silent_views=views)
    one, other = Trust(4).add(reports, 0.5), Trust(4).add(turned, 0.5)
    assert np.allclose(one.evidence[order], other.evidence)
    assert np.allclose(one.trust[order], other.trust)
    assert np.allclose(one.existence, other.existence)


def nothing_reported(agents: int) -> Reports:
    return reports_of(np.zeros((0, agents), bool), np.zeros((0, agents)))


def surprises(agents: int, present: int, *, who: int | None = 0) -> tuple[F64, F64]:
    """Return comparisons of the views of those present, of whom one sees through all others and is misplaced."""
    pairs, own = np.full((agents, agents, 2), np.nan), np.full((agents, 3), np.nan)
    pairs[:present, :present], own[:present] = 0.0, 0.0
    if who is not None:
        pairs[who, :present, 0], own[who, 2] = 4.8, 4.8
    return pairs, own


@pytest.mark.parametrize("gone", [1, 5, 13])
def test_who_left_weakens_nothing_that_speaks_against_those_present(gone: int) -> None:
    few, many, present = Trust(3), Trust(3 + gone), np.arange(3 + gone) < 3
    for _ in range(12):
        alone = few.add(nothing_reported(3), 0.5, surprises(3, 3))
        verdicts = many.add(nothing_reported(3 + gone), 0.5, surprises(3 + gone, 3), present=present)
    assert verdicts.answers[:3] == pytest.approx(alone.answers, abs=1e-9)
    assert verdicts.trust[:3] == pytest.approx(alone.trust, abs=0.08)


def test_evidence_of_views_is_the_same_at_any_rate_and_fades() -> None:
    """Agents take turns at higher rates, so that each view is compared as often; nothing renews it after 4 s."""
    found = []
    for hz in (2, 10):
        trust = Trust(5)
        for k in range(4 * hz):
            turn = np.arange(5) == k % 5 if hz == 10 else np.ones(5, bool)
            pairs, own = surprises(5, 5)
            pairs[~(turn[:, None] | turn[None])], own[~turn] = np.nan, np.nan
            found.append(trust.add(nothing_reported(5), 1.0 / hz, (pairs, own)))
        for _ in range(60 * hz):
            faded = trust.add(nothing_reported(5), 1.0 / hz, surprises(5, 0, who=None))
        assert faded.answers[0, 2:4] == pytest.approx(0.0, abs=0.01)
        assert faded.trust[0] == pytest.approx(faded.trust[1], abs=0.01)
    assert found[-1].answers[0, 2:4] == pytest.approx(found[7].answers[0, 2:4], rel=0.05)


def test_old_reports_fade_and_memory_stays_bounded() -> None:
    trust = Trust(3)
    liar = reports_of(np.array([[1, 1, 0]] * 3, bool), np.full((3, 3), 0.95))
    found = told(liar, 5, trust)
    honest = reports_of(np.ones((3, 3), bool), np.full((3, 3), 0.95), first=10)
    verdicts = told(honest, 60, trust)
    assert found.evidence[2] > 3.0
    assert verdicts.evidence[2] < 0.5
    for number in range(300):
        trust.add(reports_of(np.ones((1, 3), bool), np.full((1, 3), 0.95), first=100 + number), 1.0)
    assert len(trust._of_objects) < 250


@pytest.mark.parametrize("masts", [0, 2])
def test_limits_hold_their_rate_and_refuse_what_they_cannot(masts: int) -> None:
    """Of five agents some are elevated, which err three times as much, and one question has half the noise."""
    rng, elevated, accused = np.random.default_rng(8), np.arange(5) >= 5 - masts, []
    scale = np.where(elevated, 3.0, 1.0)[:, None] * np.array([1.0, 0.5, 1.0, 1.0, 1.0])
    for _ in range(20):
        benign = rng.normal(size=(199, 5, 5)) * scale
        limits = TrustLimits.of(benign, elevated, rng.normal(size=199))
        accused += [limits.accused(rng.normal(size=(5, 5)) * scale, elevated, 0.05) for _ in range(200)]
    assert np.mean([one.any() for one in accused]) == pytest.approx(0.05, abs=0.015)
    # Each kind has its part: the scale makes up for what the elevated ones err more.
    assert np.mean(accused, axis=0) == pytest.approx(np.mean(accused), abs=0.008)
    assert not limits.beyond(limits.usual[elevated.astype(int)], elevated).any()
    # Each question convicts by itself.
    for question in range(5):
        answers = np.zeros((5, 5))
        answers[1, question] = 6.0 * scale[1, question]
        assert limits.accused(answers, elevated, 0.05).tolist() == [False, True, False, False, False]
    with pytest.raises(ValueError, match=r"needs \d+ benign scenes, got 199"):
        limits.accused(np.zeros((5, 5)), elevated, 0.0001)
    with pytest.raises(ValueError, match="must be finite"):
        TrustLimits.of(np.full((9, 5, 5), np.nan), elevated, np.zeros(9))
    with pytest.raises(ValueError, match="must come from two benign scenes or more, got 1 and 1"):
        TrustLimits.of(benign[:1], elevated, np.zeros(1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"reported": np.full((1, 2), np.nan)}, "finite"),
        ({"std_m": np.zeros((1, 2))}, "positive"),
        ({"xy_m": np.full((1, 2, 2), np.nan)}, "finite"),
        ({"ids": np.arange(2)}, "must have"),
        ({"able": np.ones((2, 2), bool)}, "able must be"),
    ],
)
def test_bad_reports_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(reports_of(np.ones((1, 2), bool), np.ones((1, 2))), **change)


def silent(agents: int) -> Reports:
    """Return reports about nothing."""
    return reports_of(np.zeros((0, agents), bool), np.zeros((0, agents)))


@pytest.mark.parametrize("agents", [1, 2, 3, 4, 5])
def test_the_same_agents_in_another_order_keep_what_is_known(agents: int) -> None:
    rng = np.random.default_rng(agents)
    seen = rng.random((6, agents)) < 0.7
    seen[:, 0] = True
    order = rng.permutation(agents)
    trust, other = Trust(agents), Trust(agents)
    for each in (trust, other):
        each.add(reports_of(seen, np.full(seen.shape, 0.9)), 1.0)
    other.regroup(order.tolist())
    one, two = trust.add(silent(agents), 1.0), other.add(silent(agents), 1.0)
    np.testing.assert_allclose(two.trust, one.trust[order], atol=1e-9)
    np.testing.assert_allclose(two.evidence, one.evidence[order], atol=1e-9)


@pytest.mark.parametrize("agents", [2, 3, 4, 5, 9])
def test_who_comes_in_begins_at_the_prior_and_changes_nobody(agents: int) -> None:
    trust, seen = Trust(agents), np.zeros((3, agents), bool)
    seen[:, 0] = True
    before = told(reports_of(seen, np.full(seen.shape, 0.95)), 3, trust)
    trust.regroup([*range(agents), -1])
    after_it = trust.add(silent(agents + 1), 1e-3)
    np.testing.assert_allclose(after_it.trust[:agents], before.trust, atol=0.1 if agents > 2 else 0.25)
    assert after_it.trust[0] < 0.6
    assert after_it.trust[agents] == pytest.approx(1.0 - TrustRules().prior, abs=0.1)


def test_who_goes_takes_its_contradictions_along() -> None:
    """Two contradict each other; when one goes, nothing is left against the other, and a third keeps its record."""
    seen, liar, honest = np.array([[1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 1, 1]], bool), Trust(4), Trust(4)
    for each, kept in ((liar, [0, 1, 2]), (honest, [1, 2, 3])):
        before = told(reports_of(seen, np.full(seen.shape, 0.95)), 4, each)
        each.regroup(kept)
    assert before.trust.argmin() == 0
    assert liar.add(silent(3), 1e-3).trust[0] == pytest.approx(before.trust[0], abs=0.1)
    assert (honest.add(silent(3), 1e-3).trust > 0.85).all()
