"""OPV2V and data sets of its layout: SCENARIO/AGENT/000068.pcd with 000068.yaml, points and poses as CARLA gives them.

The layout is that of OpenCDA's ``data_dumper.py``, which recorded OPV2V.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from viewshed.datasets.recordings.carla import box_of_carla, lidar_of_carla, mirrored, rigid_of_carla
from viewshed.datasets.recordings.source import ObjectBox, SweepRef
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

LAYOUT = "folders SCENARIO/AGENT/000068.pcd with 000068.yaml"

STEP_S = 0.05
"""Seconds from one frame number to the next, where ``data_protocol.yaml`` does not tell; OpenCDA's default."""

_PROTOCOL = "data_protocol.yaml"

_HEIGHTS_M = (0.5, 5.0)

_MAX_YAML_BYTES = 64_000_000


@dataclass(frozen=True, slots=True, eq=False)
class _Scenario:
    """One scenario: agent → frame → file of points, the step of its frame numbers, and its sensors."""

    agents: Mapping[str, Mapping[int, Path]]
    step_s: float
    vehicle_lidar: LidarModel | None
    roadside_lidar: LidarModel | None


@dataclass(frozen=True, slots=True, eq=False)
class Opv2v:
    """Scenarios with their agents, from :meth:`open`; a scene is a scenario, agents have the names of their folders.

    >>> Opv2v({}, ()).scenes()
    ()
    """

    _scenarios: Mapping[str, _Scenario]
    _damage: tuple[str, ...] = field(default=())

    @classmethod
    def open(cls, place: Path) -> Opv2v:
        """Return the scenarios in a folder: itself one, a folder of them, or the data set with its splits.

        Raises:
            ValueError: there is none.
            ImportError: the extra ``opv2v`` is not installed.
            OSError: the folder cannot be read.
        """
        _loader()
        damage: list[str] = []
        scenarios = {name: _open_scenario(folder, damage) for name, folder in _scenarios_in(place)}
        if not scenarios:
            raise ValueError(f"{place}: must hold {LAYOUT}, found none")
        return cls(scenarios, tuple(damage))

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the scenarios, in alphabetical order; with the split before them where there is one."""
        return tuple(self._scenarios)

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the sweeps of a scenario by time, then agent.

        Raises:
            ValueError: there is no such scenario.
        """
        scenario = self._scenario(scene)
        found = sorted(
            (frame, at, agent, str(file))
            for at, (agent, files) in enumerate(scenario.agents.items())
            for frame, file in files.items()
        )
        return [
            SweepRef(scene, index, file, round(frame * scenario.step_s * 1e9), agent)
            for index, (frame, _, agent, file) in enumerate(found)
        ]

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep in the sensor's frame, with its pose; without one where its YAML file is not there.

        Raises:
            ValueError: the points or the pose are damaged.
            OSError: a file cannot be read.
        """
        from viewshed.io import read_sweep

        scenario, about = self._scenario(ref.scene), _about(ref)
        pose = None if about is None else _pose(about, ref)
        model = scenario.roadside_lidar if _is_roadside(ref.agent) else scenario.vehicle_lidar
        return mirrored(read_sweep(ref.file)).replace(
            agent=ref.agent, t_ns=ref.t_ns, world_from_sensor=pose, model=model,
            sensor_height_m=None if about is None or pose is None else _height_m(about, pose, ref),
        )  # fmt: skip

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the vehicles that the agent's own YAML file names, in the world; None where there is no such file.

        Raises:
            ValueError: a vehicle is not as it must be.
            OSError: the file cannot be read.
        """
        about = _about(ref)
        if about is None:
            return None
        try:
            return tuple(_box(str(name), row) for name, row in (about.get("vehicles") or {}).items())
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ValueError(f"{_yaml_of(ref.file)}: a vehicle is damaged: {error!r}") from error

    def damage(self) -> tuple[str, ...]:
        """Return what was wrong with the files' names: points without YAML, YAML without points."""
        return self._damage

    def _scenario(self, name: str) -> _Scenario:
        if name not in self._scenarios:
            raise ValueError(f"scene must be one of {', '.join(self._scenarios)}, got {name!r}")
        return self._scenarios[name]


def is_opv2v(place: Path) -> bool:
    """Return whether a folder has this layout, by names alone."""
    return any(True for _ in _scenarios_in(place))


def _scenarios_in(place: Path) -> Iterator[tuple[str, Path]]:
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
    return (path for path in folder.iterdir() if path.suffix == suffix and path.stem.isascii() and path.stem.isdigit())


def _is_roadside(agent: str) -> bool:
    """Return whether the agent stands at the roadside: data sets of this layout give those negative numbers."""
    return agent.startswith("-")


def _open_scenario(folder: Path, damage: list[str]) -> _Scenario:
    agents: dict[str, dict[int, Path]] = {}
    for path in sorted(_folders(folder), key=lambda path: (len(path.name), path.name)):
        files = {int(file.stem): file for file in sorted(_numbered(path, ".pcd"))}
        frames = {int(file.stem) for file in _numbered(path, ".yaml")}
        _tell(damage, path, files.keys() - frames, "without YAML, read without pose")
        _tell(damage, path, frames - files.keys(), "without points (.pcd), left out")
        if files:
            agents[path.name] = files
    protocol = _protocol(folder / _PROTOCOL, damage)
    vehicle, roadside = (_lidar(protocol, part, folder, damage) for part in ("vehicle_base", "rsu_base"))
    step_s = _at(protocol, ("world", "fixed_delta_seconds"))
    usable = isinstance(step_s, float) and 0 < step_s < 10
    return _Scenario(agents, step_s if usable else STEP_S, vehicle, roadside)


def _tell(damage: list[str], folder: Path, frames: Iterable[int], problem: str) -> None:
    numbers = sorted(frames)
    if numbers:
        damage.append(f"{folder}: {len(numbers)} frame(s) {problem}, the first is {numbers[0]:06d}")


def _protocol(path: Path, damage: list[str]) -> Any:
    if not path.is_file():
        return {}
    try:
        return _parsed(path)
    except (ValueError, OSError) as error:
        damage.append(f"{error}; left out")
        return {}


def _at(tree: Any, keys: Iterable[str]) -> Any:
    for key in keys:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return tree


def _lidar(protocol: Any, part: str, folder: Path, damage: list[str]) -> LidarModel | None:
    told = _at(protocol, (part, "sensing", "perception", "lidar"))
    if told is None:
        return None
    names = ("upper_fov", "lower_fov", "range", "points_per_second", "rotation_frequency")
    try:
        return lidar_of_carla(int(told["channels"]), *(float(told[name]) for name in names))
    except (KeyError, TypeError, ValueError) as error:
        damage.append(f"{folder / _PROTOCOL}: does not describe the lidar of {part}: {error!r}")
        return None


def _about(ref: SweepRef) -> Mapping[str, Any] | None:
    """Return what the YAML file beside a sweep says, or None where there is no such file."""
    path = _yaml_of(ref.file)
    if not path.is_file():
        return None
    about = _parsed(path)
    if not isinstance(about, dict):
        raise ValueError(f"{path}: must be a mapping, got {type(about).__name__}")
    return about


def _yaml_of(file: str) -> Path:
    return Path(file).with_suffix(".yaml")


def _pose(about: Mapping[str, Any], ref: SweepRef) -> Rigid:
    try:
        x, y, z, roll, yaw, pitch = map(float, about["lidar_pose"])
        return rigid_of_carla((x, y, z), roll, pitch, yaw)
    except (KeyError, TypeError, ValueError) as error:
        problem = "lidar_pose must be six numbers x, y, z, roll, yaw, pitch"
        raise ValueError(f"{_yaml_of(ref.file)}: {problem}: {error!r}") from error


def _height_m(about: Mapping[str, Any], pose: Rigid, ref: SweepRef) -> float | None:
    """Return how far the sensor is above its vehicle's origin, which CARLA has on the road; None at the roadside."""
    vehicle = about.get("true_ego_pos")
    if _is_roadside(ref.agent) or not isinstance(vehicle, list) or len(vehicle) < 3:
        return None
    height = pose.translation[2] - float(vehicle[2])
    return height if _HEIGHTS_M[0] < height < _HEIGHTS_M[1] else None


def _box(name: str, row: Mapping[str, Any]) -> ObjectBox:
    roll, yaw, pitch = map(float, row["angle"])
    vehicle = rigid_of_carla(row["location"], roll, pitch, yaw)
    world_from_box = vehicle @ rigid_of_carla(row.get("center", (0.0, 0.0, 0.0)), 0.0, 0.0, 0.0)
    return box_of_carla(world_from_box, row["extent"], str(row.get("obj_type", "vehicle")), name)


def _parsed(path: Path) -> Any:
    import yaml

    size = path.stat().st_size
    if size > _MAX_YAML_BYTES:
        raise ValueError(f"{path}: must be at most {_MAX_YAML_BYTES} bytes, got {size}")
    try:
        return yaml.load(path.read_bytes(), _loader())
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ValueError(f"{path}: is not YAML: {' '.join(str(error).split())}") from error


@lru_cache(maxsize=1)
def _loader() -> Any:
    """Return PyYAML's safe loader, the fast one if it is there; objects of Python become None, nothing is run."""
    try:
        import yaml
    except ImportError as error:
        raise ImportError("OPV2V needs PyYAML: pip install 'viewshed[opv2v]'") from error
    base: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    loader: Any = type("_Loader", (base,), {})
    loader.add_multi_constructor("tag:yaml.org,2002:python/", lambda loader, suffix, node: None)
    return loader
