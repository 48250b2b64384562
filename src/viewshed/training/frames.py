"""TrainingFrames: what the network is shown and what it should say, frame by frame; works with torch, needs none."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from viewshed.training.attacking import attacked
from viewshed.training.config import TrainConfig
from viewshed.training.sources import CleanFrames

Arrays = dict[str, NDArray[np.float32]]
Key = tuple[int, int]
"""Epoch and number of a frame."""
BLANK = -1
"""Number of a frame that counts nowhere: it makes the parts of several processes equally long."""


class _Purpose(IntEnum):
    ATTACK = 1
    MASKS = 2


@dataclass(frozen=True, slots=True, eq=False)
class TrainingFrames:
    """Frames of one config as a map-style data set, in any number of processes.

    Attributes:
        source: the clean frames.
        config: attacks, variant and seed.
    """

    source: CleanFrames
    config: TrainConfig

    def __len__(self) -> int:
        return len(self.source)

    def __getitem__(self, key: Key) -> Arrays:
        """Return the frame ``(epoch, number)`` as float32 arrays; all that is random follows from seed and key.

        ``inputs`` (1, cells, cells): what the network is shown, the sweep perhaps attacked; ``visible`` (cells, cells):
        0 or 1, of the clean sweep; ``known`` (cells, cells): 1 where that counts; ``masks`` (M,): dropout's, ones for
        ``mle``.

        Raises:
            IndexError: there is no such frame.
            ValueError: its shard is damaged.
            OSError: its shard cannot be read.
        """
        epoch, index = key
        if index == BLANK:
            return self._blank()
        clean = self.source.clean(epoch, index)
        rng = self._rng(epoch, index, _Purpose.ATTACK)
        sweep = attacked(self.config, clean.sweep, lambda: self.source.earlier(epoch, index), rng)
        masks = self.config.shape.masks(1, self._rng(epoch, index, _Purpose.MASKS))[0]
        return {
            "inputs": self.config.card().input_of(sweep),
            "visible": clean.visible.astype(np.float32),
            "known": clean.known.astype(np.float32),
            "masks": masks,
        }

    def _blank(self) -> Arrays:
        zeros, shape = np.zeros(self.config.grid.shape, np.float32), self.config.shape
        return {"inputs": zeros[None].copy(), "visible": zeros, "known": zeros.copy(), "masks": shape.no_masks(1)[0]}

    def _rng(self, epoch: int, index: int, purpose: int) -> np.random.Generator:
        return np.random.default_rng([self.config.seed, epoch, index, purpose])
