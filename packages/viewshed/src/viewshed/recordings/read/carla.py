"""Read CARLA recordings: each agent is a folder with PLY or NPY sweeps and a table of poses.

- ``recording.json`` (optional): ``axes`` is ``carla`` (the default), ``carla_0.9.9`` (0.9.9 and older: x right,
  y backward, z down) or ``sensor`` (x forward, y left, z up); ``agents`` has for each folder ``sensor_height_m`` and
  ``lidar`` with ``channels``, ``upper_fov_deg``, ``lower_fov_deg``, ``range_m``, ``points_per_second`` and
  ``rotation_hz``.
- ``actors.jsonl`` (optional), a line a tick: ``frame``, ``t_ns`` and ``actors``, each with ``id``, ``type``, the center
  ``x``, ``y``, ``z`` of its box, ``roll``, ``pitch``, ``yaw``, ``extent`` (half sizes) and, where it carries a sensor,
  ``agent``. An agent's own vehicle is not among its boxes.
- ``AGENT/poses.csv`` (or ``poses.jsonl`` with the same keys): ``frame,t_ns,x,y,z,roll,pitch,yaw``: number in the
  file name, nanoseconds, meters and degrees of the sensor's ``carla.Transform``.
- ``AGENT/000123.ply``: output of ``measurement.save_to_disk``, or an NPY array (N, 3) or (N, 4) of the same. A sweep
  without a row in the table is read without pose and time.

Poses and actors are stored as in CARLA, in left-handed frames (x forward, y right, z up; degrees). Mirroring y,
S = diag(1, -1, 1), converts them to our right-handed frames: a pose (R, t) becomes (S R S, S t).
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io import read_sweep
from viewshed.io._input import inside, one_line, open_input
from viewshed.recordings.read.source import ObjectBox, RecordingSource, SweepRef, note_damage, numbers_in, read_optional
from viewshed.sensors import MAX_RINGS, LidarModel
from viewshed.sweep import Sweep

MIRROR = np.array([1.0, -1.0, 1.0])
"""Factors that convert a vector from CARLA's axes to ours, and back."""


def rotation_of_carla(roll_deg: float, pitch_deg: float, yaw_deg: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of CARLA's ``Transform.get_matrix``, in CARLA's left-handed axes.

    Source: ``carla/geom/Transform.h``. Yaw rotates x toward y (right), pitch lifts x, roll lowers the right side (y).

    >>> rotation_of_carla(0.0, 0.0, 90.0).round(6).tolist()[1]
    [1.0, 0.0, 0.0]
    """
    (cr, cp, cy), (sr, sp, sy) = (f(np.deg2rad([roll_deg, pitch_deg, yaw_deg])) for f in (np.cos, np.sin))
    return np.array(
        [
            [cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr],
            [cp * sy, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr],
            [sp, -cp * sr, cp * cr],
        ]
    )


def rigid_of_carla(location_m: Sequence[float], roll_deg: float, pitch_deg: float, yaw_deg: float) -> Rigid:
    """Return the right-handed pose of a CARLA transform: (x, y, z) in meters, angles in degrees.

    >>> rigid_of_carla((10.0, 2.0, 1.0), 0.0, 0.0, 90.0).translation.tolist()
    [10.0, -2.0, 1.0]
    """
    rotation = rotation_of_carla(roll_deg, pitch_deg, yaw_deg)
    return Rigid(MIRROR[:, None] * rotation * MIRROR, MIRROR * np.asarray(location_m, np.float64))


def mirrored(sweep: Sweep) -> Sweep:
    """Convert a sweep from CARLA's axes to the sensor's frame: negate y and azimuth."""
    azimuth = None if sweep.azimuth is None else -sweep.azimuth
    return sweep.replace(points=sweep.points * MIRROR.astype(np.float32), azimuth=azimuth)


def box_of_carla(world_from_box: Rigid, extent_m: Sequence[float], category: str, track: str | None) -> ObjectBox:
    """Return a box of CARLA's extent (half of length, width and height, meters)."""
    length, width, height = (2.0 * half for half in extent_m)
    return ObjectBox(world_from_box, (length, width, height), category, track)


def lidar_of_carla(
    channels: float,
    upper_fov_deg: float,
    lower_fov_deg: float,
    range_m: float,
    points_per_second: float,
    rotation_hz: float,
) -> LidarModel:
    """Return the beam table of ``sensor.lidar.ray_cast`` with these attributes: evenly spaced, the lowest first.

    Source: ``RayCastSemanticLidar.cpp``, CreateLasers and SimulateLidar.

    Raises:
        ValueError: an attribute is out of range.

    >>> lidar_of_carla(64, 2.0, -25.0, 120.0, 1_300_000, 20.0).azimuth_columns
    1016
    """
    if not (1 <= channels <= MAX_RINGS and channels == int(channels)):
        raise ValueError(f"channels must be a whole number in [1, {MAX_RINGS}], got {channels}")
    if not 1e-3 <= rotation_hz <= 1e6:
        raise ValueError(f"rotation_frequency must lie in [0.001, 1000000], got {rotation_hz}")
    columns = round(points_per_second / (channels * rotation_hz))
    elevation = np.deg2rad(np.linspace(lower_fov_deg, upper_fov_deg, int(channels)))
    source = f"CARLA sensor.lidar.ray_cast, {channels:g} channels, {lower_fov_deg:g} to {upper_fov_deg:g} degrees"
    return LidarModel(f"CARLA {channels:g}", elevation, columns, min_range_m=0.3, max_range_m=range_m, source=source)


def lidar_described(beams: Any, names: Sequence[str]) -> LidarModel:
    """Build the beam table from a dict or list; ``names`` are the keys of the arguments of :func:`lidar_of_carla`."""
    values = [beams.get(name) for name in names] if isinstance(beams, dict) else beams
    return lidar_of_carla(*numbers_in(values, len(names), ", ".join(names)))


_MAX_ROWS = 200_000  # 5 hours at 10 Hz
_MAX_POSES_BYTES = 100_000_000
_MAX_LINE_BYTES = 4_000_000

POSE_COLUMNS = ("frame", "t_ns", "x", "y", "z", "roll", "pitch", "yaw")
"""``frame`` is the number in the file name; meters and degrees, left-handed, as in ``carla.Transform``."""

_POSE_NUMBERS = POSE_COLUMNS[2:]


@dataclass(frozen=True, slots=True)
class AgentPose:
    """Pose of a sensor at the time of a frame."""

    t_ns: int  # time in nanoseconds
    numbers: tuple[float, ...]  # x, y, z in meters, roll, pitch, yaw in degrees, in CARLA's left-handed world

    @property
    def world_from_sensor(self) -> Rigid:
        """Pose in our right-handed frames."""
        return rigid_of_carla(self.numbers[:3], *self.numbers[3:])


@dataclass(frozen=True, slots=True)
class Actors:
    """Index of the actors of each tick in a file."""

    path: Path  # JSON file, one line a tick
    positions: Mapping[int, tuple[int, int]]  # frame → (first byte, number of bytes)

    def boxes(self, frame: int, agent: str) -> tuple[ObjectBox, ...] | None:
        """Return the boxes of a tick in the world, without the vehicle of ``agent``; None if the tick is missing."""
        if frame not in self.positions:
            return None
        start, length = self.positions[frame]
        with self.path.open("rb") as file:
            file.seek(start)
            line = file.read(length)
        try:
            rows = _json_object(line).get("actors")
            if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
                raise ValueError("actors must be a list of objects")
            return tuple(_box(row) for row in rows if row.get("agent") != agent)
        except ValueError as error:
            raise ValueError(one_line(f"{self.path}: frame {frame} has a damaged actor: {error}")) from error


def _box(row: Mapping[str, Any]) -> ObjectBox:
    what = f"{', '.join(_POSE_NUMBERS)} of an actor"
    x, y, z, *angles = numbers_in([row.get(name) for name in _POSE_NUMBERS], len(_POSE_NUMBERS), what)
    extent = numbers_in(row.get("extent"), 3, "extent of an actor")
    category, number = row.get("type"), row.get("id")
    if not isinstance(category, str) or not isinstance(number, int):
        raise ValueError("an actor must have text as type and a whole number as id")
    return box_of_carla(rigid_of_carla((x, y, z), *angles), extent, category, str(number))


def _json_object(line: bytes | str) -> Mapping[str, Any]:
    """Parse a line as a JSON object; raise ValueError if it is something else."""
    try:
        row = json.loads(line)
    except RecursionError as error:
        raise ValueError("is too deep") from error
    if not isinstance(row, dict):
        raise ValueError(f"must be an object, got {type(row).__name__}")
    return row


def read_actors(root: Path, path: Path, damage: list[str]) -> Actors | None:
    """Index the actors in a file; None if there is no file. Damaged lines are reported in ``damage``."""
    if not path.is_file():
        return None
    positions: dict[int, tuple[int, int]] = {}
    start = 0
    with inside(root, path).open("rb") as file:
        for number in range(1, _MAX_ROWS + 1):
            line = file.readline(_MAX_LINE_BYTES + 1)
            if not line:
                return Actors(path, positions)
            if len(line) > _MAX_LINE_BYTES:
                problem = f"line {number} must be at most {_MAX_LINE_BYTES} bytes"
                break
            try:
                if line.strip():
                    positions[_integer(_json_object(line).get("frame"), "frame")] = (start, len(line))
            except ValueError as error:
                note_damage(damage, f"{path}: line {number} must be an object with a frame: {error}")
            start += len(line)
        else:
            problem = f"must have at most {_MAX_ROWS} lines"
    note_damage(damage, f"{path}: {problem}; the rest is left out")
    return Actors(path, positions)


def read_poses(root: Path, folder: Path, damage: list[str]) -> dict[int, AgentPose]:
    """Read the poses of an agent by frame; invalid rows are skipped and reported in ``damage``."""
    path = next((folder / name for name in _POSES if (folder / name).is_file()), None)
    if path is None:
        note_damage(damage, f"{folder}: has no poses.csv or poses.jsonl; its sweeps have no pose and no time")
        return {}
    poses: dict[int, AgentPose] = {}
    try:
        with open_input(inside(root, path)) as source:
            text = source.content(_MAX_POSES_BYTES).decode("utf-8-sig", "replace")
        is_table = path.suffix == ".csv"
        rows: Iterable[Any] = csv.DictReader(io.StringIO(text)) if is_table else io.StringIO(text)
        for number, row in enumerate(rows, 1 + is_table):
            if isinstance(row, str) and not row.strip():
                continue
            if number > _MAX_ROWS:
                raise ValueError(f"{path}: must have at most {_MAX_ROWS} lines; the rest is left out")
            try:
                frame, pose = _pose_in(row if isinstance(row, dict) else _json_object(row))
                if frame in poses:
                    raise ValueError(f"frame {frame} appears twice; the first is kept")
                poses[frame] = pose
            except ValueError as error:
                note_damage(damage, f"{path}: line {number}: {error}")
    except csv.Error as error:
        note_damage(damage, f"{path}: {error}")
    except (OSError, ValueError) as error:
        note_damage(damage, str(error))
    times = [poses[frame].t_ns for frame in sorted(poses)]
    if any(late <= early for early, late in pairwise(times)):
        note_damage(damage, f"{path}: t_ns does not ascend with frame; the sweeps are taken in the order of t_ns")
    return poses


def _pose_in(row: Mapping[str, Any]) -> tuple[int, AgentPose]:
    frame, t_ns = _integer(row.get("frame"), "frame"), _integer(row.get("t_ns"), "t_ns")
    what = f"a pose ({', '.join(_POSE_NUMBERS)})"
    numbers = numbers_in([row.get(name) for name in _POSE_NUMBERS], len(_POSE_NUMBERS), what)
    return frame, AgentPose(t_ns, numbers)


def _integer(value: object, what: str) -> int:
    """Convert a value of JSON or CSV to an integer that fits int64."""
    text = str(value).strip() if isinstance(value, str) or type(value) is int else ""
    if re.fullmatch(r"-?[0-9]{1,18}|-?[1-8][0-9]{18}", text) is None:
        raise ValueError(f"{what} must be a whole number, got {one_line(value, 40)}")
    return int(text)


AXES = ("carla", "carla_0.9.9", "sensor")
"""Axes of the points in the files: carla is x forward, y right, z up (CARLA 0.9.10 and newer);
carla_0.9.9 is x right, y backward, z down (0.9.9 and older); sensor is x forward, y left, z up (ours)."""

BEAMS = ("channels", "upper_fov_deg", "lower_fov_deg", "range_m", "points_per_second", "rotation_hz")
"""Keys of ``lidar`` in ``recording.json``: arguments of :func:`lidar_of_carla`, in this order."""

_SWEEPS = (".ply", ".npy", ".ply.gz", ".npy.gz")
_POSES = ("poses.jsonl", "poses.csv")


@dataclass(frozen=True, slots=True, eq=False)
class _Agent:
    """One folder of sweeps: frame → file, frame → pose, and the sensor as described in ``recording.json``."""

    files: Mapping[int, Path]
    poses: Mapping[int, AgentPose]
    model: LidarModel | None
    sensor_height_m: float | None


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    axes: str
    agents: Mapping[str, _Agent]
    actors: Actors | None


class CarlaRecording(RecordingSource):
    """A CARLA recording, or a folder of recordings; each is a scene."""

    def __init__(self, place: Path) -> None:
        self.place = place
        self.problems: list[str] = []
        self._scenes = {folder.name: _open_scene(place, folder, self.problems) for folder in recordings_in(place)}
        self.sweeps = {name: _refs_of(name, scene) for name, scene in self._scenes.items()}

    def _read(self, ref: SweepRef) -> Sweep:
        """Read a sweep in the sensor's frame, with pose and time if the table of poses has its frame."""
        scene = self._scenes[ref.scene]
        agent = scene.agents[ref.agent]
        file_frame = "carla" if scene.axes == "carla_0.9.9" else None
        sweep = read_sweep(inside(self.place, ref.file), file_frame=file_frame)
        sweep = mirrored(sweep) if scene.axes == "carla" else sweep
        pose = agent.poses.get(int(ref.key))
        fits = agent.model is not None and (sweep.ring is None or sweep.ring.max(initial=0) < agent.model.rings)
        return sweep.replace(
            agent=ref.agent, t_ns=ref.t_ns, model=agent.model if fits else None,
            world_from_sensor=None if pose is None else pose.world_from_sensor,
            sensor_height_m=agent.sensor_height_m,
        )  # fmt: skip

    def _boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the actors of the sweep's tick, without the sensor's vehicle; None if there is no data."""
        actors = self._scenes[ref.scene].actors
        return None if actors is None else actors.boxes(int(ref.key), ref.agent)


def _refs_of(name: str, scene: _Scene) -> list[SweepRef]:
    """Return the sweeps of a recording, sorted by time, then agent; sweeps without a pose are last."""
    ordered = sorted(
        (float("inf") if pose is None else pose.t_ns, agent, frame, str(file))
        for agent, folder in scene.agents.items()
        for frame, file in folder.files.items()
        for pose in (folder.poses.get(frame),)
    )
    return [
        SweepRef(name, index, file, None if t_ns == float("inf") else int(t_ns), agent, key=str(frame))
        for index, (t_ns, agent, frame, file) in enumerate(ordered)
    ]


def recordings_in(place: Path) -> list[Path]:
    """Return the recordings at ``place``: itself, or folders in it."""
    if not place.is_dir():
        return []
    if _is_recording(place):
        return [place]
    return sorted(folder for folder in place.iterdir() if folder.is_dir() and _is_recording(folder))


def _is_recording(folder: Path) -> bool:
    """Return whether a folder has ``recording.json`` or an agent with poses, by file names alone."""
    if (folder / "recording.json").is_file():
        return True
    return any((agent / name).is_file() for agent in folder.iterdir() if agent.is_dir() for name in _POSES)


def _open_scene(root: Path, folder: Path, damage: list[str]) -> _Scene:
    def read_description(path: Path) -> Mapping[str, Any]:
        with open_input(inside(root, path)) as source:
            return _json_object(source.content(_MAX_LINE_BYTES))

    description = read_optional(folder / "recording.json", read_description, damage) or {}
    axes = description.get("axes", "carla")
    if axes not in AXES:
        problem = f"axes must be one of {', '.join(AXES)}, got {one_line(axes, 40)}; carla is used"
        note_damage(damage, f"{folder / 'recording.json'}: {problem}")
        axes = "carla"
    sensors = description.get("agents")
    sensors = sensors if isinstance(sensors, dict) else {}
    agents = {
        path.name: _open_agent(root, path, sensors.get(path.name), damage)
        for path in sorted(folder.iterdir())
        if path.is_dir() and any(file.name.lower().endswith(_SWEEPS) for file in path.iterdir())
    }
    if not agents:
        note_damage(damage, f"{folder}: no agent has a sweep ({', '.join(_SWEEPS)})")
    return _Scene(str(axes), agents, read_actors(root, folder / "actors.jsonl", damage))


def _open_agent(root: Path, folder: Path, sensor: Any, damage: list[str]) -> _Agent:
    files: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        stem = path.name.split(".")[0]
        if not path.name.lower().endswith(_SWEEPS):
            continue
        if not (stem.isascii() and stem.isdigit() and len(stem) <= 18):
            note_damage(damage, f"{path}: a sweep must be named after its frame, like 000123{path.suffix}; left out")
        elif int(stem) in files:
            note_damage(damage, f"{path}: frame {int(stem)} is there twice; left out")
        else:
            files[int(stem)] = path
    poses = read_poses(root, folder, damage)
    missing = [frame for frame in files if frame not in poses]
    if poses and missing:
        problem = f"{len(missing)} of {len(files)} sweeps have no pose, the first is {missing[0]:06d}"
        note_damage(damage, f"{folder}: {problem}")
    model, height_m = _sensor(sensor, folder, damage)
    return _Agent(files, poses, model, height_m)


def _sensor(sensor: Any, folder: Path, damage: list[str]) -> tuple[LidarModel | None, float | None]:
    """Return beam table and height of a sensor described in ``recording.json``."""
    if not isinstance(sensor, dict):
        return None, None
    try:
        beams, height = sensor.get("lidar"), sensor.get("sensor_height_m")
        model = None if beams is None else lidar_described(beams, BEAMS)
        return model, None if height is None else numbers_in([height], 1, "sensor_height_m")[0]
    except ValueError as error:
        note_damage(damage, f"{folder}: recording.json describes its sensor wrongly: {error}")
        return None, None
