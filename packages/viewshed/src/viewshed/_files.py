"""Atomic writes of files and folders; reading of NPZ archives; order of files."""

from __future__ import annotations

import io
import lzma
import os
import re
import secrets
import shutil
import struct
import sys
import time
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    from numpy.typing import NDArray

DAMAGED = (
    ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError, RuntimeError, EOFError, OSError,
    MemoryError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error,
)  # fmt: skip
"""Exceptions that reading a damaged archive of arrays, or its content, may raise."""


def read_arrays(raw: bytes, max_bytes: int, names: Iterable[str] = ()) -> dict[str, NDArray[Any]]:
    """Return arrays of an NPZ file by name, without unpickling.

    Args:
        raw: content of the file.
        max_bytes: maximum unpacked size of an array.
        names: names of the arrays to read; empty reads all.

    Raises:
        DAMAGED: the file is no NPZ archive, or an array is missing or too large.
    """
    import numpy as np

    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        for member in [archive.getinfo(f"{name}.npy") for name in names] or archive.infolist():
            if member.file_size > max_bytes:
                raise ValueError(f"{member.filename} must be at most {max_bytes} bytes, got {member.file_size}")
    with np.load(io.BytesIO(raw), allow_pickle=False) as file:
        return {name: file[name] for name in names or file.files}


_MIN_DRAFT_AGE_S = 10.0
"""Younger drafts are kept: a running process may not have locked its draft yet."""


def write_atomic(path: str | Path, content: bytes) -> None:
    """Write ``content`` to a new file beside ``path``, then rename it to ``path``: readers never see a partial file.

    Raises:
        OSError: the folder does not exist or cannot be written; no file is left behind.
    """
    with open_atomic(path) as file:
        file.write(content)


def require_parent(path: Path) -> None:
    """Check that the parent folder of ``path`` exists.

    Raises:
        OSError: it does not exist, or is no folder.
    """
    if not path.parent.is_dir():
        kind = NotADirectoryError if path.parent.exists() else FileNotFoundError
        raise kind(f"{path} must lie in a folder that exists, got {path.parent}; create it first")


@contextmanager
def open_atomic(path: str | Path) -> Iterator[BinaryIO]:
    """Open a new file beside ``path`` for writing; rename it to ``path`` when the block ends without an error.

    Raises:
        OSError: the folder does not exist or cannot be written; no file is left behind.
    """
    target = Path(path)
    if target.is_dir():
        raise IsADirectoryError(f"path must name a file, got the folder {target}")
    require_parent(target)
    draft = _draft_of(target)
    try:
        with draft.open("xb") as file:
            _lock(file.fileno())
            yield file
            file.flush()
            os.fsync(file.fileno())
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def draft_folder(target: Path) -> Iterator[Path]:
    """Make a draft folder beside ``target``, which the caller fills and renames; remove it when the block ends.

    Raises:
        OSError: the folder does not exist or cannot be written.
    """
    remove_old_drafts(target)
    draft = _draft_of(target)
    draft.mkdir()
    lock = _open_locked(draft)
    try:
        yield draft
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def remove_old_drafts(target: Path) -> None:
    """Remove the drafts of ``target`` that killed processes left beside it.

    A living process holds a lock on its draft. On systems without such locks nothing is removed.
    """
    name = re.compile(rf"\.{re.escape(target.name[:100])}\.[0-9a-f]{{12}}\.part")
    siblings = target.parent.iterdir() if target.parent.is_dir() else ()
    for draft in [path for path in siblings if name.fullmatch(path.name)]:
        lock = _open_locked(draft)
        if lock is None:
            continue
        if time.time() - os.fstat(lock).st_mtime > _MIN_DRAFT_AGE_S:
            shutil.rmtree(draft, ignore_errors=True) if draft.is_dir() else draft.unlink(missing_ok=True)
        os.close(lock)


def _draft_of(target: Path) -> Path:
    return target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.part")


def _open_locked(draft: Path) -> int | None:
    """Return a file descriptor that holds the lock of a draft; None if it cannot be locked."""
    if sys.platform == "win32":
        return None
    try:
        descriptor = os.open(draft, os.O_RDONLY)
    except OSError:
        return None
    if _lock(descriptor):
        return descriptor
    os.close(descriptor)
    return None


def _lock(descriptor: int) -> bool:
    """Lock a file or folder until it is closed or the process ends; return whether that succeeded."""
    if sys.platform == "win32":
        return False
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def by_numbers(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts paths by the numbers in them: ``2.bin`` before ``10.bin``.

    >>> sorted([Path("10.bin"), Path("2.bin"), Path("3²1.bin")], key=by_numbers)[0].name
    '2.bin'
    """
    return [(int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", str(path))]
