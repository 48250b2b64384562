"""Simulated data sets: all random numbers of a frame depend only on the seed and the frame's place in the data set.

So frames can be simulated in any order and on any machine, and an interrupted run resumes to the same bytes.
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

    preset: Preset  # composition of the data set
    split: int  # index of the scene's split
    number: int  # number of the scene in the split

    @property
    def split_name(self) -> str:
        """Name of its split."""
        return self.preset.splits[self.split]

    @property
    def name(self) -> str:
        """Name in the archive: split, number, kind of world, conditions."""
        return f"{self.split_name}-{self.number:04d}-{self.world_kind}-{self.conditions}"

    @property
    def frames(self) -> int:
        """Number of frames; at each time there is one frame of every agent."""
        total, scenes = self.preset.frames[self.split], self.preset.scenes[self.split]
        return total // scenes + (self.number < total % scenes)

    @property
    def duration_s(self) -> float:
        """Duration of the scene."""
        return -(-self.frames // self.preset.agents) * self.preset.interval_s

    @property
    def world_kind(self) -> str:
        """Kind of world, of ``WORLDS``."""
        return self.preset.worlds[self._turn(_FOR_WORLD_KIND, _GOLDEN, self.preset.world_weights)]

    @property
    def conditions(self) -> str:
        """Weather and faults, of ``CONDITIONS``."""
        return self.preset.conditions[self._turn(_FOR_CONDITIONS, _SILVER, self.preset.condition_weights)]

    @property
    def sensor(self) -> int:
        """Index of the moving agents' beam table in the preset's ``sensors``."""
        return self._turn(_FOR_SENSOR, _BRONZE, (1.0,) * len(self.preset.sensors))

    def chunks(self) -> Iterator[tuple[int, int]]:
        """Yield the first frame of each shard and the one after its last: all agents of a time, up to 48 frames."""
        agents = self.preset.agents
        times = -(-self.frames // agents)
        count = -(-times // max(1, FRAMES_PER_SHARD // agents))
        ends = [times * k // count * agents for k in range(count + 1)]
        yield from ((first, min(last, self.frames)) for first, last in pairwise(ends))

    def seed(self, purpose: int, frame: int = 0) -> np.random.SeedSequence:
        """Return the seed for one purpose in a frame, or in the scene (frame 0)."""
        time, agent = divmod(frame, self.preset.agents)
        return np.random.SeedSequence([self.preset.seed, self.split, self.number, agent, time, purpose])

    def _turn(self, purpose: int, step: float, weights: tuple[float, ...]) -> int:
        """Return a weighted index for the scene: multiples of an irrational number fill [0, 1) evenly (Kronecker)."""
        at = (_start_of(self.preset.seed, self.split, purpose) + self.number * step) % 1.0 * sum(weights)
        return min(bisect_right(list(accumulate(weights)), at), len(weights) - 1)


@lru_cache(maxsize=64)
def _start_of(seed: int, split: int, purpose: int) -> float:
    """Return the start in [0, 1) of a split's Kronecker sequence for one purpose."""
    return float(np.random.SeedSequence([seed, split, 0, 0, 0, purpose]).generate_state(1)[0] / 2**32)


def jobs_of(preset: Preset) -> list[ShardJob]:
    """Return the jobs that build the shards of a data set, in order."""
    return [
        ShardJob(f"{scene.split_name}-{scene.number:04d}-{chunk:03d}.parquet", partial(_samples, scene, first, last))
        for split, scenes in enumerate(preset.scenes)
        for scene in (ScenePlan(preset, split, number) for number in range(scenes))
        for chunk, (first, last) in enumerate(scene.chunks())
    ]


def _samples(scene: ScenePlan, first: int, last: int, _: list[str]) -> Iterator[Sample]:
    return (simulate_frame(scene, frame) for frame in range(first, last))


def simulate_frame(scene: ScenePlan, frame: int) -> Sample:
    """Simulate one frame of a scene: range image, truth, and the cells where the truth is known."""
    observed = observe_frame(scene, frame)
    return Sample(observed.image, observed.truth, observed.known, scene.name, scene.split_name)


def observe_frame(scene: ScenePlan, frame: int) -> Observation:
    """Observe one frame of a scene: the stored sweep, its truth, and the exact hit of every beam."""
    return observe(*_observer_of(scene, frame), scene.seed(_FOR_OBSERVATION, frame))


def scan_frame(scene: ScenePlan, frame: int, world: World | None = None) -> tuple[ExactScan, StoredSweep]:
    """Return the exact hit of every beam in one frame of a scene and the stored sweep, without computing the truth.

    ``world`` replaces the scene's world; it must have the same agents.
    """
    for_paths, for_noise = scene.seed(_FOR_OBSERVATION, frame).spawn(2)
    return measure_sweep(*_observer_of(scene, frame, world), for_paths, for_noise)


def _observer_of(scene: ScenePlan, frame: int, world: World | None = None) -> tuple[World, Agent, float, Setting]:
    """Return the world, the observing agent, the time in s and the setting of one frame of a scene."""
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
    """Simulate a preset into ``store`` and return the archive; its bytes do not depend on the engine.

    Intact shards of an interrupted run of the same preset are kept.

    Args:
        preset: composition of the data set.
        store: destination.
        engine: runs the jobs.
        on_progress: called with each finished shard, including those of an earlier run.

    Raises:
        ValueError: the destination holds something else.
        OSError: a shard could not be made or written; finished shards are kept.
    """
    layout = Layout(preset.grid, tuple(sorted(TARGETS)), tuple(sorted(OTHER_DEFINITIONS)))
    return build_archive(recipe_of(preset), layout, jobs_of(preset), store, engine, on_progress)


def recipe_of(preset: Preset) -> dict[str, object]:
    """Return the recipe of a simulated data set as plain values: command, preset, seed, config and targets."""
    targets = {name: asdict(target) for name, target in TARGETS.items()}
    about = {"command": "simulate", "preset": preset.name, "seed": preset.seed}
    return about | {"config": preset.to_json(), "targets": targets}
