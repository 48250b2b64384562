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
"""Share of returns on no beam, or beyond the sensor's range, that a bad mounting or clock does not explain."""


def impossible_reasons(leveled: LeveledSweep) -> tuple[str, ...]:
    """Return why no sensor of this kind reports such a sweep, a sentence each; none where one does."""
    sweep = leveled.sweep
    range_m = np.sqrt(np.einsum("ij,ij->i", sweep.points, sweep.points))
    reasons = []
    if len(leveled.points) < LEAST_RETURNS:
        reasons.append(f"the sweep has {len(leveled.points)} usable returns: empty, covered or jammed")
    near = float((range_m < BLINDED_M).mean()) if len(range_m) else 0.0
    if near > BLINDED_SHARE:
        reasons.append(f"{near:.0%} of the returns lie within {BLINDED_M:g} m: the sensor is blinded or covered")
    return (*reasons, *_off_table(sweep, range_m))


def _off_table(sweep: Sweep, range_m: F32) -> list[str]:
    """Return what the sensor's own beam table forbids; nothing without one."""
    model = sweep.model
    if model is None or model.shots is not None or sweep.planar is not None or not len(range_m):
        return []
    elevation = np.arcsin(np.clip(sweep.points[:, 2] / np.maximum(range_m, 1e-3), -1.0, 1.0))
    low, high = float(np.min(model.elevation)) - OUTSIDE, float(np.max(model.elevation)) + OUTSIDE
    known = range_m > max(model.min_range_m, 2.0)  # nearer, the beams' own origins show
    outside = float(((elevation < low) | (elevation > high))[known].mean()) if known.any() else 0.0
    beyond = float((range_m > 1.05 * model.max_range_m).mean())
    reasons = []
    if outside > OUTSIDE_SHARE:
        reasons.append(f"{outside:.0%} of the returns lie above or below all beams of a {model.name}")
    if beyond > OUTSIDE_SHARE:
        reasons.append(f"{beyond:.0%} of the returns lie beyond the range of a {model.name}, {model.max_range_m:g} m")
    return reasons
