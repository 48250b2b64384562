"""Building archives: shard by shard by an engine, resuming where an earlier run stopped; or sample by sample.

:func:`build_archive` is for data sets that can be planned: every shard is a job, the jobs run anywhere in any order,
and the bytes are the same. While it runs, the manifest says ``"complete": false`` and each finished shard has a file
beside it with its line of the manifest, so that a run that was stopped goes on where it was. :class:`ArchiveWriter` is
for samples of any origin.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, Generic, Protocol, TypeVar

from viewshed._jobs import Engine
from viewshed.datasets.archive.archive import Archive
from viewshed.datasets.archive.schema import MANIFEST, Layout, Manifest, ShardFacts, code_version
from viewshed.datasets.archive.shard import damage_of, write_shard
from viewshed.datasets.archive.storage import Storage
from viewshed.datasets.sample import Sample

FRAMES_PER_SHARD = 48
"""Frames of a shard, at most: a shard of points then has some 25 MB."""

SIDECAR = ".json"
"""Ending of the file beside a finished shard that holds its line, until the manifest does."""

PROBLEMS = "problems.json"
"""What had to be left out of a finished archive, by shard; a file of its own, for its lines may name places."""

_DETAILS = ("command", "config", "targets")


class ShardJob(Protocol):
    """What a worker must know to build one shard."""

    @property
    def store(self) -> Storage:
        """Where the shard goes."""
        ...

    @property
    def name(self) -> str:
        """Name of its file."""
        ...


J = TypeVar("J", bound=ShardJob)


@dataclass(frozen=True, slots=True)
class ShardResult:
    """What became of one shard.

    Attributes:
        facts: of the shard, or None where there was nothing to write.
        problems: one line for each frame that had to be left out.
    """

    facts: ShardFacts | None
    problems: tuple[str, ...] = ()

    @property
    def frames(self) -> int:
        """Number of frames that were written."""
        return 0 if self.facts is None else self.facts.frames


@dataclass(frozen=True, slots=True)
class BuildPlan(Generic[J]):
    """An archive that is to be built.

    Attributes:
        recipe: how, as plain values: ``command``, what else names it, ``config`` and ``targets``.
        layout: of all its frames.
        jobs: its shards, in order.
        work: builds one, by :func:`build_shard`.
    """

    recipe: Mapping[str, Any]
    layout: Layout
    jobs: Sequence[J]
    work: Callable[[J], ShardResult]


def build_archive(
    plan: BuildPlan[J], store: Storage, engine: Engine, on_progress: Callable[[ShardResult], None] | None = None
) -> Archive:
    """Return the archive of a plan, built into ``store``; its bytes do not depend on the engine.

    Args:
        plan: what is built.
        store: where it goes.
        engine: builds the shards.
        on_progress: is called with each finished shard, also of an earlier run, with the problems that it had.

    Raises:
        ValueError: the place holds something else.
        OSError: a shard could not be built or written; those that are finished stay.
    """
    # 1. Claim the place: an empty one, or one that an earlier run of the same plan began.
    manifest = _claim(plan, store)
    store.clear_drafts()
    # 2. Keep the shards that are there and whole; build the others.
    results: dict[str, ShardResult] = {}
    for name, result in chain(_find_finished(manifest, store, plan.jobs), _build_missing(plan, results, engine)):
        results[name] = result
        if on_progress is not None:
            on_progress(result)
    # 3. The manifest last: only now is it an archive. A shard without frames is none, and is tried again by every run.
    written = {job.name: results[job.name] for job in plan.jobs if results[job.name].facts is not None}
    _write_problems(store, {name: result.problems for name, result in written.items()})
    shards = tuple(result.facts for result in written.values() if result.facts is not None)
    complete = replace(manifest, shards=shards, complete=True)
    complete.write(store)
    store.delete(*(name for name in store.names() if name.endswith(f".parquet{SIDECAR}")))
    return Archive(store, complete)


def build_shard(
    store: Storage, name: str, samples: Iterable[Sample], problems: Callable[[], tuple[str, ...]] = tuple
) -> ShardResult:
    """Return what became of a shard of one scene: it is written, and its line in a file beside it.

    No samples are a shard that is left out. ``problems`` is called when the samples have been read: one line for each
    that had to be left out.
    """
    iterator = iter(samples)
    first = next(iterator, None)
    if first is None:
        return ShardResult(None, problems())
    facts = write_shard(store, name, chain([first], iterator))
    result = ShardResult(facts, problems())
    store.write(name + SIDECAR, json.dumps(facts.to_json() | {"problems": list(result.problems)}).encode())
    return result


def _claim(plan: BuildPlan[J], store: Storage) -> Manifest:
    """Return the manifest so far, written now if there was none; refuse a place that holds anything else."""
    wanted = Manifest(plan.recipe, plan.layout, complete=False)
    names = store.names()
    if MANIFEST not in names:
        if names:
            raise ValueError(f"{store.place} must be empty or hold this data set, got {names[0]}; choose another place")
        wanted.write(store)
        return wanted
    begun = Manifest.read(store)
    _check_same(begun, wanted, store.place)
    claimed = replace(begun, code=code_version(begun.code.get("commits", ())))
    if claimed != begun:
        claimed.write(store)
    return claimed


def _check_same(begun: Manifest, wanted: Manifest, place: str) -> None:
    """Check that a place was begun with the same recipe, layout and version; say what differs."""
    ours, theirs = wanted.recipe, begun.recipe
    if theirs.get("command") != ours["command"]:
        raise ValueError(f"{place} must be empty or hold this data set, got another archive; choose another place")
    names = [key for key in ours if key not in _DETAILS]
    for key in names:
        if theirs.get(key) != ours[key]:
            raise ValueError(f"{place} holds {key} {theirs.get(key)}, not {ours[key]}; choose another place")
    if theirs != ours or begun.layout != wanted.layout:
        before, now = theirs.get("config", {}), ours["config"]
        other = [key for key in now if before.get(key) != now[key]]
        differs = ", ".join(other) or "targets"
        raise ValueError(f"{place} holds {ours[names[0]]} with other {differs}; choose another place")
    if begun.code.get("version") != wanted.code["version"]:
        raise ValueError(
            f"{place} was begun with viewshed {begun.code.get('version')}, this is {wanted.code['version']}; "
            "finish it with that version or choose another place"
        )


def _find_finished(manifest: Manifest, store: Storage, jobs: Sequence[J]) -> Iterator[tuple[str, ShardResult]]:
    """Yield the shards that are there and whole by name, by the manifest or by the file beside them."""
    problems = _read_problems(store) if manifest.shards else {}
    listed = {shard.name: ShardResult(shard, problems.get(shard.name, ())) for shard in manifest.shards}
    names = set(store.names()) if jobs else set()
    for job in jobs:
        result = listed.get(job.name) or _read_sidecar(job, names)
        facts = None if result is None else result.facts
        if result is None or facts is None or facts.name != job.name:
            continue
        if damage_of(job.store, facts, manifest.layout) is None:
            yield job.name, result


def _read_sidecar(job: J, names: set[str]) -> ShardResult | None:
    """Return what the file beside a shard says; None where one of the two is missing or the file is damaged."""
    if not {job.name, job.name + SIDECAR} <= names:
        return None
    with contextlib.suppress(ValueError, KeyError, AttributeError, TypeError):
        table = json.loads(job.store.read(job.name + SIDECAR))
        problems = tuple(map(str, table.pop("problems")))
        return ShardResult(ShardFacts.from_json(table), problems)
    return None


def _build_missing(
    plan: BuildPlan[J], finished: Mapping[str, ShardResult], engine: Engine
) -> Iterator[tuple[str, ShardResult]]:
    """Yield the shards that are not finished when this begins, by name, as they are built; errors are their own."""
    jobs = [job for job in plan.jobs if job.name not in finished]
    with contextlib.closing(engine.run(plan.work, jobs)) as run:
        for done in run:
            if done.result is None:
                raise OSError(f"{done.error}; finished shards are kept, the same command goes on from here")
            yield jobs[done.index].name, done.result


def _write_problems(store: Storage, problems: Mapping[str, Sequence[str]]) -> None:
    """Write the lines of an archive that has any; remove those of an earlier run where it has none."""
    by_shard = {name: list(lines) for name, lines in problems.items() if lines}
    if by_shard:
        store.write(PROBLEMS, json.dumps(by_shard, indent=1, ensure_ascii=False).encode())
    elif PROBLEMS in store.names():
        store.delete(PROBLEMS)


def _read_problems(store: Storage) -> dict[str, tuple[str, ...]]:
    """Return the lines of :func:`_write_problems`; none where they are missing or damaged."""
    with contextlib.suppress(FileNotFoundError, ValueError, AttributeError, TypeError):
        table = json.loads(store.read(PROBLEMS))
        return {str(name): tuple(map(str, lines)) for name, lines in table.items()}
    return {}


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
