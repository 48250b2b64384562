"""Read bags as streams of messages: ROS 1 files, MCAP files, SQLite files of ROS 2, and folders of these.

The packages ``mcap`` and ``rosbags`` parse records. Bags are untrusted: lengths are checked against the file size, a
chunk may decompress to at most 200 times its size and all chunks of a file to 200 times the file size, and files with
endless records are refused. A truncated MCAP file is read up to the cut; a ROS 1 bag is read by the index at its end.

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
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO, Protocol

from viewshed._extras import needed_for
from viewshed._files import by_numbers
from viewshed.io._input import MAX_RATIO, inside, one_line, unpack_limit
from viewshed.io.formats import BAG_SUFFIXES

MCAP_MAGIC = b"\x89MCAP0\r\n"
ROS1_MAGIC = b"#ROSBAG V2.0\n"
_METADATA = "metadata.yaml"
_ZSTD_SUFFIXES = (".zstd", ".zst")
_MAX_EMPTY_RECORDS = 100_000
_MIN_ROW_BYTES = 8
_LZ4_STEP_BYTES = 1 << 20
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True, slots=True)
class Message:
    """One serialized message."""

    topic: str  # name of its topic
    kind: str  # message type in ROS 2 notation
    encoding: str  # ``cdr`` or ``ros1``
    t_ns: int  # recording time in nanoseconds
    where: str  # position for :meth:`BagFile.message`
    raw: bytes  # serialized bytes


class BagFile(Protocol):
    """One opened bag."""

    @property
    def types(self) -> dict[str, str]:
        """Topic → message type, for the topics read so far."""
        ...

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types in file order; raise ValueError where the file is damaged."""
        ...

    def message(self, where: str) -> bytes:
        """Return the bytes of one message; raise ValueError if it no longer exists."""
        ...

    def close(self) -> None:
        """Close the bag."""
        ...


def bags_in(place: Path) -> list[Path]:
    """Return the bags at a place, by file names alone: itself, or those in the folder, sorted by numbers."""
    if place.is_file():
        return [place] if _is_bag_file(place) else []
    if _is_ros2(place):
        return [place]
    return sorted([*_bag_files(place), *(path for path in place.iterdir() if _is_ros2(path))], key=by_numbers)


def _bag_files(folder: Path) -> list[Path]:
    """Return the bag files in a folder, sorted by numbers; without compressed ones that are also there uncompressed."""
    files = sorted((path for path in folder.iterdir() if _is_bag_file(path)), key=by_numbers)
    return [path for path in files if path.suffix.lower() not in _ZSTD_SUFFIXES or path.with_suffix("") not in files]


def _is_bag_file(path: Path) -> bool:
    return path.name.lower().endswith(BAG_SUFFIXES)


def _is_ros2(folder: Path) -> bool:
    return (folder / _METADATA).is_file()


def open_bag(root: Path, path: Path) -> BagFile:
    """Open a bag; raise ValueError if its first bytes are unknown or a link leads out of the recording."""
    inside(root, path)
    if path.is_dir():
        return FolderBag(root, path)
    packed = path.name.lower().endswith(_ZSTD_SUFFIXES)
    stream: BinaryIO = io.BytesIO(_unpacked_zstd(path.read_bytes())) if packed else _BoundedFile(path)
    budget = _UnpackBudget.of(path.stat().st_size)
    with contextlib.ExitStack() as on_failure:
        on_failure.callback(stream.close)
        head = stream.read(16)
        stream.seek(0)
        for magic, bag_type in ((MCAP_MAGIC, McapBag), (ROS1_MAGIC, Ros1Bag)):
            if head.startswith(magic):
                bag: BagFile = bag_type(stream, budget)
                on_failure.pop_all()
                return bag
        if head == b"SQLite format 3\0":
            return SqliteBag(stream.read() if packed else path, budget)
    if not head:
        raise ValueError("the file is empty")
    if path.suffix in {".bag", ".mcap"}:
        kind = "an MCAP file" if path.suffix == ".mcap" else "a ROS 1 bag"
        raise ValueError(f"does not begin like {kind}; it is damaged or of another format")
    raise ValueError("is damaged: it is no SQLite database")


class _BoundedFile(io.BufferedReader):
    """A file whose reads allocate at most the rest of the file, even if a record claims more bytes."""

    def __init__(self, path: Path) -> None:
        raw = io.FileIO(path)
        super().__init__(raw)
        self._size = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """Read at most ``size`` bytes; the rest of the file if it is negative."""
        remaining = max(self._size - self.tell(), 0)
        return super().read(remaining if size is None or size < 0 else min(size, remaining))


@dataclass(slots=True)
class _UnpackBudget:
    """Limit of the total decompressed size of a file, over all its chunks and messages."""

    limit: int
    spent: int = 0

    @classmethod
    def of(cls, file_bytes: int) -> _UnpackBudget:
        return cls(max(MAX_RATIO * file_bytes, unpack_limit(file_bytes)))

    def spend(self, count: int) -> None:
        self.spent += count
        if self.spent > self.limit:
            raise ValueError(f"is damaged: it unpacks to more than {self.limit} bytes in all; refused")


class _ChunkedBag:
    """A bag file with chunks of compressed records; caches the content of the last chunk."""

    def __init__(self, file: BinaryIO, budget: _UnpackBudget) -> None:
        self._file, self._budget = file, budget
        self._chunk: tuple[int, bytes] = (-1, b"")

    def __del__(self) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read(self, at: int, count: int) -> bytes:
        self._file.seek(at)
        return self._file.read(count)

    def _unpack(self, at: int, packed: bytes, packing: str, size: int | None = None) -> bytes:
        """Decompress a chunk (to ``size`` bytes, if known) and cache its content."""
        limit = unpack_limit(len(packed))
        if packing not in _DECOMPRESSORS:
            raise ValueError(f"has a chunk packed as {packing!r}, which is not read")
        if size is not None and size > limit:
            raise ValueError(f"is damaged: the chunk at byte {at} names {len(packed)} and {size} bytes; refused")
        try:
            content = _DECOMPRESSORS[packing](packed, limit + 1 if size is None else size + 1)
        except (OSError, EOFError, ValueError, MemoryError) as error:
            raise ValueError(f"is damaged: the chunk at byte {at} does not unpack: {error}") from error
        if len(content) > limit or size not in {None, len(content)}:
            raise ValueError(f"is damaged: the chunk at byte {at} unpacks to {len(content)} bytes, not {size or limit}")
        self._chunk = (at, content)
        return content


class McapBag(_ChunkedBag):
    """An MCAP file, read from its start, so that a truncated file is read up to the cut."""

    def __init__(self, file: BinaryIO, budget: _UnpackBudget) -> None:
        super().__init__(file, budget)
        with needed_for("reading MCAP"):
            from mcap import data_stream, records
        self._mcap, self._stream = records, data_stream.ReadDataStream
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str, str]] = {}
        self._empty = 0

    @property
    def types(self) -> dict[str, str]:
        """Topic → message type."""
        return {topic: kind for topic, kind, _ in self._channels.values()}

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types, in file order."""
        return self._messages(kinds, -1, self._file, len(MCAP_MAGIC), self._file.seek(0, io.SEEK_END))

    def message(self, where: str) -> bytes:
        """Return the bytes of one message."""
        chunk, start, length = map(int, where.split(":"))
        if chunk < 0:
            return self._read(start, length)
        if self._chunk[0] != chunk:
            self._content(chunk)
        return self._chunk[1][start : start + length]

    def _messages(self, kinds: Collection[str], chunk: int, file: BinaryIO, at: int, stop: int) -> Iterator[Message]:
        """Yield the messages of a chunk, or of the file (``chunk`` is -1) up to the end of its data section."""
        while at < stop or chunk < 0:
            file.seek(at)
            head = file.read(9)
            if len(head) < 9:
                raise ValueError(f"is cut off at byte {at}: its end is missing")
            opcode, length = struct.unpack("<BQ", head)
            end = at + 9 + length
            if opcode in {0x02, 0x0F}:  # footer, or end of the data section
                return
            if end > stop:
                raise ValueError(f"is cut off: a record at byte {at} has {length} bytes, {stop - at - 9} are left")
            self._empty = 0 if opcode == 0x05 else self._empty + 1
            if self._empty > _MAX_EMPTY_RECORDS:
                raise ValueError(f"is damaged: {self._empty} records before byte {at} hold no message")
            if opcode == 0x03:
                schema = self._parsed(self._mcap.Schema, file, at)
                self._schemas[schema.id] = schema.name
            elif opcode == 0x04:
                channel = self._parsed(self._mcap.Channel, file, at)
                kind = _name_in_ros2(self._schemas.get(channel.schema_id, ""))
                self._channels[channel.id] = (channel.topic, kind, channel.message_encoding)
            elif opcode == 0x05:  # parsed here: the package copies the bytes twice
                number, _, t_ns, _ = struct.unpack("<HIQQ", file.read(22).ljust(22, b"\xff"))
                if number not in self._channels or length < 22:
                    raise ValueError(f"is damaged: a message names channel {number}, which is not there")
                topic, kind, encoding = self._channels[number]
                if kind in kinds:
                    where = f"{chunk}:{at + 31}:{length - 22}"
                    yield Message(topic, kind, encoding, t_ns, where, file.read(length - 22))
            elif opcode == 0x06 and chunk < 0:
                content = self._content(at)
                self._budget.spend(len(content))
                yield from self._messages(kinds, at, io.BytesIO(content), 0, len(content))
            at = end

    def _content(self, at: int) -> bytes:
        self._file.seek(at + 9)
        chunk = self._parsed(self._mcap.Chunk, self._file, at)
        return self._unpack(at, chunk.data, chunk.compression, chunk.uncompressed_size)

    def _parsed(self, kind: Any, file: BinaryIO, at: int) -> Any:
        """Parse the record at the current position of a file."""
        try:
            return kind.read(self._stream(file))
        except Exception as error:  # the package raises several types on damaged records
            raise ValueError(f"is damaged: the record at byte {at} cannot be read: {error!r}") from error


def _name_in_ros2(name: str) -> str:
    """Convert the name of a message type to ROS 2 notation.

    >>> _name_in_ros2("nav_msgs/Odometry")
    'nav_msgs/msg/Odometry'
    """
    package, _, rest = name.partition("/")
    return name if not rest or "/" in rest else f"{package}/msg/{rest}"


class Ros1Bag(_ChunkedBag):
    """A ROS 1 bag, read by the index at its end."""

    def __init__(self, file: BinaryIO, budget: _UnpackBudget) -> None:
        super().__init__(file, budget)
        self._rosbags, reader = _ros1_reader()
        self._packings = {unpack: name.replace("none", "") for name, unpack in self._rosbags.decompressors.items()}
        size = file.seek(0, io.SEEK_END)
        file.seek(0)
        self._reader = reader(SimpleNamespace(exists=lambda: True, open=lambda _: file, size=size))
        with _ros1_errors():
            self._reader.open()

    @property
    def types(self) -> dict[str, str]:
        """Topic → message type."""
        return {connection.topic: connection.msgtype for connection in self._reader.connections}

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types, in file order."""
        connections = [connection for connection in self._reader.connections if connection.msgtype in kinds]
        entries = sorted(
            (entry.chunk_pos, entry.offset, entry.time, number)
            for number, connection in enumerate(connections)
            for entry in self._reader.indexes[connection.id]
        )
        for chunk, offset, t_ns, number in entries:
            where, previous_chunk = f"{chunk}:{offset}", self._chunk[0]
            raw = self.message(where)
            self._budget.spend(len(raw) + (len(self._chunk[1]) if self._chunk[0] != previous_chunk else 0))
            yield Message(connections[number].topic, connections[number].msgtype, "ros1", t_ns, where, raw)

    def message(self, where: str) -> bytes:
        """Return the bytes of one message."""
        at, offset = map(int, where.split(":"))
        with _ros1_errors():
            if self._chunk[0] != at:
                chunk = self._reader.chunks[at]
                self._unpack(at, self._read(chunk.datapos, chunk.datasize), self._packings[chunk.decompressor])
            content = io.BytesIO(self._chunk[1])
            content.seek(offset)
            header = self._rosbags.Header.read(content)
            if header.get_uint8("op") == self._rosbags.RecordType.CONNECTION:  # some indexes point at it
                content.seek(self._rosbags.read_uint32(content), io.SEEK_CUR)
                header = self._rosbags.Header.read(content)
            if header.get_uint8("op") != self._rosbags.RecordType.MSGDATA:
                raise ValueError("its index points at something that is not a message")
            raw: bytes = self._rosbags.read_bytes(content, self._rosbags.read_uint32(content))
        return raw


@cache
def _ros1_reader() -> tuple[Any, Any]:
    """Return the reader module of rosbags, and its Reader with a limit against indexes that are listed repeatedly."""
    with needed_for("reading a bag"):
        from rosbags.rosbag1 import reader
    base: Any = reader.Reader

    class Reader(base):  # type: ignore[misc]
        index_bytes = 0
        last_index = -1

        def read_index_data(self, pos: int, indexes: Any) -> None:
            start = self.bio.tell()
            if self.index_bytes > self.path.size or start == self.last_index:
                raise ValueError("its index names more than the file has")
            super().read_index_data(pos, indexes)
            self.index_bytes, self.last_index = self.index_bytes + self.bio.tell() - start, start

    return reader, Reader


@contextlib.contextmanager
def _ros1_errors() -> Iterator[None]:
    try:
        yield
    except OSError:
        raise
    except Exception as error:  # rosbags raises a dozen types on damaged bags
        raise ValueError(f"is damaged or cut off: {one_line(error)}") from error


def _unlz4(packed: bytes, limit: int) -> bytes:
    with needed_for("reading a bag packed by lz4"):
        from lz4.frame import LZ4FrameDecompressor
    # The decompressor allocates its output limit: use small steps, so that few bytes do not cost hundreds of megabytes.
    decompressor, parts, remaining, pending = LZ4FrameDecompressor(), [b""], limit, packed
    try:
        while remaining and not decompressor.eof and (len(parts[-1]) or pending):
            parts.append(bytes(decompressor.decompress(pending, min(remaining, _LZ4_STEP_BYTES))))
            remaining, pending = remaining - len(parts[-1]), b""
    except RuntimeError as error:  # the only exception of lz4
        raise ValueError(str(error)) from error
    return b"".join(parts)


def _unzstd(packed: bytes, limit: int) -> bytes:
    with needed_for("reading a bag packed by zstd"):
        import zstandard
    try:
        with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as stream:
            return bytes(stream.read(limit))
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error


_DECOMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda packed, _: packed, "bz2": lambda packed, limit: bz2.BZ2Decompressor().decompress(packed, limit),
    "lz4": _unlz4, "zstd": _unzstd,
}  # fmt: skip
"""Name of the compression → function (chunk, limit in bytes) that decompresses it."""


class SqliteBag:
    """One SQLite file of a ROS 2 bag, given by path or content."""

    def __init__(self, content: Path | bytes, budget: _UnpackBudget) -> None:
        self.types: dict[str, str] = {}
        self._budget = budget
        self._log = content.with_name(f"{content.name}-wal") if isinstance(content, Path) else None
        self._rows_left = (len(content) if isinstance(content, bytes) else content.stat().st_size) // _MIN_ROW_BYTES
        where = ":memory:" if isinstance(content, bytes) else f"{content.absolute().as_uri()}?mode=ro&immutable=1"
        # The garbage collector may close the bag in another thread.
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
        with contextlib.suppress(AttributeError):  # it could not be opened
            self.close()

    def close(self) -> None:
        """Close the database."""
        self._base.close()

    def _step(self) -> bool:
        """Count 10,000 steps of SQLite; True aborts the query: tables with shared child pages are endless."""
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
        """Yield the messages of some types, in file order."""
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
        if self._log is not None and self._log.is_file() and self._log.stat().st_size:
            repair = f"sqlite3 {self._log.name.removesuffix('-wal')} 'PRAGMA wal_checkpoint(TRUNCATE)'"
            raise ValueError(f"was not closed: what lies in {self._log.name} is not read; write it back: {repair}")

    def message(self, where: str) -> bytes:
        """Return the bytes of one message."""
        with _sqlite_errors():
            row = self._base.execute("SELECT data FROM messages WHERE id = ?", (int(where),)).fetchone()
        if row is None or not isinstance(row[0], bytes):
            raise ValueError(f"is damaged: message {where} is no bytes")
        return _unpacked_zstd(row[0]) if row[0][:4] == _ZSTD_MAGIC else row[0]  # rosbag2 may compress each message


def _unpacked_zstd(packed: bytes) -> bytes:
    """Decompress a file or a message of unknown decompressed length."""
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
    """A ROS 2 bag folder: its SQLite or MCAP files in order; its metadata.yaml is not needed."""

    def __init__(self, root: Path, folder: Path) -> None:
        self._root = root
        self._files = _bag_files(folder)
        if not self._files:
            raise ValueError("is damaged: it holds no .db3 and no .mcap file")
        self._open: tuple[int, BagFile] | None = None
        self.types: dict[str, str] = {}

    def close(self) -> None:
        """Close the open file."""
        if self._open is not None:
            self._open[1].close()
        self._open = None

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types, file by file; raise the problems of damaged files after the last one."""
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
