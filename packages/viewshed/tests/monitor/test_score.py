"""Scores: standardized by the own past, on a common scale, several rare changes count more than one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from viewshed.monitor.evidence import SECTORS, Evidence
from viewshed.monitor.score import (
    MEMORY_SWEEPS,
    PRIOR_SWEEPS,
    Past,
    SurpriseScale,
    added,
    strongest,
)


def _kind(name: str, grain: float) -> Evidence:
    return Evidence(name, lambda _: np.zeros(SECTORS, np.float32), grain, "{value}")


def test_the_three_strongest_sectors_count_in_grains() -> None:
    evidence = np.zeros((3, SECTORS), np.float32)
    evidence[0, [3, 30, 60, 70]] = [6.0, 2.0, 4.0, 1.0]
    evidence[1] = np.nan
    evidence[1, 5] = 3.0
    evidence[2] = np.nan
    kinds = {name: _kind(name, grain) for name, grain in (("a", 2.0), ("b", 1.0), ("c", 1.0))}
    assert_allclose(strongest(evidence, kinds), [np.log(3.0), np.log(4.0), np.nan])


def test_what_is_usual_in_a_stream_is_no_change() -> None:
    rng = np.random.default_rng(0)
    past = Past(np.array([1.0, 1.0], np.float32), np.array([False, True]))
    for _ in range(MEMORY_SWEEPS):
        past.add(rng.normal([50.0, -3.0], [2.0, 0.5]).astype(np.float32))
    usual = past.reference()
    assert_allclose(usual.location, [50.0, -3.0], atol=0.3)
    assert_allclose(usual.scale, [2.0, 0.5], rtol=0.35)
    higher = usual.changes(np.array([60.0, 0.0], np.float32))
    lower = usual.changes(np.array([40.0, -6.0], np.float32))
    assert higher[0] > 3.0 > lower[0] + 5.0, "less of a one-sided kind is no change"
    assert higher[1] == pytest.approx(lower[1], rel=0.2)


def test_a_minute_is_remembered_and_no_more() -> None:
    one, other = (Past(np.ones(1, np.float32), np.array([False])) for _ in range(2))
    for value in range(500):
        one.add(np.array([1000.0 + value], np.float32))
    for value in np.random.default_rng(1).normal(0.0, 1.0, MEMORY_SWEEPS):
        one.add(np.array([value], np.float32))
        other.add(np.array([value], np.float32))
    assert_array_equal(one.reference().location, other.reference().location)
    assert_array_equal(one.reference().scale, other.reference().scale)


def test_the_first_seconds_are_standardized_by_the_calibration() -> None:
    past = Past(np.array([2.0], np.float32), np.array([False]))
    for _ in range(PRIOR_SWEEPS):
        past.add(np.array([7.0], np.float32))
    # No spread of its own in as many sweeps as the prior counts for: half of its variance.
    assert past.reference().scale[0] == pytest.approx(2.0 / np.sqrt(2.0))


def test_one_attack_in_the_past_does_not_hide_the_next() -> None:
    rng = np.random.default_rng(2)
    past = Past(np.ones(1, np.float32), np.array([False]))
    for number in range(300):
        past.add(np.array([100.0 if number % 60 < 3 else rng.normal()], np.float32))  # 5 % of the sweeps
    assert past.reference().changes(np.array([100.0], np.float32))[0] > 20.0


@given(st.lists(st.floats(-5.0, 50.0), min_size=20, max_size=60), st.floats(0.0, 50.0), st.floats(0.0, 50.0))
def test_rarer_is_more_surprising(benign: list[float], one: float, more: float) -> None:
    scale = SurpriseScale.fit(np.array(benign)[:, None])
    low, high = scale(np.array([[one], [one + more]]))[:, 0]
    assert 0.0 <= low <= high


def test_surprise_is_the_logarithm_of_a_share() -> None:
    scale = SurpriseScale.fit(np.arange(10_000.0)[:, None])
    assert_allclose(scale(np.array([[0.0], [9_000.0], [9_900.0], [9_990.0]]))[:, 0], [0.0, 1.0, 2.0, 3.0], atol=0.02)
    assert scale(np.array([[1e5]]))[0, 0] > 4.0


def test_evidence_that_always_abstained_counts_nothing() -> None:
    scale = SurpriseScale.fit(np.full((50, 1), np.nan))
    assert scale(np.array([[9.0]]))[0, 0] == 0.0
    places = np.array([False, False])
    assert added(np.array([[3.0, np.nan]]), places)[0] == pytest.approx(1.0)
    assert added(np.array([[3.0, 3.0]]), places)[0] == pytest.approx(2.0)
    assert added(np.array([[50.0, 1.0]]), places)[0] < added(np.array([[4.0, 4.0]]), places)[0]
    assert added(np.array([[50.0, 1.0]]), ~places)[0] > added(np.array([[50.0, 1.0]]), places)[0]
