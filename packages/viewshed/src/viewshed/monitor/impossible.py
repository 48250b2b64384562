"""What one sweep says by itself: that it is impossible, or nothing.

A forgery that keeps to the beams cannot be told from a world by one sweep (area under the curve .5, measured), so no
rate is promised here; what is listed no honest sensor of this kind reports.
"""

from __future__ import annotations

import numpy as np

from viewshed.arrays import F32
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep

LEAST_RETURNS = 72
"""Fewer usable returns, less than one in each 5° of azimuth, show nothing."""

BLINDED_M, BLINDED_SHARE = 0.7, 0.9
"""A sensor is blinded if more than this share of its returns lie nearer than this."""

OUTSIDE = np.deg2rad(2.0)
"""Returns lie on no beam if they are so far above the highest or below the lowest one of the beam table."""

OUTSIDE_SHARE = 0.02
"""Share of returns on no beam, out of their time or beyond the range, that a bad mounting or clock does not explain."""

TIME_BINS, TIMED = 120, 2048
"""Parts of a sweep by its times, and returns that are looked at; fewer tell nothing."""

OUT_OF_TIME, CARRIED_M, MOST_OUT = np.deg2rad(5.0), 5.0, 0.25
"""A return is out of its time where it lies so far from where the sensor pointed, more than a sensor that drives fast
carries it in a revolution; where more than a share of the returns are, times do not tell where this sensor points."""


def impossible_reasons(leveled: LeveledSweep) -> tuple[str, ...]:
    """Return why no sensor of this kind reports such a sweep, a sentence each; none where one does."""
    sweep = leveled.sweep
    range_m = np.sqrt(np.einsum("ij,ij->i", sweep.points, sweep.points))
    reasons = []
    if len(leveled.points) < LEAST_RETURNS:
        reasons.append(f"the sweep has {len(leveled.points)} usable returns: empty, covered or jammed")
    returned_m = range_m[range_m > 0.0]  # drivers write zeros for beams without a return
    near = float((returned_m < BLINDED_M).mean()) if len(returned_m) else 0.0
    if near > BLINDED_SHARE:
        reasons.append(f"{near:.0%} of the returns lie within {BLINDED_M:g} m: the sensor is blinded or covered")
    out_of_time = share_out_of_time(sweep)
    if OUTSIDE_SHARE < out_of_time <= MOST_OUT:
        reasons.append(f"{out_of_time:.0%} of the returns lie where the sensor did not point at their time")
    return (*reasons, *_off_table(sweep, range_m))


def share_out_of_time(sweep: Sweep) -> float:
    """Return the share of the returns that lie where a sensor that turns did not point at their time; 0 without times.

    Where it points at a time is what most returns of that time say. Two heads, or times of another clock, tell nothing:
    then most returns are out of their time.
    """
    if sweep.time_s is None or sweep.planar is not None or len(sweep) < TIMED:
        return 0.0
    # Drawn, for every other return may be of another head.
    some = np.random.default_rng(0).integers(len(sweep), size=TIMED)
    x, y, time_s = sweep.points[some, 0], sweep.points[some, 1], sweep.time_s[some].astype(np.float64)
    range_m = np.hypot(x, y)
    direction = (x + 1j * y) / np.maximum(range_m, 1e-3)
    known, lasts_s = range_m > 1.0, float(np.ptp(time_s))
    if not lasts_s > 0.0 or not known.any():
        return 0.0
    part = np.minimum((time_s - time_s.min()) * (TIME_BINS / lasts_s), TIME_BINS - 1).astype(np.intp)
    along, weight = np.zeros(len(part), np.complex128), known.astype(np.float64)
    # The direction of each part, then without what lies far from it.
    for near in (1.0, 0.3, 0.1):
        pointing = np.bincount(part, weight * direction.real, TIME_BINS) + 1j * np.bincount(
            part, weight * direction.imag, TIME_BINS
        )
        along = direction * np.conj(pointing / np.maximum(np.abs(pointing), 1e-9))[part]
        weight = known * (along.real > np.cos(near))
    off, allowed = np.abs(np.angle(along)), OUT_OF_TIME + np.arctan2(CARRIED_M, range_m)
    return float((off > allowed)[known].mean())


def _off_table(sweep: Sweep, range_m: F32) -> list[str]:
    """Return what the sensor's own beam table forbids; nothing without one."""
    model = sweep.model
    if model is None or model.shots is not None or sweep.planar is not None or not len(range_m):
        return []
    z_m = sweep.points[:, 2]
    low, high = np.sin(np.min(model.elevation) - OUTSIDE), np.sin(np.max(model.elevation) + OUTSIDE)
    known = range_m > max(model.min_range_m, 2.0)  # nearer, the beams' own origins show
    outside = float(((z_m < low * range_m) | (z_m > high * range_m))[known].mean()) if known.any() else 0.0
    beyond = float((range_m > 1.05 * model.max_range_m).mean())
    reasons = []
    if outside > OUTSIDE_SHARE:
        reasons.append(f"{outside:.0%} of the returns lie above or below all beams of a {model.name}")
    if beyond > OUTSIDE_SHARE:
        reasons.append(f"{beyond:.0%} of the returns lie beyond the range of a {model.name}, {model.max_range_m:g} m")
    return reasons
