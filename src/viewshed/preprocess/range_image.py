"""Compiled loops of :mod:`viewshed.preprocess.no_return`: the range image, and the beams that it lacks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed._numba import BLOCK, atan2, split

JITTER_COLUMNS = 4
"""A point may lie this many columns from the firing that it belongs to."""

SHARE_BIN_M = 2.5
"""The share of ground that returns is learned in bins of this width ..."""

SHARE_BINS = 52
"""... of this number; the last one holds everything beyond ..."""

SHARE_SECTORS = 24
"""... and in so many sectors of azimuth, so that one thing that swallows light does not decide."""

AWAKE = 0.5
"""A column that returned from less than this share of the usual number of rings did not fire, or hardly."""

_PHASES = 16


@njit(cache=True, nogil=True, error_model="numpy")
def place(points: Any, ring: Any, columns: int, rings: int) -> Any:  # pragma: no cover - compiled
    """Return each point's column (N,), each ring's phase (rings,), the points in each pixel and in each ring.

    The phase tells where in a column a ring's firings lie, so that one just at an edge does not fall into either column
    by chance: the circular mean of the azimuths' remainders, from a histogram, as the order must not matter. Pixels
    count up to 255; a point without a ring has column -1.
    """
    position = np.empty(points.shape[0], np.float32)
    column = position.view(np.int32)  # each place is read before it is written: fresh memory costs more than sums
    phases = np.zeros((rings, _PHASES), np.int32)
    counts = np.zeros((rings, columns), np.uint8)
    _positions(points, ring, np.float32(columns / (2 * np.pi)), position, phases)
    phase = _circular_means(phases)
    start = np.float32(columns + 0.5) - phase
    flat, turn = counts.reshape(-1), np.int32(columns)
    for n in range(points.shape[0]):
        c = np.int32(-1)
        if ring[n] >= 0:
            r = np.uint32(ring[n])
            c = np.int32(position[n] + start[r])
            c -= turn if c >= turn else np.int32(0)
            c -= turn if c >= turn else np.int32(0)
            flat[r * np.uint32(turn) + np.uint32(c)] += flat[r * np.uint32(turn) + np.uint32(c)] < 255
        column[n] = c
    return column, phase, counts, phases.sum(axis=1)


@njit(cache=True, nogil=True, error_model="numpy")
def _positions(points: Any, ring: Any, per_rad: Any, position: Any, phases: Any) -> None:  # pragma: no cover - compiled
    """Write the azimuth of each point in columns, from 0, and count its place within a column."""
    x, y, z = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    part = np.empty(BLOCK, np.int32)
    for start in range(0, points.shape[0], BLOCK):
        count = split(points, start, x, y, z)
        _turn(x[:count], y[:count], per_rad, position[start : start + count], part)
        rings = ring[start : start + count]
        for k in range(count):
            if rings[k] >= 0:
                phases[np.uint32(rings[k]), np.uint32(part[k])] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _turn(x: Any, y: Any, per_rad: Any, position: Any, part: Any) -> None:  # pragma: no cover - compiled
    for k in range(x.shape[0]):
        position[k] = (atan2(y[k], x[k]) + np.float32(np.pi)) * per_rad
    for k in range(x.shape[0]):
        part[k] = np.int32(position[k] * np.float32(_PHASES)) % np.int32(_PHASES)


@njit(cache=True, nogil=True, error_model="numpy")
def _circular_means(phases: Any) -> Any:  # pragma: no cover - compiled
    """Return the circular mean of each row of a histogram over [0, 1)."""
    mean = np.full(phases.shape[0], 0.5, np.float32)
    for r in range(phases.shape[0]):
        x, y = 0.0, 0.0
        for p in range(_PHASES):
            angle = 2 * np.pi * (p + 0.5) / _PHASES
            x += phases[r, p] * np.cos(angle)
            y += phases[r, p] * np.sin(angle)
        if x * x + y * y > 1e-6:
            mean[r] = np.arctan2(y, x) / (2 * np.pi) % 1.0
    return mean


@njit(cache=True, nogil=True, error_model="numpy")
def put(pixel: Any, points: Any, limits: Any, images: Any, tallies: Any) -> None:  # pragma: no cover - compiled
    """Lower the images (rings, columns) of depth and of obstacles to the ranges of points, and tally those.

    ``points``: row in the sweep, range and height. ``limits``: height from which on they are obstacles, and range from
    which on ground is tallied, by sectors and bins of range; those with a column are tallied by meters.
    """
    ring, column = pixel
    rows, range_m, height_m = points
    low_m, near_m = limits
    depth, obstacle = images
    ground_tally, meter_tally = tallies
    last = np.uint32(meter_tally.shape[0] - 1)
    per_bin, per_column = np.float32(1.0 / SHARE_BIN_M), np.float32(SHARE_SECTORS / depth.shape[1])
    for k in range(rows.shape[0]):
        n, d = np.uint64(rows[k]), range_m[k]
        high = height_m[k] > low_m
        if column[n] >= 0:
            r, c = np.uint32(ring[n]), np.uint32(column[n])
            meter_tally[min(np.uint32(d), last)] += 1
            if not high and d > near_m:
                ground_tally[np.uint32(c * per_column), min(np.uint32(d * per_bin), np.uint32(SHARE_BINS - 1))] += 1
            depth[r, c] = min(depth[r, c], d)
            if high:
                obstacle[r, c] = min(obstacle[r, c], d)


@njit(cache=True, nogil=True, error_model="numpy")
def find_no_return(counts: Any, depth: Any, awake: bool) -> Any:  # pragma: no cover - compiled
    """Return the missing beams' ring and column (M, 2), lowest ring first, and the returns around them in the ring.

    Of the nearest pixel with a return on each side: depth (M, 2), +inf for none, and steps in columns (M, 2). With
    ``awake`` only beams of rings and columns that have returns.
    """
    rings, columns = counts.shape
    size = counts.size - np.count_nonzero(counts)
    pixels = np.empty((size, 2), np.int32)
    ends = np.full((size, 2), np.inf, np.float32)
    steps = np.full((size, 2), columns, np.int32)
    silent = silent_columns(counts) if awake else np.zeros(columns, np.bool_)
    found = 0
    for r in range(rings):
        if awake and not counts[r].any():
            continue
        empty = _empty_columns(counts[r])
        around = _around(counts[r], empty)
        for k in range(empty.shape[0]):
            c = empty[k]
            if silent[c]:
                continue
            pixels[found, 0], pixels[found, 1] = r, c
            for side in range(2):
                at = around[k, side]
                if at != c:
                    steps[found, side] = abs(at - c)
                    ends[found, side] = depth[r, at % columns]
            found += 1
    return pixels[:found], ends[:found], steps[:found]


@njit(cache=True, nogil=True, error_model="numpy")
def _around(counts: Any, empty: Any) -> Any:  # pragma: no cover - compiled
    """Return the columns of the nearest returns before and after each empty column (E, 2), unwrapped around the circle.

    The column itself stands for none.
    """
    columns, count = counts.shape[0], empty.shape[0]
    around = np.empty((count, 2), np.int64)
    any_ = counts.any()
    for k in range(count):
        stop = empty[k - 1] if k > 0 else -columns
        at = empty[k] - 1
        while any_ and at > stop and counts[at] == 0:
            at -= 1
        around[k, 0] = empty[k] if not any_ else (around[k - 1, 0] if k > 0 and at == stop else at)
    for k in range(count - 1, -1, -1):
        stop = empty[k + 1] if k + 1 < count else 2 * columns
        at = empty[k] + 1
        while any_ and at < stop and counts[at % columns] == 0:
            at += 1
        around[k, 1] = empty[k] if not any_ else (around[k + 1, 1] if k + 1 < count and at == stop else at)
    return around


@njit(cache=True, nogil=True, error_model="numpy")
def silent_columns(counts: Any) -> Any:  # pragma: no cover - compiled
    """Return the columns that returned from less than ``AWAKE`` as many rings as the median of those with any return.

    They were dropped, or lie at the edge of a dropped sector, whatever a few points in them say.
    """
    rings = np.zeros(counts.shape[1], np.int32)
    for r in range(counts.shape[0]):
        for c in range(counts.shape[1]):
            rings[c] += counts[r, c] > 0
    some = np.sort(rings[rings > 0])
    least = AWAKE * some[some.shape[0] // 2] if some.shape[0] else 0.0
    return (rings == 0) | (rings < least)


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def aim(pixels: Any, tangent: Any, phase: Any, rotation: Any, columns: int) -> Any:  # pragma: no cover - compiled
    """Return azimuth (M,) and slope (M,) in ``level`` of beams given by ring and column."""
    count = pixels.shape[0]
    azimuth, slope = np.empty(count, np.float32), np.empty(count, np.float32)
    turns = np.empty((columns, 2))
    for c in range(columns):
        turns[c, 0], turns[c, 1] = np.cos(2 * np.pi * c / columns - np.pi), np.sin(2 * np.pi * c / columns - np.pi)
    for n in range(count):
        r, c = pixels[n, 0], pixels[n, 1]
        if n == 0 or r != pixels[n - 1, 0]:
            co, si = np.cos(2 * np.pi * phase[r] / columns), np.sin(2 * np.pi * phase[r] / columns)
        x, y, z = turns[c, 0] * co - turns[c, 1] * si, turns[c, 1] * co + turns[c, 0] * si, tangent[r]
        u = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z
        v = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z
        w = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
        azimuth[n] = atan2(np.float32(v), np.float32(u))
        slope[n] = w / max(np.sqrt(u * u + v * v), 1e-6)
    return azimuth, slope
