"""Sudden moves: where the latest detections of a track are, against where the earlier ones lead."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

LATEST, EARLIER, LEAST_EARLIER = 3, 12, 5
"""Detections whose mean is compared with where the earlier ones lead."""

_LONGEST_S = 1.0
"""Where the latest detections take longer, nothing is sudden."""

_LEAST_STD_M = 0.08
"""No detector places boxes better."""

_TURN_MPS2 = 2.0
"""Acceleration that moving objects have without being suspicious."""

PARKED_MPS = 0.5
"""Objects slower than this are taken for standing."""


def jump_of(times: ArrayLike, places: ArrayLike) -> tuple[float, Floats]:
    """Return by how many standard deviations the latest places leave the way of the earlier ones, and the vector (2,).

    The earlier places give a straight line in time, or one place if the object stands. NaN where they are too few.

    Args:
        times: (T,) of detections, rising.
        places: (T, 2) of their centers in meters.
    """
    t_s, xy = np.asarray(times, np.float64), np.asarray(places, np.float64)
    if len(t_s) < LATEST + LEAST_EARLIER or t_s[-1] - t_s[-LATEST] > _LONGEST_S:
        return float("nan"), np.zeros(2)
    now_s, before_s, before = t_s[-LATEST:].mean(), t_s[:-LATEST], xy[:-LATEST]
    count, mean_s, mean = len(before), before_s.mean(), before.mean(axis=0)
    spread = ((before_s - mean_s) ** 2).sum()
    velocity = ((before_s - mean_s)[:, None] * (before - mean)).sum(axis=0) / max(spread, 1e-9)
    ahead_s = now_s - mean_s
    if np.hypot(*velocity) < PARKED_MPS:
        rest, expected, lever, turned = before - mean, mean, 0.0, 0.0
    else:
        rest = before - mean - velocity * (before_s - mean_s)[:, None]
        expected, lever = mean + velocity * ahead_s, ahead_s**2 / max(spread, 1e-9)
        turned = 0.5 * _TURN_MPS2 * (now_s - before_s[-1]) * ahead_s
    variance = max(float((rest**2).sum() / max(2 * count - 4, 1)), _LEAST_STD_M**2)
    std = np.sqrt(variance * (1 / LATEST + 1 / count + lever) + turned**2)
    vector = xy[-LATEST:].mean(axis=0) - expected
    return float(np.hypot(*vector) / std), vector
