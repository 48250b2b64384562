"""The probability that a track is an object (Musicki, Evans and Stankovic, 1994), where doubt lasts.

The textbook counts each sweep as new evidence. But an object that a view calls half visible is not drawn anew ten times
a second: if a pole's shadow hid it a moment ago, it does so still. So each track has a hidden number u, uniform in
[0, 1]: it can be found in a sweep if u is less than P_D of that sweep. What hits and misses say of u is kept, and
forgotten with a time constant. In the same way a false detection (a bush) comes back where it was.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LEVELS = 8
"""Steps in which u is kept."""


def forget(levels: Floats, kept: float) -> Floats:
    """Return the distributions of u (N, LEVELS) of which the part ``kept`` in [0, 1] is still known."""
    return np.asarray(kept * levels + (1.0 - kept) / LEVELS)


def shares_found(detection_prob: Floats, most_found: float) -> Floats:
    """Return the probability (N, LEVELS) that a track is found, for each step of u, with P_D (N,)."""
    steps = np.arange(LEVELS)
    return most_found * np.clip(detection_prob[:, None] * LEVELS - steps, 0.0, 1.0)


def found_probability(levels: Floats, shares: Floats) -> Floats:
    """Return the probability (N,) that each track is found: ``most_found`` · P_D where nothing is known of u."""
    return np.asarray((levels * shares).sum(axis=1))


def existence_after_detection(
    existence: Floats, found: Floats, density: Floats, clutter_per_m2: float, recurrence: float
) -> Floats:
    """Return the existence (M,) of tracks that were matched.

    Args:
        existence: predicted, (M,).
        found: probability that each is found, (M,).
        density: of the detection's center if it is the track's, per square meter, (M,).
        clutter_per_m2: false detections per square meter and sweep, anywhere.
        recurrence: how often a false detection comes back where it was, as a part of how often an object does; 0
            is the textbook.
    """
    real = (1.0 - found) * clutter_per_m2 + found * density
    false = clutter_per_m2 + recurrence * found * density
    return existence * real / (existence * real + (1.0 - existence) * false)


def existence_after_miss(existence: Floats, found: Floats, recurrence: float) -> Floats:
    """Return the existence (M,) of tracks that were not matched: unchanged where they cannot be found."""
    real, false = 1.0 - found, 1.0 - recurrence * found
    return existence * real / (existence * real + (1.0 - existence) * false)


def levels_after(levels: Floats, likelihoods: Floats) -> Floats:
    """Return the distributions of u (M, LEVELS) after a hit or a miss of these likelihoods (M, LEVELS)."""
    weighed = levels * likelihoods
    total = weighed.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, weighed / np.where(total > 0.0, total, 1.0), levels)
