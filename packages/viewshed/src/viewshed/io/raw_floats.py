"""Headerless float32 rows: KITTI ``.bin`` (x, y, z, intensity) and nuScenes ``.pcd.bin`` (the same and ring)."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.geometry import Rigid
from viewshed.io._columns import FILE_FRAMES, IDENTITY, Columns
from viewshed.io._input import InputFile
from viewshed.sweep import MAX_POINTS, Sweep

_CHUNK_ROWS = 8_192
"""Number of rows that stay in the CPU cache between reading and splitting."""

_LOCAL = threading.local()

_SAMPLE_BYTES = 4_800

_MICROSECONDS = re.compile(r"__(\d{16})\.pcd\.bin$")


def read_kitti(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the sweep of a KITTI ``.bin`` file."""
    rows = _rows(source, 4)
    block = np.empty(4 * rows, np.float32)
    points, intensity = block[: 3 * rows], block[3 * rows :]
    for buffer, start, stop in _chunks(source, rows, 4):
        _core.split_xyzi(buffer, points[3 * start : 3 * stop], intensity[start:stop])
    yield Columns(points.reshape(rows, 3), intensity, frame=IDENTITY if frame is None else frame)


def read_nuscenes(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the sweep of a nuScenes ``.pcd.bin`` file; its time is read from the file name."""
    rows = _rows(source, 5)
    block = np.empty(9 * rows, np.int16)
    floats, ring = block[: 8 * rows].view(np.float32), block[8 * rows :]
    points, intensity = floats[: 3 * rows], floats[3 * rows :]
    bad = 0
    for buffer, start, stop in _chunks(source, rows, 5):
        bad += _core.split_xyzir(
            buffer, points[3 * start : 3 * stop], intensity[start:stop], ring[start:stop], frame is None
        )
    if bad and source.size % 16 == 0:
        raise ValueError(f"the fifth column must be whole ring numbers, {bad} of {rows} are not; is it nuScenes?")
    match = _MICROSECONDS.search(source.name)
    yield Columns(
        points.reshape(rows, 3), intensity, None if bad else ring,
        left_out=(f"ring is left out: {bad} of {rows} are no whole numbers",) if bad else (),
        t_ns=int(match[1]) * 1000 if match else None, frame=IDENTITY if frame is None else frame,
    )  # fmt: skip


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


def _chunks(source: InputFile, rows: int, columns: int) -> Iterator[tuple[NDArray[np.float32], int, int]]:
    """Yield a buffer of this thread, filled with the rows start to stop, and start and stop.

    The buffer is reused because allocating fresh memory costs more than reading.
    """
    buffer: NDArray[np.float32] | None = getattr(_LOCAL, "buffer", None)
    if buffer is None:
        buffer = _LOCAL.buffer = np.empty(5 * _CHUNK_ROWS, np.float32)
    for start in range(0, rows, _CHUNK_ROWS):
        stop = min(start + _CHUNK_ROWS, rows)
        view = buffer.data.cast("B")[: 4 * columns * (stop - start)]
        got = 0
        while got < len(view):
            count = source.file.readinto(view[got:])  # type: ignore[attr-defined]
            if not count:
                raise ValueError("the file became shorter while it was read")
            got += count
        yield buffer, start, stop


def columns_of_bin(source: InputFile) -> int:
    """Detect the number of float32 columns (4 or 5) of a ``.bin`` file by its size and its first rows.

    Raises:
        ValueError: neither or both are plausible.
    """
    sample = source.file.read(_SAMPLE_BYTES)
    source.file.seek(0)
    raw = np.frombuffer(sample, np.float32, len(sample) // 4)
    fits = [columns for columns in (4, 5) if source.size % (4 * columns) == 0 and _core.plausible_rows(raw, columns)]
    if len(fits) == 1:
        return fits[0]
    if fits:
        raise ValueError("could be 4 or 5 float32 columns; say which with --format kitti or --format nuscenes")
    raise ValueError(
        f"does not look like rows of 4 or 5 float32 columns ({source.size} bytes); "
        "it is cut off or of another format (name one with --format)"
    )


def write_kitti(sweep: Sweep) -> bytes:
    """Return rows of x, y, z, intensity (0 if unknown) as little-endian float32."""
    rows = np.zeros((len(sweep), 4), "<f4")
    rows[:, :3] = sweep.points
    if sweep.intensity is not None:
        rows[:, 3] = sweep.intensity
    return rows.tobytes()


def write_nuscenes(sweep: Sweep) -> bytes:
    """Return rows of x, y, z, intensity, ring in nuScenes' frame as little-endian float32.

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
