"""Archives of the wild sets: a shard for each scene, made from the set's seeds anywhere and in any order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial

from viewshed.fov.visibility import TARGETS
from viewshed_lab import _config
from viewshed_lab._jobs import Engine
from viewshed_lab.data.archive.archive import Archive
from viewshed_lab.data.archive.build import ShardJob, ShardResult, build_archive
from viewshed_lab.data.archive.schema import Layout
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.sample import Sample
from viewshed_lab.data.wild import TOLD, WildScene, wild_scenes


def _samples(scene: WildScene, told: tuple[str, ...], _: list[str]) -> Iterator[Sample]:
    split = split_of_set(scene.domain.set_name)
    for sweep in range(scene.domain.sweeps):
        seen = scene.observe(sweep)
        given = seen.told(told[(scene.number + sweep) % len(told)])
        yield Sample(given, seen.truth, seen.known, scene.name, split)


def split_of_set(set_name: str) -> str:
    """Return the split of a set's samples: ``train`` for the training set, as in every archive, else its own name."""
    return "train" if set_name == "training" else set_name


def make_wild_archive(
    set_name: str,
    domain: str,
    store: Storage,
    engine: Engine,
    *,
    told: tuple[str, ...] = ("rings", "nothing"),
    scenes: int | None = None,
    on_progress: Callable[[ShardResult], None] | None = None,
) -> Archive:
    """Return the archive of one domain of a set, made into ``store``; its bytes do not depend on the engine.

    Shards of an earlier run of the same set that was stopped are kept where they are whole. The sealed set has no
    archive: it is run by its study alone.

    Args:
        set_name: of ``datasets.wild.SETS`` but ``sealed``.
        domain: ``road`` or ``indoor``.
        store: where it goes.
        engine: makes the shards.
        told: of ``TOLD``: what the sweeps say beside their points, in turn.
        scenes: at most this number of scenes, the first ones.
        on_progress: is called with each shard that is finished, also of an earlier run.

    Raises:
        ValueError: a name is unknown, the set is sealed or has no such domain, or the place holds something else.
        OSError: a shard could not be made or written; those that are finished stay.
    """
    if not told or not set(told) <= set(TOLD):
        raise ValueError(f"told must be one or more of {', '.join(TOLD)}, got {', '.join(told) or 'none'}")
    chosen = wild_scenes(set_name, domain)[:scenes]
    if not chosen:
        raise ValueError(f"{set_name} must have a domain {domain!r}, got none; choose road or indoor")
    one = chosen[0].domain
    about = {"command": "dataset wild", "set": set_name, "domain": domain, "seed": one.seed}
    config = _config.to_dict(one) | {"told": list(told), "scenes": len(chosen)}
    recipe = about | {"config": config, "targets": {name: asdict(target) for name, target in TARGETS.items()}}
    jobs = [ShardJob(f"{scene.name}.parquet", partial(_samples, scene, told)) for scene in chosen]
    layout = Layout(one.grid, tuple(sorted(TARGETS)), ())
    return build_archive(recipe, layout, jobs, store, engine, on_progress)
