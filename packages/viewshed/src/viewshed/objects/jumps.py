"""Sudden moves: where the latest detections of a track are, against where the earlier ones lead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64

LATEST, EARLIER, LEAST_EARLIER = 3, 12, 5
"""Detections whose mean is compared with where the earlier ones lead."""

_LONGEST_S = 1.0
"""Where the latest detections take longer, nothing is sudden."""

_LEAST_STD_M = 0.08
"""No detector places boxes better."""

_TURN_MPS2 = 2.0
"""Acceleration that moving objects have without being suspicious."""

PARKED_MPS = 0.5
"""Objects slower than this are taken for standing."""


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Times and places of the last detections of N tracks, the latest last; NaN where there were fewer."""

    times: F64  # (N, T) seconds
    places: F64  # (N, T, 2) centers in meters

    @classmethod
    def none(cls, count: int) -> Self:
        """Return ``count`` tracks that were not detected yet."""
        length = LATEST + EARLIER
        return cls(np.full((count, length), np.nan), np.full((count, length, 2), np.nan))

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Self:
        """Return some of the tracks, as a copy."""
        return type(self)(self.times[rows], self.places[rows])

    def joined(self, others: Self) -> Self:
        """Return these tracks and others after them."""
        return type(self)(np.concatenate([self.times, others.times]), np.concatenate([self.places, others.places]))

    def after(self, rows: NDArray[np.intp], t_s: float, places: F64) -> Self:
        """Return them with detections at places (R, 2) of the tracks with numbers (R,)."""
        times, before = self.times.copy(), self.places.copy()
        times[rows, :-1], before[rows, :-1] = times[rows, 1:], before[rows, 1:]
        times[rows, -1], before[rows, -1] = t_s, places
        return type(self)(times, before)

    def jumps(self) -> tuple[F64, F64]:
        """Return by how many standard deviations (N,) the latest places leave the way of the earlier ones, and vectors.

        The earlier places give a straight line in time, or one place if the object stands. NaN and vectors (N, 2) of
        zeros where they are too few, or where the latest ones took so long that nothing is sudden.
        """
        earlier_s, earlier = self.times[:, :-LATEST], self.places[:, :-LATEST]
        known = ~np.isnan(earlier_s)
        count = known.sum(axis=1)
        says = (count >= LEAST_EARLIER) & (self.times[:, -1] - self.times[:, -LATEST] <= _LONGEST_S)
        count, weight = np.maximum(count, 1), known.astype(np.float64)
        earlier_s, earlier = np.where(known, earlier_s, 0.0), np.where(known[..., None], earlier, 0.0)
        # A line through the earlier places by least squares; all sums are over those that are known.
        mean_s, mean = earlier_s.sum(axis=1) / count, earlier.sum(axis=1) / count[:, None]
        since_s = weight * (earlier_s - mean_s[:, None])
        spread = np.maximum((since_s**2).sum(axis=1), 1e-9)
        off = weight[..., None] * (earlier - mean[:, None])
        velocity = (since_s[..., None] * off).sum(axis=1) / spread[:, None]
        velocity = np.where((np.hypot(*velocity.T) < PARKED_MPS)[:, None], 0.0, velocity)
        moves = velocity.any(axis=1)
        latest_s = np.where(says[:, None], self.times[:, -LATEST:], 0.0)
        ahead_s = latest_s.mean(axis=1) - mean_s
        rest = off - velocity[:, None] * since_s[..., None]
        variance = (rest**2).sum(axis=(1, 2)) / np.maximum(2 * count - 4, 1)
        lever = np.where(moves, ahead_s**2 / spread, 0.0)
        turned = np.where(moves, 0.5 * _TURN_MPS2 * (latest_s.mean(axis=1) - earlier_s[:, -1]) * ahead_s, 0.0)
        std = np.sqrt(np.maximum(variance, _LEAST_STD_M**2) * (1 / LATEST + 1 / count + lever) + turned**2)
        vector = np.where(says[:, None, None], self.places[:, -LATEST:], 0.0).mean(axis=1)
        vector = np.where(says[:, None], vector - mean - velocity * ahead_s[:, None], 0.0)
        return np.where(says, np.hypot(*vector.T) / std, np.nan), vector
