"""Simulated data sets: everything random in a frame follows from the seed and the frame's place in the data set.

So frames can be simulated in any order, on any machine, and a run that was stopped resumes to the same bytes.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from itertools import accumulate, pairwise

import numpy as np

from viewshed.fov.truth import OTHER_DEFINITIONS
from viewshed.fov.visibility import TARGETS
from viewshed_lab._jobs import Engine
from viewshed_lab.data.archive.archive import Archive
from viewshed_lab.data.archive.build import FRAMES_PER_SHARD, ShardJob, ShardResult, build_archive
from viewshed_lab.data.archive.schema import Layout
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.presets import Preset
from viewshed_lab.data.sample import Sample
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.observe import Observation, Setting, measure_sweep, observe
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.world import Agent, World
from viewshed_lab.sim.worlds import WORLDS

_GOLDEN = (5**0.5 - 1) / 2
_SILVER = 2**0.5 - 1
_BRONZE = (13**0.5 - 3) / 2


_FOR_WORLD, _FOR_OBSERVATION, _FOR_WORLD_KIND, _FOR_CONDITIONS, _FOR_SENSOR = range(5)


@dataclass(frozen=True, slots=True)
class ScenePlan:
    """One scene of a simulated data set."""

    preset: Preset  # the composition that it is part of
    split: int  # number of its split
    number: int  # its number in the split

    @property
    def split_name(self) -> str:
        """Name of its split."""
        return self.preset.splits[self.split]

    @property
    def name(self) -> str:
        """Its name in the archive: split, number, kind of world, conditions."""
        return f"{self.split_name}-{self.number:04d}-{self.world_kind}-{self.conditions}"

    @property
    def frames(self) -> int:
        """Number of its frames: agent after agent, then the next time."""
        total, scenes = self.preset.frames[self.split], self.preset.scenes[self.split]
        return total // scenes + (self.number < total % scenes)

    @property
    def duration_s(self) -> float:
        """How long it lasts."""
        return -(-self.frames // self.preset.agents) * self.preset.interval_s

    @property
    def world_kind(self) -> str:
        """What kind of place it is."""
        return self.preset.worlds[self._turn(_FOR_WORLD_KIND, _GOLDEN, self.preset.world_weights)]

    @property
    def conditions(self) -> str:
        """Weather and faults."""
        return self.preset.conditions[self._turn(_FOR_CONDITIONS, _SILVER, self.preset.condition_weights)]

    @property
    def sensor(self) -> int:
        """Which of the preset's sensors the moving agents have."""
        return self._turn(_FOR_SENSOR, _BRONZE, (1.0,) * len(self.preset.sensors))

    def chunks(self) -> Iterator[tuple[int, int]]:
        """Yield the first frame of each shard and the one after its last: whole times, 48 frames if they fit."""
        agents = self.preset.agents
        times = -(-self.frames // agents)
        count = -(-times // max(1, FRAMES_PER_SHARD // agents))
        ends = [times * k // count * agents for k in range(count + 1)]
        yield from ((first, min(last, self.frames)) for first, last in pairwise(ends))

    def seed(self, purpose: int, frame: int = 0) -> np.random.SeedSequence:
        """Return the seed of what is random in one frame (or in the scene) for one purpose."""
        time, agent = divmod(frame, self.preset.agents)
        return np.random.SeedSequence([self.preset.seed, self.split, self.number, agent, time, purpose])

    def _turn(self, purpose: int, step: float, weights: tuple[float, ...]) -> int:
        """Return the scene's turn: the multiples of an irrational number fill [0, 1) evenly (Kronecker, Weyl)."""
        at = (_start_of(self.preset.seed, self.split, purpose) + self.number * step) % 1.0 * sum(weights)
        return min(bisect_right(list(accumulate(weights)), at), len(weights) - 1)


@lru_cache(maxsize=64)
def _start_of(seed: int, split: int, purpose: int) -> float:
    """Return where the turns of a split's scenes begin for one purpose, in [0, 1)."""
    return float(np.random.SeedSequence([seed, split, 0, 0, 0, purpose]).generate_state(1)[0] / 2**32)


def jobs_of(preset: Preset) -> list[ShardJob]:
    """Return the shards of a data set, in order."""
    return [
        ShardJob(f"{scene.split_name}-{scene.number:04d}-{chunk:03d}.parquet", partial(_samples, scene, first, last))
        for split, scenes in enumerate(preset.scenes)
        for scene in (ScenePlan(preset, split, number) for number in range(scenes))
        for chunk, (first, last) in enumerate(scene.chunks())
    ]


def _samples(scene: ScenePlan, first: int, last: int, _: list[str]) -> Iterator[Sample]:
    return (simulate_frame(scene, frame) for frame in range(first, last))


def simulate_frame(scene: ScenePlan, frame: int) -> Sample:
    """Return one frame of a scene: range image, truth and where it is known."""
    seen = observe_frame(scene, frame)
    return Sample(seen.image, seen.truth, seen.known, scene.name, scene.split_name)


def observe_frame(scene: ScenePlan, frame: int) -> Observation:
    """Return what is observed in one frame of a scene: beside what is stored, what every beam met."""
    return observe(*_place_of(scene, frame), scene.seed(_FOR_OBSERVATION, frame))


def scan_frame(scene: ScenePlan, frame: int, world: World | None = None) -> tuple[ExactScan, StoredSweep]:
    """Return what every beam meets in one frame of a scene, and what the sensor stores, without the frame's truth.

    A ``world`` with the same agents takes the place of the scene's own.
    """
    for_paths, for_noise = scene.seed(_FOR_OBSERVATION, frame).spawn(2)
    return measure_sweep(*_place_of(scene, frame, world), for_paths, for_noise)


def _place_of(scene: ScenePlan, frame: int, world: World | None = None) -> tuple[World, Agent, float, Setting]:
    """Return who observes in one frame of a scene, when and how."""
    preset, world = scene.preset, world or world_of(scene)
    time, number = divmod(frame, preset.agents)
    setting = Setting(preset.grid, CONDITIONS[scene.conditions], preset.revolution_s)
    return world, world.agents[number], (time + 0.5) * preset.interval_s, setting


@lru_cache(maxsize=2)
def world_of(scene: ScenePlan) -> World:
    """Return the world of a scene."""
    rng = np.random.Generator(np.random.PCG64(scene.seed(_FOR_WORLD)))
    world = WORLDS[scene.world_kind](rng, scene.preset.plan(scene.sensor, scene.duration_s))
    if len(world.agents) != scene.preset.agents:
        raise ValueError(f"{scene.name} must have {scene.preset.agents} agents, got {len(world.agents)}")
    return world


def simulate(
    preset: Preset, store: Storage, engine: Engine, on_progress: Callable[[ShardResult], None] | None = None
) -> Archive:
    """Return the archive of a preset, simulated into ``store``; its bytes do not depend on the engine.

    Shards of an earlier run of the same preset that was stopped are kept where they are whole.

    Args:
        preset: what is simulated.
        store: where it goes.
        engine: makes the shards.
        on_progress: is called with each shard that is finished, also of an earlier run.

    Raises:
        ValueError: the place holds something else.
        OSError: a shard could not be made or written; those that are finished stay.
    """
    layout = Layout(preset.grid, tuple(sorted(TARGETS)), tuple(sorted(OTHER_DEFINITIONS)))
    return build_archive(recipe_of(preset), layout, jobs_of(preset), store, engine, on_progress)


def recipe_of(preset: Preset) -> dict[str, object]:
    """Return how a simulated data set was made, as plain values."""
    targets = {name: asdict(target) for name, target in TARGETS.items()}
    about = {"command": "simulate", "preset": preset.name, "seed": preset.seed}
    return about | {"config": preset.to_json(), "targets": targets}
