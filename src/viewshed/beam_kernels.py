"""Compiled loops of :mod:`viewshed.beams`: polar coordinates, rings by file order or nearest beam, medians, pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.angles import atan2

_COARSE = 1024
_FINE = 512


@njit(cache=True, nogil=True)
def polar(points: Any) -> Any:  # pragma: no cover - compiled
    """Return azimuth (N,) in [-π, π), slope z / range (N,) and horizontal range (N,) in metres; slope 0 at range 0."""
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
def order_rings(azimuth: Any, slope: Any, start: float, turn: float) -> Any:  # pragma: no cover - compiled
    """Return rings (N,) counted from the wraps of the azimuth past ``start`` in the sense ``turn``.

    Also their number, the steps against that sense, and the share of wraps at which the slope rises. First and last
    rings of less than a hundredth of the others' size are joined to their neighbor. Stops early on a shuffled cloud.
    """
    count = azimuth.shape[0]
    ring = np.zeros(count, np.int16)
    backward, wraps, upward, first_end, last_start = 0, 0, 0, 0, 0
    before = 0.0
    for n in range(count):
        angle = (turn * (azimuth[n] - start)) % (2 * np.pi)
        step = angle - before
        if n > 0 and step < -np.pi:
            wraps += 1
            upward += slope[n] > slope[n - 1]
            first_end = n if wraps == 1 else first_end
            last_start = n
        elif n > 0 and step < -0.003:
            backward += 1
        if backward > 100 + 0.1 * n or wraps > 4096:
            return ring, 0, count, 0.5
        ring[n] = wraps
        before = angle
    share = upward / wraps if wraps else 0.5
    typical = count / (wraps + 1)
    if wraps and count - last_start < 0.01 * typical:
        ring[last_start:] = wraps - 1
        wraps -= 1
    if wraps and first_end < 0.01 * typical:
        for n in range(first_end, count):
            ring[n] -= 1
        wraps -= 1
    return ring, wraps + 1, backward, share


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


@njit(cache=True, nogil=True, inline="always")
def _squeeze(slope: Any) -> Any:  # pragma: no cover - compiled
    """Map a slope to [0, 1024), ascending."""
    return min((0.5 + 0.5 * slope / (1.0 + abs(slope))) * _COARSE, _COARSE - 1e-6)


@njit(cache=True, nogil=True, inline="always")
def _bin_of_rank(counts: Any, rank: int) -> Any:  # pragma: no cover - compiled
    """Return the bin that holds the ``rank``-th item (from 1), and its rank within that bin; (-1, 0) for none."""
    seen = 0
    for b in range(len(counts)):
        if seen + counts[b] >= rank > 0:
            return b, rank - seen
        seen += counts[b]
    return -1, 0


@njit(cache=True, nogil=True)
def _count_slopes(ring: Any, slope: Any, rings: int) -> Any:  # pragma: no cover - compiled
    """Return (rings, 1024) int32 counts of squeezed slopes."""
    counts = np.zeros((rings, _COARSE), np.int32)
    for n in range(ring.shape[0]):
        if ring[n] >= 0 and slope[n] == slope[n]:
            counts[ring[n], int(_squeeze(slope[n]))] += 1
    return counts


@njit(cache=True, nogil=True)
def ring_medians(ring: Any, slope: Any, rings: int) -> Any:  # pragma: no cover - compiled
    """Return (rings,) float64 lower medians of the slopes within 1e-5 (NaN for none; NaN slopes are left out).

    Two rounds of counting (a radix select): the order of the points does not matter.
    """
    coarse = _count_slopes(ring, slope, rings)
    bins = np.empty(rings, np.int64)
    ranks = np.empty(rings, np.int64)
    for r in range(rings):
        bins[r], ranks[r] = _bin_of_rank(coarse[r], (coarse[r].sum() + 1) // 2)
    fine = np.zeros((rings, _FINE), np.int32)
    for n in range(ring.shape[0]):
        if ring[n] >= 0 and slope[n] == slope[n]:
            u = _squeeze(slope[n])
            if int(u) == bins[ring[n]]:
                fine[ring[n], int((u - int(u)) * _FINE)] += 1
    medians = np.full(rings, np.nan)
    for r in range(rings):
        if bins[r] >= 0:
            v = 2.0 * (bins[r] + (_bin_of_rank(fine[r], ranks[r])[0] + 0.5) / _FINE) / _COARSE - 1.0
            medians[r] = v / (1.0 - abs(v))
    return medians


@njit(cache=True, nogil=True)
def count_alone(azimuth: Any, ring: Any, columns: int, rings: int) -> Any:  # pragma: no cover - compiled
    """Return the column of each point (N,), the points with a ring, and those of them alone in their pixel."""
    column = np.empty(azimuth.shape[0], np.int32)
    counts = np.zeros((rings, columns), np.uint8)
    per_radian = columns / (2 * np.pi)
    for n in range(azimuth.shape[0]):
        c = int((azimuth[n] + np.pi) * per_radian)
        c = min(max(c, 0), columns - 1)
        column[n] = c
        if ring[n] >= 0:
            counts[ring[n], c] = min(counts[ring[n], c] + 1, 2)
    placed, alone = 0, 0
    for n in range(azimuth.shape[0]):
        if ring[n] >= 0:
            placed += 1
            alone += counts[ring[n], column[n]] == 1
    return column, placed, alone
