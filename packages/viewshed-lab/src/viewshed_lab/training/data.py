"""From a config to data: archives are opened or simulated, and their scenes split into training and validation."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from viewshed_lab._jobs import LocalEngine, cores
from viewshed_lab.data.archive.archive import Archive
from viewshed_lab.data.archive.schema import MANIFEST
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.presets import Preset, preset_named
from viewshed_lab.data.simulated import recipe_of, simulate
from viewshed_lab.training.config import TrainConfig
from viewshed_lab.training.samples import (
    VALIDATION_EPOCH,
    ArchivedSamples,
    PaperLabels,
    TrainingFrames,
    check_archives,
    sample_cache_of,
)

OnProgress = Callable[[str, int, int], None]
"""Called with what is being prepared, how many frames are done and how many there are in all."""

_VALIDATION = 0x76616C
_WORTH_PROCESSES = 100


@dataclass(frozen=True, slots=True)
class Fold:
    """One of the folds of cross-validation: its number, and how many there are."""

    number: int
    count: int

    def __post_init__(self) -> None:
        if not (self.count >= 2 and 0 <= self.number < self.count):
            raise ValueError(f"fold must be one of at least 2, got {self.number} of {self.count}")


@dataclass(frozen=True, slots=True, eq=False)
class TrainingData:
    """What a training reads; no scene is in both."""

    train: TrainingFrames  # what the weights are fitted to
    validation: TrainingFrames  # what decides when to stop and which epoch is best


def check_data(config: TrainConfig) -> None:
    """Check that the archives of a config exist and have what it wants; presets have been checked by the config."""
    if not config.simulated:
        check_archives(config, [_open_archive(place) for place in config.data])


def check_folds(config: TrainConfig, count: int) -> None:
    """Check that a config's data have scenes enough for ``count`` folds."""
    for place in config.data:
        if config.simulated:
            preset = preset_named(place)
            scenes = preset.scenes[preset.splits.index(config.train_split)]
        else:
            scenes = len(_open_archive(place).split(config.train_split).scenes)
        if scenes < count:
            raise ValueError(f"{place} must have a scene for each of {count} folds, got {scenes}; ask for fewer folds")


def prepare(
    config: TrainConfig, cache: Path, fold: Fold | None = None, on_progress: OnProgress | None = None
) -> TrainingData:
    """Return the frames of a config; presets are simulated and the paper's labels made, once, below ``cache``.

    Args:
        config: what is wanted.
        cache: folder for what is simulated, labeled and cached.
        fold: which scenes validate; None takes ``validation_share`` of them.
        on_progress: is called as simulation, labels and cached samples progress.

    Raises:
        ValueError: data do not fit the config, or there are too few scenes.
        OSError: data cannot be read or written.
    """
    if fold is not None:
        check_folds(config, fold.count)
    archives = [_train_split(config, place, cache, on_progress) for place in config.data]
    check_archives(config, archives)
    parts = [_split_scenes(archive.split(config.train_split), config, fold) for archive in archives]
    rest, held = (tuple(pair) for pair in zip(*parts, strict=True))
    train = _frames_of_archives(config, rest, cache, on_progress, first_epoch=1, versions=config.versions)
    validation = _frames_of_archives(
        config, held, cache, on_progress, first_epoch=VALIDATION_EPOCH, versions=min(config.versions, 1)
    )
    return TrainingData(replace(train, mirrored=config.mirrored), validation)


def archived_samples(config: TrainConfig) -> ArchivedSamples:
    """Return the clean frames of the archives of a config, all scenes of its split.

    Raises:
        ValueError: an archive is not there, or has not what the config wants.
    """
    archives = [_open_archive(place) for place in config.data]
    check_archives(config, archives)
    return ArchivedSamples(tuple(archive.split(config.train_split) for archive in archives), config)


def _frames_of_archives(
    config: TrainConfig,
    archives: tuple[Archive, ...],
    cache: Path,
    on_progress: OnProgress | None,
    *,
    first_epoch: int,
    versions: int,
) -> TrainingFrames:
    """Return the frames of archives; the samples of ``versions`` epochs from the first one on are cached, 0 is none."""
    labels = None
    if config.truth == "paper_label":
        labels = PaperLabels(cache / "labels", config.grid, config.indoor)
        counter = _ProgressCounter(on_progress, "labels", sum(map(len, archives)))
        for archive in archives:
            labels.build(archive, processes_for(len(archive)), counter.add)
    frames = TrainingFrames(ArchivedSamples(archives, config, labels), config)
    if not versions:
        return frames
    sample_cache = sample_cache_of(config, archives, cache / "frames", first_epoch, versions)
    counter = _ProgressCounter(on_progress, "frames", len(frames) * versions)
    sample_cache.build(frames, processes_for(len(frames)), counter.add)
    return replace(frames, cached=sample_cache.frame)


def _split_scenes(archive: Archive, config: TrainConfig, fold: Fold | None) -> tuple[Archive, Archive]:
    """Return the archive in two: what is trained on, and the scenes that validate."""
    scenes = archive.scenes
    if fold is not None:
        return list(archive.folds(fold.count, config.seed))[fold.number]
    if len(scenes) < 2:
        raise ValueError(
            f"{archive.store.place} has {len(scenes)} scene in split {config.train_split!r}; validation is split by "
            "scene and needs two at least: give more data"
        )
    count = min(max(round(config.validation_share * len(scenes)), 1), len(scenes) - 1)
    order = np.random.default_rng([config.seed, _VALIDATION]).permutation(len(scenes))
    held = {scenes[k] for k in order[:count]}
    return archive.of_scenes(set(scenes) - held), archive.of_scenes(held)


def _train_split(config: TrainConfig, place: str, cache: Path, on_progress: OnProgress | None) -> Archive:
    if not config.simulated:
        return _open_archive(place)
    preset = preset_named(place)
    count = preset.splits.index(config.train_split) + 1
    parts = {name: getattr(preset, name)[:count] for name in ("splits", "scenes", "frames")}
    wanted = replace(preset, grid_cells=config.cells, grid_half_extent_m=config.half_extent_m, **parts)
    return _simulated_archive(wanted, cache, on_progress)


def _simulated_archive(preset: Preset, cache: Path, on_progress: OnProgress | None) -> Archive:
    """Return the archive of a preset below ``cache``, made now unless it is there."""
    store = Storage.of(cache / f"{preset.name}-{preset.grid_cells}x{preset.grid_half_extent_m:g}")
    with contextlib.suppress(ValueError, OSError):
        archive = Archive.open(store.uri)
        if archive.manifest.recipe == recipe_of(preset):
            return archive
    if int(os.environ.get("WORLD_SIZE", "1")) > 1:  # a launcher has started this process beside others
        raise ValueError(
            f"{store.place} must be finished before several processes train; run viewshed train with one process "
            "first, or simulate archives and name them as data"
        )
    counter = _ProgressCounter(on_progress, preset.name, preset.sweeps)
    return simulate(preset, store, LocalEngine(processes_for(preset.sweeps)), lambda shard: counter.add(shard.frames))


def processes_for(frames: int) -> int:
    """Return how many processes make frames: few frames are done before another process has started.

    A worker of an engine may have no processes of its own, and shares the cores with others already.
    """
    alone = frames < _WORTH_PROCESSES or multiprocessing.parent_process() is not None
    return 1 if alone else cores()


def _open_archive(place: str) -> Archive:
    store = Storage.of(place)
    if MANIFEST not in store.names():
        raise ValueError(f"data must name presets or archives, got {place!r}: no archive is there, and no such preset")
    return Archive.open(place)


@dataclass(slots=True)
class _ProgressCounter:
    """Counts frames of one preparation and reports the sum."""

    on_progress: OnProgress | None
    name: str
    total: int
    done: int = 0

    def add(self, frames: int) -> None:
        self.done += frames
        if self.on_progress is not None:
            self.on_progress(self.name, self.done, self.total)
