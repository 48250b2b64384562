"""Rates from confusion counts, and their bootstrap intervals over scenes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from viewshed.arrays import F64

Measure = Callable[[F64], F64]
"""Maps counts (…, 4) of cells (both, over, under, neither) to a figure (…)."""

DRAWS = 1000  # bootstrap samples

NO_INTERVAL = (float("nan"), float("nan"))
"""The interval of fewer than two scenes, which cannot be resampled."""


def precision(counts: F64) -> F64:
    """Return the share of claimed cells that are visible (…); NaN if none is claimed."""
    return _rate(counts[..., 0], counts[..., 0] + counts[..., 1])


def f1(counts: F64) -> F64:
    """Return the harmonic mean of precision and recall (…); NaN if no cell is claimed or visible.

    >>> f1(np.array([6.0, 2.0, 2.0, 10.0])).item()
    0.75
    """
    return _rate(2 * counts[..., 0], 2 * counts[..., 0] + counts[..., 1] + counts[..., 2])


def _rate(part: F64, whole: F64) -> F64:
    rate: F64 = np.divide(part, whole, out=np.full(np.shape(whole), np.nan), where=whole > 0)
    return rate


def bootstrap(cases: Iterable[tuple[F64, Sequence[str]]], measure: Measure) -> tuple[float, float]:
    """Return the 95 % interval of the mean over cases of a pooled measure, by a bootstrap over scenes.

    Scenes are resampled with all their sweeps; cases with equally many scenes share the same random samples. If a case
    has one scene, the result is ``NO_INTERVAL``.

    Args:
        cases: counts (S, 4) of the sweeps of each case, and their scenes (S,).
        measure: maps pooled counts to a figure.
    """
    cases = [(counts, scenes) for counts, scenes in cases if len(counts)]
    if any(len(set(scenes)) < 2 for _, scenes in cases):
        return NO_INTERVAL
    means = [measure(_resampled(counts, scenes)) for counts, scenes in cases]
    mean = np.mean(means, axis=0) if means else np.array(np.nan)
    if np.isnan(mean).all():
        return NO_INTERVAL
    low, high = np.nanquantile(mean, (0.025, 0.975))
    return float(low), float(high)


def _resampled(counts: F64, scenes: Sequence[str]) -> F64:
    """Return pooled counts (DRAWS, 4) of scenes sampled with replacement."""
    names, scene_of = np.unique(np.asarray(scenes, object).astype(str), return_inverse=True)
    pooled = np.zeros((len(names), counts.shape[1]))
    np.add.at(pooled, scene_of, counts)
    rng = np.random.Generator(np.random.PCG64(len(names)))
    weights = rng.multinomial(len(names), np.full(len(names), 1.0 / len(names)), DRAWS)
    return np.asarray(weights @ pooled, np.float64)
