"""In which order an epoch shows its frames, and which process shows which."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.training.frames import BLANK, Key

VALIDATION_EPOCH = 0
"""Epoch in which validation frames are drawn: the same attacks every time. Training's begin with 1."""


@dataclass(frozen=True, slots=True)
class Share:
    """The part of one of several processes.

    Attributes:
        rank: number of the process.
        world: how many there are.
    """

    rank: int = 0
    world: int = 1


@dataclass(slots=True)
class TrainingOrder:
    """The frames of an epoch in an order of its own, as keys; a sampler for torch's DataLoader.

    Attributes:
        frames: how many there are.
        take: how many an epoch shows.
        block: so many in a row stay together.
        seed: with the epoch it decides the order.
        share: this process's part; all are equally long, the first frames fill up.
        epoch: number of the epoch, from 0; Lightning sets it.

    >>> list(TrainingOrder(4, 4, 1, 7)) == sorted(TrainingOrder(4, 4, 1, 7))
    False
    """

    frames: int
    take: int
    block: int
    seed: int
    share: Share = Share()
    epoch: int = 0

    def set_epoch(self, epoch: int) -> None:
        """Begin an epoch."""
        self.epoch = epoch

    def __len__(self) -> int:
        return math.ceil(self.take / self.share.world)

    def __iter__(self) -> Iterator[Key]:
        order = np.resize(self._order(), len(self) * self.share.world)
        for index in order[self.share.rank :: self.share.world]:
            yield self.epoch + 1, int(index)

    def _order(self) -> NDArray[np.int64]:
        rng = np.random.default_rng([self.seed, self.epoch + 1])
        blocks = rng.permutation(-(-self.frames // self.block))
        order = (blocks[:, None] * self.block + np.arange(self.block)).reshape(-1)
        return order[order < self.frames][: self.take]


@dataclass(frozen=True, slots=True)
class ValidationOrder:
    """The frames that validate, one after the other, as keys; a sampler for torch's DataLoader.

    Attributes:
        frames: how many there are.
        share: this process's part; all are equally long, blank frames fill up.
    """

    frames: int
    share: Share = Share()

    def __len__(self) -> int:
        return math.ceil(self.frames / self.share.world)

    def __iter__(self) -> Iterator[Key]:
        for step in range(len(self)):
            index = step * self.share.world + self.share.rank
            yield VALIDATION_EPOCH, index if index < self.frames else BLANK
