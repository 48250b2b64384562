"""Measured performance of the detector: detection probability and false detections.

Counted in simulated worlds with exact truth by ``tools/fit_detector.py``; the counts ship with the package.
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
"""Shipped table, of the shipped detector."""

RETURNS = (0, 1, 2, 3, 5, 8, 12, 20, 35, 60, 120, 250)
"""Lower bounds of the classes of expected returns; the last class is open."""

RANGE_M = (0.0, 10.0, 20.0, 30.0, 40.0, 55.0, 80.0)
"""Edges of the range classes in meters."""

_RETURNS_AT = np.array([0, 1, 2, 3.5, 6, 9.5, 15.5, 27, 47, 88, 180, 350])

_RANGE_AT_M = (np.array(RANGE_M[:-1]) + np.array(RANGE_M[1:])) / 2

_PRIOR = 8.0
"""Prior count of a class, at the probability of its parent class."""


@dataclass(frozen=True, eq=False)
class DetectionTable:
    """Counts of a detector in worlds with exact truth: K = 5 kinds, R classes of returns, D of range.

    Raises:
        ValueError: the shapes differ, or counts are inconsistent.
    """

    found: Counts  # (K, R, D) detected objects: centers within 2 m (or a quarter of their length)
    total: Counts  # (K, R, D) all objects
    matched: Counts  # (K, D) detections of objects
    false: Counts  # (K, D) false detections, by the kind that they were given
    sweeps: int  # number of sweeps evaluated
    about: Mapping[str, Any]  # provenance, for people

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

        Rare classes are shrunk toward their parent classes; between classes it is interpolated. It never falls with the
        expected returns.

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
        """Return the number (K,) of false detections per true one, by range and kind."""
        d, share = _between(np.asarray(range_m, np.float64), _RANGE_AT_M)
        kind = np.asarray(kinds, np.intp)
        result: F64 = (1 - share) * self._false_odds[kind, d] + share * self._false_odds[kind, d + 1]
        return result

    @cached_property
    def _prob(self) -> F64:
        """(K, R, D) detection probabilities."""
        # Shrink: each range toward its kind, each kind toward all kinds, by returns.
        found, total = (counts.astype(np.float64) for counts in (self.found, self.total))
        of_all = found.sum(axis=(0, 2))[None], total.sum(axis=(0, 2))[None]
        by_returns = _isotonic(_shrunk(*of_all, np.full(len(RETURNS), 0.5), 1.0), of_all[1] + 1.0)
        by_kind = _shrunk(found.sum(axis=2), total.sum(axis=2), by_returns)
        return _isotonic(_shrunk(found, total, by_kind[:, :, None]), total + _PRIOR)

    @cached_property
    def _false_odds(self) -> F64:
        """(K, D) false detections per true one; a range is shrunk toward its kind, a kind toward all."""
        false, matched = self.false.astype(np.float64), self.matched.astype(np.float64)
        of_all = np.array([false.sum() / max(false.sum() + matched.sum(), 1.0)])
        of_kind = _shrunk(false.sum(axis=1), (false + matched).sum(axis=1), of_all)
        share = np.clip(_shrunk(false, false + matched, of_kind[:, None]), 0.001, 0.999)
        result: F64 = share / (1.0 - share)
        return result

    def save(self, path: Path) -> None:
        """Write the table as JSON."""
        arrays = {name: getattr(self, name).tolist() for name in ("found", "total", "matched", "false")}
        classes = {"returns": RETURNS, "range_m": RANGE_M}
        content = {"about": dict(self.about), "classes": classes, "sweeps": self.sweeps, **arrays}
        write_atomic(path, (json.dumps(content) + "\n").encode())

    @classmethod
    def load(cls, path: Path) -> DetectionTable:
        """Return the table in a file that :meth:`save` wrote."""
        content = json.loads(path.read_text(encoding="utf-8"))
        found, total, matched, false = (
            np.array(content[name], np.int64) for name in ("found", "total", "matched", "false")
        )
        return cls(found, total, matched, false, int(content["sweeps"]), content["about"])


@lru_cache(maxsize=1)
def detection_table() -> DetectionTable:
    """Return the shipped table; it is read once."""
    return DetectionTable.load(SHIPPED)


def _between(values: F64, at: F64) -> tuple[NDArray[np.intp], F64]:
    """Return the class (K,) at or below each value, never the last, and the fraction (K,) toward the next one."""
    lower = np.clip(np.searchsorted(at, values, "right") - 1, 0, len(at) - 2)
    share: F64 = np.clip((values - at[lower]) / (at[lower + 1] - at[lower]), 0.0, 1.0)
    return lower, share


def _shrunk(sums: F64, counts: F64, prior: F64, weight: float = _PRIOR) -> F64:
    """Return means shrunk toward a prior of ``weight`` counts."""
    result: F64 = (sums + weight * prior) / (counts + weight)
    return result


def _isotonic(values: F64, weights: F64) -> F64:
    """Return the nearest values that do not fall along axis 1 (isotonic regression)."""
    with needed_for("tracking"):
        from scipy.optimize import isotonic_regression
    rows, row_weights = (np.moveaxis(array, 1, -1) for array in (values, weights))
    fitted = np.empty_like(rows)
    for index in np.ndindex(rows.shape[:-1]):
        fitted[index] = isotonic_regression(rows[index], weights=row_weights[index]).x
    return np.moveaxis(fitted, -1, 1)
