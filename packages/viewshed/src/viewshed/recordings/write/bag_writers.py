"""Write bags: MCAP files, ROS 1 files, and ROS 2 folders with SQLite. Equal messages give equal bytes."""

from __future__ import annotations

import errno
import json
import os
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewshed._extras import needed_for
from viewshed._files import draft_folder, require_parent


@dataclass(frozen=True, slots=True)
class Schema:
    """Message type of a topic."""

    name: str  # name of the type
    encoding: str  # format of ``definition``: ``ros2msg`` or ``protobuf``
    message_encoding: str  # serialization of messages: ``cdr``, ``ros1`` or ``protobuf``
    definition: bytes  # definition of the type


_LATCHED_QOS = """\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 2147483647
    nsec: 4294967295
  lifespan:
    sec: 2147483647
    nsec: 4294967295
  liveliness: 1
  liveliness_lease_duration:
    sec: 2147483647
    nsec: 4294967295
  avoid_ros_namespace_conventions: false
"""
"""Reliable and transient local with depth 1, so that late subscribers receive the last message."""


def _qos(latched: bool) -> str:
    return _LATCHED_QOS if latched else ""


class McapWriter:
    """Writes an MCAP file with lz4 compression."""

    def __init__(self, path: Path, profile: str) -> None:
        with needed_for("writing MCAP"):
            import lz4.frame  # noqa: F401 (checked here for our error message)
            from mcap.writer import CompressionType, Writer
        self._stream = path.open("wb")
        self._writer = Writer(self._stream, compression=CompressionType.LZ4)
        self._writer.start(profile, "viewshed")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._counts: Counter[str] = Counter()

    def write(self, topic: str, schema: Schema, t_ns: int, raw: bytes, *, latched: bool = False) -> None:
        """Add a message."""
        if topic not in self._channels:
            if schema.name not in self._schemas:
                self._schemas[schema.name] = self._writer.register_schema(
                    schema.name, schema.encoding, schema.definition
                )
            metadata = {"offered_qos_profiles": _qos(latched)} if schema.encoding == "ros2msg" else {}
            number = self._schemas[schema.name]
            self._channels[topic] = self._writer.register_channel(topic, schema.message_encoding, number, metadata)
        self._writer.add_message(self._channels[topic], t_ns, raw, t_ns, self._counts[topic])
        self._counts[topic] += 1

    def close(self) -> None:
        """Write index and statistics, and close the file."""
        self._writer.finish()
        self._stream.close()


class Ros1Writer:
    """Writes a ROS 1 bag."""

    def __init__(self, path: Path) -> None:
        with needed_for("writing a bag"):
            from rosbags.rosbag1 import Writer
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        self._writer = Writer(path)
        self._writer.open()
        self._connections: dict[str, Any] = {}
        self._store = get_typestore(Stores.ROS1_NOETIC)
        self._store.register(
            get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
        )

    def write(self, topic: str, schema: Schema, t_ns: int, raw: bytes, *, latched: bool = False) -> None:
        """Add a message."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, schema.name, typestore=self._store, callerid="/viewshed", latching=int(latched)
            )
        self._writer.write(self._connections[topic], t_ns, raw)

    def close(self) -> None:
        """Write the index."""
        self._writer.close()


class SqliteWriter:
    """Writes a ROS 2 bag: a folder with ``metadata.yaml`` and one SQLite file, in the version of Humble.

    Later ROS versions read it as well. rosbags' own writer works only in the thread that opened it, but answers are
    published in another thread.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self._folder, self._name = folder, f"{folder.name}_0.db3"
        self._file = sqlite3.connect(folder / self._name, check_same_thread=False)
        self._file.executescript(
            "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);"
            "CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);"
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
            " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
            " data BLOB NOT NULL);"
            "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
            "INSERT INTO schema VALUES (3, 'humble');"
        )
        self._topics: dict[str, tuple[int, str, bool]] = {}
        self._counts: dict[str, int] = {}

    def write(self, topic: str, schema: Schema, t_ns: int, raw: bytes, *, latched: bool = False) -> None:
        """Add a message."""
        if topic not in self._topics:
            number = len(self._topics) + 1
            self._topics[topic], self._counts[topic] = (number, schema.name, latched), 0
            self._file.execute(
                "INSERT INTO topics VALUES (?, ?, ?, ?, ?)", (number, topic, schema.name, "cdr", _qos(latched))
            )
        self._counts[topic] += 1
        number = self._topics[topic][0]
        self._file.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", (number, t_ns, raw))

    def close(self) -> None:
        """Write the metadata."""
        first_ns, last_ns = self._file.execute("SELECT min(timestamp), max(timestamp) FROM messages").fetchone()
        self._file.commit()
        self._file.close()
        start, duration, count = first_ns or 0, (last_ns or 0) - (first_ns or 0), sum(self._counts.values())
        topics = [
            {
                "topic_metadata": {
                    "name": name, "type": kind, "serialization_format": "cdr", "offered_qos_profiles": _qos(latched),
                },
                "message_count": self._counts[name],
            }
            for name, (_, kind, latched) in self._topics.items()
        ]  # fmt: skip
        times = {
            "starting_time": {"nanoseconds_since_epoch": start}, "duration": {"nanoseconds": duration},
            "message_count": count,
        }  # fmt: skip
        metadata = {
            "version": 5, "storage_identifier": "sqlite3", "relative_file_paths": [self._name], **times,
            "topics_with_message_count": topics, "compression_format": "", "compression_mode": "",
            "files": [{"path": self._name, **times}],
        }  # fmt: skip
        # JSON is valid YAML, so no YAML package is needed.
        text = json.dumps({"rosbag2_bagfile_information": metadata}, indent=1) + "\n"
        (self._folder / "metadata.yaml").write_text(text, encoding="utf-8")


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Add the path of the bag and a remedy to write errors."""
    try:
        yield
    except (OSError, sqlite3.Error) as error:
        number = error.errno if isinstance(error, OSError) else None
        reason = str(error) if number is None else os.strerror(number)
        message = f"{reason}; free some space or choose another place"
        raise OSError(errno.EIO if number is None else number, message, str(path)) from error


class BagWriter:
    """Writes one bag; messages must be in time order, and errors name the bag."""

    def __init__(self, bag: McapWriter | Ros1Writer | SqliteWriter, path: Path) -> None:
        self._bag, self._path = bag, path

    def write(self, topic: str, schema: Schema, t_ns: int, raw: bytes, *, latched: bool = False) -> None:
        """Add a message."""
        with _writing(self._path):
            self._bag.write(topic, schema, t_ns, raw, latched=latched)

    def close(self) -> None:
        """Finish and close the bag."""
        with _writing(self._path):
            self._bag.close()


@contextmanager
def open_bag_writer(path: Path, profile: str = "ros2") -> Iterator[BagWriter]:
    """Open a bag for writing; its suffix is the kind: ``.mcap``, ``.bag`` (ROS 1), or none for a folder (ROS 2).

    It is written to a draft next to ``path`` and moved into place at the end, also after Ctrl-C; any other error
    removes it. An existing file is replaced, a folder is not.

    Args:
        path: path of the bag.
        profile: profile of an MCAP file: ``ros2``, or empty if the messages are not ROS messages.

    Raises:
        ValueError: the suffix is unknown, or the folder exists.
        ImportError: a required package is not installed.
        OSError: it cannot be written.
    """
    kind = path.suffix.lower()
    check_bag_name(path)
    with draft_folder(path) as draft:
        inner = draft / path.name
        with _writing(path):
            if kind == ".mcap":
                writer = BagWriter(McapWriter(inner, profile), path)
            else:
                writer = BagWriter(Ros1Writer(inner) if kind else SqliteWriter(inner), path)
        try:
            yield writer
        except Exception:
            with suppress(OSError):  # the draft is discarded
                writer.close()
            raise
        except KeyboardInterrupt:
            writer.close()
            inner.replace(path)
            raise
        writer.close()
        inner.replace(path)


def check_bag_name(path: Path) -> None:
    """Check that the suffix of a bag is known, that it does not replace a folder, and that its parent folder exists.

    Raises:
        ValueError: the suffix is unknown, or the folder exists.
        OSError: the parent folder does not exist.
    """
    if path.suffix.lower() not in {".mcap", ".bag", ""}:
        raise ValueError(f"a bag must be NAME.mcap, NAME.bag (ROS 1) or a folder NAME (ROS 2), got {path}")
    if path.is_dir():
        raise ValueError(f"a bag must not replace a folder, got {path}, which exists; choose another name")
    require_parent(path)
