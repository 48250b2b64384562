"""Evidence of the noise of range: more than the sensor's, the same as in an earlier sweep, or common to a surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep
from viewshed.monitor.evidence.beams import return_image_of
from viewshed.monitor.evidence.history import compare, view_of
from viewshed.preprocess.leveling import LeveledSweep

_BANDS = 8
"""Bands of rings, each with its own quartile."""

_MOST_M = 0.3
"""A larger quartile is no noise of a sensor or spoofer, but a rough surface."""

_FLOOR_M = 0.01
"""Noise that every sensor may have."""


def measure_ground_noise(monitored: MonitoredSweep) -> F32:
    """Return the noise of ground returns (SECTORS,) against that all around; NaN for too few, or without rings.

    Rings of one band meet the ground at one range and angle, so each band is compared with itself all around; noise of
    the whole sweep, of rain or of the sensor, cancels.
    """
    noise = _noise_of(monitored.leveled)
    if noise is None:
        return ABSTAINS
    noise_m = noise[0]
    return np.asarray(_largest_of_bands(noise_m / (_median_around(noise_m) + _FLOOR_M)).mean(axis=1), np.float32)


def measure_near_noise(monitored: MonitoredSweep) -> F32:
    """Return the noise of returns up to 20 m (SECTORS,) against the smoothest; NaN for too few, or without rings."""
    return _against_smoothest(monitored, 1)


def measure_surface_noise(monitored: MonitoredSweep) -> F32:
    """Return the noise of all returns (SECTORS,) against the smoothest; NaN for too few, or without rings."""
    return _against_smoothest(monitored, 2)


def _against_smoothest(monitored: MonitoredSweep, kind: int) -> F32:
    noise = _noise_of(monitored.leveled)
    if noise is None or np.isnan(noise_m := noise[kind]).all():
        return ABSTAINS
    # The second largest: a patch reaches over several bands.
    return np.asarray(_largest_of_bands(noise_m / (np.nanquantile(noise_m, 0.25) + _FLOOR_M))[:, 0], np.float32)


def _noise_of(leveled: LeveledSweep) -> F32 | None:
    """Return the noise in meters (3, SECTORS, _BANDS) of ground, near and all, made once; None without rings.

    A spoofer sets ranges with an error of its own: on commercial sensors .10 m a point (docs/attacks.md), where a
    sensor has .02 m. It shows where a surface is smooth: what a parabola leaves of seven ranges in a row. Leaves and
    grass are rough as well, so the lower quartile counts: all of a forged patch is noisy, but rough surfaces mix with
    smooth ones. NaN where it is of too few returns, or too rough.
    """
    image = return_image_of(leveled)
    noise: F32 | None = leveled.derived.get(("range_noise",))
    if noise is None and image is not None:
        noise_m = _core.measure_noise(image.range_m, image.height_m, image.sector, SECTORS, _BANDS)
        noise = np.where(noise_m < _MOST_M, noise_m, np.float32(np.nan))
        leveled.derived[("range_noise",)] = noise
    return noise


def _median_around(noise_m: F32) -> F32:
    """Return the median (_BANDS,) over the sectors that have a number; NaN where none has."""
    ordered, count = np.sort(noise_m, axis=0), np.isfinite(noise_m).sum(axis=0)
    band = np.arange(noise_m.shape[1])
    low, high = ordered[np.maximum(count - 1, 0) // 2, band], ordered[np.minimum(count // 2, len(noise_m) - 1), band]
    return np.where(count > 0, (low + high) / 2, np.nan).astype(np.float32)


def _largest_of_bands(values: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return the second largest and the largest of each row (SECTORS, 2), 0 for a missing one; NaN where none is."""
    known = np.isfinite(values)
    two = np.sort(np.where(known, values, 0.0), axis=1)[:, -2:]
    return np.where(known.any(axis=1, keepdims=True), two, np.nan)


def measure_same_noise(monitored: MonitoredSweep) -> F32:
    """Return the share by sector (SECTORS,) of ranges that repeat an earlier sweep's, beyond what noise repeats.

    A replayed sweep, or a sensor that is frozen: each range has noise of its own, so two sweeps of one scene differ,
    even from one place. Where the difference between the two is the same for a beam and its neighbor, to less than the
    sensor's noise, one sweep was made of the other. Neighbors are compared, not ranges, because undoing another motion
    shifts all ranges of a direction alike. Sensors report whole steps of range, so some differences are equal by
    chance: about as many as differ by one step, which are subtracted.

    Of the earlier sweep that is most alike. Needs no poses; abstains without earlier sweeps of the same image or rings.
    """
    view, image = view_of(monitored.leveled), monitored.leveled.range_image
    if view is None or image is None:
        return ABSTAINS
    views = [
        before
        for each in monitored.earlier
        if each.range_image is not None
        and each.range_image.counts.shape == image.counts.shape
        and (before := view_of(each)) is not None
    ]
    if not views:
        return ABSTAINS
    shares = view.repeats(views, SECTORS)
    alike = int(np.argmax(np.nan_to_num(shares, nan=-1.0).mean(axis=1)))
    return np.asarray(np.maximum(shares[alike], np.float32(0.0)))


def measure_frame_noise(monitored: MonitoredSweep) -> F32:
    """Return the median second difference of range by sector (SECTORS,), m, over this sweep and the two before it.

    A spoofer times all its pulses by one clock, which is off by some decimeters in each sweep anew; so what it shows
    jumps to and fro as a whole, along the beams, while the world stands still. Things that move at a constant speed do
    not: their second difference is zero. Abstains without poses, two earlier sweeps or rings.
    """
    comparison = compare(monitored)
    if comparison is None or len(comparison.earlier) < 2:
        return ABSTAINS
    return comparison.view.jumps(comparison.earlier[:2], comparison.to_earlier[:2], comparison.gaps_s[:2], SECTORS)
