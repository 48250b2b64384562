"""Clean sweeps to train on: of archives, or simulated anew for every epoch; and the paper's labels of archives.

The label of arXiv 2503.07375 takes as long as the network, so it is computed once for each sweep and cached as bits.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators import PAPER_ESTIMATORS, PAPER_INDOOR_ESTIMATORS
from viewshed.grid import BevGrid
from viewshed.sweep import Sweep
from viewshed_lab.data.archive.archive import Archive
from viewshed_lab.data.archive.schema import ShardFacts
from viewshed_lab.data.presets import Preset, preset_named
from viewshed_lab.data.sample import Sample
from viewshed_lab.data.simulated import ScenePlan, simulate_frame
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
        jobs = [_LabelJob(self, archive.of_scenes([shard.scene]), shard) for shard in missing]
        build_files(_label_shard, self.folder, jobs, workers, on_progress)


@dataclass(frozen=True, slots=True, eq=False)
class _LabelJob:
    """What a worker must know to label one shard: how and where, the archive of its scene, and which shard it is."""

    labels: PaperLabels
    scene: Archive
    shard: ShardFacts


def _label_shard(job: _LabelJob) -> int:
    """Return the number of frames of a shard, whose labels are written."""
    names = [shard.name for shard in job.scene.shards]
    first = sum(shard.frames for shard in job.scene.shards[: names.index(job.shard.name)])
    sweeps = (job.scene[first + row].sweep for row in range(job.shard.frames))
    masks = [paper_label(sweep, job.labels.grid, job.labels.indoor) for sweep in sweeps]
    write_array(job.labels.path(job.shard), np.packbits(np.reshape(masks, (len(masks), -1)), axis=1))
    return job.shard.frames


FRAMES_PER_NEW_SCENE = 8
"""Frames that are simulated of each fresh scene."""

_LOOK_BACK_FRAMES = 24
_FRESH = 0x7665777368


@dataclass(frozen=True, slots=True, eq=False)
class CleanSample:
    """A sweep that nobody attacked, and the one mask that a config teaches of it.

    Not a :class:`~viewshed_lab.data.sample.Sample`: what is taught may be the paper's label, which is no truth.
    """

    sweep: Sweep  # what the sensor measured
    visible: NDArray[np.bool_]  # (cells, cells) bool, the truth or the label
    known: NDArray[np.bool_]  # (cells, cells) bool, where it is known


class CleanSamples(Protocol):
    """Frames by number, in any process."""

    def __len__(self) -> int: ...

    @property
    def block(self) -> int:
        """Frames in a row that are best read one after the other; 1 where it does not matter."""
        ...

    def clean(self, epoch: int, index: int) -> CleanSample:
        """Return one frame."""
        ...

    def earlier(self, epoch: int, index: int, count: int = 1) -> tuple[Sweep, ...]:
        """Return the last ``count`` sweeps before it of the same sensor and scene, or as many as there are.

        The oldest comes first.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ArchivedSamples:
    """The frames of archives, one after the other; the same in every epoch."""

    archives: tuple[Archive, ...]  # what is read, each a part of a split
    config: TrainConfig  # target and truth
    labels: PaperLabels | None = None  # of the paper, where they are the truth
    block: int = 1  # see :class:`CleanSamples`

    def __len__(self) -> int:
        return sum(map(len, self.archives))

    def clean(self, epoch: int, index: int) -> CleanSample:
        """Return one frame, of any epoch."""
        archive, at = self._place(index)
        sample = archive[at]
        if self.labels is None:
            return _with_truth(sample, self.config)
        return _with_label(sample.sweep, self.labels.of_frame(*archive.locate(at)))

    def earlier(self, epoch: int, index: int, count: int = 1) -> tuple[Sweep, ...]:
        """Return the last sweeps before it of the same sensor and scene, the oldest first."""
        archive, at = self._place(index)
        sample = archive[at]
        sweeps: list[Sweep] = []
        for before in range(at - 1, max(at - _LOOK_BACK_FRAMES, 0) - 1, -1):
            other = archive[before]
            if other.scene != sample.scene or len(sweeps) == count:
                break
            if other.measured.agent == sample.measured.agent:
                sweeps.insert(0, other.sweep)
        return tuple(sweeps)

    def _place(self, index: int) -> tuple[Archive, int]:
        for archive in self.archives:
            if index < len(archive):
                return archive, index
            index -= len(archive)
        raise IndexError(f"index must be below {len(self)}, the number of frames")


@dataclass(frozen=True, slots=True)
class OnlineSimulation:
    """Frames of scenes that no epoch has seen before; 8 of each scene, the presets in turn."""

    config: TrainConfig  # seed, presets and number of frames
    count: int  # frames of an epoch

    def __len__(self) -> int:
        return self.count

    @property
    def block(self) -> int:
        """Frames of one scene."""
        return FRAMES_PER_NEW_SCENE

    def clean(self, epoch: int, index: int) -> CleanSample:
        """Return one frame, simulated now."""
        sample = simulate_frame(*self._place(epoch, index))
        if self.config.truth == "probe":
            return _with_truth(sample, self.config)
        return _with_label(sample.sweep, paper_label(sample.sweep, self.config.grid, self.config.indoor))

    def earlier(self, epoch: int, index: int, count: int = 1) -> tuple[Sweep, ...]:
        """Return the sweeps of the same agent just before it, the oldest first; fewer at the start of a scene."""
        scene, number = self._place(epoch, index)
        before = range(number - scene.preset.agents, -1, -scene.preset.agents)[:count]
        return tuple(simulate_frame(scene, earlier).sweep for earlier in reversed(before))

    def _place(self, epoch: int, index: int) -> tuple[ScenePlan, int]:
        number, turn = divmod(index, FRAMES_PER_NEW_SCENE)
        config = self.config
        preset = new_scenes_preset(config, config.data[number % len(config.data)], epoch, len(self))
        scene = ScenePlan(preset, 0, number)
        rng = np.random.default_rng([config.seed, epoch, number, _FRESH])
        return scene, int(rng.permutation(scene.frames)[turn % scene.frames])


@lru_cache(maxsize=16)
def new_scenes_preset(config: TrainConfig, name: str, epoch: int, frames: int) -> Preset:
    """Return the preset with one split of new scenes, enough for ``frames``, on the config's grid."""
    preset = preset_named(name)
    at = preset.splits.index(config.train_split)
    scenes = -(-frames // FRAMES_PER_NEW_SCENE)
    length = preset.frames[at] // preset.scenes[at]
    seed = int(np.random.SeedSequence([config.seed, epoch, _FRESH]).generate_state(1)[0])
    return replace(on_grid(preset, config), splits=("fresh",), scenes=(scenes,), frames=(scenes * length,), seed=seed)


def on_grid(preset: Preset, config: TrainConfig) -> Preset:
    """Return the preset with its truth on the config's grid."""
    return replace(preset, grid_cells=config.cells, grid_half_extent_m=config.half_extent_m)


def _with_truth(sample: Sample, config: TrainConfig) -> CleanSample:
    return CleanSample(sample.sweep, sample.truth.visible(config.target), sample.known)


def _with_label(sweep: Sweep, label: NDArray[np.bool_]) -> CleanSample:
    return CleanSample(sweep, label, np.ones(label.shape, np.bool_))


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
