"""Journals: files of JSON lines that are only added to, so that what is there survives what stops the rest.

Files that are either whole or not there.
"""

from __future__ import annotations

import json
import os
import secrets
from pathlib import Path
from typing import Any


def write_atomic(path: str | Path, content: bytes) -> None:
    """Write ``content`` to a new file beside ``path`` and move it into place, so that nobody sees half of it.

    Raises:
        OSError: the folder does not exist or cannot be written; no file is left behind.
    """
    target = Path(path)
    if target.is_dir():
        raise IsADirectoryError(f"path must name a file, got the folder {target}")
    draft = target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.part")
    try:
        with draft.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


def append_jsonl(path: Path, line: dict[str, Any]) -> None:
    """Add a line to a journal, on the disk when this returns.

    Raises:
        OSError: it cannot be written.
    """
    with path.open("ab") as file:
        file.write(json.dumps(line, ensure_ascii=False, separators=(",", ":")).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())


def is_begun(path: Path) -> bool:
    """Return whether a journal has a whole line; what a crash left of a line at its end is cut off."""
    if not path.exists():
        return False
    content = path.read_bytes()
    whole = content.rfind(b"\n") + 1
    if whole < len(content):
        with path.open("r+b") as file:
            file.truncate(whole)
    return whole > 0
