"""Build archives: shard by shard with an engine, resuming an interrupted run; or sample by sample.

:func:`build_archive` is for data sets that can be planned: every shard is a job; the jobs run anywhere in any order and
give the same bytes. During a run the manifest has ``"complete": false`` and lists the finished shards, so that an
interrupted run resumes. :func:`write_archive` is for samples of any origin.
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
"""Largest number of frames of a shard: a shard of points then has about 25 MB."""

PROBLEMS = "problems.json"
"""File of the samples that were left out, by shard; not in the manifest, because its lines may name locations."""

_DETAILS = ("command", "config", "targets")
_SAVE_EVERY_S = 1.0
_SAVE_SHARE = 0.05  # largest share of the time for saving: a manifest of many shards is long


@dataclass(frozen=True, slots=True)
class ShardJob:
    """Input of a worker to build one shard."""

    name: str  # of the file
    # yields the samples, all of one scene, and appends one line to the given list for each sample that is left out;
    # must be picklable: a ``functools.partial`` of a module's function
    samples: Callable[[list[str]], Iterator[Sample]]


@dataclass(frozen=True, slots=True)
class ShardResult:
    """A finished job: facts of the shard, or None if it had no samples, and one line for each sample left out."""

    facts: ShardFacts | None
    problems: tuple[str, ...] = ()

    @property
    def frames(self) -> int:
        """Number of written frames."""
        return 0 if self.facts is None else self.facts.frames


def build_archive(
    recipe: Mapping[str, Any],
    layout: Layout,
    jobs: Sequence[ShardJob],
    store: Storage,
    engine: Engine,
    on_progress: Callable[[ShardResult], None] | None = None,
) -> Archive:
    """Build shards into ``store`` and return the archive; its bytes do not depend on the engine.

    Args:
        recipe: how it is made, as plain values: ``command``, further names, ``config`` and ``targets``.
        layout: of all frames.
        jobs: the shards, in order.
        store: destination.
        engine: runs the jobs.
        on_progress: called with each finished shard, including those of an earlier run.

    Raises:
        ValueError: the destination holds something else.
        OSError: a shard could not be built or written; finished shards are kept.
    """
    # 1. Claim the destination: empty, or begun by an earlier run of the same recipe.
    manifest = _claim(Manifest(recipe, layout, complete=False), store)
    store.clear_drafts()
    # 2. Keep intact shards of an earlier run.
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
    # 3. Build the other shards, and save the manifest from time to time.
    next_s, missing = 0.0, [job for job in jobs if job.name not in results]
    try:
        with contextlib.closing(engine.run(partial(_build_shard, store), missing)) as run:
            for done in run:
                if done.result is None:
                    raise OSError(f"{done.error}; finished shards are kept; the same command resumes")
                note(missing[done.index].name, done.result)
                if (start_s := time.monotonic()) > next_s:
                    _save(manifest, results, jobs, store)
                    next_s = start_s + max(_SAVE_EVERY_S, (time.monotonic() - start_s) / _SAVE_SHARE)
    except BaseException:
        with contextlib.suppress(OSError):
            _save(manifest, results, jobs, store)
        raise
    # 4. Mark the archive as complete. Shards without frames are not listed, so every run tries them again.
    return Archive(store, _save(replace(manifest, complete=True), results, jobs, store, tidy=True))


def _build_shard(store: Storage, job: ShardJob) -> ShardResult:
    """Build one shard; without samples no file is written."""
    problems: list[str] = []
    samples = job.samples(problems)
    first = next(samples, None)
    facts = None if first is None else write_shard(store, job.name, chain([first], samples))
    return ShardResult(facts, tuple(problems))


def _claim(planned: Manifest, store: Storage) -> Manifest:
    """Return the manifest so far, or write ``planned``; raise a ValueError if the location holds anything else."""
    names = store.names()
    if MANIFEST not in names:
        if names:
            raise ValueError(f"{store.place} must be empty or hold this data set, got {names[0]}; choose another place")
        planned.write(store)
        return planned
    begun = Manifest.read(store)
    _check_same(begun, planned, store.place)
    claimed = replace(begun, code=code_version(begun.code.get("commits", ())))
    if claimed != begun:
        claimed.write(store)
    return replace(claimed, complete=False)


def _check_same(begun: Manifest, planned: Manifest, place: str) -> None:
    """Check that the manifest ``begun`` has the same recipe, layout and version; the message names the difference."""
    ours, theirs = planned.recipe, begun.recipe
    if theirs.get("command") != ours["command"]:
        raise ValueError(f"{place} must be empty or hold this data set, got another archive; choose another place")
    names = [key for key in ours if key not in _DETAILS]
    for key in names:
        if theirs.get(key) != ours[key]:
            raise ValueError(f"{place} holds {key} {theirs.get(key)}, not {ours[key]}; choose another place")
    if theirs != ours or begun.layout != planned.layout:
        before, now = theirs.get("config", {}), ours["config"]
        other = [key for key in now if before.get(key) != now[key]]
        differs = ", ".join(other) or "targets"
        raise ValueError(f"{place} holds {ours[names[0]]} with different {differs}; choose another place")
    if begun.code.get("version") != planned.code["version"]:
        raise ValueError(
            f"{place} was begun with viewshed {begun.code.get('version')}, this is {planned.code['version']}; "
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
    """Write the problems of the finished shards, then the manifest that lists the shards in order; return the manifest.

    ``tidy`` deletes an outdated problems file; it lists all files, so it is not done after each shard.
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
    """Return the problems that :func:`_save` wrote; none if the file is missing or damaged."""
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
    """Write samples to an archive, one after the other, and return it; samples of one scene must be consecutive.

    Args:
        place: an empty folder or URI.
        samples: of any origin.
        recipe: how they were made, as plain values, for the manifest.
        frames_per_shard: largest number of frames of a shard; a shard holds one scene.

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
