"""Recorder: takes the moments of a run and writes them to a bag, as ROS messages or with Foxglove's schemas."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from viewshed.recordings.write.bag_writers import BagWriter, Schema, check_bag_name, open_bag_writer
from viewshed.recordings.write.moment import Moment
from viewshed.recordings.write.ros_topics import RosTable

Record = Callable[[Moment], None]
"""Takes one moment."""

SCHEMAS = ("ros", "foxglove")
"""In which messages a bag is written."""


@contextmanager
def open_recorder(path: Path, schemas: str = "ros") -> Iterator[Record]:
    """Open a bag and yield what writes a moment to it.

    Args:
        path: of the bag, see :func:`open_bag_writer`.
        schemas: ``ros``, or ``foxglove`` for an MCAP file with the schemas of Foxglove.

    Raises:
        ValueError: the name is that of no bag, or schemas and name do not go together.
        ImportError: a package is not installed.
        OSError: the bag cannot be written.
    """
    if schemas not in SCHEMAS:
        raise ValueError(f"schemas must be one of {', '.join(SCHEMAS)}, got {schemas!r}")
    check_bag_name(path)
    if schemas == "foxglove":
        if path.suffix.lower() != ".mcap":
            raise ValueError(f"Foxglove's schemas go into NAME.mcap, got {path}")
        from viewshed.recordings.write.foxglove_topics import foxglove_messages, foxglove_types

        foxglove_types()  # what is not installed is reported before anything is read
        with open_bag_writer(path, profile="") as bag:

            def record(moment: Moment) -> None:
                for topic, schema, raw in foxglove_messages(moment):
                    bag.write(topic, schema, moment.t_ns, raw)

            yield record
        return
    is_ros1 = path.suffix.lower() == ".bag"
    table = RosTable(ros1=is_ros1)
    with open_bag_writer(path) as bag:
        yield _RosRecord(bag, table, "ros1" if is_ros1 else "cdr")


class _RosRecord:
    """Writes moments as ROS messages."""

    def __init__(self, bag: BagWriter, table: RosTable, encoding: str) -> None:
        self._bag, self._table, self._encoding = bag, table, encoding
        self._schemas: dict[str, Schema] = {}

    def __call__(self, moment: Moment) -> None:
        for topic, message, latched in self._table.of(moment):
            kind, messages = message.__msgtype__, self._table.messages
            if kind not in self._schemas:
                definition = b"" if self._encoding == "ros1" else messages.definition(kind).encode()
                self._schemas[kind] = Schema(kind, "ros2msg", self._encoding, definition)
            self._bag.write(topic, self._schemas[kind], moment.t_ns, messages.encode(message), latched=latched)
