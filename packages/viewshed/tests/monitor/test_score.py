"""Scores: standardized by the own past, on a common scale, several rare changes count more than one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from viewshed.monitor.evidence import SECTORS, Evidence
from viewshed.monitor.score import (
    MEMORY_SWEEPS,
    ONSET_SWEEPS,
    PRIOR_SWEEPS,
    Past,
    Reference,
    SurpriseScale,
    numbers_of,
    sector_scores,
)


def _kind(name: str, grain: float, *, two_sided: bool = False) -> Evidence:
    return Evidence(name, lambda _: np.zeros(SECTORS, np.float32), grain, "{value}", two_sided)


STATE = {"a": _kind("a", 1.0, two_sided=True), "b": _kind("b", 1.0, two_sided=True)}


def _evidence(*numbers: float) -> NDArray[np.float32]:
    """Return evidence (E, SECTORS), the same in all sectors, whose logarithms in grains of 1 are these numbers."""
    return np.repeat(np.expm1(np.array(numbers, np.float32))[:, None], SECTORS, axis=1)


def test_a_sector_and_those_beside_it_count_in_grains() -> None:
    evidence = np.zeros((3, SECTORS), np.float32)
    evidence[0, [0, 71]] = [6.0, 3.0]
    evidence[1] = np.nan
    evidence[1, 5] = 3.0
    evidence[2] = np.nan
    kinds = {name: _kind(name, grain) for name, grain in (("a", 2.0), ("b", 1.0), ("c", 1.0))}
    numbers = numbers_of(evidence, kinds)
    # Means of three in a circle; where a sector is not known, of those that are.
    assert_allclose(numbers[0, [69, 70, 71, 0, 1, 2]], np.log1p([0.0, 0.5, 1.5, 1.5, 1.0, 0.0]))
    assert_allclose(numbers[1, 3:8], [np.nan, np.log(4.0), np.log(4.0), np.log(4.0), np.nan])
    assert np.isnan(numbers[2]).all()


def test_a_sector_counts_by_what_is_beyond_its_last_five_sweeps() -> None:
    kinds = {"one-sided": _kind("a", 1.0), "two-sided": _kind("b", 1.0, two_sided=True)}
    past = Past(np.ones(2, np.float32), kinds)
    before, now = np.zeros((2, 2, SECTORS), np.float32)
    before[:, 10] = 5.0
    now[:, [12, 13, 30]] = 7.0
    past.add(before)
    for _ in range(ONSET_SWEEPS - 1):
        past.add(np.full((2, SECTORS), np.nan, np.float32))
    onset = past.onset(now)
    # Sector 12 is beside one that had 5, sector 13 is not; two-sided kinds are the sensor's, not a sector's.
    assert onset[0, [10, 12, 13, 30]].tolist() == [0.0, 2.0, 7.0, 7.0]
    assert_array_equal(onset[1], now[1])
    past.add(now)
    assert past.onset(before)[0].max() == 0.0 < past.copy().onset(2 * now)[0].max(), "the oldest sweep is forgotten"
    assert past.onset(before + 1.0)[0, 10] == 0.0


def test_what_is_usual_in_a_stream_is_no_change() -> None:
    rng = np.random.default_rng(0)
    past = Past(np.array([0.1, 0.1], np.float32), STATE)
    for _ in range(MEMORY_SWEEPS):
        past.add(_evidence(*rng.normal([5.0, 3.0], [0.2, 0.05])))
    usual = past.reference()
    assert_allclose(usual.location, [5.0, 3.0], atol=0.03)
    assert_allclose(usual.scale, [0.2, 0.05], rtol=0.35)
    one_sided = Reference(usual.location, usual.scale, np.array([False, True]))
    # Two sectors: higher and lower.
    changes = one_sided.changes(np.array([[6.0, 4.0], [3.3, 2.7]], np.float32))
    assert changes[0, 0] > 3.0 > changes[0, 1] + 5.0, "less of a one-sided kind is no change"
    assert changes[1, 0] == pytest.approx(changes[1, 1], rel=0.2)


def test_a_minute_is_remembered_and_no_more() -> None:
    one, other = (Past(np.ones(2, np.float32), STATE) for _ in range(2))
    for value in range(100):
        one.add(_evidence(1.0 + 0.1 * value, 0.0))
    for value in np.random.default_rng(1).normal(5.0, 1.0, MEMORY_SWEEPS):
        one.add(_evidence(value, 0.0))
        other.add(_evidence(value, 0.0))
    assert_array_equal(one.reference().location, other.reference().location)
    assert_array_equal(one.reference().scale, other.reference().scale)


def test_the_first_seconds_are_standardized_by_the_calibration() -> None:
    past = Past(np.full(2, 2.0, np.float32), STATE)
    for _ in range(PRIOR_SWEEPS):
        past.add(_evidence(7.0, 7.0))
    # No spread of its own in as many sweeps as the prior counts for: half of its variance.
    assert past.reference().scale[0] == pytest.approx(2.0 / np.sqrt(2.0))


def test_one_attack_in_the_past_does_not_hide_the_next() -> None:
    rng = np.random.default_rng(2)
    past = Past(np.full(2, 0.1, np.float32), STATE)
    for number in range(500):
        past.add(_evidence(9.0 if number % 200 < 3 else 1.0 + 0.1 * rng.normal(), 0.0))  # 1.8 % of the sweeps
    assert past.reference().changes(np.array([[9.0], [0.0]], np.float32))[0, 0] > 20.0


@settings(max_examples=30)
@given(st.lists(st.floats(-5.0, 50.0), min_size=20, max_size=60), st.floats(0.0, 50.0), st.floats(0.0, 50.0))
def test_rarer_is_more_surprising(benign: list[float], one: float, more: float) -> None:
    scale = SurpriseScale.fit([np.array(benign)[:, None]])
    low, high = scale(np.array([[one], [one + more]]))[:, 0]
    assert 0.0 <= low <= high


def test_surprise_is_the_logarithm_of_a_share() -> None:
    # Peaks stand apart: each sweep of 10,000 is a stream's only one.
    numbers = np.random.default_rng(3).exponential(1.0, (10_000, 1, 1))
    scale = SurpriseScale.fit(list(numbers))
    assert_allclose(scale(-np.log(10.0) * np.array([[0.0], [-1.0], [-2.0], [-3.0]]))[:, 0], [0, 1, 2, 3], atol=0.15)


def test_the_tail_goes_on_beyond_all_that_was_seen_and_the_more_minutes_the_rarer() -> None:
    rng = np.random.default_rng(4)
    # One in 10^6 of an exponential distribution; the tail of few peaks is uncertain, so it is heavier.
    beyond = np.array([[6.0 * np.log(10.0)]])
    few, many = (
        np.mean([SurpriseScale.fit(list(rng.exponential(1.0, (streams, 400, 1))))(beyond) for _ in range(8)])
        for streams in (5, 80)
    )
    assert 3.5 < few < many < 6.5
    heavy = SurpriseScale.fit(list(rng.pareto(2.0, (80, 400, 1))))
    assert heavy(np.array([[1000.0]]))[0, 0] == pytest.approx(6.0, abs=0.7), "P(x > 1,000) is about 10^-6"


def test_evidence_that_always_abstained_or_never_spoke_counts_little() -> None:
    scale = SurpriseScale.fit([np.full((50, 1), np.nan)])
    assert scale(np.array([[9.0]]))[0, 0] == 0.0
    never = SurpriseScale.fit([np.zeros((50, 1))])
    assert never(np.array([[0.0]]))[0, 0] == 0.0
    assert np.log10(50.0) < never(np.array([[50.0]]))[0, 0] < 5.0


def test_one_kind_beyond_doubt_counts_and_several_count_more_in_one_place() -> None:
    surprises = np.zeros((3, 2, SECTORS))
    surprises[:, 0, 10] = 5.0
    surprises[1, 1, 10] = surprises[2, 1, 50] = 4.0
    scores = sector_scores(surprises, np.array([False, False])).max(axis=1)
    assert scores[[0, 2]] == pytest.approx(3.5)
    assert 3.5 < scores[1] < 6.0
    assert sector_scores(surprises, np.array([True, True])).max(axis=1) == pytest.approx(3.5), "of one place"
    assert sector_scores(surprises, np.array([True, False])).max(axis=1) == pytest.approx(scores)
