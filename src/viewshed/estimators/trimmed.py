"""Ray trace to the farthest return once the few farthest are dropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viewshed.bev import BevGrid
from viewshed.estimate import FovEstimate
from viewshed.level import LevelSweep, level_sweep
from viewshed.polar import (
    FALLBACK_BINS,
    ends_on_obstacle,
    farthest_in_bins,
    fov_of_state,
    measured_azimuth_bins,
    reach_of,
    require,
    require_bins,
    state_of_limits,
    with_margin,
)
from viewshed.sweep import Sweep
from viewshed.visible import CAR, Target


@dataclass(frozen=True, slots=True)
class TrimmedRayTrace:
    """Visible up to the farthest return of the azimuth bin but ``trim``. Source: the trimmed maximum of statistics.

    As :class:`~viewshed.estimators.farthest.QuantizedRayTrace`, but the ``trim`` farthest returns of each bin are
    dropped first. A bin with no more than ``trim`` returns is UNKNOWN. Beyond the limit a cell is HIDDEN if the
    return at the limit is an obstacle, else UNKNOWN.

    Limits: more than ``trim`` spoofed points in a bin open it as before; sensors with few beams lose their outer
    rings (16 beams leave 12); holes behind low cars are called visible, as by every farthest-return method.

    Attributes:
        grid: where the cells are.
        target: passed on; this estimator does not depend on it.
        trim: farthest returns to drop in each bin.
        azimuth_bins: number of bins; None takes them from the measured azimuth step, but at most 360, so that
            a bin holds enough returns to drop some.
        name: goes into the estimate's ``method``.

    >>> TrimmedRayTrace(BevGrid(8, 4.0), trim=4).name
    'trimmed'
    """

    grid: BevGrid
    target: Target = CAR
    trim: int = 4
    azimuth_bins: int | None = None
    name: str = "trimmed"

    def __post_init__(self) -> None:
        require("trim", self.trim, 0, 1000)
        require_bins(self.azimuth_bins)

    def estimate(self, sweep: Sweep) -> FovEstimate:
        """Estimate what the sensor sees: the farthest return of each azimuth bin but the few farthest."""
        return self.estimate_level(level_sweep(sweep, self.grid))

    def estimate_level(self, level: LevelSweep) -> FovEstimate:
        """Estimate from a sweep already levelled."""
        bins = self.azimuth_bins or min(measured_azimuth_bins(level.azimuth), FALLBACK_BINS)
        limit_m = farthest_in_bins(level, bins, drop=self.trim)
        hidden_m = np.where(ends_on_obstacle(level, limit_m), reach_of(level), -1.0).astype(np.float32)
        state = state_of_limits(level, self.grid, with_margin(limit_m, self.grid.cell_m), hidden_m)
        return fov_of_state(level, self.grid, state, self.name, self.target)
