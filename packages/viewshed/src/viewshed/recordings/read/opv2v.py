"""Read OPV2V and data sets of its layout: SCENARIO/AGENT/000068.pcd with 000068.yaml, in CARLA's axes.

The layout is that of OpenCDA's ``data_dumper.py``, which recorded OPV2V.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewshed.geometry import Rigid
from viewshed.io import read_sweep
from viewshed.io._input import inside
from viewshed.recordings.read._yaml import load_pyyaml, read_yaml
from viewshed.recordings.read.carla import box_of_carla, lidar_described, mirrored, rigid_of_carla
from viewshed.recordings.read.source import ObjectBox, RecordingSource, SweepRef, note_damage, numbers_in, read_optional
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

STEP_S = 0.05
"""Seconds a frame number if ``data_protocol.yaml`` does not state it; OpenCDA's default."""

_PROTOCOL = "data_protocol.yaml"
_HEIGHTS_M = (0.5, 5.0)
_MAX_FRAME_DIGITS = 9
_LIDAR = ("channels", "upper_fov", "lower_fov", "range", "points_per_second", "rotation_frequency")


@dataclass(frozen=True, slots=True, eq=False)
class _Scenario:
    """One scenario: agent → frame → PCD file, seconds a frame number, and beam tables."""

    agents: Mapping[str, Mapping[int, Path]]
    step_s: float
    vehicle_lidar: LidarModel | None
    roadside_lidar: LidarModel | None


class Opv2v(RecordingSource):
    """OPV2V scenarios; each is a scene, and each of its folders an agent."""

    def __init__(self, place: Path) -> None:
        load_pyyaml()
        self.place = place
        self.problems: list[str] = []
        self._scenarios = {name: _open_scenario(place, folder, self.problems) for name, folder in scenarios_in(place)}
        self.sweeps = {name: _refs_of(name, scenario) for name, scenario in self._scenarios.items()}

    def _read(self, ref: SweepRef) -> Sweep:
        """Read a sweep in the sensor's frame, with its pose if its YAML file exists."""
        scenario = self._scenarios[ref.scene]
        metadata = _read_metadata(self.place, ref)
        pose = None if metadata is None else _pose(metadata, ref)
        model = scenario.roadside_lidar if _is_roadside(ref.agent) else scenario.vehicle_lidar
        return mirrored(read_sweep(inside(self.place, ref.file))).replace(
            agent=ref.agent, t_ns=ref.t_ns, world_from_sensor=pose, model=model,
            sensor_height_m=None if metadata is None or pose is None else _height_m(metadata, pose, ref),
        )  # fmt: skip

    def _boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the vehicles in the agent's YAML file, in the world; None if there is no file."""
        metadata = _read_metadata(self.place, ref)
        if metadata is None:
            return None
        vehicles = metadata.get("vehicles") or {}
        if not isinstance(vehicles, dict):
            raise ValueError(f"{_yaml_of(ref.file)}: vehicles must be a mapping, got {type(vehicles).__name__}")
        try:
            return tuple(_box(str(name), row) for name, row in vehicles.items())
        except ValueError as error:
            raise ValueError(f"{_yaml_of(ref.file)}: a vehicle is damaged: {error}") from error


def _refs_of(name: str, scenario: _Scenario) -> list[SweepRef]:
    """Return the sweeps of a scenario, sorted by time, then agent."""
    ordered = sorted(
        (frame, position, agent, str(file))
        for position, (agent, files) in enumerate(scenario.agents.items())
        for frame, file in files.items()
    )
    return [
        SweepRef(name, index, file, round(frame * scenario.step_s * 1e9), agent)
        for index, (frame, _, agent, file) in enumerate(ordered)
    ]


def scenarios_in(place: Path) -> Iterator[tuple[str, Path]]:
    """Yield (name, folder) of the scenarios at a place, sorted; the name is prefixed by the split, if any."""
    if _is_scenario(place):
        yield place.resolve().name, place
        return
    for folder in _folders(place):
        if _is_scenario(folder):
            yield folder.name, folder
        else:
            yield from ((f"{folder.name}/{inner.name}", inner) for inner in _folders(folder) if _is_scenario(inner))


def _is_scenario(folder: Path) -> bool:
    return any(path.with_suffix(".yaml").is_file() for agent in _folders(folder) for path in _numbered(agent, ".pcd"))


def _folders(place: Path) -> list[Path]:
    return sorted(path for path in place.iterdir() if path.is_dir()) if place.is_dir() else []


def _numbered(folder: Path, suffix: str) -> Iterator[Path]:
    return (
        path for path in folder.iterdir()
        if path.suffix == suffix and path.stem.isascii() and path.stem.isdigit() and len(path.stem) <= _MAX_FRAME_DIGITS
    )  # fmt: skip


def _is_roadside(agent: str) -> bool:
    """Return whether an agent is a roadside unit: these have negative numbers in data sets of this layout."""
    return agent.startswith("-")


def _open_scenario(root: Path, folder: Path, damage: list[str]) -> _Scenario:
    agents: dict[str, dict[int, Path]] = {}
    for path in sorted(_folders(folder), key=lambda path: (len(path.name), path.name)):
        files = {int(file.stem): file for file in sorted(_numbered(path, ".pcd"))}
        frames = {int(file.stem) for file in _numbered(path, ".yaml")}
        _note_frames(damage, path, files.keys() - frames, "without YAML, read without pose")
        _note_frames(damage, path, frames - files.keys(), "without points (.pcd), left out")
        if files:
            agents[path.name] = files
    protocol = read_optional(folder / _PROTOCOL, lambda path: read_yaml(inside(root, path)), damage)
    vehicle, roadside = (_lidar(protocol, part, folder, damage) for part in ("vehicle_base", "rsu_base"))
    step_s = _nested_value(protocol, ("world", "fixed_delta_seconds"))
    usable = isinstance(step_s, float) and 0 < step_s < 10
    return _Scenario(agents, step_s if usable else STEP_S, vehicle, roadside)


def _note_frames(damage: list[str], folder: Path, frames: Iterable[int], problem: str) -> None:
    numbers = sorted(frames)
    if numbers:
        note_damage(damage, f"{folder}: {len(numbers)} frame(s) {problem}, the first is {numbers[0]:06d}")


def _nested_value(tree: Any, keys: Iterable[str]) -> Any:
    for key in keys:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return tree


def _lidar(protocol: Any, part: str, folder: Path, damage: list[str]) -> LidarModel | None:
    metadata = _nested_value(protocol, (part, "sensing", "perception", "lidar"))
    if metadata is None:
        return None
    try:
        return lidar_described(metadata, _LIDAR)
    except ValueError as error:
        note_damage(damage, f"{folder / _PROTOCOL}: does not describe the lidar of {part}: {error}")
        return None


def _read_metadata(root: Path, ref: SweepRef) -> Mapping[str, Any] | None:
    """Read the YAML file of a sweep; None if there is no file."""
    path = _yaml_of(ref.file)
    if not path.is_file():
        return None
    metadata = read_yaml(inside(root, path))
    if not isinstance(metadata, dict):
        raise ValueError(f"{path}: must be a mapping, got {type(metadata).__name__}")
    return metadata


def _yaml_of(file: str) -> Path:
    return Path(file).with_suffix(".yaml")


def _pose(metadata: Mapping[str, Any], ref: SweepRef) -> Rigid:
    what = f"{_yaml_of(ref.file)}: lidar_pose (x, y, z, roll, yaw, pitch)"
    x, y, z, roll, yaw, pitch = numbers_in(metadata.get("lidar_pose"), 6, what)
    return rigid_of_carla((x, y, z), roll, pitch, yaw)


def _height_m(metadata: Mapping[str, Any], pose: Rigid, ref: SweepRef) -> float | None:
    """Return the height of the sensor above its vehicle's origin, in CARLA on the road; None for roadside units."""
    vehicle = metadata.get("true_ego_pos")
    if _is_roadside(ref.agent) or not isinstance(vehicle, list) or len(vehicle) < 3:
        return None
    _, _, z = numbers_in(vehicle[:3], 3, f"{_yaml_of(ref.file)}: true_ego_pos (x, y, z)")
    height = float(pose.translation[2]) - z
    return height if _HEIGHTS_M[0] < height < _HEIGHTS_M[1] else None


def _box(name: str, row: Any) -> ObjectBox:
    if not isinstance(row, dict):
        raise ValueError(f"vehicle {name} must be a mapping, got {type(row).__name__}")
    location, extent = (numbers_in(row.get(key), 3, f"{key} of vehicle {name}") for key in ("location", "extent"))
    roll, yaw, pitch = numbers_in(row.get("angle"), 3, f"angle of vehicle {name}")
    center = numbers_in(row.get("center", (0.0, 0.0, 0.0)), 3, f"center of vehicle {name}")
    world_from_box = rigid_of_carla(location, roll, pitch, yaw) @ rigid_of_carla(center, 0.0, 0.0, 0.0)
    category = row.get("obj_type", "vehicle")
    return box_of_carla(world_from_box, extent, category if isinstance(category, str) else "vehicle", name)
