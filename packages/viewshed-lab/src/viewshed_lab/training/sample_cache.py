"""A cache of training samples on the disk, so that a training never waits for data.

Drawing a sample (read, attack, count) takes longer than a step of the network. So ``versions`` of every frame, each
with an attack of its own, are drawn once and shown in turn: epoch e shows version e modulo ``versions``. Folders are
named by a hash of all that decides a sample, so that another config never reads them. A file holds the counts of 256
frames, or their truth. Files are memory-mapped: all loader processes share one copy in the page cache. Each is written
whole or not at all and the truth last, so a block whose truth is there has its counts.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import viewshed
from viewshed_lab.data.archive.archive import Archive
from viewshed_lab.training.config import TrainConfig
from viewshed_lab.training.log import build_files, mapped_array, write_array
from viewshed_lab.training.samples import TrainingFrames, TrainingSample

_LAYOUT = 6
_BLOCK = 256
_COUNTS, _TRUTH = "counts", "truth"

_CONFIG_KEYS = (
    "cells", "half_extent_m", "target", "truth", "attacks", "attack_share", "seed", "max_range_m", "heights_m",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class SampleCache:
    """Samples of a config in rows: a byte of each cell for its returns, two bits for visible and known."""

    folder: Path  # where the files are; its name tells what decides the frames
    cells: int  # of the grid
    frames: int  # how many there are
    first: int  # epoch whose attacks the first version has
    versions: int  # of each frame; later epochs show them again in turn

    def frame(self, epoch: int, index: int) -> TrainingSample:
        """Return a frame in the version of an epoch."""
        if not 0 <= index < self.frames:
            raise IndexError(f"index must be below {self.frames}, the number of frames, got {index}")
        block, row = divmod(index, _BLOCK)
        version = (epoch - self.first) % self.versions
        maps = mapped_array(self.path(version, block, _COUNTS))[row].reshape(1, self.cells, self.cells)
        truth = mapped_array(self.path(version, block, _TRUTH))[row]
        bits = np.unpackbits(truth, axis=1, count=self.cells**2).astype(np.bool_)
        return TrainingSample(maps, *bits.reshape(2, self.cells, self.cells))

    def path(self, version: int, block: int, name: str) -> Path:
        """Return where the counts or the truth of a block of a version are."""
        return self.folder / f"{version}-{block}-{name}.npy"

    def build(self, frames: TrainingFrames, workers: int, on_progress: Callable[[int], None] | None = None) -> None:
        """Draw the samples of the blocks that are missing, in ``workers`` processes; see :func:`build_files`."""
        blocks = range(-(-self.frames // _BLOCK))
        places = [(version, block) for version in range(self.versions) for block in blocks]
        jobs = [_BlockJob(self, frames, *place) for place in places if not self.path(*place, _TRUTH).is_file()]
        build_files(_write_block, self.folder, jobs, workers, on_progress)


@dataclass(frozen=True, slots=True, eq=False)
class _BlockJob:
    cache: SampleCache
    frames: TrainingFrames
    version: int
    block: int


def sample_cache_of(
    config: TrainConfig, archives: tuple[Archive, ...], folder: Path, first: int, versions: int
) -> SampleCache:
    """Return the cache of the samples of archives below ``folder``, which :meth:`SampleCache.build` fills."""
    table = config.to_json()
    shards = [shard.sha256 for archive in archives for shard in archive.shards]
    decided_by = {key: table[key] for key in _CONFIG_KEYS}
    words = [_LAYOUT, viewshed.__version__, first, config.card().clip, decided_by, shards]
    name = hashlib.sha256(json.dumps(words).encode()).hexdigest()[:24]
    return SampleCache(folder / name, config.cells, sum(map(len, archives)), first, versions)


def _write_block(job: _BlockJob) -> int:
    """Return the number of frames of a block, whose counts and then their truth are written."""
    start = job.block * _BLOCK
    numbers = range(start, min(start + _BLOCK, job.cache.frames))
    samples = [job.frames.draw(job.cache.first + job.version, number) for number in numbers]
    path = partial(job.cache.path, job.version, job.block)
    write_array(path(_COUNTS), np.stack([sample.maps.reshape(-1) for sample in samples]))
    bits = np.stack([np.reshape([sample.visible, sample.known], (2, -1)) for sample in samples])
    write_array(path(_TRUTH), np.packbits(bits, axis=2))
    return len(samples)
