"""Clean frames to train on: of archives, or simulated anew for every epoch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.archive import Archive
from viewshed.datasets.frame import Frame
from viewshed.datasets.presets import Preset, preset_named
from viewshed.datasets.simulate import ScenePlan, simulate_frame
from viewshed.sweep import Sweep
from viewshed.training.config import TrainConfig
from viewshed.training.labels import PaperLabels, paper_label

FRESH_PER_SCENE = 8
"""Frames that are simulated of each fresh scene."""
_LOOK_BACK = 24
_FRESH = 0x7665777368


@dataclass(frozen=True, slots=True, eq=False)
class Clean:
    """A sweep that nobody attacked, and what there is to see.

    Attributes:
        sweep: what the sensor measured.
        visible: (cells, cells) bool, the truth or the label.
        known: (cells, cells) bool, where it is known.
    """

    sweep: Sweep
    visible: NDArray[np.bool_]
    known: NDArray[np.bool_]


class CleanFrames(Protocol):
    """Frames by number, in any process."""

    def __len__(self) -> int: ...

    @property
    def block(self) -> int:
        """Frames in a row that are best read one after the other; 1 where it does not matter."""
        ...

    def clean(self, epoch: int, index: int) -> Clean:
        """Return one frame."""
        ...

    def earlier(self, epoch: int, index: int, count: int = 1) -> tuple[Sweep, ...]:
        """Return the last ``count`` sweeps before it of the same sensor and scene, or as many as there are.

        The oldest comes first.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Archived:
    """The frames of archives, one after the other; the same in every epoch.

    Attributes:
        archives: what is read, each a part of a split.
        config: target and truth.
        labels: of the paper, where they are the truth.
        block: see :class:`CleanFrames`.
    """

    archives: tuple[Archive, ...]
    config: TrainConfig
    labels: PaperLabels | None = None
    block: int = 1

    def __len__(self) -> int:
        return sum(map(len, self.archives))

    def clean(self, epoch: int, index: int) -> Clean:
        """Return one frame, of any epoch.

        Raises:
            ValueError: its shard is damaged.
            OSError: its shard cannot be read.
        """
        archive, at = self._place(index)
        frame, shard = archive.frame(at)
        if self.labels is None:
            return _with_truth(frame, self.config)
        return _with_label(frame.sweep, self.labels.of_frame(shard, _row(archive, at)))

    def earlier(self, epoch: int, index: int, count: int = 1) -> tuple[Sweep, ...]:
        """Return the last sweeps before it of the same sensor and scene, the oldest first."""
        archive, at = self._place(index)
        frame, shard = archive.frame(at)
        found: list[Sweep] = []
        for before in range(at - 1, max(at - _LOOK_BACK, 0) - 1, -1):
            other, facts = archive.frame(before)
            if facts.scene != shard.scene or len(found) == count:
                break
            if other.measured.agent == frame.measured.agent:
                found.insert(0, other.sweep)
        return tuple(found)

    def _place(self, index: int) -> tuple[Archive, int]:
        for archive in self.archives:
            if index < len(archive):
                return archive, index
            index -= len(archive)
        raise IndexError(f"index must be below {len(self)}, the number of frames")


@dataclass(frozen=True, slots=True)
class Fresh:
    """Frames of scenes that no epoch has seen before; 8 of each scene, the presets in turn.

    Attributes:
        config: seed, presets and number of frames.
        count: frames of an epoch.
    """

    config: TrainConfig
    count: int

    def __len__(self) -> int:
        return self.count

    @property
    def block(self) -> int:
        """Frames of one scene."""
        return FRESH_PER_SCENE

    def clean(self, epoch: int, index: int) -> Clean:
        """Return one frame, simulated now."""
        frame = simulate_frame(*self._place(epoch, index))
        if self.config.truth == "probe":
            return _with_truth(frame, self.config)
        sweep = frame.sweep
        return _with_label(sweep, paper_label(sweep, self.config.grid, self.config.indoor))

    def earlier(self, epoch: int, index: int, count: int = 1) -> tuple[Sweep, ...]:
        """Return the sweeps of the same agent just before it, the oldest first; fewer at the start of a scene."""
        scene, number = self._place(epoch, index)
        before = range(number - scene.preset.agents, -1, -scene.preset.agents)[:count]
        return tuple(simulate_frame(scene, each).sweep for each in reversed(before))

    def _place(self, epoch: int, index: int) -> tuple[ScenePlan, int]:
        number, turn = divmod(index, FRESH_PER_SCENE)
        config = self.config
        preset = fresh_preset(config, config.data[number % len(config.data)], epoch, len(self))
        scene = ScenePlan(preset, 0, number)
        rng = np.random.default_rng([config.seed, epoch, number, _FRESH])
        return scene, int(rng.permutation(scene.frames)[turn % scene.frames])


@lru_cache(maxsize=16)
def fresh_preset(config: TrainConfig, name: str, epoch: int, frames: int) -> Preset:
    """Return the preset with one split of new scenes, enough for ``frames``, on the config's grid."""
    preset = preset_named(name)
    at = preset.splits.index(config.train_split)
    scenes = -(-frames // FRESH_PER_SCENE)
    length = preset.frames[at] // preset.scenes[at]
    seed = int(np.random.SeedSequence([config.seed, epoch, _FRESH]).generate_state(1)[0])
    return replace(on_grid(preset, config), splits=("fresh",), scenes=(scenes,), frames=(scenes * length,), seed=seed)


def on_grid(preset: Preset, config: TrainConfig) -> Preset:
    """Return the preset with its truth on the config's grid."""
    return replace(preset, grid_cells=config.cells, grid_half_extent_m=config.half_extent_m)


def _row(archive: Archive, at: int) -> int:
    """Return the row that a frame has in its shard."""
    for shard in archive.shards:
        if at < shard.frames:
            return at
        at -= shard.frames
    raise IndexError(f"index must be below {len(archive)}, the number of frames")


def _with_truth(frame: Frame, config: TrainConfig) -> Clean:
    return Clean(frame.sweep, frame.truth.visible(config.target), frame.known)


def _with_label(sweep: Sweep, label: NDArray[np.bool_]) -> Clean:
    return Clean(sweep, label, np.ones(label.shape, np.bool_))


def check_archives(config: TrainConfig, archives: Sequence[Archive]) -> None:
    """Check that archives have what the config wants to learn.

    Raises:
        ValueError: an archive's grid, targets, splits or sweeps are not those that are needed.
    """
    for archive in archives:
        layout, place = archive.manifest.layout, archive.store.place
        if config.train_split not in archive.splits:
            raise ValueError(f"train_split must be one of {', '.join(archive.splits)} of {place}, got "
                             f"{config.train_split!r}")  # fmt: skip
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
