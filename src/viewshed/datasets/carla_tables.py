"""The tables of a CARLA recording: poses of an agent, actors of a tick. Everything in them is as CARLA says it."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from viewshed.datasets.carla_frames import box_of_carla, rigid_of_carla
from viewshed.datasets.source import ObjectBox
from viewshed.geometry import Rigid

MAX_TABLE_BYTES = 1_000_000_000
POSE_COLUMNS = ("frame", "t_ns", "x", "y", "z", "roll", "pitch", "yaw")
"""``frame`` is the number in the file's name; metres and degrees, left-handed, as ``carla.Transform`` gives them."""
_ACTOR_NUMBERS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True, slots=True)
class AgentPose:
    """Where a sensor was when it measured a frame.

    Attributes:
        t_ns: time in nanoseconds.
        numbers: x, y, z in metres, roll, pitch, yaw in degrees, in CARLA's left-handed world.
    """

    t_ns: int
    numbers: tuple[float, ...]

    @property
    def world_from_sensor(self) -> Rigid:
        """The pose in our right-handed frames."""
        return rigid_of_carla(self.numbers[:3], *self.numbers[3:])


@dataclass(frozen=True, slots=True)
class Actors:
    """Where the actors of each tick stand in a file.

    Attributes:
        path: the file, JSON, one line a tick.
        places: frame → (first byte, number of bytes).
    """

    path: Path
    places: Mapping[int, tuple[int, int]]

    def boxes(self, frame: int, agent: str) -> tuple[ObjectBox, ...] | None:
        """Return the boxes of a tick in the world, without that of the actor that carries ``agent``; None without it.

        Raises:
            ValueError: a box is not as it must be; one line that names the file.
            OSError: the file cannot be read.
        """
        if frame not in self.places:
            return None
        start, length = self.places[frame]
        with self.path.open("rb") as file:
            file.seek(start)
            line = file.read(length)
        try:
            rows = json.loads(line)["actors"]
            return tuple(_box(row) for row in rows if row.get("agent") != agent)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{self.path}: frame {frame} has a damaged actor: {error!r}") from error


def _box(row: Mapping[str, Any]) -> ObjectBox:
    x, y, z, *angles = (float(row[name]) for name in _ACTOR_NUMBERS)
    return box_of_carla(rigid_of_carla((x, y, z), *angles), row["extent"], str(row["type"]), str(row["id"]))


def read_actors(path: Path, damage: list[str]) -> Actors | None:
    """Return the actors in a file, or None where there is no such file; lines that are damaged are added to a list."""
    if not path.is_file():
        return None
    places: dict[int, tuple[int, int]] = {}
    start = 0
    for number, line in enumerate(_content(path).splitlines(keepends=True), 1):
        try:
            if line.strip():
                places[int(json.loads(line)["frame"])] = (start, len(line))
        except (ValueError, KeyError, TypeError) as error:
            damage.append(f"{path}: line {number} must be an object with a frame: {_line(error)}")
        start += len(line)
    return Actors(path, places)


def read_poses(folder: Path, damage: list[str]) -> dict[int, AgentPose]:
    """Return the poses of an agent by frame; what is wrong with them is added to a list, the other rows are kept."""
    path = next((folder / name for name in ("poses.jsonl", "poses.csv") if (folder / name).is_file()), None)
    if path is None:
        damage.append(f"{folder}: has no poses.csv or poses.jsonl; its sweeps have no pose and no time")
        return {}
    poses: dict[int, AgentPose] = {}
    try:
        for number, row in _rows(path, _content(path).decode("utf-8", "replace")):
            try:
                _take(poses, row)
            except (ValueError, KeyError, TypeError, OverflowError) as error:
                damage.append(f"{path}: line {number}: {_line(error)}")
    except (OSError, csv.Error) as error:
        damage.append(f"{path}: {_line(error)}")
    times = [poses[frame].t_ns for frame in sorted(poses)]
    if any(late <= early for early, late in pairwise(times)):
        damage.append(f"{path}: t_ns does not ascend with frame; the sweeps are taken in the order of t_ns")
    return poses


def _take(poses: dict[int, AgentPose], row: Mapping[str, Any]) -> None:
    frame, numbers = int(row["frame"]), tuple(float(row[name]) for name in POSE_COLUMNS[2:])
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"a pose must be finite numbers, got {numbers}")
    if frame in poses:
        raise ValueError(f"frame {frame} appears twice; the first is kept")
    poses[frame] = AgentPose(int(row["t_ns"]), numbers)


def _rows(path: Path, text: str) -> Iterator[tuple[int, Mapping[str, Any]]]:
    if path.suffix == ".csv":
        yield from enumerate(csv.DictReader(io.StringIO(text)), 2)
        return
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip():
            yield number, _object(line)


def _object(line: str) -> Mapping[str, Any]:
    """Return the object on a line of JSON, an empty one where it is damaged, which every key will miss."""
    try:
        row = json.loads(line)
    except ValueError:
        return {}
    return row if isinstance(row, dict) else {}


def _content(path: Path) -> bytes:
    size = path.stat().st_size
    if size > MAX_TABLE_BYTES:
        raise OSError(f"{path}: must be at most {MAX_TABLE_BYTES} bytes, got {size}")
    return path.read_bytes()


def _line(error: Exception) -> str:
    missing = f"{error} is missing" if isinstance(error, KeyError) else str(error)
    return " ".join(missing.split())
