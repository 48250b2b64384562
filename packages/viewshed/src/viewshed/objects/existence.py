"""The probability that a track is an object (Musicki, Evans and Stankovic, 1994), where doubt lasts.

The textbook counts each sweep as new evidence. But an object that a view calls half visible is not drawn anew ten times
a second: if a pole's shadow hid it in the last sweep, it does so still. So each track has a hidden number u, uniform in
[0, 1]: it can be found in a sweep if u is less than P_D of that sweep. What hits and misses say of u is kept, and
forgotten with a time constant. And a false detection may have a persistent source (a bush), and come back where it was:
a track is an object, or such a false source, or nothing any more.
"""

from __future__ import annotations

import numpy as np

from viewshed.arrays import F64

LEVELS = 8
"""Steps in which u is kept."""


def forget(levels: F64, kept: float) -> F64:
    """Return the distributions of u (N, LEVELS) of which the part ``kept`` in [0, 1] is still known."""
    return np.asarray(kept * levels + (1.0 - kept) / LEVELS)


def shares_found(detection_prob: F64, most_found: float) -> F64:
    """Return the probability (N, LEVELS) that a track is found, for each step of u, with P_D (N,)."""
    steps = np.arange(LEVELS)
    return most_found * np.clip(detection_prob[:, None] * LEVELS - steps, 0.0, 1.0)


def found_probability(levels: F64, shares: F64) -> F64:
    """Return the probability (N,) that each track is found: ``most_found`` · P_D where nothing is known of u."""
    return np.asarray((levels * shares).sum(axis=1))


def after_detection(
    existence: F64, persistent: F64, found: F64, density: F64, clutter_per_m2: float | F64, recurrence: float
) -> tuple[F64, F64]:
    """Return existence and the probability of a persistent false source, (M,) each, of tracks that were matched.

    A track is an object, or something persistent that looks like one (a bush), or nothing any more.

    Args:
        existence: predicted, (M,).
        persistent: predicted probability of a persistent false source, (M,); 0 is the textbook.
        found: probability that each object is found, (M,).
        density: of the detection's center if it is the track's, per square meter, (M,).
        clutter_per_m2: other false detections per square meter and sweep, there.
        recurrence: how often a persistent false source is detected, as a part of how often an object is.
    """
    real = existence * ((1.0 - found) * clutter_per_m2 + found * density)
    false = persistent * ((1.0 - recurrence * found) * clutter_per_m2 + recurrence * found * density)
    total = real + false + (1.0 - existence - persistent) * clutter_per_m2
    return real / total, false / total


def after_miss(existence: F64, persistent: F64, found: F64, recurrence: float) -> tuple[F64, F64]:
    """Return the same (M,) of tracks that were not matched: unchanged where nothing can be found."""
    real, false = existence * (1.0 - found), persistent * (1.0 - recurrence * found)
    total = real + false + (1.0 - existence - persistent)
    return real / total, false / total


def levels_after(levels: F64, likelihoods: F64) -> F64:
    """Return the distributions of u (M, LEVELS) after a hit or a miss of these likelihoods (M, LEVELS)."""
    weighed = levels * likelihoods
    total = weighed.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, weighed / np.where(total > 0.0, total, 1.0), levels)
