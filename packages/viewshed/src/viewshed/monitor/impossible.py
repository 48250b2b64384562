"""Detect single sweeps that no honest sensor of their kind reports.

One sweep cannot tell a forgery that respects the beams from a real scene (measured AUROC: .5), so these checks promise
no detection rate.
"""

from __future__ import annotations

import numpy as np

from viewshed.arrays import F32
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep

MIN_RETURNS = 72
"""Minimum number of usable returns: one in each 5° of azimuth."""

BLINDED_M, BLINDED_SHARE = 0.7, 0.9
"""A sensor is blinded if more than this share of its returns lie nearer than this."""

OUTSIDE = np.deg2rad(2.0)
"""A return lies on no beam if it is farther than this above the highest or below the lowest beam of the table."""

OUTSIDE_SHARE = 0.02
"""Share of returns on no beam, out of time or beyond the range that bad mounting or a bad clock cannot explain."""

TIME_BINS, TIMED_RETURNS = 120, 2048
"""Time bins of a sweep, and number of returns sampled; sweeps with fewer returns are not checked."""

OUT_OF_TIME, CARRIED_M, MAX_OUT_OF_TIME_SHARE = np.deg2rad(5.0), 5.0, 0.25
"""A return is out of time if its azimuth is farther than this from where the sensor pointed, plus what the sensor's
own motion in a revolution explains. Above the maximum share the times do not tell where this sensor points."""


def impossible_reasons(leveled: LeveledSweep) -> tuple[str, ...]:
    """Return one sentence for each reason why no sensor of this kind reports such a sweep."""
    sweep = leveled.sweep
    range_m = np.sqrt(np.einsum("ij,ij->i", sweep.points, sweep.points))
    reasons = []
    if len(leveled.points) < MIN_RETURNS:
        reasons.append(f"the sweep has {len(leveled.points)} usable returns: empty, covered or jammed")
    returned_m = range_m[range_m > 0.0]  # drivers write zeros for beams without a return
    near = float((returned_m < BLINDED_M).mean()) if len(returned_m) else 0.0
    if near > BLINDED_SHARE:
        reasons.append(f"{near:.0%} of the returns lie within {BLINDED_M:g} m: the sensor is blinded or covered")
    out_of_time = share_out_of_time(sweep)
    if OUTSIDE_SHARE < out_of_time <= MAX_OUT_OF_TIME_SHARE:
        reasons.append(f"{out_of_time:.0%} of the returns lie where the sensor did not point at their time")
    return (*reasons, *_off_table(sweep, range_m))


def share_out_of_time(sweep: Sweep) -> float:
    """Return the share of returns that lie where a rotating sensor did not point at their time; 0 without times.

    The direction at a time is the mean of the returns at that time, without outliers. With two heads, or with times of
    another clock, most returns are out of time and the share says nothing.
    """
    if sweep.time_s is None or sweep.planar is not None or len(sweep) < TIMED_RETURNS:
        return 0.0
    # Random sample: a fixed stride could hit the returns of one head only.
    sample = np.random.default_rng(0).integers(len(sweep), size=TIMED_RETURNS)
    x, y, time_s = sweep.points[sample, 0], sweep.points[sample, 1], sweep.time_s[sample].astype(np.float64)
    range_m = np.hypot(x, y)
    direction = (x + 1j * y) / np.maximum(range_m, 1e-3)
    known, duration_s = range_m > 1.0, float(np.ptp(time_s))
    if not duration_s > 0.0 or not known.any():
        return 0.0
    time_bin = np.minimum((time_s - time_s.min()) * (TIME_BINS / duration_s), TIME_BINS - 1).astype(np.intp)
    offset, weight = np.zeros(len(time_bin), np.complex128), known.astype(np.float64)
    # Mean direction of each time bin, repeated without the returns that lie too far (radians) from it.
    for max_angle in (1.0, 0.3, 0.1):
        pointing = np.bincount(time_bin, weight * direction.real, TIME_BINS) + 1j * np.bincount(
            time_bin, weight * direction.imag, TIME_BINS
        )
        offset = direction * np.conj(pointing / np.maximum(np.abs(pointing), 1e-9))[time_bin]
        weight = known * (offset.real > np.cos(max_angle))
    angle, max_angles = np.abs(np.angle(offset)), OUT_OF_TIME + np.arctan2(CARRIED_M, range_m)
    return float((angle > max_angles)[known].mean())


def _off_table(sweep: Sweep, range_m: F32) -> list[str]:
    """Return one sentence for each violation of the sensor's beam table; none without a table."""
    model = sweep.model
    if model is None or model.shots is not None or sweep.planar is not None or not len(range_m):
        return []
    z_m = sweep.points[:, 2]
    low, high = np.sin(np.min(model.elevation) - OUTSIDE), np.sin(np.max(model.elevation) + OUTSIDE)
    known = range_m > max(model.min_range_m, 2.0)  # nearer returns show the offsets of the beams' origins
    outside = float(((z_m < low * range_m) | (z_m > high * range_m))[known].mean()) if known.any() else 0.0
    beyond = float((range_m > 1.05 * model.max_range_m).mean())
    reasons = []
    if outside > OUTSIDE_SHARE:
        reasons.append(f"{outside:.0%} of the returns lie above or below all beams of a {model.name}")
    if beyond > OUTSIDE_SHARE:
        reasons.append(f"{beyond:.0%} of the returns lie beyond the range of a {model.name}, {model.max_range_m:g} m")
    return reasons
