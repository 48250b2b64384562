"""Building archives: shard by shard by an engine, resuming where an earlier run stopped; or sample by sample.

:func:`build_archive` is for data sets that can be planned: every shard is a job, the jobs run anywhere in any order,
and the bytes are the same. While it runs, the manifest says ``"complete": false`` and lists what is finished, so that a
run that was stopped goes on where it was. :func:`write_archive` is for samples of any origin.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, groupby, islice
from typing import Any

from viewshed_lab._jobs import Engine
from viewshed_lab.data.archive.archive import Archive
from viewshed_lab.data.archive.schema import MANIFEST, Layout, Manifest, ShardFacts, code_version
from viewshed_lab.data.archive.shard import damage_of, write_shard
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.sample import Sample

FRAMES_PER_SHARD = 48
"""Frames of a shard, at most: a shard of points then has some 25 MB."""

PROBLEMS = "problems.json"
"""What had to be left out of an archive, by shard; a file of its own, for its lines may name places."""

_DETAILS = ("command", "config", "targets")
_SAVE_EVERY_S = 1.0
_SAVE_SHARE = 0.05  # of the time, at most: a manifest of many shards is long


@dataclass(frozen=True, slots=True)
class ShardJob:
    """What a worker must know to build one shard."""

    name: str  # of its file
    # yields its samples, all of one scene, and adds to the list that it is given one line for each sample that had to
    # be left out; a function of a module with its arguments (``functools.partial``)
    samples: Callable[[list[str]], Iterator[Sample]]


@dataclass(frozen=True, slots=True)
class ShardResult:
    """One built shard: its facts, or None where there was nothing to write, and one line for each sample left out."""

    facts: ShardFacts | None
    problems: tuple[str, ...] = ()

    @property
    def frames(self) -> int:
        """Number of frames that were written."""
        return 0 if self.facts is None else self.facts.frames


def build_archive(
    recipe: Mapping[str, Any],
    layout: Layout,
    jobs: Sequence[ShardJob],
    store: Storage,
    engine: Engine,
    on_progress: Callable[[ShardResult], None] | None = None,
) -> Archive:
    """Return the archive of some shards, built into ``store``; its bytes do not depend on the engine.

    Args:
        recipe: how it is made, as plain values: ``command``, what else names it, ``config`` and ``targets``.
        layout: of all its frames.
        jobs: its shards, in order.
        store: where it goes.
        engine: builds the shards.
        on_progress: is called with each finished shard, also of an earlier run, with the problems that it had.

    Raises:
        ValueError: the place holds something else.
        OSError: a shard could not be built or written; those that are finished stay.
    """
    # 1. Claim the place: an empty one, or one that an earlier run of the same recipe began.
    manifest = _claim(Manifest(recipe, layout, complete=False), store)
    store.clear_drafts()
    # 2. Keep the shards that are there and whole.
    results: dict[str, ShardResult] = {}

    def note(name: str, result: ShardResult) -> None:
        results[name] = result
        if on_progress is not None:
            on_progress(result)

    listed = {shard.name: shard for shard in manifest.shards}
    left_out = _read_problems(store) if listed else {}
    for name in (job.name for job in jobs if job.name in listed):
        if damage_of(store, listed[name], manifest.layout) is None:
            note(name, ShardResult(listed[name], left_out.get(name, ())))
    if len(results) < len(manifest.shards):
        _save(manifest, results, jobs, store, tidy=True)
    # 3. Build the others, and save now and then what is there.
    next_s, missing = 0.0, [job for job in jobs if job.name not in results]
    try:
        with contextlib.closing(engine.run(partial(_build_shard, store), missing)) as run:
            for done in run:
                if done.result is None:
                    raise OSError(f"{done.error}; finished shards are kept, the same command goes on from here")
                note(missing[done.index].name, done.result)
                if (start_s := time.monotonic()) > next_s:
                    _save(manifest, results, jobs, store)
                    next_s = start_s + max(_SAVE_EVERY_S, (time.monotonic() - start_s) / _SAVE_SHARE)
    except BaseException:
        with contextlib.suppress(OSError):
            _save(manifest, results, jobs, store)
        raise
    # 4. Only now is it an archive. A shard without frames is none, and is tried again by every run.
    return Archive(store, _save(replace(manifest, complete=True), results, jobs, store, tidy=True))


def _build_shard(store: Storage, job: ShardJob) -> ShardResult:
    """Return what became of a shard; without samples, it is left out."""
    problems: list[str] = []
    samples = job.samples(problems)
    first = next(samples, None)
    facts = None if first is None else write_shard(store, job.name, chain([first], samples))
    return ShardResult(facts, tuple(problems))


def _claim(wanted: Manifest, store: Storage) -> Manifest:
    """Return the manifest so far, written now if there was none; refuse a place that holds anything else."""
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
    return replace(claimed, complete=False)


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


def _save(
    manifest: Manifest,
    results: Mapping[str, ShardResult],
    jobs: Sequence[ShardJob],
    store: Storage,
    *,
    tidy: bool = False,
) -> Manifest:
    """Write what was left out of the finished shards, then the manifest that lists them in order; return that.

    ``tidy`` removes the lines of an earlier run where there are none now; it lists all files, so not after each shard.
    """
    written = {job.name: results[job.name] for job in jobs if job.name in results and results[job.name].facts}
    problems = {name: list(result.problems) for name, result in written.items() if result.problems}
    if problems:
        store.write(PROBLEMS, json.dumps(problems, indent=1, ensure_ascii=False).encode())
    elif tidy and PROBLEMS in store.names():
        store.delete(PROBLEMS)
    saved = replace(manifest, shards=tuple(result.facts for result in written.values() if result.facts))
    saved.write(store)
    return saved


def _read_problems(store: Storage) -> dict[str, tuple[str, ...]]:
    """Return the lines of :func:`_save`; none where they are missing or damaged."""
    with contextlib.suppress(FileNotFoundError, ValueError, AttributeError, TypeError):
        table = json.loads(store.read(PROBLEMS))
        return {str(name): tuple(map(str, lines)) for name, lines in table.items()}
    return {}


def write_archive(
    place: str | os.PathLike[str],
    samples: Iterable[Sample],
    recipe: Mapping[str, Any],
    frames_per_shard: int = FRAMES_PER_SHARD,
) -> Archive:
    """Return the archive that ``samples`` were written to, one after the other; those of one scene follow each other.

    Args:
        place: a folder or a URI that is empty.
        samples: of any origin.
        recipe: how they were made, as plain values, for the manifest.
        frames_per_shard: at most; a shard holds one scene.

    Raises:
        ValueError: the place is not empty, there are no samples, they differ in grid, targets or definitions, or a
            scene is in two splits.
        OSError: a file cannot be written.
    """
    if frames_per_shard < 1:
        raise ValueError(f"frames_per_shard must be at least 1, got {frames_per_shard}")
    store, shards, layout = Storage.of(place), list[ShardFacts](), None
    if store.names():
        raise ValueError(f"{store.place} must be empty; choose another place")
    splits: dict[str, str] = {}
    for _, same_scene in groupby(samples, lambda sample: (sample.split, sample.scene)):
        scene = iter(same_scene)
        for first in scene:
            layout = layout or Layout.of(first.truth)
            if Layout.of(first.truth) != layout:
                raise ValueError(f"truth must have the layout of the archive, {layout}, got {Layout.of(first.truth)}")
            if splits.setdefault(first.scene, first.split) != first.split:
                both = f"{splits[first.scene]!r} and {first.split!r}"
                raise ValueError(f"a scene must be in one split, got {first.scene!r} in {both}")
            frames = chain([first], islice(scene, frames_per_shard - 1))
            shards.append(write_shard(store, f"shard-{len(shards):05d}.parquet", frames))
    if layout is None:
        raise ValueError("an archive must have at least one sample, got none")
    manifest = Manifest(dict(recipe), layout, tuple(shards))
    manifest.write(store)
    return Archive(store, manifest)
