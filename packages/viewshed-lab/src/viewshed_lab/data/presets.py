"""Presets: composition of simulated data sets, one flat TOML file each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from viewshed.grid import BevGrid
from viewshed.sensors import lidar_model
from viewshed_lab import _config as flat
from viewshed_lab.sim.lidar.weather import conditions_named
from viewshed_lab.sim.world import AgentPlan
from viewshed_lab.sim.worlds import WORLDS

MAX_SEED = 2**32 - 1
_TABLES = "data/preset_tables"

MAX_CELLS = 2048
"""Most cells per side of a frame's grid: with one more target than ours, a worker stays below half a gigabyte."""


@dataclass(frozen=True, slots=True)
class Preset:
    """Composition of a simulated data set.

    Raises:
        ValueError: a name is unknown, a number is out of range, or lists differ in length.
    """

    name: str  # of the preset
    about: str  # one-line description
    worlds: tuple[str, ...]  # kinds of world, of ``WORLDS``
    world_weights: tuple[float, ...]  # relative frequency of each kind over the scenes
    splits: tuple[str, ...]  # names of the splits
    scenes: tuple[int, ...]  # number of scenes of each split
    frames: tuple[int, ...]  # number of sweeps of each split, spread evenly over its scenes
    moving: int  # vehicles or robots with a sensor in each scene
    roadside: int  # sensors on masts in each scene
    sensors: tuple[str, ...]  # beam tables of the moving sensors, used in turn over the scenes
    roadside_sensor: str  # beam table of the sensors on masts
    sensor_height_m: float  # of the moving sensors
    interval_s: float  # between two sweeps of one agent
    revolution_s: float  # duration of a sweep; 0 fires all beams at once
    conditions: tuple[str, ...]  # weather and faults, of ``CONDITIONS``; one per scene
    condition_weights: tuple[float, ...]  # relative frequency of each condition over the scenes
    grid_cells: int  # cells per side of the truth's grid
    grid_half_extent_m: float  # half the side length of the truth's grid
    seed: int  # of all random numbers

    def __post_init__(self) -> None:
        for names, numbers in (("worlds", "world_weights"), ("conditions", "condition_weights"),
                               ("splits", "scenes"), ("splits", "frames")):  # fmt: skip
            keys, values = getattr(self, names), getattr(self, numbers)
            if not keys or len(keys) != len(values) or len(set(keys)) != len(keys):
                raise ValueError(f"{self.name}: {names} must be different names with {numbers} of the same length")
            if min(values) <= 0:
                raise ValueError(f"{self.name}: {numbers} must be positive, got {list(values)}")
        for split, scenes, frames in zip(self.splits, self.scenes, self.frames, strict=True):
            if frames < scenes:
                raise ValueError(f"{self.name}: {split} must have a frame for each scene, got {frames} for {scenes}")
        for world in self.worlds:
            if world not in WORLDS:
                raise ValueError(f"{self.name}: worlds must be among {', '.join(WORLDS)}, got {world!r}")
        for condition in self.conditions:
            conditions_named(condition)
        for sensor in (*self.sensors, self.roadside_sensor):
            lidar_model(sensor)
        if not 0 <= self.seed <= MAX_SEED:
            raise ValueError(f"seed must lie in [0, {MAX_SEED}], got {self.seed}")
        if not 1 <= self.grid_cells <= MAX_CELLS:
            raise ValueError(
                f"a data set's grid must have 1 to {MAX_CELLS} cells a side, got {self.grid_cells}: "
                "a frame would not fit into memory; choose fewer cells"
            )
        if not (self.interval_s > 0 and 0 <= self.revolution_s <= 1):
            raise ValueError(f"{self.name}: interval_s must be positive and revolution_s lie in [0, 1]")
        self.plan(0, 1.0)
        _ = self.grid

    @classmethod
    def from_json(cls, table: dict[str, Any]) -> Preset:
        """Return the preset of a table of plain values: the keys are the attributes, tuples are lists."""
        return cls(**flat.from_dict(cls, table, "preset"))

    def to_json(self) -> dict[str, Any]:
        """Return the preset as a table of plain values."""
        return flat.to_dict(self)

    @property
    def grid(self) -> BevGrid:
        """The truth's grid."""
        return _grid(self.grid_cells, self.grid_half_extent_m)

    @property
    def agents(self) -> int:
        """Number of agents in each scene."""
        return self.moving + self.roadside

    @property
    def sweeps(self) -> int:
        """Number of sweeps in all splits."""
        return sum(self.frames)

    def plan(self, sensor: int, duration_s: float) -> AgentPlan:
        """Return the sensors of a world; ``sensor`` is the index of the moving agents' beam table in ``sensors``."""
        height_m = self.sensor_height_m
        return AgentPlan(self.moving, self.roadside, self.sensors[sensor], self.roadside_sensor, height_m, duration_s)

    def scaled(self, sweeps: int) -> Preset:
        """Return the preset with another number of sweeps; splits keep their ratio, scenes their length if possible.

        Raises:
            ValueError: there are fewer sweeps than splits.

        >>> small = preset_named("nuscenes").scaled(1000)
        >>> small.frames, small.scenes
        ((821, 179), (21, 4))
        """
        if sweeps < len(self.splits):
            raise ValueError(f"sweeps must be at least {len(self.splits)}, one for each split, got {sweeps}")
        frames = _shared(sweeps, self.frames)
        lengths = [total / count for total, count in zip(self.frames, self.scenes, strict=True)]
        scenes = (max(1, min(count, round(count / length))) for count, length in zip(frames, lengths, strict=True))
        return replace(self, frames=tuple(frames), scenes=tuple(scenes))


def _shared(total: int, weights: tuple[int, ...]) -> list[int]:
    """Split ``total`` into positive integers in the ratio of ``weights``."""
    rest, counts = total, []
    for index, weight in enumerate(weights):
        after = len(weights) - index - 1
        share = round(rest * weight / sum(weights[index:]))
        counts.append(min(max(share, 1), rest - after))
        rest -= counts[-1]
    return counts


@lru_cache(maxsize=4)
def _grid(cells: int, half_extent_m: float) -> BevGrid:
    """Return a shared grid, so that its cell centers are computed only once."""
    return BevGrid(cells, half_extent_m)


@lru_cache(maxsize=1)
def preset_names() -> tuple[str, ...]:
    """Return the names of all presets, sorted."""
    return flat.preset_names(_TABLES)


def preset_named(name: str) -> Preset:
    """Return the preset called ``name``.

    Raises:
        ValueError: there is no such preset; the message lists all names.
    """
    return Preset.from_json(flat.load_preset(_TABLES, name))
