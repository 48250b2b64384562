"""Files that survive a kill, written whole or not at all; archives of arrays."""

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
"""What the reader of a damaged archive of arrays, or of what it holds, may raise."""


def read_arrays(raw: bytes, most_bytes: int, names: Iterable[str] = ()) -> dict[str, NDArray[Any]]:
    """Return arrays of an NPZ by name, all of them unless some are named; nothing is unpickled.

    Args:
        raw: the file.
        most_bytes: an array that is larger, unpacked, is refused.
        names: of the arrays.

    Raises:
        DAMAGED: the file is no such archive, an array is missing or too large.
    """
    import numpy as np

    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        for member in [archive.getinfo(f"{name}.npy") for name in names] or archive.infolist():
            if member.file_size > most_bytes:
                raise ValueError(f"{member.filename} must be at most {most_bytes} bytes, got {member.file_size}")
    with np.load(io.BytesIO(raw), allow_pickle=False) as file:
        return {name: file[name] for name in names or file.files}


_YOUNG_S = 10.0
"""A draft that is younger may be one that a running process has not locked yet."""


def write_atomic(path: str | Path, content: bytes) -> None:
    """Write ``content`` to a new file beside ``path`` and move it into place, so that nobody sees half of it.

    Raises:
        OSError: the folder does not exist or cannot be written; no file is left behind.
    """
    with open_atomic(path) as file:
        file.write(content)


def require_parent(path: Path) -> None:
    """Check that the folder exists that a file or folder is to lie in.

    Raises:
        OSError: it does not.
    """
    if not path.parent.is_dir():
        kind = NotADirectoryError if path.parent.exists() else FileNotFoundError
        raise kind(f"{path} must lie in a folder that exists, got {path.parent}; make it first")


@contextmanager
def open_atomic(path: str | Path) -> Iterator[BinaryIO]:
    """Open a new file beside ``path`` for writing; it is moved into place when the block ends without an error.

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
    """Make a folder beside ``target`` to write it in before it is moved into place; it is removed when the block ends.

    Raises:
        OSError: the folder does not exist or cannot be written.
    """
    remove_old_drafts(target)
    draft = _draft_of(target)
    draft.mkdir()
    held = _held(draft)
    try:
        yield draft
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        if held is not None:
            os.close(held)


def remove_old_drafts(target: Path) -> None:
    """Remove the drafts of ``target`` that killed processes left beside it.

    A process holds a lock on its draft as long as it lives. Where the system has no such locks nothing is removed.
    """
    name = re.compile(rf"\.{re.escape(target.name[:100])}\.[0-9a-f]{{12}}\.part")
    found = target.parent.iterdir() if target.parent.is_dir() else ()
    for draft in [each for each in found if name.fullmatch(each.name)]:
        held = _held(draft)
        if held is None:
            continue
        if time.time() - os.fstat(held).st_mtime > _YOUNG_S:
            shutil.rmtree(draft, ignore_errors=True) if draft.is_dir() else draft.unlink(missing_ok=True)
        os.close(held)


def _draft_of(target: Path) -> Path:
    return target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.part")


def _held(draft: Path) -> int | None:
    """Return a descriptor that holds the lock of a draft; None where another process has it, or none can be had."""
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
    """Lock a file or folder until it is closed, or its process ends; return whether that was possible."""
    if sys.platform == "win32":
        return False
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
