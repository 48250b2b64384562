"""Read the rows of a large JSON list block by block."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from viewshed.io._input import InputFile

_BLOCK_BYTES = 1 << 16  # small blocks cost less garbage collection: twice as fast as 8 MB

_ROW_MAX = 1 << 20

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


def json_rows(source: InputFile) -> Iterator[dict[str, Any]]:
    """Yield the objects of a JSON list, in order; only a small part of the file is in memory at a time."""
    number = 0
    try:
        for rows in _blocks(source):
            for row in rows:
                if not isinstance(row, dict):
                    raise ValueError(f"row {number} must be an object, got {type(row).__name__}")
                yield row
                number += 1
    except (ValueError, RecursionError) as error:
        raise ValueError(f"must be a JSON list of objects, it is damaged or cut off: {error}") from error


def _blocks(source: InputFile) -> Iterator[list[Any]]:
    """Yield the rows of each block: parsed up to its last brace at once, or row by row if that brace ends no row."""
    pending = source.file.read(_BLOCK_BYTES).removeprefix(_BYTE_ORDER_MARK).lstrip()
    if not pending.startswith(b"["):
        raise ValueError("it does not begin with [")
    pending, comma = pending[1:], b""
    # A row longer than a block is parsed again; the read size doubles each time, so that the total stays linear.
    while block := source.file.read(max(_BLOCK_BYTES, len(pending))):
        pending += block
        end = pending.rfind(b"}") + 1
        try:
            rows = json.loads(b"[%b]" % pending[:end].lstrip().removeprefix(comma)) if end else []
        except ValueError:  # nested objects, or damage
            rows, end = _complete_rows(pending, comma)
        if len(pending) - end > _ROW_MAX:
            raise ValueError(f"a row must have at most {_ROW_MAX} bytes")
        if rows:
            yield rows
            pending, comma = pending[end:], b","
    tail = pending.lstrip()
    yield json.loads(b"[" + tail.removeprefix(comma))


def _complete_rows(pending: bytes, comma: bytes) -> tuple[list[Any], int]:
    """Return the complete rows at the beginning of ``pending``, and the position of their end."""
    text = pending.decode("latin-1")  # one character a byte, so that positions in text and bytes agree
    decoder, plain = json.JSONDecoder(), pending.isascii()
    rows: list[Any] = []
    end = 0
    while True:
        start = _skip_blanks(text, end)
        if comma or rows:
            if text[start : start + 1] != ",":
                return rows, end
            start = _skip_blanks(text, start + 1)
        try:
            row, stop = decoder.raw_decode(text, start)
            rows.append(row if plain else json.loads(pending[start:stop]))
        except ValueError:
            return rows, end
        end = stop


def _skip_blanks(text: str, position: int) -> int:
    while text[position : position + 1] in {" ", "\t", "\r", "\n"}:
        position += 1
    return position
