"""Loops of :mod:`viewshed.labels.image`: points to pixels of the firing pattern, and rays of pixels without a point."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.angles import atan2

JITTER_COLUMNS = 4
"""A point may lie this many columns from the firing that it belongs to."""


@njit(cache=True, nogil=True, error_model="numpy")
def fired(points: Any, ring: Any, seconds: Any, pose: Any, tables: Any) -> Any:  # pragma: no cover - compiled
    """Return starts (N, 3), unit directions (N, 3) in level axes, lengths (N,) and firing azimuths (N,).

    ``pose`` is level_from_sensor (3, 3), velocity (3,) and yaw rate; ``tables`` are the height of each ring's start
    and its azimuth offset.
    """
    turn, velocity, yaw_rate = pose
    rise, offset = tables
    count = points.shape[0]
    start, way = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    length, azimuth = np.empty(count, np.float32), np.empty(count, np.float32)
    for n in range(count):
        t = seconds[n]
        c, s = np.cos(yaw_rate * t), np.sin(yaw_rate * t)
        h = rise[max(ring[n], 0)]
        ox, oy, oz = turn[0, 2] * h, turn[1, 2] * h, turn[2, 2] * h
        ox, oy = c * ox - s * oy + velocity[0] * t, s * ox + c * oy + velocity[1] * t
        oz += velocity[2] * t
        p = points[n]
        dx = turn[0, 0] * p[0] + turn[0, 1] * p[1] + turn[0, 2] * p[2] - ox
        dy = turn[1, 0] * p[0] + turn[1, 1] * p[1] + turn[1, 2] * p[2] - oy
        dz = turn[2, 0] * p[0] + turn[2, 1] * p[1] + turn[2, 2] * p[2] - oz
        far = max(np.sqrt(dx * dx + dy * dy + dz * dz), np.float32(1e-3))
        start[n, 0], start[n, 1], start[n, 2] = ox, oy, oz
        way[n, 0], way[n, 1], way[n, 2], length[n] = dx / far, dy / far, dz / far, far
        bx, by = c * dx + s * dy, c * dy - s * dx
        x = turn[0, 0] * bx + turn[1, 0] * by + turn[2, 0] * dz
        y = turn[0, 1] * bx + turn[1, 1] * by + turn[2, 1] * dz
        azimuth[n] = atan2(np.float32(y), np.float32(x)) - offset[max(ring[n], 0)]
    return start, way, length, azimuth


@njit(cache=True, nogil=True, error_model="numpy")
def settle(ring: Any, column: Any, length: Any, pixels: Any) -> Any:  # pragma: no cover - compiled
    """Give each point a pixel of ``pixels`` (C, R): the nearer of two keeps it, the other moves to an empty one nearby.

    Returns how many points found none.
    """
    spare, spares, lost = np.empty(ring.shape[0], np.int64), 0, 0
    for n in range(ring.shape[0]):
        if ring[n] < 0:
            continue
        other = pixels[column[n], ring[n]]
        nearer = other < 0 or length[n] < length[other]
        if other >= 0:
            spare[spares] = other if nearer else n
            spares += 1
        if nearer:
            pixels[column[n], ring[n]] = n
    for k in range(spares):
        lost += not _moved(spare[k], column[spare[k]], ring[spare[k]], pixels)
    return lost


@njit(cache=True, nogil=True, error_model="numpy")
def _moved(n: Any, column: Any, ring: Any, pixels: Any) -> bool:  # pragma: no cover - compiled
    for step in range(1, JITTER_COLUMNS + 1):
        for side in (-1, 1):
            c = (column + side * step) % pixels.shape[0]
            if pixels[c, ring] < 0:
                pixels[c, ring] = n
                return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def mean_times(column: Any, seconds: Any, columns: Any) -> Any:  # pragma: no cover - compiled
    """Return the mean time (columns,) of each column's points; a column without any takes that of the one before."""
    total, count = np.zeros(columns, np.float64), np.zeros(columns, np.int64)
    for n in range(column.shape[0]):
        total[column[n]] += seconds[n]
        count[column[n]] += 1
    out = np.zeros(columns, np.float32)
    for step in range(2 * columns):
        c = step % columns
        if count[c] > 0:
            out[c] = total[c] / count[c]
        else:
            out[c] = out[c - 1]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def fill_image(pixels: Any, beams: Any, nominal: Any, pose: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Fill starts, directions (C, R, 3) and depths (C, R) from the points and, where there is none, the pattern.

    ``nominal`` are azimuth of column 0, step, time of each column, and elevation, start height and azimuth offset of
    each ring. A missing beam has depth 0.
    """
    start, way, length = beams
    first, step, seconds, elevation, rise, offset = nominal
    turn, velocity, yaw_rate = pose
    origins, directions, depth = out
    for c in range(pixels.shape[0]):
        t = seconds[c]
        cos, sin = np.cos(yaw_rate * t), np.sin(yaw_rate * t)
        for r in range(pixels.shape[1]):
            n = pixels[c, r]
            if n >= 0:
                for axis in range(3):
                    origins[c, r, axis], directions[c, r, axis] = start[n, axis], way[n, axis]
                depth[c, r] = length[n]
                continue
            azimuth = first + c * step + offset[r]
            flat, z = np.cos(elevation[r]), np.sin(elevation[r])
            x, y, h = flat * np.cos(azimuth), flat * np.sin(azimuth), rise[r]
            dx = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z
            dy = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z
            dz = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z
            ox, oy = turn[0, 2] * h, turn[1, 2] * h
            directions[c, r, 0], directions[c, r, 1], directions[c, r, 2] = cos * dx - sin * dy, sin * dx + cos * dy, dz
            origins[c, r, 0] = cos * ox - sin * oy + velocity[0] * t
            origins[c, r, 1] = sin * ox + cos * oy + velocity[1] * t
            origins[c, r, 2] = turn[2, 2] * h + velocity[2] * t
            depth[c, r] = np.float32(0.0)
