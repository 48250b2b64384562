"""Training frames made once and kept: maps and bits of each frame, so that a training never waits for data."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import viewshed
from viewshed.atomic import write_bytes
from viewshed.datasets.archive import Archive
from viewshed.training.config import TrainConfig
from viewshed.training.files import make_files
from viewshed.training.frames import Drawn, TrainingFrames

_LAYOUT = 2
_BLOCK = 256
_OPEN = 1024
_DECIDE = (
    "cells", "half_extent_m", "target", "truth", "attacks", "attack_share", "seed",
    "max_range_m", "heights_m", "inputs",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class KeptOnDisk:
    """Frames of a config as rows of bytes: of a cell's channels, and a bit each for visible and known. 256 a file.

    Attributes:
        folder: where the files are; its name tells what decides the frames.
        shape: (channels, cells, cells) of the maps.
        frames: how many there are.
        first: epoch of the first version.
        versions: epochs that are kept; later ones show them again in turn.
    """

    folder: Path
    shape: tuple[int, int, int]
    frames: int
    first: int
    versions: int

    def frame(self, epoch: int, index: int) -> Drawn:
        """Return a frame in the version of an epoch.

        Raises:
            IndexError: there is no such frame.
            OSError: its file cannot be read.
        """
        if not 0 <= index < self.frames:
            raise IndexError(f"index must be below {self.frames}, the number of frames, got {index}")
        block, row = divmod(index, _BLOCK)
        record = _rows(self.path((epoch - self.first) % self.versions, block))[row]
        size, cells = math.prod(self.shape), self.shape[1:]
        bits = np.unpackbits(record[size:].reshape(2, -1), axis=1, count=math.prod(cells)).astype(np.bool_)
        return Drawn(record[:size].reshape(self.shape), *bits.reshape(2, *cells))

    def path(self, version: int, block: int) -> Path:
        """Return where a block of a version is."""
        return self.folder / f"{version}-{block}.npy"

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
        missing = [_Job(self, frames, *place) for place in places if not self.path(*place).is_file()]
        if missing:
            self.folder.mkdir(parents=True, exist_ok=True)
        make_files(_make_block, missing, workers, told)


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    kept: KeptOnDisk
    frames: TrainingFrames
    version: int
    block: int


def kept_of(config: TrainConfig, archives: tuple[Archive, ...], folder: Path, first: int, versions: int) -> KeptOnDisk:
    """Return where the frames of archives are kept, which :meth:`KeptOnDisk.make` makes.

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
    shape = (len(config.inputs), config.cells, config.cells)
    return KeptOnDisk(folder / name, shape, sum(map(len, archives)), first, versions)


def _make_block(job: _Job) -> int:
    """Return the number of frames of a block, which is written."""
    start = job.block * _BLOCK
    numbers = range(start, min(start + _BLOCK, job.kept.frames))
    rows = [_record(job.frames.draw(job.kept.first + job.version, number)) for number in numbers]
    buffer = io.BytesIO()
    np.save(buffer, np.stack(rows))
    write_bytes(job.kept.path(job.version, job.block), buffer.getvalue())
    return len(rows)


def _record(drawn: Drawn) -> NDArray[np.uint8]:
    bits = np.packbits(np.reshape([drawn.visible, drawn.known], (2, -1)), axis=1)
    return np.concatenate([drawn.maps.reshape(-1), bits.reshape(-1)])


@lru_cache(maxsize=_OPEN)
def _rows(path: Path) -> NDArray[np.uint8]:
    rows: NDArray[np.uint8] = np.load(path, mmap_mode="r")
    return rows
