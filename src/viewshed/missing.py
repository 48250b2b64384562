"""Beams without a return: which ones a sweep lacks, where they aimed, and how far their neighbors went."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.beams import recover_beams
from viewshed.level import LevelSweep
from viewshed.visible import Beams

FILL_COLUMNS = 16
"""A gap is filled from returns in the same ring at most this many columns away."""

JITTER_COLUMNS = 4
"""A point may lie this many columns from the firing that it belongs to."""


def missing_beams(level: LevelSweep, *, fill: bool) -> Beams:
    """Return the beams that did not return, in the ``level`` frame.

    A pixel (ring, column) without a point is a missing beam, unless one within four columns of its ring holds two:
    then the azimuth only jittered. Without ``fill`` the depth is +inf; with it, that of the nearer of the two
    neighbors in the ring within 16 columns, and beams without such neighbors are left out.
    """
    beams = recover_beams(level.sweep)
    column, middle = _aligned_columns(level.sweep.points, beams.columns)
    sensor_range = np.linalg.norm(level.sweep.points, axis=1).astype(np.float32)
    depth = np.full((len(beams.elevation), beams.columns), np.inf, np.float32)
    counts = np.zeros(depth.shape, np.int32)
    _fill_pixels(beams.ring, column, sensor_range, depth, counts)
    rows, columns, ranges = _missing(counts, depth, FILL_COLUMNS if fill else 0)
    azimuth = (columns + middle) * (2 * np.pi / beams.columns) - np.pi
    elevation = beams.elevation[rows]
    directions = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )
    x, y, z = (directions @ level.level_from_sensor.rotation.T).T
    flat = np.maximum(np.hypot(x, y), 1e-6)
    depth_m = np.where(np.isfinite(ranges), ranges * flat, np.inf)
    return Beams(np.arctan2(y, x).astype(np.float32), (z / flat).astype(np.float32), depth_m.astype(np.float32))


def _aligned_columns(points: NDArray[np.float32], columns: int) -> tuple[NDArray[np.int64], float]:
    """Return each point's column (N,) and where in a column firings lie: at its middle, not at its edge.

    The circular mean of the azimuths' remainders tells the sensor's phase, so that a firing just at an edge does not
    fall into either column by chance.
    """
    position = (np.arctan2(points[:, 1], points[:, 0]).astype(np.float64) / (2 * np.pi) + 0.5) * columns
    phase = float(np.angle(np.exp(2j * np.pi * position).sum()) / (2 * np.pi)) if len(points) else 0.5
    phase = round(phase, 6)  # the rest depends on the order of the points
    return np.floor(position - phase + 0.5).astype(np.int64) % columns, phase


@njit(cache=True, nogil=True)
def _fill_pixels(ring: Any, column: Any, range_m: Any, depth: Any, counts: Any) -> None:  # pragma: no cover
    for n in range(ring.shape[0]):
        if ring[n] >= 0:
            r, c = ring[n], column[n]
            counts[r, c] += 1
            depth[r, c] = min(depth[r, c], range_m[n])


@njit(cache=True, nogil=True)
def _missing(counts: Any, depth: Any, reach: int) -> Any:  # pragma: no cover - compiled
    rings = counts.shape[0]
    rows, cols = np.empty(counts.size, np.int64), np.empty(counts.size, np.int64)
    ranges = np.empty(counts.size, np.float32)
    found = 0
    for r in range(rings):
        empty = _empty_columns(counts[r])
        for c in empty:
            nearest = min(_nearest(depth[r], c, -1, reach), _nearest(depth[r], c, 1, reach))
            if reach == 0 or nearest < np.inf:
                rows[found], cols[found], ranges[found] = r, c, nearest
                found += 1
    return rows[:found], cols[:found], ranges[:found]


@njit(cache=True, nogil=True)
def _empty_columns(counts: Any) -> Any:  # pragma: no cover - compiled
    """Columns of one ring without a point, less one for each double within ``JITTER_COLUMNS`` before or after it."""
    columns = counts.shape[0]
    empty = np.empty(columns, np.int64)
    found, spare, spare_at = 0, 0, -columns
    for c in range(columns):
        if c - spare_at > JITTER_COLUMNS:
            spare = 0
        for _ in range(counts[c] - 1):
            if found > 0 and c - empty[found - 1] <= JITTER_COLUMNS:
                found -= 1
            else:
                spare, spare_at = spare + 1, c
        if counts[c] == 0 and spare > 0:
            spare -= 1
        elif counts[c] == 0:
            empty[found] = c
            found += 1
    return empty[:found]


@njit(cache=True, nogil=True)
def _nearest(depth: Any, c: int, side: int, reach: int) -> Any:  # pragma: no cover - compiled
    """Depth of the first return from column ``c`` to one side, within ``reach`` columns; inf where there is none."""
    for step in range(1, reach + 1):
        d = depth[(c + side * step) % depth.shape[0]]
        if d < np.inf:
            return d
    return np.float32(np.inf)
