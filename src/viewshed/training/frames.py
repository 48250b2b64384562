"""TrainingFrames: what the network is shown and what it should say, frame by frame; works with torch, needs none."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from viewshed.evaluation import unorganised_no_sensor
from viewshed.past import PAST_SWEEPS
from viewshed.sweep import Sweep
from viewshed.training.attacking import Struck, attacked
from viewshed.training.config import TrainConfig
from viewshed.training.sources import CleanFrames

Scalar = TypeVar("Scalar", bound=np.generic)
Arrays = dict[str, NDArray[np.float32]]
Key = tuple[int, int]
"""Epoch and number of a frame."""
BLANK = -1
"""Number of a frame that counts nowhere: it makes the parts of several processes equally long."""
_LASTING = 0.5
"""Share of the attacks that had begun before the earlier sweeps."""


class _Purpose(IntEnum):
    ATTACK = 1
    MASKS = 2
    TURN = 3
    RINGS = 4
    PAST = 5


class KeptFrames(Protocol):
    """Frames that were made before."""

    def frame(self, epoch: int, index: int) -> Drawn:
        """Return one of them."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A frame before it is shown to the network.

    Attributes:
        maps: (channels, cells, cells) uint8, what the network is shown of the sweep, perhaps attacked.
        visible: (cells, cells) bool, of the clean sweep.
        known: (cells, cells) bool, where that counts.
    """

    maps: NDArray[np.uint8]
    visible: NDArray[np.bool_]
    known: NDArray[np.bool_]

    def turned(self, turn: int) -> Drawn:
        """Return the frame after ``turn`` modulo 4 quarter turns; from 4 on its x and y change places first.

        >>> Drawn(np.array([[[1, 2], [3, 4]]]), np.eye(2, dtype=bool), np.eye(2, dtype=bool)).turned(5).maps.tolist()
        [[[3, 4], [1, 2]]]
        """
        return Drawn(_turned(self.maps, turn), _turned(self.visible, turn), _turned(self.known, turn))


def _turned(maps: NDArray[Scalar], turn: int) -> NDArray[Scalar]:
    return np.rot90(maps.swapaxes(-2, -1) if turn >= 4 else maps, turn % 4, axes=(-2, -1))


@dataclass(frozen=True, slots=True, eq=False)
class TrainingFrames:
    """Frames of one config as a map-style data set, in any number of processes.

    Attributes:
        source: the clean frames.
        config: attacks, variant and seed.
        kept: frames that were made before; None makes each when it is asked for.
        mirrored: whether frames are turned and mirrored at random.
    """

    source: CleanFrames
    config: TrainConfig
    kept: KeptFrames | None = None
    mirrored: bool = False

    def __len__(self) -> int:
        return len(self.source)

    def __getitem__(self, key: Key) -> Arrays:
        """Return the frame ``(epoch, number)`` as float32 arrays; all that is random follows from seed and key.

        ``inputs`` (channels, cells, cells): what the network is shown, the sweep perhaps attacked; ``visible`` and
        ``known`` (cells, cells): 0 or 1, of the clean sweep, and 1 where that counts; ``masks`` (M,): dropout's, ones
        for ``mle``.

        Raises:
            IndexError: there is no such frame.
            ValueError: its shard is damaged.
            OSError: its shard cannot be read.
        """
        epoch, index = key
        if index == BLANK:
            return self._blank()
        drawn = self.draw(epoch, index) if self.kept is None else self.kept.frame(epoch, index)
        if self.mirrored:
            drawn = drawn.turned(int(self._rng(epoch, index, _Purpose.TURN).integers(8)))
        return {
            "inputs": self.config.card().shown(drawn.maps),
            "visible": drawn.visible.astype(np.float32),
            "known": drawn.known.astype(np.float32),
            "masks": self.config.shape.masks(1, self._rng(epoch, index, _Purpose.MASKS))[0],
        }

    def draw(self, epoch: int, index: int) -> Drawn:
        """Return a frame made now, with the attack of this epoch."""
        clean = self.source.clean(epoch, index)
        rng = self._rng(epoch, index, _Purpose.ATTACK)
        struck = attacked(self.config, clean.sweep, lambda: self.source.earlier(epoch, index), rng)
        shown = struck.sweep, *self._past(epoch, index, struck)
        if self._rng(epoch, index, _Purpose.RINGS).random() < self.config.ringless_share:
            shown = tuple(map(unorganised_no_sensor, shown))
        return Drawn(self.config.card().maps_of(shown[0], shown[1:]), clean.visible, clean.known)

    def _past(self, epoch: int, index: int, struck: Struck) -> tuple[Sweep, ...]:
        """Return the earlier sweeps that are shown with a frame; attacked as well under half of the attacks."""
        rng = self._rng(epoch, index, _Purpose.PAST)
        if rng.random() >= self.config.past_share or not self.config.card().uses_past:
            return ()
        earlier = self.source.earlier(epoch, index, int(rng.integers(1, PAST_SWEEPS + 1)))
        return struck.before(earlier, rng) if rng.random() < _LASTING else earlier

    def _blank(self) -> Arrays:
        zeros, shape = np.zeros(self.config.grid.shape, np.float32), self.config.shape
        inputs = np.zeros((shape.channels, *zeros.shape), np.float32)
        return {"inputs": inputs, "visible": zeros, "known": zeros.copy(), "masks": shape.no_masks(1)[0]}

    def _rng(self, epoch: int, index: int, purpose: int) -> np.random.Generator:
        return np.random.default_rng([self.config.seed, epoch, index, purpose])
