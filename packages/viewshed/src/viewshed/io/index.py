"""Read an index of sweeps: a JSON list of files in the same folder, with their frames and poses."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewshed.geometry import Rigid
from viewshed.io._input import inside, open_input
from viewshed.io._json import json_rows
from viewshed.sweep import LATEST_S

_MAX_ENTRIES = 50_000


@dataclass(frozen=True, slots=True, eq=False)
class IndexEntry:
    """One file of an index."""

    file: Path  # path in the folder of the index, links resolved
    sensor: str  # name of the sensor, as in the index
    sensor_from_file: Rigid  # transform from the file's frame to the sensor's
    sensor_height_m: float | None = None  # mounting height, or None
    world_from_sensor: Rigid | None = None  # pose of the sensor frame, or None
    seq: str | None = None  # name of the drive, or None
    t: float | None = None  # seconds of the drive's clock, or None
    points: int | None = None  # number of points stated by the index; None for a file that is not a sweep


def read_index(path: str | os.PathLike[str]) -> list[IndexEntry]:
    """Return the entries of an index file, in order.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not an index, or names a file outside its folder.
    """
    folder = Path(path).parent
    entries: list[IndexEntry] = []
    with open_input(path) as source:
        for row in json_rows(source):
            if len(entries) >= _MAX_ENTRIES:
                raise ValueError(f"an index must have at most {_MAX_ENTRIES} entries")
            entries.append(_entry(folder, len(entries), row))
    return entries


def _entry(folder: Path, position: int, entry: Any) -> IndexEntry:
    try:
        frame = entry.get("sensor_from_file")
        pose, stats = entry.get("world_from_sensor"), entry.get("stats")
        return IndexEntry(
            file=inside(folder, folder / entry["file"]).resolve(), sensor=str(entry["sensor"]),
            sensor_from_file=Rigid.identity() if frame is None else Rigid.from_matrix(frame),
            sensor_height_m=_optional(float, entry.get("sensor_height_m")),
            world_from_sensor=None if pose is None else Rigid.from_matrix(pose),
            seq=_optional(str, entry.get("seq")), t=_optional(_seconds, entry.get("t")),
            points=None if stats is None else int(stats["points"]),
        )  # fmt: skip
    except KeyError as error:
        raise ValueError(f"entry {position} has no {error}") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ValueError(f"entry {position}: {error}") from error


def _seconds(value: Any) -> float:
    seconds = float(value)
    if not abs(seconds) < LATEST_S:
        raise ValueError(f"t must be seconds that fit int64 in nanoseconds, got {seconds:g}")
    return seconds


def _optional(kind: Callable[[Any], Any], value: Any) -> Any:
    return None if value is None else kind(value)
