"""Convert ring numbers, azimuths and times of files with another order, sign, zero or unit to ours."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.sensors import MAX_RINGS, LidarModel
from viewshed.sweep import REVOLUTION_S

_MAX_QUARTILE_RANGE = np.deg2rad(1.0)

_MIN_CORRELATION = 0.9

_MAX_AZIMUTH_ERROR = np.deg2rad(6.0)

_SECTOR, _MIN_NEIGHBORS = 0.035, 200
"""Tangent of the half-width of the four sectors used (front, rear, left, right), and their minimum of returns."""

_MAX_RING_STD = np.deg2rad(2.0)

_MAX_DIFF_RATIO = 0.7

_CONVENTIONS = tuple(product((1.0, np.pi / 180, np.pi / 18000), (1.0, -1.0), (0.0, np.pi / 2, np.pi, -np.pi / 2)))


def rings_by_elevation(
    laser: NDArray[np.int64], points: NDArray[np.float32], model: LidarModel | None = None
) -> NDArray[np.int16]:
    """Return the ring (N,) int16, 0 the lowest, of beams numbered in a file's own order.

    The order is determined from each beam's median elevation. Ascending numbers are kept and descending ones reversed,
    so that a beam without returns keeps its number. Any other order is replaced by the rank of the median elevation, or
    by the nearest beam of ``model`` if that has more beams. If the spread of elevation within beams is too large to
    rank them (points that are not in the sensor's frame), numbers are only kept or reversed.

    >>> up = np.array([[5.0, 0.0, 1.0], [5.0, 0.0, 0.0], [5.0, 0.0, -1.0]], np.float32)
    >>> rings_by_elevation(np.array([0, 1, 2]), up).tolist()
    [2, 1, 0]
    """
    if laser.size == 0:
        return laser.astype(np.int16)
    if laser.min() < 0 or laser.max() >= MAX_RINGS:
        raise ValueError(f"ring must lie in [0, {MAX_RINGS}), got {laser.min()}…{laser.max()}")
    beams, median, tight = _beam_elevations(laser, points)
    last = int(laser.max()) if model is None else max(model.rings - 1, int(laser.max()))
    table = np.arange(last + 1)
    order = _order(median)
    if order == 0 and tight and beams.size > 2:
        table[beams] = _ranks(median, model)
    elif order < 0:
        table = table[::-1]
    return np.asarray(table[laser], dtype=np.int16)


def _beam_elevations(
    laser: NDArray[np.int64], points: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.float64], bool]:
    """Return the beams (K,) with finite returns, their median elevations, and whether their quartile range is small."""
    with np.errstate(invalid="ignore", over="ignore"):
        elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]), dtype=np.float64)
        usable = np.isfinite(points).all(axis=1) & (points != 0).any(axis=1)
    if not usable.any():
        return np.unique(laser), np.zeros(np.unique(laser).size), False
    laser, elevation = laser[usable], elevation[usable]
    order = np.argsort(laser, kind="stable")
    beams, first = np.unique(laser[order], return_index=True)
    groups = np.split(elevation[order], first[1:])
    quarters = np.array([np.percentile(group, (25, 50, 75)) for group in groups])
    return beams, quarters[:, 1], bool(np.median(quarters[:, 2] - quarters[:, 0]) < _MAX_QUARTILE_RANGE)


def _order(median: NDArray[np.float64]) -> int:
    """Return +1 if elevation ascends with the beam number, -1 if it descends, 0 if neither."""
    if median.size < 2 or (np.diff(median) >= 0).all():
        return 1
    if (np.diff(median) <= 0).all():
        return -1
    rank = np.argsort(np.argsort(median))
    correlation = float(np.corrcoef(np.arange(median.size), rank)[0, 1])
    return 0 if abs(correlation) < _MIN_CORRELATION else int(np.sign(correlation))


def _ranks(median: NDArray[np.float64], model: LidarModel | None) -> NDArray[np.int64]:
    if model is not None and model.rings > median.size:
        nearest: NDArray[np.int64] = np.abs(model.elevation[None, :] - median[:, None]).argmin(axis=1)
        if np.unique(nearest).size == nearest.size:
            return nearest
    return np.argsort(np.argsort(median, kind="stable"))


def problem_of_rings(ring: NDArray[Any], points: NDArray[np.float32]) -> str | None:
    """Return why a column (N,) cannot be the rings of points (N, 3), or None if it can.

    Returns that are neighbors as seen from the origin have similar rings, in any frame and ring order. In a column of
    something else, neighbors differ as much as any two returns.
    """
    if ring.size == 0:
        return None
    low, high = int(ring.min()), int(ring.max())
    if low < 0 or high >= MAX_RINGS:
        return f"rings must lie in [0, {MAX_RINGS}), got {low}…{high}"
    count, elevation_std, neighbor_diff, mean_diff = _core.spread_of_rings(points, ring.astype(np.int16), _SECTOR)
    if count < _MIN_NEIGHBORS:
        return None
    if low == high:
        return f"every return has ring {low}" if elevation_std > _MAX_RING_STD else None
    return "returns beside each other are of rings far apart" if neighbor_diff > _MAX_DIFF_RATIO * mean_diff else None


def matched_azimuth(value: NDArray[np.floating], points: NDArray[np.float32]) -> NDArray[np.float32] | None:
    """Convert a file's azimuth column (N,) to radians in [-π, π], counter-clockwise from x; None if it is no azimuth.

    Formats differ in unit, sign and zero: the convention that agrees best with the points is used. If its median error
    exceeds 6° (no azimuth at all, or one of another frame), the result is None.
    """
    usable = np.isfinite(points).all(axis=1) & (points[:, :2] != 0).any(axis=1) & np.isfinite(value)
    if not usable.any():
        return None
    sample = np.flatnonzero(usable)[:: max(1, int(usable.sum()) // 2000)]
    measured = np.arctan2(points[sample, 1], points[sample, 0], dtype=np.float64)
    angle = value[sample].astype(np.float64)
    best = (np.inf, 1.0, 0.0)
    for scale, sign, zero in _CONVENTIONS:
        error = float(np.median(np.abs(_wrapped(sign * scale * angle + zero - measured))))
        best = min(best, (error, sign * scale, zero))
    if best[0] > _MAX_AZIMUTH_ERROR:
        return None
    filled = np.where(np.isfinite(value), value, 0.0).astype(np.float64)
    return _wrapped(best[1] * filled + best[2]).astype(np.float32)


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.mod(angle + np.pi, 2 * np.pi) - np.pi


def matched_time_s(value: NDArray[np.generic]) -> NDArray[np.float32] | None:
    """Convert a file's time column (N,) to seconds since its minimum; None if not finite or over one revolution.

    Integers are nanoseconds, floats are seconds; one revolution lasts at most :data:`REVOLUTION_S`.

    >>> matched_time_s(np.array([5_000_000, 0], np.uint32)).tolist()
    [0.004999999888241291, 0.0]
    """
    if value.size == 0:
        return None
    low, high = value.min().item(), value.max().item()  # Python integers: a difference of two int64 may overflow
    scale = 1e-9 if value.dtype.kind in "iu" else 1.0
    if not (high - low) * scale <= REVOLUTION_S:  # also true for NaN
        return None
    since = value - value.min()
    return np.asarray(since * np.float32(scale), dtype=np.float32)


def instant_ns(value: NDArray[np.generic]) -> int | None:
    """Return the minimum of a file's time column (N,) in nanoseconds since 1970; None if its epoch is another one.

    Integers are nanoseconds, floats are seconds. The epoch is taken to be 1970 if the time is between 2000 and 2100.

    >>> instant_ns(np.array([1617745958.75, 1617745958.85])), instant_ns(np.array([0.0, 0.1]))
    (1617745958750000000, None)
    """
    if value.size == 0 or not np.isfinite(value.min()):
        return None
    earliest = value.min().item()
    # Rounded to microseconds: float64 seconds since 1970 are exact to a quarter of one.
    earliest_ns = earliest if value.dtype.kind in "iu" else round(earliest * 1e6) * 1000
    return earliest_ns if 946_684_800 <= earliest_ns / 1e9 < 4_102_444_800 else None


def valid_rings(value: NDArray[Any]) -> NDArray[np.int64] | None:
    """Return a file's ring column (N,) as int64; None if it is not integers in [0, MAX_RINGS)."""
    number = value.astype(np.float64)
    if number.size and not ((number >= 0) & (number < MAX_RINGS) & (number == np.floor(number))).all():
        return None
    return number.astype(np.int64)
