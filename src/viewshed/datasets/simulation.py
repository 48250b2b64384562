"""A simulated data set from start to end: what is there already is kept, the rest is made by an engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

from viewshed.datasets.archive import Archive
from viewshed.datasets.layout import Layout
from viewshed.datasets.making import Made, Task, make_archive
from viewshed.datasets.presets import Preset
from viewshed.datasets.shard import ShardFacts
from viewshed.datasets.simulate import ShardJob, jobs_of, simulate_shard
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
    layout = Layout(preset.grid, tuple(sorted(TARGETS)), tuple(sorted(OTHER_DEFINITIONS)))
    task = Task(recipe_of(preset), layout, jobs_of(preset, store), _made)
    return make_archive(task, store, engine, None if progress is None else lambda made: _tell(progress, made))


def recipe_of(preset: Preset) -> dict[str, object]:
    """Return how a simulated data set was made, as plain values."""
    targets = {name: asdict(target) for name, target in TARGETS.items()}
    about = {"command": "simulate", "preset": preset.name, "seed": preset.seed}
    return about | {"config": preset.to_json(), "targets": targets}


def _made(job: ShardJob) -> Made:
    return Made(simulate_shard(job))


def _tell(progress: Callable[[ShardFacts], None], made: Made) -> None:
    if made.facts is not None:
        progress(made.facts)
