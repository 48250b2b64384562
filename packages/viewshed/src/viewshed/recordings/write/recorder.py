"""Recorder: write the moments of a run to a bag, as ROS messages or with Foxglove's schemas."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from viewshed.recordings.write.bag_writers import Schema, check_bag_name, open_bag_writer
from viewshed.recordings.write.moment import Moment
from viewshed.recordings.write.ros_topics import RosTable

Record = Callable[[Moment], None]
"""Function that records one moment."""

SCHEMAS = ("ros", "foxglove")
"""Message schemas of a bag."""


@contextmanager
def open_recorder(path: Path, schemas: str = "ros") -> Iterator[Record]:
    """Open a bag and yield a function that writes a moment to it.

    Args:
        path: path of the bag, see :func:`open_bag_writer`.
        schemas: ``ros``, or ``foxglove`` for an MCAP file with the schemas of Foxglove.

    Raises:
        ValueError: the name is not that of a bag, or does not match the schemas.
        ImportError: a required package is not installed.
        OSError: the bag cannot be written.
    """
    if schemas not in SCHEMAS:
        raise ValueError(f"schemas must be one of {', '.join(SCHEMAS)}, got {schemas!r}")
    check_bag_name(path)
    if schemas == "foxglove":
        if path.suffix.lower() != ".mcap":
            raise ValueError(f"Foxglove's schemas go into NAME.mcap, got {path}")
        from viewshed.recordings.write.foxglove_topics import foxglove_messages, foxglove_types

        foxglove_types()  # fail early if the package is not installed

        def messages(moment: Moment) -> Iterator[tuple[str, Schema, bytes, bool]]:
            return ((*message, False) for message in foxglove_messages(moment))

    else:
        messages = RosTable(ros1=path.suffix.lower() == ".bag").of
    with open_bag_writer(path, profile="ros2" if schemas == "ros" else "") as bag:

        def record(moment: Moment) -> None:
            for topic, schema, raw, latched in messages(moment):
                bag.write(topic, schema, moment.t_ns, raw, latched=latched)

        yield record
