"""Loops of the exact truth: beams sorted by azimuth, and the beams that a plate in each cell would meet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed._numba import atan2

LANES = 16
"""Beams of a ring lie in tiles of so many, sorted by azimuth."""

SECTORS = 256
"""Sectors of azimuth in which the slopes of each ring are bounded."""

BEND, ALONG_X, ALONG_Y, RISE, SLOPE, STOP, REACH = range(7)
"""What a beam is, as a line over the plane: distance by which it passes the sensor's reference position on its right,
horizontal unit direction, height where it passes, rise over run, and the run from there to its stop."""

_PI = np.float32(np.pi)


@njit(cache=True, nogil=True, error_model="numpy")
def beam_lines(
    origin: Any, direction: Any, depth: Any, turn: Any, max_range: Any
) -> Any:  # pragma: no cover - compiled
    """Return beams (6, C·R) float32 in axes turned by (cosine, sine), and their azimuths (C·R,)."""
    count = depth.size
    out, azimuth = np.empty((6, count), np.float32), np.empty(count, np.float32)
    start, way, length = origin.reshape(-1, 3), direction.reshape(-1, 3), depth.reshape(-1)
    c, s = np.float32(turn[0]), np.float32(turn[1])
    for n in range(count):
        dx, dy = c * way[n, 0] + s * way[n, 1], c * way[n, 1] - s * way[n, 0]
        ox, oy = c * start[n, 0] + s * start[n, 1], c * start[n, 1] - s * start[n, 0]
        flat = max(np.sqrt(dx * dx + dy * dy), np.float32(1e-6))
        inverse = np.float32(1.0) / flat
        ux, uy = dx * inverse, dy * inverse
        slope, begin = way[n, 2] * inverse, ox * ux + oy * uy
        out[0, n], out[1, n], out[2, n] = oy * ux - ox * uy, ux, uy
        out[3, n], out[4, n] = start[n, 2] - slope * begin, slope
        out[5, n] = begin + min(length[n], max_range) * flat
    for n in range(count):
        azimuth[n] = atan2(out[2, n], out[1, n])
    return out, azimuth


@njit(cache=True, nogil=True, error_model="numpy")
def sorted_tiles(beams: Any, azimuth: Any, rings: Any) -> Any:  # pragma: no cover - compiled
    """Sort each ring's beams into as many bins of azimuth as there are columns.

    Returns tiles (R, T, 7, LANES), filled up with beams that meet nothing (NaN), and the place of the first beam of
    each bin and ring (bins + 1, R). REACH is how far the stops of a tile's beams lie from the sensor at most.
    """
    columns = azimuth.size // rings
    per_rad = np.float32(columns / (2 * np.pi))
    starts = np.zeros((columns + 1, rings), np.int32)
    bins = np.empty(azimuth.size, np.int32)
    ring = 0
    for n in range(azimuth.size):
        bins[n] = min(max(int((azimuth[n] + _PI) * per_rad), 0), columns - 1)
        starts[bins[n] + 1, ring] += 1
        ring = ring + 1 if ring < rings - 1 else 0
    for b in range(columns):
        for k in range(rings):
            starts[b + 1, k] += starts[b, k]
    free = starts[:columns].copy()
    tiles = np.empty((rings, (columns + LANES - 1) // LANES, 7, LANES), np.float32)
    tiles[:, -1, :REACH], tiles[:, :, REACH] = np.float32(np.nan), np.float32(0.0)
    ring = 0
    for n in range(azimuth.size):
        place = free[bins[n], ring]
        free[bins[n], ring] = place + 1
        t, k = place // LANES, place % LANES
        for row in range(6):
            tiles[ring, t, row, k] = beams[row, n]
        bend, run = beams[0, n], beams[5, n]
        tiles[ring, t, REACH, 0] = max(tiles[ring, t, REACH, 0], np.sqrt(bend * bend + run * run))
        ring = ring + 1 if ring < rings - 1 else 0
    return tiles, starts


@njit(cache=True, nogil=True, error_model="numpy")
def slope_bounds(slope: Any, azimuth: Any, rings: Any) -> Any:  # pragma: no cover - compiled
    """Return two bounds (2, SECTORS, R) that ascend with the ring.

    The largest slope of any ring up to this one, and the smallest of any ring from this one on.
    """
    per_rad = np.float32(SECTORS / (2 * np.pi))
    out = np.empty((2, SECTORS, rings), np.float32)
    out[0], out[1] = np.float32(-np.inf), np.float32(np.inf)
    ring = 0
    for n in range(azimuth.size):
        sector = min(max(int((azimuth[n] + _PI) * per_rad), 0), SECTORS - 1)
        out[0, sector, ring] = max(out[0, sector, ring], slope[n])
        out[1, sector, ring] = min(out[1, sector, ring], slope[n])
        ring = ring + 1 if ring < rings - 1 else 0
    for sector in range(SECTORS):
        for k in range(1, rings):
            out[0, sector, k] = max(out[0, sector, k], out[0, sector, k - 1])
            back = rings - 1 - k
            out[1, sector, back] = min(out[1, sector, back], out[1, sector, back + 1])
    wide = np.empty_like(out)
    for sector in range(SECTORS):
        before, after = (sector - 1) % SECTORS, (sector + 1) % SECTORS
        for k in range(rings):
            wide[0, sector, k] = max(out[0, sector, k], out[0, before, k], out[0, after, k])
            wide[1, sector, k] = min(out[1, sector, k], out[1, before, k], out[1, after, k])
    return wide


@njit(cache=True, nogil=True, error_model="numpy")
def mark_stops(beams: Any, counts: Any, ground: Any, shape: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Set ``out`` (targets, cells) where a stop that ``counts`` lies between a height and the target's top.

    ``shape`` is the lattice (x and y of its corner, cells a meter, cells a side), the height and the tops (targets,).
    """
    (x0, y0, per_m, cells), low, tops = shape
    for n in range(beams.shape[1]):
        if counts[n]:
            bend, ux, uy, run = beams[0, n], beams[1, n], beams[2, n], beams[5, n]
            u, v = (ux * run - bend * uy - x0) * per_m, (uy * run + bend * ux - y0) * per_m
            if u >= 0 and v >= 0 and u < cells and v < cells:
                cell = int(u) * cells + int(v)
                height = beams[3, n] + beams[4, n] * run - ground[cell]
                for k in range(tops.shape[0]):
                    if height > low and height <= tops[k]:
                        out[k, cell] = True
