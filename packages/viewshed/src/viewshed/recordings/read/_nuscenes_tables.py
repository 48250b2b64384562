"""The tables of nuScenes (v1.0) as far as its LiDAR needs them, each read in one pass.

The schema is that of https://www.nuscenes.org/nuscenes#data-format.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from sys import intern
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io._input import inside, open_input
from viewshed.io._json import json_rows
from viewshed.recordings.read.source import SweepRef, error_prefix, note_damage

CHANNEL = "LIDAR_TOP"
"""The sensor whose sweeps are read."""

_MICROSECONDS_MAX = 2**63 // 1000
_KINDS = {str: "text", int: "a whole number", bool: "true or false", list: "a list"}

_SAMPLE_DATA: dict[str, type] = {
    "token": str, "sample_token": str, "calibrated_sensor_token": str, "ego_pose_token": str,
    "timestamp": int, "is_key_frame": bool, "filename": str,
}  # fmt: skip
"""The columns of ``sample_data`` that are read."""


class Tokens(NamedTuple):
    """What a sweep's row of ``sample_data`` refers to: rows of ``sample``, ``calibrated_sensor``, ``ego_pose``."""

    sample: str
    calibration: str
    pose: str


@dataclass(frozen=True, slots=True)
class PoseTable:
    """A table of poses."""

    place: Path  # its file
    rows: dict[str, int]  # token → row of ``values``
    # (N, 7) float64: quaternion (w, x, y, z), translation in meters; not finite where the row is damaged
    values: NDArray[np.float64]

    @classmethod
    def read(cls, place: Path, needed: Container[str], damage: list[str]) -> PoseTable:
        """Return the poses whose tokens are needed; what is wrong with their rows is added to ``damage``."""
        rows: dict[str, int] = {}
        values = array("d")
        kinds: dict[str, type] = {"token": str, "rotation": list, "translation": list}
        for token, *pose in _columns(place, kinds, damage, lambda row: str(row.get("token")) in needed):
            rows[token] = len(values) // 7
            values.extend(floats_of(pose, (4, 3)))
        return cls(place, rows, np.array(values).reshape(-1, 7))

    def pose(self, token: str) -> Rigid:
        """Return the pose with this token; a ValueError where it has no row, or a damaged one."""
        row = self.rows.get(token)
        if row is None:
            raise ValueError(f"{self.place} has no row {token!r}")
        with error_prefix(f"{self.place}, row {token!r}"):
            return Rigid.from_quaternion(self.values[row, :4], self.values[row, 4:])


@dataclass(frozen=True, slots=True, eq=False)
class NuscenesTables:
    """What the tables of one version say about the LiDAR."""

    # name of the scene → its sweeps in time order, keyframes among them; their key is the row's token
    scenes: dict[str, list[SweepRef]]
    tokens: dict[str, Tokens]  # the sweep's token → what its row refers to
    calibrations: PoseTable  # ego from LiDAR
    poses: PoseTable  # global from ego

    @classmethod
    def read(cls, folder: Path, damage: list[str]) -> NuscenesTables:
        """Return the tables in a folder; a line for each row that must be left out is added to ``damage``."""
        # 1. Which calibrations are the LiDAR's.
        channels = dict(_columns(folder / "sensor.json", {"token": str, "channel": str}, damage))
        sensors = dict(_columns(folder / "calibrated_sensor.json", {"token": str, "sensor_token": str}, damage))
        lidar = {token: channels.get(sensor) == CHANNEL for token, sensor in sensors.items() if sensor in channels}
        candidates = {token for token in sensors if lidar.get(token, True)}
        calibrations = PoseTable.read(folder / "calibrated_sensor.json", candidates, damage)
        # 2. Which samples belong to which scene.
        names = dict(_columns(folder / "scene.json", {"token": str, "name": str}, damage))
        samples = {}
        for token, scene in _columns(folder / "sample.json", {"token": str, "scene_token": str}, damage):
            if scene in names:
                samples[token] = names[scene]
            else:
                problem = f"row {token!r} names no row of scene.json, {scene!r}"
                _leave_out(damage, folder / "sample.json", problem)
        # 3. The sweeps of the LiDAR by scene, and the poses that they need.
        rows: dict[str, list[tuple[int, bool, str, str]]] = {name: [] for name in names.values()}
        tokens: dict[str, Tokens] = {}
        for token, sample, calibration, pose, t_us, keyframe, file in _lidar_rows(folder, lidar, damage):
            if sample in samples:
                rows[samples[sample]].append((t_us, keyframe, token, str(folder.parent / file)))
                tokens[token] = Tokens(intern(sample), intern(calibration), token if pose == token else pose)
            else:
                problem = f"{file} names no sample of a scene, {sample!r}"
                _leave_out(damage, folder / "sample_data.json", problem)
        scenes = {
            scene: [
                SweepRef(scene, index, file, t_us * 1000, sensor=CHANNEL, keyframe=keyframe, key=token)
                for index, (t_us, keyframe, token, file) in enumerate(sorted(sweeps, key=lambda sweep: sweep[0]))
            ]
            for scene, sweeps in rows.items()
        }
        needed = {row.pose for row in tokens.values()}
        return cls(scenes, tokens, calibrations, PoseTable.read(folder / "ego_pose.json", needed, damage))


def _lidar_rows(folder: Path, lidar: Mapping[str, bool], damage: list[str]) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of the LiDAR: calibrations tell, and names of files where a calibration is not known."""
    place = folder / "sample_data.json"

    def of_lidar(row: dict[str, Any]) -> bool:
        known = lidar.get(str(row.get("calibrated_sensor_token")))
        return CHANNEL in str(row.get("filename")) if known is None else known

    for row in _columns(place, _SAMPLE_DATA, damage, of_lidar):
        token, t_us = row[0], row[4]
        if abs(t_us) < _MICROSECONDS_MAX:
            yield row
        else:
            _leave_out(damage, place, f"row {token!r} must have microseconds as 'timestamp', got {str(t_us)[:30]}")


def floats_of(parts: list[Any], lengths: tuple[int, ...]) -> array[float]:
    """Return lists of numbers, of these lengths, one after the other; all NaN where one is something else.

    >>> floats_of([[1, 2], [3.5]], (2, 1)), floats_of([[1, 2], None], (2, 1))
    (array('d', [1.0, 2.0, 3.5]), array('d', [nan, nan, nan]))
    """
    numbers = array("d")
    try:
        for part, length in zip(parts, lengths, strict=True):
            numbers.extend(array("d", part))
            if len(part) != length:
                raise TypeError
    except (TypeError, OverflowError):
        return array("d", [np.nan] * sum(lengths))
    return numbers


def _columns(
    place: Path,
    kinds: Mapping[str, type],
    damage: list[str],
    wanted: Callable[[dict[str, Any]], bool] = lambda row: True,
) -> Iterator[tuple[Any, ...]]:
    """Yield the columns that ``kinds`` names of the rows that are wanted; rows without them go to ``damage``."""
    types = tuple(kinds.values())
    for number, row in enumerate(rows_of_table(place)):
        if not wanted(row):
            continue
        values = tuple(map(row.get, kinds))
        if tuple(map(type, values)) == types:
            yield values
        else:
            key = next(key for key in kinds if type(row.get(key)) is not kinds[key])
            got = str(row.get(key))[:60]
            _leave_out(damage, place, f"row {number} must have {_KINDS[kinds[key]]} as {key!r}, got {got!r}")


def rows_of_table(place: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table, which must lie in its recording: the folder above that of the tables."""
    with open_input(inside(place.parents[1], place)) as source:
        yield from json_rows(source)


def _leave_out(damage: list[str], place: Path, problem: str) -> None:
    note_damage(damage, f"{place}: {problem}; the row is left out")
