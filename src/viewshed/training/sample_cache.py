"""Training frames made once and kept: maps and bits of each frame, so that a training never waits for data."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import viewshed
from viewshed._files import write_atomic
from viewshed.datasets.archive.archive import Archive
from viewshed.training.config import TrainConfig
from viewshed.training.log import make_files
from viewshed.training.samples import TrainingFrames, TrainingSample

_LAYOUT = 5

_BLOCK = 256

_OPEN = 4096

_TRUTH = "truth"

_DECIDE = (
    "cells", "half_extent_m", "target", "truth", "attacks", "attack_share", "ringless_share", "past_share", "seed",
    "max_range_m", "heights_m",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class SampleCache:
    """Frames of a config in rows: a byte of each cell for each channel, two bits for visible and known. 256 a file.

    Each channel has files of its own, so that trainings on other channels of the same frames share them.

    Attributes:
        folder: where the files are; its name tells what decides the frames.
        inputs: names of the channels.
        cells: of the grid.
        frames: how many there are.
        first: epoch of the first version.
        versions: epochs that are kept; later ones show them again in turn.
    """

    folder: Path
    inputs: tuple[str, ...]
    cells: int
    frames: int
    first: int
    versions: int

    def frame(self, epoch: int, index: int) -> TrainingSample:
        """Return a frame in the version of an epoch.

        Raises:
            IndexError: there is no such frame.
            OSError: its file cannot be read.
        """
        if not 0 <= index < self.frames:
            raise IndexError(f"index must be below {self.frames}, the number of frames, got {index}")
        block, row = divmod(index, _BLOCK)
        place, size = ((epoch - self.first) % self.versions, block), self.cells**2
        maps = [_rows(self.path(*place, name))[row].reshape(self.cells, self.cells) for name in self.inputs]
        bits = np.unpackbits(_rows(self.path(*place, _TRUTH))[row], axis=1, count=size).astype(np.bool_)
        return TrainingSample(np.stack(maps), *bits.reshape(2, self.cells, self.cells))

    def path(self, version: int, block: int, name: str) -> Path:
        """Return where a channel, or the truth, of a block of a version is."""
        return self.folder / f"{version}-{block}-{name}.npy"

    def missing(self, version: int, block: int) -> tuple[str, ...]:
        """Return the channels of a block that are not there; all of them if its truth is not."""
        if not self.path(version, block, _TRUTH).is_file():
            return self.inputs
        return tuple(name for name in self.inputs if not self.path(version, block, name).is_file())

    def make(self, frames: TrainingFrames, workers: int, told: Callable[[int], None] | None = None) -> None:
        """Make the blocks that are not there yet.

        Args:
            frames: that are kept.
            workers: processes that share the work; 1 does it here.
            told: is given the number of frames of each block that is finished.

        Raises:
            OSError: a frame cannot be read or a file cannot be written; what is finished stays.
        """
        blocks = range(-(-self.frames // _BLOCK))
        places = [(version, block) for version in range(self.versions) for block in blocks]
        jobs = [_Job(self, frames, *place, names) for place in places if (names := self.missing(*place))]
        if jobs:
            self.folder.mkdir(parents=True, exist_ok=True)
        make_files(_make_block, jobs, workers, told)


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    kept: SampleCache
    frames: TrainingFrames
    version: int
    block: int
    names: tuple[str, ...]


def kept_of(config: TrainConfig, archives: tuple[Archive, ...], folder: Path, first: int, versions: int) -> SampleCache:
    """Return where the frames of archives are kept, which :meth:`SampleCache.make` makes.

    Args:
        config: what decides the frames, beside the archives.
        archives: that are read.
        folder: of all kept frames.
        first: epoch whose attacks the first version has.
        versions: of each frame.
    """
    table = config.to_json()
    shards = [shard.sha256 for archive in archives for shard in archive.shards]
    words = [_LAYOUT, viewshed.__version__, first, config.card().clip, {key: table[key] for key in _DECIDE}, shards]
    name = hashlib.sha256(json.dumps(words).encode()).hexdigest()[:24]
    return SampleCache(folder / name, config.inputs, config.cells, sum(map(len, archives)), first, versions)


def _make_block(job: _Job) -> int:
    """Return the number of frames of a block, whose missing channels are written, the truth last."""
    start = job.block * _BLOCK
    numbers = range(start, min(start + _BLOCK, job.kept.frames))
    frames = replace(job.frames, config=job.frames.config.showing(job.names))
    drawn = [frames.draw(job.kept.first + job.version, number) for number in numbers]
    for k, name in enumerate(job.names):
        _write(job, name, np.stack([each.maps[k].reshape(-1) for each in drawn]))
    bits = np.stack([np.reshape([each.visible, each.known], (2, -1)) for each in drawn])
    _write(job, _TRUTH, np.packbits(bits, axis=2))
    return len(drawn)


def _write(job: _Job, name: str, rows: NDArray[np.uint8]) -> None:
    buffer = io.BytesIO()
    np.save(buffer, rows)
    write_atomic(job.kept.path(job.version, job.block, name), buffer.getvalue())


@lru_cache(maxsize=_OPEN)
def _rows(path: Path) -> NDArray[np.uint8]:
    rows: NDArray[np.uint8] = np.load(path, mmap_mode="r")
    return rows
