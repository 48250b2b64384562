"""An MCAP file being written: chunks packed by lz4 in its quickest way, with indexes, as mcap.dev/spec describes it.

The mcap package packs without a choice of how hard: that took more time than all else of a replay, for a tenth fewer
bytes.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from struct import pack
from typing import IO, Any

from viewshed._extras import needed_for

MAGIC = b"\x89MCAP0\r\n"

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_STATISTICS, _SUMMARY_OFFSET, _DATA_END = 0x0B, 0x0E, 0x0F

_CHUNK_BYTES = 1 << 20
"""A chunk is written when it is longer than this."""

_QUICK = -8
"""Level of lz4: three times as quick as 0 to pack and twice to unpack, for an eighth more bytes."""


def _text(text: str) -> bytes:
    return _data(text.encode())


def _data(data: bytes) -> bytes:
    return pack("<I", len(data)) + data


def _record(opcode: int, *parts: bytes) -> bytes:
    return b"".join((pack("<BQ", opcode, sum(map(len, parts))), *parts))


def _texts(texts: Mapping[str, str]) -> bytes:
    return _data(b"".join(_text(key) + _text(value) for key, value in texts.items()))


def _numbers(numbers: Mapping[int, int]) -> bytes:
    return _data(b"".join(pack("<HQ", key, value) for key, value in numbers.items()))


@dataclass(slots=True)
class _Chunk:
    """The chunk being filled.

    Attributes:
        parts: its records, in pieces.
        size: of them in bytes.
        index: of each channel the times of its messages and where they begin.
    """

    parts: list[bytes] = field(default_factory=list)
    size: int = 0
    index: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def add(self, *parts: bytes) -> None:
        """Add the pieces of a record."""
        self.parts += parts
        self.size += sum(map(len, parts))


class McapFile:
    """An MCAP file being written.

    Args:
        path: of the file.
        profile: of its header: ``ros2``, or empty.

    Raises:
        ImportError: lz4 is not installed.
    """

    def __init__(self, path: Path, profile: str) -> None:
        with needed_for("writing MCAP"):
            from lz4.frame import compress
        self._compress = compress
        self._file: IO[bytes] = path.open("wb")
        self._at = 0
        self._write(MAGIC + _record(_HEADER, _text(profile), _text("viewshed")))
        self._chunk = _Chunk()
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._chunk_indexes: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._first_ns, self._last_ns = 0, 0

    def add_schema(self, name: str, encoding: str, definition: bytes) -> int:
        """Add a type of messages and return its number."""
        number = len(self._schemas) + 1
        self._schemas.append(
            _record(_SCHEMA, pack("<H", number), _text(name), _text(encoding), _data(definition))
        )  # fmt: skip
        self._chunk.add(self._schemas[-1])
        return number

    def add_channel(self, schema: int, topic: str, message_encoding: str, about: Mapping[str, str]) -> int:
        """Add a topic and return its number."""
        number = len(self._channels) + 1
        ids = pack("<HH", number, schema)
        self._channels.append(_record(_CHANNEL, ids, _text(topic), _text(message_encoding), _texts(about)))
        self._chunk.add(self._channels[-1])
        return number

    def add_message(self, channel: int, t_ns: int, data: bytes) -> None:
        """Add a message at a time in nanoseconds."""
        count = sum(self._counts.values())
        self._first_ns = t_ns if count == 0 else min(self._first_ns, t_ns)
        self._last_ns = t_ns if count == 0 else max(self._last_ns, t_ns)
        number = self._counts.get(channel, 0)
        self._counts[channel] = number + 1
        self._chunk.index.setdefault(channel, []).append((t_ns, self._chunk.size))
        self._chunk.add(pack("<BQHIQQ", _MESSAGE, 22 + len(data), channel, number, t_ns, t_ns), data)
        if self._chunk.size > _CHUNK_BYTES:
            self._end_chunk()

    def close(self) -> None:
        """Write what is left, the summary and the end."""
        if self._chunk.parts:
            self._end_chunk()
        self._write(_record(_DATA_END, pack("<I", 0)))  # 0: the data section has no checksum, its chunks have
        # 1. The summary: schemas, channels, statistics, indexes; then where each of these groups is.
        start, groups = self._at, self._groups()
        summary, offsets = b"", b""
        for opcode, records in groups:
            if records:
                content = b"".join(records)
                where = pack("<BQQ", opcode, start + len(summary), len(content))
                offsets += _record(_SUMMARY_OFFSET, where)
                summary += content
        # 2. The footer, with a checksum of all from the summary on, its own first fields included.
        offset_start = start + len(summary)
        footer = pack("<BQQQ", _FOOTER, 20, start, offset_start)
        self._write(summary + offsets + footer + pack("<I", zlib.crc32(summary + offsets + footer)) + MAGIC)
        self._file.close()

    def _groups(self) -> Sequence[tuple[int, list[bytes]]]:
        counts = pack(
            "<QHIIIIQQ", sum(self._counts.values()), len(self._schemas), len(self._channels), 0, 0,
            len(self._chunk_indexes), self._first_ns, self._last_ns,
        )  # fmt: skip
        return (
            (_SCHEMA, self._schemas), (_CHANNEL, self._channels),
            (_STATISTICS, [_record(_STATISTICS, counts, _numbers(self._counts))]), (_CHUNK_INDEX, self._chunk_indexes),
        )  # fmt: skip

    def _write(self, content: bytes) -> None:
        self._file.write(content)
        self._at += len(content)

    def _end_chunk(self) -> None:
        """Write the chunk and the index of its messages."""
        chunk, self._chunk = self._chunk, _Chunk()
        content = b"".join(chunk.parts)
        packed: Any = self._compress(content, compression_level=_QUICK)
        times_ns = [t_ns for of_channel in chunk.index.values() for t_ns, _ in of_channel] or [0]
        span = pack("<QQ", min(times_ns), max(times_ns))
        sizes = pack("<QI", len(content), zlib.crc32(content))
        start = self._at
        self._write(_record(_CHUNK, span, sizes, _text("lz4"), pack("<Q", len(packed)), packed))
        length, offsets = self._at - start, dict[int, int]()
        for channel, of_channel in chunk.index.items():
            offsets[channel] = self._at
            entries = b"".join(pack("<QQ", *entry) for entry in of_channel)
            self._write(_record(_MESSAGE_INDEX, pack("<H", channel), _data(entries)))
        index = (
            span, pack("<QQ", start, length), _numbers(offsets), pack("<Q", self._at - start - length), _text("lz4"),
            pack("<QQ", len(packed), len(content)),
        )  # fmt: skip
        self._chunk_indexes.append(_record(_CHUNK_INDEX, *index))
