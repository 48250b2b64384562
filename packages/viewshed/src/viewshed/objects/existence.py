"""Probability that a track is an object (Musicki, Evans and Stankovic, 1994), with doubt that is correlated over time.

The textbook treats each sweep as independent evidence. But whether a half visible object is seen is not drawn anew ten
times a second: if a pole's shadow hid it in the last sweep, it still does. So each track has a hidden number u, uniform
in [0, 1]: it can be detected in a sweep if u is less than P_D of that sweep. The distribution of u is updated by hits
and misses, and forgotten with a time constant. A false detection may have a persistent source (a bush) and recur at the
same place: a track is an object, or such a false source, or nothing any more.
"""

from __future__ import annotations

import numpy as np

from viewshed.arrays import F64

LEVELS = 8
"""Number of bins of the distribution of u."""


def forget(levels: F64, kept: float) -> F64:
    """Return the distributions of u (N, LEVELS) mixed with a uniform one; ``kept`` in [0, 1] is the part that stays."""
    return np.asarray(kept * levels + (1.0 - kept) / LEVELS)


def shares_found(detection_prob: F64, most_found: float) -> F64:
    """Return the detection probability (N, LEVELS) in each bin of u, given P_D (N,)."""
    steps = np.arange(LEVELS)
    return most_found * np.clip(detection_prob[:, None] * LEVELS - steps, 0.0, 1.0)


def found_probability(levels: F64, shares: F64) -> F64:
    """Return the detection probability (N,) of each track: ``most_found`` · P_D where nothing is known of u."""
    return np.asarray((levels * shares).sum(axis=1))


def after_detection(
    existence: F64, persistent: F64, found: F64, density: F64, clutter_per_m2: float | F64, recurrence: float
) -> tuple[F64, F64]:
    """Return existence and probability of a persistent false source, (M,) each, of matched tracks.

    Args:
        existence: predicted, (M,).
        persistent: predicted probability of a persistent false source, (M,); 0 is the textbook.
        found: detection probability of each object, (M,).
        density: of the detection's center given the track, per square meter, (M,).
        clutter_per_m2: density of other false detections per square meter and sweep.
        recurrence: detection rate of a persistent false source relative to that of an object.
    """
    real = existence * ((1.0 - found) * clutter_per_m2 + found * density)
    false = persistent * ((1.0 - recurrence * found) * clutter_per_m2 + recurrence * found * density)
    total = real + false + (1.0 - existence - persistent) * clutter_per_m2
    return real / total, false / total


def after_miss(existence: F64, persistent: F64, found: F64, recurrence: float) -> tuple[F64, F64]:
    """Return the same (M,) for unmatched tracks; unchanged where nothing can be detected."""
    real, false = existence * (1.0 - found), persistent * (1.0 - recurrence * found)
    total = real + false + (1.0 - existence - persistent)
    return real / total, false / total


def levels_after(levels: F64, likelihoods: F64) -> F64:
    """Return the distributions of u (M, LEVELS) after a hit or a miss with likelihoods (M, LEVELS)."""
    weighed = levels * likelihoods
    total = weighed.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, weighed / np.where(total > 0.0, total, 1.0), levels)
