"""What is counted of one estimate: agreement with the truth, in the view and in the wedge, and average precision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

COUNTS = 4
"""Counted, in this order: cells that both call visible, only the estimate, only the truth, and none."""

_STEPS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What estimates are held against, on the K cells that count.

    Attributes:
        among: (cells, cells) bool, the cells that count.
        visible: (K,) bool, truth.
        azimuth: (K,) float32 of the cells, in the sensor's heading.
    """

    among: Mask
    visible: Mask
    azimuth: NDArray[np.float32]

    @classmethod
    def of(cls, visible: Mask, among: Mask, azimuth: NDArray[np.float32]) -> Reference:
        """Return the reference of a mask of the grid over the cells ``among``."""
        return cls(among, visible[among], azimuth[among])


def counts(claimed: Mask, visible: Mask) -> tuple[int, int, int, int]:
    """Return how many of K cells both call visible, only the claim, only the truth, and none.

    >>> counts(np.array([True, True, False]), np.array([True, False, False]))
    (1, 1, 0, 1)
    """
    both, claims, truths = int((claimed & visible).sum()), int(claimed.sum()), int(visible.sum())
    return both, claims - both, truths - both, len(visible) - claims - truths + both


def average_precision(prob: NDArray[np.float32], visible: Mask) -> float:
    """Return the area under the precision-recall curve, Σ (Rₙ - Rₙ₋₁) Pₙ over thresholds in steps of 0.001.

    The sum is the one of scikit-learn's ``average_precision_score``. A mask has one threshold below 1: what it leaves
    unclaimed comes at the share of visible cells. NaN where no cell is visible.

    >>> average_precision(np.array([1, 1, 0, 0], np.float32), np.array([True, False, True, False]))
    0.5
    """
    level = np.rint(prob * np.float32(_STEPS)).astype(np.intp)
    every = np.bincount(level, minlength=_STEPS + 1)[::-1].cumsum()
    true = np.bincount(level[visible], minlength=_STEPS + 1)[::-1].cumsum()
    if not true[-1]:
        return float("nan")
    precision = true / np.maximum(every, 1)
    return float((np.diff(true, prepend=0) * precision).sum() / true[-1])


def score(
    prob: NDArray[np.float32], threshold: float, reference: Reference, wedge: Mask | None
) -> list[float | int | None]:
    """Return nine numbers: counts in the whole view, counts in the wedge, average precision.

    Args:
        prob: (cells, cells) probability of visible.
        threshold: probability from which a cell is claimed.
        reference: the truth.
        wedge: (K,) bool, cells of the wedge; None for no wedge, whose counts are 0.
    """
    of_cells = prob[reference.among]
    claimed = of_cells >= np.float32(threshold)
    inside = (0, 0, 0, 0) if wedge is None else counts(claimed[wedge], reference.visible[wedge])
    area = average_precision(of_cells, reference.visible)
    return [*counts(claimed, reference.visible), *inside, None if np.isnan(area) else round(area, 6)]
