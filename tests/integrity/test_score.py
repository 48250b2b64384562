"""The score of evidence: laws of its scale, its pooling, and scores computed by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from viewshed.grid import BevGrid
from viewshed.integrity.evidence import EVIDENCE, SECTORS, MonitoredSweep
from viewshed.integrity.score import EvidenceScore, SurpriseScale, features, features_of, measure_all, pooled
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep

RNG = np.random.Generator(np.random.PCG64(1))

BENIGN = RNG.exponential(size=(200, 2, SECTORS)).astype(np.float32)
"""Two kinds of evidence, on 200 sweeps."""


def score_of(evidence: int = 2, hidden: int = 2) -> EvidenceScore:
    """Return a score whose first hidden unit is the sector's first surprise, and the second the sweep's last maximum.

    Features come as surprises, neighbors', medians, maxima, shares.
    """
    count = features_of(evidence)
    weights = np.zeros((count, hidden), np.float32)
    weights[0, 0] = 1.0
    weights[4 * evidence - 1, 1] = 1.0
    scale = SurpriseScale.fit(np.resize(BENIGN, (200, evidence, SECTORS)))
    return EvidenceScore(
        tuple("abcdef"[:evidence]), scale, np.zeros(count, np.float32), np.ones(count, np.float32), weights,
        np.zeros(hidden, np.float32), np.eye(hidden, 2, dtype=np.float32), np.zeros(2, np.float32),
    )  # fmt: skip


def test_the_surprise_of_a_number_is_how_rare_it_is() -> None:
    scale = SurpriseScale.fit(BENIGN)
    for share in (0.5, 0.1, 0.01, 0.001):
        limit = np.quantile(BENIGN[:, 0], 1 - share)
        evidence = np.full((1, 2, SECTORS), limit, np.float32)
        assert_allclose(scale(evidence)[0, 0], -np.log10(share), atol=0.06)


def test_a_common_value_is_no_surprise() -> None:
    shares = np.where(RNG.uniform(size=(100, 1, SECTORS)) < 0.9, 0.0, 1.0)
    surprises = SurpriseScale.fit(shares)(np.array([0.0, 1.0]).repeat(SECTORS // 2).reshape(1, 1, SECTORS))
    assert_allclose(surprises[0, 0, 0], 0.0)
    assert_allclose(surprises[0, 0, -1], 1.0, atol=0.05)


@given(arrays(np.float32, SECTORS, elements=st.floats(-1e6, 1e6, width=32)))
def test_surprises_never_fall_and_stay_finite(values: np.ndarray) -> None:
    scale = SurpriseScale.fit(BENIGN)
    surprises = scale(np.sort(values).reshape(1, 1, SECTORS).repeat(2, axis=1))[0]
    assert np.isfinite(surprises).all()
    assert (np.diff(surprises) >= -1e-5).all()


def test_beyond_all_benign_numbers_surprise_still_rises() -> None:
    scale = SurpriseScale.fit(BENIGN)
    far = BENIGN[:, 0].max() * np.array([1.0, 2.0, 10.0, np.inf], np.float32)
    surprises = scale(np.resize(far, (1, 2, SECTORS)))[0, 0, :4]
    assert (np.diff(surprises) > 0.1).all()
    assert np.isfinite(surprises).all()


def test_evidence_that_always_abstained_says_nothing() -> None:
    benign = BENIGN.copy()
    benign[:, 1] = np.nan
    scale = SurpriseScale.fit(benign)
    assert np.isnan(scale(benign[:1])[0, 1]).all()
    assert_array_equal(scale.surprises[1], 0.0)


def test_features_by_hand() -> None:
    surprises = np.zeros((1, 2, SECTORS), np.float32)
    surprises[0, 0, [3, 4]] = 2.0, 4.0
    surprises[0, 1] = np.nan
    of_sectors, of_sweep = features(surprises)
    assert_array_equal(of_sectors[0, 3], [2.0, np.nan, 2.0, np.nan])
    assert_array_equal(of_sectors[0, 5], [0.0, np.nan, 2.0, np.nan])
    assert_allclose(of_sweep[0], [0.0, np.nan, 4.0, np.nan, 2 / SECTORS, np.nan])


def test_pooling_lies_between_mean_and_maximum() -> None:
    logits = RNG.normal(size=(50, SECTORS, 2)).astype(np.float32) * 5
    scores = pooled(logits)
    assert (scores <= logits.max(axis=1) + 1e-5).all()
    assert (scores >= logits.mean(axis=1) - 1e-5).all()
    assert_allclose(pooled(np.full((1, SECTORS, 2), 3.0, np.float32)), 3.0, rtol=1e-6)


def test_a_raised_sector_is_where_the_score_comes_from() -> None:
    evidence = np.zeros((2, SECTORS), np.float32)
    evidence[0, 17] = evidence[1, 30] = 20.0
    scores = score_of()(evidence)
    assert int(scores.sectors.argmax()) == 17
    # All other sectors say 0 of what is inconsistent; the sweep's maximum is the same in all of them.
    assert_allclose(scores.inconsistent, np.log((np.exp(scores.sectors[17]) + SECTORS - 1) / SECTORS), rtol=1e-5)
    assert scores.degraded > 4


def test_abstaining_is_neutral() -> None:
    evidence = np.zeros((2, SECTORS), np.float32)
    benign = score_of()(evidence)
    evidence[1] = np.nan
    abstained = score_of()(evidence)
    assert abstained.inconsistent == benign.inconsistent
    assert np.isfinite(score_of()(np.full((2, SECTORS), np.nan, np.float32)).inconsistent)


@given(st.integers(0, SECTORS - 1))
def test_turning_the_sweep_turns_the_sectors(shift: int) -> None:
    evidence = BENIGN[0]
    before, after = score_of()(evidence), score_of()(np.roll(evidence, shift, axis=1))
    assert_allclose(after.sectors, np.roll(before.sectors, shift), atol=1e-5)
    assert_allclose(after.inconsistent, before.inconsistent, atol=1e-5)


def test_arrays_hold_all_of_a_score() -> None:
    score = score_of(3)
    again = EvidenceScore.from_arrays(score.arrays())
    assert again.names == score.names
    evidence = BENIGN[:1, [0, 1, 0]]
    assert_array_equal(again.logits(evidence), score.logits(evidence))


def test_refuses_what_does_not_fit() -> None:
    score = score_of()
    with pytest.raises(ValueError, match=r"evidence must be 2 lines of 72 sectors \(a, b\), got shape"):
        score(np.zeros((3, SECTORS)))
    with pytest.raises(ValueError, match="mean must have shape"):
        replace(score, names=("a", "b", "c"))
    with pytest.raises(ValueError, match="scale must be of 2 kinds of evidence, got 3"):
        replace(score, scale=score_of(3).scale)
    with pytest.raises(ValueError, match="values must ascend"):
        SurpriseScale(score.scale.values[:, ::-1], score.scale.surprises)


def test_measures_all_evidence_in_order() -> None:
    points = RNG.normal(size=(500, 3)).astype(np.float32) * 10
    monitored = MonitoredSweep(level(Sweep(points, sensor_height_m=1.8), BevGrid(64, 32.0)))
    measured = measure_all(monitored)
    assert measured.shape == (len(EVIDENCE), SECTORS)
    for line, evidence in zip(measured, EVIDENCE.values(), strict=True):
        assert_array_equal(line, evidence.measure(monitored))
