"""TrainingFrames: the inputs and targets of a network, sample by sample; for torch's DataLoader, but needs no torch.

A sample is drawn in steps: the clean sweep, an attack or none, the counts of its returns.
Everything random follows from seed, epoch and number of the frame, so that it does not depend on processes or resumes.

Drawing a sample takes longer than a step of the network. So ``versions`` of every frame, each with an attack of its
own, are drawn once, cached on the disk, and shown in turn: epoch e shows version e modulo ``versions``. Folders are
named by a hash of all that decides a sample, so that another config never reads them. A file holds the counts of 256
frames, or their truth. Files are memory-mapped: all loader processes share one copy in the page cache. Each is written
whole or not at all and the truth last, so a block whose truth is there has its counts.

Clean sweeps are of archives. The label of arXiv 2503.07375 takes as long as the network: it is computed once for
each sweep and cached as bits.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

import viewshed
from viewshed.estimators import PAPER_ESTIMATORS, PAPER_INDOOR_ESTIMATORS
from viewshed.grid import BevGrid
from viewshed.sweep import Sweep
from viewshed_lab.data.archive.archive import Archive
from viewshed_lab.data.archive.schema import ShardFacts
from viewshed_lab.threats.attacks import (
    ATTACKS,
    BUDGETS,
    EARLIER,
    PAPER_ATTACK,
    PAPER_INDOOR_ATTACK,
    SEVERITIES,
    Attack,
    Knowledge,
    at_severity,
)
from viewshed_lab.training.config import PAPER, TrainConfig
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


class CleanSamples(Protocol):
    """Frames by number, in any process."""

    def __len__(self) -> int: ...

    def clean(self, index: int) -> CleanSample:
        """Return one frame."""
        ...

    def earlier(self, index: int) -> tuple[Sweep, ...]:
        """Return the last sweep before it of the same sensor and scene, or none."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ArchivedSamples:
    """The frames of archives, one after the other."""

    archives: tuple[Archive, ...]  # what is read, each a part of a split
    config: TrainConfig  # target and truth
    labels: PaperLabels | None = None  # of the paper, where they are the truth; None makes each when it is needed

    def __len__(self) -> int:
        return sum(map(len, self.archives))

    def clean(self, index: int) -> CleanSample:
        """Return one frame."""
        archive, at = self._place(index)
        sample = archive[at]
        config = self.config
        if config.truth == "probe":
            return CleanSample(sample.sweep, sample.truth.visible(config.target), sample.known)
        if self.labels is None:
            return labeled(sample.sweep, paper_label(sample.sweep, config.grid, config.indoor))
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


def draw_attacked_sweep(
    config: TrainConfig, sweep: Sweep, earlier: Callable[[], tuple[Sweep, ...]], rng: np.random.Generator
) -> Sweep:
    """Return the sweep as the network is shown it: attacked by one of the config's attacks, or as it is.

    Attacks are drawn evenly, and so is the strength of each, from its budgets and its severities in the study. One
    that this sweep does not allow leaves it as it is. ``earlier`` returns earlier sweeps of the same sensor, asked only
    where the attack needs one.
    """
    if not config.attacks or rng.random() >= config.attack_share:
        return sweep
    name = config.attacks[rng.integers(len(config.attacks))]
    try:
        return _draw_attack(config, name, earlier, rng).apply(sweep, rng).sweep
    except ValueError:
        return sweep


def _draw_attack(
    config: TrainConfig, name: str, earlier: Callable[[], tuple[Sweep, ...]], rng: np.random.Generator
) -> Attack:
    if name == PAPER:
        return PAPER_INDOOR_ATTACK if config.indoor else PAPER_ATTACK
    strengths = attack_strengths(name)
    strength = strengths[rng.integers(len(strengths))]
    attack_history = earlier() if name in EARLIER else ()
    knowledge = Knowledge(attack_history, half_extent_m=config.half_extent_m)
    if isinstance(strength, tuple):
        return at_severity(name, *strength, knowledge)
    return ATTACKS[name](strength, knowledge)


@lru_cache(maxsize=64)
def attack_strengths(name: str) -> tuple[int | tuple[str, float] | None, ...]:
    """Return how strong an attack may be drawn: None its default, a budget, or an attribute with a value.

    >>> attack_strengths("ghost_car")
    (None, 50, 100, 150, 200, 1000, 1000000000)
    """
    budgets = tuple(budget for budget in BUDGETS[name] if budget)
    return (None, *budgets, *SEVERITIES.get(name, ()))


Scalar = TypeVar("Scalar", bound=np.generic)
Arrays = dict[str, NDArray[np.float32]]

Key = tuple[int, int]
"""Epoch and number of a frame."""

BLANK = -1
"""Number of a frame that counts nowhere: it makes the parts of several processes equally long."""


_FOR_ATTACK, _FOR_MASKS, _FOR_TURN = 1, 2, 3


@dataclass(frozen=True, slots=True, eq=False)
class TrainingSample:
    """A sample as the network is taught it: a map in bytes and two masks, small enough to be cached.

    Not a :class:`~viewshed_lab.data.sample.Sample`: sweep and truth are no longer in it, only what they come to on the
    network's grid.
    """

    maps: NDArray[np.uint8]  # (1, cells, cells) uint8, what the network is shown of the sweep, perhaps attacked
    visible: NDArray[np.bool_]  # (cells, cells) bool, of the clean sweep
    known: NDArray[np.bool_]  # (cells, cells) bool, where that counts

    def turned(self, turn: int) -> TrainingSample:
        """Return the frame after ``turn`` modulo 4 quarter turns; from 4 on its x and y change places first.

        >>> mask = np.eye(2, dtype=bool)
        >>> TrainingSample(np.array([[[1, 2], [3, 4]]]), mask, mask).turned(5).maps.tolist()
        [[[3, 4], [1, 2]]]
        """
        return TrainingSample(_turned(self.maps, turn), _turned(self.visible, turn), _turned(self.known, turn))


def _turned(maps: NDArray[Scalar], turn: int) -> NDArray[Scalar]:
    return np.rot90(maps.swapaxes(-2, -1) if turn >= 4 else maps, turn % 4, axes=(-2, -1))


@dataclass(frozen=True, slots=True, eq=False)
class TrainingFrames:
    """Frames of one config as a map-style data set, in any number of processes."""

    source: CleanSamples  # the clean frames
    config: TrainConfig  # attacks, variant and seed
    # returns the sample of an epoch and a number that was drawn before; None draws each when it is needed
    cached: Callable[[int, int], TrainingSample] | None = None
    mirrored: bool = False  # whether frames are turned and mirrored at random

    def __len__(self) -> int:
        return len(self.source)

    def __getitem__(self, key: Key) -> Arrays:
        """Return the frame ``(epoch, number)`` as float32 arrays; all that is random follows from seed and key.

        ``inputs`` (1, cells, cells): what the network is shown, the sweep perhaps attacked; ``visible`` and
        ``known`` (cells, cells): 0 or 1, of the clean sweep, and 1 where that counts; ``masks`` (M,): dropout's, ones
        for ``mle``.

        Raises:
            IndexError: there is no such frame.
            ValueError: its shard is damaged.
            OSError: its shard cannot be read.
        """
        epoch, index = key
        if index == BLANK:
            zeros, masks = np.zeros(self.config.grid.shape, np.float32), self.config.shape.no_masks(1)[0]
            return {"inputs": zeros[None].copy(), "visible": zeros, "known": zeros.copy(), "masks": masks}
        sample = self.draw(epoch, index) if self.cached is None else self.cached(epoch, index)
        if self.mirrored:
            sample = sample.turned(int(self._rng(epoch, index, _FOR_TURN).integers(8)))
        return {
            "inputs": self.config.card().shown(sample.maps),
            "visible": sample.visible.astype(np.float32),
            "known": sample.known.astype(np.float32),
            "masks": self.config.shape.masks(1, self._rng(epoch, index, _FOR_MASKS))[0],
        }

    def draw(self, epoch: int, index: int) -> TrainingSample:
        """Return a frame made now, with the attack of this epoch."""
        clean = self.source.clean(index)
        rng = self._rng(epoch, index, _FOR_ATTACK)
        shown = draw_attacked_sweep(self.config, clean.sweep, lambda: self.source.earlier(index), rng)
        return TrainingSample(self.config.card().maps_of(shown), clean.visible, clean.known)

    def _rng(self, epoch: int, index: int, purpose: int) -> np.random.Generator:
        return np.random.default_rng([self.config.seed, epoch, index, purpose])


VALIDATION_EPOCH = 0
"""Epoch in which validation frames are drawn: the same attacks every time. Training's begin with 1."""


@dataclass(frozen=True, slots=True)
class Share:
    """The part of one of several processes."""

    rank: int = 0  # number of the process
    world: int = 1  # how many there are


@dataclass(slots=True)
class TrainingOrder:
    """The frames of an epoch in an order of its own, as keys; a sampler for torch's DataLoader.

    >>> list(TrainingOrder(4, 4, 7)) == sorted(TrainingOrder(4, 4, 7))
    False
    """

    frames: int  # how many there are
    take: int  # how many an epoch shows
    seed: int  # with the epoch it decides the order
    share: Share = Share()  # this process's part; all are equally long, the first frames fill up
    epoch: int = 0  # number of the epoch, from 0; Lightning sets it

    def set_epoch(self, epoch: int) -> None:
        """Begin an epoch."""
        self.epoch = epoch

    def __len__(self) -> int:
        return math.ceil(self.take / self.share.world)

    def __iter__(self) -> Iterator[Key]:
        rng = np.random.default_rng([self.seed, self.epoch + 1])
        order = np.resize(rng.permutation(self.frames)[: self.take], len(self) * self.share.world)
        for index in order[self.share.rank :: self.share.world]:
            yield self.epoch + 1, int(index)


@dataclass(frozen=True, slots=True)
class ValidationOrder:
    """The frames that validate, one after the other, as keys; a sampler for torch's DataLoader."""

    frames: int  # how many there are
    share: Share = Share()  # this process's part; all are equally long, blank frames fill up

    def __len__(self) -> int:
        return math.ceil(self.frames / self.share.world)

    def __iter__(self) -> Iterator[Key]:
        for step in range(len(self)):
            index = step * self.share.world + self.share.rank
            yield VALIDATION_EPOCH, index if index < self.frames else BLANK


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
        jobs = [(self, frames, *place) for place in places if not self.path(*place, _TRUTH).is_file()]
        build_files(_write_block, self.folder, jobs, workers, on_progress)


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


def _write_block(job: tuple[SampleCache, TrainingFrames, int, int]) -> int:
    """Return the number of frames of a block, whose counts and then their truth are written."""
    cache, frames, version, block = job
    numbers = range(block * _BLOCK, min((block + 1) * _BLOCK, cache.frames))
    samples = [frames.draw(cache.first + version, number) for number in numbers]
    path = partial(cache.path, version, block)
    write_array(path(_COUNTS), np.stack([sample.maps.reshape(-1) for sample in samples]))
    bits = np.stack([np.reshape([sample.visible, sample.known], (2, -1)) for sample in samples])
    write_array(path(_TRUTH), np.packbits(bits, axis=2))
    return len(samples)
