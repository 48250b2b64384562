"""Masks with a promised error: the tests against scipy and MAPIE, the promises on scenes drawn by chance."""

import warnings
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from viewshed.fov.estimate import FovEstimate
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import CAR
from viewshed.grid import BevGrid
from viewshed.guarantees.conformal import (
    PLACE_EDGES,
    THRESHOLDS,
    Calibration,
    SceneCounts,
    binomial_tail,
    calibration_for,
    lower_bound,
)

GRID = BevGrid(40, 50.0)
GROUND = HeightMap.flat(50.0, std_m=0.06)
BIAS, SPREAD = 0.15, 0.15


def scene(rng: np.random.Generator) -> tuple[FovEstimate, SceneCounts, NDArray[np.bool_]]:
    """Return an estimate whose probability is off by an error that the scene's cells share."""
    prob = rng.random(GRID.shape).astype(np.float32)
    visible = rng.random(GRID.shape) < np.clip(prob + rng.normal(BIAS, SPREAD), 0.0, 1.0)
    estimate = FovEstimate(GRID, prob, np.zeros(GRID.shape, np.uint8), method="by_chance", target=CAR)
    known = np.ones(GRID.shape, np.bool_)
    return estimate, SceneCounts.of(estimate, GROUND, visible, known, rng), visible


def calibration_of(shares: NDArray[np.float32], std: int = -1) -> Calibration:
    """Return a calibration whose masks, of one threshold each, have false shares (steps, scenes)."""
    stds, levels = np.full(len(shares), std), np.tile(np.arange(len(shares))[:, None], (1, 4))
    return Calibration("toy", "car", "by_chance", stds, levels, shares, np.zeros((4, 6, 2), np.int64))


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 60), st.integers(1, 60), st.floats(0.01, 0.99))
def test_binomial_as_scipy(count: int, trials: int, share: float) -> None:
    count = min(count, trials)
    assert binomial_tail(count, trials, share) == pytest.approx(stats.binom.cdf(count, trials, share), abs=1e-9)
    exact = stats.beta.ppf(0.05, count, trials - count + 1) if count else 0.0
    assert lower_bound(count, trials, 0.95) == pytest.approx(exact, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.1, 0.3]), st.sampled_from([0.5, 0.9, 0.99]))
def test_steps_as_mapie(seed: int, delta: float, confidence: float) -> None:
    # Of 128 scenes: MAPIE rounds the product of mean and number up, which is exact for a power of two.
    mapie, rng = pytest.importorskip("mapie.risk_control"), np.random.default_rng(seed)
    rates = np.sort(rng.uniform(0.0, 1.5 * delta, 12)) if seed % 2 else rng.uniform(0.0, 1.2 * delta, 12)
    shares = np.where(rng.random((12, 128)) < rates[:, None], 0.2, 0.04).astype(np.float32)
    controller = mapie.BinaryClassificationController(
        lambda scenes, step: (shares[int(step), scenes] > 0.05).astype(int), "predicted_positive_fraction", delta,
        confidence, "predicted_positive_fraction", list_predict_params=np.arange(12)[:, None],
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that no mask passes
        controller.calibrate(np.arange(128), np.zeros(128))
    passed = mapie.control_fwer(controller.p_values[:, 0], 1.0 - confidence, "fixed_sequence")
    assert calibration_of(shares).step(0.05, delta, confidence) == len(passed) - 1


def test_what_is_no_mask_says_so() -> None:
    shares = np.zeros((5, 100), np.float32)
    shares[3:, :40] = 0.2
    calibration, estimate = calibration_of(shares), scene(np.random.default_rng(0))[0]
    assert (calibration.guaranteed(estimate, GROUND) == (estimate.visible_prob >= THRESHOLDS[2])).all()
    abstaining = replace(estimate, threshold=0.9)  # what it does not claim is no part of a promise
    assert (calibration.guaranteed(abstaining, GROUND) == abstaining.visible()).all()
    assert (calibration.guaranteed_at(abstaining, GRID.centers)[~abstaining.visible()] == 0.0).all()
    unsure = FovEstimate(
        GRID, np.minimum(estimate.visible_prob, np.float32(0.4)), estimate.state, method=estimate.method
    )
    with pytest.warns(UserWarning, match="nothing of this sweep is guaranteed at alpha 0.05, delta 0.1: no claim"):
        assert not calibration.guaranteed(unsure, GROUND).any()
    with pytest.raises(ValueError, match="nothing is guaranteed at alpha 0"):
        calibration.guaranteed(estimate, GROUND, 0.05, 0.01)
    for numbers in ((0.0, 0.1), (1.0, 0.1), (0.05, 0.0), (0.05, 1.0), (np.nan, 0.1), (0.05, 0.1, 1.0)):
        with pytest.raises(ValueError, match=r"must lie in \(0, 1\)"):
            calibration.guaranteed(estimate, GROUND, *numbers)
    other = FovEstimate(GRID, estimate.visible_prob, estimate.state, method="network")
    for promise in (
        lambda: calibration.guaranteed(other, GROUND),
        lambda: calibration.guaranteed_at(other, np.zeros(2)),
    ):
        with pytest.raises(ValueError, match="must be of network"):
            promise()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:nothing of this sweep")
def test_the_promise_holds_for_new_scenes() -> None:
    # At confidence .9 one calibration in ten at most promises too much: more than 4 of 10, a chance of 1 in 600.
    rng, broken = np.random.default_rng(7), 0
    for _ in range(10):
        calibration = Calibration.fit([scene(rng)[1] for _ in range(120)], "toy", "car", "by_chance")
        if calibration.step(0.2, 0.1) < 0:
            continue
        false = []
        for _ in range(150):
            estimate, _, visible = scene(rng)
            claim = calibration.guaranteed(estimate, GROUND, 0.2, 0.1)
            false.append((claim & ~visible).sum() / max(claim.sum(), 1))
        # Counted as broken only where the new scenes say so beyond chance.
        broken += stats.binom.sf((np.array(false) > 0.2).sum() - 1, 150, 0.1) < 0.01
    assert broken <= 4


def test_counts_and_masks_agree() -> None:
    rng = np.random.default_rng(3)
    scenes = [scene(rng) for _ in range(100)]
    calibration = Calibration.fit([counts for _, counts, _ in scenes], "toy", "car", "by_chance")
    again = Calibration.from_json(calibration.to_json())
    step = calibration.step(0.3, 0.4)
    assert step >= 0
    for number, (estimate, _, visible) in enumerate(scenes[50:53]):
        claim = again.guaranteed(estimate, GROUND, 0.3, 0.4)
        assert (claim & ~visible).sum() / claim.sum() == pytest.approx(calibration.shares[step, number], abs=1e-6)


def test_places_are_visible_as_often_as_guaranteed() -> None:
    # In each bin the bound holds in 95 of 100 calibrations: of 8 · 24 bounds 9.6 at most fail, more than 20 by chance
    # 1 in 1,000 times. Each is at a cell's middle; the truth is the mean over the bin's probabilities and the errors.
    rng, failed, tight = np.random.default_rng(5), 0, 0.0
    edges = np.append(PLACE_EDGES, 1.0)
    errors = stats.norm(BIAS, SPREAD).ppf((np.arange(200) + 0.5) / 200)
    truth = [np.clip(np.linspace(a, b, 200) + errors[:, None], 0, 1).mean() for a, b in pairwise(edges)]
    for _ in range(8):
        calibration = Calibration.fit([scene(rng)[1] for _ in range(100)], "toy", "car", "by_chance")
        for x_m in (5.0, 20.0, 40.0, 48.0):
            for share, (low, high) in zip(truth, pairwise(edges), strict=True):
                prob = np.full(GRID.shape, (low + high) / 2, np.float32)
                estimate = FovEstimate(GRID, prob, np.zeros(GRID.shape, np.uint8), method="by_chance", target=CAR)
                bound = float(calibration.guaranteed_at(estimate, np.array([x_m, 0.0])))
                failed, tight = failed + (bound > share), max(tight, bound)
    assert failed <= 20
    assert tight > 0.9
    estimate = scene(rng)[0]
    xy = GRID.centers[::7, ::7]
    assert (calibration.guaranteed_at(estimate, xy)[estimate.at(xy) < 0.5] == 0.0).all()
    assert np.isnan(calibration.guaranteed_at(estimate, np.array([999.0, 0.0])))


def test_too_few_scenes_and_unknown_sensors() -> None:
    counts = [scene(np.random.default_rng(0))[1]] * 60
    with pytest.raises(ValueError, match="100 or more, got 60"):
        Calibration.fit(counts, "toy", "car", "by_chance")
    calibration = Calibration.fit(counts * 2, "toy", "car", "by_chance")
    with pytest.raises(ValueError, match="needs 50 scenes or more, got 49"):
        calibration.retested(counts[:49], "other")
    assert calibration.retested(counts, "other").sensor == "other"
    with pytest.raises(ValueError, match="no calibration for toy"):
        calibration_for("toy", "car", "shadow_map")


def test_unsure_ground_carries_no_claim() -> None:
    calibration, estimate = calibration_of(np.zeros((1, 100), np.float32), 4), scene(np.random.default_rng(0))[0]
    std = np.full((64, 64), 0.05, np.float32)
    std[32:] = 0.2  # forward
    ground = HeightMap(np.zeros((64, 64), np.float32), 50.0, np.ones((64, 64), np.bool_), std_m=std)
    claim = calibration.guaranteed(estimate, ground)
    assert (claim[:19] == estimate.visible()[:19]).all()
    assert not claim[21:].any()
