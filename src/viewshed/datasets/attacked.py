"""Data sets under attack, or corrupted: shard by shard, truth kept, with a record of what was touched."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby
from pathlib import Path
from typing import Any

import numpy as np

from viewshed.bev import BevGrid
from viewshed.datasets.archive import Archive
from viewshed.datasets.frame import Frame
from viewshed.datasets.layout import Layout
from viewshed.datasets.making import Made, Task, make_archive, write_beside
from viewshed.datasets.scene_frames import ArchiveScene, FileScene, ReadFile, RecordingScene, SceneFrames, opened
from viewshed.datasets.shard import write_frames
from viewshed.datasets.spoiling import Spoiling
from viewshed.datasets.store import Store
from viewshed.datasets.writer import FRAMES_PER_SHARD
from viewshed.engines import Engine
from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Frames of one scene that become one shard.

    Attributes:
        name: of the shard's file.
        frames: of the whole scene.
        scene: its name.
        split: that it belongs to.
        number: of the scene in the data set, for seeds.
        first: the first frame.
        last: the frame after the last.
    """

    name: str
    frames: SceneFrames
    scene: str
    split: str
    number: int
    first: int
    last: int


@dataclass(frozen=True, slots=True, eq=False)
class Sweeps:
    """A data set of any kind that can be attacked.

    Attributes:
        layout: of its truth.
        parts: what its shards are.
        lineage: what it is, as plain values that do not depend on where it lies.
        problems: one line for each thing that was found wrong on opening.
    """

    layout: Layout
    parts: tuple[Part, ...]
    lineage: Any
    problems: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Number of sweeps."""
        return sum(part.last - part.first for part in self.parts)


@dataclass(frozen=True, slots=True, eq=False)
class SpoilJob:
    """What a worker must know to make one shard.

    Attributes:
        store: where the shard goes.
        part: what it is made from.
        spoiling: what is done.
        seed: of all that is random.
    """

    store: Store
    part: Part
    spoiling: Spoiling
    seed: int

    @property
    def name(self) -> str:
        """Name of the shard's file."""
        return self.part.name


def of_archive(archive: Archive, split: str | None = None) -> Sweeps:
    """Return the sweeps of an archive, or of one of its splits; a sweep has the same seed in both.

    Raises:
        ValueError: there is no such split.
    """
    wanted = {shard.name for shard in (archive if split is None else archive.split(split)).shards}
    parts = []
    for number, scene in enumerate(archive.scenes):
        frames, first = ArchiveScene.of(archive, scene), 0
        for shard in frames.archive.shards:
            if shard.name in wanted:
                last = first + shard.frames
                parts.append(Part(shard.name, frames, scene, shard.split, number, first, last))
            first += shard.frames
    shards = [shard.to_json() for shard in archive.shards]
    lineage = {"recipe": dict(archive.manifest.recipe), "sha256": _digest(shards), "split": split}
    return Sweeps(archive.manifest.layout, tuple(parts), lineage)


def of_recording(place: str, grid: BevGrid, kind: str = "auto") -> Sweeps:
    """Return the sweeps of a recording, which has no truth: it is nowhere known.

    Raises:
        ValueError: no recording is there, or it is damaged.
        OSError: it cannot be read.
    """
    source = opened(place, kind)
    parts: list[Part] = []
    told, problems = [], list(source.damage())
    for number, scene in enumerate(source.scenes()):
        try:
            refs = source.refs(scene)
        except (ValueError, OSError) as error:
            problems.append(str(error))
            continue
        told.append([[ref.scene, ref.index, Path(ref.file).name, ref.t_ns, ref.key] for ref in refs])
        parts += _chunks(RecordingScene(place, kind, scene, grid), len(refs), scene, number)
    return Sweeps(Layout(grid, (), ()), tuple(parts), {"sha256": _digest(told)}, tuple(problems))


def of_files(files: Sequence[Path], read: ReadFile, grid: BevGrid) -> Sweeps:
    """Return the sweeps of files, each a scene of its own; they have no truth.

    Args:
        files: of any format.
        read: yields the sweeps of one; it travels to other processes.
        grid: of the truth that is not there.
    """
    parts: list[Part] = []
    told, problems = [], []
    for number, file in enumerate(files):
        count = 0
        try:
            for _ in read(file):
                count += 1
        except (ValueError, OSError) as error:
            problems.append(str(error))
        told.append([file.name, count, file.stat().st_size if file.is_file() else 0])
        parts += _chunks(FileScene(file.absolute(), count, read, grid), count, file.name, number)
    return Sweeps(Layout(grid, (), ()), tuple(parts), {"sha256": _digest(told)}, tuple(problems))


def spoil(
    sweeps: Sweeps,
    spoiling: Spoiling,
    store: Store,
    engine: Engine,
    seed: int = 0,
    progress: Callable[[Made], None] | None = None,
) -> Archive:
    """Return the archive of attacked (or corrupted) sweeps, made into ``store``; its bytes do not depend on the engine.

    Truth, known, scene and split are those of the source. The random numbers of a sweep follow from ``seed``, the
    number of its scene and its number there. A run that was stopped goes on where it was.

    Args:
        sweeps: from :func:`of_archive`, :func:`of_recording` or :func:`of_files`.
        spoiling: what is done to each.
        store: where the archive goes.
        engine: makes the shards.
        seed: of all that is random.
        progress: is told of each shard that is there, and of the sweeps that had to be left out.

    Raises:
        ValueError: the place holds something else, or the seed is negative.
        OSError: a shard could not be made or written; those that are finished stay.
    """
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    config = spoiling.config() | {"source": sweeps.lineage}
    recipe = {"command": spoiling.command, "name": spoiling.name, "seed": seed, "config": config}
    jobs = [SpoilJob(store, part, spoiling, seed) for part in sweeps.parts]
    return make_archive(Task(recipe, sweeps.layout, jobs, spoil_shard), store, engine, progress)


def spoiled_sweep(sweeps: Sweeps, spoiling: Spoiling, seed: int = 0) -> tuple[Sweep, str]:
    """Return the first of some sweeps, attacked or corrupted, and what was done to it as JSON.

    The rows added are those of the new sweep, the rows removed those of the old one.

    Raises:
        ValueError: it cannot be done to this sweep.
        OSError: the sweep cannot be read.
    """
    job = SpoilJob(Store.of("."), sweeps.parts[0], spoiling, seed)
    frame = _one(job, 0, _Earlier(job.part))
    about = {"command": spoiling.command, "name": spoiling.name, "seed": seed, "config": spoiling.config()}
    touched = frame.touched
    if touched is not None:
        about |= {"wedge": touched.wedge, "added_rows": np.flatnonzero(touched.added).tolist()}
        about |= {"removed_rows": np.flatnonzero(touched.removed).tolist()}
    return frame.sweep, json.dumps(about) + "\n"


def spoil_shard(job: SpoilJob) -> Made:
    """Return what became of one shard: it is written with a file beside it; sweeps that cannot be used are left out.

    Raises:
        OSError: the source cannot be read now (a file that is not there is damage), or the shard cannot be written.
    """
    problems: list[tuple[int, str]] = []
    frames = _spoiled(job, problems)
    first = next(frames, None)
    if first is None:
        return Made(None, _folded(job.part, problems))
    facts = write_frames(job.store, job.name, (job.part.scene, job.part.split), chain([first], frames))
    lines = _folded(job.part, problems)
    return Made(write_beside(job.store, facts, lines), lines)


def _spoiled(job: SpoilJob, problems: list[tuple[int, str]]) -> Iterator[Frame]:
    earlier = _Earlier(job.part)
    for index in range(job.part.first, job.part.last):
        try:
            yield _one(job, index, earlier)
        except (ValueError, FileNotFoundError) as error:
            problems.append((index, " ".join(str(error).split())))


def _one(job: SpoilJob, index: int, earlier: _Earlier) -> Frame:
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([job.seed, job.part.number, index])))
    frame = job.part.frames.frame(index)
    sweep = frame.sweep
    done, touched = job.spoiling.apply(sweep, lambda: earlier.of(sweep, index), rng)
    earlier.note(sweep)
    return replace(frame, touched=touched, clean=None) if done is sweep else frame.attacked(done, touched)


class _Earlier:
    """The first sweep of each agent of a scene and the last before a frame; remembers what has passed."""

    def __init__(self, part: Part) -> None:
        self._part = part
        self._first: dict[str, Sweep] = {}
        self._last: dict[str, Sweep] = {}

    def note(self, sweep: Sweep) -> None:
        self._last[sweep.agent] = sweep

    def of(self, sweep: Sweep, index: int) -> tuple[Sweep, ...]:
        agent = sweep.agent
        if agent not in self._last:
            before = self._found(agent, range(self._part.first - 1, -1, -1))
            if before is None:
                self._first[agent] = sweep
                return ()
            self._last[agent] = before
        if agent not in self._first:
            self._first[agent] = self._found(agent, range(index)) or self._last[agent]
        return self._first[agent], self._last[agent]

    def _found(self, agent: str, indices: Iterable[int]) -> Sweep | None:
        """Return the first sweep of an agent among some frames; those that cannot be read are passed over."""
        for index in indices:
            try:
                if self._part.frames.agent(index) == agent:
                    return self._part.frames.frame(index).sweep
            except (ValueError, FileNotFoundError):
                continue
        return None


def _folded(part: Part, problems: list[tuple[int, str]]) -> tuple[str, ...]:
    """Return one line for each run of sweeps with one problem."""
    lines = []
    for message, group in groupby(problems, lambda problem: problem[1]):
        numbers = [index for index, _ in group]
        which = f"sweep {numbers[0]}" if len(numbers) == 1 else f"{len(numbers)} sweeps from {numbers[0]} on"
        lines.append(f"{part.scene}, {which}: {message}")
    return tuple(lines)


def _chunks(frames: SceneFrames, count: int, scene: str, number: int) -> Iterator[Part]:
    for chunk, first in enumerate(range(0, count, FRAMES_PER_SHARD)):
        last = min(first + FRAMES_PER_SHARD, count)
        yield Part(f"scene-{number:05d}-{chunk:03d}.parquet", frames, scene, "", number, first, last)


def _digest(table: Any) -> str:
    return hashlib.sha256(json.dumps(table, sort_keys=True, default=str).encode()).hexdigest()
