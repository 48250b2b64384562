"""Beams without a return: which ones a sweep lacks, where they aimed, and how far each of them is likely to have gone.

The beams are the pixels of a range image, ring by azimuth column. A pixel without a return is a no-return beam, unless
one within four columns of its ring holds two: then the azimuth only jittered.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed import _core
from viewshed._numba import atan2
from viewshed.fov.height_map import LatticePositions, lattice_positions
from viewshed.fov.visibility import Beams
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, range_limits
from viewshed.preprocess.range_image import RangeImage, range_image_by_rings
from viewshed.preprocess.ring_recovery import recover_rings

FILL_COLUMNS = 16
"""A gap is filled from returns in the same ring at most this many columns away."""

JITTER_COLUMNS = 4
"""A point may lie this many columns from the firing that it belongs to."""

GAP_M = 1.5
"""A gap between two returns that is narrower than this, measured at the nearer one, lies on what the two lie on ..."""

SIMILAR = 1.25
"""... if the ratio of their ranges is below this."""

EXPECTED_SHARE = 0.9
"""Where a larger share of the ground gives returns, a beam without one did not meet the ground."""

STEEP = 4.0
"""Ground nearer than this many sensor heights (seen at 14° or more) is always expected to return."""

SHARE_BIN_M = 2.5
"""The share of ground that returns is learned in bins of this width ..."""

SHARE_BINS = 52
"""... of this number; the last one holds everything beyond ..."""

SHARE_SECTORS = 24
"""... and in so many sectors of azimuth, so that one thing that swallows light does not decide."""

PRIOR_BEAMS = 20
"""The share of a bin starts from that of the bin before, as if so many beams had shown it."""

WEIGHTY = 0.02
"""Nearer ground returns at least as often as that of a bin with this share of all returns from ground."""

REACH_SHARE = 0.001
"""Beyond some range lies only this share of the returns: that far the sensor reaches in this air, ..."""

BEYOND_REACH = 2.0
"""... and so much farther a target would still be seen, for it faces the beams, which graze the ground."""

_REACH_BINS = 512
"""Bins of one meter in which returns are counted for the reach."""

_NEIGHBOR_RINGS = 8
"""The next return below or above in a column is at most so many rings away."""

_SECTORS = 128

_RANGES_M = np.geomspace(1.0, 128.0, 113)

Floats = NDArray[np.float32]

Pixels = NDArray[np.int32]
"""Ring and column (M, 2) of beams, by ascending ring."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamsByEvidence:
    """The beams of a sweep by what is known of their depth.

    Attributes:
        measured: beams of returns; those of isolated ones point straight up and meet nothing.
        inferred: without a return, as deep as :func:`beams_by_evidence` infers.
        unresolved: all others that aim no higher than a target's top; +inf deep, since where they ended is not known.
    """

    measured: Beams
    inferred: Beams
    unresolved: Beams


def no_return_beams(leveled: LeveledSweep, *, fill: bool) -> Beams:
    """Return the beams that did not return, in the ``level`` frame.

    Without ``fill`` the depth is +inf; with it, that of the nearer of the two neighbors in the ring within 16 columns,
    and beams without such neighbors are left out.
    """
    # Isolated returns are returns here; clutter is not.
    image = _image_of_beams(leveled)
    depths = _depth_images(leveled, image, _clutter(leveled))
    pixels, ends_m, steps = find_no_return(depths.counts, depths.range_m, False, _core.silent_columns(depths.counts))
    azimuth, slope = _directions(pixels, np.tan(image.elevation), image.phase, _rotation(leveled), image.columns)
    if not fill:
        return Beams(azimuth, slope, np.full(len(pixels), np.inf, np.float32))
    depth_m = np.where(steps <= FILL_COLUMNS, ends_m, np.float32(np.inf)).min(axis=1, initial=np.float32(np.inf))
    keep = depth_m < np.inf
    return Beams(azimuth[keep], slope[keep], depth_m[keep])


def beams_by_evidence(leveled: LeveledSweep, top_m: float) -> BeamsByEvidence:
    """Split the beams of a sweep, in ``level``, into measured, inferred and unresolved depth.

    An isolated return is no evidence of a depth: its beam counts as one without a return, and what is learned is
    learned without it. A beam without a return is inferred from its surroundings:

    1. A gap narrower than 1.5 m between two returns of similar range, in a ring, or in a column between two returns
       from obstacles: as far as the nearer of the two.
    2. A beam that aims above the ground, or at ground from which few beams return (by range, learned from the sweep):
       as far as that ground, but no farther than an obstacle beside it in its ring or next above it, nor than a beam
       of the same gap stopped by rule 1 within 1.5 m, nor than twice as far as the sweep has returns.
    3. All others are unresolved: those at ground that should have returned, and beams above one of them (something
       that swallows light, glass, an attack). Rings and columns without any return (dead, dropped) have no beams.

    Beams that pass above targets of height ``top_m`` wherever they stand are left out. Of a cloud without a ring column
    and without a model it is not known which beams it lacks: it has measured ones alone.
    """
    image = None if leveled.sensor_id.ring is None else _image_of_beams(leveled)
    if image is None or not image.pixels_are_beams:
        none = Beams(*np.zeros((3, 0), np.float32))
        return BeamsByEvidence(leveled.beams(), none, none)
    return BeamsByEvidence(leveled.beams(image.isolated), *_infer_no_return_beams(leveled, image, top_m))


def _infer_no_return_beams(leveled: LeveledSweep, image: RangeImage, top_m: float) -> tuple[Beams, Beams]:
    """Return the inferred and the unresolved beams; the rules are those of :func:`beams_by_evidence`."""
    rotation, tangent = _rotation(leveled), np.tan(image.elevation)
    steep_m = np.float32(STEEP * leveled.sensor_height_m)  # nearer ground always returns
    # The depth of each pixel without isolated returns (and clutter).
    clutter = _clutter(leveled)
    depths = _depth_images(leveled, image, image.isolated if clutter is None else image.isolated | clutter)
    # The beams that are missing, of rings that may reach a target, and where they aimed.
    ground_slope = _ground_slopes(leveled)
    highest = _highest_slopes(ground_slope, top_m)
    rings = _rings_below(float(highest.max()), tangent, rotation)
    counts = depths.counts[:rings]
    pixels, ends_m, steps = find_no_return(counts, depths.range_m, True, _core.silent_columns(counts))
    azimuth, slope = _directions(pixels, tangent, image.phase, rotation, image.columns)
    rise_m = image.origin_m[pixels[:, 0]].astype(np.float32)
    # Rule 1: narrow gaps in a ring, then in a column; beams beside them in the same gap are bounded by what they meet.
    gap_m = _narrow_gaps(ends_m, steps, image.columns)
    _fill_column_gaps(pixels, depths.obstacle_m, depths.counts, tangent, gap_m)
    bound_m = _nearest_obstacles(pixels, depths.obstacle_m)
    _bound_beside_gaps(pixels, gap_m, bound_m, image.columns)
    # Rules 2 and 3: where each beam would have met the ground, and the share of beams that return from there.
    ground_m = _meet_ground(azimuth, slope, rise_m, ground_slope, _RANGES_M)
    share = _returning_shares(depths.ground_counts, pixels, gap_m, bound_m, ground_m, steep_m, image.columns)
    reach_m = BEYOND_REACH * _reach_m(depths.meter_counts)
    depth_m = _infer_depths(
        pixels, gap_m, bound_m, ground_m, share, EXPECTED_SHARE, steep_m, reach_m, depths.counts
    )  # fmt: skip
    inferred, unresolved = _split_by_depth(azimuth, slope, rise_m, depth_m, highest, steep_m)
    return Beams(*inferred), Beams(*unresolved)


def _image_of_beams(leveled: LeveledSweep) -> RangeImage:
    """Return the sweep's range image if its pixels are beams, else one by its rings and measured columns."""
    image = leveled.range_image
    if image is not None and image.pixels_are_beams:
        return image
    sweep, sensor_id = leveled.sweep, leveled.sensor_id
    rings = recover_rings(sweep, sensor_id.model, sensor_id.ring)
    return range_image_by_rings(sweep.points, rings, range_limits(sweep))


def _clutter(leveled: LeveledSweep) -> NDArray[np.bool_] | None:
    """Return the clutter (N,) that the leveled sweep lacks, None where there is none."""
    return None if leveled.range_image is None else leveled.range_image.clutter


def _rotation(leveled: LeveledSweep) -> NDArray[np.float64]:
    return leveled.level_from_sensor.rotation


@dataclass(frozen=True, slots=True, eq=False)
class _DepthImages:
    """What the leveled returns of a range image measure in ``level``, by pixels (rings, columns) and by range.

    Attributes:
        counts: uint8 returns of each pixel, up to 255.
        range_m: float32 horizontal range of the nearest one, +inf for none.
        obstacle_m: the same among those on obstacles.
        ground_counts: (SHARE_SECTORS, SHARE_BINS) returns from ground beyond the steep part, by azimuth and range.
        meter_counts: (_REACH_BINS,) returns in each meter of range.
    """

    counts: NDArray[np.uint8]
    range_m: Floats
    obstacle_m: Floats
    ground_counts: NDArray[np.int64]
    meter_counts: NDArray[np.int64]


def _depth_images(leveled: LeveledSweep, image: RangeImage, left_out: NDArray[np.bool_] | None) -> _DepthImages:
    """Return the depths of the leveled returns, without those ``left_out`` (N,) of the sweep."""
    column, counts = (image.column, image.counts) if left_out is None else image.pixels_without(left_out)
    range_m, obstacle_m = np.full(counts.shape, np.inf, np.float32), np.full(counts.shape, np.inf, np.float32)
    ground_counts, meter_counts = np.zeros((SHARE_SECTORS, SHARE_BINS), np.int64), np.zeros(_REACH_BINS, np.int64)
    _fill_depth_images(
        image.ring,
        column,
        leveled.rows,
        leveled.range_m,
        leveled.height_m,
        np.float32(OBSTACLE_HEIGHTS_M[0]),
        np.float32(STEEP * leveled.sensor_height_m),
        range_m,
        obstacle_m,
        ground_counts,
        meter_counts,
    )
    return _DepthImages(counts, range_m, obstacle_m, ground_counts, meter_counts)


def _ground_slopes(leveled: LeveledSweep) -> Floats:
    """Return the slope from the sensor to the ground (sectors, ranges)."""
    ground = leveled.ground
    positions = _polar_positions(ground.half_extent_m, len(ground.heights_m))
    height_m = ground.at_positions(positions) - np.float32(leveled.sensor_height_m)
    return (height_m / _RANGES_M.astype(np.float32)).astype(np.float32, copy=False)


@lru_cache(maxsize=8)
def _polar_positions(half_extent_m: float, nodes: int) -> LatticePositions:
    """Return the positions on the ground's lattice of so many sectors and ranges."""
    azimuth = (np.arange(_SECTORS) + 0.5) * (2 * np.pi / _SECTORS) - np.pi
    xy = np.stack([np.outer(np.cos(azimuth), _RANGES_M), np.outer(np.sin(azimuth), _RANGES_M)], -1)
    return lattice_positions(xy, half_extent_m, nodes)


def _highest_slopes(ground_slope: Floats, top_m: float) -> Floats:
    """Return the steepest slope (sectors,) from the sensor to the top of a target, wherever it stands."""
    highest: Floats = (ground_slope + (top_m / _RANGES_M).astype(np.float32)).max(axis=1)
    return highest


def _rings_below(slope: float, tangent: NDArray[np.float64], rotation: NDArray[np.float64]) -> int:
    """Return how many rings, from the lowest and at least one, may have a beam below ``slope`` in ``level``."""
    tilt = np.arccos(np.clip(rotation[2, 2], -1.0, 1.0))
    below = np.flatnonzero(np.arctan(tangent) - tilt <= np.arctan(slope))
    return int(below[-1]) + 1 if below.size else 1


def _reach_m(meter_counts: NDArray[np.int64]) -> float:
    """Return the range beyond which lies ``REACH_SHARE`` of the returns."""
    beyond = np.cumsum(meter_counts[::-1])[::-1]
    return float(np.count_nonzero(beyond > REACH_SHARE * beyond[0]))


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_depth_images(
    ring: Any,
    column: Any,
    rows: Any,
    range_m: Any,
    height_m: Any,
    low_m: Any,
    steep_m: Any,
    nearest_m: Any,
    obstacle_m: Any,
    ground_counts: Any,
    meter_counts: Any,
) -> None:  # pragma: no cover - compiled
    """Lower the images (rings, columns) of depth and of obstacles to leveled returns, and count those by range.

    Returns higher than ``low_m`` above the ground are on obstacles. Others count as ground beyond ``steep_m``.
    """
    last = np.uint32(meter_counts.shape[0] - 1)
    per_bin, per_column = np.float32(1.0 / SHARE_BIN_M), np.float32(SHARE_SECTORS / nearest_m.shape[1])
    for k in range(rows.shape[0]):
        n, d = np.uint64(rows[k]), range_m[k]
        high = height_m[k] > low_m
        if column[n] >= 0:
            r, c = np.uint32(ring[n]), np.uint32(column[n])
            meter_counts[min(np.uint32(d), last)] += 1
            if not high and d > steep_m:
                ground_counts[np.uint32(c * per_column), min(np.uint32(d * per_bin), np.uint32(SHARE_BINS - 1))] += 1
            nearest_m[r, c] = min(nearest_m[r, c], d)
            if high:
                obstacle_m[r, c] = min(obstacle_m[r, c], d)


@njit(cache=True, nogil=True, error_model="numpy")
def find_no_return(counts: Any, depth_m: Any, awake: bool, silent: Any) -> Any:  # pragma: no cover - compiled
    """Return ring and column (M, 2) of the no-return beams, lowest ring first, and the returns around them in the ring.

    Of the nearest pixel with a return on each side: depth (M, 2), +inf for none, and steps in columns (M, 2). With
    ``awake`` only beams of rings that have returns, and of columns that are not ``silent`` (columns,).
    """
    rings, columns = counts.shape
    size = counts.size - np.count_nonzero(counts)
    pixels = np.empty((size, 2), np.int32)
    ends_m = np.full((size, 2), np.inf, np.float32)
    steps = np.full((size, 2), columns, np.int32)
    m = 0
    for r in range(rings):
        if awake and not counts[r].any():
            continue
        empty = _empty_columns(counts[r])
        around = _columns_around(counts[r], empty)
        for k in range(empty.shape[0]):
            c = empty[k]
            if awake and silent[c]:
                continue
            pixels[m, 0], pixels[m, 1] = r, c
            for side in range(2):
                at = around[k, side]
                if at != c:
                    steps[m, side] = abs(at - c)
                    ends_m[m, side] = depth_m[r, at % columns]
            m += 1
    return pixels[:m], ends_m[:m], steps[:m]


@njit(cache=True, nogil=True, error_model="numpy")
def _empty_columns(counts: Any) -> Any:  # pragma: no cover - compiled
    """Columns of one ring without a point, less one for each double within ``JITTER_COLUMNS`` before or after it."""
    columns = counts.shape[0]
    empty = np.empty(columns, np.int64)
    m, doubles, doubles_at = 0, 0, -columns
    for c in range(columns):
        if c - doubles_at > JITTER_COLUMNS:
            doubles = 0
        # A second return belongs to the last empty column if that is near, else to one that follows.
        for _ in range(counts[c] - 1):
            if m > 0 and c - empty[m - 1] <= JITTER_COLUMNS:
                m -= 1
            else:
                doubles, doubles_at = doubles + 1, c
        if counts[c] == 0 and doubles > 0:
            doubles -= 1
        elif counts[c] == 0:
            empty[m] = c
            m += 1
    return empty[:m]


@njit(cache=True, nogil=True, error_model="numpy")
def _columns_around(counts: Any, empty: Any) -> Any:  # pragma: no cover - compiled
    """Return the columns of the nearest returns before and after each empty column (E, 2), unwrapped around the circle.

    The column itself stands for none. Each search ends at the empty column before, which has its answer already.
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
def _directions(
    pixels: Any, tangent: Any, phase: Any, rotation: Any, columns: int
) -> Any:  # pragma: no cover - compiled
    """Return azimuth (M,) and slope (M,) in ``level`` of the beams of pixels (M, 2)."""
    count = pixels.shape[0]
    azimuth, slope = np.empty(count, np.float32), np.empty(count, np.float32)
    # Cosine and sine of each column's edge once; those of a ring's phase are added by the angle sum.
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


@njit(cache=True, nogil=True, error_model="numpy")
def _narrow_gaps(ends_m: Any, steps: Any, columns: int) -> Any:  # pragma: no cover - compiled
    """Return the nearer end (M,) of gaps in a ring that are narrow and whose ends have similar depths, else NaN."""
    gap_m = np.full(ends_m.shape[0], np.nan, np.float32)
    step = np.float32(2 * np.pi / columns)
    for n in range(ends_m.shape[0]):
        near, far = min(ends_m[n, 0], ends_m[n, 1]), max(ends_m[n, 0], ends_m[n, 1])
        if far < SIMILAR * near and (steps[n, 0] + steps[n, 1]) * step * near < GAP_M:
            gap_m[n] = near
    return gap_m


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_column_gaps(
    pixels: Any, obstacle_m: Any, counts: Any, tangent: Any, gap_m: Any
) -> None:  # pragma: no cover - compiled
    """Lower ``gap_m`` (M,) to the nearer of the obstacles next below and above in the column, if similar and close."""
    for n in range(pixels.shape[0]):
        r, c = pixels[n, 0], pixels[n, 1]
        low, high = _next_in_column(counts, r, c, -1), _next_in_column(counts, r, c, 1)
        if low < 0 or high < 0:
            continue
        near, far = min(obstacle_m[low, c], obstacle_m[high, c]), max(obstacle_m[low, c], obstacle_m[high, c])
        if far < SIMILAR * near and (tangent[high] - tangent[low]) * near < GAP_M:
            gap_m[n] = near if np.isnan(gap_m[n]) else min(gap_m[n], near)


@njit(cache=True, nogil=True, error_model="numpy")
def _next_in_column(counts: Any, r: Any, c: Any, step: Any) -> Any:  # pragma: no cover - compiled
    """Return the next ring below (-1) or above (1) with a return in a column; -1 where there is none nearby."""
    for _ in range(_NEIGHBOR_RINGS):
        r += step
        if r < 0 or r >= counts.shape[0]:
            return -1
        if counts[r, c] > 0:
            return r
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_obstacles(pixels: Any, obstacle_m: Any) -> Any:  # pragma: no cover - compiled
    """Return the nearest obstacle (M,) among the two pixels beside each beam and the three above it."""
    rings, columns = obstacle_m.shape
    nearest = np.full(pixels.shape[0], np.inf, np.float32)
    for n in range(pixels.shape[0]):
        r, c = pixels[n, 0], pixels[n, 1]
        before, after = (c - 1 if c > 0 else columns - 1), (c + 1 if c + 1 < columns else 0)
        nearest[n] = min(obstacle_m[r, before], obstacle_m[r, after])
        if r + 1 < rings:
            nearest[n] = min(nearest[n], obstacle_m[r + 1, before], obstacle_m[r + 1, c], obstacle_m[r + 1, after])
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def _bound_beside_gaps(pixels: Any, gap_m: Any, bound_m: Any, columns: int) -> None:  # pragma: no cover - compiled
    """Lower ``bound_m`` (M,) to ``gap_m`` of beams in the same gap of the ring that passed closer than ``GAP_M``.

    Once in the order of the columns and once against it, as the stopped beam may lie on either side.
    """
    per_column = np.float32(2 * np.pi / columns)
    count = pixels.shape[0]
    for direction in range(2):
        at, near = 0, np.float32(np.inf)
        for k in range(count):
            n = k if direction == 0 else count - 1 - k
            last = n - 1 if direction == 0 else n + 1
            # A new gap begins: another ring, or a return between the two beams.
            if k == 0 or pixels[n, 0] != pixels[last, 0] or abs(pixels[n, 1] - pixels[last, 1]) > 1:
                near = np.float32(np.inf)
            if not np.isnan(gap_m[n]):
                at, near = pixels[n, 1], gap_m[n]
            elif abs(pixels[n, 1] - at) * per_column * near < GAP_M / 2:
                bound_m[n] = min(bound_m[n], near)


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_ground(
    azimuth: Any, slope: Any, rise_m: Any, ground_slope: Any, ranges_m: Any
) -> Any:  # pragma: no cover - compiled
    """Return the range (M,) at which beams first meet the ground, +inf where they do not.

    ``ground_slope`` (sectors, ranges) is the slope from the sensor to the ground; beams start ``rise_m`` (M,) higher.
    """
    # The steepest ground up to each range ascends, so that a beam's first crossing is found by bisection.
    sectors, bins = ground_slope.shape
    highest = np.empty_like(ground_slope)
    for s in range(sectors):
        highest[s, 0] = ground_slope[s, 0]
        for k in range(1, bins):
            highest[s, k] = max(highest[s, k - 1], ground_slope[s, k])
    ground_m = np.full(azimuth.shape[0], np.inf, np.float32)
    per_rad = np.float32(sectors / (2 * np.pi))
    for n in range(azimuth.shape[0]):
        s = min(max(int((azimuth[n] + np.float32(np.pi)) * per_rad), 0), sectors - 1)
        row = highest[s]
        ground_m[n] = _crossing(row, ranges_m, slope[n])
        # A beam that starts higher looks less steep from the sensor's origin: once more with the slope at that range.
        if rise_m[n] != 0.0 and ground_m[n] < np.inf:
            ground_m[n] = _crossing(row, ranges_m, slope[n] + rise_m[n] / ground_m[n])
    return ground_m


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
def _returning_shares(
    ground_counts: Any, pixels: Any, gap_m: Any, bound_m: Any, ground_m: Any, steep_m: Any, columns: int
) -> Any:  # pragma: no cover - compiled
    """Return the share of the beams at ground that return, in each bin of range: the median over the sectors."""
    # Beams at open ground that did not return: no gap, and no obstacle before the ground.
    lost = np.zeros_like(ground_counts)
    for n in range(ground_m.shape[0]):
        if np.isnan(gap_m[n]) and bound_m[n] > ground_m[n] - 1.0 and steep_m < ground_m[n] < np.inf:
            lost[pixels[n, 1] * SHARE_SECTORS // columns, min(int(ground_m[n] / SHARE_BIN_M), SHARE_BINS - 1)] += 1
    # Outwards: each bin starts from the one before.
    share = np.empty(SHARE_BINS)
    before = 1.0
    for k in range(SHARE_BINS):
        beams = ground_counts[:, k].sum() + lost[:, k].sum()
        before = (beams * _median_share(ground_counts[:, k], lost[:, k]) + PRIOR_BEAMS * before) / (beams + PRIOR_BEAMS)
        share[k] = before
    # Inwards: nearer ground returns at least as often as well observed ground farther away.
    farther, enough = 0.0, WEIGHTY * ground_counts.sum()
    for k in range(SHARE_BINS - 1, -1, -1):
        if ground_counts[:, k].sum() > enough:
            farther = max(farther, share[k])
        share[k] = max(share[k], farther)
    return share


@njit(cache=True, nogil=True, error_model="numpy")
def _median_share(returned: Any, lost: Any) -> Any:  # pragma: no cover - compiled
    """Return the median of the sectors' shares, weighted with their beams; 0 without any."""
    beams = returned + lost
    share = returned / np.maximum(beams, 1)
    seen, half = 0, beams.sum() / 2
    for s in np.argsort(share):
        seen += beams[s]
        if seen > half:
            return share[s]
    return 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _infer_depths(
    pixels: Any,
    gap_m: Any,
    bound_m: Any,
    ground_m: Any,
    share: Any,
    expected_share: Any,
    steep_m: Any,
    reach_m: Any,
    counts: Any,
) -> Any:  # pragma: no cover - compiled
    """Return how far each beam went (M,), NaN where nothing explains it. ``pixels`` ascend by ring.

    Args: ``gap_m`` the nearer end of a narrow gap (NaN for none), ``bound_m`` the nearest obstacle around, ``ground_m``
    where it would meet the ground, ``share`` of the beams there that return; from ``expected_share`` on, and up to
    ``steep_m``, a return is expected. Nothing is said of what lies beyond ``reach_m``.
    """
    below = _ring_below(counts)
    unexplained_at = np.full(counts.shape[1], -2, np.int64)  # the last ring of each column that nothing explains
    depth_m = np.full(pixels.shape[0], np.nan, np.float32)
    for n in range(pixels.shape[0]):
        r, c = pixels[n, 0], pixels[n, 1]
        lost = ground_m[n] == np.inf
        if steep_m < ground_m[n] < np.inf:
            lost = share[min(int(ground_m[n] / SHARE_BIN_M), SHARE_BINS - 1)] < expected_share
        if not np.isnan(gap_m[n]):
            depth_m[n] = gap_m[n]
        elif lost and unexplained_at[c] != below[r]:
            depth_m[n] = min(ground_m[n], bound_m[n], reach_m)
        else:
            unexplained_at[c] = r
    return depth_m


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
def _split_by_depth(
    azimuth: Any, slope: Any, rise_m: Any, depth_m: Any, highest: Any, steep_m: Any
) -> Any:  # pragma: no cover - compiled
    """Return azimuth, slope and depth (3, …) of the beams whose depth is known, and of the others, which are endless.

    Beams steeper than ``highest`` (sectors,) are in neither. Slopes are seen from the sensor's origin afterwards: a
    beam starts ``rise_m`` higher.
    """
    sectors, count, m, k = highest.shape[0], azimuth.shape[0], 0, 0
    known, endless = np.empty((3, count), np.float32), np.empty((3, count), np.float32)
    per_rad = np.float32(sectors / (2 * np.pi))
    for n in range(count):
        seen_slope = slope[n] + rise_m[n] / (depth_m[n] if depth_m[n] > steep_m else steep_m)
        sector = min(max(int((azimuth[n] + np.float32(np.pi)) * per_rad), 0), sectors - 1)
        if seen_slope > highest[sector]:
            continue
        if np.isfinite(depth_m[n]):
            known[0, m], known[1, m], known[2, m] = azimuth[n], seen_slope, depth_m[n]
            m += 1
        else:
            endless[0, k], endless[1, k], endless[2, k] = azimuth[n], seen_slope, np.inf
            k += 1
    return known[:, :m], endless[:, :k]
