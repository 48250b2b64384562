"""One estimate against the truth, by cases computed by hand."""

import numpy as np
import pytest

from viewshed import PEDESTRIAN, BevGrid, FovEstimate, Truth, score

GRID = BevGrid(4, 8.0)


def _estimate(prob: list[float], std: float | None = None) -> FovEstimate:
    values = np.array(prob, np.float32).reshape(4, 4)
    deviation = None if std is None else np.full((4, 4), std, np.float32)
    return FovEstimate(GRID, values, np.zeros((4, 4), np.uint8), deviation)


def test_precision_and_recall_count_known_cells() -> None:
    estimate = _estimate([0.9] * 4 + [0.8] * 2 + [0.1] * 10)
    visible = np.zeros((4, 4), np.bool_)
    visible[0, :3] = visible[1, 0] = visible[2, 0] = True  # 4 of the 6 claimed, and one more
    scores = score(estimate, visible)
    assert scores.precision() == pytest.approx(4 / 6)
    assert scores.recall() == pytest.approx(4 / 5)
    known = np.ones((4, 4), np.bool_)
    known[2, 0] = False
    assert score(estimate, visible, known).recall() == 1.0
    assert (scores + score(estimate, visible)).f1() == scores.f1()


def test_a_truth_is_asked_for_the_estimates_target() -> None:
    counts = {"car": np.full((4, 4), 9, np.uint8), "pedestrian": np.zeros((4, 4), np.uint8)}
    truth = Truth(GRID, counts, {name: np.zeros((4, 4), np.uint8) for name in counts})
    claim = _estimate([0.9] * 16, std=0.1)
    assert score(claim, truth).precision() == 1.0
    walker = FovEstimate(GRID, claim.visible_prob, claim.state, target=PEDESTRIAN)
    assert score(walker, truth).precision() == 0.0
    with pytest.raises(ValueError, match="target must be a Target named car or pedestrian, got 'cone'"):
        truth.visible("cone")


def test_what_does_not_fit_is_refused() -> None:
    estimate = _estimate([0.5] * 16)
    with pytest.raises(ValueError, match=r"truth must be bool \(4, 4\), got bool \(3, 4\)"):
        score(estimate, np.ones((3, 4), np.bool_))
    with pytest.raises(ValueError, match=r"known must be bool \(4, 4\), got uint8"):
        score(estimate, np.ones((4, 4), np.bool_), np.ones((4, 4), np.uint8))
    other = Truth(BevGrid(4, 4.0), {"car": np.zeros((4, 4), np.uint8)}, {"car": np.zeros((4, 4), np.uint8)})
    with pytest.raises(ValueError, match="truth must lie on the estimate's grid"):
        score(estimate, other)
