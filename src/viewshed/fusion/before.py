"""Where a track was before its first detection: only what is made in the sweep appears where beams passed just before.

An object that the detector missed at first stood there all the same and stopped beams; one that comes out of a shadow
was hidden. Its velocity leads back to where it was.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import CellState
from viewshed.fusion.cells import FINE, SeenCells, footprint_points
from viewshed.tracking.tracks import Tracks

Floats = NDArray[np.float64]

BEFORE_S = (0.3, 0.6, 0.9)
"""So long before its first detection the place of a track is looked at, ..."""

YOUNG_S = 2.0
"""... until so long after it: the velocity is known better and better."""

_EVERY_S, _NEAR_S = 0.25, 0.15
"""Cells are kept at least so far apart in time, and are of another time if it is farther off."""

_SURFACE_WEIGHT = 5.0
"""A surface denies that a place was free: most of a car's box is free or hidden, and only its near side a surface."""

_MARGIN_M = 0.5
"""Boxes are taken larger on each side: they did not stand exactly where they are led back to."""


class SeenBefore:
    """Keeps the cells of the last sweeps, and looks at where young tracks were in them."""

    def __init__(self) -> None:
        """Begin without a past."""
        self._past: deque[tuple[float, SeenCells]] = deque()

    def add(self, t_s: float, cells: SeenCells | None) -> None:
        """Keep the cells of a sweep at ``t_s``, if it has any and none was kept just before."""
        while self._past and self._past[0][0] < t_s - YOUNG_S - BEFORE_S[-1] - _NEAR_S:
            self._past.popleft()
        if cells is not None and (not self._past or t_s - self._past[-1][0] > _EVERY_S):
            self._past.append((t_s, cells))

    def free_shares(self, tracks: Tracks) -> Floats:
        """Return which share (N,) of each young track's place was seen free before its first detection.

        Less than none where it had surfaces; the median over the times :data:`BEFORE_S`. NaN where nothing can be
        said: the track is old or without poses, no sweep was, or its place is known worse than by half of its width.
        """
        shares = np.full((len(BEFORE_S), len(tracks)), np.nan)
        young = np.flatnonzero(tracks.t_s - tracks.born_s <= YOUNG_S)
        if not (tracks.in_world and len(young) and self._past):
            return shares[0]
        times = np.array([t_s for t_s, _ in self._past])
        for row, before_s in zip(shares, BEFORE_S, strict=True):
            wanted_s = tracks.born_s[young] - before_s
            kept = np.abs(times[:, None] - wanted_s).argmin(axis=0)
            for k in np.unique(kept):
                rows = young[(kept == k) & (np.abs(times[k] - wanted_s) <= _NEAR_S)]
                boxes, std_m = _led_back(tracks, rows, tracks.t_s - times[k])
                known = std_m <= 0.5 * boxes[:, 3:5].min(axis=1, initial=np.inf)
                states = self._past[k][1].states_at(footprint_points(boxes[known], FINE, _MARGIN_M))
                is_free, is_surface = states == CellState.FREE, states == CellState.SURFACE
                row[rows[known]] = is_free.mean(axis=1) - _SURFACE_WEIGHT * is_surface.mean(axis=1)
        said = ~np.isnan(shares).all(axis=0)
        return np.where(said, np.nanmedian(np.where(said, shares, 0.0), axis=0), np.nan)


def _led_back(tracks: Tracks, rows: NDArray[np.intp], ago_s: float) -> tuple[Floats, Floats]:
    """Return the boxes (R, 7) of tracks ``ago_s`` seconds ago, and the standard deviations (R,) of their places."""
    boxes, covariances = tracks.boxes[rows].copy(), tracks.covariances[rows]
    boxes[:, :2] -= ago_s * tracks.states[rows, 2:]
    own, mixed = np.diagonal(covariances, 0, 1, 2), np.diagonal(covariances, 2, 1, 2)
    variance = own[:, :2] - 2.0 * ago_s * mixed + ago_s**2 * own[:, 2:]
    return boxes, np.sqrt(np.maximum(variance, 0.0).max(axis=1, initial=0.0))
