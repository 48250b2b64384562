"""Metrics of tracks against true objects: OSPA, GOSPA, matching and id switches.

:mod:`viewshed.metrics` compares cells; this compares points. Distances are between centers, by x and y in meters.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.objects.association import assignment_solver

Points = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class Gospa:
    """Generalized OSPA with α = 2 (Rahmathullah, García-Fernández and Svensson, 2017), and its components.

    Components are costs, in meters to the power p: the distance is the p-th root of their sum.

    >>> Gospa(localization=1.0, missed=8.0, false=0.0, order=2.0).distance_m
    3.0
    """

    localization: float  # of the pairs nearer than the cutoff
    missed: float  # half the cutoff to the power p for each object without a track
    false: float  # the same for each track without an object
    order: float  # p

    @property
    def distance_m(self) -> float:
        """Distance in meters."""
        return float((self.localization + self.missed + self.false) ** (1.0 / self.order))


def gospa(tracks: Points, truths: Points, *, cutoff_m: float = 4.0, order: float = 2.0) -> Gospa:
    """Return GOSPA of tracks (N, 2+) against truths (M, 2+).

    Args:
        tracks: positions of the tracks; x and y are used.
        truths: positions of the objects.
        cutoff_m: distance from which a track does not match an object.
        order: exponent p; a larger one penalizes large distances more.

    Raises:
        ValueError: a number is not finite, or the cutoff or the order is out of range.
        ImportError: scipy is not installed.
    """
    distance_m = _distances(tracks, truths, cutoff_m, order)
    costs = np.minimum(distance_m, cutoff_m) ** order
    rows, columns = assignment_solver()(costs)
    is_pair = distance_m[rows, columns] < cutoff_m
    pairs, unmatched_cost = int(is_pair.sum()), cutoff_m**order / 2.0
    localization = float(costs[rows, columns][is_pair].sum())
    return Gospa(localization, unmatched_cost * (len(truths) - pairs), unmatched_cost * (len(tracks) - pairs), order)


def ospa_m(tracks: Points, truths: Points, *, cutoff_m: float = 1.0, order: float = 1.0) -> float:
    """Return OSPA in meters (Schuhmacher, Vo and Vo, 2008) of tracks (N, 2+) against truths (M, 2+).

    The mean distance over as many pairs as the larger set has points; points without a partner cost ``cutoff_m``.

    >>> ospa_m(np.array([[0.0, 0.2], [9.0, 9.0]]), np.array([[0.0, 0.0]]))
    0.6
    """
    costs = np.minimum(_distances(tracks, truths, cutoff_m, order), cutoff_m) ** order
    max_count = max(costs.shape)
    if max_count == 0:
        return 0.0
    total = costs[assignment_solver()(costs)].sum() + cutoff_m**order * (max_count - min(costs.shape))
    return float((total / max_count) ** (1.0 / order))


@dataclass(frozen=True, slots=True)
class MatchedObjects:
    """Tracks and truths of one time, matched within a distance at the minimum sum of distances."""

    track_ids: NDArray[np.int64]  # (N,) int64 of all tracks
    truth_ids: NDArray[np.int64]  # (M,) int64 of all truths
    truth_of_track: NDArray[np.int64]  # (N,) int index of each track's truth, -1 for none


def match_objects(
    tracks: Points, track_ids: NDArray[np.int64], truths: Points, truth_ids: NDArray[np.int64], within_m: float = 2.0
) -> MatchedObjects:
    """Return the matches of tracks (N, 2+) and truths (M, 2+) at most ``within_m`` apart, as many as possible."""
    distance_m = _distances(tracks, truths, within_m, 1.0)
    # Maximize the number of pairs first, then minimize the sum of distances.
    rows, columns = assignment_solver()(
        np.where(distance_m <= within_m, distance_m - within_m * (1 + max(distance_m.shape, default=0)), 0.0)
    )
    truth_of_track = np.full(len(track_ids), -1, np.int64)
    is_pair = distance_m[rows, columns] <= within_m
    truth_of_track[rows[is_pair]] = columns[is_pair]
    return MatchedObjects(np.asarray(track_ids, np.int64), np.asarray(truth_ids, np.int64), truth_of_track)


@dataclass(slots=True)
class IdSwitches:
    """Counts how often an object changes its track, over the times of a recording in order.

    An object that is lost and found again by a new track counts: that is the switch that a lost car causes.
    """

    count: int = 0  # number of switches so far
    _last: dict[int, int] = field(default_factory=dict, repr=False)

    def add(self, *times: MatchedObjects) -> int:
        """Add the next times and return the count."""
        for now in times:
            for track_id, truth in zip(now.track_ids.tolist(), now.truth_of_track.tolist(), strict=True):
                if truth >= 0:
                    object_id = int(now.truth_ids[truth])
                    self.count += self._last.get(object_id, track_id) != track_id
                    self._last[object_id] = track_id
        return self.count


def _distances(tracks: Points, truths: Points, cutoff_m: float, order: float) -> F64:
    """Return the distances (N, M) of points by x and y; raise ValueError if they are invalid."""
    if not 0.0 < cutoff_m < np.inf:
        raise ValueError(f"cutoff_m must be positive and finite, got {cutoff_m}")
    if not 1.0 <= order < np.inf:
        raise ValueError(f"order must be at least 1 and finite, got {order}")
    first, second = (np.asarray(points, np.float64)[..., :2] for points in (tracks, truths))
    if first.ndim != 2 or second.ndim != 2:
        raise ValueError(f"points must have shape (N, 2) or more columns, got {first.shape} and {second.shape}")
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        raise ValueError("points must be finite; leave out those that are not")
    if not len(first) or not len(second):
        return np.zeros((len(first), len(second)))
    return np.asarray(np.linalg.norm(first[:, None] - second[None], axis=-1))
