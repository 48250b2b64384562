"""Explained tracks: why each is detected or not, the evidence against it, and the tracks after fusion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.objects.tracks import Tracks

_PUT_BACK_M = 2.0
"""Minimum jump in meters that is undone; a false jump is not known better than this."""

_GROWTH_MPS = 0.3
"""Growth of the position's standard deviation of a removed object."""


class Explanation(IntEnum):
    """Why a track is detected or not; suspicious from ``MISSING`` on."""

    SEEN = 0
    """Detected, as expected."""
    MISSED = 1
    """Not detected though it could be; so far as rarely as detectors miss."""
    HIDDEN = 2
    """Not detected: something nearer blocks the view of it."""
    OUT_OF_VIEW = 3
    """Not detected: no beam goes there."""
    TOO_FEW_RETURNS = 4
    """Not detected: in view, but the detector rarely finds an object with so few returns."""
    ABSTAINED = 5
    """The field of view is under alarm there: the track is not judged."""
    MISSING = 6
    """Repeatedly not detected though visible: its detections are removed."""
    NEW_IN_FREE = 7
    """Its surface appeared where beams had passed before: fabricated."""
    SEEN_THROUGH = 8
    """Beams pass through its box: fabricated."""
    NOT_VISIBLE = 9
    """Detected where nothing can be seen: fabricated."""
    TOO_FAST = 10
    """It jumped faster than physics: moved."""


FABRICATED, REMOVED, MOVED = range(3)
"""Suspicions against a track: columns of ``wealth``."""


@dataclass(frozen=True, slots=True, eq=False)
class ExplainedTracks:
    """Tracks with an explanation and the evidence against each."""

    tracks: Tracks  # tracks of the tracker, then remembered ones that it has given up
    explanations: NDArray[np.uint8]  # (N,) uint8 of :class:`Explanation`
    e_values: F64  # (N,) evidence against *honest*, the mean over the three suspicions
    wealth: F64  # (N, 3) e-value of each suspicion: ``FABRICATED``, ``REMOVED``, ``MOVED``
    suspicions: NDArray[np.uint8]  # (N,) uint8, the suspicion with the highest e-value relative to its limit
    accused: Mask  # (N,) bool, at least one e-value has reached its limit
    moved_m: F64  # (N, 2) jump of a moved track; 0 for all others
    held: Mask  # (N,) bool, given up by the tracker and carried over from earlier sweeps
    reasons: tuple[str, ...]  # (N,) one sentence each
    notes: tuple[str, ...] = ()  # what could not be checked in this sweep, and why, one sentence each

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.tracks)

    def trusted(self) -> Tracks:
        """Return the confirmed tracks after fusion.

        Fabricated tracks are dropped. Removed tracks stay, even if the tracker has given them up; their covariance
        grows since the last detection. Moved tracks are put back if they jumped by at least two meters; for a smaller
        jump only the covariance grows.
        """
        tracks, kind = self.tracks, self.suspicions
        removed = self.accused & (kind == REMOVED)
        kept = tracks.confirmed & ~(self.accused & (kind == FABRICATED)) & (~self.held | removed)
        states, boxes, covariances = tracks.states.copy(), tracks.boxes.copy(), tracks.covariances.copy()
        is_undone = np.hypot(*self.moved_m.T) >= _PUT_BACK_M
        jump_m = np.where(is_undone[:, None], self.moved_m, 0.0)
        states[:, :2] -= jump_m
        boxes[:, :2] -= jump_m
        unseen_s = np.where(removed, tracks.t_s - tracks.seen_s, 0.0)
        covariances[:, [0, 1], [0, 1]] += (_GROWTH_MPS * unseen_s[:, None]) ** 2 + self.moved_m**2
        odds = self.wealth[:, REMOVED]
        existence = np.where(removed, np.maximum(tracks.existence, odds / (1.0 + odds)), tracks.existence)
        corrected = replace(tracks, states=states, boxes=boxes, covariances=covariances, existence=existence)
        return corrected.take(kept)
