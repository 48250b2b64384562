"""Read the tables of nuScenes (v1.0) for its LiDAR, each in one pass.

Schema: https://www.nuscenes.org/nuscenes#data-format.
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
"""Channel of the LiDAR."""

_MAX_MICROSECONDS = 2**63 // 1000
_KINDS = {str: "text", int: "a whole number", bool: "true or false", list: "a list"}

_SAMPLE_DATA: dict[str, type] = {
    "token": str, "sample_token": str, "calibrated_sensor_token": str, "ego_pose_token": str,
    "timestamp": int, "is_key_frame": bool, "filename": str,
}  # fmt: skip
"""Columns of ``sample_data`` that are read, and their types."""


class Tokens(NamedTuple):
    """Foreign keys of a row of ``sample_data``: tokens in ``sample``, ``calibrated_sensor`` and ``ego_pose``."""

    sample: str
    calibration: str
    pose: str


@dataclass(frozen=True, slots=True)
class PoseTable:
    """A table of poses."""

    place: Path  # file of the table
    rows: dict[str, int]  # token → row of ``values``
    # (N, 7) float64: quaternion (w, x, y, z), translation in meters; not finite if the row is damaged
    values: NDArray[np.float64]

    @classmethod
    def read(cls, place: Path, needed: Container[str], damage: list[str]) -> PoseTable:
        """Read the poses whose tokens are in ``needed``; damaged rows are reported in ``damage``."""
        rows: dict[str, int] = {}
        values = array("d")
        kinds: dict[str, type] = {"token": str, "rotation": list, "translation": list}
        for token, *pose in _columns(place, kinds, damage, lambda row: str(row.get("token")) in needed):
            rows[token] = len(values) // 7
            values.extend(floats_of(pose, (4, 3)))
        return cls(place, rows, np.array(values).reshape(-1, 7))

    def pose(self, token: str) -> Rigid:
        """Return the pose with this token; raise ValueError if its row is missing or damaged."""
        row = self.rows.get(token)
        if row is None:
            raise ValueError(f"{self.place} has no row {token!r}")
        with error_prefix(f"{self.place}, row {token!r}"):
            return Rigid.from_quaternion(self.values[row, :4], self.values[row, 4:])


@dataclass(frozen=True, slots=True, eq=False)
class NuscenesTables:
    """The LiDAR's part of the tables of one version."""

    # name of the scene → its sweeps (with keyframes) in time order; their key is the token of the row
    scenes: dict[str, list[SweepRef]]
    tokens: dict[str, Tokens]  # token of the sweep → foreign keys of its row
    calibrations: PoseTable  # ego from LiDAR
    poses: PoseTable  # global from ego

    @classmethod
    def read(cls, folder: Path, damage: list[str]) -> NuscenesTables:
        """Read the tables in a folder; each dropped row is reported in ``damage``."""
        # 1. Find the calibrations of the LiDAR.
        channels = dict(_columns(folder / "sensor.json", {"token": str, "channel": str}, damage))
        sensors = dict(_columns(folder / "calibrated_sensor.json", {"token": str, "sensor_token": str}, damage))
        is_lidar = {token: channels.get(sensor) == CHANNEL for token, sensor in sensors.items() if sensor in channels}
        candidates = {token for token in sensors if is_lidar.get(token, True)}
        calibrations = PoseTable.read(folder / "calibrated_sensor.json", candidates, damage)
        # 2. Find the scene of each sample.
        names = dict(_columns(folder / "scene.json", {"token": str, "name": str}, damage))
        samples = {}
        for token, scene in _columns(folder / "sample.json", {"token": str, "scene_token": str}, damage):
            if scene in names:
                samples[token] = names[scene]
            else:
                problem = f"row {token!r} names no row of scene.json, {scene!r}"
                _report_dropped(damage, folder / "sample.json", problem)
        # 3. Collect the sweeps of the LiDAR by scene, and the poses that they refer to.
        rows: dict[str, list[tuple[int, bool, str, str]]] = {name: [] for name in names.values()}
        tokens: dict[str, Tokens] = {}
        for token, sample, calibration, pose, t_us, keyframe, file in _lidar_rows(folder, is_lidar, damage):
            if sample in samples:
                rows[samples[sample]].append((t_us, keyframe, token, str(folder.parent / file)))
                tokens[token] = Tokens(intern(sample), intern(calibration), token if pose == token else pose)
            else:
                problem = f"{file} names no sample of a scene, {sample!r}"
                _report_dropped(damage, folder / "sample_data.json", problem)
        scenes = {
            scene: [
                SweepRef(scene, index, file, t_us * 1000, sensor=CHANNEL, keyframe=keyframe, key=token)
                for index, (t_us, keyframe, token, file) in enumerate(sorted(sweeps, key=lambda sweep: sweep[0]))
            ]
            for scene, sweeps in rows.items()
        }
        needed = {row.pose for row in tokens.values()}
        return cls(scenes, tokens, calibrations, PoseTable.read(folder / "ego_pose.json", needed, damage))


def _lidar_rows(folder: Path, is_lidar: Mapping[str, bool], damage: list[str]) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of the LiDAR, by calibration, or by file name if the calibration is unknown."""
    place = folder / "sample_data.json"

    def of_lidar(row: dict[str, Any]) -> bool:
        known = is_lidar.get(str(row.get("calibrated_sensor_token")))
        return CHANNEL in str(row.get("filename")) if known is None else known

    for row in _columns(place, _SAMPLE_DATA, damage, of_lidar):
        token, t_us = row[0], row[4]
        if abs(t_us) < _MAX_MICROSECONDS:
            yield row
        else:
            _report_dropped(damage, place, f"row {token!r} must have microseconds as 'timestamp', got {str(t_us)[:30]}")


def floats_of(parts: list[Any], lengths: tuple[int, ...]) -> array[float]:
    """Concatenate lists of numbers with given lengths; all NaN if one is something else.

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
    keep: Callable[[dict[str, Any]], bool] = lambda row: True,
) -> Iterator[tuple[Any, ...]]:
    """Yield the columns in ``kinds`` (name → type) of the rows to keep; report rows of other types in ``damage``."""
    types = tuple(kinds.values())
    for number, row in enumerate(rows_of_table(place)):
        if not keep(row):
            continue
        values = tuple(map(row.get, kinds))
        if tuple(map(type, values)) == types:
            yield values
        else:
            key = next(key for key in kinds if type(row.get(key)) is not kinds[key])
            got = str(row.get(key))[:60]
            _report_dropped(damage, place, f"row {number} must have {_KINDS[kinds[key]]} as {key!r}, got {got!r}")


def rows_of_table(place: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table; links must not lead out of the recording, the parent of the folder of tables."""
    with open_input(inside(place.parents[1], place)) as source:
        yield from json_rows(source)


def _report_dropped(damage: list[str], place: Path, problem: str) -> None:
    note_damage(damage, f"{place}: {problem}; the row is left out")
