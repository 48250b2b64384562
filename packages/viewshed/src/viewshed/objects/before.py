"""Origin of a track's surface: only a surface made in the sweep appears where beams passed just before.

A real object that the detector missed at first still stood there and stopped beams; one that leaves a shadow was
hidden. So the surface of a track is followed back from sweep to sweep, past its first detection.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.fov.estimate import CellState
from viewshed.objects.cells import FINE, SeenCells, footprint_points
from viewshed.objects.tracks import Tracks

FOLLOWED_AFTER = (5, 10)
"""Numbers of detections at which a track is followed back; by then its velocity is known."""

_KEPT_S, _EVERY_S = 4.0, 0.25
"""Age up to which cells are kept, and minimum time between kept sweeps."""

_MARGIN_M = 0.5
"""Margin of boxes on each side, because their earlier positions are extrapolated."""

_SURFACE_WEIGHT = 5.0
"""Weight of surface against free cells: most of a car's box is free or hidden, only its near side is a surface."""

_MIN_SURFACE, _LOST_SHARE = 0.03, 0.3
"""Minimum surface share of a followed box, and part of the last share below which, twice in a row, it is lost."""

_MIN_LENGTH_M = 3.0
"""Minimum length of a followed box: the surface of a person is lost at times."""

_MAX_VELOCITY_STD_MPS = 3.0
"""Maximum standard deviation of the velocity of a followed track."""


class SeenBefore:
    """Keeps the cells of recent sweeps, and follows tracks back through them."""

    def __init__(self) -> None:
        """Start without a past."""
        self._past: deque[tuple[float, SeenCells]] = deque()

    def add(self, t_s: float, cells: SeenCells | None) -> None:
        """Keep the cells of a sweep at ``t_s``, if it has any and none were kept just before."""
        while self._past and self._past[0][0] < t_s - _KEPT_S:
            self._past.popleft()
        if cells is not None and (not self._past or t_s - self._past[-1][0] > _EVERY_S):
            self._past.append((t_s, cells))

    def free_shares(self, tracks: Tracks, surface: F64, followed: NDArray[np.bool_]) -> F64:
        """Return the free share (N,) of the place that the surface of each followed track came from.

        It is negative where the oldest sweep still has the surface. It is NaN if unknown: the track is not followed or
        without poses, its velocity is not known, or it hardly has a surface.

        Args:
            tracks: of this sweep.
            surface: (N,) of :func:`surface_shares` now.
            followed: (N,) bool, which tracks to follow.
        """
        shares = np.full(len(tracks), np.nan)
        variance = np.maximum(tracks.covariances[:, 2, 2], tracks.covariances[:, 3, 3])
        can_follow = (variance <= _MAX_VELOCITY_STD_MPS**2) & (surface >= _MIN_SURFACE)
        can_follow &= tracks.boxes[:, 3:5].max(axis=1, initial=0.0) >= _MIN_LENGTH_M
        pursued, boxes, t_s = np.flatnonzero(followed & can_follow & tracks.in_world), tracks.boxes.copy(), tracks.t_s
        last_share, was_lost = surface.copy(), np.zeros(len(tracks), np.bool_)
        for past_s, cells in reversed(self._past):
            if not len(pursued):
                break
            # Go back one kept sweep, and to the nearest surface there; after two without a surface, stop.
            boxes[pursued, :2] -= (t_s - past_s) * tracks.states[pursued, 2:]
            boxes[pursued, :2] += cells.shifts(boxes[pursued])
            share = surface_shares(cells, boxes[pursued])
            free = _shares(cells, boxes[pursued], CellState.FREE) - _SURFACE_WEIGHT * share
            shares[pursued] = np.where(was_lost[pursued], np.minimum(shares[pursued], free), free)
            is_lost = share < _LOST_SHARE * last_share[pursued]
            ends, was_lost[pursued] = is_lost & was_lost[pursued], is_lost
            last_share[pursued] = np.where(is_lost, last_share[pursued], 0.5 * (last_share[pursued] + share))
            pursued, t_s = pursued[~ends], past_s
        # Unknown if lost in the oldest sweep only, or if the surface faded away, as that of far objects does.
        shares[pursued[was_lost[pursued]]] = np.nan
        return np.where(last_share >= _MIN_SURFACE, shares, np.nan)


def surface_shares(cells: SeenCells | None, boxes: F64) -> F64:
    """Return the share (K,) of surface in boxes (K, 7) with a margin; 0 without cells."""
    return np.zeros(len(boxes)) if cells is None else _shares(cells, boxes, CellState.SURFACE)


def _shares(cells: SeenCells, boxes: F64, state: CellState) -> F64:
    states = cells.states_at(footprint_points(boxes, FINE, _MARGIN_M))
    return np.asarray((states == state).mean(axis=1))
