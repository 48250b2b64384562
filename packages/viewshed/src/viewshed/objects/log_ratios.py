"""Log-odds that add up over bins of what was measured: weights of evidence (Good, 1985) by logistic regression."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64

Columns = NDArray[np.int32]

CELL_BOUNDS: dict[str, tuple[float, ...]] = {
    "surface": (0.001, 0.03, 0.08, 0.15, 0.25, 0.4),
    "free": (0.05, 0.15, 0.3, 0.5, 0.7, 0.9),
    "hidden": (0.05, 0.2, 0.5, 0.8, 0.95),
    "ring": (0.001, 0.03, 0.08, 0.15, 0.3),
    "ring_free": (0.2, 0.4, 0.6, 0.8, 0.95),
    "near_free": (0.05, 0.2, 0.4, 0.7, 0.95),
    "first_m": (0.3, 0.8, 1.5, 3.0, 9.0),
}
"""Bounds of the bins of what ``BoxCells`` measures."""

_RIDGE = 3.0
"""Prior of the weights: bins that are rarely seen stay near 0."""

_NEWTON_STEPS, _SETTLED = 15, 1e-3
"""Most steps of a fit, which ends earlier where no weight changes by more."""


class Bins:
    """Columns of features: each is a bin of one measure or of several together.

    Args:
        shape: of the cases.
        bounds: of the bins of each measure.
    """

    def __init__(self, shape: tuple[int, ...], bounds: Mapping[str, tuple[float, ...]]) -> None:
        self.shape, self.bounds, self.size = shape, bounds, 0
        self._columns: list[NDArray[Any]] = []

    def of(self, name: str, values: NDArray[Any]) -> tuple[NDArray[np.intp], int]:
        """Return the bins of values of a measure, and how many there are."""
        bounds = self.bounds[name]
        return np.searchsorted(np.array(bounds), values, side="right"), len(bounds) + 1

    def add(self, *codes: tuple[NDArray[Any], int]) -> None:
        """Add a feature: the bins of measures together, each with their number."""
        code: NDArray[Any] = np.zeros(self.shape, np.int32)
        count = 1
        for bins, of in codes:
            code, count = code * of + bins, count * of
        self._columns.append(code + self.size)
        self.size += count

    def columns(self) -> Columns:
        """Return the columns (…, F) of all features."""
        return np.stack(self._columns, axis=-1).astype(np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Log-odds that add up."""

    of_bins: F64  # (W,) weights
    bias: float  # that is always added

    def __call__(self, columns: Columns) -> F64:
        """Return the log-odds (…,) of features with columns (…, F)."""
        total: F64 = self.of_bins[columns].sum(axis=-1) + self.bias
        return total

    @classmethod
    def fit(cls, counts: NDArray[Any], label: NDArray[Any], share: F64 | None = None) -> Self:
        """Return the weights of N rows, by logistic regression with a ridge (Newton's method).

        Args:
            counts: (N, W) how often each column occurs in each row; see :func:`counted`.
            label: (N,) bool.
            share: (N,) weights of the rows; None is 1 each. :func:`evenly` lets both classes weigh the same.

        Raises:
            ValueError: there is no row of one of the classes.
        """
        label = np.asarray(label, np.float64)
        if not 0 < label.sum() < len(label):
            raise ValueError(f"rows must be of both classes, got {int(label.sum())} of {len(label)} of one")
        share = np.ones(len(label)) if share is None else share
        # A further column is that of the bias, which has no prior.
        rows = np.column_stack([counts, np.ones(len(label))]).astype(np.float32)
        ridge, weights = np.append(np.full(rows.shape[1] - 1, _RIDGE), 1e-6), np.zeros(rows.shape[1])
        for _ in range(_NEWTON_STEPS):
            prob = 1.0 / (1.0 + np.exp(-rows @ weights))
            slope = (share * (label - prob)) @ rows - ridge * weights
            curve = (rows * (share * prob * (1.0 - prob))[:, None].astype(np.float32)).T @ rows + np.diag(ridge)
            step = np.linalg.solve(curve, slope)
            weights += step
            if np.abs(step).max() < _SETTLED:
                break
        return cls(weights[:-1], float(weights[-1]))


def counted(columns: NDArray[Any], size: int) -> NDArray[np.uint8]:
    """Return how often each of ``size`` columns occurs (N, size) in rows of columns (N, F); others are left out.

    >>> counted(np.array([[0, 2, 2], [1, 0, 3]]), 3).tolist()
    [[1, 0, 2], [1, 1, 0]]
    """
    cells = np.arange(len(columns))[:, None] * (size + 1) + np.minimum(columns, size)
    counts = np.bincount(cells.ravel(), minlength=len(columns) * (size + 1)).reshape(-1, size + 1)
    return counts[:, :size].astype(np.uint8)


def evenly(label: NDArray[Any]) -> F64:
    """Return weights (N,) with which both classes weigh the same, so that log-odds are log-likelihood ratios."""
    label = np.asarray(label, np.float64)
    each = np.where(label == 1, 0.5 / max(float(label.sum()), 1.0), 0.5 / max(float((1 - label).sum()), 1.0))
    return np.asarray(each * len(label), np.float64)
