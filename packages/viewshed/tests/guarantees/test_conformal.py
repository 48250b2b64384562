"""Masks with a promised error: the tests against scipy, the promise on scenes drawn by chance, the choice by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from viewshed.fov.estimate import FovEstimate
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import CAR
from viewshed.grid import BevGrid
from viewshed.guarantees.conformal import (
    THRESHOLDS,
    Calibration,
    SceneCounts,
    binomial_tail,
    calibration_for,
    lower_bound,
)

GRID = BevGrid(40, 50.0)
GROUND = HeightMap.flat(50.0, std_m=0.06)


def scene(rng: np.random.Generator) -> tuple[FovEstimate, SceneCounts, np.ndarray]:
    """Return an estimate whose probability is off by an error that the scene's cells share."""
    prob = rng.random(GRID.shape).astype(np.float32)
    visible = rng.random(GRID.shape) < np.clip(prob + rng.normal(0.15, 0.15), 0.0, 1.0)
    estimate = FovEstimate(GRID, prob, np.zeros(GRID.shape, np.uint8), method="by_chance", target=CAR)
    known = np.ones(GRID.shape, np.bool_)
    return estimate, SceneCounts.of(estimate, GROUND, visible, known, rng), visible


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 60), st.integers(1, 60), st.floats(0.01, 0.99))
def test_binomial_as_scipy(count: int, trials: int, share: float) -> None:
    count = min(count, trials)
    assert binomial_tail(count, trials, share) == pytest.approx(stats.binom.cdf(count, trials, share), abs=1e-9)
    exact = stats.beta.ppf(0.05, count, trials - count + 1) if count else 0.0
    assert lower_bound(count, trials, 0.95) == pytest.approx(exact, abs=1e-9)


def test_the_loosest_mask_before_the_first_that_fails() -> None:
    # 100 test scenes; broken 0, 3, 5, 9 and 0 of them. At delta .1 and confidence .9 up to 5 may be
    # (P(N ≤ 5) = .058, P(N ≤ 6) = .117), and the last mask comes too late.
    shares = np.zeros((5, 100), np.float32)
    for step, broken in enumerate((0, 3, 5, 9, 0)):
        shares[step, :broken] = 0.2
    calibration = Calibration(
        "toy",
        "car",
        "by_chance",
        np.full(5, np.inf, np.float32),
        np.tile(THRESHOLDS[4:9, None], (1, 4)),
        shares,
        np.zeros((4, 6, 2), np.int64),
    )
    assert calibration.step(0.05, 0.1) == 2
    assert calibration.step(0.25, 0.1) == 4
    assert calibration.step(0.05, 0.01) == -1
    estimate = scene(np.random.default_rng(0))[0]
    assert (calibration.mask(estimate, GROUND, 0.05, 0.1) == (estimate.visible_prob >= THRESHOLDS[6])).all()
    with pytest.raises(ValueError, match="nothing is guaranteed"):
        calibration.mask(estimate, GROUND, 0.05, 0.01)
    with pytest.raises(ValueError, match=r"alpha must lie in \(0, 1\)"):
        calibration.mask(estimate, GROUND, 0.0, 0.1)
    with pytest.raises(ValueError, match="must be of network"):
        calibration.mask(FovEstimate(GRID, estimate.visible_prob, estimate.state, method="network"), GROUND)


@pytest.mark.slow
def test_the_promise_holds_for_new_scenes() -> None:
    # At confidence .9 one calibration in ten at most promises too much: more than 4 of 10, a chance of 1 in 600.
    rng, broken = np.random.default_rng(7), 0
    for _ in range(10):
        counts = [scene(rng)[1] for _ in range(120)]
        calibration = Calibration.fit(counts, "toy", "car", "by_chance")
        step = calibration.step(0.2, 0.1)
        if step < 0:
            continue
        false = []
        for _ in range(150):
            estimate, _, visible = scene(rng)
            claim = calibration.mask(estimate, GROUND, 0.2, 0.1)
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
        claim = again.mask(estimate, GROUND, 0.3, 0.4)
        assert (claim & ~visible).sum() / claim.sum() == pytest.approx(calibration.shares[step, number], abs=1e-6)


def test_places() -> None:
    rng = np.random.default_rng(5)
    counts = [scene(rng)[1] for _ in range(100)]
    calibration = Calibration.fit(counts, "toy", "car", "by_chance")
    estimate = scene(rng)[0]
    xy = GRID.centers[::7, ::7]
    bound = calibration.at(estimate, xy)
    assert (bound[estimate.at(xy) < 0.5] == 0.0).all()
    assert np.isnan(calibration.at(estimate, np.array([999.0, 0.0])))
    i, j = np.argwhere(estimate.visible_prob > 0.999)[0]
    band = int(np.digitize(np.hypot(*GRID.centers[i, j]), [15, 30, 45]))
    drawn = np.array([one.drawn[band, 5] for one in counts[50:]])
    trials, successes = int((drawn >= 0).sum()), int((drawn == 1).sum())
    assert calibration.at(estimate, GRID.centers[i, j]) == pytest.approx(
        stats.beta.ppf(0.05, successes, trials - successes + 1)
    )


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
    shares = np.zeros((1, 100), np.float32)
    path = np.full((1, 4), 0.5, np.float32)
    calibration = Calibration(
        "toy", "car", "by_chance", np.array([0.1], np.float32), path, shares, np.zeros((4, 6, 2), np.int64)
    )
    estimate = scene(np.random.default_rng(0))[0]
    std = np.full((64, 64), 0.05, np.float32)
    std[32:] = 0.2  # forward
    ground = HeightMap(np.zeros((64, 64), np.float32), 50.0, np.ones((64, 64), np.bool_), std_m=std)
    claim = calibration.mask(estimate, ground)
    assert (claim[:19] == estimate.visible()[:19]).all()
    assert not claim[21:].any()
