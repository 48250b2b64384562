"""Rings without a table: the elevations at which the returns of an unknown sensor gather.

Each beam of a spinning sensor keeps its elevation, so that in the sensor's own frame the elevations of a revolution
fall into as many narrow clusters as it has beams. Patterns that do not repeat, several sensors in one cloud and points
that are not in the sensor's frame have none: then nothing is inferred.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed._numba import BLOCK
from viewshed.preprocess.beam_matching import Angles, match_elevations

FEWEST_RINGS = 4
"""Fewer clusters are no sensor."""

MOST_RINGS = 256
"""More clusters than this are noise."""

FEWEST_RETURNS = 256
"""Clouds with fewer returns do not show clusters."""

_BIN, _COARSE_BIN = np.deg2rad(0.01), np.deg2rad(0.1)
"""Widths of the bins of a histogram of elevations, in their sine: hundredths and tenths of a degree at the horizon."""

_HALF_WIDTHS = (1, 2, 4, 8, 16)
"""Half widths of the windows, in bins of a hundredth of a degree, in which the elevations of a beam may scatter."""

_LEAST_IN_CLUSTER = 8.0

_NEAR_M = 0.4
"""Low robots see the ground from this horizontal range on."""

_CLEARLY = 0.01

_SAMPLE, _FEW = 4096, 2048
"""Returns by which clusters are judged, and by which their origin is found."""

_HEIGHTS_M = tuple(0.03 * k for k in range(-5, 11))
"""Heights of the beams' origin above the sensor's that are tried: Ouster counts from 36 mm below, KITTI from 0.2 m."""

_AROUND_M = tuple(0.005 * k for k in range(-4, 5))

_RADII_M = (0.0, 0.0158, 0.0277)
"""Radii that are tried of the circle on which the beams start: Ouster's are 15.8 and 27.7 mm."""

_SPLIT_GAP = 0.6
"""Two clusters may be one beam's if the gap between them is less than this share of the wider one beside them, ..."""

_FULL_SECTOR, _DOUBLE, _DOUBLE_SHARE = 0.95, 1.3, 0.2
"""... and fewer than this share of their sectors return more than 1.3 times as much as a full sector of one beam."""

_MOST_PARTS = 3

SHARPNESS = 0.85
"""Least share of the returns, beyond what chance gives, that must lie at the clusters' elevations."""


class ElevationClusters(NamedTuple):
    """Beams that a cloud shows.

    Attributes:
        elevation: (K,) radians, ascending.
        origin_m: (K,) height of each beam above the sensor's origin at range 0.
        sharpness: share of the returns that lie at the beams, less what chance gives.
    """

    elevation: NDArray[np.float64]
    origin_m: NDArray[np.float64]
    sharpness: float


def find_clusters(azimuth: Angles, slope: Angles, range_m: Angles) -> ElevationClusters | None:
    """Return the elevations at which returns (N,) gather, or None where they do not gather at any.

    How far the returns of a beam scatter is not known before: windows of several widths are tried, and the narrowest
    one is taken whose clusters explain about as many returns as those of any other.

    Args:
        azimuth: (N,) radians in [-π, π).
        slope: (N,) z over horizontal range.
        range_m: (N,) horizontal range in meters.
    """
    if len(slope) < FEWEST_RETURNS:
        return None
    rows = np.random.default_rng(0).integers(len(slope), size=_SAMPLE)
    few = slope[rows], range_m[rows]
    # Most sensors' beams start at the origin. Where they gather less than sharply, look for another one.
    best = _clusters_seen_from((0.0, 0.0), slope, range_m, few)
    if best is None or best.sharpness < 1.0 - _CLEARLY:
        origin = _find_origin(few[0][:_FEW], few[1][:_FEW])
        other = None if origin == (0.0, 0.0) else _clusters_seen_from(origin, slope, range_m, few)
        if other is not None and (best is None or other.sharpness > best.sharpness):
            best = other
    return None if best is None else _joined(best, azimuth, slope, range_m)


def _clusters_seen_from(
    origin: tuple[float, float], slope: Angles, range_m: Angles, few: tuple[Angles, Angles]
) -> ElevationClusters | None:
    """Return the clusters of returns (N,) at the best width, judged by ``few`` of them; None where none is sharp."""
    height_m, radius_m = origin
    counts = _count_elevations(slope, range_m, height_m, radius_m, _BIN)
    best, best_share = None, SHARPNESS
    for half_width in _HALF_WIDTHS:
        elevation = _peaks(counts, half_width, _LEAST_IN_CLUSTER)
        if not FEWEST_RINGS <= len(elevation) <= MOST_RINGS:
            continue
        origin_m = height_m - radius_m * np.tan(elevation)
        share = match_elevations(*few, elevation, origin_m).excess
        if share > best_share + (0.0 if best is None else _CLEARLY):
            best, best_share = ElevationClusters(elevation, origin_m, share), share
        if best_share > 1.0 - _CLEARLY:
            break
    return best


def _find_origin(slope: Angles, range_m: Angles) -> tuple[float, float]:
    """Return the origin from which the elevations (N,) of points gather most: its height, and the radius in meters.

    Beams that start on a circle of a radius meet the axis lower by its share of the tangent of their elevation.
    """

    def gathered(origin: tuple[float, float]) -> tuple[float, float]:
        counts = _count_elevations(slope, range_m, *origin, _COARSE_BIN).astype(np.float32)
        return float(counts @ counts), -abs(origin[0]) - origin[1]

    height_m, _ = max(((height_m, 0.0) for height_m in _HEIGHTS_M), key=gathered)
    around = [(height_m + away_m, radius_m) for radius_m in _RADII_M for away_m in _AROUND_M]
    return max(around, key=gathered)


def _joined(clusters: ElevationClusters, azimuth: Angles, slope: Angles, range_m: Angles) -> ElevationClusters:
    """Return the clusters with those joined that are one beam's: together they return no more than one beam would.

    A beam that starts away from the origin is seen under two elevations where it meets surfaces at two ranges. Two
    beams return from the same sector, one beam from either of its clusters.
    """
    for _ in range(_MOST_PARTS):
        elevation = clusters.elevation
        gap = np.diff(elevation)
        beside = np.maximum(np.append(gap[1:], 0.0), np.append(0.0, gap[:-1]))
        close = np.flatnonzero(gap < _SPLIT_GAP * beside)
        if len(close) == 0:
            return clusters
        # 1. Returns of each cluster by sector, and how many of one beam are in a full one.
        ring = match_elevations(slope, range_m, elevation, clusters.origin_m).ring
        counts = _count_sectors(ring, azimuth, len(elevation))
        full = np.quantile(counts[counts > 0], _FULL_SECTOR) if counts.any() else 0
        # 2. Pairs that are close and do not return twice as much: from the closest on, no cluster in two of them.
        pairs = counts[close] + counts[close + 1]
        doubled = (pairs > _DOUBLE * full).sum(axis=1) / np.maximum((pairs > 0.5 * full).sum(axis=1), 1)
        one = close[doubled < _DOUBLE_SHARE]
        one = one[np.argsort(gap[one], kind="stable")]
        sizes, keep, mean = counts.sum(axis=1), np.ones(len(elevation), np.bool_), elevation.copy()
        taken = np.zeros(len(elevation), np.bool_)
        for k in one:
            if not taken[k : k + 2].any():
                taken[k : k + 2], keep[k + 1] = True, False
                mean[k] = np.average(elevation[k : k + 2], weights=np.maximum(sizes[k : k + 2], 1))
        if keep.all():
            return clusters
        clusters = ElevationClusters(mean[keep], clusters.origin_m[keep], clusters.sharpness)
    return clusters


@njit("int32[::1](float32[::1], float32[::1], float64, float64, float64)", cache=True, nogil=True, error_model="numpy")
def _count_elevations(
    slope: Any, range_m: Any, height_m: float, radius_m: float, bin_sine: float
) -> Any:  # pragma: no cover - compiled
    """Return the histogram of the elevations seen from an origin, of returns beyond 0.4 m, in equal bins of their sine.

    The sine costs a square root where the angle costs an arctangent. Blocks of positions come first, since a loop that
    counts does not vectorize.
    """
    bins = int(np.ceil(2.0 / bin_sine))
    counts, position = np.zeros(bins, np.int32), np.empty(BLOCK, np.float32)
    per_sine, most = np.float32(0.5 * bins), np.float32(bins)
    height, radius = np.float32(height_m), np.float32(radius_m)
    near, one = np.float32(_NEAR_M), np.float32(1.0)
    for start in range(0, slope.shape[0], BLOCK):
        size = min(BLOCK, slope.shape[0] - start)
        for k in range(size):
            r, t = range_m[start + k], slope[start + k]
            t -= (height - radius * t) / max(r, near)
            at = (t / np.sqrt(one + t * t) + one) * per_sine
            # Not for near returns, and not where a slope is not finite.
            position[k] = at if (r > near) & (at >= np.float32(0.0)) & (at < most) else np.float32(-1.0)
        for k in range(size):
            if position[k] >= np.float32(0.0):
                counts[np.uint32(position[k])] += 1
    return counts


@njit("int32[:, ::1](int16[::1], float32[::1], int64)", cache=True, nogil=True, error_model="numpy")
def _count_sectors(ring: Any, azimuth: Any, rings: int) -> Any:  # pragma: no cover - compiled
    """Return the returns (rings, 360) of each ring in each degree of azimuth."""
    counts = np.zeros((rings, 360), np.int32)
    per_rad = np.float32(180.0 / np.pi)
    for n in range(ring.shape[0]):
        if ring[n] >= 0:
            counts[ring[n], min(max(int((azimuth[n] + np.float32(np.pi)) * per_rad), 0), 359)] += 1
    return counts


@njit("float64[::1](int32[::1], int64, float64)", cache=True, nogil=True, error_model="numpy")
def _peaks(counts: Any, half_width: int, least: float) -> Any:  # pragma: no cover - compiled
    """Return the elevations (K,) in radians of the peaks of a histogram, ascending.

    The histogram is smoothed by a triangle of ``half_width`` bins to either side and walked through once: a maximum of
    at least ``least`` is a peak once the curve has fallen to half of it, and the next one begins once the curve has
    risen to twice the lowest value since. A peak lies at the mean of the returns in its window.
    """
    bins = counts.shape[0]
    smooth = np.zeros(bins)
    for b in range(bins):
        if counts[b] > 0:
            for k in range(max(b - half_width, 0), min(b + half_width + 1, bins)):
                smooth[k] += counts[b] * (1.0 - abs(k - b) / (half_width + 1.0))
    sines = np.empty(bins // 2)
    peaks, rising, highest, at, lowest = 0, True, 0.0, 0, 0.0
    for b in range(bins):
        v = smooth[b]
        if rising:
            if v > highest:
                highest, at = v, b
            elif highest >= least and v <= 0.5 * highest:
                mass, moment = 0.0, 0.0
                for k in range(max(at - half_width, 0), min(at + half_width + 1, bins)):
                    mass += counts[k]
                    moment += counts[k] * (k + 0.5)
                sines[peaks] = min(max(moment / mass * (2.0 / bins) - 1.0, -1.0), 1.0)
                peaks += 1
                rising, lowest = False, v
        else:
            lowest = min(lowest, v)
            if v >= least and v >= 2.0 * lowest:
                rising, highest, at = True, v, b
    return np.arcsin(sines[:peaks])


def rings_by_clusters(
    azimuth: Angles, slope: Angles, range_m: Angles
) -> tuple[NDArray[np.int16], ElevationClusters] | None:
    """Return the rings (N,) told by the elevations at which the returns gather, and these; None where they do not.

    Rings are the clusters from the lowest to the highest: a beam without returns has none. -1 far from all of them.
    """
    clusters = find_clusters(azimuth, slope, range_m)
    if clusters is None:
        return None
    return match_elevations(slope, range_m, clusters.elevation, clusters.origin_m).ring, clusters
