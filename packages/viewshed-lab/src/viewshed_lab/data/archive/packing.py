"""Arrays as bytes that compress well, and back, exactly.

Parquet has encodings of its own for this. Measured on simulated frames of 30,000 returns: as Arrow lists they take 1.6
times the size and 7 times the time to read, as plain bytes 1.3 times the size and the same time.

What reads is compiled, for a frame is read again and again. All that unpack raise a ValueError where there are more or
fewer bytes than the shape needs; arrays are read-only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Buffer = bytes | memoryview
Bytes = NDArray[np.uint8]

_SHIFTS = np.arange(0, 8, 2, dtype=np.uint8)


def pack_ranges(steps: NDArray[np.uint16]) -> bytes:
    """Return the bytes of a range image (C, R): ring by ring the differences along the columns, low bytes first.

    Neighboring columns of one ring differ little, so the high bytes are almost all 0. A difference d is stored as the
    zigzag number 2·d or -2·d - 1, modulo 2¹⁶.
    """
    changes = np.ascontiguousarray(np.diff(steps.T, axis=1, prepend=np.uint16(0))).view(np.int16)
    return pack_column((changes << 1) ^ (changes >> 15))


def unpack_ranges(raw: Buffer, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Return the range image (C, R) of :func:`pack_ranges`."""
    steps = np.empty(shape, np.uint16)
    _unpack_ranges(_exactly(raw, steps.nbytes), steps)
    return _frozen(steps)


@njit(cache=True, nogil=True, error_model="numpy")
def _unpack_ranges(raw: Any, steps: Any) -> None:
    columns, rings = steps.shape
    high = columns * rings
    for ring in range(rings):
        value = np.int32(0)
        for column in range(columns):
            k = ring * columns + column
            zigzag = np.int32(raw[k]) | (np.int32(raw[high + k]) << 8)
            value += (zigzag >> 1) ^ -(zigzag & 1)
            steps[column, ring] = value & 0xFFFF


def pack_states(states: NDArray[np.uint8]) -> bytes:
    """Return four states of 0 to 3 in each byte, the first in the lowest bits.

    >>> pack_states(np.array([1, 2, 3, 0, 3], np.uint8)).hex()
    '3903'
    """
    if states.size and states.max() > 3:
        raise ValueError(f"state must lie in [0, 3], got {states.max()}")
    padded = np.zeros((states.size + 3) // 4 * 4, np.uint8)
    padded[: states.size] = states.reshape(-1)
    packed: Bytes = np.bitwise_or.reduce(padded.reshape(-1, 4) << _SHIFTS, axis=1, dtype=np.uint8)
    return packed.tobytes()


def unpack_states(raw: Buffer, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the states of :func:`pack_states`."""
    states = np.empty(shape, np.uint8)
    _unpack_states(_exactly(raw, (states.size + 3) // 4), states.reshape(-1))
    return _frozen(states)


@njit(cache=True, nogil=True, error_model="numpy")
def _unpack_states(raw: Any, states: Any) -> None:
    for k in range(states.shape[0]):
        states[k] = (raw[k >> 2] >> (2 * (k & 3))) & 3


def pack_masks(masks: NDArray[np.bool_]) -> bytes:
    """Return one bit a cell, each of the masks (M, …) padded to whole bytes, the first cell in the highest bit.

    >>> pack_masks(np.array([[True, False, True]])).hex()
    'a0'
    """
    return np.packbits(masks.reshape(len(masks), -1), axis=1).tobytes()


def unpack_masks(raw: Buffer, shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Return the masks (M, cells, cells) of :func:`pack_masks`."""
    count = shape[1] * shape[2]
    rows = _exactly(raw, shape[0] * ((count + 7) // 8)).reshape(shape[0], -1)
    return _frozen(np.unpackbits(rows, axis=1, count=count).view(np.bool_).reshape(shape))


def pack_column(values: NDArray[np.number[Any]]) -> bytes:
    """Return the bytes of numbers (N,) or (N, k): all first bytes, all second bytes, and so on."""
    return np.ascontiguousarray(values).reshape(-1, 1).view(np.uint8).T.tobytes()


def unpack_column(raw: Buffer, dtype: type[np.generic], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the numbers of :func:`pack_column`."""
    out = np.empty(shape, dtype)
    _merge(_exactly(raw, out.nbytes).reshape(out.itemsize, -1), out.reshape(-1, 1).view(np.uint8))
    return _frozen(out)


@njit(cache=True, nogil=True, error_model="numpy")
def _merge(planes: Any, numbers: Any) -> None:
    for byte in range(planes.shape[0]):
        for k in range(planes.shape[1]):
            numbers[k, byte] = planes[byte, k]


def bytes_of(raw: Buffer, shape: tuple[int, ...]) -> Bytes:
    """Return the uint8 array of ``shape`` that ``raw`` holds, without a copy."""
    return _exactly(raw, int(np.prod(shape))).reshape(shape)


def _exactly(raw: Buffer, count: int) -> Bytes:
    flat = np.frombuffer(raw, np.uint8)
    if len(flat) != count:
        raise ValueError(f"a column must hold {count} bytes, got {len(flat)}")
    return flat


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array
