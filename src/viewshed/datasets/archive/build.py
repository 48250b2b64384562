"""Archives that are made shard by shard by an engine: what is there already is kept, the rest is made.

ArchiveWriter: samples of any origin into an archive.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from viewshed._jobs import Engine
from viewshed.datasets.archive.archive import Archive, damage_of
from viewshed.datasets.archive.manifest import MANIFEST, Manifest, code_version
from viewshed.datasets.archive.schema import Layout
from viewshed.datasets.archive.shard import ShardFacts, write_shard
from viewshed.datasets.archive.storage import Storage
from viewshed.datasets.sample import Sample

SIDECAR = ".json"
"""Ending of the file beside a finished shard that tells its checksum, until the manifest does."""

PROBLEMS = "problems.json"
"""What had to be left out of a finished archive, by shard; a file of its own, for its lines may name places."""

_DETAILS = ("command", "config", "targets")


class Job(Protocol):
    """What a worker must know to make one shard."""

    @property
    def store(self) -> Storage:
        """Where the shard goes."""
        ...

    @property
    def name(self) -> str:
        """Name of its file."""
        ...


J = TypeVar("J", bound=Job)


@dataclass(frozen=True, slots=True)
class ShardResult:
    """What became of one shard.

    Attributes:
        facts: of the shard, or None where there was nothing to write.
        problems: one line for each frame that had to be left out.
    """

    facts: ShardFacts | None
    problems: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class BuildPlan(Generic[J]):
    """An archive that is to be made.

    Attributes:
        recipe: how, as plain values: ``command``, what else names it, ``config`` and ``targets``.
        layout: of all its frames.
        jobs: its shards, in order.
        work: makes one; it writes the shard and the file beside it (:func:`write_beside`).
    """

    recipe: Mapping[str, Any]
    layout: Layout
    jobs: Sequence[J]
    work: Callable[[J], ShardResult]


def make_archive(
    task: BuildPlan[J], store: Storage, engine: Engine, progress: Callable[[ShardResult], None] | None = None
) -> Archive:
    """Return the archive of a task, made into ``store``; its bytes do not depend on the engine.

    Shards of an earlier run of the same task that was stopped are kept where they are whole.

    Args:
        task: what is made.
        store: where it goes.
        engine: makes the shards.
        progress: is told of each shard that is there, with the problems that it had when it was made.

    Raises:
        ValueError: the place holds something else.
        OSError: a shard could not be made or written; those that are finished stay.
    """
    manifest = _claimed(task, store)
    store.clear_drafts()
    there: dict[str, ShardResult] = {}
    for name, made in _standing(manifest, store, task.jobs):
        there[name] = made
        _tell(progress, made)
    for made in _made(task, [job for job in task.jobs if job.name not in there], engine):
        there |= {} if made.facts is None else {made.facts.name: made}
        _tell(progress, made)
    _write_problems(store, {job.name: there[job.name].problems for job in task.jobs if job.name in there})
    shards = tuple(facts for job in task.jobs if job.name in there and (facts := there[job.name].facts) is not None)
    finished = replace(manifest, shards=shards, complete=True)
    finished.write(store)
    _tidy(store)
    return Archive(store, finished)


def write_beside(store: Storage, facts: ShardFacts, problems: Sequence[str] = ()) -> ShardFacts:
    """Return the facts of a shard, which are written into a file beside it, with the problems that it had.

    Raises:
        OSError: it cannot be written.
    """
    store.write(facts.name + SIDECAR, json.dumps(facts.to_json() | {"problems": list(problems)}).encode())
    return facts


def _write_problems(store: Storage, problems: Mapping[str, Sequence[str]]) -> None:
    """Write the lines of an archive that has any; remove those of an earlier run where it has none."""
    lines = {name: list(told) for name, told in problems.items() if told}
    if lines:
        store.write(PROBLEMS, json.dumps(lines, indent=1, ensure_ascii=False).encode())
    elif PROBLEMS in store.names():
        store.delete(PROBLEMS)


def _read_problems(store: Storage) -> dict[str, tuple[str, ...]]:
    """Return the lines of :func:`_write_problems`; none where they are missing or damaged."""
    with contextlib.suppress(FileNotFoundError, ValueError, AttributeError, TypeError):
        table = json.loads(store.read(PROBLEMS))
        return {str(name): tuple(map(str, lines)) for name, lines in table.items()}
    return {}


def _claimed(task: BuildPlan[J], store: Storage) -> Manifest:
    """Return the manifest so far, written now if there was none; refuse a place that holds anything else."""
    wanted = Manifest(task.recipe, task.layout, complete=False)
    names = store.names()
    if MANIFEST not in names:
        if names:
            raise ValueError(f"{store.place} must be empty or hold this data set, got {names[0]}; choose another place")
        wanted.write(store)
        return wanted
    found = Manifest.read(store)
    _check_same(found, wanted, store.place)
    commits = code_version(found.code.get("commits", ()))
    claimed = replace(found, code=commits)
    if claimed != found:
        claimed.write(store)
    return claimed


def _check_same(found: Manifest, wanted: Manifest, place: str) -> None:
    ours, theirs = wanted.recipe, found.recipe
    if theirs.get("command") != ours["command"]:
        raise ValueError(f"{place} must be empty or hold this data set, got another archive; choose another place")
    names = [key for key in ours if key not in _DETAILS]
    for key in names:
        if theirs.get(key) != ours[key]:
            raise ValueError(f"{place} holds {key} {theirs.get(key)}, not {ours[key]}; choose another place")
    if theirs != ours or found.layout != wanted.layout:
        before, now = theirs.get("config", {}), ours["config"]
        other = [key for key in now if before.get(key) != now[key]]
        differs = ", ".join(other) or "targets"
        raise ValueError(f"{place} holds {ours[names[0]]} with other {differs}; choose another place")
    if found.code.get("version") != wanted.code["version"]:
        raise ValueError(
            f"{place} was begun with viewshed {found.code.get('version')}, this is {wanted.code['version']}; "
            "finish it with that version or choose another place"
        )


def _standing(manifest: Manifest, store: Storage, jobs: Sequence[J]) -> Iterator[tuple[str, ShardResult]]:
    """Yield the shards that are there and whole by name, by the manifest or by the file beside them."""
    problems = _read_problems(store) if manifest.shards else {}
    told = {shard.name: ShardResult(shard, problems.get(shard.name, ())) for shard in manifest.shards}
    names = set(store.names()) if jobs else set()
    for job in jobs:
        made = told.get(job.name) or _beside(job, names)
        facts = None if made is None else made.facts
        if (
            made is not None
            and facts is not None
            and facts.name == job.name
            and damage_of(job.store, facts, manifest.layout) is None
        ):
            yield job.name, made


def _beside(job: J, names: set[str]) -> ShardResult | None:
    if not {job.name, job.name + SIDECAR} <= names:
        return None
    with contextlib.suppress(ValueError, KeyError, AttributeError, TypeError):
        table = json.loads(job.store.read(job.name + SIDECAR))
        problems = tuple(map(str, table.pop("problems")))
        return ShardResult(ShardFacts.from_json(table), problems)
    return None


def _made(task: BuildPlan[J], jobs: Sequence[J], engine: Engine) -> Iterator[ShardResult]:
    """Yield what became of the shards as they are finished.

    Raises:
        OSError: one failed; the message is its own.
    """
    with contextlib.closing(engine.run(task.work, jobs)) as run:
        for done in run:
            if done.result is None:
                raise OSError(f"{done.error}; finished shards are kept, the same command goes on from here")
            yield done.result


def _tidy(store: Storage) -> None:
    store.delete(*(name for name in store.names() if name.endswith(f".parquet{SIDECAR}")))


def _tell(progress: Callable[[ShardResult], None] | None, made: ShardResult) -> None:
    if progress is not None:
        progress(made)


FRAMES_PER_SHARD = 48


class ArchiveWriter:
    """Writes samples into a new archive, shard by shard; :meth:`close` writes the manifest.

    Samples of one scene should follow each other: a shard holds one scene. Nothing can be read before ``close``.

    Args:
        place: a folder or a URI that is empty.
        recipe: how the samples were made, as plain values, for the manifest.
        frames_per_shard: at most.

    Raises:
        ValueError: the place is not empty, or ``frames_per_shard`` is below 1.
    """

    def __init__(
        self, place: str | os.PathLike[str], recipe: Mapping[str, Any], frames_per_shard: int = FRAMES_PER_SHARD
    ) -> None:
        if frames_per_shard < 1:
            raise ValueError(f"frames_per_shard must be at least 1, got {frames_per_shard}")
        self._store = Storage.of(place)
        if self._store.names():
            raise ValueError(f"{self._store.place} must be empty; choose another place")
        self._recipe = dict(recipe)
        self._frames_per_shard = frames_per_shard
        self._pending: list[Sample] = []
        self._shards: list[ShardFacts] = []
        self._layout: Layout | None = None

    def add(self, sample: Sample) -> None:
        """Take one sample; a full shard is written.

        Raises:
            ValueError: its scene is empty or its truth differs in grid, targets or definitions from those before.
            OSError: the shard cannot be written.
        """
        layout = Layout.of(sample.truth)
        self._layout = self._layout or layout
        if layout != self._layout:
            raise ValueError(f"truth must have the layout of the archive, {self._layout}, got {layout}")
        last = self._pending[-1] if self._pending else sample
        if (sample.scene, sample.split) != (last.scene, last.split) or len(self._pending) >= self._frames_per_shard:
            self._flush()
        self._pending.append(sample)

    def close(self) -> Archive:
        """Write what is left and the manifest, and return the archive.

        Raises:
            ValueError: there was no sample.
            OSError: a file cannot be written.
        """
        self._flush()
        if self._layout is None:
            raise ValueError("an archive must have at least one sample, got none")
        manifest = Manifest(self._recipe, self._layout, tuple(self._shards))
        manifest.write(self._store)
        return Archive(self._store, manifest)

    def _flush(self) -> None:
        if self._pending:
            name = f"shard-{len(self._shards):05d}.parquet"
            self._shards.append(write_shard(self._store, name, self._pending))
            self._pending = []


def write_archive(place: str | os.PathLike[str], samples: Iterable[Sample], recipe: Mapping[str, Any]) -> Archive:
    """Return the archive that ``samples`` were written to; see :class:`ArchiveWriter`.

    Raises:
        ValueError: the place is not empty, there are no samples, or they differ in grid, targets or definitions.
        OSError: a file cannot be written.
    """
    writer = ArchiveWriter(place, recipe)
    for sample in samples:
        writer.add(sample)
    return writer.close()
