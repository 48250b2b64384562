"""Bags as streams of messages: ROS 1 files, MCAP files, SQLite files of ROS 2, and folders of these.

Each is read from its start, record by record, so that a bag that was cut off gives what lies before the cut. Nothing in
it is believed: lengths are checked against what is there, a chunk may unpack to 200 times its size and all chunks of a
file to 200 times the file's, and files that only keep a reader busy are refused. (The reader of the ``mcap`` package
checks none of this and takes 1.6 times as long; rosbags' readers need an index that was written at the end, and follow
one that leads in circles.)

Sources: https://mcap.dev/spec, http://wiki.ros.org/Bags/Format/2.0, rosbag2_storage_sqlite3.
"""

from __future__ import annotations

import bz2
import contextlib
import io
import sqlite3
import struct
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, NamedTuple, Protocol

from viewshed._extras import needed_for
from viewshed.io._input import MAX_RATIO, inside, one_line, unpack_limit
from viewshed.io.formats import BAG_SUFFIXES

MCAP_MAGIC = b"\x89MCAP0\r\n"
ROS1_MAGIC = b"#ROSBAG V2.0\n"
_METADATA = "metadata.yaml"
_PACKED = (".zstd", ".zst")
_EMPTY_RECORDS_MAX = 100_000
_ROW_BYTES_MIN = 8
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it is stored.

    Attributes:
        topic: what it belongs to.
        kind: its type, as ROS 2 writes it.
        encoding: ``cdr`` or ``ros1``.
        t_ns: when it was recorded, nanoseconds.
        where: how :meth:`BagFile.message` finds it again.
        raw: its bytes.
    """

    topic: str
    kind: str
    encoding: str
    t_ns: int
    where: str
    raw: bytes


class BagFile(Protocol):
    """One opened bag."""

    @property
    def types(self) -> dict[str, str]:
        """Topic → type of its messages, of the topics that were met so far."""
        ...

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types in the order of the file; a ValueError where it is damaged."""
        ...

    def message(self, where: str) -> bytes:
        """Return the bytes of one message; a ValueError where it is not there any more."""
        ...

    def close(self) -> None:
        """Close the bag."""
        ...


def bags_in(place: Path) -> list[Path]:
    """Return the bags at a place, by names alone: itself, or those in the folder, in alphabetical order."""
    if place.is_file():
        return [place] if _is_bag_file(place) else []
    if _is_ros2(place):
        return [place]
    return sorted(path for path in place.iterdir() if _is_bag_file(path) or _is_ros2(path))


def _is_bag_file(path: Path) -> bool:
    return path.name.lower().endswith(BAG_SUFFIXES)


def _is_ros2(folder: Path) -> bool:
    return (folder / _METADATA).is_file()


def open_bag(root: Path, path: Path) -> BagFile:
    """Return an opened bag; a ValueError where it does not begin like one, or a link leads out of the recording."""
    inside(root, path)
    if path.is_dir():
        return FolderBag(root, path)
    packed = path.name.lower().endswith(_PACKED)
    stream: BinaryIO = io.BytesIO(_unpacked_zstd(path.read_bytes())) if packed else path.open("rb")
    budget = _UnpackBudget.of(path.stat().st_size)
    head = stream.read(16)
    stream.seek(0)
    if head.startswith(MCAP_MAGIC):
        return RecordBag(stream, _Mcap(), budget)
    if head.startswith(ROS1_MAGIC):
        return RecordBag(stream, _Ros1(), budget)
    with stream:
        if head == b"SQLite format 3\0":
            return SqliteBag(stream.read() if packed else path, budget)
    if not head:
        raise ValueError("the file is empty")
    if path.suffix in {".bag", ".mcap"}:
        kind = "an MCAP file" if path.suffix == ".mcap" else "a ROS 1 bag"
        raise ValueError(f"does not begin like {kind}; it is damaged or of another format")
    raise ValueError("is damaged: it is no SQLite database")


@dataclass(slots=True)
class _UnpackBudget:
    """How many bytes all chunks and messages of a file may still unpack to: many small ones add up as a large one."""

    limit: int
    spent: int = 0

    @classmethod
    def of(cls, file_bytes: int) -> _UnpackBudget:
        return cls(max(MAX_RATIO * file_bytes, unpack_limit(file_bytes)))

    def spend(self, count: int) -> None:
        self.spent += count
        if self.spent > self.limit:
            raise ValueError(f"is damaged: it unpacks to more than {self.limit} bytes in all; refused")


Read = Callable[[int, int], bytes]
"""(first byte, number of bytes) → what is there, of a file or of a chunk that was unpacked."""


class _Record(NamedTuple):
    """One record: where it ends, and what is used of a message or a chunk (a tuple: a bag has millions).

    Attributes:
        end: first byte behind it.
        kind: ``message``, ``chunk``, ``other`` or ``end``.
        start: first byte of the message, or of the packed bytes.
        length: how many bytes these are.
        channel: number of the message's channel.
        t_ns: when the message was recorded.
        packing: how the chunk is packed, "" where it is not.
        unpacked: to how many bytes.
    """

    end: int
    kind: str = "other"
    start: int = 0
    length: int = 0
    channel: int = 0
    t_ns: int = 0
    packing: str = ""
    unpacked: int = 0


class _Layout(Protocol):
    """How a kind of file writes its records; it keeps the topics and types of the channels that it meets."""

    magic: bytes
    channels: dict[int, tuple[str, str, str]]

    def record(self, read: Read, at: int, stop: int) -> _Record:
        """Return the record at ``at`` of content that ends at ``stop``; a ValueError where it is not whole."""
        ...


class _Mcap:
    """MCAP: opcode, length, content."""

    magic = MCAP_MAGIC

    def __init__(self) -> None:
        self.channels: dict[int, tuple[str, str, str]] = {}
        self._schemas: dict[int, str] = {}

    def record(self, read: Read, at: int, stop: int) -> _Record:
        head = read(at, 9)
        if len(head) < 9:
            raise ValueError(f"is cut off at byte {at}: its end is missing")
        opcode, length = struct.unpack("<BQ", head)
        start = at + 9
        if opcode in {0x02, 0x0F}:  # footer, or the end of the data
            return _Record(stop, "end")
        if length > stop - start:
            raise ValueError(f"is cut off: a record at byte {at} has {length} bytes, {stop - start} are left")
        match opcode:
            case 0x03:
                content = read(start, min(length, 1000))
                self._schemas[struct.unpack_from("<H", content)[0]] = _text(content, 2)[0]
            case 0x04:
                content = read(start, length)
                number, schema = struct.unpack_from("<HH", content)
                topic, after = _text(content, 4)
                kind = _name_in_ros2(self._schemas.get(schema, ""))
                self.channels[number] = (topic, kind, _text(content, after)[0])
            case 0x05:
                number, _, t_ns, _ = struct.unpack("<HIQQ", read(start, min(length, 22)))
                return _Record(start + length, "message", start + 22, length - 22, number, t_ns)
            case 0x06:
                content = read(start, min(length, 200))
                unpacked = struct.unpack_from("<Q", content, 16)[0]
                packing, after = _text(content, 28)
                packed = struct.unpack_from("<Q", content, after)[0]
                if packed > length - after - 8:
                    raise ValueError(f"is damaged: the chunk at byte {at} names {packed} bytes")
                return _Record(start + length, "chunk", start + after + 8, packed, packing=packing, unpacked=unpacked)
        return _Record(start + length)


class _Ros1:
    """ROS 1: length, header of named fields, length, data."""

    magic = ROS1_MAGIC

    def __init__(self) -> None:
        self.channels: dict[int, tuple[str, str, str]] = {}
        self._index = 0

    def record(self, read: Read, at: int, stop: int) -> _Record:
        if at == stop and self._index:
            return _Record(stop, "end")
        header, after = self._sized(read, at, stop)
        (length,) = struct.unpack("<I", read(after, 4).ljust(4, b"\xff"))
        start, end = after + 4, after + 4 + length
        if end > stop:
            raise ValueError(f"is damaged or cut off: a record at byte {at} has {length} bytes")
        fields = _fields(header)
        match fields.get(b"op"):
            case b"\x02":
                number, seconds, nanoseconds = struct.unpack("<III", fields[b"conn"] + fields[b"time"])
                return _Record(end, "message", start, length, number, seconds * 1_000_000_000 + nanoseconds)
            case b"\x03":
                (self._index,) = struct.unpack("<Q", fields[b"index_pos"])
            case b"\x05":
                packing, unpacked = fields[b"compression"].decode(), struct.unpack("<I", fields[b"size"])[0]
                packing = "" if packing == "none" else packing
                return _Record(end, "chunk", start, length, packing=packing, unpacked=unpacked)
            case b"\x07":
                (number,) = struct.unpack("<I", fields[b"conn"])
                kind = _fields(read(start, length)).get(b"type", b"").decode("utf-8", "replace")
                self.channels[number] = (fields[b"topic"].decode("utf-8", "replace"), _name_in_ros2(kind), "ros1")
        return _Record(end)

    def _sized(self, read: Read, at: int, stop: int) -> tuple[bytes, int]:
        """Return the bytes whose length stands at ``at``, and where they end."""
        length = int.from_bytes(read(at, 4).ljust(4, b"\xff"), "little")
        if length > stop - at - 4:
            raise ValueError(f"is damaged or cut off at byte {at}")
        return read(at + 4, length), at + 4 + length


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields of a ROS 1 header: length, name, =, value."""
    fields: dict[bytes, bytes] = {}
    at = 0
    while at < len(header):
        (length,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        fields[name] = value
        at += 4 + length
    return fields


def _text(content: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", content, at)
    return content[at + 4 : at + 4 + length].decode("utf-8", "replace"), at + 4 + length


def _name_in_ros2(name: str) -> str:
    """Return a type's name as ROS 2 writes it.

    >>> _name_in_ros2("nav_msgs/Odometry")
    'nav_msgs/msg/Odometry'
    """
    package, _, rest = name.partition("/")
    return name if not rest or "/" in rest else f"{package}/msg/{rest}"


class RecordBag:
    """A bag of records, MCAP or ROS 1, of which some are chunks of packed records."""

    def __init__(self, file: BinaryIO, layout: _Layout, budget: _UnpackBudget) -> None:
        self._file, self._layout, self._budget = file, layout, budget
        self._size = file.seek(0, io.SEEK_END)
        self._unpacked: tuple[int, bytes] = (-1, b"")
        self._empty = 0

    def __del__(self) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def types(self) -> dict[str, str]:
        """Topic → type of its messages."""
        return {topic: kind for topic, kind, _ in self._layout.channels.values()}

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types, in the order of the file."""
        for at, record in self._records(self._read, len(self._layout.magic), self._size):
            if record.kind != "chunk":
                yield from self._wanted(record, -1, self._read, kinds)
                continue
            read = _reader_of(self._chunk(at, record))
            self._budget.spend(record.unpacked)
            for _, inner in self._records(read, 0, record.unpacked):
                yield from self._wanted(inner, at, read, kinds)

    def message(self, where: str) -> bytes:
        """Return the bytes of one message."""
        chunk, start, length = map(int, where.split(":"))
        if chunk < 0:
            return self._read(start, length)
        content = self._chunk(chunk, self._record(self._read, chunk, self._size))
        return content[start : start + length]

    def _read(self, at: int, count: int) -> bytes:
        self._file.seek(at)
        return self._file.read(count)

    def _records(self, read: Read, at: int, stop: int) -> Iterator[tuple[int, _Record]]:
        """Yield each record with its first byte; many in a row without a message are refused."""
        while at < stop or read == self._read:
            record = self._record(read, at, stop)
            if record.kind == "end":
                return
            self._empty = 0 if record.kind == "message" else self._empty + 1
            if self._empty > _EMPTY_RECORDS_MAX:
                raise ValueError(f"is damaged: {self._empty} records before byte {at} hold no message")
            yield at, record
            at = record.end

    def _record(self, read: Read, at: int, stop: int) -> _Record:
        try:
            return self._layout.record(read, at, stop)
        except (struct.error, KeyError) as error:
            raise ValueError(f"is damaged: the record at byte {at} does not hold what it should: {error!r}") from error

    def _wanted(self, record: _Record, chunk: int, read: Read, kinds: Collection[str]) -> Iterator[Message]:
        if record.kind != "message":
            return
        if record.channel not in self._layout.channels:
            raise ValueError(f"is damaged: a message names channel {record.channel}, which is not there")
        topic, kind, encoding = self._layout.channels[record.channel]
        if kind in kinds:
            where = f"{chunk}:{record.start}:{record.length}"
            yield Message(topic, kind, encoding, record.t_ns, where, read(record.start, record.length))

    def _chunk(self, at: int, record: _Record) -> bytes:
        """Return the unpacked bytes of a chunk; the last one is kept."""
        if self._unpacked[0] != at:
            if record.unpacked > unpack_limit(record.length):
                sizes = f"{record.length} and {record.unpacked} bytes"
                raise ValueError(f"is damaged: the chunk at byte {at} names {sizes}; refused")
            packed = self._read(record.start, record.length)
            self._unpacked = (at, _unpack(packed, record.packing, record.unpacked, at))
        return self._unpacked[1]


def _reader_of(content: bytes) -> Read:
    return lambda at, count: content[at : at + count]


def _unpack(packed: bytes, packing: str, size: int, at: int) -> bytes:
    """Return the bytes of a chunk, ``size`` of them and never more."""
    if packing not in _UNPACKERS:
        raise ValueError(f"has a chunk packed as {packing!r}, which is not read")
    try:
        content = _UNPACKERS[packing](packed, size + 1)
    except (OSError, EOFError, ValueError, MemoryError) as error:
        raise ValueError(f"is damaged: the chunk at byte {at} does not unpack: {error}") from error
    if len(content) != size:
        length = str(len(content)) if len(content) < size else "more"
        raise ValueError(f"is damaged: the chunk at byte {at} unpacks to {length} bytes, not {size}")
    return content


def _stored(packed: bytes, limit: int) -> bytes:
    return packed


def _bunzip2(packed: bytes, limit: int) -> bytes:
    return bz2.BZ2Decompressor().decompress(packed, limit)


def _unlz4(packed: bytes, limit: int) -> bytes:
    with needed_for("reading a bag packed by lz4"):
        from lz4.frame import LZ4FrameDecompressor
    try:
        return bytes(LZ4FrameDecompressor().decompress(packed, limit))
    except RuntimeError as error:  # all that it raises
        raise ValueError(str(error)) from error


def _unzstd(packed: bytes, limit: int) -> bytes:
    with needed_for("reading a bag packed by zstd"):
        import zstandard
    try:
        with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as stream:
            return bytes(stream.read(limit))
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error


_UNPACKERS = {"": _stored, "bz2": _bunzip2, "lz4": _unlz4, "zstd": _unzstd}
"""What unpacks a chunk to at most so many bytes, by the name of the packing."""


class SqliteBag:
    """One SQLite file of a ROS 2 bag: the file, or what it holds."""

    def __init__(self, content: Path | bytes, budget: _UnpackBudget) -> None:
        self.types: dict[str, str] = {}
        self._budget = budget
        self._rows_left = (len(content) if isinstance(content, bytes) else content.stat().st_size) // _ROW_BYTES_MIN
        where = ":memory:" if isinstance(content, bytes) else f"{content.absolute().as_uri()}?mode=ro&immutable=1"
        # A bag that nobody holds any more is closed by whichever thread collects it.
        self._base = sqlite3.connect(where, uri=True, check_same_thread=False)
        self._steps_left = 100 + self._rows_left // 100
        self._base.set_progress_handler(self._step, 10_000)
        try:
            if isinstance(content, bytes):
                self._base.deserialize(content)
            self._topics = self._read_topics()
        except BaseException:
            self.close()
            raise

    def __del__(self) -> None:
        with contextlib.suppress(AttributeError):  # where it could not be opened at all
            self.close()

    def close(self) -> None:
        """Close the data base."""
        self._base.close()

    def _step(self) -> bool:
        """Count 10,000 steps of the data base; True ends it: pages that share their children make endless tables."""
        self._steps_left -= 1
        return self._steps_left < 0

    def _read_topics(self) -> dict[int, tuple[str, str, str]]:
        with _sqlite_errors():
            tables = dict(self._base.execute("SELECT name, type FROM sqlite_master LIMIT 1000").fetchall())
            if tables.get("topics") != "table" or tables.get("messages") != "table":
                raise ValueError("must have tables named topics and messages; it is no ROS 2 bag")
            columns = self._base.execute("SELECT hidden FROM pragma_table_xinfo('messages')").fetchall()
            if any(hidden for (hidden,) in columns):
                raise ValueError("must have a table of messages without computed columns")
            rows = self._base.execute("SELECT id, name, type, serialization_format FROM topics LIMIT 10000").fetchall()
        topics = {int(number): (str(name), str(kind), str(form) or "cdr") for number, name, kind, form in rows}
        self.types = {topic: kind for topic, kind, _ in topics.values()}
        return topics

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types, in the order of the file."""
        with _sqlite_errors():
            for row, topic_id, t_ns in self._base.execute("SELECT id, topic_id, timestamp FROM messages"):
                self._rows_left -= 1
                if self._rows_left < 0:
                    raise ValueError("is damaged: it has more messages than its size allows")
                topic, kind, encoding = self._topics.get(topic_id, ("", "", ""))
                if kind not in kinds:
                    continue
                if not isinstance(t_ns, int):
                    raise ValueError(f"is damaged: message {row} has no time")
                raw = self.message(str(row))
                self._budget.spend(len(raw))
                yield Message(topic, kind, encoding, t_ns, str(row), raw)

    def message(self, where: str) -> bytes:
        """Return the bytes of one message."""
        with _sqlite_errors():
            row = self._base.execute("SELECT data FROM messages WHERE id = ?", (int(where),)).fetchone()
        if row is None or not isinstance(row[0], bytes):
            raise ValueError(f"is damaged: message {where} is no bytes")
        return _unpacked_zstd(row[0]) if row[0][:4] == _ZSTD_MAGIC else row[0]  # rosbag2 may pack each message


def _unpacked_zstd(packed: bytes) -> bytes:
    """Return what a file or a message holds, whose unpacked length nobody tells."""
    limit = unpack_limit(len(packed))
    try:
        content = _unzstd(packed, limit + 1)
    except (ValueError, MemoryError) as error:
        raise ValueError(f"is damaged: its zstd content does not unpack: {error}") from error
    if len(content) > limit:
        raise ValueError(f"unpacks to more than {limit} bytes; refused (a file is unpacked with: zstd -d)")
    return content


@contextlib.contextmanager
def _sqlite_errors() -> Iterator[None]:
    try:
        yield
    except (sqlite3.Error, TypeError, OverflowError) as error:
        raise ValueError(f"is damaged: {one_line(error)}") from error


class FolderBag:
    """A folder of a ROS 2 bag: its SQLite or MCAP files, one after the other. Its metadata.yaml is not needed."""

    def __init__(self, root: Path, folder: Path) -> None:
        self._root = root
        self._files = sorted(path for path in folder.iterdir() if _is_bag_file(path))
        if not self._files:
            raise ValueError("is damaged: it holds no .db3 and no .mcap file")
        self._open: tuple[int, BagFile] | None = None
        self.types: dict[str, str] = {}

    def close(self) -> None:
        """Close the file that is open."""
        if self._open is not None:
            self._open[1].close()
        self._open = None

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types, file by file; what is wrong with one does not stop the others."""
        problems: list[str] = []
        for number, path in enumerate(self._files):
            try:
                bag = self._bag(number)
                for message in bag.messages(kinds):
                    yield replace(message, where=f"{number}/{message.where}")
            except (ValueError, OSError) as error:
                problems.append(f"{path.name} {one_line(error)}")
            else:
                self.types |= bag.types
        if problems:
            raise ValueError("; ".join(problems))

    def message(self, where: str) -> bytes:
        """Return the bytes of one message."""
        number, _, inner = where.partition("/")
        return self._bag(int(number)).message(inner)

    def _bag(self, number: int) -> BagFile:
        if self._open is None or self._open[0] != number:
            self.close()
            self._open = (number, open_bag(self._root, self._files[number]))
        return self._open[1]
