"""Recordings made in CARLA: each agent a folder with PLY or NPY sweeps and a table of poses, see docs/recording.md."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from viewshed.datasets.carla_frames import lidar_of_carla, mirrored
from viewshed.datasets.carla_tables import Actors, AgentPose, read_actors, read_poses
from viewshed.datasets.source import ObjectBox, SweepRef
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

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
