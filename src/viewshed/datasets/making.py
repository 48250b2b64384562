"""Archives that are made shard by shard by an engine: what is there already is kept, the rest is made."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from viewshed.datasets.archive import Archive, damage_of
from viewshed.datasets.layout import Layout
from viewshed.datasets.manifest import MANIFEST, Manifest, code_version
from viewshed.datasets.shard import ShardFacts
from viewshed.datasets.store import Store
from viewshed.engines import Engine

SIDECAR = ".json"
"""Ending of the file beside a finished shard that tells its checksum, until the manifest does."""
PROBLEMS = "problems.json"
"""What had to be left out of a finished archive, by shard; a file of its own, for its lines may name places."""
_DETAILS = ("command", "config", "targets")


class Job(Protocol):
    """What a worker must know to make one shard."""

    @property
    def store(self) -> Store:
        """Where the shard goes."""
        ...

    @property
    def name(self) -> str:
        """Name of its file."""
        ...


J = TypeVar("J", bound=Job)


@dataclass(frozen=True, slots=True)
class Made:
    """What became of one shard.

    Attributes:
        facts: of the shard, or None where there was nothing to write.
        problems: one line for each frame that had to be left out.
    """

    facts: ShardFacts | None
    problems: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Task(Generic[J]):
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
    work: Callable[[J], Made]


def make_archive(
    task: Task[J], store: Store, engine: Engine, progress: Callable[[Made], None] | None = None
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
    there: dict[str, Made] = {}
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


def write_beside(store: Store, facts: ShardFacts, problems: Sequence[str] = ()) -> ShardFacts:
    """Return the facts of a shard, which are written into a file beside it, with the problems that it had.

    Raises:
        OSError: it cannot be written.
    """
    store.write(facts.name + SIDECAR, json.dumps(facts.to_json() | {"problems": list(problems)}).encode())
    return facts


def _write_problems(store: Store, problems: Mapping[str, Sequence[str]]) -> None:
    """Write the lines of an archive that has any; remove those of an earlier run where it has none."""
    lines = {name: list(told) for name, told in problems.items() if told}
    if lines:
        store.write(PROBLEMS, json.dumps(lines, indent=1, ensure_ascii=False).encode())
    elif PROBLEMS in store.names():
        store.delete(PROBLEMS)


def _read_problems(store: Store) -> dict[str, tuple[str, ...]]:
    """Return the lines of :func:`_write_problems`; none where they are missing or damaged."""
    with contextlib.suppress(FileNotFoundError, ValueError, AttributeError, TypeError):
        table = json.loads(store.read(PROBLEMS))
        return {str(name): tuple(map(str, lines)) for name, lines in table.items()}
    return {}


def _claimed(task: Task[J], store: Store) -> Manifest:
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


def _standing(manifest: Manifest, store: Store, jobs: Sequence[J]) -> Iterator[tuple[str, Made]]:
    """Yield the shards that are there and whole by name, by the manifest or by the file beside them."""
    problems = _read_problems(store) if manifest.shards else {}
    told = {shard.name: Made(shard, problems.get(shard.name, ())) for shard in manifest.shards}
    names = set(store.names()) if jobs else set()
    for job in jobs:
        made = told.get(job.name) or _beside(job, names)
        facts = None if made is None else made.facts
        if made is not None and facts is not None and facts.name == job.name and damage_of(job.store, facts) is None:
            yield job.name, made


def _beside(job: J, names: set[str]) -> Made | None:
    if not {job.name, job.name + SIDECAR} <= names:
        return None
    with contextlib.suppress(ValueError, KeyError, AttributeError, TypeError):
        table = json.loads(job.store.read(job.name + SIDECAR))
        problems = tuple(map(str, table.pop("problems")))
        return Made(ShardFacts.from_json(table), problems)
    return None


def _made(task: Task[J], jobs: Sequence[J], engine: Engine) -> Iterator[Made]:
    """Yield what became of the shards as they are finished.

    Raises:
        OSError: one failed; the message is its own.
    """
    with contextlib.closing(engine.run(task.work, jobs)) as run:
        for done in run:
            if done.result is None:
                raise OSError(f"{done.error}; finished shards are kept, the same command goes on from here")
            yield done.result


def _tidy(store: Store) -> None:
    store.delete(*(name for name in store.names() if name.endswith(f".parquet{SIDECAR}")))


def _tell(progress: Callable[[Made], None] | None, made: Made) -> None:
    if progress is not None:
        progress(made)
