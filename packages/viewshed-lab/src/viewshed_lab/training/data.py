"""Open or simulate the archives of a config, and split their scenes into training and validation."""

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
"""Called with the preparation stage, the frames that are done and the total frames."""

_VALIDATION = 0x76616C

_MIN_FRAMES_FOR_PROCESSES = 100
"""Fewer frames are done before a second process has started."""


@dataclass(frozen=True, slots=True)
class Fold:
    """One fold of a cross-validation: its number from 0, and the number of folds."""

    number: int
    count: int

    def __post_init__(self) -> None:
        if not (self.count >= 2 and 0 <= self.number < self.count):
            raise ValueError(f"fold must be one of at least 2, got {self.number} of {self.count}")


@dataclass(frozen=True, slots=True, eq=False)
class TrainingData:
    """Training and validation frames; no scene is in both."""

    train: TrainingFrames  # to fit the weights
    validation: TrainingFrames  # to choose the best epoch and when to stop


def check_data(config: TrainConfig) -> None:
    """Check that the archives of a config exist and fit it; the config itself has checked presets."""
    if not config.simulated:
        check_archives(config, [_open_archive(place) for place in config.data])


def check_folds(config: TrainConfig, count: int) -> None:
    """Check that each entry of a config's data has at least ``count`` scenes."""
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
    """Return the frames of a config; simulate presets and compute the paper's labels below ``cache`` where missing.

    Args:
        config: settings of the training.
        cache: folder of simulated archives, labels and cached samples.
        fold: validation scenes; None selects ``validation_share`` of them.
        on_progress: called during simulation, labeling and caching.

    Raises:
        ValueError: data do not fit the config, or there are too few scenes.
        OSError: data cannot be read or written.
    """
    if fold is not None:
        check_folds(config, fold.count)
    archives = [_train_split(config, place, cache, on_progress) for place in config.data]
    check_archives(config, archives)
    parts = [_split_scenes(archive.split(config.train_split), config, fold) for archive in archives]
    train_parts, validation_parts = (tuple(pair) for pair in zip(*parts, strict=True))
    train = _frames_of_archives(config, train_parts, cache, on_progress, first_epoch=1, versions=config.versions)
    validation = _frames_of_archives(
        config, validation_parts, cache, on_progress, first_epoch=VALIDATION_EPOCH, versions=min(config.versions, 1)
    )
    return TrainingData(replace(train, mirrored=config.mirrored), validation)


def archived_samples(config: TrainConfig) -> ArchivedSamples:
    """Return the clean frames of all scenes of a config's archives and split.

    Raises:
        ValueError: an archive is missing or does not fit the config.
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
    """Return the frames of archives; cache the samples of ``versions`` epochs from ``first_epoch`` on (0: no cache)."""
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
    """Split an archive by scene into a training part and a validation part."""
    scenes = archive.scenes
    if fold is not None:
        return list(archive.folds(fold.count, config.seed))[fold.number]
    if len(scenes) < 2:
        raise ValueError(
            f"{archive.store.place} has {len(scenes)} scene(s) in split {config.train_split!r}; validation is split by "
            "scene and needs at least two; give more data"
        )
    count = min(max(round(config.validation_share * len(scenes)), 1), len(scenes) - 1)
    order = np.random.default_rng([config.seed, _VALIDATION]).permutation(len(scenes))
    validation = {scenes[k] for k in order[:count]}
    return archive.of_scenes(set(scenes) - validation), archive.of_scenes(validation)


def _train_split(config: TrainConfig, place: str, cache: Path, on_progress: OnProgress | None) -> Archive:
    if not config.simulated:
        return _open_archive(place)
    preset = preset_named(place)
    count = preset.splits.index(config.train_split) + 1
    parts = {name: getattr(preset, name)[:count] for name in ("splits", "scenes", "frames")}
    on_grid = replace(preset, grid_cells=config.cells, grid_half_extent_m=config.half_extent_m, **parts)
    return _simulated_archive(on_grid, cache, on_progress)


def _simulated_archive(preset: Preset, cache: Path, on_progress: OnProgress | None) -> Archive:
    """Return the archive of a preset below ``cache``; simulate it unless it exists."""
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
    """Return the number of processes to build frames with: 1 for few frames, and in a worker process.

    A worker of an engine must not start processes, and already shares the cores with other workers.
    """
    single = frames < _MIN_FRAMES_FOR_PROCESSES or multiprocessing.parent_process() is not None
    return 1 if single else cores()


def _open_archive(place: str) -> Archive:
    store = Storage.of(place)
    if MANIFEST not in store.names():
        raise ValueError(f"data must name presets or archives, got {place!r}: no archive is there, and no such preset")
    return Archive.open(place)


@dataclass(slots=True)
class _ProgressCounter:
    """Counts the frames of one preparation stage and reports the sum."""

    on_progress: OnProgress | None
    name: str
    total: int
    done: int = 0

    def add(self, frames: int) -> None:
        self.done += frames
        if self.on_progress is not None:
            self.on_progress(self.name, self.done, self.total)
