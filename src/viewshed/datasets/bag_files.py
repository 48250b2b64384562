"""One bag as a stream of messages: ROS 1 files and ROS 2 folders through rosbags, single MCAP files by ourselves."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

from viewshed.datasets.mcap import McapFile, Message

SUFFIXES = (".bag", ".mcap", ".db3")
TF = "tf2_msgs/msg/TFMessage"
_METADATA = "metadata.yaml"


class BagFile(Protocol):
    """One bag."""

    @property
    def types(self) -> dict[str, str]:
        """Topic → type of its messages; of an MCAP file those that were met so far."""
        ...

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types; a ValueError where the bag is damaged."""
        ...

    def message(self, where: str) -> bytes:
        """Return the bytes of one message; a ValueError where it is not there."""
        ...

    def close(self) -> None:
        """Close the bag."""
        ...


def bags_in(place: Path) -> list[Path]:
    """Return the bags at a place, by names alone: itself, or those in the folder, in alphabetical order."""
    if place.is_file():
        return [place] if place.suffix in SUFFIXES else []
    if _is_ros2(place):
        return [place]
    return sorted(path for path in place.iterdir() if path.suffix in SUFFIXES or (path.is_dir() and _is_ros2(path)))


def _is_ros2(folder: Path) -> bool:
    return (folder / _METADATA).is_file()


def open_bag(path: Path) -> BagFile:
    """Return an opened bag.

    Raises:
        ValueError: it is damaged or of no kind that is read.
        ImportError: the extra ``bags`` is not installed.
        OSError: it cannot be read.
    """
    decoder("cdr")
    if path.is_dir() and not _is_ros2(path):
        raise ValueError(f"has no {_METADATA}; write it with: ros2 bag reindex")
    if path.suffix == ".db3" and path.is_file():
        raise ValueError(f"is one file of a ROS 2 bag; name its folder, which must hold {_METADATA}")
    return McapFile(path) if path.suffix == ".mcap" and path.is_file() else RosbagFile(path)


@lru_cache(maxsize=2)
def decoder(encoding: str) -> Callable[[bytes, str], Any]:
    """Return what turns the bytes of a message and the name of its type into an object.

    Raises:
        ImportError: the extra ``bags`` is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise ImportError("bags need rosbags: pip install 'viewshed[bags]'") from error
    if encoding == "ros1":
        store = get_typestore(Stores.ROS1_NOETIC)
        if TF not in store.types:
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
        return store.deserialize_ros1
    return get_typestore(Stores.ROS2_FOXY).deserialize_cdr


class RosbagFile:
    """A ROS 1 bag or the folder of a ROS 2 bag.

    Args:
        path: where it lies.

    Raises:
        ValueError: it is damaged.
    """

    def __init__(self, path: Path) -> None:
        from rosbags import rosbag1, rosbag2

        self._encoding = "cdr" if path.is_dir() else "ros1"
        self._reader: Any = None
        try:
            self._reader = rosbag2.Reader(path) if path.is_dir() else rosbag1.Reader(path)
            self._reader.open()
        except Exception as error:  # rosbags raises a dozen types on damaged bags
            self.close()
            raise ValueError(_problem(error)) from error

    def __del__(self) -> None:
        self.close()

    def close(self) -> None:
        """Close the bag."""
        with contextlib.suppress(Exception):  # rosbags asserts that it was open
            self._reader.close()

    @property
    def types(self) -> dict[str, str]:
        """Topic → type of its messages."""
        return {connection.topic: connection.msgtype for connection in self._reader.connections}

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types, in the order of recording.

        Raises:
            ValueError: the bag is damaged there; the messages before have been yielded.
        """
        topics = sorted({connection.topic for connection in self._reader.connections})
        last: dict[str, tuple[int, int]] = {}
        wanted = [connection for connection in self._reader.connections if connection.msgtype in kinds]
        for connection, t_ns, raw in self._read(wanted):
            topic = connection.topic
            before = last.get(topic, (t_ns, -1))
            last[topic] = (t_ns, before[1] + 1 if before[0] == t_ns else 0)
            where = f"{topics.index(topic)}:{t_ns}:{last[topic][1]}"
            yield Message(topic, connection.msgtype, self._encoding, t_ns, where, bytes(raw))

    def message(self, where: str) -> bytes:
        """Return the bytes of one message.

        Raises:
            ValueError: it is not there any more, or damaged.
        """
        number, t_ns, nth = map(int, where.split(":"))
        topic = sorted({connection.topic for connection in self._reader.connections})[number]
        same = [connection for connection in self._reader.connections if connection.topic == topic]
        for at, (_, _, raw) in enumerate(self._read(same, t_ns)):
            if at == nth:
                return bytes(raw)
        raise ValueError(f"{topic} has no message at {t_ns} ns any more")

    def _read(self, connections: list[Any], t_ns: int | None = None) -> Iterator[tuple[Any, int, bytes]]:
        if not connections:
            return
        stop = None if t_ns is None else t_ns + 1
        try:
            yield from self._reader.messages(connections=connections, start=t_ns, stop=stop)
        except Exception as error:  # as when opening
            raise ValueError(_problem(error)) from error


def _problem(error: Exception) -> str:
    words = " ".join(str(error).split())
    return f"is damaged or of a kind that is not read: {words or type(error).__name__}"
