"""ROC, its area and limits of alarms against brute force over all pairs, and coverage of the interval by simulation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewshed.monitor.calibration import alarm_limit
from viewshed.monitor.roc import auroc, auroc_interval, roc_curve, tpr_at_fpr

SCORES = st.lists(st.integers(0, 8), min_size=1, max_size=12)


@given(SCORES, SCORES)
def test_area_counts_pairs(benign: list[int], attacked: list[int]) -> None:
    pairs = [1.0 if a > b else 0.5 if a == b else 0.0 for a in attacked for b in benign]
    assert auroc(benign, attacked) == pytest.approx(sum(pairs) / len(pairs), abs=1e-15)
    assert auroc(benign, attacked) == pytest.approx(1 - auroc(attacked, benign), abs=1e-15)


@given(SCORES, SCORES)
def test_curve_by_counting_and_its_area(benign: list[int], attacked: list[int]) -> None:
    false, true, limits = roc_curve(benign, attacked)
    for f, t, limit in zip(false, true, limits, strict=True):
        assert f == pytest.approx(sum(b > limit for b in benign) / len(benign))
        assert t == pytest.approx(sum(a > limit for a in attacked) / len(attacked))
    assert (false[0], true[0], false[-1], true[-1]) == (0, 0, 1, 1)
    assert np.trapezoid(true, false) == pytest.approx(auroc(benign, attacked), abs=1e-12)


@given(SCORES, SCORES, st.sampled_from([0.0, 0.01, 0.1, 0.25, 0.5, 1.0]))
def test_caught_at_a_rate_by_trying_every_limit(benign: list[int], attacked: list[int], rate: float) -> None:
    tried = [
        sum(a > limit for a in attacked) / len(attacked)
        for limit in range(-1, 10)
        if sum(b > limit for b in benign) <= rate * len(benign) + 1e-9
    ]
    assert tpr_at_fpr(benign, attacked, rate) == pytest.approx(max(tried))


def test_the_interval_holds_the_true_area_about_as_often_as_it_says() -> None:
    """Normal scores one apart have an area of Φ(1 / √2) = .7602."""
    rng, inside = np.random.default_rng(5), 0
    for _ in range(150):
        low, high = auroc_interval(rng.normal(0, 1, 40), rng.normal(1, 1, 40), rng, draws=300)
        inside += low <= 0.7602 <= high
    assert 0.88 <= inside / 150 <= 0.99


def test_pairs_are_drawn_together() -> None:
    """A sample that is always above all others in both roles leaves no doubt if its pair is drawn with it."""
    base = np.arange(20.0)
    paired = auroc_interval(base, base + 0.5, np.random.default_rng(0), paired=True)
    apart = auroc_interval(base, base + 0.5, np.random.default_rng(0))
    assert apart[1] - apart[0] > 4 * (paired[1] - paired[0]) > 0
    assert paired[0] < auroc(base, base + 0.5) < paired[1] + 1e-3
    again = auroc_interval(base, base + 0.5, np.random.default_rng(0))
    assert again == apart


@pytest.mark.parametrize("rate", [0.3, 0.1, 0.05])
@pytest.mark.parametrize("count", [19, 20, 47])
def test_a_further_sweep_alarms_at_most_as_often_as_chosen(rate: float, count: int) -> None:
    """Of n + 1 exchangeable scores each is the further one with equal probability: leave every one out in turn."""
    scores = np.random.default_rng(count).permutation(count + 1).astype(float)
    alarms = sum(scores[k] > alarm_limit(np.delete(scores, k), rate) for k in range(count + 1))
    assert alarms / (count + 1) <= rate
    assert (alarms + 1) / (count + 1) > rate, "a smaller limit would do as well"


@pytest.mark.parametrize(("rate", "need"), [(0.05, 19), (0.01, 99), (0.001, 999), (0.3, 3), (0.1, 9), (0.5, 1)])
def test_too_few_benign_sweeps_are_named(rate: float, need: int) -> None:
    with pytest.raises(ValueError, match=rf"rate of {rate} needs at least {need} benign sweeps, got {need - 1}"):
        alarm_limit(np.arange(need - 1), rate)
    assert alarm_limit(np.arange(need), rate) == need - 1


def test_bad_scores_and_rates() -> None:
    with pytest.raises(ValueError, match="benign must be one or more scores"):
        auroc([], [1.0])
    with pytest.raises(ValueError, match=r"attacked must be .* none of them NaN"):
        roc_curve([1.0], [np.nan])
    with pytest.raises(ValueError, match="pairs must be complete, got 1 benign and 2"):
        auroc_interval([1.0], [1.0, 2.0], np.random.default_rng(0), paired=True)
    with pytest.raises(ValueError, match=r"rate must lie in \[0, 1\], got 1\.5"):
        tpr_at_fpr([1.0], [1.0], 1.5)
    with pytest.raises(ValueError, match=r"false-alarm rate must lie in \(0, 1\), got 0"):
        alarm_limit([1.0], 0)
