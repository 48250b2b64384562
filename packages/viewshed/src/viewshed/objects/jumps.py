"""Sudden moves of a track: its latest positions against the extrapolation of its earlier ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64

LATEST, EARLIER, MIN_EARLIER = 3, 12, 5
"""Number of latest detections (compared), of earlier ones (extrapolated), and the minimum of the latter."""

_MAX_LATEST_S = 1.0
"""Maximum duration of the latest detections; in a longer one nothing is sudden."""

_MIN_STD_M = 0.08
"""Minimum standard deviation of a detection's position."""

_TURN_MPS2 = 2.0
"""Acceleration of objects that is not suspicious."""

PARKED_MPS = 0.5
"""Objects slower than this are taken as standing."""


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Times and positions of the last detections of N tracks, the latest last; NaN where there were fewer."""

    times: F64  # (N, T) seconds
    places: F64  # (N, T, 2) centers in meters

    @classmethod
    def none(cls, count: int) -> Self:
        """Return the sightings of ``count`` tracks without detections."""
        length = LATEST + EARLIER
        return cls(np.full((count, length), np.nan), np.full((count, length, 2), np.nan))

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Self:
        """Return some of the tracks, as a copy."""
        return type(self)(self.times[rows], self.places[rows])

    def joined(self, others: Self) -> Self:
        """Return these tracks followed by others."""
        return type(self)(np.concatenate([self.times, others.times]), np.concatenate([self.places, others.places]))

    def after(self, rows: NDArray[np.intp], t_s: float, places: F64) -> Self:
        """Return the sightings with new detections at positions (R, 2) of the tracks with indices (R,)."""
        times, before = self.times.copy(), self.places.copy()
        times[rows, :-1], before[rows, :-1] = times[rows, 1:], before[rows, 1:]
        times[rows, -1], before[rows, -1] = t_s, places
        return type(self)(times, before)

    def jumps(self) -> tuple[F64, F64]:
        """Return the jumps of the latest positions in standard deviations (N,), and as vectors (N, 2).

        The earlier positions are extrapolated by a straight line in time, or by one place if the object stands. Both
        results are NaN and 0 if there are too few of them, or if the latest ones took too long to be sudden.
        """
        earlier_s, earlier = self.times[:, :-LATEST], self.places[:, :-LATEST]
        is_earlier = ~np.isnan(earlier_s)
        count = is_earlier.sum(axis=1)
        is_known = (count >= MIN_EARLIER) & (self.times[:, -1] - self.times[:, -LATEST] <= _MAX_LATEST_S)
        count, weight = np.maximum(count, 1), is_earlier.astype(np.float64)
        earlier_s, earlier = np.where(is_earlier, earlier_s, 0.0), np.where(is_earlier[..., None], earlier, 0.0)
        # Fit a line to the earlier positions by least squares; unknown ones have weight 0.
        mean_s, mean = earlier_s.sum(axis=1) / count, earlier.sum(axis=1) / count[:, None]
        since_s = weight * (earlier_s - mean_s[:, None])
        spread = np.maximum((since_s**2).sum(axis=1), 1e-9)
        off = weight[..., None] * (earlier - mean[:, None])
        velocity = (since_s[..., None] * off).sum(axis=1) / spread[:, None]
        velocity = np.where((np.hypot(*velocity.T) < PARKED_MPS)[:, None], 0.0, velocity)
        moves = velocity.any(axis=1)
        latest_s = np.where(is_known[:, None], self.times[:, -LATEST:], 0.0)
        ahead_s = latest_s.mean(axis=1) - mean_s
        rest = off - velocity[:, None] * since_s[..., None]
        variance = (rest**2).sum(axis=(1, 2)) / np.maximum(2 * count - 4, 1)
        lever = np.where(moves, ahead_s**2 / spread, 0.0)
        turned = np.where(moves, 0.5 * _TURN_MPS2 * (latest_s.mean(axis=1) - earlier_s[:, -1]) * ahead_s, 0.0)
        std = np.sqrt(np.maximum(variance, _MIN_STD_M**2) * (1 / LATEST + 1 / count + lever) + turned**2)
        vector = np.where(is_known[:, None, None], self.places[:, -LATEST:], 0.0).mean(axis=1)
        vector = np.where(is_known[:, None], vector - mean - velocity * ahead_s[:, None], 0.0)
        return np.where(is_known, np.hypot(*vector.T) / std, np.nan), vector
