"""Arrays as bytes that compress well, and back, exactly.

Parquet has encodings of its own for this. Measured on simulated sweeps of 30,000 returns: with BYTE_STREAM_SPLIT points
have the same size, and are read in 0.48 ms instead of 0.28 ms; range images grow by 9 % with it (after our zigzag
differences) and by 75 % with DELTA_BINARY_PACKED. So blobs are packed here.

All that unpack raise a ValueError where there are more or fewer bytes than the shape needs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Buffer = bytes | memoryview
Bytes = NDArray[np.uint8]
Numbers = NDArray[np.number[Any]]


def pack_ranges(steps: NDArray[np.uint16]) -> bytes:
    """Return the bytes of a range image (C, R): ring by ring the differences along the columns, low bytes first.

    Neighboring columns of one ring differ little, so the high bytes are almost all 0. A difference d is stored as the
    zigzag number 2·d or -2·d - 1, modulo 2¹⁶.
    """
    columns, rings = steps.shape
    out = np.empty(2 * columns * rings, np.uint8)
    _pack_ranges(np.ascontiguousarray(steps), out)
    return out.tobytes()


def unpack_ranges(raw: Buffer, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Return the range image (C, R) of :func:`pack_ranges`, read-only."""
    flat = _exactly(raw, 2 * shape[0] * shape[1])
    steps = np.empty(shape, np.uint16)
    _unpack_ranges(flat, steps)
    return _frozen(steps)


def pack_states(states: NDArray[np.uint8]) -> bytes:
    """Return four states of 0 to 3 in each byte, the first in the lowest bits.

    >>> pack_states(np.array([1, 2, 3, 0, 3], np.uint8)).hex()
    '3903'
    """
    flat = np.ascontiguousarray(states).reshape(-1)
    if flat.size and flat.max() > 3:
        raise ValueError(f"state must lie in [0, 3], got {flat.max()}")
    out = np.zeros((flat.size + 3) // 4, np.uint8)
    _pack_states(flat, out)
    return out.tobytes()


def unpack_states(raw: Buffer, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the states of :func:`pack_states`, read-only."""
    count = int(np.prod(shape))
    out = np.empty(count, np.uint8)
    _unpack_states(_exactly(raw, (count + 3) // 4), out)
    return _frozen(out.reshape(shape))


def pack_masks(masks: NDArray[np.bool_]) -> bytes:
    """Return one bit a cell, each of the masks (M, …) padded to whole bytes, the first cell in the highest bit.

    >>> pack_masks(np.array([[True, False, True]])).hex()
    'a0'
    """
    return np.packbits(masks.reshape(len(masks), -1), axis=1).tobytes()


def unpack_masks(raw: Buffer, shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Return the masks (M, cells, cells) of :func:`pack_masks`, read-only."""
    count = shape[1] * shape[2]
    rows = _exactly(raw, shape[0] * ((count + 7) // 8)).reshape(shape[0], -1)
    return _frozen(np.unpackbits(rows, axis=1, count=count).view(np.bool_).reshape(shape))


def pack_column(values: Numbers) -> bytes:
    """Return the bytes of numbers (N,) or (N, k): all first bytes, all second bytes, and so on."""
    array = np.ascontiguousarray(values)
    out = np.empty(array.nbytes, np.uint8)
    if array.nbytes:
        _split(array.reshape(-1).view(np.uint8).reshape(-1, array.itemsize), out.reshape(array.itemsize, -1))
    return out.tobytes()


def unpack_column(raw: Buffer, dtype: type[np.generic], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the numbers of :func:`pack_column`, read-only."""
    out = np.empty(shape, dtype)
    flat = _exactly(raw, out.nbytes)
    if out.nbytes:
        _split(flat.reshape(out.itemsize, -1), out.reshape(-1).view(np.uint8).reshape(-1, out.itemsize))
    return _frozen(out)


def bytes_of(raw: Buffer, shape: tuple[int, ...]) -> Bytes:
    """Return the uint8 array of ``shape`` that ``raw`` holds, read-only and without a copy."""
    return _exactly(raw, int(np.prod(shape))).reshape(shape)


def _exactly(raw: Buffer, count: int) -> Bytes:
    flat = np.frombuffer(raw, np.uint8)
    if len(flat) != count:
        raise ValueError(f"a column must hold {count} bytes, got {len(flat)}")
    return flat


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array


@njit(cache=True, nogil=True, error_model="numpy")
def _pack_ranges(steps: Any, out: Any) -> None:  # pragma: no cover - compiled
    columns, rings = steps.shape
    high = columns * rings
    for ring in range(rings):
        before = np.int32(0)
        for column in range(columns):
            value = np.int32(steps[column, ring])
            change = np.int32(np.int16(value - before))
            zigzag = np.uint16((change << 1) ^ (change >> 15))
            out[ring * columns + column] = zigzag & 0xFF
            out[high + ring * columns + column] = zigzag >> 8
            before = value


@njit(cache=True, nogil=True, error_model="numpy")
def _unpack_ranges(raw: Any, steps: Any) -> None:  # pragma: no cover - compiled
    columns, rings = steps.shape
    high = columns * rings
    for ring in range(rings):
        value = np.int32(0)
        for column in range(columns):
            k = ring * columns + column
            zigzag = np.int32(raw[k]) | (np.int32(raw[high + k]) << 8)
            value += (zigzag >> 1) ^ -(zigzag & 1)
            steps[column, ring] = value & 0xFFFF


@njit(cache=True, nogil=True, error_model="numpy")
def _pack_states(states: Any, out: Any) -> None:  # pragma: no cover - compiled
    for k in range(states.shape[0]):
        out[k >> 2] |= states[k] << (2 * (k & 3))


@njit(cache=True, nogil=True, error_model="numpy")
def _unpack_states(raw: Any, states: Any) -> None:  # pragma: no cover - compiled
    for k in range(states.shape[0]):
        states[k] = (raw[k >> 2] >> (2 * (k & 3))) & 3


@njit(cache=True, nogil=True, error_model="numpy")
def _split(rows: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Transpose bytes."""
    for k in range(rows.shape[0]):
        for byte in range(rows.shape[1]):
            out[byte, k] = rows[k, byte]
