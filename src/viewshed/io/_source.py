"""An opened input file: a regular file or its unpacked gzip content, with its true size and one-line errors.

Coordinate frames that files come in, as ``sensor_from_file`` (sensor: x forward, y left, z up).
"""

from __future__ import annotations

import gzip
import io
import os
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from viewshed.geometry import Rigid

FILE_FRAMES: dict[str, Rigid] = {
    "sensor": Rigid.identity(),
    "nuscenes": Rigid(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3)),
    "carla": Rigid(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.zeros(3)),
    "argoverse2": Rigid(np.eye(3), np.array([-1.35018, 0.0, -1.64042])),
    "pandaset": Rigid(np.eye(3), np.array([0.0, 0.0, -1.8])),
}
"""Name → ``sensor_from_file``.

sensor: as it is. nuscenes: x right, y forward. carla: raw files of CARLA ≤ 0.9.9, x right, y backward, z down.
argoverse2: the car's frame (rear axle) → its ``up_lidar``. pandaset: the car's frame → a sensor 1.8 m above its origin
(inferred from the innermost ring, not documented by the data set).
"""


def file_frame_named(frame: str | Rigid) -> Rigid:
    """Return the ``sensor_from_file`` of a name in :data:`FILE_FRAMES`; a transform is returned as it is.

    >>> (file_frame_named("nuscenes") @ np.array([0.0, 5.0, 0.0])).tolist()
    [5.0, 0.0, 0.0]
    """
    if isinstance(frame, Rigid):
        return frame
    if frame not in FILE_FRAMES:
        raise ValueError(f"file_frame must be one of {', '.join(FILE_FRAMES)} or a Rigid, got {frame!r}")
    return FILE_FRAMES[frame]


def is_identity(frame: Rigid) -> bool:
    """Return whether a transform changes nothing."""
    return bool((frame.rotation == np.eye(3)).all() and not frame.translation.any())


IDENTITY = FILE_FRAMES["sensor"]

MAX_UNPACKED_BYTES = 2_000_000_000
"""Compressed content larger than this is refused."""

MAX_RATIO = 200
"""Content that unpacks to more than this many times its packed size is refused (above 1 MB)."""

_SMALL_BYTES = 1_000_000

_HEAD_BYTES = 64

_CHUNK_BYTES = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """One input: where it is, what it holds.

    Attributes:
        path: the file as the caller named it.
        name: lower-case file name without ``.gz``.
        file: binary stream at its start.
        size: bytes in the stream, measured, not claimed.
        head: the first 64 bytes.
    """

    path: str
    name: str
    file: BinaryIO
    size: int
    head: bytes

    def error(self, problem: object) -> ValueError:
        """Return an error of one line that names the file."""
        return ValueError(one_line(f"{self.path}: {problem}"))

    def content(self) -> bytes:
        """Return every byte of the stream."""
        self.file.seek(0)
        return self.file.read()


def one_line(text: str, limit: int = 400) -> str:
    r"""Return text on one line, cut after ``limit`` characters.

    >>> one_line("two\n  lines")
    'two lines'
    """
    line = " ".join(text.split())
    return line if len(line) <= limit else line[: limit - 1] + "…"


def unpack_limit(packed_bytes: int) -> int:
    """Return how many bytes compressed content of this size may unpack to.

    >>> unpack_limit(10), unpack_limit(1_000_000), unpack_limit(10**9)
    (1000000, 200000000, 2000000000)
    """
    return min(MAX_UNPACKED_BYTES, max(MAX_RATIO * packed_bytes, _SMALL_BYTES))


@contextmanager
def open_source(path: str | os.PathLike[str]) -> Iterator[Source]:
    """Open a sweep file, unpacked if it is gzipped.

    Raises:
        OSError: there is no such file, it cannot be read, or it is not a regular file.
        ValueError: it is empty, or its gzip content is damaged or too large.
    """
    where = os.fspath(path)
    try:
        descriptor = os.open(where, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except OSError as error:
        raise type(error)(one_line(f"{where}: {error.strerror or error}")) from error
    try:
        status = os.fstat(descriptor)
        _check_kind(where, status)
        file = io.FileIO(descriptor)
    except BaseException:
        os.close(descriptor)
        raise
    with file:
        head = file.read(_HEAD_BYTES)
        file.seek(0)
        name = os.path.basename(where).lower()  # noqa: PTH119 (a Path costs as much as reading a small sweep)
        if head[:2] != b"\x1f\x8b":
            yield Source(where, name, file, status.st_size, head)
            return
        content = _gunzip(where, file, status.st_size)
        yield Source(where, name.removesuffix(".gz"), io.BytesIO(content), len(content), content[:_HEAD_BYTES])


def _check_kind(where: str, status: os.stat_result) -> None:
    mode = status.st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(one_line(f"{where}: is a folder; name the files in it"))
    if not stat.S_ISREG(mode):
        raise OSError(one_line(f"{where}: is not a regular file"))
    if status.st_size == 0:
        raise ValueError(one_line(f"{where}: the file is empty"))


def _gunzip(where: str, file: BinaryIO, size: int) -> bytes:
    try:
        with gzip.GzipFile(fileobj=file, mode="rb") as stream:
            content = read_bounded(stream, unpack_limit(size))
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise ValueError(one_line(f"{where}: the gzip content is damaged or cut off: {error}")) from error
    except ValueError as error:
        raise ValueError(one_line(f"{where}: {error}")) from error
    if not content:
        raise ValueError(one_line(f"{where}: the gzip content is empty"))
    return content


def read_bounded(stream: BinaryIO | gzip.GzipFile, limit: int) -> bytes:
    """Return everything in a stream.

    Raises:
        ValueError: it holds more than ``limit`` bytes.
    """
    chunks: list[bytes] = []
    total = 0
    while chunk := stream.read(_CHUNK_BYTES):
        total += len(chunk)
        if total > limit:
            raise ValueError(f"unpacks to more than {limit} bytes ({MAX_RATIO} × its size or 2 GB); refused")
        chunks.append(chunk)
    return b"".join(chunks)
