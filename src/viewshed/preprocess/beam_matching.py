"""Returns and beams: azimuth, slope and range of points, and how well the beams of a table explain them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed._numba import atan2
from viewshed.sensors import LidarModel

Angles = NDArray[np.float32]

EXPLAINED = 0.3
"""Least ``excess`` of a match from which a beam table is believed to explain a cloud."""

NEAR_M = 1.0
"""Returns nearer than this do not tell elevations."""


@njit(cache=True, nogil=True)
def polar(points: Any) -> Any:  # pragma: no cover - compiled
    """Return azimuth (N,) in [-π, π), slope z / range (N,) and horizontal range (N,) in meters; slope 0 at range 0."""
    count = points.shape[0]
    azimuth = np.empty(count, np.float32)
    slope = np.empty(count, np.float32)
    range_m = np.empty(count, np.float32)
    for n in range(count):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        r = np.sqrt(x * x + y * y)
        azimuth[n] = atan2(y, x)
        range_m[n] = r
        slope[n] = z / r if r > 0 else np.float32(0.0)
    return azimuth, slope, range_m


@njit(cache=True, nogil=True)
def nearest_beams(slope: Any, range_m: Any, beams: Any) -> Any:  # pragma: no cover - compiled
    """Return the nearest beam of each point (N,), -1 beyond 0.15° and 5 cm, and what shows how well they fit.

    ``beams`` (rings, 3): tangent of the elevation, height of the origin, a quarter of the gap to the next beam. Then
    follow, for points beyond 1 m: those close to each beam (rings,), their number, and how many would be close by
    chance. Close is within a quarter of the gap, and within 0.1° and 1.5 cm.
    """
    rings = beams.shape[0]
    ring = np.full(slope.shape[0], -1, np.int16)
    hits = np.zeros(rings, np.int64)
    tried, chance = 0, 0.0
    origin = beams[:, 1].mean()
    first = _first_guess(beams[:, 0])
    per_slope = len(first) / max(beams[-1, 0] - beams[0, 0], 1e-6)
    for n in range(slope.shape[0]):
        r, t = np.float64(range_m[n]), np.float64(slope[n])
        if r <= 0:
            continue
        per_m = 1.0 / r
        cell = (t - origin * per_m - beams[0, 0]) * per_slope
        best = first[int(min(max(cell, 0.0), len(first) - 1.0))]
        error = abs(beams[best, 0] + beams[best, 1] * per_m - t)
        for step in (-1, 1):
            while 0 <= best + step < rings:
                other = abs(beams[best + step, 0] + beams[best + step, 1] * per_m - t)
                if other >= error:
                    break
                best, error = best + step, other
        error /= 1.0 + t * t
        ring[n] = best if error < 0.0026 + 0.05 * per_m else -1
        if r > 1.0:
            tried += 1
            close = min(beams[best, 2], 0.00175 + 0.015 * per_m)
            chance += 0.5 * close / beams[best, 2]
            hits[best] += error <= close
    return ring, hits, tried, chance


@njit(cache=True, nogil=True)
def _first_guess(tangent: Any) -> Any:  # pragma: no cover - compiled
    """Return the beam nearest to each of 4096 equal cells of slope."""
    cells = np.empty(4096, np.int16)
    beam = 0
    for c in range(4096):
        t = tangent[0] + (tangent[-1] - tangent[0]) * (c + 0.5) / 4096
        while beam + 1 < len(tangent) and abs(tangent[beam + 1] - t) < abs(tangent[beam] - t):
            beam += 1
        cells[c] = beam
    return cells


class BeamMatch(NamedTuple):
    """How a beam table fits: nearest beam of each point, points close to each beam, their share less chance."""

    ring: NDArray[np.int16]
    hits: NDArray[np.int64]
    excess: float


def match_beams(slope: Angles, range_m: Angles, model: LidarModel) -> BeamMatch:
    """Return the nearest beam of each point (N,) and how well the table explains them."""
    return match_elevations(slope, range_m, model.elevation, model.origin_m)


def match_elevations(
    slope: Angles, range_m: Angles, elevation: NDArray[np.float64], origin_m: NDArray[np.float64]
) -> BeamMatch:
    """Return the nearest beam of each point and how much better than chance the returns gather at the beams.

    Close is within a quarter of the gap to the next beam, and within 0.1° and 1.5 cm; chance is the share of the gap
    that this covers.

    Args:
        slope: (N,) z over horizontal range.
        range_m: (N,) horizontal range in meters.
        elevation: (rings,) radians, ascending.
        origin_m: (rings,) height of each beam at range 0.
    """
    gap = np.diff(elevation, prepend=-np.pi, append=np.pi)
    gap = np.minimum(gap[:-1], gap[1:])
    ring, hits, tried, chance = nearest_beams(slope, range_m, np.stack([np.tan(elevation), origin_m, gap / 4], axis=1))
    if tried == 0 or chance >= tried:
        return BeamMatch(ring, hits, 0.0)
    return BeamMatch(ring, hits, max(0.0, (int(hits.sum()) - chance) / (tried - chance)))
