"""Beams without a return: which ones a sweep lacks, where they aimed, and how far their neighbors went."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.beams import recover_beams
from viewshed.level import LevelSweep
from viewshed.visible import Beams

FILL_COLUMNS = 16
"""A gap is filled from returns in the same ring at most this many columns away."""


def missing_beams(level: LevelSweep, *, fill: bool) -> Beams:
    """Return the beams that did not return, in the ``level`` frame.

    A pixel (ring, column) without a point is a missing beam, unless a pixel beside it holds two: then the azimuth
    only jittered. Without ``fill`` the depth is +inf; with it, that of the nearer of the two neighbors in the ring
    within 16 columns, and beams without such neighbors are left out.
    """
    beams = recover_beams(level.sweep)
    sensor_range = np.linalg.norm(level.sweep.points, axis=1).astype(np.float32)
    depth = np.full((len(beams.elevation), beams.columns), np.inf, np.float32)
    counts = np.zeros(depth.shape, np.int32)
    _fill_pixels(beams.ring, beams.column, sensor_range, depth, counts)
    rows, columns, ranges = _missing(counts, depth, FILL_COLUMNS if fill else 0)
    azimuth = (columns + 0.5) * (2 * np.pi / beams.columns) - np.pi
    elevation = beams.elevation[rows]
    directions = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )
    x, y, z = (directions @ level.level_from_sensor.rotation.T).T
    flat = np.maximum(np.hypot(x, y), 1e-6)
    depth_m = np.where(np.isfinite(ranges), ranges * flat, np.inf)
    return Beams(np.arctan2(y, x).astype(np.float32), (z / flat).astype(np.float32), depth_m.astype(np.float32))


@njit(cache=True, nogil=True)
def _fill_pixels(ring: Any, column: Any, range_m: Any, depth: Any, counts: Any) -> None:  # pragma: no cover
    for n in range(ring.shape[0]):
        if ring[n] >= 0:
            r, c = ring[n], column[n]
            counts[r, c] += 1
            depth[r, c] = min(depth[r, c], range_m[n])


@njit(cache=True, nogil=True)
def _missing(counts: Any, depth: Any, reach: int) -> Any:  # pragma: no cover - compiled
    rings, columns = counts.shape
    rows, cols = np.empty(counts.size, np.int64), np.empty(counts.size, np.int64)
    ranges = np.empty(counts.size, np.float32)
    found = 0
    for r in range(rings):
        for c in range(columns):
            before, after = (c - 1) % columns, (c + 1) % columns
            if counts[r, c] > 0:
                continue
            if counts[r, before] > 1:
                counts[r, before] -= 1
                continue
            if counts[r, after] > 1:
                counts[r, after] -= 1
                continue
            nearest = min(_nearest(depth[r], c, -1, reach), _nearest(depth[r], c, 1, reach))
            if reach == 0 or nearest < np.inf:
                rows[found], cols[found], ranges[found] = r, c, nearest
                found += 1
    return rows[:found], cols[:found], ranges[:found]


@njit(cache=True, nogil=True)
def _nearest(depth: Any, c: int, side: int, reach: int) -> Any:  # pragma: no cover - compiled
    """Depth of the first return from column ``c`` to one side, within ``reach`` columns; inf where there is none."""
    for step in range(1, reach + 1):
        d = depth[(c + side * step) % depth.shape[0]]
        if d < np.inf:
            return d
    return np.float32(np.inf)
