"""TrainingFrames: a network's inputs and targets, sample by sample, for torch's DataLoader. Needs no torch.

A sample is built in steps: load the clean sweep of an archive, attack it or not, count its returns per cell.
All random numbers depend only on seed, epoch and frame number, not on the number of processes or on resumes.

Building a sample takes longer than a network step. Therefore ``versions`` of every frame, each with its own attack, are
built once and cached on disk; epoch e uses version e modulo ``versions``. The name of the cache folder is a hash of
everything that determines a sample, so another config never reads it. One file holds the counts of 256 frames, another
their truth. Files are memory-mapped: all loader processes share one copy in the page cache. Files are written
atomically and the truth last, so a block with a truth file is complete.

The label of arXiv 2503.07375 takes as long as a network step: it is computed once per sweep and cached as bits.
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
    """Return the label (cells, cells) bool of a sweep by the method of arXiv 2503.07375."""
    table = PAPER_INDOOR_ESTIMATORS if indoor else PAPER_ESTIMATORS
    return table["paper_label"](grid).estimate(sweep).visible()


@dataclass(frozen=True, slots=True)
class PaperLabels:
    """Cached paper labels of sweeps on a grid, one file of bits per shard."""

    folder: Path  # of the files
    grid: BevGrid  # of the labels
    indoor: bool  # whether to use the paper's indoor settings

    def of_frame(self, shard: ShardFacts, row: int) -> NDArray[np.bool_]:
        """Return the label (cells, cells) bool of a frame; :meth:`build` must have labeled its shard."""
        cells = self.grid.cells
        bits = np.unpackbits(mapped_array(self.path(shard))[row], count=cells * cells)
        return bits.reshape(cells, cells).astype(np.bool_)

    def path(self, shard: ShardFacts) -> Path:
        """Return the label file of a shard; its name is a hash of the shard's content and the label settings."""
        key = json.dumps([_VERSION, shard.sha256, self.grid.cells, float(self.grid.half_extent_m), self.indoor])
        return self.folder / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.npy"

    def build(self, archive: Archive, workers: int, on_progress: Callable[[int], None] | None = None) -> None:
        """Label the unlabeled shards of an archive in ``workers`` processes; see :func:`build_files`."""
        missing = [shard for shard in archive.shards if not self.path(shard).is_file()]
        jobs = [(self, archive.of_scenes([shard.scene]), shard) for shard in missing]
        build_files(_label_shard, self.folder, jobs, workers, on_progress)


def _label_shard(job: tuple[PaperLabels, Archive, ShardFacts]) -> int:
    """Write the labels of a shard, given the archive of its scene, and return its number of frames."""
    labels, scene, shard = job
    first = sum(one.frames for one in scene.shards[: scene.shards.index(shard)])
    sweeps = (scene[first + row].sweep for row in range(shard.frames))
    masks = [paper_label(sweep, labels.grid, labels.indoor) for sweep in sweeps]
    write_array(labels.path(shard), np.packbits(np.reshape(masks, (len(masks), -1)), axis=1))
    return shard.frames


_LOOK_BACK_FRAMES = 24
"""Frames that :meth:`ArchivedSamples.earlier` searches backward."""


@dataclass(frozen=True, slots=True, eq=False)
class CleanSample:
    """A sweep without attack, and its target mask.

    Unlike in a :class:`~viewshed_lab.data.sample.Sample`, the target may be the paper's label instead of the truth.
    """

    sweep: Sweep  # as measured
    visible: NDArray[np.bool_]  # (cells, cells) bool, truth or label
    known: NDArray[np.bool_]  # (cells, cells) bool, where ``visible`` is known


def labeled(sweep: Sweep, label: NDArray[np.bool_]) -> CleanSample:
    """Return the sample of a sweep and its paper label, which is known in every cell."""
    return CleanSample(sweep, label, np.ones(label.shape, np.bool_))


class CleanSamples(Protocol):
    """Clean frames by index; usable in any process."""

    def __len__(self) -> int: ...

    def clean(self, index: int) -> CleanSample:
        """Return frame ``index``."""
        ...

    def earlier(self, index: int) -> tuple[Sweep, ...]:
        """Return the previous sweep of the same sensor and scene, or an empty tuple."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ArchivedSamples:
    """The frames of several archives, concatenated."""

    archives: tuple[Archive, ...]  # each a part of a split
    config: TrainConfig  # target and truth
    labels: PaperLabels | None = None  # cached labels for truth ``paper_label``; None computes each on demand

    def __len__(self) -> int:
        return sum(map(len, self.archives))

    def clean(self, index: int) -> CleanSample:
        """Return frame ``index``."""
        archive, at = self._place(index)
        sample = archive[at]
        config = self.config
        if config.truth == "probe":
            return CleanSample(sample.sweep, sample.truth.visible(config.target), sample.known)
        if self.labels is None:
            return labeled(sample.sweep, paper_label(sample.sweep, config.grid, config.indoor))
        return labeled(sample.sweep, self.labels.of_frame(*archive.locate(at)))

    def earlier(self, index: int) -> tuple[Sweep, ...]:
        """Return the previous sweep of the same sensor and scene, or an empty tuple."""
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
    """Check that archives have the grid, target, split and kind of sweeps that the config requires."""
    for archive in archives:
        layout, place = archive.manifest.layout, archive.store.place
        if config.train_split not in archive.splits:
            names = ", ".join(archive.splits)
            raise ValueError(f"train_split must be one of {names} of {place}, got {config.train_split!r}")
        if config.truth == "paper_label":
            if archive.manifest.recipe.get("command") in ("attack", "corrupt"):
                raise ValueError(
                    f"{place} holds tampered sweeps, but paper_label needs clean ones; train on its source"
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


def sample_attacked_sweep(
    config: TrainConfig, sweep: Sweep, earlier: Callable[[], tuple[Sweep, ...]], rng: np.random.Generator
) -> Sweep:
    """Return the sweep, attacked by one of the config's attacks or unchanged.

    The attack and its strength (a budget or a severity of the study) are sampled uniformly. An attack that is not
    possible on this sweep leaves it unchanged. ``earlier`` returns earlier sweeps of the same sensor; it is called only
    if the attack needs them.
    """
    if not config.attacks or rng.random() >= config.attack_share:
        return sweep
    name = config.attacks[rng.integers(len(config.attacks))]
    try:
        return _sample_attack(config, name, earlier, rng).apply(sweep, rng).sweep
    except ValueError:
        return sweep


def _sample_attack(
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
    """Return the strengths of an attack to sample from: None (its default), a budget, or an attribute and its value.

    >>> attack_strengths("ghost_car")
    (None, 50, 100, 150, 200, 1000, 1000000000)
    """
    budgets = tuple(budget for budget in BUDGETS[name] if budget)
    return (None, *budgets, *SEVERITIES.get(name, ()))


Scalar = TypeVar("Scalar", bound=np.generic)
Arrays = dict[str, NDArray[np.float32]]

Key = tuple[int, int]
"""Epoch and index of a frame."""

BLANK = -1
"""Index of a padding frame without known cells: it makes the shares of all processes equally long."""


_FOR_ATTACK, _FOR_MASKS, _FOR_TURN = 1, 2, 3
"""Last entry of the seeds of :meth:`TrainingFrames._rng`."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingSample:
    """A training sample on the network's grid: a uint8 map and two masks, small enough to be cached.

    Unlike a :class:`~viewshed_lab.data.sample.Sample`, it holds neither the sweep nor its full truth.
    """

    maps: NDArray[np.uint8]  # (1, cells, cells) uint8, network input of the sweep, possibly attacked
    visible: NDArray[np.bool_]  # (cells, cells) bool, of the clean sweep
    known: NDArray[np.bool_]  # (cells, cells) bool, where ``visible`` is known

    def turned(self, turn: int) -> TrainingSample:
        """Return the sample rotated by ``turn`` modulo 4 quarter turns; for ``turn`` ≥ 4, x and y are swapped first.

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
    # (epoch, index) -> cached sample; None builds each sample on demand
    cached: Callable[[int, int], TrainingSample] | None = None
    mirrored: bool = False  # whether frames are rotated and mirrored at random

    def __len__(self) -> int:
        return len(self.source)

    def __getitem__(self, key: Key) -> Arrays:
        """Return the frame ``(epoch, index)`` as float32 arrays; random numbers depend only on seed and key.

        ``inputs`` (1, cells, cells): network input of the sweep, possibly attacked. ``visible`` and ``known``
        (cells, cells): 0 or 1, of the clean sweep. ``masks`` (M,): dropout masks, ones for ``mle``.

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
        """Build frame ``index`` with the attack of this epoch, without the cache."""
        clean = self.source.clean(index)
        rng = self._rng(epoch, index, _FOR_ATTACK)
        attacked = sample_attacked_sweep(self.config, clean.sweep, lambda: self.source.earlier(index), rng)
        return TrainingSample(self.config.card().maps_of(attacked), clean.visible, clean.known)

    def _rng(self, epoch: int, index: int, purpose: int) -> np.random.Generator:
        return np.random.default_rng([self.config.seed, epoch, index, purpose])


VALIDATION_EPOCH = 0
"""Epoch of all validation frames, so their attacks never change. Training epochs begin with 1."""


@dataclass(frozen=True, slots=True)
class Share:
    """One process's part of the frames."""

    rank: int = 0  # number of the process
    world: int = 1  # number of processes


@dataclass(slots=True)
class TrainingOrder:
    """Yields the keys of an epoch in random order; a sampler for torch's DataLoader.

    >>> list(TrainingOrder(4, 4, 7)) == sorted(TrainingOrder(4, 4, 7))
    False
    """

    frames: int  # number of frames
    frames_per_epoch: int  # number of frames that one epoch uses
    seed: int  # determines the order, together with the epoch
    share: Share = Share()  # this process's part; all parts are padded to equal length with the first frames
    epoch: int = 0  # number of the epoch, from 0; Lightning sets it

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch; Lightning calls this."""
        self.epoch = epoch

    def __len__(self) -> int:
        return math.ceil(self.frames_per_epoch / self.share.world)

    def __iter__(self) -> Iterator[Key]:
        rng = np.random.default_rng([self.seed, self.epoch + 1])
        order = np.resize(rng.permutation(self.frames)[: self.frames_per_epoch], len(self) * self.share.world)
        for index in order[self.share.rank :: self.share.world]:
            yield self.epoch + 1, int(index)


@dataclass(frozen=True, slots=True)
class ValidationOrder:
    """Yields the keys of the validation frames in order; a sampler for torch's DataLoader."""

    frames: int  # number of frames
    share: Share = Share()  # this process's part; all parts are padded to equal length with blank frames

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
    """Cached samples of a config, a row per frame: one byte per cell for its returns, two bits for the masks."""

    folder: Path  # of the files; its name is a hash of everything that determines the samples
    cells: int  # per side of the grid
    frames: int  # number of frames
    first: int  # epoch of the first version's attacks
    versions: int  # of each frame; later epochs cycle through them

    def frame(self, epoch: int, index: int) -> TrainingSample:
        """Return frame ``index`` in the version that ``epoch`` uses."""
        if not 0 <= index < self.frames:
            raise IndexError(f"index must be below {self.frames}, the number of frames, got {index}")
        block, row = divmod(index, _BLOCK)
        version = (epoch - self.first) % self.versions
        maps = mapped_array(self.path(version, block, _COUNTS))[row].reshape(1, self.cells, self.cells)
        truth = mapped_array(self.path(version, block, _TRUTH))[row]
        bits = np.unpackbits(truth, axis=1, count=self.cells**2).astype(np.bool_)
        return TrainingSample(maps, *bits.reshape(2, self.cells, self.cells))

    def path(self, version: int, block: int, name: str) -> Path:
        """Return the file of a block and version; ``name`` is ``counts`` or ``truth``."""
        return self.folder / f"{version}-{block}-{name}.npy"

    def build(self, frames: TrainingFrames, workers: int, on_progress: Callable[[int], None] | None = None) -> None:
        """Build the samples of the missing blocks in ``workers`` processes; see :func:`build_files`."""
        blocks = range(-(-self.frames // _BLOCK))
        places = [(version, block) for version in range(self.versions) for block in blocks]
        jobs = [(self, frames, *place) for place in places if not self.path(*place, _TRUTH).is_file()]
        build_files(_write_block, self.folder, jobs, workers, on_progress)


def sample_cache_of(
    config: TrainConfig, archives: tuple[Archive, ...], folder: Path, first: int, versions: int
) -> SampleCache:
    """Return the sample cache of archives below ``folder``; :meth:`SampleCache.build` fills it."""
    table = config.to_json()
    shards = [shard.sha256 for archive in archives for shard in archive.shards]
    settings = {key: table[key] for key in _CONFIG_KEYS}
    content = [_LAYOUT, viewshed.__version__, first, config.card().clip, settings, shards]
    name = hashlib.sha256(json.dumps(content).encode()).hexdigest()[:24]
    return SampleCache(folder / name, config.cells, sum(map(len, archives)), first, versions)


def _write_block(job: tuple[SampleCache, TrainingFrames, int, int]) -> int:
    """Write the counts and then the truth of a block, and return its number of frames."""
    cache, frames, version, block = job
    numbers = range(block * _BLOCK, min((block + 1) * _BLOCK, cache.frames))
    samples = [frames.draw(cache.first + version, number) for number in numbers]
    path = partial(cache.path, version, block)
    write_array(path(_COUNTS), np.stack([sample.maps.reshape(-1) for sample in samples]))
    bits = np.stack([np.reshape([sample.visible, sample.known], (2, -1)) for sample in samples])
    write_array(path(_TRUTH), np.packbits(bits, axis=2))
    return len(samples)
