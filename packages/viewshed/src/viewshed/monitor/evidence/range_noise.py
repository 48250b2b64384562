"""Noise of range along the rings that is not the sensor's: a spoofer sets ranges with an error of its own.

Measured on commercial sensors it is .10 m a point (docs/attacks.md), where a sensor has .02 m. It shows where a
surface is smooth: what a parabola leaves of seven ranges in a row. Leaves and grass are rough as well, so the lower
quartile counts: all of a forged patch is noisy, but rough surfaces mix with smooth ones. Rings of one band meet the
ground at one range and angle, so on the ground each band is compared with itself all around; noise of the whole sweep,
of rain or of the sensor, cancels.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep
from viewshed.monitor.evidence.return_image import ReturnImage, return_image_of

_BANDS = 8
"""Bands of rings, each with its own quartile."""

_MOST_M = 0.3
"""A larger quartile is no noise of a sensor or spoofer, but a rough surface."""

_FLOOR_M = 0.01
"""Noise that every sensor may have."""


def measure_ground_noise(monitored: MonitoredSweep) -> F32:
    """Return the noise of ground returns (SECTORS,) against that all around; NaN for too few, or without rings."""
    image = return_image_of(monitored.leveled)
    if image is None:
        return ABSTAINS
    noise_m = _noise_of(image)[0]
    return _largest_two(noise_m / (_median_around(noise_m) + _FLOOR_M))


def measure_near_noise(monitored: MonitoredSweep) -> F32:
    """Return the noise of returns up to 20 m (SECTORS,) against the smoothest; NaN for too few, or without rings."""
    return _against_smoothest(monitored, 1)


def measure_surface_noise(monitored: MonitoredSweep) -> F32:
    """Return the noise of all returns (SECTORS,) against the smoothest; NaN for too few, or without rings."""
    return _against_smoothest(monitored, 2)


def _against_smoothest(monitored: MonitoredSweep, kind: int) -> F32:
    image = return_image_of(monitored.leveled)
    if image is None:
        return ABSTAINS
    noise_m = _noise_of(image)[kind]
    if np.isnan(noise_m).all():
        return ABSTAINS
    return _second_largest(noise_m / (np.nanquantile(noise_m, 0.25) + _FLOOR_M))


@lru_cache(maxsize=2)
def _noise_of(image: ReturnImage) -> F32:
    """Return the noise in meters (3, SECTORS, _BANDS) of ground, near and all; NaN where too few or too rough."""
    noise_m = _core.measure_noise(image.range_m, image.height_m, image.sector, SECTORS, _BANDS)
    return np.where(noise_m < _MOST_M, noise_m, np.nan).astype(np.float32)


def _median_around(noise_m: F32) -> F32:
    """Return the median (_BANDS,) over the sectors that have a number; NaN where none has."""
    ordered, count = np.sort(noise_m, axis=0), np.isfinite(noise_m).sum(axis=0)
    band = np.arange(noise_m.shape[1])
    low, high = ordered[np.maximum(count - 1, 0) // 2, band], ordered[np.minimum(count // 2, len(noise_m) - 1), band]
    return np.where(count > 0, (low + high) / 2, np.nan).astype(np.float32)


def _second_largest(values: NDArray[np.floating[Any]]) -> F32:
    """Return the second largest of each row without NaN: a patch reaches over several bands. NaN for none."""
    known = np.isfinite(values)
    second = np.sort(np.where(known, values, 0.0), axis=1)[:, -2]
    return np.where(known.any(axis=1), second, np.nan).astype(np.float32)


def _largest_two(values: NDArray[np.floating[Any]]) -> F32:
    """Return the mean of the two largest of each row, 0 for one that is missing; NaN for none."""
    known = np.isfinite(values)
    two = np.sort(np.where(known, values, 0.0), axis=1)[:, -2:].mean(axis=1)
    return np.where(known.any(axis=1), two, np.nan).astype(np.float32)
