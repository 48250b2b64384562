"""The contract of every estimator over the learned ones, on the grid of a network made by hand; then what is theirs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.estimators.test_contracts import (  # noqa: F401 - they run here with the fixtures of this file
    test_an_empty_sweep_sees_nothing_and_says_so,
    test_degenerate_points_claim_little,
    test_free_or_surface_is_what_is_visible_and_what_the_beams_support,
    test_order_of_points_is_irrelevant,
    test_order_of_points_without_rings_leaves_the_mask,
    test_the_side_without_returns_is_not_claimed,
    test_the_sweep_is_left_as_it_was_and_gives_the_same_estimate,
    test_time_agent_and_pose_are_passed_on,
    test_what_is_no_return_shows_nothing,
)
from tests.networks.made import card, drawn, nearby

from viewshed.estimators import EstimatorFactory
from viewshed.estimators.base import Estimator
from viewshed.estimators.unet import LEARNED, PASSES, UnetEstimator, load_network
from viewshed.fov.estimate import CellState
from viewshed.fov.visibility import CAR, PEDESTRIAN, Target
from viewshed.grid import BevGrid
from viewshed.networks.architecture import UNetShape
from viewshed.preprocess.evidence import BeamEvidence, beam_evidence
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep
from viewshed_lab.training.onnx_export import export_onnx
from viewshed_lab.training.unet_torch import TorchRunner

GRID = BevGrid(64, 16.0)
SHAPE = UNetShape(4, 2, 0.3)
Floats = NDArray[np.floating[Any]]


@pytest.fixture(params=list(LEARNED))
def named(request: pytest.FixtureRequest) -> tuple[str, EstimatorFactory]:
    name: str = request.param

    def make(grid: BevGrid, target: Target = CAR) -> Estimator:
        passes = PASSES if name == "mc_dropout" else 1
        return UnetEstimator(TorchRunner(card(SHAPE, grid), nearby(SHAPE)), passes, name=name)

    return name, make


@pytest.fixture
def make(named: tuple[str, EstimatorFactory]) -> EstimatorFactory:
    return named[1]


@pytest.mark.parametrize("grid", [GRID, BevGrid(36, 12.0, (5.0, -3.0)), BevGrid(4, 4.0, (6.0, 0.0))], ids=str)
def test_an_estimate_is_on_its_own_grid(make: EstimatorFactory, street: Sweep, grid: BevGrid) -> None:
    assert make(grid).grid == make(grid).estimate(street).grid == grid


def evidence_of(sweep: Sweep) -> BeamEvidence:
    return beam_evidence(level(sweep, GRID), GRID, CAR)


def is_bounded(found: Floats, said: Floats, evidence: BeamEvidence, threshold: float = 0.5, atol: float = 0.0) -> bool:
    """Whether probabilities are those that a network ``said``, cut to below its threshold where beams support none."""
    supported = evidence.supports_claim()
    kept, cut = supported | (said < threshold - 1e-6), ~supported & (said > threshold + 1e-6)
    assert kept.any()
    assert cut.any()
    return np.allclose(found[kept], said[kept], rtol=0.0, atol=atol) and bool(
        (found[cut] < threshold).all() and (found[cut] > threshold - 1e-6).all()
    )


def test_one_pass_is_the_network_without_dropout(street: Sweep) -> None:
    runner = TorchRunner(card(SHAPE, GRID), drawn(SHAPE))
    estimate = UnetEstimator(runner, seed=3).estimate(street)
    assert estimate.method == "unet"
    assert np.isnan(estimate.std).all()
    found = estimate.visible_prob
    inputs = runner.card.input_of(street)[None]
    assert is_bounded(found, runner.run(inputs, SHAPE.no_masks(1))[0], evidence_of(street))
    assert not is_bounded(found, runner.run(inputs, SHAPE.masks(1, np.random.default_rng(3)))[0], evidence_of(street))


def test_the_mean_and_deviation_are_those_of_the_seeds_masks(street: Sweep) -> None:
    made = card(SHAPE, GRID)
    runner = TorchRunner(made, drawn(SHAPE))
    masks = SHAPE.masks(6, np.random.Generator(np.random.PCG64(4)))
    passes = np.stack([runner.run(made.input_of(street)[None], mask[None])[0] for mask in masks]).astype(np.float64)
    found = UnetEstimator(runner, 6, seed=4).estimate(street)
    assert found.method == "mc_dropout"
    assert is_bounded(found.visible_prob, passes.mean(axis=0), evidence_of(street), atol=1e-5)
    np.testing.assert_allclose(found.std, passes.std(axis=0), atol=1e-5)
    other = UnetEstimator(runner, 6, seed=5).estimate(street)
    assert not np.array_equal(found.visible_prob, other.visible_prob)


@pytest.mark.parametrize(("threshold", "sure"), [(0.5, 0.7), (0.2, 0.7), (0.9, 0.7), (0.5, 0.6)])
def test_states_are_told_where_the_network_is_sure(street: Sweep, threshold: float, sure: float) -> None:
    plain = UnetEstimator(TorchRunner(card(SHAPE, GRID, threshold=threshold), drawn(SHAPE)))
    every, found = plain.estimate(street), plain.with_abstention(sure).estimate(street)
    said = plain.runner.run(plain.card.input_of(street)[None], SHAPE.no_masks(1))[0]
    evidence = evidence_of(street)
    claimed = evidence.supports_claim() & (said >= max(threshold, sure))
    denied = evidence.supports_denial() & (said <= np.float32(1 - sure))
    assert claimed.any() or threshold == 0.9
    assert denied.any()
    assert (~claimed & ~denied & (every.state != CellState.UNKNOWN)).any()
    assert np.array_equal(np.isin(found.state, [CellState.FREE, CellState.SURFACE]), claimed)
    assert np.array_equal(found.state == CellState.HIDDEN, denied)
    kept = claimed | (denied & (said < threshold))
    assert np.array_equal(found.state[kept], every.state[kept])
    assert np.array_equal(plain.with_abstention(0.5).estimate(street).state, every.state)


@pytest.mark.parametrize(
    ("passes", "dropout", "message"),
    [
        (0, 0.1, r"passes must lie in \[1, 1000\], got 0"),
        (1001, 0.1, r"passes must lie in \[1, 1000\], got 1001"),
        (5, 0.0, "passes must be 1 for made, which has no dropout, got 5; use unet"),
    ],
)
def test_passes_that_make_no_sense_are_refused(passes: int, dropout: float, message: str) -> None:
    shape = UNetShape(4, 2, dropout)
    with pytest.raises(ValueError, match=message):
        UnetEstimator(TorchRunner(card(shape), drawn(shape)), passes)


def test_a_file_makes_an_estimator_for_its_grid_and_target_only(tmp_path: Path, street: Sweep) -> None:
    path = tmp_path / "net.onnx"
    export_onnx(path, card(SHAPE, GRID), nearby(SHAPE))
    found = load_network("mc_dropout", GRID, weights=path, passes=3)
    assert (found.passes, found.grid, found.target.name) == (3, GRID, "car")
    assert found.estimate(street).visible().any()
    with pytest.raises(
        ValueError, match="grid must be 64x16 for the network made, got 64x8; ask for that grid, or train"
    ):
        load_network("unet", BevGrid(64, 8.0), weights=path)
    with pytest.raises(ValueError, match="target must be car for the network made, got pedestrian; train a network"):
        load_network("unet", GRID, PEDESTRIAN, weights=path)
    with pytest.raises(ValueError, match="method must be one of unet, mc_dropout, got 'majority_vote'"):
        load_network("majority_vote", GRID, weights=path)
    with pytest.raises(ValueError, match="passes must be 1 for unet; use mc_dropout, got 5"):
        load_network("unet", GRID, weights=path, passes=5)
    with pytest.raises(ValueError, match="passes must be at least 2 for mc_dropout; use unet for one pass, got 1"):
        load_network("mc_dropout", GRID, weights=path, passes=1)
    with pytest.raises(
        ValueError, match=r"method mc_dropout needs weights, .* on a grid of 64x16, only for: .*; give --weights"
    ):
        load_network("mc_dropout", GRID)
