"""Where the surface of a track came from: only what is made in the sweep appears where beams passed just before.

What a detector missed at first stood there all the same and stopped beams; what comes out of a shadow was hidden. A
surface is followed back from sweep to sweep, whenever it was first detected.
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
"""Numbers of detections at which a track is followed back: then its velocity is known."""

_KEPT_S, _EVERY_S = 4.0, 0.25
"""Cells are kept for so long, at least so far apart in time."""

_MARGIN_M = 0.5
"""Boxes are taken larger on each side: they did not stand exactly where they are led back to."""

_SURFACE_WEIGHT = 5.0
"""A surface denies that a place was free: most of a car's box is free or hidden, and only its near side a surface."""

_LEAST_SURFACE, _LEFT_SURFACE = 0.03, 0.3
"""Only boxes with such a share of surface are followed, until less than this part of the latest is left twice."""

_LEAST_M = 3.0
"""Shorter boxes are not followed: the surface of a person is lost now and then."""

_FASTEST_STD_MPS = 3.0
"""Tracks whose velocity is known worse are not followed."""


class SeenBefore:
    """Keeps the cells of the last sweeps, and follows tracks back through them."""

    def __init__(self) -> None:
        """Begin without a past."""
        self._past: deque[tuple[float, SeenCells]] = deque()

    def add(self, t_s: float, cells: SeenCells | None) -> None:
        """Keep the cells of a sweep at ``t_s``, if it has any and none was kept just before."""
        while self._past and self._past[0][0] < t_s - _KEPT_S:
            self._past.popleft()
        if cells is not None and (not self._past or t_s - self._past[-1][0] > _EVERY_S):
            self._past.append((t_s, cells))

    def free_shares(self, tracks: Tracks, surface: F64, followed: NDArray[np.bool_]) -> F64:
        """Return which share (N,) of the place where the surface of each followed track came from was seen free.

        Less than none where the oldest sweep still has its surface. NaN where nothing is known: the track is not
        followed or without poses, its velocity is not known, or there is hardly a surface to be followed.

        Args:
            tracks: of this sweep.
            surface: (N,) of :func:`surface_shares` now.
            followed: (N,) which tracks are followed.
        """
        shares = np.full(len(tracks), np.nan)
        variance = np.maximum(tracks.covariances[:, 2, 2], tracks.covariances[:, 3, 3])
        known = (variance <= _FASTEST_STD_MPS**2) & (surface >= _LEAST_SURFACE)
        known &= tracks.boxes[:, 3:5].max(axis=1, initial=0.0) >= _LEAST_M
        left, boxes, t_s = np.flatnonzero(followed & known & tracks.in_world), tracks.boxes.copy(), tracks.t_s
        latest, was_lost = surface.copy(), np.zeros(len(tracks), np.bool_)
        for before_s, cells in reversed(self._past):
            if not len(left):
                break
            # One kept sweep back, and to the surface that is there; twice none, and it came from nowhere, or unseen.
            boxes[left, :2] -= (t_s - before_s) * tracks.states[left, 2:]
            boxes[left, :2] += cells.shifts(boxes[left])
            share = surface_shares(cells, boxes[left])
            free = _shares(cells, boxes[left], CellState.FREE) - _SURFACE_WEIGHT * share
            shares[left] = np.where(was_lost[left], np.minimum(shares[left], free), free)
            is_lost = share < _LEFT_SURFACE * latest[left]
            ends, was_lost[left] = is_lost & was_lost[left], is_lost
            latest[left] = np.where(is_lost, latest[left], 0.5 * (latest[left] + share))
            left, t_s = left[~ends], before_s
        # Nothing follows from the oldest sweep alone, nor from a surface that faded away, as what came from afar does.
        shares[left[was_lost[left]]] = np.nan
        return np.where(latest >= _LEAST_SURFACE, shares, np.nan)


def surface_shares(cells: SeenCells | None, boxes: F64) -> F64:
    """Return which share (K,) of boxes (K, 7), taken larger, are surfaces; 0 without cells."""
    return np.zeros(len(boxes)) if cells is None else _shares(cells, boxes, CellState.SURFACE)


def _shares(cells: SeenCells, boxes: F64, state: CellState) -> F64:
    states = cells.states_at(footprint_points(boxes, FINE, _MARGIN_M))
    return np.asarray((states == state).mean(axis=1))
