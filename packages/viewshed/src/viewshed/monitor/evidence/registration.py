"""Poses that do not fit: sweeps laid over each other by their poses must show one world.

The obstacles of this sweep are put on the surfaces of earlier ones by the given poses. A turn and a shift that lay
them better are estimated, point to plane, and counted in units of their uncertainty: a direction in which nothing is
seen, as along a tunnel or on an open field, has no information and so no weight. The sweep before tells of a pose that
jumps; the oldest one still tells when all poses since are off by the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep
from viewshed.monitor.evidence.views import compare

SURE_YAW, SURE_SHIFT_M = np.deg2rad(0.1), 0.1
"""Deviations of a pose that are no cause for worry: time stamps, motion within a sweep, the grain of its returns."""

SIGMA_M = 0.05
"""Least deviation of a return from its surface."""

DEPENDENT = 4.0
"""So many returns of one surface say no more than one."""

ENOUGH_SEEN = 0.25
"""A shift is seen where so large a share of the returns shows it; fewer may lie on cars that drive side by side, ..."""

CARRIED_M = 1.0
"""... which are somewhere else by about so much."""

LEAST_MATCHES = 80
"""Returns on surfaces that an estimate needs."""


def measure_registration(monitored: MonitoredSweep) -> F32:
    """Return how far the pose is off, in units of what is known of that (SECTORS,), the same in all sectors.

    The greater one against the sweep before and the oldest. Abstains without poses, earlier sweeps or rings.
    """
    comparison = compare(monitored)
    if comparison is None:
        return ABSTAINS
    compared = sorted({0, len(comparison.earlier) - 1})
    found = comparison.view.register_on([comparison.earlier[k] for k in compared], comparison.to_earlier[compared])
    distances = [
        _deviations(step, information, sigma_m, matches)
        for step, information, sigma_m, matches in zip(*found, strict=True)
        if matches >= LEAST_MATCHES
    ]
    return np.full(SECTORS, max(distances), np.float32) if distances else ABSTAINS


def _deviations(step: NDArray[np.float64], information: NDArray[np.float64], sigma_m: float, matches: int) -> float:
    """Return the Mahalanobis distance of a turn and a shift (3,) with their information (3, 3) for unit noise."""
    variance_m2 = max(sigma_m, SIGMA_M) ** 2 * DEPENDENT
    covariance = variance_m2 * np.linalg.inv(information + 1e-6 * np.eye(3))
    covariance += np.diag([SURE_YAW**2, SURE_SHIFT_M**2, SURE_SHIFT_M**2])
    # Directions of shift that few returns show: those may lie on things that move.
    seen, directions = np.linalg.eigh(information[1:, 1:] / matches)
    carried_m = CARRIED_M * np.clip(1.0 - seen / ENOUGH_SEEN, 0.0, 1.0)
    covariance[1:, 1:] += (directions * carried_m**2) @ directions.T
    squared = float(step @ np.linalg.solve(covariance, step))
    return float(np.sqrt(max(squared, 0.0)))
