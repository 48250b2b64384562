"""Clean sweeps to train on, of archives, and the paper's labels of them.

The label of arXiv 2503.07375 takes as long as the network, so it is computed once for each sweep and cached as bits.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators import PAPER_ESTIMATORS, PAPER_INDOOR_ESTIMATORS
from viewshed.grid import BevGrid
from viewshed.sweep import Sweep
from viewshed_lab.data.archive.archive import Archive
from viewshed_lab.data.archive.schema import ShardFacts
from viewshed_lab.training.config import TrainConfig
from viewshed_lab.training.log import build_files, mapped_array, write_array

_VERSION = 1


def paper_label(sweep: Sweep, grid: BevGrid, indoor: bool) -> NDArray[np.bool_]:
    """Return the label (cells, cells) that arXiv 2503.07375 would give a sweep."""
    table = PAPER_INDOOR_ESTIMATORS if indoor else PAPER_ESTIMATORS
    return table["paper_label"](grid).estimate(sweep).visible()


@dataclass(frozen=True, slots=True)
class PaperLabels:
    """The paper's label of sweeps on a grid, one file of bits for each shard."""

    folder: Path  # where the files are
    grid: BevGrid  # of the labels
    indoor: bool  # whether the paper's indoor settings are taken

    def of_frame(self, shard: ShardFacts, row: int) -> NDArray[np.bool_]:
        """Return the label (cells, cells) of a frame whose shard :meth:`build` has seen."""
        cells = self.grid.cells
        bits = np.unpackbits(mapped_array(self.path(shard))[row], count=cells * cells)
        return bits.reshape(cells, cells).astype(np.bool_)

    def path(self, shard: ShardFacts) -> Path:
        """Return where the labels of a shard are: named by what the shard holds and by how labels are made."""
        key = json.dumps([_VERSION, shard.sha256, self.grid.cells, float(self.grid.half_extent_m), self.indoor])
        return self.folder / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.npy"

    def build(self, archive: Archive, workers: int, on_progress: Callable[[int], None] | None = None) -> None:
        """Label the shards of an archive that have no labels yet, in ``workers`` processes; see :func:`build_files`."""
        missing = [shard for shard in archive.shards if not self.path(shard).is_file()]
        jobs = [(self, archive.of_scenes([shard.scene]), shard) for shard in missing]
        build_files(_label_shard, self.folder, jobs, workers, on_progress)


def _label_shard(job: tuple[PaperLabels, Archive, ShardFacts]) -> int:
    """Return the number of frames of a shard in the archive of its scene, whose labels are written."""
    labels, scene, shard = job
    first = sum(one.frames for one in scene.shards[: scene.shards.index(shard)])
    sweeps = (scene[first + row].sweep for row in range(shard.frames))
    masks = [paper_label(sweep, labels.grid, labels.indoor) for sweep in sweeps]
    write_array(labels.path(shard), np.packbits(np.reshape(masks, (len(masks), -1)), axis=1))
    return shard.frames


_LOOK_BACK_FRAMES = 24


@dataclass(frozen=True, slots=True, eq=False)
class CleanSample:
    """A sweep that nobody attacked, and the one mask that a config teaches of it.

    Not a :class:`~viewshed_lab.data.sample.Sample`: what is taught may be the paper's label, which is no truth.
    """

    sweep: Sweep  # what the sensor measured
    visible: NDArray[np.bool_]  # (cells, cells) bool, the truth or the label
    known: NDArray[np.bool_]  # (cells, cells) bool, where it is known


def labeled(sweep: Sweep, label: NDArray[np.bool_]) -> CleanSample:
    """Return a sweep with the paper's label, which is known everywhere."""
    return CleanSample(sweep, label, np.ones(label.shape, np.bool_))


@dataclass(frozen=True, slots=True, eq=False)
class ArchivedSamples:
    """The frames of archives, one after the other."""

    archives: tuple[Archive, ...]  # what is read, each a part of a split
    config: TrainConfig  # target and truth
    labels: PaperLabels | None = None  # of the paper, where they are the truth

    def __len__(self) -> int:
        return sum(map(len, self.archives))

    def clean(self, index: int) -> CleanSample:
        """Return one frame."""
        archive, at = self._place(index)
        sample = archive[at]
        if self.labels is None:
            return CleanSample(sample.sweep, sample.truth.visible(self.config.target), sample.known)
        return labeled(sample.sweep, self.labels.of_frame(*archive.locate(at)))

    def earlier(self, index: int) -> tuple[Sweep, ...]:
        """Return the last sweep before it of the same sensor and scene, or none."""
        archive, at = self._place(index)
        sample = archive[at]
        for before in range(at - 1, max(at - _LOOK_BACK_FRAMES, 0) - 1, -1):
            other = archive[before]
            if other.scene != sample.scene:
                break
            if other.measured.agent == sample.measured.agent:
                return (other.sweep,)
        return ()

    def _place(self, index: int) -> tuple[Archive, int]:
        for archive in self.archives:
            if index < len(archive):
                return archive, index
            index -= len(archive)
        raise IndexError(f"index must be below {len(self)}, the number of frames")


def check_archives(config: TrainConfig, archives: Sequence[Archive]) -> None:
    """Check that archives have the grid, targets, splits and sweeps that the config wants to learn."""
    for archive in archives:
        layout, place = archive.manifest.layout, archive.store.place
        if config.train_split not in archive.splits:
            names = ", ".join(archive.splits)
            raise ValueError(f"train_split must be one of {names} of {place}, got {config.train_split!r}")
        if config.truth == "paper_label":
            if archive.manifest.recipe.get("command") in ("attack", "corrupt"):
                raise ValueError(
                    f"{place} holds tampered sweeps, and paper_label is of clean ones; train on its source"
                )
        elif layout.grid != config.grid:
            raise ValueError(
                f"{place} has its truth on {layout.grid.cells} cells, ±{layout.grid.half_extent_m:g} m; cells and "
                f"half_extent_m must be those, got {config.cells} and {config.half_extent_m:g}"
            )
        elif config.target not in layout.targets:
            raise ValueError(
                f"{place} has no truth for target {config.target!r}, it has {', '.join(layout.targets) or 'none'}; "
                'simulate or label it, or train with truth = "paper_label"'
            )
