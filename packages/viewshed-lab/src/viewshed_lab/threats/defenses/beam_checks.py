"""What a LiDAR cannot report: ranges beyond its own, two returns of one beam, sectors without any."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.geometry import polar
from viewshed.preprocess.leveling import MAX_RANGE_M, NULL_RANGE_M
from viewshed.preprocess.ring_recovery import rings_of_sweep
from viewshed.sweep import Sweep
from viewshed_lab.threats.defenses.base import Defended, without

HOUSING_M = 1.0
"""Returns nearer than this are null returns or the sensor's own housing: they come several to a beam."""

BINS = 360
"""Azimuth bins in which empty sectors are looked for."""


@dataclass(frozen=True, slots=True)
class RangeValidation:
    """Drops returns nearer or farther than the sensor can measure.

    The limits are those of the sweep's sensor; 0.5 and 250 m where it is not known.
    """

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without impossible ranges."""
        model = sweep.model
        near_m, far_m = (NULL_RANGE_M, MAX_RANGE_M) if model is None else (model.min_range_m, model.max_range_m)
        range_m = np.linalg.norm(sweep.points, axis=1)
        return without(sweep, (range_m < near_m) | (range_m > far_m))


@dataclass(frozen=True, slots=True)
class OneReturnPerBeam:
    """Drops all returns of a beam but the nearest. Needs rings.

    Two returns share a beam if they share a ring and their firing azimuths (those of the points where the sweep has
    none) lie within ``tolerance`` of a firing step. Which one is real is not known; the nearest one is kept because a
    claim to see through a surface is the dangerous one. Returns nearer than 1 m, and those of no ring, are left alone.
    """

    tolerance: float = 0.25  # share of the azimuth step between two firings

    def __post_init__(self) -> None:
        if not 0 <= self.tolerance < 1:
            raise ValueError(f"tolerance must lie in [0, 1), got {self.tolerance}")

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` with one return a beam.

        Raises:
            ValueError: the sweep's rings are not known.
        """
        dropped = np.zeros(len(sweep), np.bool_)
        if len(sweep) == 0:
            return without(sweep, dropped)
        beams = rings_of_sweep(sweep)
        range_m = np.linalg.norm(sweep.points, axis=1)
        azimuth = polar(sweep.points)[1] if sweep.azimuth is None else sweep.azimuth
        rows = np.flatnonzero((beams.ring >= 0) & (range_m >= HOUSING_M))
        rows = rows[np.lexsort((range_m[rows], azimuth[rows], beams.ring[rows]))]
        nearest_first = np.argsort(range_m[rows], kind="stable")
        reach = self.tolerance * beams.azimuth_step
        dropped[rows] = _farther_on_beam(beams.ring[rows], azimuth[rows].astype(np.float64), nearest_first, reach)
        return without(sweep, dropped)


@njit(cache=True, nogil=True, error_model="numpy")
def _farther_on_beam(ring: Any, azimuth: Any, nearest_first: Any, reach: float) -> Any:
    """Return (N,) bool: returns that lie within ``reach`` of a kept nearer one; sorted by ring and azimuth."""
    count = len(ring)
    starts = np.searchsorted(ring, ring, side="left")
    ends = np.searchsorted(ring, ring, side="right")
    gone = np.zeros(count, np.bool_)
    for n in nearest_first:
        if gone[n]:
            continue
        start, size = starts[n], ends[n] - starts[n]
        for way in (1, -1):
            for step in range(1, size):
                m = start + (n - start + way * step) % size
                apart = abs((azimuth[m] - azimuth[n] + np.pi) % (2 * np.pi) - np.pi)
                if apart > reach:
                    break
                gone[m] = True
    return gone


@dataclass(frozen=True, slots=True)
class EmptySectorCheck:
    """Raises an alarm where a sector of the revolution has hardly any returns; drops nothing.

    A bin of one degree is empty with fewer returns than ``share`` of the median bin (of those with any). The score is
    the widest run of empty bins as a share of the revolution.
    """

    width_deg: float = 5.0  # a run at least this wide raises the alarm
    share: float = 0.1  # of the median bin

    def __post_init__(self) -> None:
        if not (0 < self.width_deg <= 360 and 0 < self.share <= 1):
            raise ValueError(f"width_deg must lie in (0, 360] and share in (0, 1], got {self}")

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` as it is, with an alarm; an empty sweep raises it."""
        range_m = np.linalg.norm(sweep.points, axis=1)
        azimuth = polar(sweep.points[range_m >= HOUSING_M])[1].astype(np.float64)
        counts = np.bincount(((azimuth + np.pi) * (BINS / (2 * np.pi))).astype(np.intp) % BINS, minlength=BINS)
        some = counts[counts > 0]
        empty = counts < max(self.share * np.median(some), 1) if len(some) else np.ones(BINS, np.bool_)
        score = _widest(empty) / BINS
        return Defended(sweep, np.zeros(len(sweep), np.bool_), score * 360 >= self.width_deg, score)


def _widest(empty: NDArray[np.bool_]) -> int:
    """Return the length of the longest run of True in a circle."""
    full = np.flatnonzero(~empty)
    if len(full) == 0:
        return len(empty)
    return int(np.diff(full, append=full[0] + len(empty)).max()) - 1
