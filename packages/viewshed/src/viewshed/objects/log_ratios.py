"""Additive log-odds over binned features: weights of evidence (Good, 1985) by logistic regression."""

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
"""Bin edges of the features of ``BoxCells``."""

_RIDGE = 3.0
"""Ridge penalty (prior precision) of the weights: rare bins stay near 0."""

_NEWTON_STEPS, _TOLERANCE = 15, 1e-3
"""Maximum number of Newton steps, and the largest change of a weight at which a fit has converged."""


class Bins:
    """Builds columns of features; each feature is a bin of one measure or of several jointly.

    Args:
        shape: of the cases.
        bounds: bin edges of each measure.
    """

    def __init__(self, shape: tuple[int, ...], bounds: Mapping[str, tuple[float, ...]]) -> None:
        self.shape, self.bounds, self.size = shape, bounds, 0
        self._columns: list[NDArray[Any]] = []

    def of(self, name: str, values: NDArray[Any]) -> tuple[NDArray[np.intp], int]:
        """Return the bins of values of a measure, and their number."""
        bounds = self.bounds[name]
        return np.searchsorted(np.array(bounds), values, side="right"), len(bounds) + 1

    def add(self, *codes: tuple[NDArray[Any], int]) -> None:
        """Add a feature: joint bins of measures, each given with its number of bins."""
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
    """Additive log-odds."""

    of_bins: F64  # (W,) weight of each bin
    bias: float  # constant term

    def __call__(self, columns: Columns) -> F64:
        """Return the log-odds (…,) of features with columns (…, F).

        >>> Weights(np.array([1.0, 2.0, 4.0]), 0.5)(np.array([[0, 2], [1, 2]])).tolist()
        [5.5, 6.5]
        """
        total: F64 = self.of_bins[columns].sum(axis=-1) + self.bias
        return total

    @classmethod
    def fit(cls, counts: NDArray[Any], label: NDArray[Any], share: F64 | None = None) -> Self:
        """Return the weights fitted to N rows, by ridge logistic regression (Newton's method).

        Args:
            counts: (N, W) how often each column occurs in each row; see :func:`counted`.
            label: (N,) bool.
            share: (N,) weights of the rows; None is 1 each. :func:`evenly` balances both classes.

        Raises:
            ValueError: one of the classes has no row.
        """
        label = np.asarray(label, np.float64)
        if not 0 < label.sum() < len(label):
            raise ValueError(f"rows must be of both classes, got {int(label.sum())} of {len(label)} of one")
        share = np.ones(len(label)) if share is None else share
        # The last column is the bias, with almost no penalty.
        rows = np.column_stack([counts, np.ones(len(label))]).astype(np.float32)
        ridge, weights = np.append(np.full(rows.shape[1] - 1, _RIDGE), 1e-6), np.zeros(rows.shape[1])
        for _ in range(_NEWTON_STEPS):
            prob = 1.0 / (1.0 + np.exp(-rows @ weights))
            gradient = (share * (label - prob)) @ rows - ridge * weights
            hessian = (rows * (share * prob * (1.0 - prob))[:, None].astype(np.float32)).T @ rows + np.diag(ridge)
            step = np.linalg.solve(hessian, gradient)
            weights += step
            if np.abs(step).max() < _TOLERANCE:
                break
        return cls(weights[:-1], float(weights[-1]))


def counted(columns: NDArray[Any], size: int) -> NDArray[np.uint8]:
    """Return how often each of ``size`` columns occurs (N, size) in rows (N, F) of columns; larger ones are ignored.

    >>> counted(np.array([[0, 2, 2], [1, 0, 3]]), 3).tolist()
    [[1, 0, 2], [1, 1, 0]]
    """
    cells = np.arange(len(columns))[:, None] * (size + 1) + np.minimum(columns, size)
    counts = np.bincount(cells.ravel(), minlength=len(columns) * (size + 1)).reshape(-1, size + 1)
    return counts[:, :size].astype(np.uint8)


def evenly(label: NDArray[Any]) -> F64:
    """Return weights (N,) that balance both classes, so that log-odds are log-likelihood ratios."""
    label = np.asarray(label, np.float64)
    weights = np.where(label == 1, 0.5 / max(float(label.sum()), 1.0), 0.5 / max(float((1 - label).sum()), 1.0))
    return np.asarray(weights * len(label), np.float64)
