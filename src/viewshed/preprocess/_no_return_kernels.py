"""Compiled loops: what the surroundings of beams without a return say about their depth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from viewshed.preprocess.range_image import SHARE_BIN_M, SHARE_BINS, SHARE_SECTORS

GAP_M = 1.5
"""A gap between two returns that is narrower than this, measured at the nearer one, lies on what the two lie on ..."""

LIKE = 1.25
"""... if the ratio of their ranges is below this."""

PRIOR_BEAMS = 20
"""The share of a bin starts from that of the bin before, as if so many beams had told it."""

WEIGHTY = 0.02
"""Nearer ground returns at least as often as that of a bin with this share of all returns from ground."""


@njit(cache=True, nogil=True, error_model="numpy")
def meet(azimuth: Any, slope: Any, rise_m: Any, profile: Any, ranges_m: Any) -> Any:  # pragma: no cover - compiled
    """Return the range (M,) at which beams first meet the ground, +inf where they do not.

    ``profile`` (sectors, ranges) is the slope from the sensor to the ground; beams start ``rise_m`` (M,) higher.
    """
    sectors, bins = profile.shape
    highest = np.empty_like(profile)
    for s in range(sectors):
        highest[s, 0] = profile[s, 0]
        for k in range(1, bins):
            highest[s, k] = max(highest[s, k - 1], profile[s, k])
    met = np.full(azimuth.shape[0], np.inf, np.float32)
    per_rad = np.float32(sectors / (2 * np.pi))
    for n in range(azimuth.shape[0]):
        s = min(max(int((azimuth[n] + np.float32(np.pi)) * per_rad), 0), sectors - 1)
        row = highest[s]
        met[n] = _crossing(row, ranges_m, slope[n])
        if rise_m[n] != 0.0 and met[n] < np.inf:
            met[n] = _crossing(row, ranges_m, slope[n] + rise_m[n] / met[n])
    return met


@njit(cache=True, nogil=True, error_model="numpy")
def _crossing(row: Any, ranges_m: Any, slope: Any) -> Any:  # pragma: no cover - compiled
    """Return the range at which an ascending row first reaches ``slope``, between its entries linearly."""
    k = np.searchsorted(row, slope)
    if k == row.shape[0]:
        return np.float32(np.inf)
    if k == 0:
        return np.float32(ranges_m[0])
    part = (slope - row[k - 1]) / max(row[k] - row[k - 1], 1e-9)
    return np.float32(ranges_m[k - 1] + part * (ranges_m[k] - ranges_m[k - 1]))


@njit(cache=True, nogil=True, error_model="numpy")
def bounds(pixels: Any, obstacle: Any) -> Any:  # pragma: no cover - compiled
    """Return the nearest obstacle (M,) among the two pixels beside each beam and the three above it."""
    rings, columns = obstacle.shape
    nearest = np.full(pixels.shape[0], np.inf, np.float32)
    for n in range(pixels.shape[0]):
        r, c = pixels[n, 0], pixels[n, 1]
        before, after = (c - 1 if c > 0 else columns - 1), (c + 1 if c + 1 < columns else 0)
        nearest[n] = min(obstacle[r, before], obstacle[r, after])
        if r + 1 < rings:
            nearest[n] = min(nearest[n], obstacle[r + 1, before], obstacle[r + 1, c], obstacle[r + 1, after])
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def narrow(ends: Any, steps: Any, columns: int) -> Any:  # pragma: no cover - compiled
    """Return the nearer end (M,) of gaps in a ring that are narrow and whose ends are of like depth, else NaN."""
    out = np.full(ends.shape[0], np.nan, np.float32)
    step = np.float32(2 * np.pi / columns)
    for n in range(ends.shape[0]):
        near, far = min(ends[n, 0], ends[n, 1]), max(ends[n, 0], ends[n, 1])
        if far < LIKE * near and (steps[n, 0] + steps[n, 1]) * step * near < GAP_M:
            out[n] = near
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def enclose(pixels: Any, obstacle: Any, counts: Any, tangent: Any, between: Any) -> None:  # pragma: no cover - compiled
    """Lower ``between`` (M,) to the nearer of the obstacles next below and above in the column, if like and close."""
    for n in range(pixels.shape[0]):
        r, c = pixels[n, 0], pixels[n, 1]
        low, high = _next(counts, r, c, -1), _next(counts, r, c, 1)
        if low < 0 or high < 0:
            continue
        near, far = min(obstacle[low, c], obstacle[high, c]), max(obstacle[low, c], obstacle[high, c])
        if far < LIKE * near and (tangent[high] - tangent[low]) * near < GAP_M:
            between[n] = near if between[n] != between[n] else min(between[n], near)


@njit(cache=True, nogil=True, error_model="numpy")
def spread(pixels: Any, between: Any, bound: Any, columns: int) -> None:  # pragma: no cover - compiled
    """Lower ``bound`` (M,) to ``between`` of beams in the same gap of the ring that passed closer than ``GAP_M``."""
    per_column = np.float32(2 * np.pi / columns)
    count = pixels.shape[0]
    for turn in range(2):
        at, near = 0, np.float32(np.inf)
        for k in range(count):
            n = k if turn == 0 else count - 1 - k
            last = n - 1 if turn == 0 else n + 1
            if k == 0 or pixels[n, 0] != pixels[last, 0] or abs(pixels[n, 1] - pixels[last, 1]) > 1:
                near = np.float32(np.inf)
            if between[n] == between[n]:
                at, near = pixels[n, 1], between[n]
            elif abs(pixels[n, 1] - at) * per_column * near < GAP_M / 2:
                bound[n] = min(bound[n], near)


@njit(cache=True, nogil=True, error_model="numpy")
def _next(counts: Any, r: Any, c: Any, step: Any) -> Any:  # pragma: no cover - compiled
    """Return the next ring below (-1) or above (1) with a return in a column; -1 where there is none nearby."""
    for _ in range(8):
        r += step
        if r < 0 or r >= counts.shape[0]:
            return -1
        if counts[r, c] > 0:
            return r
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def shares(ground: Any, pixels: Any, told: Any, near_m: Any, columns: int) -> Any:  # pragma: no cover - compiled
    """Return the share of the beams at ground that return, in each bin of range: the median over the sectors."""
    between, bound, met = told
    lost = np.zeros_like(ground)
    for n in range(met.shape[0]):
        if np.isnan(between[n]) and bound[n] > met[n] - 1.0 and near_m < met[n] < np.inf:
            lost[pixels[n, 1] * SHARE_SECTORS // columns, min(int(met[n] / SHARE_BIN_M), SHARE_BINS - 1)] += 1
    share = np.empty(SHARE_BINS)
    before = 1.0
    for k in range(SHARE_BINS):
        beams = ground[:, k].sum() + lost[:, k].sum()
        before = (beams * _median(ground[:, k], lost[:, k]) + PRIOR_BEAMS * before) / (beams + PRIOR_BEAMS)
        share[k] = before
    farther, enough = 0.0, WEIGHTY * ground.sum()
    for k in range(SHARE_BINS - 1, -1, -1):
        if ground[:, k].sum() > enough:
            farther = max(farther, share[k])
        share[k] = max(share[k], farther)
    return share


@njit(cache=True, nogil=True, error_model="numpy")
def _median(ground: Any, lost: Any) -> Any:  # pragma: no cover - compiled
    """Return the median of the sectors' shares, weighted with their beams; 0 without any."""
    beams = ground + lost
    share = ground / np.maximum(beams, 1)
    seen, half = 0, beams.sum() / 2
    for s in np.argsort(share):
        seen += beams[s]
        if seen > half:
            return share[s]
    return 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def infer_depths(pixels: Any, told: Any, share: Any, limits: Any, counts: Any) -> Any:  # pragma: no cover - compiled
    """Return how far each beam went (M,), NaN where nothing explains it. ``pixels`` ascend by ring.

    ``told``: nearer end of a narrow gap (NaN for none), nearest obstacle around, range at which it would meet ground.
    ``limits``: the share from which on a return is expected, the range up to which it always is, and the farthest range
    that anything is said about.
    """
    between, bound, met = told
    expected, near_m, reach_m = limits
    below = _ring_below(counts)
    dark_at = np.full(counts.shape[1], -2, np.int64)
    depth = np.full(pixels.shape[0], np.nan, np.float32)
    for n in range(pixels.shape[0]):
        r, c = pixels[n, 0], pixels[n, 1]
        lost = met[n] == np.inf
        if near_m < met[n] < np.inf:
            lost = share[min(int(met[n] / SHARE_BIN_M), SHARE_BINS - 1)] < expected
        if between[n] == between[n]:
            depth[n] = between[n]
        elif lost and dark_at[c] != below[r]:
            depth[n] = min(met[n], bound[n], reach_m)
        else:
            dark_at[c] = r
    return depth


@njit(cache=True, nogil=True, error_model="numpy")
def _ring_below(counts: Any) -> Any:  # pragma: no cover - compiled
    """Return the next lower ring (rings,) that has returns, -1 for none."""
    below = np.full(counts.shape[0], -1, np.int64)
    last = -1
    for r in range(counts.shape[0]):
        below[r] = last
        if counts[r].any():
            last = r
    return below


@njit(cache=True, nogil=True, error_model="numpy")
def split_by_height(beams: Any, highest: Any, near_m: Any) -> Any:  # pragma: no cover - compiled
    """Return azimuth, slope and depth (3, …) of the beams whose depth is known, and of the others, which are endless.

    Beams steeper than ``highest`` (sectors,) are in neither. Slopes are seen from the sensor's origin afterwards: a
    beam starts ``rise_m`` higher.
    """
    azimuth, slope, rise_m, depth = beams
    sectors, count, found, left = highest.shape[0], azimuth.shape[0], 0, 0
    known, rest = np.empty((3, count), np.float32), np.empty((3, count), np.float32)
    per_rad = np.float32(sectors / (2 * np.pi))
    for n in range(count):
        steep = slope[n] + rise_m[n] / (depth[n] if depth[n] > near_m else near_m)
        sector = min(max(int((azimuth[n] + np.float32(np.pi)) * per_rad), 0), sectors - 1)
        if steep > highest[sector]:
            continue
        if np.isfinite(depth[n]):
            known[0, found], known[1, found], known[2, found] = azimuth[n], steep, depth[n]
            found += 1
        else:
            rest[0, left], rest[1, left], rest[2, left] = azimuth[n], steep, np.inf
            left += 1
    return known[:, :found], rest[:, :left]
