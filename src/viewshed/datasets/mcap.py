"""Messages of one MCAP file, read record by record: a file that was cut off gives what lies before the cut.

Source: https://mcap.dev/spec. Every length is checked against what is there.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

MAGIC = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _END = 0x03, 0x04, 0x05, 0x06, (0x02, 0x0F)
_MAX_CHUNK_BYTES = 2_000_000_000


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it is stored.

    Attributes:
        topic: what it belongs to.
        kind: its type, as ROS 2 writes it.
        encoding: ``cdr`` or ``ros1``.
        t_ns: when it was recorded, nanoseconds.
        where: how :meth:`McapFile.message` finds it again.
        raw: its bytes.
    """

    topic: str
    kind: str
    encoding: str
    t_ns: int
    where: str
    raw: bytes


class McapFile:
    """One MCAP file, read from its start.

    Args:
        path: the file.

    Raises:
        ValueError: it does not begin like one.
        OSError: it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO = io.BytesIO()
        self._file = path.open("rb")
        self._size = path.stat().st_size
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str, str]] = {}
        self._chunk: tuple[int, bytes] = (-1, b"")
        if self._file.read(len(MAGIC)) != MAGIC:
            self.close()
            raise ValueError("is no MCAP file: its first bytes are others")

    def __del__(self) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def types(self) -> dict[str, str]:
        """Topic → type of its messages, of the channels that were met so far."""
        return {topic: kind for topic, kind, _ in self._channels.values()}

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types, in the order of the file.

        Raises:
            ValueError: the file is damaged or cut off there; the messages before have been yielded.
        """
        for opcode, start, record in self._records():
            if opcode != _CHUNK:
                yield from self._take(opcode, record, f"{start}", kinds)
                continue
            content = self._unpacked(start, record)
            for inner, at, body in _split(content):
                yield from self._take(inner, body, f"{start}:{at}", kinds)

    def message(self, where: str) -> bytes:
        """Return the bytes of one message.

        Raises:
            ValueError: there is none, or its chunk is damaged.
        """
        start, _, at = where.partition(":")
        record = self._record_at(int(start))
        if not at:
            return record[22:]
        content = self._unpacked(int(start), record)
        (length,) = struct.unpack_from("<Q", content, int(at) - 8)
        return content[int(at) + 22 : int(at) + length]

    def _records(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield (opcode, first byte of the content, content) of each record; chunks are not unpacked."""
        at = len(MAGIC)
        while at < self._size:
            self._file.seek(at)
            head = self._file.read(9)
            if len(head) < 9:
                raise ValueError(f"is cut off at byte {at}")
            opcode, length = struct.unpack("<BQ", head)
            if opcode in _END:
                return
            if length > self._size - at - 9:
                raise ValueError(
                    f"is cut off: a record at byte {at} has {length} bytes, {self._size - at - 9} are left"
                )
            if opcode in (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK):
                yield opcode, at + 9, self._file.read(length)
            at += 9 + length
        raise ValueError("is cut off: its end is missing")

    def _record_at(self, start: int) -> bytes:
        self._file.seek(start - 8)
        (length,) = struct.unpack("<Q", self._file.read(8))
        if length > self._size - start:
            raise ValueError(f"is cut off: a record at byte {start} has {length} bytes")
        return self._file.read(length)

    def _take(self, opcode: int, record: bytes, where: str, kinds: Collection[str]) -> Iterator[Message]:
        try:
            if opcode == _SCHEMA:
                self._schemas[struct.unpack_from("<H", record)[0]] = _text(record, 2)[0]
            elif opcode == _CHANNEL:
                self._take_channel(record)
            elif opcode == _MESSAGE:
                number, _, t_ns = struct.unpack_from("<HIQ", record)
                topic, kind, encoding = self._channels[number]
                if kind in kinds:
                    yield Message(topic, kind, encoding, t_ns, where, record[22:])
        except (struct.error, KeyError) as error:
            raise ValueError(f"is damaged: the record at {where} does not hold what it should: {error!r}") from error

    def _take_channel(self, record: bytes) -> None:
        number, schema = struct.unpack_from("<HH", record)
        topic, at = _text(record, 4)
        encoding, _ = _text(record, at)
        self._channels[number] = (topic, _ros2_name(self._schemas.get(schema, "")), encoding)

    def _unpacked(self, start: int, record: bytes) -> bytes:
        if self._chunk[0] == start:
            return self._chunk[1]
        try:
            (size,) = struct.unpack_from("<Q", record, 16)
            packing, at = _text(record, 28)
            (length,) = struct.unpack_from("<Q", record, at)
        except struct.error as error:
            raise ValueError(f"is damaged: the chunk at byte {start} is too short") from error
        packed = record[at + 8 : at + 8 + length]
        if len(packed) < length or size > _MAX_CHUNK_BYTES:
            raise ValueError(f"is damaged: the chunk at byte {start} names {length} and {size} bytes")
        self._chunk = (start, _unpack(packed, packing, size, start))
        return self._chunk[1]


def _unpack(packed: bytes, packing: str, size: int, start: int) -> bytes:
    import pyarrow as pa

    if packing not in ("", "lz4", "zstd"):
        raise ValueError(f"has a chunk packed as {packing!r}, which is not read")
    try:
        content = packed if not packing else pa.Codec(packing).decompress(packed, size, asbytes=True)
    except (OSError, ValueError, MemoryError) as error:
        raise ValueError(f"is damaged: the chunk at byte {start} does not unpack: {error}") from error
    if len(content) != size:
        raise ValueError(f"is damaged: the chunk at byte {start} unpacks to {len(content)} bytes, not {size}")
    return bytes(content)


def _split(content: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield (opcode, first byte of the content, content) of each record in an unpacked chunk."""
    at = 0
    while at < len(content):
        if at + 9 > len(content):
            raise ValueError("is damaged: a chunk ends within a record")
        opcode, length = struct.unpack_from("<BQ", content, at)
        if length > len(content) - at - 9:
            raise ValueError(f"is damaged: a record of {length} bytes leaves its chunk")
        yield opcode, at + 9, content[at + 9 : at + 9 + length]
        at += 9 + length


def _text(record: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", record, at)
    return record[at + 4 : at + 4 + length].decode("utf-8", "replace"), at + 4 + length


def _ros2_name(name: str) -> str:
    """Return a type's name as ROS 2 writes it.

    >>> _ros2_name("nav_msgs/Odometry")
    'nav_msgs/msg/Odometry'
    """
    package, _, rest = name.partition("/")
    return name if not rest or "/" in rest else f"{package}/msg/{rest}"
