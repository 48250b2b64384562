"""The probability of visible: laws, the network in NumPy, and exact truth that it was not fitted to."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from viewshed import CAR, GRIDS, Sweep, load_estimator
from viewshed.arrays import F32, F64
from viewshed.fov.estimate import THRESHOLD
from viewshed.fov.visibility import probability_of_visible
from viewshed.grid import polar_of_cells
from viewshed.preprocess.evidence import beam_evidence, cell_features
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed_lab.data.wild import WildObservation, wild_scenes
from viewshed_lab.training.no_return import arrays_of

NUMBERS = Path(__file__).resolve().parents[2] / "src" / "core" / "calibration_network.inc"
OWN = 12
"""Features of the cell itself; as many are of the sweep, and one more."""

SCENES = wild_scenes("development", "road")[:8]


@lru_cache(maxsize=len(SCENES))
def observed(at: int) -> tuple[WildObservation, LeveledSweep]:
    seen = SCENES[at].observe(0)
    return seen, level(seen.given("rings"), seen.truth.grid)


def expected_error(prob: NDArray[np.float32], visible: NDArray[np.bool_]) -> float:
    """Return the expected calibration error of probabilities (K,) in fifteen bins."""
    at = np.minimum((prob * 15).astype(int), 14)
    return float(np.abs(np.bincount(at, prob) - np.bincount(at, visible)).sum() / len(prob))


def said_by_numpy(features: F32) -> F64:
    """Return the network's probability (cells, cells) for features (F, cells, cells)."""
    of = arrays_of(NUMBERS.read_text(encoding="ascii"))
    # Features of the sweep, the last ones, are cut off sooner.
    most = np.where(np.arange(len(features)) < OWN, 6, 2)
    inputs = ((features.reshape(len(features), -1).T - of["mean"]) * of["scale"]).clip(-most, most)
    hidden = np.maximum(inputs @ of["first"] + of["first_bias"], 0)
    prob: F64 = 1 / (1 + np.exp(-(hidden @ of["second"] + of["second_bias"])[:, 0].reshape(features.shape[1:])))
    return prob


def test_cells_without_beams_are_silent_and_none_is_visible_without_support() -> None:
    _, leveled = observed(0)
    evidence = beam_evidence(leveled, GRIDS["road"], CAR)
    prob = evidence.visible_prob
    silent = (evidence.counted_prob == 0) & (evidence.aimed <= 0)
    assert silent.any()
    assert not prob[silent].any()
    # Support: enough beams reach a target on the estimated ground, within reach.
    supported = evidence.within_reach & (probability_of_visible(evidence.reaching, CAR.min_returns) >= THRESHOLD)
    assert (prob[~supported] < THRESHOLD).all()
    assert 0 < (prob[supported] < THRESHOLD).mean() < 0.3
    assert prob.min() >= 0
    assert prob.max() <= 1
    assert np.abs(prob - evidence.counted_prob)[~silent].mean() > 0.01


def test_the_core_runs_the_network_whose_numbers_it_holds() -> None:
    _, leveled = observed(1)
    evidence = beam_evidence(leveled, GRIDS["road"], CAR)
    said, prob = said_by_numpy(cell_features(leveled, evidence)), evidence.visible_prob
    inside = (prob > 0) & (np.abs(prob - THRESHOLD) > 1e-3)
    assert inside.mean() > 0.2
    assert np.abs(prob - said)[inside].max() < 1e-4


def test_features_of_cells_are_those_of_numpy() -> None:
    _, leveled = observed(3)
    evidence = beam_evidence(leveled, GRIDS["road"], CAR)

    def logit(prob: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.log2((prob + 0.01) / (1.01 - prob))

    def mean_around(values: NDArray[np.float64], width: int) -> NDArray[np.float64]:
        filtered: NDArray[np.float64] = uniform_filter(values, width, mode="nearest")
        return np.asarray(uniform_filter(filtered, width, mode="nearest"))

    counted = evidence.counted_prob.astype(np.float64)
    near = mean_around(counted, 5)
    returns = [evidence.aimed, evidence.measured, evidence.reaching, evidence.measured + evidence.late]
    own = probability_of_visible(evidence.reaching, CAR.min_returns).astype(np.float64)
    wanted = [logit(counted), logit(near), logit(mean_around(near, 13)), logit(own)]
    features = cell_features(leveled, evidence)
    np.testing.assert_allclose(features[:4], wanted, atol=2e-3)
    np.testing.assert_allclose(features[7:11], np.log2(1 + np.maximum(returns, 0)), atol=1e-3)
    np.testing.assert_allclose(features[11], np.log2(1 + polar_of_cells(evidence.grid)[0]), atol=1e-3)


def test_features_of_the_sweep_are_means_over_cells_at_which_beams_aim() -> None:
    _, leveled = observed(3)
    evidence = beam_evidence(leveled, GRIDS["road"], CAR)
    features = cell_features(leveled, evidence)
    own, sweep = features[:OWN], features[OWN:]
    assert len(sweep) == OWN + 1
    assert (sweep == sweep[:, :1, :1]).all()
    np.testing.assert_allclose(sweep[:-1, 0, 0], own[:, evidence.aimed > 0].mean(1), atol=1e-3)
    np.testing.assert_allclose(sweep[-1, 0, 0], np.log2(0.1 + leveled.ground.heights_m.std()), atol=1e-3)


def test_a_sweep_that_aims_nowhere_is_described() -> None:
    leveled = level(Sweep(np.zeros((0, 3), np.float32)), GRIDS["road"])
    evidence = beam_evidence(leveled, GRIDS["road"], CAR)
    assert not evidence.aimed.any()
    assert not cell_features(leveled, evidence)[OWN:-1].any()
    assert not evidence.visible_prob.any()


def test_the_same_cells_are_doubted_more_where_the_ground_is_uneven() -> None:
    _, leveled = observed(3)
    evidence = beam_evidence(leveled, GRIDS["road"], CAR)
    hilly = replace(leveled.ground, heights_m=(leveled.ground.heights_m * 20).astype(np.float32))
    claimed = evidence.supports_claim()
    sweeps = leveled, replace(leveled, ground=hilly)
    even, uneven = (said_by_numpy(cell_features(sweep, evidence))[claimed].mean() for sweep in sweeps)
    assert uneven < even


def test_features_of_a_wall_in_the_dark() -> None:
    # Rings on flat ground, and a wall 10 m ahead, one row of points: what lies behind it has a nearer blocker.
    azimuth, range_m = np.meshgrid(np.linspace(-np.pi, np.pi, 1080, endpoint=False), [4.0, 6.0, 8.0, 12.0, 16.0])
    ground = np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), np.full_like(range_m, -1.8)], -1)
    wall_y = np.linspace(-3, 3, 121)
    wall = np.stack([np.full_like(wall_y, 10.0), wall_y, np.full_like(wall_y, -0.8)], -1)
    points = np.concatenate([ground.reshape(-1, 3), wall]).astype(np.float32)
    leveled = level(Sweep(points, sensor_height_m=1.8, attitude=np.array([1.0, 0, 0, 0])), GRIDS["road"])
    features = cell_features(leveled, beam_evidence(leveled, GRIDS["road"], CAR))
    names = "prob", "near", "wide", "own", "blocker", "away", "farthest"
    row = dict(zip(names, features, strict=False))
    ahead, behind, aside = (128 + 16, 128), (128 + 30, 128), (128, 128 + 30)
    assert np.isclose(row["blocker"][ahead], np.log2(10.0 / 8.25), atol=0.03)
    assert np.isclose(row["blocker"][behind], np.log2(10.0 / 15.25), atol=0.03)
    assert row["away"][behind] < 0 < row["away"][ahead]
    assert np.isclose(row["blocker"][aside], np.log2(200.0 / 15.25), atol=0.03)
    assert np.isclose(row["farthest"][aside], np.log2(16.0 / 15.25), atol=0.03)
    # A mean over the whole of one value is that value; it lies between the extremes elsewhere.
    assert (row["near"] <= row["prob"].max() + 1e-3).all()
    assert (row["wide"] >= row["prob"].min() - 1e-3).all()


def test_it_is_better_calibrated_than_the_count_in_places_it_was_not_fitted_to() -> None:
    counted, calibrated, visible = [], [], []
    for at in range(len(SCENES)):
        seen, leveled = observed(at)
        evidence = beam_evidence(leveled, seen.truth.grid, CAR)
        counted.append(evidence.counted_prob[seen.known])
        calibrated.append(evidence.visible_prob[seen.known])
        visible.append(seen.truth.visible(CAR)[seen.known])
    truth = np.concatenate(visible)
    errors = [expected_error(np.concatenate(prob), truth) for prob in (calibrated, counted)]
    assert errors[0] < 0.7 * errors[1]
    assert errors[0] < 0.05


def test_the_estimator_says_it() -> None:
    seen, leveled = observed(2)
    estimate = load_estimator("shadow_map", grid=seen.truth.grid, target="car").estimate(leveled)
    assert np.array_equal(estimate.visible_prob, beam_evidence(leveled, seen.truth.grid, CAR).visible_prob)
