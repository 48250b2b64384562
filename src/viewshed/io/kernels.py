"""Compiled loops of the readers. Indices are unsigned so that numba leaves out its wrap-around tests (3 × faster)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
    """Return whether rows (N · columns,) read as metres within 10 km, an intensity ≥ 0 and, if five, a ring in 0…127.

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
def unpack_lzf(packed: NDArray[np.uint8], unpacked: NDArray[np.uint8]) -> int:  # noqa: C901 (a decoder's state machine)
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
