"""What the detector does, measured: how surely it finds an object, and how often it errs.

Counted in simulated worlds with exact truth, by ``tools/fit_detector.py``; the counts travel with the package.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._extras import needed_for
from viewshed._files import write_atomic
from viewshed.arrays import F64
from viewshed.detections import ObjectKind

Counts = NDArray[np.int64]

SHIPPED = Path(__file__).with_name("detection_table.json")
"""The table that travels with the package, of the shipped detector."""

RETURNS = (0, 1, 2, 3, 5, 8, 12, 20, 35, 60, 120, 250)
"""Expected returns from which each class on begins; the last has no end."""

RANGE_M = (0.0, 10.0, 20.0, 30.0, 40.0, 55.0, 80.0)
"""Borders of the classes of range."""

_RETURNS_AT = np.array([0, 1, 2, 3.5, 6, 9.5, 15.5, 27, 47, 88, 180, 350])

_RANGE_AT_M = (np.array(RANGE_M[:-1]) + np.array(RANGE_M[1:])) / 2

_PRIOR = 8.0
"""A class counts as if this number of objects of the class that it is part of had been among its own."""


@dataclass(frozen=True, eq=False)
class DetectionTable:
    """Counts of a detector in worlds with exact truth; K = 5 kinds, R classes of returns, D of range.

    Raises:
        ValueError: the shapes are not these, or counts contradict each other.
    """

    found: Counts  # (K, R, D) objects that were detected: their center within 2 m (or a quarter of their length)
    total: Counts  # (K, R, D) all objects
    matched: Counts  # (K, D) detections of them
    false: Counts  # (K, D) detections that are no object, by the kind that they were called
    sweeps: int  # how many were looked at
    about: Mapping[str, Any]  # how it was made, for people

    def __post_init__(self) -> None:
        kinds, ranges = len(ObjectKind), len(RANGE_M) - 1
        shape = kinds, len(RETURNS), ranges
        shapes = [array.shape for array in (self.found, self.total, self.matched, self.false)]
        if shapes != [shape, shape, (kinds, ranges), (kinds, ranges)]:
            raise ValueError(f"the table must have classes of {shape}, got {shapes}; measure it again")
        if (self.found < 0).any() or (self.found > self.total).any() or self.sweeps < 1:
            raise ValueError("the table must count no more objects found than there are; measure it again")

    def prob(self, expected_returns: NDArray[Any], range_m: NDArray[Any], kinds: NDArray[np.uint8]) -> F64:
        """Return the probability (K,) that the detector finds each of K objects.

        Rarely seen classes lean on those that they are part of; between classes it is interpolated. It never falls
        with the expected returns.

        Args:
            expected_returns: (K,) of :func:`viewshed.preprocess.evidence.expected_returns`, without the objects' own.
            range_m: (K,) horizontal ranges of the centers.
            kinds: (K,) of :class:`viewshed.detections.ObjectKind`.
        """
        table = self._prob
        returns = np.log2(1.0 + np.maximum(np.asarray(expected_returns, np.float64), 0.0))
        r, r_share = _between(returns, np.log2(1.0 + _RETURNS_AT))
        d, d_share = _between(np.asarray(range_m, np.float64), _RANGE_AT_M)
        kind = np.asarray(kinds, np.intp)
        low = (1 - d_share) * table[kind, r, d] + d_share * table[kind, r, d + 1]
        high = (1 - d_share) * table[kind, r + 1, d] + d_share * table[kind, r + 1, d + 1]
        result: F64 = (1 - r_share) * low + r_share * high
        return result

    def false_odds(self, range_m: NDArray[Any], kinds: NDArray[np.uint8]) -> F64:
        """Return the number (K,) of false detections of a kind at a range for one of an object."""
        d, share = _between(np.asarray(range_m, np.float64), _RANGE_AT_M)
        kind = np.asarray(kinds, np.intp)
        result: F64 = (1 - share) * self._false_odds[kind, d] + share * self._false_odds[kind, d + 1]
        return result

    @cached_property
    def _prob(self) -> F64:
        """(K, R, D) probabilities that an object is found."""
        # 1. By returns alone, of all kinds; then of each kind, and of each range of it.
        found, total = (counts.astype(np.float64) for counts in (self.found, self.total))
        of_all = found.sum(axis=(0, 2))[None], total.sum(axis=(0, 2))[None]
        by_returns = _rising(_leaning(*of_all, np.full(len(RETURNS), 0.5), 1.0), of_all[1] + 1.0)
        by_kind = _leaning(found.sum(axis=2), total.sum(axis=2), by_returns)
        return _rising(_leaning(found, total, by_kind[:, :, None]), total + _PRIOR)

    @cached_property
    def _false_odds(self) -> F64:
        """(K, D) false detections for one of an object; a range leans on its kind, a kind on all."""
        false, right = self.false.astype(np.float64), self.matched.astype(np.float64)
        of_all = np.array([false.sum() / max(false.sum() + right.sum(), 1.0)])
        of_kind = _leaning(false.sum(axis=1), (false + right).sum(axis=1), of_all)
        share = np.clip(_leaning(false, false + right, of_kind[:, None]), 0.001, 0.999)
        result: F64 = share / (1.0 - share)
        return result

    def save(self, path: Path) -> None:
        """Write it as JSON."""
        arrays = {name: getattr(self, name).tolist() for name in ("found", "total", "matched", "false")}
        classes = {"returns": RETURNS, "range_m": RANGE_M}
        content = {"about": dict(self.about), "classes": classes, "sweeps": self.sweeps, **arrays}
        write_atomic(path, (json.dumps(content) + "\n").encode())

    @classmethod
    def load(cls, path: Path) -> DetectionTable:
        """Return the table of a file that :meth:`save` wrote."""
        content = json.loads(path.read_text(encoding="utf-8"))
        found, total, matched, false = (
            np.array(content[name], np.int64) for name in ("found", "total", "matched", "false")
        )
        return cls(found, total, matched, false, int(content["sweeps"]), content["about"])


@lru_cache(maxsize=1)
def detection_table() -> DetectionTable:
    """Return the table that travels with the package; it is read once."""
    return DetectionTable.load(SHIPPED)


def _between(values: F64, at: F64) -> tuple[NDArray[np.intp], F64]:
    """Return the class (K,) below each value, never the last, and how far in [0, 1] it is to the next one."""
    below = np.clip(np.searchsorted(at, values, "right") - 1, 0, len(at) - 2)
    share: F64 = np.clip((values - at[below]) / (at[below + 1] - at[below]), 0.0, 1.0)
    return below, share


def _leaning(sums: F64, counts: F64, prior: F64, weight: float = _PRIOR) -> F64:
    """Return means that lean on a prior, as if ``weight`` more had been counted with it."""
    result: F64 = (sums + weight * prior) / (counts + weight)
    return result


def _rising(values: F64, weights: F64) -> F64:
    """Return the nearest values that do not fall along axis 1."""
    with needed_for("tracking"):
        from scipy.optimize import isotonic_regression
    rows, row_weights = (np.moveaxis(array, 1, -1) for array in (values, weights))
    out = np.empty_like(rows)
    for place in np.ndindex(rows.shape[:-1]):
        out[place] = isotonic_regression(rows[place], weights=row_weights[place]).x
    return np.moveaxis(out, -1, 1)
