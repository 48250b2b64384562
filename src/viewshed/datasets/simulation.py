"""A simulated data set from start to end: what is there already is kept, the rest is made by an engine."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace

from viewshed.datasets.archive import Archive, damage_of
from viewshed.datasets.layout import Layout
from viewshed.datasets.manifest import MANIFEST, Manifest, code_version
from viewshed.datasets.presets import Preset
from viewshed.datasets.shard import ShardFacts
from viewshed.datasets.simulate import SIDECAR, ShardJob, jobs_of, simulate_shard
from viewshed.datasets.store import Store
from viewshed.engines import Engine
from viewshed.truth import OTHER_DEFINITIONS
from viewshed.visible import TARGETS


def simulate(
    preset: Preset, store: Store, engine: Engine, progress: Callable[[ShardFacts], None] | None = None
) -> Archive:
    """Return the archive of a preset, simulated into ``store``; its bytes do not depend on the engine.

    Shards of an earlier run of the same preset that was stopped are kept where they are whole.

    Args:
        preset: what is simulated.
        store: where it goes.
        engine: makes the shards.
        progress: is told of each shard that is there.

    Raises:
        ValueError: the place holds something else.
        OSError: a shard could not be made or written; those that are finished stay.
    """
    manifest = _claimed(preset, store)
    store.clear_drafts()
    jobs = jobs_of(preset, store)
    facts: dict[str, ShardFacts] = {}
    for shard in _standing(manifest, jobs):
        facts[shard.name] = shard
        _tell(progress, shard)
    for shard in _made([job for job in jobs if job.name not in facts], engine):
        facts[shard.name] = shard
        _tell(progress, shard)
    finished = replace(manifest, shards=tuple(facts[job.name] for job in jobs), complete=True)
    finished.write(store)
    _tidy(store)
    return Archive(store, finished)


def recipe_of(preset: Preset) -> dict[str, object]:
    """Return how a simulated data set was made, as plain values."""
    targets = {name: asdict(target) for name, target in TARGETS.items()}
    about = {"command": "simulate", "preset": preset.name, "seed": preset.seed}
    return about | {"config": preset.to_json(), "targets": targets}


def _claimed(preset: Preset, store: Store) -> Manifest:
    """Return the manifest so far, written now if there was none; refuse a place that holds anything else."""
    layout = Layout(preset.grid, tuple(sorted(TARGETS)), tuple(sorted(OTHER_DEFINITIONS)))
    wanted = Manifest(recipe_of(preset), layout, complete=False)
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
    for key in ("preset", "seed"):
        if theirs.get(key) != ours[key]:
            raise ValueError(f"{place} holds {key} {theirs.get(key)}, not {ours[key]}; choose another place")
    if theirs != ours or found.layout != wanted.layout:
        before, now = theirs.get("config", {}), ours["config"]
        other = [key for key in now if before.get(key) != now[key]]
        differs = ", ".join(other) or "targets"
        raise ValueError(f"{place} holds {ours['preset']} with other {differs}; choose another place")
    if found.code.get("version") != wanted.code["version"]:
        raise ValueError(
            f"{place} was begun with viewshed {found.code.get('version')}, this is {wanted.code['version']}; "
            "finish it with that version or choose another place"
        )


def _standing(manifest: Manifest, jobs: Sequence[ShardJob]) -> Iterator[ShardFacts]:
    """Yield the shards that are there and whole, by the manifest or by the file beside them."""
    told = {shard.name: shard for shard in manifest.shards}
    names = set(jobs[0].store.names())
    for job in jobs:
        facts = told.get(job.name) or _sidecar(job, names)
        if facts is not None and facts.name == job.name and damage_of(job.store, facts) is None:
            yield facts


def _sidecar(job: ShardJob, names: set[str]) -> ShardFacts | None:
    if not {job.name, job.name + SIDECAR} <= names:
        return None
    with contextlib.suppress(ValueError):
        return ShardFacts.from_json(json.loads(job.store.read(job.name + SIDECAR)))
    return None


def _made(jobs: Sequence[ShardJob], engine: Engine) -> Iterator[ShardFacts]:
    """Yield the shards as they are finished.

    Raises:
        OSError: one failed; the message is its own.
    """
    with contextlib.closing(engine.run(simulate_shard, jobs)) as run:
        for done in run:
            if done.result is None:
                raise OSError(f"{done.error}; finished shards are kept, the same command goes on from here")
            yield done.result


def _tidy(store: Store) -> None:
    store.delete(*(name for name in store.names() if name.endswith(f".parquet{SIDECAR}")))


def _tell(progress: Callable[[ShardFacts], None] | None, shard: ShardFacts) -> None:
    if progress is not None:
        progress(shard)
