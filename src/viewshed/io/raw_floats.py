"""Headerless float32 rows: KITTI ``.bin`` (x, y, z, intensity) and nuScenes ``.pcd.bin`` (and ring)."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io._columns import FILE_FRAMES, IDENTITY, Columns
from viewshed.io._input import InputFile
from viewshed.sweep import MAX_POINTS, Sweep

_U = np.uint64

_CHUNK_ROWS = 65_536

_LOCAL = threading.local()

_SAMPLE_BYTES = 4_800

_MICROSECONDS = re.compile(r"__(\d{16})\.pcd\.bin$")


def read_kitti(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the one sweep of a KITTI ``.bin`` file."""
    rows = _rows(source, 4)
    block = np.empty(4 * rows, np.float32)
    points, intensity = block[: 3 * rows], block[3 * rows :]
    buffer, _ = _scratch()
    start = 0
    while start < rows:
        count = _fill(source, buffer, rows - start, 4)
        stop = start + count
        split_xyzi(buffer, points[3 * start : 3 * stop], intensity[start:stop])
        start = stop
    yield Columns(points.reshape(rows, 3), intensity, frame=IDENTITY if frame is None else frame)


def read_nuscenes(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the one sweep of a nuScenes ``.pcd.bin`` file; its time is the one in nuScenes' file names."""
    rows = _rows(source, 5)
    block = np.empty(9 * rows, np.int16)
    floats, ring = block[: 8 * rows].view(np.float32), block[8 * rows :]
    points, intensity = floats[: 3 * rows], floats[3 * rows :]
    buffer, rings = _scratch()
    start = bad = 0
    while start < rows:
        count = _fill(source, buffer, rows - start, 5)
        stop = start + count
        split_xyzir(buffer, points[3 * start : 3 * stop], intensity[start:stop], rings[:count], frame is None)
        bad += whole_numbers(rings[:count], ring[start:stop])
        start = stop
    if bad and source.size % 16 == 0:
        raise ValueError(f"the fifth column must be whole ring numbers, {bad} of {rows} are not; is it nuScenes?")
    named = _MICROSECONDS.search(source.name)
    yield Columns(
        points.reshape(rows, 3), intensity, None if bad else ring,
        left_out=(f"ring is left out: {bad} of {rows} are no whole numbers",) if bad else (),
        t_ns=int(named[1]) * 1000 if named else None, frame=IDENTITY if frame is None else frame,
    )  # fmt: skip


def _scratch() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return this thread's buffers for rows and rings, kept because fresh memory costs more than reading."""
    buffers: tuple[NDArray[np.float32], NDArray[np.float32]] | None = getattr(_LOCAL, "buffers", None)
    if buffers is None:
        buffers = np.empty(5 * _CHUNK_ROWS, np.float32), np.empty(_CHUNK_ROWS, np.float32)
        _LOCAL.buffers = buffers
    return buffers


def _rows(source: InputFile, columns: int) -> int:
    rows, rest = divmod(source.size, 4 * columns)
    if rest:
        raise ValueError(
            f"must hold rows of {columns} float32 ({4 * columns} bytes), got {source.size} bytes; "
            "it is cut off or of another format"
        )
    if rows > MAX_POINTS:
        raise ValueError(f"a sweep must have at most {MAX_POINTS} points, got {rows}")
    return rows


def _fill(source: InputFile, buffer: NDArray[np.float32], rows: int, columns: int) -> int:
    """Read up to a buffer of whole rows; return how many."""
    view = buffer.data.cast("B")[: 4 * columns * min(rows, _CHUNK_ROWS)]
    got = 0
    while got < len(view):
        count = source.file.readinto(view[got:])  # type: ignore[attr-defined]
        if not count:
            raise ValueError("the file became shorter while it was read")
        got += count
    return got // (4 * columns)


def columns_of_bin(source: InputFile) -> int:
    """Return 4 or 5: how many float32 columns a nameless ``.bin`` file has, judged by its size and its first rows.

    Raises:
        ValueError: neither fits, or both do.
    """
    sample = source.file.read(_SAMPLE_BYTES)
    source.file.seek(0)
    raw = np.frombuffer(sample, np.float32, len(sample) // 4)
    fits = [columns for columns in (4, 5) if source.size % (4 * columns) == 0 and plausible_rows(raw, columns)]
    if len(fits) == 1:
        return fits[0]
    if fits:
        raise ValueError("could be 4 or 5 float32 columns; say which with --format kitti or --format nuscenes")
    raise ValueError(
        f"does not look like rows of 4 or 5 float32 columns ({source.size} bytes); "
        "it is cut off or of another format (name one with --format)"
    )


def write_kitti(sweep: Sweep) -> bytes:
    """Return the rows x, y, z, intensity (0 where it is not known) as little-endian float32."""
    rows = np.zeros((len(sweep), 4), "<f4")
    rows[:, :3] = sweep.points
    if sweep.intensity is not None:
        rows[:, 3] = sweep.intensity
    return rows.tobytes()


def write_nuscenes(sweep: Sweep) -> bytes:
    """Return the rows x, y, z, intensity, ring in nuScenes' frame as little-endian float32.

    Raises:
        ValueError: the sweep has no ring.
    """
    if sweep.ring is None:
        raise ValueError("a sweep without ring cannot be written as nuScenes; recover its beams or use another format")
    rows = np.zeros((len(sweep), 5), "<f4")
    rows[:, :3] = sweep.points @ FILE_FRAMES["nuscenes"].rotation.astype(np.float32)
    if sweep.intensity is not None:
        rows[:, 3] = sweep.intensity
    rows[:, 4] = sweep.ring
    return rows.tobytes()


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
