"""Trains what judges the statistics of whole sweeps, the part of a monitor's score that looks at no sector [torch]."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import binary_cross_entropy_with_logits

from viewshed.arrays import F32
from viewshed.monitor.score import (
    STATISTICS,
    StatisticsNetwork,
    SurpriseScale,
    WholeSweep,
    parts_of,
    statistics,
    surprises_of_statistics,
)

BATCH = 256

EPOCH = 16384
"""Sweeps of an epoch at most; others are drawn in the next."""

LEARNING_RATE = 1e-2

DECAY = 1e-4

ABSTAIN_SHARE = 0.08
"""Chance that any one kind of evidence abstains in training: a family that was never seen shows in few."""

ALONE_SHARE = 0.25
"""Share of the sweeps that are trained on as if nothing had been measured before."""

UNITS, SECOND_UNITS = 48, 18

_CHUNK = 4096


@dataclass(frozen=True, slots=True)
class Freedom:
    """What a network may do with statistics."""

    falls: bool  # with any of them, not only with medians
    context: bool  # sees the medians
    epochs: int  # for each epoch that was given


IN_CONTEXT = Freedom(falls=False, context=True, epochs=8)
BY_ITSELF = Freedom(falls=False, context=False, epochs=1)
"""Few epochs: without context, more of them only fit the families that are there."""
DEGRADED = Freedom(falls=True, context=True, epochs=6)
"""Fewer beams and lower returns make numbers fall, so that this one must be free."""


@dataclass(frozen=True, slots=True, eq=False)
class WholeSweepTrainer:
    """Trains on any part of some sweeps; scale and statistics are computed once."""

    scale: SurpriseScale  # of the statistics of usual sweeps
    surprises: F32  # (N, STATISTICS E) of all
    inconsistent: F32  # (N,) 1 where a sweep is attacked, 0 where it is benign, NaN where that is open
    degraded: F32  # (N,) 1 where a sweep shows less or worse, 0 where it is as good as can be, NaN where that is open
    weight: F32  # (N,) of the sweeps
    usual: NDArray[np.bool_]  # (N,) bool, benign sweeps in the proportions in which they occur, with all earlier ones
    earlier: NDArray[np.bool_]  # (E,) bool, evidence that abstains where nothing was measured before
    _degraded: dict[tuple[bytes, int, int], StatisticsNetwork] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        evidence: NDArray[np.floating],
        labels: tuple[F32, F32],
        weight: F32,
        usual: NDArray[np.bool_],
        earlier: NDArray[np.bool_],
    ) -> WholeSweepTrainer:
        """Return the trainer of evidence (N, E, SECTORS) labeled as inconsistent and as degraded."""
        chunks = range(0, len(evidence), _CHUNK)
        numbers = np.concatenate([statistics(evidence[start : start + _CHUNK]) for start in chunks])
        spoke = np.isfinite(numbers[:, : len(earlier)])
        complete = usual & spoke[:, earlier].any(axis=1) if earlier.any() else usual
        usual = complete if complete.any() else usual
        scale = SurpriseScale.fit(numbers[usual][..., None])
        surprises = np.concatenate(
            [surprises_of_statistics(scale, numbers[start : start + _CHUNK]) for start in chunks]
        )
        return cls(scale, surprises, *labels, weight, usual, earlier)

    def train(self, chosen: NDArray[np.bool_], epochs: int, seed: int) -> WholeSweep:
        """Return what judges whole sweeps, trained on the chosen (N,) of them; the same seed, the same networks."""
        in_context, by_itself = (
            self._network(chosen, self.inconsistent, self.weight, freedom, epochs, seed)
            for freedom in (IN_CONTEXT, BY_ITSELF)
        )
        # Where only attacks are left out, and none of them has a label, this network is the same every time.
        key = (np.packbits(chosen & np.isfinite(self.degraded)).tobytes(), epochs, seed)
        if key not in self._degraded:
            balanced = self._balanced(chosen)
            self._degraded[key] = self._network(chosen, self.degraded, balanced, DEGRADED, epochs, seed)
        degraded = self._degraded[key]
        parts = parts_of(self.surprises[self.usual], in_context, by_itself)
        return WholeSweep(self.scale, in_context, by_itself, degraded, SurpriseScale.fit(parts[..., None]))

    def _balanced(self, chosen: NDArray[np.bool_]) -> F32:
        """Return weights (N,) that give degraded and other sweeps half each, 1 on average."""
        weight = np.zeros(len(chosen))
        for label in (0.0, 1.0):
            mask = chosen & (self.degraded == label)
            weight[mask] = 0.5 / max(mask.sum(), 1)
        return (weight * np.count_nonzero(weight)).astype(np.float32)

    def _network(
        self, chosen: NDArray[np.bool_], labels: F32, weight: F32, freedom: Freedom, epochs: int, seed: int
    ) -> StatisticsNetwork:
        rng = np.random.Generator(np.random.PCG64(seed))
        kinds = len(self.earlier)
        layers = _Layers(kinds, freedom, rng)
        rows = np.flatnonzero(chosen & np.isfinite(labels))
        batches = list(_batches(rows, epochs * freedom.epochs, rng))
        optimizer = torch.optim.Adam(layers.parameters(), LEARNING_RATE, weight_decay=DECAY)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(len(batches), 1))
        for batch in batches:
            kept = rng.random((len(batch), kinds)) >= ABSTAIN_SHARE
            kept &= ~(self.earlier & (rng.random((len(batch), 1)) < ALONE_SHARE))
            outputs = layers(torch.from_numpy(self.surprises[batch] * np.tile(kept, STATISTICS)))
            losses = binary_cross_entropy_with_logits(outputs, torch.from_numpy(labels[batch]), reduction="none")
            optimizer.zero_grad()
            (losses * torch.from_numpy(weight[batch])).mean().backward()
            optimizer.step()
            layers.keep_bounds()
            schedule.step()
        return layers.network()


class _Layers(torch.nn.Module):
    """The layers of a network, begun small and rising."""

    def __init__(self, kinds: int, freedom: Freedom, rng: np.random.Generator) -> None:
        super().__init__()
        self.kinds, self.freedom = kinds, freedom
        inputs = STATISTICS * kinds
        first = rng.random((inputs, UNITS)) * 0.08
        second = rng.random((UNITS + inputs, SECOND_UNITS)) * 0.1
        outputs = np.concatenate([rng.random(SECOND_UNITS) * 0.2, np.full(inputs, 0.02)])
        first[-kinds:] = (rng.random((kinds, UNITS)) - 0.5) * 0.1
        second[-kinds:] = (rng.random((kinds, SECOND_UNITS)) - 0.5) * 0.05
        outputs[-kinds:] = 0.0
        offsets = [0.5 - 2.0 * rng.random(UNITS), 0.3 - rng.random(SECOND_UNITS), np.array([-1.0])]
        self.first, self.second, self.outputs, self.offsets = (
            torch.nn.Parameter(torch.from_numpy(values.astype(np.float32)))
            for values in (first, second, outputs, np.concatenate(offsets))
        )
        self.keep_bounds()

    def forward(self, surprises: torch.Tensor) -> torch.Tensor:
        """Return the output (N,) for surprises (N, F)."""
        hidden = _rectified(surprises @ self.first + self.offsets[:UNITS])
        seen = torch.cat([hidden, surprises], 1)
        deeper = _rectified(seen @ self.second + self.offsets[UNITS:-1])
        return torch.cat([deeper, surprises], 1) @ self.outputs + self.offsets[-1]

    def keep_bounds(self) -> None:
        """Keep the output from falling with a statistic that is no median; hide the medians from a network without."""
        with torch.no_grad():
            # Of the statistics the second layer sees the medians alone, the others through the first.
            self.second[UNITS : -self.kinds] = 0.0
            for weights in (self.first, self.second, self.outputs):
                if not self.freedom.falls:
                    weights[: -self.kinds].clamp_(min=0.0)
                if not self.freedom.context:
                    weights[-self.kinds :] = 0.0

    def network(self) -> StatisticsNetwork:
        """Return the layers as arrays."""
        layers = (self.first, self.second, self.outputs, self.offsets)
        return StatisticsNetwork(*(values.detach().numpy().copy() for values in layers))


def _rectified(values: torch.Tensor) -> torch.Tensor:
    low, middle, high = values.chunk(3, 1)
    return torch.cat([torch.relu(low), torch.clamp(middle, max=1.0), torch.clamp(high, -1.0, 1.0)], 1)


def _batches(rows: NDArray[np.intp], epochs: int, rng: np.random.Generator) -> Iterator[NDArray[np.intp]]:
    for _ in range(epochs if len(rows) else 0):
        shuffled = rng.permutation(rows)[:EPOCH]
        yield from np.array_split(shuffled, -(-len(shuffled) // BATCH))
