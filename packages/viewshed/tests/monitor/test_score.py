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
from viewshed.monitor.evidence import EVIDENCE, SECTORS, MonitoredSweep
from viewshed.monitor.score import (
    NEIGHBORS,
    SECTOR_FEATURES,
    STATISTICS,
    EvidenceScore,
    StatisticsNetwork,
    SurpriseScale,
    WholeSweep,
    features,
    features_of,
    measure_all,
    pooled,
    statistics,
    sum_of_odds,
    surprises_of_statistics,
)
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep

RNG = np.random.Generator(np.random.PCG64(1))

BENIGN = RNG.exponential(size=(200, 2, SECTORS)).astype(np.float32)
"""Two kinds of evidence, on 200 sweeps."""


def score_of(evidence: int = 2, hidden: int = 2) -> EvidenceScore:
    """Return a score whose first hidden unit is the sector's first surprise, and the second the sweep's last maximum.

    Features come as surprises, neighbors' of all distances, medians, maxima, shares.
    """
    count = features_of(evidence)
    weights = np.zeros((count, hidden), np.float32)
    weights[0, 0] = 1.0
    weights[(SECTOR_FEATURES + 2) * evidence - 1, 1] = 1.0
    scale = SurpriseScale.fit(np.resize(BENIGN, (200, evidence, SECTORS)))
    return EvidenceScore(
        tuple("abcdef"[:evidence]), scale, np.zeros(count, np.float32), np.ones(count, np.float32), weights,
        np.zeros(hidden, np.float32), np.eye(hidden, 2, dtype=np.float32), np.zeros(2, np.float32),
    )  # fmt: skip


def network(seed: int, inputs: int = 2 * STATISTICS, kinds: int = 2) -> StatisticsNetwork:
    """Return a network that falls with medians, the last of its inputs, alone."""
    rng = np.random.Generator(np.random.PCG64(seed))
    first, second, outputs = rng.random((inputs, 6)), rng.random((6 + inputs, 3)), rng.random(3 + inputs)
    for weights in (first, second, outputs):
        weights[-kinds:] *= -1.0
    return StatisticsNetwork(*(part.astype(np.float32) for part in (first, second, outputs, rng.normal(size=10))))


def whole_sweep() -> WholeSweep:
    """Return what judges whole sweeps of two kinds of evidence."""
    scale = SurpriseScale.fit(statistics(BENIGN)[..., None])
    parts = SurpriseScale.fit(RNG.normal(size=(200, 3, 1)) * 3.0)
    return WholeSweep(scale, network(1), network(2), network(3), parts)


WHOLE = replace(score_of(), whole=whole_sweep())


def test_statistics_by_hand() -> None:
    evidence = np.zeros((2, 2, SECTORS), np.float32)
    evidence[0, 0, [5, 40, 41]] = 6.0, 3.0, 9.0
    evidence[1, 0] = np.nan
    evidence[1, 0, :4] = 4.0, 1.0, 2.0, 5.0
    evidence[1, 1] = np.nan
    found = statistics(evidence).reshape(2, STATISTICS, 2)
    assert_allclose(found[0, :, 0], [9.0, 6.0, 2.0, 0.25, 0.0])
    # Where most sectors abstain the means are of those that do not; of four, the lower middle one is the median.
    assert_allclose(found[1, :, 0], [5.0, 11 / 3, 3.0, 3.0, 2.0])
    assert np.isnan(found[1, :, 1]).all()


@given(arrays(np.float32, (3, 7), elements=st.floats(0.0, 9.0, width=32)))
def test_a_sum_of_odds_is_the_largest_and_a_little_more(surprises: np.ndarray) -> None:
    found = sum_of_odds(surprises)
    assert (found >= surprises.max(axis=1) - 1e-5).all()
    assert (found <= surprises.max(axis=1) + 2.0 * np.log10(7) + 1e-5).all()


@given(st.integers(0, 1), st.integers(0, SECTORS - 1), st.floats(0.0, 50.0), st.integers(0, 199))
def test_more_of_a_raised_sector_is_never_less_doubt(kind: int, sector: int, more: float, sweep: int) -> None:
    before = BENIGN[sweep].copy()
    # A sector above the median stays above it, so that the context is the same.
    before[kind, sector] = max(before[kind, sector], np.median(before[kind]) + 0.1)
    after = before.copy()
    after[kind, sector] += more
    assert WHOLE(after).inconsistent >= WHOLE(before).inconsistent - 1e-4


def test_evidence_that_abstains_counts_as_common() -> None:
    silent, common = BENIGN[:1].copy(), BENIGN[:1].copy()
    silent[:, 1], common[:, 1] = np.nan, 0.0
    surprises = [surprises_of_statistics(whole_sweep().scale, statistics(each)) for each in (silent, common)]
    assert_array_equal(surprises[0], surprises[1])
    assert np.isfinite(WHOLE(np.full((2, SECTORS), np.nan, np.float32)).inconsistent)


def test_what_is_rare_counts_without_any_network() -> None:
    still = StatisticsNetwork(*(np.zeros_like(getattr(network(1), name)) for name in network(1).__slots__))
    silent = replace(whole_sweep(), in_context=still, by_itself=still, degraded=still)
    evidence = BENIGN[:20].copy()
    evidence[:, 1, 30:33] += 20.0
    assert (silent(evidence)[:, 0] > silent(BENIGN[:20])[:, 0] + 0.5).all()


def test_a_whole_sweep_by_hand() -> None:
    surprises = np.zeros((1, 2 * STATISTICS), np.float32)
    surprises[0, 0] = 2.0
    first, second = np.zeros((10, 3), np.float32), np.zeros((13, 3), np.float32)
    first[0], second[1] = 1.0, 0.5
    outputs = np.concatenate([np.ones(3), [0.25], np.zeros(9)]).astype(np.float32)
    one = StatisticsNetwork(first, second, outputs, np.array([0, 0, -4, 0, 0, 0, 1], np.float32))
    # The first layer is 2, min(2, 1) and -1; the second sees the middle one: .5 in all three units.
    assert_allclose(one(surprises), 3 * 0.5 + 0.25 * 2.0 + 1.0)


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
    assert NEIGHBORS[:3] == ((1,), (2, 3), (4, 5, 6))
    surprises = np.zeros((1, 2, SECTORS), np.float32)
    surprises[0, 0, [3, 4]] = 2.0, 4.0
    surprises[0, 1] = np.nan
    of_sectors, of_sweep = features(surprises)
    first = of_sectors[0].reshape(SECTORS, SECTOR_FEATURES, 2)[..., 0]
    assert_allclose(first[3], [2.0, 2.0, 0.0, 0.0, 0.0])
    assert_allclose(first[5], [0.0, 2.0, 0.5, 0.0, 0.0])
    assert_allclose(first[9], [0.0, 0.0, 0.0, 1.0, 0.0])
    assert_allclose(first[69], [0.0, 0.0, 0.0, 2 / 6, 4 / 12])
    assert not of_sectors[0].reshape(SECTORS, SECTOR_FEATURES, 2)[..., 1].any(), "evidence that abstains says nothing"
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
    assert again.whole is None
    whole = EvidenceScore.from_arrays(WHOLE.arrays())
    assert_array_equal(whole.of_sweeps(BENIGN[:9]), WHOLE.of_sweeps(BENIGN[:9]))


def test_refuses_what_does_not_fit() -> None:
    score = score_of()
    with pytest.raises(ValueError, match=r"evidence must be 2 lines of 72 sectors \(a, b\), got shape"):
        score(np.zeros((3, SECTORS)))
    with pytest.raises(ValueError, match="mean must have shape"):
        replace(score, names=("a", "b", "c"))
    with pytest.raises(ValueError, match="scale must be of 2 kinds of evidence, got 3"):
        replace(score, scale=score_of(3).scale)
    with pytest.raises(ValueError, match="whole must be of 15 statistics, got 10; train the score again"):
        replace(score_of(3), whole=whole_sweep())
    with pytest.raises(ValueError, match=r"layers must have shapes .* in thirds, got"):
        replace(network(1), outputs=np.zeros(4, np.float32))
    with pytest.raises(ValueError, match="values must ascend"):
        SurpriseScale(score.scale.values[:, ::-1], score.scale.surprises)


def test_measures_all_evidence_in_order() -> None:
    points = RNG.normal(size=(500, 3)).astype(np.float32) * 10
    monitored = MonitoredSweep(level(Sweep(points, sensor_height_m=1.8), BevGrid(64, 32.0)))
    measured = measure_all(monitored)
    assert measured.shape == (len(EVIDENCE), SECTORS)
    for line, evidence in zip(measured, EVIDENCE.values(), strict=True):
        assert_array_equal(line, evidence.measure(monitored))
