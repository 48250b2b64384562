"""Tracks explained: why each is detected or not, what speaks against it, and what is left of them after fusion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.objects.tracks import Tracks

_PUT_BACK_M = 2.0
"""A false jump is known no better than this."""

_GROWTH_MPS = 0.3
"""How fast the place of a removed object becomes unsure."""


class Explanation(IntEnum):
    """Why a track is detected or not; from ``MISSING`` on it is suspicious."""

    SEEN = 0
    """Detected, as it should be."""
    MISSED = 1
    """Not detected though it could be; so far as rarely as detectors miss."""
    HIDDEN = 2
    """Not detected: something nearer blocks the view of it."""
    OUT_OF_VIEW = 3
    """Not detected: no beams go there."""
    TOO_FEW_RETURNS = 4
    """Not detected: in view, but the detector rarely finds so few returns."""
    ABSTAINED = 5
    """The field of view itself is under alarm there: nothing is claimed."""
    MISSING = 6
    """Not detected though it is visible, again and again: its detections are removed."""
    NEW_IN_FREE = 7
    """Its surface appeared where beams had passed before: fabricated."""
    SEEN_THROUGH = 8
    """Beams pass through its box: fabricated."""
    NOT_VISIBLE = 9
    """Detected where nothing can be seen: fabricated."""
    TOO_FAST = 10
    """It jumped faster than physics: moved."""


FABRICATED, REMOVED, MOVED = range(3)
"""What a track may be suspected of: columns of ``wealth``."""


@dataclass(frozen=True, slots=True, eq=False)
class ExplainedTracks:
    """Tracks with what speaks for and against each."""

    tracks: Tracks  # those of the tracker, then those that it gave up and that are still remembered
    explanations: NDArray[np.uint8]  # (N,) uint8 of :class:`Explanation`
    e_values: F64  # (N,) how much speaks against *honest*, the mean of the three suspicions
    wealth: F64  # (N, 3) the e-value of each suspicion: ``FABRICATED``, ``REMOVED``, ``MOVED``
    suspicions: NDArray[np.uint8]  # (N,) uint8, the one that is nearest to its limit or farthest above
    accused: Mask  # (N,) bool, one of them has reached its limit
    moved_m: F64  # (N, 2) by which a moved track jumped; 0 for all others
    held: Mask  # (N,) bool, the tracker has given it up: carried over from earlier sweeps
    reasons: tuple[str, ...]  # (N,) a sentence each
    notes: tuple[str, ...] = ()  # what could not be checked in this sweep, and why, in sentences

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.tracks)

    def trusted(self) -> Tracks:
        """Return the confirmed tracks after fusion.

        Fabricated ones are dropped. Removed ones stay, also where the tracker has given them up, with a covariance
        that has grown since they were last detected. Moved ones are put back where they came from if they jumped by two
        meters or more; of a smaller jump only the covariance grows.
        """
        tracks, kind = self.tracks, self.suspicions
        removed = self.accused & (kind == REMOVED)
        kept = tracks.confirmed & ~(self.accused & (kind == FABRICATED)) & (~self.held | removed)
        states, boxes, covariances = tracks.states.copy(), tracks.boxes.copy(), tracks.covariances.copy()
        far = np.hypot(*self.moved_m.T) >= _PUT_BACK_M
        back = np.where(far[:, None], self.moved_m, 0.0)
        states[:, :2] -= back
        boxes[:, :2] -= back
        unseen_s = np.where(removed, tracks.t_s - tracks.seen_s, 0.0)
        covariances[:, [0, 1], [0, 1]] += (_GROWTH_MPS * unseen_s[:, None]) ** 2 + self.moved_m**2
        odds = self.wealth[:, REMOVED]
        existence = np.where(removed, np.maximum(tracks.existence, odds / (1.0 + odds)), tracks.existence)
        whole = replace(tracks, states=states, boxes=boxes, covariances=covariances, existence=existence)
        return whole.take(kept)
