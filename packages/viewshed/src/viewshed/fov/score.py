"""Scores of an estimate against truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import FovEstimate
from viewshed.fov.truth import Truth
from viewshed.metrics import Scores


def score(estimate: FovEstimate, truth: Truth | NDArray[np.bool_], known: NDArray[np.bool_] | None = None) -> Scores:
    """Return the scores of one estimate; add the scores of several estimates with ``+``.

    Args:
        estimate: the estimate.
        truth: the exact field of view or a label of it; or the mask (cells, cells) of visible cells.
        known: (cells, cells) bool mask of the cells whose truth is known; None is all cells.

    Raises:
        ValueError: the truth is on another grid, or lacks the estimate's target.
    """
    if isinstance(truth, Truth) and truth.grid != estimate.grid:
        raise ValueError(f"truth must lie on the estimate's grid {estimate.grid}, got {truth.grid}")
    visible = truth.visible(estimate.target) if isinstance(truth, Truth) else np.asarray(truth)
    mask = np.ones(estimate.grid.shape, np.bool_) if known is None else np.asarray(known)
    for name, array in (("truth", visible), ("known", mask)):
        if array.shape != estimate.grid.shape or array.dtype != np.bool_:
            raise ValueError(f"{name} must be bool {estimate.grid.shape}, got {array.dtype} {array.shape}")
    std = estimate.std
    has_std = std is not None and bool(np.isfinite(std[mask]).all())
    scores = Scores()
    scores.add(estimate.visible_prob[mask], visible[mask], std[mask] if std is not None and has_std else None)
    return scores
