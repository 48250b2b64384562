"""Open input files: gunzip with size limits, and report every error as one line that names the file."""

from __future__ import annotations

import builtins
import io
import os
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

MAX_UNPACKED_BYTES = 2_000_000_000
"""Limit of the decompressed size of a file."""

MAX_RATIO = 200
"""Limit of the compression ratio, checked above 1 MB of decompressed content (against zip bombs)."""

_MIN_LIMIT_BYTES = 1_000_000

_HEAD_BYTES = 64

_CHUNK_BYTES = 1 << 20

_GZIP_BLOCK_BYTES = 1 << 14  # small: zlib copies the rest of the block after each member

_MAX_GZIP_MEMBERS = 50_000


@dataclass(frozen=True, slots=True, eq=False)
class InputFile:
    """An opened input file."""

    path: str  # as given by the caller
    name: str  # lower-case file name without ``.gz``
    file: BinaryIO  # binary stream at its start
    size: int  # bytes in the stream, measured, not taken from a header
    head: bytes  # the first 64 bytes

    def content(self, limit_bytes: int | None = None) -> bytes:
        """Read the whole stream; raise ValueError if it is longer than ``limit_bytes``."""
        if limit_bytes is not None and self.size > limit_bytes:
            raise ValueError(f"must be at most {limit_bytes} bytes, got {self.size}")
        self.file.seek(0)
        return self.file.read()


def one_line(text: object, limit: int = 400) -> str:
    r"""Return text as one line, truncated to ``limit`` characters; an error without a message gives its type's name.

    >>> one_line("two\n  lines")
    'two lines'
    >>> one_line(KeyError())
    'KeyError'
    """
    line = " ".join(str(text).split())
    if not line and isinstance(text, BaseException):
        return type(text).__name__
    return line if len(line) <= limit else line[: limit - 1] + "…"


@contextmanager
def errors_with_path(path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> Iterator[None]:
    """Convert every exception raised inside to a one-line error that begins with the path.

    Readers and their libraries raise a dozen exception types on damaged content. This is the one place that converts
    them to ValueError, so that callers can skip a bad file. OSError and ImportError keep their type.

    Args:
        path: the file that is read.
        root: the folder of its recording; a message that contains it is not prefixed again. None is ``path``.
    """
    file_path = os.fspath(path)
    root_path = None if root is None else os.fspath(root)
    try:
        yield
    except ImportError as error:
        raise ImportError(_with_path(file_path, root_path, error)) from error
    except OSError as error:
        kind = type(error) if vars(builtins).get(type(error).__name__) is type(error) else OSError
        raise kind(_with_path(file_path, root_path, _os_problem(error, file_path))) from error
    except ValueError as error:
        raise ValueError(_with_path(file_path, root_path, error)) from error
    except Exception as error:
        problem = f"is damaged or of a kind that is not read: {type(error).__name__}: {error}"
        raise ValueError(_with_path(file_path, root_path, problem)) from error


def _os_problem(error: OSError, file_path: str) -> object:
    """Return the system's message without errno, prefixed by the file name if it is another file."""
    if error.strerror is None:
        return error
    other = error.filename if isinstance(error.filename, str) and error.filename != file_path else ""
    return f"{other}: {error.strerror}" if other else error.strerror


def _with_path(file_path: str, root_path: str | None, problem: object) -> str:
    line = one_line(problem)
    has_path = line.startswith(file_path) if root_path is None else root_path in line
    return line if has_path else one_line(f"{file_path}: {line}", 400 + len(file_path))


def inside(root: str | os.PathLike[str], path: str | os.PathLike[str]) -> Path:
    """Return ``path`` unchanged; raise ValueError if its symbolic links lead out of ``root`` or in a circle."""
    real_root, real_path = os.path.realpath(root), os.path.realpath(path)
    if real_path != real_root and not real_path.startswith(real_root.rstrip(os.sep) + os.sep):
        raise ValueError(f"{os.fspath(path)}: leads out of {os.fspath(root)}; refused")
    if os.path.islink(real_path):  # noqa: PTH114 (realpath leaves a link only where it cannot be followed)
        raise ValueError(f"{os.fspath(path)}: its links lead in a circle; refused")
    return Path(path)


def unpack_limit(packed_bytes: int) -> int:
    """Return the limit in bytes of the decompressed size of content of this compressed size.

    >>> unpack_limit(10), unpack_limit(1_000_000), unpack_limit(10**9)
    (1000000, 200000000, 2000000000)
    """
    return min(MAX_UNPACKED_BYTES, max(MAX_RATIO * packed_bytes, _MIN_LIMIT_BYTES))


@contextmanager
def open_input(path: str | os.PathLike[str]) -> Iterator[InputFile]:
    """Open a file, gunzipped if needed; errors raised while it is open are converted by :func:`errors_with_path`."""
    file_path = os.fspath(path)
    with errors_with_path(file_path):
        descriptor = os.open(file_path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        try:
            status = os.fstat(descriptor)
            _check_regular(status)
            file = io.FileIO(descriptor)
        except BaseException:
            os.close(descriptor)
            raise
        with file:
            head = file.read(_HEAD_BYTES)
            file.seek(0)
            name = os.path.basename(file_path).lower()  # noqa: PTH119 (a Path costs as much as reading a small sweep)
            if head[:2] != b"\x1f\x8b":
                yield InputFile(file_path, name, file, status.st_size, head)
                return
            content = _gunzip(file, unpack_limit(status.st_size))
            unpacked = io.BytesIO(content)
            yield InputFile(file_path, name.removesuffix(".gz"), unpacked, len(content), content[:_HEAD_BYTES])


def _check_regular(status: os.stat_result) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError("is a folder; name the files in it")
    if not stat.S_ISREG(status.st_mode):
        raise OSError("is not a regular file")
    if status.st_size == 0:
        raise ValueError("the file is empty")


def _gunzip(file: BinaryIO, limit: int) -> bytes:
    """Return the decompressed content of a gzip file with one or more members.

    Python's gzip module takes 9 microseconds a member, so a million empty members take 9 s: members are limited here.
    """
    chunks: list[bytes] = []
    total = members = 0
    unpack = None
    block = b""
    try:
        while block or (block := file.read(_GZIP_BLOCK_BYTES)):
            if unpack is None:
                block = block.lstrip(b"\0") if members else block  # zero padding after a member
                if not block:
                    continue
                unpack, members = zlib.decompressobj(31), members + 1
                if members > _MAX_GZIP_MEMBERS:
                    raise ValueError(f"gzip content must have at most {_MAX_GZIP_MEMBERS} members")
            chunk = unpack.decompress(block, _CHUNK_BYTES)
            chunks.append(chunk)
            total += len(chunk)
            _check_unpacked(total, limit)
            block = unpack.unconsumed_tail or unpack.unused_data
            unpack = None if unpack.eof else unpack
    except zlib.error as error:
        raise ValueError(f"the gzip content is damaged or cut off: {error}") from error
    if unpack is not None:
        raise ValueError("the gzip content is damaged or cut off: its end is missing")
    if not total:
        raise ValueError("the gzip content is empty")
    return b"".join(chunks)


def _check_unpacked(total: int, limit: int) -> None:
    if total > limit:
        raise ValueError(f"unpacks to more than {limit} bytes ({MAX_RATIO} × its size or 2 GB); refused")


def read_bounded(stream: BinaryIO, limit: int) -> bytes:
    """Read a whole stream; raise ValueError if it has more than ``limit`` bytes."""
    chunks: list[bytes] = []
    total = 0
    while chunk := stream.read(_CHUNK_BYTES):
        total += len(chunk)
        _check_unpacked(total, limit)
        chunks.append(chunk)
    return b"".join(chunks)
