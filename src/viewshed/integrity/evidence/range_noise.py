"""Noise of range along the rings that is not the sensor's: a spoofer sets ranges with an error of its own.

Measured on commercial sensors it is .10 m a point (docs/attacks.md), where a sensor has .02 m. It shows where a
surface is smooth: what a parabola leaves of seven ranges in a row. Leaves and grass are rough as well, so the lower
quartile counts: all of a forged patch is noisy, but rough surfaces mix with smooth ones. Rings of one band meet the
ground at one range and angle, so on the ground each band is compared with itself all around; noise of the whole sweep,
of rain or of the sensor, cancels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.integrity.evidence.base import ABSTAINS, SECTORS, Floats, MonitoredSweep
from viewshed.integrity.evidence.beam_image import beam_image_of

_BANDS = 8
"""Bands of rings, each with its own quartile."""

_GROUND_M = 0.3
"""Returns lower than this above local ground are ground."""

_MOST_M = 0.3
"""A larger quartile is no noise of a sensor or spoofer, but a rough surface."""

_FLOOR_M = 0.01
"""Noise that every sensor may have."""


def measure_ground_noise(monitored: MonitoredSweep) -> Floats:
    """Return the noise of ground returns (SECTORS,) against that all around; NaN for too few, or without rings."""
    noise_m = _noise_of(monitored, _GROUND_M)
    return ABSTAINS if noise_m is None else _second_largest(noise_m / (_median(noise_m, 0) + _FLOOR_M))


def measure_surface_noise(monitored: MonitoredSweep) -> Floats:
    """Return the noise of all returns (SECTORS,) against the sweep's smoothest; NaN for too few, or without rings."""
    noise_m = _noise_of(monitored, np.inf)
    if noise_m is None or np.isnan(noise_m).all():
        return ABSTAINS
    return _second_largest(noise_m / (np.nanquantile(noise_m, 0.25) + _FLOOR_M))


def _noise_of(monitored: MonitoredSweep, below_m: float) -> Floats | None:
    """Return the noise in meters (SECTORS, _BANDS) of returns lower than this; NaN where too few or too rough."""
    image = beam_image_of(monitored.leveled)
    if image is None:
        return None
    noise_m = _core.measure_noise(image.range_m, image.height_m, image.sector, below_m, SECTORS, _BANDS)
    return np.where(noise_m < _MOST_M, noise_m, np.nan).astype(np.float32)


def _median(values: Floats, axis: int) -> Floats:
    """Return the median along an axis without NaN; NaN where there is nothing else."""
    ordered, count = np.sort(values, axis), np.isfinite(values).sum(axis, keepdims=True)
    low, high = (np.take_along_axis(ordered, np.maximum(k, 0), axis) for k in ((count - 1) // 2, count // 2))
    return np.where(count > 0, (low + np.where(count > 0, high, low)) / 2, np.nan).astype(np.float32)


def _second_largest(values: NDArray[np.floating]) -> Floats:
    """Return the second largest of each row without NaN: a patch reaches over several bands. NaN for none."""
    known = np.isfinite(values)
    second = np.sort(np.where(known, values, 0.0), axis=1)[:, -2]
    return np.where(known.any(axis=1), second, np.nan).astype(np.float32)
