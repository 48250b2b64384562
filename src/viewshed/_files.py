"""Files that survive a kill: written whole or not at all, or JSON lines that are only appended; archives of arrays."""

from __future__ import annotations

import io
import json
import lzma
import os
import secrets
import struct
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
    draft = target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.part")
    try:
        with draft.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


def append_jsonl(path: Path, line: dict[str, Any]) -> None:
    """Append a line of JSON to a file; it is on the disk when this returns.

    Raises:
        OSError: it cannot be written.
    """
    with path.open("ab") as file:
        file.write(json.dumps(line, ensure_ascii=False, separators=(",", ":")).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())


def is_begun(path: Path) -> bool:
    """Return whether a file of JSON lines has a whole line; cut off what a crash left of a line at its end."""
    if not path.exists():
        return False
    content = path.read_bytes()
    whole = content.rfind(b"\n") + 1
    if whole < len(content):
        with path.open("r+b") as file:
            file.truncate(whole)
    return whole > 0
