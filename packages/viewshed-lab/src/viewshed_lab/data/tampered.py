"""Attacked or corrupted data sets: made shard by shard, with the source's truth and a record of the changed rows.

A plan names the attack or corruption of each sweep; the sweeps come from an archive, a recording or files.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache, partial
from itertools import groupby
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from viewshed.fov.estimate import FovEstimator
from viewshed.fov.truth import Truth
from viewshed.grid import BevGrid
from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import SweepSource
from viewshed.sweep import Sweep
from viewshed_lab._config import one_of
from viewshed_lab._jobs import Engine
from viewshed_lab.data.archive.archive import Archive
from viewshed_lab.data.archive.build import FRAMES_PER_SHARD, ShardJob, ShardResult, build_archive
from viewshed_lab.data.archive.schema import Layout
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.sample import Sample
from viewshed_lab.threats.attacks import (
    ADAPTIVE,
    ATTACKS,
    EARLIER,
    INFORMED,
    PAPER_ATTACK,
    PAPER_INDOOR_ATTACK,
    WHOLE_CLOUD,
    Attack,
    Knowledge,
)
from viewshed_lab.threats.attacks.base import Tampered
from viewshed_lab.threats.corruptions import CORRUPTIONS

ReadFile = Callable[[Path], Iterator[Sweep]]

SceneFrames = Callable[[int], Sample]
"""Returns a frame of one scene by its number, or raises a ValueError or an OSError; it must be picklable."""


def _recorded(place: str, kind: str, scene: str, grid: BevGrid, index: int) -> Sample:
    """Return a sweep of a recording as a sample without known truth."""
    source = opened(place, kind)
    return without_truth(source.read(source.refs(scene)[index]), grid, scene)


def _of_file(path: Path, read: ReadFile, grid: BevGrid, index: int) -> Sample:
    """Return a sweep of a file as a sample without known truth."""
    return without_truth(_Cursor(path, read).at(index), grid, path.name)


def without_truth(sweep: Sweep, grid: BevGrid, scene: str) -> Sample:
    """Return a sweep as a sample without known truth."""
    return Sample(sweep, Truth(grid, {}, {}), np.zeros(grid.shape, np.bool_), scene)


@lru_cache(maxsize=2)
def opened(place: str, kind: str) -> SweepSource:
    """Open the recording at a place, once per process; raises like ``open_source``."""
    return open_source(place, kind)


@lru_cache(maxsize=2)
class _Cursor:
    """Reads the sweeps of a file in order, and starts again for an earlier sweep."""

    def __init__(self, path: Path, read: ReadFile) -> None:
        self._path, self._read = path, read
        self._last: Sweep | None = None
        self._index, self._sweeps = -1, read(path)

    def at(self, index: int) -> Sweep:
        if index < self._index:
            self._index, self._sweeps = -1, self._read(self._path)
        while self._index < index:
            self._last = next(self._sweeps, None)
            self._index += 1
        if self._last is None:
            raise ValueError(f"{self._path} must have more than {index} sweeps; it changed while it was read")
        return self._last


ReadEarlier = Callable[[], tuple[Sweep, ...]]
"""Returns earlier sweeps of the same agent: its first and its previous one; () for the first sweep."""

PAPER = "paper"
_USES_HISTORY = EARLIER | {"coherent_phantom"}
_FACTORIES = ATTACKS | INFORMED | ADAPTIVE | WHOLE_CLOUD
_ROOM_M = 20.0


@dataclass(frozen=True, slots=True)
class AttackPlan:
    """An attack on every sweep of a data set.

    Raises:
        ValueError: there is no such attack, or it has no such budget, mode or placement.
    """

    command: ClassVar[str] = "attack"

    # a name of ``ATTACKS``, ``INFORMED``, ``WHOLE_CLOUD`` or ``ADAPTIVE``, or ``paper`` for the paper's mixture
    attack: str
    budget: int | None = None  # largest number of returns; None is the attack's default
    mode: str | None = None  # ``free_form`` or ``beam_constrained``; None is the attack's default
    half_extent_m: float = 64.0  # half the side length of the victim's grid
    placement: str | None = None  # of ``Placement``; None is the attack's default
    victim: str | None = None  # name of the estimator that an adaptive attacker queries
    estimator: FovEstimator | None = None  # that estimator

    def __post_init__(self) -> None:
        one_of("attack", self.attack, (*_FACTORIES, PAPER))
        self._build_attack((Sweep(np.zeros((0, 3), np.float32)),))

    def apply(self, sample: Sample, history: ReadEarlier, rng: np.random.Generator) -> Sample:
        """Return the attacked sample; an attack that needs earlier sweeps leaves the first sweep unchanged."""
        earlier = history() if self.attack in _USES_HISTORY else ()
        if not earlier and self.attack in EARLIER:
            none = np.zeros(len(sample.sweep), np.bool_)
            return replace(sample, tampered=Tampered(sample.sweep, none, none), clean=None)
        return sample.attacked(self._build_attack(earlier or (sample.sweep,)).apply(sample.sweep, rng))

    @property
    def name(self) -> str:
        """Name of the attack."""
        return self.attack

    def config(self) -> dict[str, Any]:
        """Return all parameters as plain values."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "estimator"}

    def _build_attack(self, earlier: tuple[Sweep, ...]) -> Attack:
        options = {"mode": self.mode, "placement": self.placement}
        options = {name: value for name, value in options.items() if value is not None}
        if self.attack == PAPER:
            if self.budget is not None or options:
                raise ValueError("attack paper samples its own points; omit budget, mode and placement")
            return PAPER_INDOOR_ATTACK if self.half_extent_m <= _ROOM_M else PAPER_ATTACK
        attack: Any = _FACTORIES[self.attack](self.budget, Knowledge(earlier, self.estimator, self.half_extent_m))
        for name, value in options.items():
            if name not in {field.name for field in fields(attack)}:
                raise ValueError(f"attack {self.attack} must keep its own {name}, got {value!r}; omit {name}")
        return replace(attack, **options)  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class CorruptionPlan:
    """A corruption of every sweep of a data set.

    Raises:
        ValueError: there is no such corruption or severity.
    """

    command: ClassVar[str] = "corrupt"

    corruption: str  # a name of ``CORRUPTIONS``
    severity: int = 3  # 1 to 5

    def __post_init__(self) -> None:
        one_of("corruption", self.corruption, CORRUPTIONS)
        CORRUPTIONS[self.corruption](self.severity)

    def apply(self, sample: Sample, history: ReadEarlier, rng: np.random.Generator) -> Sample:
        """Return the sample with a corrupted sweep, without a record of the changed returns."""
        return sample.corrupted(CORRUPTIONS[self.corruption](self.severity).apply(sample.sweep, rng))

    @property
    def name(self) -> str:
        """Name of the corruption."""
        return self.corruption

    def config(self) -> dict[str, Any]:
        """Return all parameters as plain values."""
        return asdict(self)


TamperPlan = AttackPlan | CorruptionPlan
"""What is done to a sweep; deterministic for a given generator, and picklable."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Frames of one scene that become one shard."""

    name: str  # of the shard's file
    frames: SceneFrames  # of the whole scene
    scene: str  # name of the scene
    split: str  # split of the scene
    number: int  # of the scene in the data set, for seeds
    first: int  # the first frame
    last: int  # the frame after the last


@dataclass(frozen=True, slots=True, eq=False)
class Sweeps:
    """A data set of any kind that can be attacked."""

    layout: Layout  # of its truth
    parts: tuple[Part, ...]  # one per shard
    lineage: Any  # identity of the data, as plain values that do not depend on its location
    problems: tuple[str, ...] = ()  # one line per problem found on opening

    @property
    def count(self) -> int:
        """Number of sweeps."""
        return sum(part.last - part.first for part in self.parts)


def sweeps_of_archive(archive: Archive, split: str | None = None) -> Sweeps:
    """Return the sweeps of an archive, or of one of its splits; a sweep has the same seed in both."""
    selected = {shard.name for shard in (archive if split is None else archive.split(split)).shards}
    parts = []
    for number, scene in enumerate(archive.scenes):
        # Jobs are pickled, so they hold only the part of the manifest that they need.
        shards = tuple(shard for shard in archive.shards if shard.scene == scene)
        frames = Archive(archive.store, replace(archive.manifest, shards=shards)).__getitem__
        first = 0
        for shard in shards:
            if shard.name in selected:
                last = first + shard.frames
                parts.append(Part(shard.name, frames, scene, shard.split, number, first, last))
            first += shard.frames
    digest = _digest([shard.to_json() for shard in archive.shards])
    lineage = {"recipe": dict(archive.manifest.recipe), "sha256": digest, "split": split}
    return Sweeps(archive.manifest.layout, tuple(parts), lineage)


def sweeps_of_recording(place: str, grid: BevGrid, kind: str = "auto") -> Sweeps:
    """Return the sweeps of a recording, without known truth; raises like ``open_source``."""
    source = opened(place, kind)
    parts: list[Part] = []
    listing, problems = [], list(source.damage())
    for number, scene in enumerate(source.scenes()):
        try:
            refs = source.refs(scene)
        except (ValueError, OSError) as error:
            problems.append(str(error))
            continue
        listing.append([[ref.scene, ref.index, Path(ref.file).name, ref.t_ns, ref.key] for ref in refs])
        parts += _split_into_parts(partial(_recorded, place, kind, scene, grid), len(refs), scene, number)
    return _without_truth(parts, listing, problems, grid)


def sweeps_of_files(files: Sequence[Path], read: ReadFile, grid: BevGrid) -> Sweeps:
    """Return the sweeps of files, one scene per file, without known truth.

    Args:
        files: of any format.
        read: yields the sweeps of one file; it must be picklable.
        grid: of the empty truth.
    """
    parts: list[Part] = []
    listing, problems = [], []
    for number, file in enumerate(files):
        count = 0
        try:
            for _ in read(file):
                count += 1
        except (ValueError, OSError) as error:
            problems.append(str(error))
        listing.append([file.name, count, file.stat().st_size if file.is_file() else 0])
        parts += _split_into_parts(partial(_of_file, file.absolute(), read, grid), count, file.name, number)
    return _without_truth(parts, listing, problems, grid)


def _without_truth(parts: Sequence[Part], listing: Any, problems: Sequence[str], grid: BevGrid) -> Sweeps:
    return Sweeps(Layout(grid, (), ()), tuple(parts), {"sha256": _digest(listing)}, tuple(problems))


def tamper(
    sweeps: Sweeps,
    plan: TamperPlan,
    store: Storage,
    engine: Engine,
    seed: int = 0,
    on_progress: Callable[[ShardResult], None] | None = None,
) -> Archive:
    """Attack or corrupt sweeps into ``store`` and return the archive; its bytes do not depend on the engine.

    Truth, known, scene and split are those of the source. The random numbers of a sweep depend only on ``seed``, the
    number of its scene and its number in the scene. An interrupted run resumes.

    Args:
        sweeps: from :func:`sweeps_of_archive`, :func:`sweeps_of_recording` or :func:`sweeps_of_files`.
        plan: attack or corruption of each sweep.
        store: destination.
        engine: runs the jobs.
        seed: of all random numbers.
        on_progress: called with each finished shard and the problems of the sweeps that were left out.

    Raises:
        ValueError: the destination holds something else, or the seed is negative.
        OSError: a shard could not be made or written; finished shards are kept.
    """
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    config = plan.config() | {"source": sweeps.lineage}
    recipe = {"command": plan.command, "name": plan.name, "seed": seed, "config": config}
    jobs = [ShardJob(part.name, partial(_tampered_samples, part, plan, seed)) for part in sweeps.parts]
    return build_archive(recipe, sweeps.layout, jobs, store, engine, on_progress)


def tampered_sweep(sweeps: Sweeps, plan: TamperPlan, seed: int = 0) -> tuple[Sweep, str]:
    """Attack or corrupt the first sweep; return it, and a record of the changes as JSON.

    Added rows index the new sweep, removed rows the old one.

    Raises:
        ValueError: the plan is not possible on this sweep.
        OSError: the sweep cannot be read.
    """
    frame = _tampered_sample(sweeps.parts[0], plan, seed, 0, _EarlierSweeps(sweeps.parts[0]))
    about = {"command": plan.command, "name": plan.name, "seed": seed, "config": plan.config()}
    tampered = frame.tampered
    if tampered is not None:
        wedge = None if tampered.wedge is None else (tampered.wedge.azimuth, tampered.wedge.width)
        about |= {"wedge": wedge, "added_rows": np.flatnonzero(tampered.added).tolist()}
        about |= {"removed_rows": np.flatnonzero(tampered.removed).tolist()}
    return frame.sweep, json.dumps(about) + "\n"


def _tampered_samples(part: Part, plan: TamperPlan, seed: int, problems: list[str]) -> Iterator[Sample]:
    """Yield the tampered samples of a part; leave unusable sweeps out and report them in ``problems``.

    A missing file counts as an unusable sweep; any other OSError of the source ends the job.
    """
    earlier, lost = _EarlierSweeps(part), list[tuple[int, str]]()
    for index in range(part.first, part.last):
        try:
            yield _tampered_sample(part, plan, seed, index, earlier)
        except (ValueError, FileNotFoundError) as error:
            lost.append((index, " ".join(str(error).split())))
    # One line per run of sweeps with the same problem.
    for message, group in groupby(lost, lambda problem: problem[1]):
        numbers = [index for index, _ in group]
        which = f"sweep {numbers[0]}" if len(numbers) == 1 else f"{len(numbers)} sweeps from {numbers[0]} on"
        problems.append(f"{part.scene}, {which}: {message}")


def _tampered_sample(part: Part, plan: TamperPlan, seed: int, index: int, earlier: _EarlierSweeps) -> Sample:
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, part.number, index])))
    frame = part.frames(index)
    sweep = frame.sweep
    tampered = plan.apply(frame, lambda: earlier.of(sweep, index), rng)
    earlier.note(sweep)
    return tampered


class _EarlierSweeps:
    """Caches each agent's first sweep in a scene, and its last sweep before the current frame."""

    def __init__(self, part: Part) -> None:
        self._part = part
        self._first: dict[str, Sweep] = {}
        self._last: dict[str, Sweep] = {}

    def note(self, sweep: Sweep) -> None:
        self._last[sweep.agent] = sweep

    def of(self, sweep: Sweep, index: int) -> tuple[Sweep, ...]:
        agent = sweep.agent
        if agent not in self._last:
            before = self._first_of(agent, range(self._part.first - 1, -1, -1))
            if before is None:
                self._first[agent] = sweep
                return ()
            self._last[agent] = before
        if agent not in self._first:
            self._first[agent] = self._first_of(agent, range(index)) or self._last[agent]
        return self._first[agent], self._last[agent]

    def _first_of(self, agent: str, indices: Iterable[int]) -> Sweep | None:
        """Return the first sweep of an agent among some frames, skipping unreadable ones."""
        for index in indices:
            try:
                frame = self._part.frames(index)
                if frame.measured.agent == agent:
                    return frame.sweep
            except (ValueError, FileNotFoundError):
                continue
        return None


def _split_into_parts(frames: SceneFrames, count: int, scene: str, number: int) -> Iterator[Part]:
    for chunk, first in enumerate(range(0, count, FRAMES_PER_SHARD)):
        last = min(first + FRAMES_PER_SHARD, count)
        yield Part(f"scene-{number:05d}-{chunk:03d}.parquet", frames, scene, "", number, first, last)


def _digest(table: Any) -> str:
    return hashlib.sha256(json.dumps(table, sort_keys=True, default=str).encode()).hexdigest()
