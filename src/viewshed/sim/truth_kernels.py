"""Loops of the exact truth: beams sorted by azimuth, and the beams that a plate in each cell would meet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.angles import atan2

TILE = 16
"""Beams of a ring lie in tiles of so many, sorted by azimuth, and are tested a tile at a time."""
SECTORS = 256
"""Sectors of azimuth in which the slopes of each ring are bounded."""
MANY = 255
"""Beams are counted up to here."""
BEND, ALONG_X, ALONG_Y, RISE, SLOPE, STOP = range(6)
"""What a beam is, as a line over the plane: distance by which it passes the sensor's reference position on its right,
horizontal unit direction, height where it passes, rise over run, and the run from there to its stop."""
_AZIMUTH_MARGIN = np.float32(1e-4)
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

    Returns tiles (R, T, 6, TILE), filled up with beams that meet nothing (NaN), and the place of the first beam of
    each bin and ring (bins + 1, R).
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
    tiles = np.empty((rings, (columns + TILE - 1) // TILE, 6, TILE), np.float32)
    tiles[:, -1] = np.float32(np.nan)
    ring = 0
    for n in range(azimuth.size):
        place = free[bins[n], ring]
        free[bins[n], ring] = place + 1
        for row in range(6):
            tiles[ring, place // TILE, row, place % TILE] = beams[row, n]
        ring = ring + 1 if ring < rings - 1 else 0
    return tiles, starts


@njit(cache=True, nogil=True, error_model="numpy")
def slope_bounds(slope: Any, azimuth: Any, rings: Any) -> Any:  # pragma: no cover - compiled
    """Return two bounds (SECTORS, R) that ascend with the ring.

    The largest slope of any ring up to this one, and the smallest of any ring from this one on.
    """
    per_rad = np.float32(SECTORS / (2 * np.pi))
    high = np.full((SECTORS, rings), np.float32(-np.inf))
    low = np.full((SECTORS, rings), np.float32(np.inf))
    ring = 0
    for n in range(azimuth.size):
        sector = min(max(int((azimuth[n] + _PI) * per_rad), 0), SECTORS - 1)
        high[sector, ring] = max(high[sector, ring], slope[n])
        low[sector, ring] = min(low[sector, ring], slope[n])
        ring = ring + 1 if ring < rings - 1 else 0
    for sector in range(SECTORS):
        for k in range(1, rings):
            high[sector, k] = max(high[sector, k], high[sector, k - 1])
            back = rings - 1 - k
            low[sector, back] = min(low[sector, back], low[sector, back + 1])
    return high, low


@njit(cache=True, nogil=True, error_model="numpy")
def tile_reaches(tiles: Any) -> Any:  # pragma: no cover - compiled
    """Return (R, T) how far from the sensor the stops of a tile's beams lie at most."""
    out = np.empty(tiles.shape[:2], np.float32)
    for ring in range(tiles.shape[0]):
        for t in range(tiles.shape[1]):
            farthest = np.float32(0.0)
            for k in range(TILE):
                bend, run = tiles[ring, t, 0, k], tiles[ring, t, 5, k]
                farthest = max(farthest, np.float32(bend * bend + run * run))
            out[ring, t] = np.sqrt(farthest)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def count_cells(beams: Any, cells: Any, plates: Any, limits: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Fill ``out`` (4, cells) with aimed and reached beams of plate a, then of plate b, each up to 255.

    Beams that do not reach are counted as aimed up to the least number that is asked for, perhaps not further.

    Args:
        beams: tiles, their reaches, places of bins, and bounds of slopes.
        cells: (5, cells) unit vector, range, azimuth, and ground from the sensor's height.
        plates: half widths a and b (a the wider), heights a and b, least aimed a and b.
        limits: cell's side, tolerance below ground, largest horizontal offset of a beam's start, its lowest and
            highest vertical one, and the range from which nothing is counted.
        out: as above.
    """
    half_a, half_b, high_a, high_b, least_a, least_b = plates
    cell, below, aside, lowest, highest, max_range = limits
    wide, tall, columns = half_a + aside, max(high_a, high_b), beams[2].shape[0] - 1
    rings, span = np.array([0, -1]), np.empty(2, np.int64)
    for n in range(cells.shape[1]):
        r, ground = cells[2, n], cells[4, n]
        aimed_a, aimed_b, reached_a, reached_b = 0, 0, 0, 0
        if r > aside and r - cell <= max_range:
            low, high = ground - below - highest, ground + tall - lowest
            near, far = r - aside, r + aside + wide
            slopes = (low / (near if low < 0 else far), high / (far if high < 0 else near))
            half = _half_window(wide, r)
            _bins_of(cells[3, n], half, columns, span)
            _rings_of(beams[3], cells[3, n], half, slopes, rings)
            heights = (ground - below, ground + high_a, ground + high_b)
            plate = (cells[0, n], cells[1, n], r, half_a, half_b, heights, cell)
            for ring in range(rings[0], rings[1] + 1):
                needed = r - cell if aimed_a >= least_a and aimed_b >= least_b else np.float32(-1.0)
                a, b = _met(beams, ring, span, plate, needed)
                if reached_a < MANY <= reached_a + (a >> 16):
                    _bins_of(cells[3, n], _half_window(half_b + aside, r), columns, span)
                aimed_a, reached_a = aimed_a + (a & 65535), reached_a + (a >> 16)
                aimed_b, reached_b = aimed_b + (b & 65535), reached_b + (b >> 16)
                if reached_a >= MANY and reached_b >= MANY:
                    break
        out[0, n], out[1, n] = min(aimed_a, MANY), min(reached_a, MANY)
        out[2, n], out[3, n] = min(aimed_b, MANY), min(reached_b, MANY)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _met(beams: Any, ring: Any, span: Any, plate: Any, needed: Any) -> Any:  # pragma: no cover - compiled
    """Return aimed + 65536 · reached of both plates, of the ring's beams in the bins of ``span``; see ``_met_in``."""
    tiles, reaches, starts = beams[0][ring], beams[1][ring], beams[2]
    begin, end = starts[span[0], ring] // TILE, (starts[span[1] + 1, ring] + TILE - 1) // TILE
    if span[0] <= span[1]:
        return _met_in(tiles, reaches, (begin, end), plate, needed)
    a, b = _met_in(tiles, reaches, (begin, tiles.shape[0]), plate, needed)
    more_a, more_b = _met_in(tiles, reaches, (0, min(end, begin)), plate, needed)
    return a + more_a, b + more_b


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _met_in(tiles: Any, reaches: Any, which: Any, plate: Any, needed: Any) -> Any:  # pragma: no cover - compiled
    """Return aimed + 65536 · reached of both plates, of the beams in the tiles that reach as far as ``needed``.

    ``plate`` is the unit vector to the cell, its range, half widths, heights of bottom and tops, and the cell's side.
    All lengths are scaled by the cosine between beam and line of sight (``forward``), so that nothing is divided.
    """
    cx, cy, r, half_a, half_b, (bottom, top_a, top_b), cell = plate
    a, b = 0, 0
    for t in range(which[0], which[1]):
        if reaches[t] < needed:
            continue
        tile = tiles[t]
        some_a, some_b = np.int32(0), np.int32(0)
        for k in range(TILE):
            bend, ux, uy = tile[0, k], tile[1, k], tile[2, k]
            forward, aside = ux * cx + uy * cy, uy * cx - ux * cy
            run, lateral = r + bend * aside, abs(bend + r * aside)
            height = tile[3, k] * forward + tile[4, k] * run
            ahead = (forward > np.float32(0.0)) & (height >= bottom * forward)
            hit_a = ahead & (lateral <= half_a * forward) & (height <= top_a * forward)
            hit_b = ahead & (lateral <= half_b * forward) & (height <= top_b * forward)
            worth = np.int32(65537) if tile[5, k] * forward >= run - cell else np.int32(1)
            some_a = np.int32(some_a + (worth if hit_a else np.int32(0)))
            some_b = np.int32(some_b + (worth if hit_b else np.int32(0)))
        a, b = a + int(some_a), b + int(some_b)
    return a, b


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _half_window(wide: Any, r: Any) -> Any:  # pragma: no cover - compiled
    """Return at least arcsin(wide / r), half the azimuths from which a beam may cross the plate."""
    x = min(wide / r, np.float32(1.0))
    return x + np.float32(0.5709) * x * x * x + _AZIMUTH_MARGIN


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _bins_of(azimuth: Any, half: Any, columns: Any, span: Any) -> None:  # pragma: no cover - compiled
    """Set the first and last bin of a window; the first is larger where it crosses ±π."""
    per_rad = np.float32(columns / (2 * np.pi))
    first = int(np.floor((azimuth + _PI - half) * per_rad))
    last = int(np.floor((azimuth + _PI + half) * per_rad))
    if last - first + 1 >= columns:
        span[0], span[1] = 0, columns - 1
    else:
        span[0] = first + columns if first < 0 else first
        span[1] = last - columns if last >= columns else last


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _rings_of(bounds: Any, azimuth: Any, half: Any, slopes: Any, span: Any) -> None:  # pragma: no cover - compiled
    """Move ``span`` to the first and last ring that may have slopes between two limits, from where it was."""
    high, low = bounds
    rings = high.shape[1]
    per_rad = np.float32(SECTORS / (2 * np.pi))
    begin = int(np.floor((azimuth + _PI - half) * per_rad))
    end = int(np.floor((azimuth + _PI + half) * per_rad))
    first, last = rings, -1
    for sector in range(begin, end + 1):
        s = sector % SECTORS
        f, k = min(span[0], rings - 1), max(span[1], 0)
        while f > 0 and high[s, f - 1] >= slopes[0]:
            f -= 1
        while f < rings and high[s, f] < slopes[0]:
            f += 1
        while k < rings - 1 and low[s, k + 1] <= slopes[1]:
            k += 1
        while k >= 0 and low[s, k] > slopes[1]:
            k -= 1
        first, last = min(first, f), max(last, k)
    span[0], span[1] = first, last


@njit(cache=True, nogil=True, error_model="numpy")
def mark_stops(beams: Any, counts: Any, ground: Any, shape: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Set ``out`` (targets, cells) where a stop that ``counts`` lies between a height and the target's top.

    ``shape`` is the lattice (x and y of its corner, cells a metre, cells a side), the height and the tops (targets,).
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
