"""ROC curve of a score that separates attacked from benign sweeps, its area (AUROC) and the interval of that."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from viewshed.arrays import F64
from viewshed.monitor.calibration import checked_scores


def roc_curve(benign: ArrayLike, attacked: ArrayLike) -> tuple[F64, F64, F64]:
    """Return false-positive rates (K,), true-positive rates (K,) and limits (K,), from the highest limit down.

    The limits are all scores that occur, then -∞.

    >>> roc_curve([1, 2], [2, 3])
    (array([0. , 0. , 0.5, 1. ]), array([0. , 0.5, 1. , 1. ]), array([  3.,   2.,   1., -inf]))
    """
    false, true = checked_scores("benign", benign), checked_scores("attacked", attacked)
    limits = np.append(np.unique(np.concatenate([false, true]))[::-1], -np.inf)
    return _share_above(false, limits), _share_above(true, limits), limits


def auroc(benign: ArrayLike, attacked: ArrayLike) -> float:
    """Return P(attacked > benign) + P(attacked = benign) / 2, the area under the ROC curve (Hanley and McNeil, 1982).

    >>> auroc([1, 2], [2, 3])
    0.875
    """
    false, true = np.sort(checked_scores("benign", benign)), checked_scores("attacked", attacked)
    below, not_above = np.searchsorted(false, true, "left"), np.searchsorted(false, true, "right")
    return int(below.sum() + not_above.sum()) / (2 * len(false) * len(true))


def auroc_interval(
    benign: ArrayLike, attacked: ArrayLike, rng: np.random.Generator, *, paired: bool = False, draws: int = 2000
) -> tuple[float, float]:
    """Return the 95 % interval of the AUROC by the percentile bootstrap (Efron, 1979).

    Args:
        benign: (N,) scores.
        attacked: (M,) scores.
        rng: generator of the bootstrap samples.
        paired: benign[k] and attacked[k] belong together: resample pairs, not scores.
        draws: number of bootstrap samples.

    Raises:
        ValueError: there are no scores, one is not a number, or pairs are not complete.
    """
    false, true = checked_scores("benign", benign), checked_scores("attacked", attacked)
    if paired and len(false) != len(true):
        raise ValueError(f"pairs must be complete, got {len(false)} benign and {len(true)} attacked scores")
    wins = (true > false[:, None]) + 0.5 * (true == false[:, None])
    weights = _weights(len(false), draws, rng)
    if paired and len(false) > 1:
        areas = _paired_areas(wins, weights)
    else:
        areas = ((weights @ wins) * (weights if paired else _weights(len(true), draws, rng))).sum(axis=1)
    low, high = np.quantile(areas, (0.025, 0.975))
    return float(low), float(high)


def _paired_areas(wins: F64, weights: F64) -> F64:
    """Return areas (draws,) of resampled pairs; a pair drawn twice meets itself no more often than in the data."""
    own, count = np.diag(wins), len(wins)
    others = ((weights @ (wins - np.diag(own))) * weights).sum(axis=1)
    others_weight = 1.0 - (weights**2).sum(axis=1)
    mean = others / np.maximum(others_weight, 1e-300)
    return np.where(others_weight > 1e-12, ((count - 1) * mean + weights @ own) / count, weights @ own)


def tpr_at_fpr(benign: ArrayLike, attacked: ArrayLike, rate: float) -> float:
    """Return the largest share of attacked scores above a limit with at most ``rate`` of the benign ones above it.

    >>> tpr_at_fpr([1, 2, 3, 4], [2, 3.5, 5, 6], 0.25)
    0.75
    """
    if not 0 <= rate <= 1:
        raise ValueError(f"rate must lie in [0, 1], got {rate}")
    false, true, _ = roc_curve(benign, attacked)
    return float(true[false <= rate + 1e-12].max())


def _share_above(scores: F64, limits: F64) -> F64:
    return 1.0 - np.searchsorted(np.sort(scores), limits, "right") / len(scores)


def _weights(count: int, draws: int, rng: np.random.Generator) -> F64:
    return rng.multinomial(count, np.full(count, 1.0 / count), draws) / count
