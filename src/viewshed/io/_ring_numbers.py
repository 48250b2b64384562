"""Ring numbers and azimuths of files that have their own order and sign for them."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.sensors import MAX_RINGS, LidarModel

_U = np.uint64


@njit(cache=True, nogil=True)
def split_xyzi(raw: NDArray[np.float32], points: NDArray[np.float32], intensity: NDArray[np.float32]) -> None:
    """Split rows x, y, z, intensity (4 N,) into points (3 N,) and intensity (N,)."""
    for i in range(_U(intensity.size)):
        j = _U(4) * i
        k = _U(3) * i
        points[k] = raw[j]
        points[k + _U(1)] = raw[j + _U(1)]
        points[k + _U(2)] = raw[j + _U(2)]
        intensity[i] = raw[j + _U(3)]


@njit(cache=True, nogil=True)
def split_xyzir(
    raw: NDArray[np.float32],
    points: NDArray[np.float32],
    intensity: NDArray[np.float32],
    ring: NDArray[np.float32],
    quarter_turn: bool,
) -> None:
    """Split rows x, y, z, intensity, ring (5 N,) into points (3 N,), intensity (N,) and ring (N,).

    With ``quarter_turn`` points are (y, -x, z): nuScenes' x right, y forward becomes x forward, y left.
    """
    if quarter_turn:
        for i in range(_U(intensity.size)):
            j = _U(5) * i
            k = _U(3) * i
            points[k] = raw[j + _U(1)]
            points[k + _U(1)] = -raw[j]
            points[k + _U(2)] = raw[j + _U(2)]
            intensity[i] = raw[j + _U(3)]
            ring[i] = raw[j + _U(4)]
    else:
        for i in range(_U(intensity.size)):
            j = _U(5) * i
            k = _U(3) * i
            points[k] = raw[j]
            points[k + _U(1)] = raw[j + _U(1)]
            points[k + _U(2)] = raw[j + _U(2)]
            intensity[i] = raw[j + _U(3)]
            ring[i] = raw[j + _U(4)]


@njit(cache=True, nogil=True)
def whole_numbers(values: NDArray[np.float32], whole: NDArray[np.int16]) -> int:
    """Write values (N,) as 16-bit integers; return how many are not such numbers."""
    bad = np.int32(0)
    for i in range(_U(values.size)):
        number = np.int16(np.int32(values[i]))
        whole[i] = number
        bad += np.int32(np.float32(number) != values[i])
    return int(bad)


@njit(cache=True, nogil=True)
def plausible_rows(raw: NDArray[np.float32], columns: int) -> bool:
    """Return whether rows (N · columns,) read as meters within 10 km, an intensity ≥ 0 and, if five, a ring in 0…127.

    Rows that are not finite say nothing.
    """
    for start in range(0, raw.size // columns * columns, columns):
        finite = True
        for k in range(columns):
            finite &= np.isfinite(raw[start + k])
        far = max(abs(raw[start]), abs(raw[start + 1]), abs(raw[start + 2]))
        if finite and (far > 1e4 or raw[start + 3] < 0 or raw[start + 3] > 1e6):
            return False
        ring = raw[start + columns - 1]
        if finite and columns == 5 and (ring < 0 or ring > 127 or ring != np.floor(ring)):
            return False
    return True


@njit(cache=True, nogil=True)
def move_points(points: NDArray[np.float32], rotation: NDArray[np.float64], shift: NDArray[np.float64]) -> None:
    """Replace points (N, 3) by ``rotation @ point + shift``, computed in float64, in place."""
    for i in range(_U(points.shape[0])):
        x = np.float64(points[i, 0])
        y = np.float64(points[i, 1])
        z = np.float64(points[i, 2])
        for k in range(3):
            moved = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z + shift[k]
            points[i, k] = np.float32(moved)


@njit(cache=True, nogil=True)
def unpack_lzf(packed: NDArray[np.uint8], unpacked: NDArray[np.uint8]) -> int:
    """Decode an LZF stream into ``unpacked``; return the bytes written, or -1 where the stream is damaged.

    Stream of M. Lehmann's liblzf: control < 32 is a run of control + 1 literals, else a back reference of length
    (control >> 5) + 2 (+ one more byte if that field is 7) at distance ((control & 31) << 8 | byte) + 1.
    No index leaves either array.
    """
    at = 0
    end = 0
    while at < packed.size:
        control = np.int64(packed[at])
        at += 1
        if control < 32:
            length = np.int64(control + 1)
            if at + length > packed.size or end + length > unpacked.size:
                return -1
            for _ in range(length):
                unpacked[end] = packed[at]
                at += 1
                end += 1
            continue
        length = np.int64(control >> 5)
        if length == 7:
            if at >= packed.size:
                return -1
            length += np.int64(packed[at])
            at += 1
        length += 2
        if at >= packed.size:
            return -1
        start = end - ((control & 31) << 8) - np.int64(packed[at]) - 1
        at += 1
        if start < 0 or end + length > unpacked.size:
            return -1
        for k in range(length):
            unpacked[end + k] = unpacked[start + k]
        end += int(length)
    return end


def flat(array: NDArray[Any]) -> NDArray[Any]:
    """Return a contiguous array as one dimension, without a copy."""
    return array.reshape(-1)


_TIGHT = np.deg2rad(1.0)

_ORDERED = 0.9

_AGREES = np.deg2rad(6.0)

_READINGS = tuple(product((1.0, np.pi / 180, np.pi / 18000), (1.0, -1.0), (0.0, np.pi / 2, np.pi, -np.pi / 2)))


def rings_by_elevation(
    laser: NDArray[np.int64], points: NDArray[np.float32], model: LidarModel | None = None
) -> NDArray[np.int16]:
    """Return the ring (N,) int16, 0 the lowest, of beams numbered in a file's own order.

    The order is judged by each beam's median elevation. Ascending numbers are kept and descending ones are counted from
    the other end, so that a beam without returns keeps its place. Any other order is replaced by the rank of the median
    elevation, or with a model of more beams by the model's nearest beam. Where elevations are too loose to rank (points
    that are not in the sensor's frame), the number is only kept or turned over.

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
    """Return the beams (K,) that have finite returns, their median elevations, and if these are sharp."""
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
    return beams, quarters[:, 1], bool(np.median(quarters[:, 2] - quarters[:, 0]) < _TIGHT)


def _order(median: NDArray[np.float64]) -> int:
    """Return +1 where elevations ascend with the number, -1 where they descend, 0 where they are in another order."""
    if median.size < 2 or (np.diff(median) >= 0).all():
        return 1
    if (np.diff(median) <= 0).all():
        return -1
    rank = np.argsort(np.argsort(median))
    correlation = float(np.corrcoef(np.arange(median.size), rank)[0, 1])
    return 0 if abs(correlation) < _ORDERED else int(np.sign(correlation))


def _ranks(median: NDArray[np.float64], model: LidarModel | None) -> NDArray[np.int64]:
    if model is not None and model.rings > median.size:
        nearest: NDArray[np.int64] = np.abs(model.elevation[None, :] - median[:, None]).argmin(axis=1)
        if np.unique(nearest).size == nearest.size:
            return nearest
    return np.argsort(np.argsort(median, kind="stable"))


def matched_azimuth(value: NDArray[np.floating], points: NDArray[np.float32]) -> NDArray[np.float32] | None:
    """Return a file's azimuth column (N,) as radians in [-π, π], counter-clockwise from x, or None if it is not one.

    Formats differ in unit, sign and zero. The reading that agrees best with the points is taken; one that is more than
    6° off in the median (no azimuth at all, or of another frame) is refused.
    """
    usable = np.isfinite(points).all(axis=1) & (points[:, :2] != 0).any(axis=1) & np.isfinite(value)
    if not usable.any():
        return None
    sample = np.flatnonzero(usable)[:: max(1, int(usable.sum()) // 2000)]
    seen = np.arctan2(points[sample, 1], points[sample, 0], dtype=np.float64)
    angle = value[sample].astype(np.float64)
    best = (np.inf, 1.0, 0.0)
    for scale, sign, zero in _READINGS:
        off = float(np.median(np.abs(_wrapped(sign * scale * angle + zero - seen))))
        best = min(best, (off, sign * scale, zero))
    if best[0] > _AGREES:
        return None
    filled = np.where(np.isfinite(value), value, 0.0).astype(np.float64)
    return _wrapped(best[1] * filled + best[2]).astype(np.float32)


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.mod(angle + np.pi, 2 * np.pi) - np.pi


def matched_time_s(value: NDArray[np.generic]) -> NDArray[np.float32] | None:
    """Return a file's time column (N,) as seconds since its earliest, or None where it is not within one revolution.

    Whole numbers are nanoseconds, fractions are seconds; one revolution lasts at most 2 s.

    >>> matched_time_s(np.array([5_000_000, 0], np.uint32)).tolist()
    [0.004999999888241291, 0.0]
    """
    if value.size == 0 or not np.isfinite(value.astype(np.float64)).all():
        return None
    since = (value - value.min()).astype(np.float64)
    seconds = since * 1e-9 if value.dtype.kind in "iu" else since
    return seconds.astype(np.float32) if seconds.max() <= 2.0 else None
