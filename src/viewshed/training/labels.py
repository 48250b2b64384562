"""Labels of arXiv 2503.07375 for whole archives, made once and kept as bits beside the training."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.atomic import write_bytes
from viewshed.bev import BevGrid
from viewshed.datasets.archive import Archive
from viewshed.datasets.shard import ShardFacts
from viewshed.estimators import PAPER_ESTIMATORS, PAPER_INDOOR_ESTIMATORS
from viewshed.sweep import Sweep
from viewshed.training.files import make_files

_VERSION = 1
_OPEN = 512


def paper_label(sweep: Sweep, grid: BevGrid, indoor: bool) -> NDArray[np.bool_]:
    """Return the label (cells, cells) that arXiv 2503.07375 would give a sweep."""
    table = PAPER_INDOOR_ESTIMATORS if indoor else PAPER_ESTIMATORS
    return table["paper_label"](grid).estimate(sweep).visible()


@dataclass(frozen=True, slots=True)
class PaperLabels:
    """The paper's label of sweeps on a grid, one file of bits for each shard.

    Attributes:
        folder: where the files are.
        grid: of the labels.
        indoor: whether the paper's indoor settings are taken.
    """

    folder: Path
    grid: BevGrid
    indoor: bool

    def of_frame(self, shard: ShardFacts, row: int) -> NDArray[np.bool_]:
        """Return the label (cells, cells) of a frame whose shard :meth:`make` has seen."""
        cells = self.grid.cells
        bits = np.unpackbits(_bits(self.path(shard))[row], count=cells * cells)
        return bits.reshape(cells, cells).astype(np.bool_)

    def path(self, shard: ShardFacts) -> Path:
        """Return where the labels of a shard are: named by what the shard holds and by how labels are made."""
        key = json.dumps([_VERSION, shard.sha256, self.grid.cells, float(self.grid.half_extent_m), self.indoor])
        return self.folder / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.npy"

    def make(self, archive: Archive, workers: int, told: Callable[[int], None] | None = None) -> None:
        """Make the labels of an archive that are not there yet.

        Args:
            archive: of clean sweeps.
            workers: processes that share the work; 1 does it here.
            told: is given the number of frames of each shard that is finished.

        Raises:
            OSError: a shard cannot be read or a file cannot be written; what is finished stays.
        """
        jobs = [LabelJob(self, archive.of_scenes([shard.scene]), shard) for shard in archive.shards]
        missing = [job for job in jobs if not self.path(job.shard).is_file()]
        if missing:
            self.folder.mkdir(parents=True, exist_ok=True)
        make_files(label_shard, missing, workers, told)


@dataclass(frozen=True, slots=True, eq=False)
class LabelJob:
    """What a worker must know to label one shard.

    Attributes:
        labels: how and where.
        scene: archive of the shard's scene.
        shard: the shard.
    """

    labels: PaperLabels
    scene: Archive
    shard: ShardFacts


def label_shard(job: LabelJob) -> int:
    """Return the number of frames of a shard, whose labels are written."""
    first = 0
    for shard in job.scene.shards:
        if shard.name == job.shard.name:
            break
        first += shard.frames
    sweeps = (job.scene.frame(first + row)[0].sweep for row in range(job.shard.frames))
    masks = [paper_label(sweep, job.labels.grid, job.labels.indoor) for sweep in sweeps]
    buffer = io.BytesIO()
    np.save(buffer, np.packbits(np.reshape(masks, (len(masks), -1)), axis=1))
    write_bytes(job.labels.path(job.shard), buffer.getvalue())
    return job.shard.frames


@lru_cache(maxsize=_OPEN)
def _bits(path: Path) -> NDArray[np.uint8]:
    bits: NDArray[np.uint8] = np.load(path, mmap_mode="r")
    return bits
