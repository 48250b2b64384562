"""Recordings made in CARLA: each agent a folder with PLY or NPY sweeps and a table of poses, see docs/recording.md.

The tables of a CARLA recording: poses of an agent, actors of a tick. Everything in them is as CARLA says it.

CARLA's left-handed frames (x forward, y right, z up; degrees) as our right-handed ones.

Mirroring y, S = diag(1, -1, 1), turns one into the other: a pose (R, t) of CARLA becomes (S R S, S t).
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.recordings.source import ObjectBox, SweepRef
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

MIRROR = np.array([1.0, -1.0, 1.0])
"""What turns a vector of CARLA into one of ours, and back."""


def rotation_of_carla(roll_deg: float, pitch_deg: float, yaw_deg: float) -> NDArray[np.float64]:
    """Return the (3, 3) rotation that CARLA's ``Transform.get_matrix`` has, still in CARLA's left-handed axes.

    Source: ``carla/geom/Transform.h``. Yaw turns x towards y (right), pitch lifts x, roll lowers the right side (y).

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
    """Return a sweep read from points in CARLA's axes, in the sensor's frame: y and azimuth change their sign."""
    azimuth = None if sweep.azimuth is None else -sweep.azimuth
    return sweep.replace(points=sweep.points * MIRROR.astype(np.float32), azimuth=azimuth)


def box_of_carla(world_from_box: Rigid, extent_m: Sequence[float], category: str, track: str | None) -> ObjectBox:
    """Return the box with CARLA's extent: half of its length, width and height, meters."""
    length, width, height = (2.0 * float(half) for half in extent_m)
    return ObjectBox(world_from_box, (length, width, height), category, track)


def lidar_of_carla(
    channels: int,
    upper_fov_deg: float,
    lower_fov_deg: float,
    range_m: float,
    points_per_second: float,
    rotation_hz: float,
) -> LidarModel:
    """Return the beams of ``sensor.lidar.ray_cast`` with these attributes: channels evenly spaced, the lowest first.

    Source: ``RayCastSemanticLidar.cpp``, CreateLasers and SimulateLidar.

    Raises:
        ValueError: an attribute is out of range.

    >>> lidar_of_carla(64, 2.0, -25.0, 120.0, 1_300_000, 20.0).azimuth_columns
    1016
    """
    if channels < 1 or rotation_hz <= 0:
        raise ValueError(f"channels and rotation_frequency must be positive, got {channels} and {rotation_hz}")
    columns = round(points_per_second / (channels * rotation_hz))
    elevation = np.deg2rad(np.linspace(lower_fov_deg, upper_fov_deg, channels))
    source = f"CARLA sensor.lidar.ray_cast, {channels} channels, {lower_fov_deg:g} to {upper_fov_deg:g} degrees"
    return LidarModel(f"CARLA {channels}", elevation, columns, min_range_m=0.3, max_range_m=range_m, source=source)


MAX_TABLE_BYTES = 1_000_000_000

POSE_COLUMNS = ("frame", "t_ns", "x", "y", "z", "roll", "pitch", "yaw")
"""``frame`` is the number in the file's name; meters and degrees, left-handed, as ``carla.Transform`` gives them."""

_ACTOR_NUMBERS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True, slots=True)
class AgentPose:
    """Where a sensor was when it measured a frame.

    Attributes:
        t_ns: time in nanoseconds.
        numbers: x, y, z in meters, roll, pitch, yaw in degrees, in CARLA's left-handed world.
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


LAYOUT = "folders AGENT/000123.ply (or .npy) with AGENT/poses.csv (or .jsonl)"

AXES = ("carla", "carla_0.9.9", "sensor")
"""Axes of the points in the files: carla is x forward, y right, z up (what CARLA 0.9.10 and newer give);
carla_0.9.9 is x right, y backward, z down (0.9.9 and older); sensor is x forward, y left, z up (our own)."""

_SWEEPS = (".ply", ".npy", ".ply.gz", ".npy.gz")

_POSES = ("poses.csv", "poses.jsonl")


@dataclass(frozen=True, slots=True, eq=False)
class _Agent:
    """One folder of sweeps: frame → file, frame → pose, and what ``recording.json`` says about the sensor."""

    files: Mapping[int, Path]
    poses: Mapping[int, AgentPose]
    model: LidarModel | None
    sensor_height_m: float | None


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    axes: str
    agents: Mapping[str, _Agent]
    actors: Actors | None


@dataclass(frozen=True, slots=True, eq=False)
class CarlaRecording:
    """A recording, or a folder of recordings, from :meth:`open`; each is a scene.

    >>> CarlaRecording({}, ()).scenes()
    ()
    """

    _scenes: Mapping[str, _Scene]
    _damage: tuple[str, ...] = field(default=())

    @classmethod
    def open(cls, place: Path) -> CarlaRecording:
        """Return the recording in a folder.

        Raises:
            ValueError: there is none.
            OSError: the folder cannot be read.
        """
        folders = recordings_in(place)
        if not folders:
            raise ValueError(f"{place}: must hold {LAYOUT}, found none")
        damage: list[str] = []
        return cls({folder.name: _open_scene(folder, damage) for folder in folders}, tuple(damage))

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the recordings, in alphabetical order."""
        return tuple(self._scenes)

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the sweeps of a recording by time, then agent; those without a pose come last.

        Raises:
            ValueError: there is no such recording.
        """
        found = sorted(
            (float("inf") if pose is None else pose.t_ns, agent, frame, str(file))
            for agent, folder in self._scene(scene).agents.items()
            for frame, file in folder.files.items()
            for pose in (folder.poses.get(frame),)
        )
        return [
            SweepRef(scene, index, file, None if t_ns == float("inf") else int(t_ns), agent, key=str(frame))
            for index, (t_ns, agent, frame, file) in enumerate(found)
        ]

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep in the sensor's frame, with pose and time where the table of poses has its frame.

        Raises:
            ValueError: the file is damaged.
            OSError: it cannot be read.
        """
        from viewshed.io import read_sweep

        scene = self._scene(ref.scene)
        agent = scene.agents[ref.agent]
        sweep = read_sweep(ref.file, file_frame="carla" if scene.axes == "carla_0.9.9" else None)
        sweep = mirrored(sweep) if scene.axes == "carla" else sweep
        pose = agent.poses.get(int(ref.key))
        fits = agent.model is not None and (sweep.ring is None or sweep.ring.max(initial=0) < agent.model.rings)
        return sweep.replace(
            agent=ref.agent, t_ns=ref.t_ns, model=agent.model if fits else None,
            world_from_sensor=None if pose is None else pose.world_from_sensor,
            sensor_height_m=agent.sensor_height_m,
        )  # fmt: skip

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the actors of the sweep's tick, without the one that carries the sensor; None where none are told.

        Raises:
            ValueError: ``actors.jsonl`` is damaged there.
            OSError: it cannot be read.
        """
        actors = self._scene(ref.scene).actors
        return None if actors is None else actors.boxes(int(ref.key), ref.agent)

    def damage(self) -> tuple[str, ...]:
        """Return what is wrong with the tables: missing poses, rows that cannot be used."""
        return self._damage

    def _scene(self, name: str) -> _Scene:
        if name not in self._scenes:
            raise ValueError(f"scene must be one of {', '.join(self._scenes)}, got {name!r}")
        return self._scenes[name]


def is_recording(place: Path) -> bool:
    """Return whether a folder holds a recording or several, by names alone."""
    return bool(recordings_in(place))


def recordings_in(place: Path) -> list[Path]:
    """Return the folders at ``place`` that are recordings: itself, or those in it."""
    if not place.is_dir():
        return []
    if _is_recording(place):
        return [place]
    return sorted(folder for folder in place.iterdir() if folder.is_dir() and _is_recording(folder))


def _is_recording(folder: Path) -> bool:
    """Return whether the folder has agents, by names alone; without any poses ``recording.json`` makes it one."""
    if (folder / "recording.json").is_file():
        return True
    return any((agent / name).is_file() for agent in folder.iterdir() if agent.is_dir() for name in _POSES)


def _open_scene(folder: Path, damage: list[str]) -> _Scene:
    about = _about(folder / "recording.json", damage)
    told = about.get("agents")
    told = told if isinstance(told, dict) else {}
    agents = {
        path.name: _open_agent(path, told.get(path.name), damage)
        for path in sorted(folder.iterdir())
        if path.is_dir() and any(file.name.lower().endswith(_SWEEPS) for file in path.iterdir())
    }
    if not agents:
        damage.append(f"{folder}: no agent has a sweep ({', '.join(_SWEEPS)})")
    return _Scene(_axes(about, folder, damage), agents, read_actors(folder / "actors.jsonl", damage))


def _about(path: Path, damage: list[str]) -> Mapping[str, Any]:
    if not path.is_file():
        return {}
    try:
        about = json.loads(path.read_bytes())
        if not isinstance(about, dict):
            raise ValueError("must be an object")
    except (ValueError, OSError, RecursionError) as error:
        damage.append(f"{path}: is damaged and left out: {error}")
        return {}
    return about


def _axes(about: Mapping[str, Any], folder: Path, damage: list[str]) -> str:
    axes = about.get("axes", "carla")
    if axes not in AXES:
        damage.append(f"{folder / 'recording.json'}: axes must be one of {', '.join(AXES)}, got {axes!r}; took carla")
        return "carla"
    return str(axes)


def _open_agent(folder: Path, told: Any, damage: list[str]) -> _Agent:
    files: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.lower().endswith(_SWEEPS):
            _take_file(files, path, damage)
    poses = read_poses(folder, damage)
    missing = [frame for frame in files if frame not in poses]
    if poses and missing:
        damage.append(f"{folder}: {len(missing)} of {len(files)} sweeps have no pose, the first is {missing[0]:06d}")
    model, height_m = _sensor(told, folder, damage)
    return _Agent(files, poses, model, height_m)


def _take_file(files: dict[int, Path], path: Path, damage: list[str]) -> None:
    stem = path.name.split(".")[0]
    if not (stem.isascii() and stem.isdigit()):
        damage.append(f"{path}: a sweep must be named after its frame, like 000123{path.suffix}; left out")
    elif int(stem) in files:
        damage.append(f"{path}: frame {int(stem)} is there twice; left out")
    else:
        files[int(stem)] = path


def _sensor(told: Any, folder: Path, damage: list[str]) -> tuple[LidarModel | None, float | None]:
    if not isinstance(told, dict):
        return None, None
    try:
        beams, height = told.get("lidar"), told.get("sensor_height_m")
        return None if beams is None else lidar_of_carla(**beams), None if height is None else float(height)
    except (TypeError, ValueError) as error:
        damage.append(f"{folder}: recording.json describes its sensor wrongly: {error}")
        return None, None
