"""Scores against torchmetrics, against brute force on every cell, and against laws that sums must obey."""

import json
import warnings
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from viewshed.arrays import F32, Mask
from viewshed.metrics import STEPS, Scores

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # what torch's own imports warn of is not ours
    import torch
    from torchmetrics.functional.classification import (
        binary_accuracy,
        binary_average_precision,
        binary_calibration_error,
        binary_f1_score,
        binary_jaccard_index,
        binary_precision,
        binary_recall,
    )


def _scores(prob: F32, visible: Mask, std: F32 | None = None) -> Scores:
    scores = Scores()
    scores.add(prob, visible, std)
    return scores


def _cells(seed: int, count: int = 3000) -> tuple[F32, Mask]:
    """Probabilities that are skewed and not calibrated, with both classes."""
    rng = np.random.default_rng(seed)
    visible = rng.random(count) < 0.3
    return np.clip(rng.beta(0.6, 0.9, count) + 0.2 * visible, 0, 1).astype(np.float32), visible


def _torch(prob: F32, visible: Mask) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.from_numpy(prob), torch.from_numpy(visible.astype(np.int64))


@pytest.mark.parametrize("threshold", [0.5, 0.7, 0.001, 0.137])
@pytest.mark.parametrize("seed", range(3))
def test_masks_agree_with_torchmetrics(seed: int, threshold: float) -> None:
    prob, visible = _cells(seed)
    ours, theirs = _scores(prob, visible), _torch(prob, visible)
    assert ours.precision(threshold) == pytest.approx(float(binary_precision(*theirs, threshold)), abs=1e-6)
    assert ours.recall(threshold) == pytest.approx(float(binary_recall(*theirs, threshold)), abs=1e-6)
    assert ours.f1(threshold) == pytest.approx(float(binary_f1_score(*theirs, threshold)), abs=1e-6)
    assert ours.accuracy(threshold) == pytest.approx(float(binary_accuracy(*theirs, threshold)), abs=1e-6)
    assert ours.iou(threshold) == pytest.approx(float(binary_jaccard_index(*theirs, threshold)), abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_average_precision_agrees_with_torchmetrics(seed: int) -> None:
    prob, visible = _cells(seed)
    steps = (np.floor(prob * 1000 + 1e-4) / 1000).astype(np.float32)
    exact = float(binary_average_precision(*_torch(steps, visible)))
    assert _scores(steps, visible).auprc() == pytest.approx(exact, abs=1e-6)
    assert _scores(prob, visible).auprc() == pytest.approx(
        float(binary_average_precision(*_torch(prob, visible))), abs=1e-3
    )


@pytest.mark.parametrize("seed", range(3))
def test_calibration_error_agrees_with_torchmetrics(seed: int) -> None:
    prob, visible = _cells(seed)
    prob = np.minimum(prob, np.float32(0.9999))  # torchmetrics has a sixteenth bin for exactly 1
    theirs = float(binary_calibration_error(*_torch(prob, visible), n_bins=15, norm="l1"))
    assert theirs > 0.01
    assert _scores(prob, visible).ece() == pytest.approx(theirs, abs=2e-6)


def test_brier_is_the_mean_squared_error() -> None:
    prob, visible = _cells(7)
    assert _scores(prob, visible).brier() == pytest.approx(np.mean((prob.astype(float) - visible) ** 2), abs=1e-8)


def test_thresholds_are_those_of_float32_comparison() -> None:
    """Every step's edge, and its two neighbors among floats, fall where ``prob >= float32(threshold)`` puts them."""
    edges = (np.arange(1, STEPS + 1) / STEPS).astype(np.float32)
    below, above = np.nextafter(edges, np.float32(0)), np.minimum(np.nextafter(edges, np.float32(2)), np.float32(1))
    prob = np.concatenate([edges, below, above])
    scores = _scores(prob, np.ones(len(prob), np.bool_))
    for step in range(1, STEPS + 1):
        assert scores.counts(step / STEPS)[0] == (prob >= np.float32(step / STEPS)).sum()


def _aurc_by_hand(doubt: NDArray[Any], wrong: Mask) -> float:
    """The mean over all orders of equally doubtful cells, by going through every order."""
    orders = [order for order in permutations(range(len(doubt))) if (np.diff(doubt[list(order)]) >= 0).all()]
    shares = [(wrong[list(order)].cumsum() / np.arange(1, len(doubt) + 1)).mean() for order in orders]
    return float(np.mean(shares))


@settings(max_examples=25)
@given(
    hnp.arrays(np.int64, st.integers(1, 6), elements=st.sampled_from([20, 230, 480, 520, 770, 980])),
    st.integers(0, 2**6 - 1),
)
def test_risk_coverage_area_by_going_through_every_order(thousandths: NDArray[np.int64], bits: int) -> None:
    prob = (thousandths / 1000 + 0.0005).astype(np.float32)  # the middle of a step: doubt is the same from both sides
    visible = np.array([bool(bits >> k & 1) for k in range(len(prob))])
    wrong = (prob >= 0.5) != visible
    doubt = np.round(np.minimum(prob, 1 - prob), 5)
    assert _scores(prob, visible).aurc() == pytest.approx(_aurc_by_hand(doubt, wrong), abs=1e-12)
    std = (np.arange(len(prob))[::-1] % 3 * 0.1).astype(np.float32)
    assert _scores(prob, visible, std).aurc_std() == pytest.approx(_aurc_by_hand(std, wrong), abs=1e-12)


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.lists(st.integers(0, 400), min_size=1, max_size=5))
def test_grouping_and_order_do_not_change_a_bit(seed: int, cuts: list[int]) -> None:
    prob, visible = _cells(seed, 400)
    std = np.abs(prob - np.float32(0.4)) / 2
    whole = _scores(prob, visible, std)
    parts = [_scores(*part) for part in zip(*(np.split(a, sorted(cuts)) for a in (prob, visible, std)), strict=True)]
    total = sum(parts[::-1], Scores())
    shuffled = np.random.default_rng(seed).permutation(400)
    assert total.to_json() == whole.to_json() == _scores(prob[shuffled], visible[shuffled], std[shuffled]).to_json()


@given(st.integers(0, 10_000))
def test_json_gives_the_same_back(seed: int) -> None:
    prob, visible = _cells(seed, 50)
    before = _scores(prob, visible, prob * np.float32(0.3))
    after = Scores.from_json(json.loads(json.dumps(before.to_json())))
    assert after.to_json() == before.to_json()
    assert after.summary(0.7) == before.summary(0.7)
    assert after.cells == 50


def test_reliability_by_hand() -> None:
    scores = _scores(np.array([0.05, 0.03, 0.99], np.float32), np.array([True, False, True]))
    table = scores.reliability()
    assert table[0] == pytest.approx([0.04, 0.5, 2], abs=1e-7)
    assert table[14] == pytest.approx([0.99, 1.0, 1], abs=1e-7)
    assert np.isnan(table[1:14, :2]).all()
    assert scores.ece() == pytest.approx((2 * 0.46 + 0.01) / 3, abs=1e-7)


def test_nothing_scored_is_nan() -> None:
    assert all(np.isnan(value) for value in Scores().summary().values())
    none_visible = _scores(np.zeros(3, np.float32), np.zeros(3, np.bool_))
    assert np.isnan([none_visible.recall(), none_visible.auprc(), none_visible.f1(), none_visible.aurc_std()]).all()
    assert none_visible.accuracy() == 1


def test_what_cannot_be_scored_is_refused_and_leaves_no_trace() -> None:
    scores, seen = Scores(), np.array([True, False])
    with pytest.raises(ValueError, match=r"prob must lie in \[0, 1\]"):
        scores.add([0.5, np.nan], seen)
    with pytest.raises(ValueError, match=r"prob must lie in \[0, 1\]"):
        scores.add([0.5, 1.1], seen)
    with pytest.raises(ValueError, match="visible must be bool"):
        scores.add([0.5, 0.1], [1, 0])
    with pytest.raises(ValueError, match="visible must be bool"):
        scores.add([0.5, 0.1, 0.2], seen)
    with pytest.raises(ValueError, match=r"std must be .* not negative and not NaN"):
        scores.add([0.5, 0.1], seen, [np.nan, 0.1])
    assert scores.cells == 0
    assert scores.to_json() == Scores().to_json()


@pytest.mark.parametrize("threshold", [0.0, 1.001, -0.1, 0.70001])
def test_thresholds_are_whole_steps(threshold: float) -> None:
    with pytest.raises(ValueError, match=r"multiple of 0\.001 in \(0, 1\]"):
        Scores().counts(threshold)


@pytest.mark.parametrize(
    "change", [{"steps": [[1001, 1, 1]]}, {"steps": [[1, -1, 1]]}, {"bins": [[0, 1]]}, {"bins": 3}, {"squares": "x"}]
)
def test_damaged_scores_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="damaged"):
        Scores.from_json(Scores().to_json() | change)
    with pytest.raises(ValueError, match="scores must be of version 1, got 2"):
        Scores.from_json(Scores().to_json() | {"version": 2})
