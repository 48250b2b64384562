"""Loops of the exact truth that count beams: which of them aim at a plate in each cell, and which reach it.

Beams are tried one by one on the 4 x 4 cells of a patch, or, near the sensor, where the cells of a patch lie far apart
in azimuth, 16 beams at a time on one cell. Either fills vector registers; both try every beam that may meet a plate.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed._numba import atan2
from viewshed.fov.estimate import CellState
from viewshed.sim.truth._beams import LANES, REACH, SECTORS

MANY = 255
"""Beams are counted up to here."""

_NEAR = np.float32(20.0 * 2.0 * np.pi)

_FULL = np.int32(255 * 65537)

_AZIMUTH_MARGIN = np.float32(1e-4)

_SLOPE_MARGIN = np.float32(1e-5)

_PI = np.float32(np.pi)

FREE, SURFACE, HIDDEN, UNKNOWN = (np.uint8(CellState[name]) for name in ("FREE", "SURFACE", "HIDDEN", "UNKNOWN"))


@njit(cache=True, nogil=True, error_model="numpy")
def count_cells(
    beams: Any, patches: Any, ground: Any, plates: Any, limits: Any, out: Any
) -> None:  # pragma: no cover - compiled
    """Fill ``out`` (cells,) int32, zeros before, with aimed beams of plates a and b, then those that reach them.

    One byte each, the first the lowest, up to 255. Beams that do not reach are counted as aimed up to the least number
    that is asked for, perhaps not further.

    Args:
        beams: tiles, places of bins, and bounds of slopes; see ``truth_kernels``.
        patches: of the cells in patches unit vectors and ranges (P, 3, LANES) and places in ``ground`` (P, LANES);
            of the patches azimuth of the middle, largest angle from it, nearest and farthest range (P, 4).
        ground: of the cells, from the sensor's height.
        plates: half widths a and b (a the wider), heights a and b, least aimed a and b.
        limits: cell's side, tolerance below ground, largest horizontal offset of a beam's start, its lowest and
            highest vertical one, and the range from which nothing is counted.
        out: as above.
    """
    (tiles, starts, bounds), (lanes, cells, middles) = beams, patches
    sizes, columns = (plates[0], plates[1], limits[0]), starts.shape[0] - 1
    room, counts, guess = np.empty((6, LANES), np.float32), np.empty((2, LANES), np.int32), (0, -1)
    for p in range(cells.shape[0]):
        azimuth, spread, nearest, farthest = middles[p, 0], middles[p, 1], middles[p, 2], middles[p, 3]
        if nearest - sizes[2] > limits[5]:
            continue
        heights = _load(lanes, cells, p, ground, (plates, limits), room)
        counts[:] = 0
        if spread * columns > _NEAR or nearest <= 2 * limits[2]:
            _count_near(tiles, starts, bounds, room, counts, (plates, limits))
        else:
            angle = spread + _half_window(plates[0] + limits[2], nearest)
            slopes, bins = _slopes((nearest, farthest), heights, plates[0], limits), _bins_of((azimuth, angle), columns)
            guess, needed = _rings_of(bounds, (azimuth, angle), slopes, guess), np.float32(-1.0)
            for ring in range(guess[0], guess[1] + 1):
                begin, end, rest = _span(starts, bins, ring)
                _meet_patch(tiles, (ring, begin, end, needed), room, sizes, counts)
                _meet_patch(tiles, (ring, 0, rest, needed), room, sizes, counts)
                needed = nearest - sizes[2] if _clamp(counts, plates[4], plates[5]) else needed
        for k in range(LANES):
            out[cells[p, k]] = counts[0, k] + (counts[1, k] << 8)


@njit(cache=True, nogil=True, error_model="numpy")
def _load(lanes: Any, cells: Any, p: Any, ground: Any, settings: Any, room: Any) -> Any:  # pragma: no cover - compiled
    """Store unit vectors, ranges, bottoms and tops of the plates in a patch; return the lowest and the highest.

    A bottom is infinite where nothing counts.
    """
    (_, _, high_a, high_b, _, _), (cell, below, aside, _, _, max_range) = settings
    bottom, top, tall = np.float32(np.inf), np.float32(-np.inf), max(high_a, high_b)
    for k in range(LANES):
        r, height = lanes[p, 2, k], ground[cells[p, k]]
        room[0, k], room[1, k], room[2, k] = lanes[p, 0, k], lanes[p, 1, k], r
        room[3, k] = height - below if r > aside and r - cell <= max_range else np.float32(np.inf)
        room[4, k], room[5, k] = height + high_a, height + high_b
        bottom, top = min(bottom, room[3, k]), max(top, height + tall)
    return bottom, top


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _meet_patch(tiles: Any, run: Any, room: Any, sizes: Any, counts: Any) -> None:  # pragma: no cover - compiled
    """Add a run of a ring's beams to the counts of a patch, if one of them reaches as far as needed."""
    ring, begin, end, needed = run
    if _farthest(tiles, ring, begin, end) >= needed:
        for n in range(begin, end):
            t, i = np.uint64(n // LANES), np.uint64(n % LANES)
            bend, ux, uy = tiles[ring, t, 0, i], tiles[ring, t, 1, i], tiles[ring, t, 2, i]
            rise, slope, stop = tiles[ring, t, 3, i], tiles[ring, t, 4, i], tiles[ring, t, 5, i]
            for k in range(LANES):
                plate = (room[0, k], room[1, k], room[2, k], room[3, k], room[4, k], room[5, k])
                a, b = _aim((bend, ux, uy, rise, slope, stop), plate, sizes)
                counts[0, k] += a
                counts[1, k] += b


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _clamp(counts: Any, least_a: Any, least_b: Any) -> Any:  # pragma: no cover - compiled
    """Limit all counts to 255; return whether enough beams aim at every cell."""
    enough = 0
    for k in range(LANES):
        a, b = _limited(counts[0, k]), _limited(counts[1, k])
        enough += 1 if (a & 255) >= least_a and (b & 255) >= least_b else 0
        counts[0, k], counts[1, k] = a, b
    return enough == LANES


@njit(cache=True, nogil=True, error_model="numpy")
def _limited(count: Any) -> Any:  # pragma: no cover - compiled
    """Return aimed + 65536 · reached, either of them 255 at most."""
    return np.int32(min(count & 65535, 255) + (min(count >> 16, 255) << 16))


@njit(cache=True, nogil=True, error_model="numpy")
def _count_near(
    tiles: Any, starts: Any, bounds: Any, room: Any, counts: Any, settings: Any
) -> None:  # pragma: no cover - compiled
    """Count beams by batches on each cell of a patch."""
    (half_a, half_b, _, _, least_a, least_b), limits = settings
    columns, sizes, guess = starts.shape[0] - 1, (half_a, half_b, limits[0]), (0, -1)
    for k in range(LANES):
        plate = (room[0, k], room[1, k], room[2, k], room[3, k], room[4, k], room[5, k])
        azimuth, r, a, b = atan2(plate[1], plate[0]), plate[2], np.int32(0), np.int32(0)
        if plate[3] < np.inf:
            angle = _half_window(half_a + limits[2], r)
            slopes = _slopes((r, r), (plate[3], max(plate[4], plate[5])), half_a, limits)
            guess, bins = _rings_of(bounds, (azimuth, angle), slopes, guess), _bins_of((azimuth, angle), columns)
            needed = np.float32(-1.0)
            for ring in range(guess[0], guess[1] + 1):
                begin, end, rest = _span(starts, bins, ring)
                some_a, some_b = _meet_cell(tiles, (ring, begin, end, needed), plate, sizes)
                more_a, more_b = _meet_cell(tiles, (ring, 0, rest, needed), plate, sizes)
                a, b = _limited(a + some_a + more_a), _limited(b + some_b + more_b)
                if (a & 255) >= least_a and (b & 255) >= least_b:
                    needed = r - sizes[2]
                if a == _FULL:
                    bins = _bins_of((azimuth, _half_window(half_b + limits[2], r)), columns)
                if a == _FULL and b == _FULL:
                    break
        counts[0, k], counts[1, k] = a, b


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_cell(tiles: Any, run: Any, plate: Any, sizes: Any) -> Any:  # pragma: no cover - compiled
    """Return what the tiles of a run of a ring's beams add to the counts of both plates of a cell."""
    ring, begin, end, needed = run
    a, b = np.int32(0), np.int32(0)
    for t in range(begin // LANES, (end + LANES - 1) // LANES):
        if tiles[ring, t, REACH, 0] >= needed:
            some_a, some_b = np.int32(0), np.int32(0)
            for n in range(LANES):
                line = (tiles[ring, t, 0, n], tiles[ring, t, 1, n], tiles[ring, t, 2, n],
                        tiles[ring, t, 3, n], tiles[ring, t, 4, n], tiles[ring, t, 5, n])  # fmt: skip
                hit_a, hit_b = _aim(line, plate, sizes)
                some_a, some_b = np.int32(some_a + hit_a), np.int32(some_b + hit_b)
            a, b = np.int32(a + some_a), np.int32(b + some_b)
    return a, b


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _aim(line: Any, plate: Any, sizes: Any) -> Any:  # pragma: no cover - compiled
    """Return for both plates 0 if the beam does not aim at it, 1 if it aims, 65537 if it also reaches.

    All lengths are scaled by the cosine between beam and line of sight (``forward``), so that nothing is divided.
    """
    bend, ux, uy, rise, slope, stop = line
    cx, cy, r, bottom, top_a, top_b = plate
    half_a, half_b, cell = sizes
    forward, aside = ux * cx + uy * cy, uy * cx - ux * cy
    run, lateral = r + bend * aside, abs(bend + r * aside)
    height = rise * forward + slope * run
    ahead = (forward > np.float32(0.0)) & (height >= bottom * forward)
    hit_a = ahead & (lateral <= half_a * forward) & (height <= top_a * forward)
    hit_b = ahead & (lateral <= half_b * forward) & (height <= top_b * forward)
    worth = np.int32(65537) if stop * forward >= run - cell else np.int32(1)
    return worth if hit_a else np.int32(0), worth if hit_b else np.int32(0)


@njit(cache=True, nogil=True, error_model="numpy")
def _farthest(tiles: Any, ring: Any, begin: Any, end: Any) -> Any:  # pragma: no cover - compiled
    """Return how far the tiles of a run of a ring's beams reach at most; -1 of an empty run."""
    out = np.float32(-1.0)
    for t in range(begin // LANES, (end + LANES - 1) // LANES):
        out = max(out, tiles[ring, t, REACH, 0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _span(starts: Any, bins: Any, ring: Any) -> Any:  # pragma: no cover - compiled
    """Return the run of a ring's beams in a window, and the end of the run from 0 where it crosses ±π (0 otherwise)."""
    begin, end = starts[bins[0], ring], starts[bins[1] + 1, ring]
    if bins[0] <= bins[1]:
        return begin, end, 0
    if end + LANES > begin:
        return 0, starts.shape[0] - 1, 0
    return begin, starts.shape[0] - 1, end


@njit(cache=True, nogil=True, error_model="numpy")
def _half_window(wide: Any, r: Any) -> Any:  # pragma: no cover - compiled
    """Return at least arcsin(wide / r), half the azimuths from which a beam may cross the plate."""
    x = min(wide / r, np.float32(1.0))
    return x + np.float32(0.5709) * x * x * x + _AZIMUTH_MARGIN


@njit(cache=True, nogil=True, error_model="numpy")
def _slopes(ranges: Any, heights: Any, half: Any, limits: Any) -> Any:  # pragma: no cover - compiled
    """Return the least and the greatest slope of beams that may meet plates between two ranges and heights."""
    _, _, aside, lowest, highest, _ = limits
    low, high = heights[0] - highest, heights[1] - lowest
    near, far = ranges[0] - aside, ranges[1] + half + 2 * aside
    least, most = low / (near if low < 0 else far), high / (far if high < 0 else near)
    return least - _SLOPE_MARGIN, most + _SLOPE_MARGIN


@njit(cache=True, nogil=True, error_model="numpy")
def _bins_of(azimuths: Any, columns: Any) -> Any:  # pragma: no cover - compiled
    """Return the first and last bin of a window, its middle and half given; the first is larger where it crosses ±π."""
    per_rad = np.float32(columns / (2 * np.pi))
    first = int(np.floor((azimuths[0] + _PI - azimuths[1]) * per_rad))
    last = int(np.floor((azimuths[0] + _PI + azimuths[1]) * per_rad))
    if last - first + 1 >= columns:
        return 0, columns - 1
    return (first + columns if first < 0 else first), (last - columns if last >= columns else last)


@njit(cache=True, nogil=True, error_model="numpy")
def _rings_of(bounds: Any, azimuths: Any, slopes: Any, guess: Any) -> Any:  # pragma: no cover - compiled
    """Return the first and last ring that may have slopes between two limits, found from a guess."""
    rings = bounds.shape[2]
    per_rad = np.float32(SECTORS / (2 * np.pi))
    begin = int(np.floor((azimuths[0] + _PI - azimuths[1]) * per_rad))
    end = int(np.floor((azimuths[0] + _PI + azimuths[1]) * per_rad))
    first, last = rings, -1
    for sector in range(begin + 1, end + 2, 3):
        s = sector % SECTORS
        f, k = min(guess[0], rings - 1), max(guess[1], 0)
        while f > 0 and bounds[0, s, f - 1] >= slopes[0]:
            f -= 1
        while f < rings and bounds[0, s, f] < slopes[0]:
            f += 1
        while k < rings - 1 and bounds[1, s, k + 1] <= slopes[1]:
            k += 1
        while k >= 0 and bounds[1, s, k] > slopes[1]:
            k -= 1
        first, last = min(first, f), max(last, k)
    return first, last


@njit(cache=True, nogil=True, error_model="numpy")
def states_of_cells(counts: Any, which: Any, surface: Any, least: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Fill ``out`` (2, cells) uint8 with beams that reach plate ``which`` (0 or 1) and with states.

    ``counts`` are those of ``count_cells``, ``surface`` is where a surface stands, ``least`` how many beams it takes.
    """
    shift = 8 * which
    for n in range(counts.shape[0]):
        aimed, reached = (counts[n] >> shift) & 255, (counts[n] >> (shift + 16)) & 255
        visible = SURFACE if surface[n] else FREE
        out[0, n] = reached
        out[1, n] = visible if reached >= least else (HIDDEN if aimed >= least else UNKNOWN)
