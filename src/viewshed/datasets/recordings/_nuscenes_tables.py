"""The tables of nuScenes (v1.0) as far as its LiDAR needs them, each read in one pass.

The schema is that of https://www.nuscenes.org/nuscenes#data-format.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass
from pathlib import Path
from sys import intern
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.recordings.source import note_damage
from viewshed.geometry import Rigid
from viewshed.io._input import inside, open_input
from viewshed.io._json import json_rows

CHANNEL = "LIDAR_TOP"
"""The sensor whose sweeps are read."""

_MICROSECONDS_MAX = 2**63 // 1000

_KINDS = {str: "text", int: "a whole number", bool: "true or false", list: "a list"}

_NO_POSE = array("d", [np.nan] * 7)

_POSE: dict[str, type] = {"token": str, "rotation": list, "translation": list}


class SweepRow(NamedTuple):
    """One row of ``sample_data``: its token, those of its sample, calibration and ego pose; its time and file."""

    token: str
    sample: str
    calibration: str
    pose: str
    t_us: int
    keyframe: bool
    file: str


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """A table of poses.

    Attributes:
        place: its file.
        rows: token → row of ``values``.
        values: (N, 7) float64: quaternion (w, x, y, z), translation in meters; not finite where the row is damaged.
    """

    place: Path
    rows: dict[str, int]
    values: NDArray[np.float64]

    def pose(self, token: str) -> Rigid:
        """Return the pose with this token.

        Raises:
            ValueError: there is none, or it is not a quaternion of norm 1 and three finite numbers.
        """
        row = self.rows.get(token)
        if row is None:
            raise ValueError(f"{self.place} has no row {token!r}")
        try:
            return Rigid.from_quaternion(self.values[row, :4], self.values[row, 4:])
        except ValueError as error:
            raise ValueError(f"{self.place}, row {token!r}: {error}") from error


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """What the tables of one version say about the LiDAR.

    Attributes:
        folder: where they lie.
        scenes: name of the scene → its sweeps in time order.
        calibrations: ego from LiDAR.
        poses: global from ego.
        damage: one line for each row that had to be left out.
    """

    folder: Path
    scenes: dict[str, list[SweepRow]]
    calibrations: Poses
    poses: Poses
    damage: tuple[str, ...]

    @classmethod
    def read(cls, folder: Path) -> Tables:
        """Return the tables in a folder.

        Raises:
            OSError: one is missing or cannot be read.
            ValueError: one is no list of JSON objects.
        """
        damage: list[str] = []
        channels = dict(table_rows(folder / "sensor.json", {"token": str, "channel": str}, damage))
        sensors = dict(table_rows(folder / "calibrated_sensor.json", {"token": str, "sensor_token": str}, damage))
        lidar = {token: channels.get(sensor) == CHANNEL for token, sensor in sensors.items() if sensor in channels}
        candidates = {token for token in sensors if lidar.get(token, True)}
        calibrations = read_poses(folder / "calibrated_sensor.json", candidates, damage)
        names = dict(table_rows(folder / "scene.json", {"token": str, "name": str}, damage))
        samples = _scenes_of_samples(folder / "sample.json", names, damage)
        scenes: dict[str, list[SweepRow]] = {name: [] for name in names.values()}
        for row in _sweep_rows(folder / "sample_data.json", lidar, damage):
            if row.sample in samples:
                scenes[samples[row.sample]].append(row)
            else:
                _leave_out(
                    damage, folder / "sample_data.json", f"{row.file} names no sample of a scene, {row.sample!r}"
                )
        for rows in scenes.values():
            rows.sort(key=lambda row: row.t_us)
        needed = {row.pose for rows in scenes.values() for row in rows}
        poses = read_poses(folder / "ego_pose.json", needed, damage)
        return cls(folder, scenes, calibrations, poses, tuple(damage))


def _scenes_of_samples(place: Path, names: dict[str, str], damage: list[str]) -> dict[str, str]:
    """Return token of the sample → name of its scene."""
    samples = {}
    for token, scene in table_rows(place, {"token": str, "scene_token": str}, damage):
        if scene in names:
            samples[token] = names[scene]
        else:
            _leave_out(damage, place, f"row {token!r} names no row of scene.json, {scene!r}")
    return samples


def _sweep_rows(place: Path, lidar: dict[str, bool], damage: list[str]) -> Iterator[SweepRow]:
    """Yield the rows of the LiDAR: calibrations tell, and names of files where a calibration is not known."""
    kinds = {
        "token": str, "sample_token": str, "calibrated_sensor_token": str, "ego_pose_token": str,
        "timestamp": int, "is_key_frame": bool, "filename": str,
    }  # fmt: skip

    def of_lidar(row: dict[str, Any]) -> bool:
        known = lidar.get(str(row.get("calibrated_sensor_token")))
        return CHANNEL in str(row.get("filename")) if known is None else known

    for token, sample, calibration, pose, t_us, keyframe, file in table_rows(place, kinds, damage, of_lidar):
        if abs(t_us) < _MICROSECONDS_MAX:
            pose_token = token if pose == token else pose
            yield SweepRow(token, intern(sample), intern(calibration), pose_token, t_us, keyframe, file)
        else:
            _leave_out(damage, place, f"row {token!r} must have microseconds as 'timestamp', got {str(t_us)[:30]}")


def read_poses(place: Path, needed: Container[str], damage: list[str]) -> Poses:
    """Return the poses whose tokens are needed; what is wrong with their rows is added to ``damage``.

    Raises:
        OSError: the table cannot be read.
        ValueError: it is no list of JSON objects.
    """
    rows: dict[str, int] = {}
    values = array("d")
    for token, rotation, translation in table_rows(place, _POSE, damage, lambda row: str(row.get("token")) in needed):
        rows[token] = len(values) // 7
        values.extend(_seven(rotation, translation))
    return Poses(place, rows, np.array(values).reshape(-1, 7))


def _seven(rotation: list[Any], translation: list[Any]) -> array[float]:
    try:
        numbers = array("d", [*rotation, *translation])
    except (TypeError, OverflowError):
        return _NO_POSE
    return numbers if len(rotation) == 4 and len(numbers) == 7 else _NO_POSE


def table_rows(
    place: Path,
    kinds: dict[str, type],
    damage: list[str],
    wanted: Callable[[dict[str, Any]], bool] = lambda row: True,
) -> Iterator[tuple[Any, ...]]:
    """Yield the columns that ``kinds`` names of the rows that are wanted; rows without them go to ``damage``.

    Raises:
        OSError: the table cannot be read.
        ValueError: it is no list of JSON objects.
    """
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
    """Yield the rows of a table, which must lie in its recording: the folder above that of the tables.

    Raises:
        OSError: the table cannot be read.
        ValueError: it is no list of JSON objects, or a link leads out of the recording.
    """
    with open_input(inside(place.parents[1], place)) as source:
        yield from json_rows(source)


def _leave_out(damage: list[str], place: Path, problem: str) -> None:
    note_damage(damage, f"{place}: {problem}; the row is left out")
