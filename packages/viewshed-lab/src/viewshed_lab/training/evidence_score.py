"""Trains the score of a monitor's evidence on sweeps that are benign, attacked or degraded [torch]."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import binary_cross_entropy_with_logits

from viewshed.arrays import F32
from viewshed.monitor.evidence import SECTORS
from viewshed.monitor.score import SECTOR_FEATURES, SWEEP_FEATURES, EvidenceScore, SurpriseScale, features
from viewshed_lab.training.whole_sweep import WholeSweepTrainer

LEARNING_RATE = 5e-3

DECAY = 1e-4

ALONE_SHARE = 0.25
"""Share of the sweeps that are trained on as if nothing had been measured before."""

ABSTAIN_SHARE = 0.04
"""Chance that any one kind of evidence abstains in training."""

UNITS = 64

SECTOR_EPOCH = 8192
"""Sweeps of an epoch of the network of sectors at most."""

SECTOR_BATCH = 128

_CHUNK = 4096


@dataclass(frozen=True, slots=True, eq=False)
class ScoreExamples:
    """Sweeps to train on; NaN where a label is not known."""

    names: tuple[str, ...]  # (E,) of the evidence
    evidence: NDArray[np.floating[Any]]  # (N, E, SECTORS) floats
    inconsistent: F32  # (N,) 1 where a sweep is attacked, 0 where it is benign, however bad
    degraded: F32  # (N,) 1 where a sweep shows less or worse, 0 where it is as good as can be
    sectors: F32  # (N, SECTORS) 1 where a sector is attacked
    weight: F32  # (N,) of the sweeps
    # (N,) bool, benign sweeps in the proportions in which they occur: against these numbers are a surprise
    usual: NDArray[np.bool_]
    earlier: NDArray[np.bool_]  # (E,) bool, evidence that abstains where nothing was measured before


@dataclass(frozen=True, slots=True, eq=False)
class ScoreTrainer:
    """Trains scores on any part of some examples; surprises and statistics are computed once.

    A network of one hidden layer learns which sectors are attacked, from what a sector and its neighbors say and from
    the whole sweep. How much doubt there is in all is learned apart, from statistics of whole sweeps.
    """

    examples: ScoreExamples  # to train on
    scale: SurpriseScale  # of their usual sweeps
    _surprises: NDArray[np.float16]
    _whole: WholeSweepTrainer

    @classmethod
    def of(cls, examples: ScoreExamples) -> ScoreTrainer:
        """Return the trainer of some examples.

        Raises:
            ValueError: none is usual.
        """
        if not examples.usual.any():
            raise ValueError("a score needs benign sweeps to train on, got none")
        scale = SurpriseScale.fit(examples.evidence[examples.usual])
        starts = range(0, len(examples.evidence), _CHUNK)
        surprises = [scale(examples.evidence[start : start + _CHUNK]).astype(np.float16) for start in starts]
        whole = WholeSweepTrainer.of(
            examples.evidence, (examples.inconsistent, examples.degraded), examples.weight, examples.usual,
            examples.earlier,
        )  # fmt: skip
        return cls(examples, scale, np.concatenate(surprises), whole)

    def train(
        self, chosen: NDArray[np.bool_], epochs: int, seed: int, *, sector_epochs: int | None = None
    ) -> EvidenceScore:
        """Return the score trained on the chosen (N,) sweeps; the same seed, the same score on the same machine.

        Args:
            chosen: (N,) sweeps.
            epochs: of the training.
            seed: of all that is random.
            sector_epochs: of the network of sectors, which says where and not how much; ``epochs`` if not given.
        """
        rng = np.random.Generator(np.random.PCG64(seed))
        layers = _Layers(len(self.examples.names), rng)
        rows = np.flatnonzero(chosen)
        batches = list(_batches(rows, epochs if sector_epochs is None else sector_epochs, rng))
        optimizer = torch.optim.Adam(layers.parameters(), LEARNING_RATE, weight_decay=DECAY)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(len(batches), 1))
        for batch in batches:
            optimizer.zero_grad()
            self._loss(batch, layers, rng).backward()
            optimizer.step()
            schedule.step()
        # What evidence says that never spoke in training must not count.
        spoke = np.isfinite(self.examples.evidence).any(axis=(0, 2))
        score = layers.score(self.examples.names, self.scale, spoke)
        return replace(score, whole=self._whole.train(chosen, epochs, seed))

    def _loss(self, rows: NDArray[np.intp], layers: _Layers, rng: np.random.Generator) -> torch.Tensor:
        surprises = self._surprises[rows].astype(np.float32)
        surprises[~self._kept(len(rows), rng)] = np.nan
        of_sectors, of_sweep = features(surprises)
        logits = layers(torch.from_numpy(of_sectors), torch.from_numpy(np.nan_to_num(of_sweep)))
        examples = self.examples
        weight = torch.from_numpy(examples.weight[rows])[:, None].expand(-1, SECTORS) / SECTORS
        # Weather and faults are anywhere: all sectors of a degraded sweep are.
        degraded = np.repeat(examples.degraded[rows, None], SECTORS, axis=1)
        return _masked_loss(logits[..., 0], examples.sectors[rows], weight) + _masked_loss(
            logits[..., 1], degraded, weight
        )

    def _kept(self, count: int, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Return which evidence (count, E) speaks and is not made to abstain."""
        kept = rng.random((count, len(self.examples.names))) >= ABSTAIN_SHARE
        kept &= ~(self.examples.earlier & (rng.random((count, 1)) < ALONE_SHARE))
        return kept


class _Layers(torch.nn.Module):
    """The layers of the network of sectors."""

    def __init__(self, kinds: int, rng: np.random.Generator) -> None:
        super().__init__()
        inputs = SECTOR_FEATURES * kinds
        first = rng.normal(size=(inputs + SWEEP_FEATURES * kinds, UNITS)) * 0.1
        first[inputs:] *= 0.3
        self.inputs = inputs
        self.first, self.offsets, self.outputs, self.output_offsets = (
            torch.nn.Parameter(torch.from_numpy(values.astype(np.float32)))
            for values in (first, np.zeros(UNITS), rng.normal(size=(UNITS, 2)) * 0.1, np.full(2, -3.0))
        )

    def forward(self, of_sectors: torch.Tensor, of_sweep: torch.Tensor) -> torch.Tensor:
        """Return both outputs (N, SECTORS, 2) of features (N, SECTORS, …) and (N, …)."""
        of_all = of_sweep @ self.first[self.inputs :] + self.offsets
        return torch.relu(of_sectors @ self.first[: self.inputs] + of_all[:, None]) @ self.outputs + self.output_offsets

    def score(self, names: tuple[str, ...], scale: SurpriseScale, spoke: NDArray[np.bool_]) -> EvidenceScore:
        """Return the layers as a score; evidence that never ``spoke`` (E,) adds nothing."""
        first, offsets, outputs, output_offsets = (
            values.detach().numpy().copy() for values in (self.first, self.offsets, self.outputs, self.output_offsets)
        )
        first[np.tile(~spoke, len(first) // len(spoke))] = 0.0
        zeros, ones = np.zeros(len(first), np.float32), np.ones(len(first), np.float32)
        return EvidenceScore(names, scale, zeros, ones, first, offsets, outputs, output_offsets)


def _batches(rows: NDArray[np.intp], epochs: int, rng: np.random.Generator) -> Iterator[NDArray[np.intp]]:
    for _ in range(epochs):
        shuffled = rng.permutation(rows)[:SECTOR_EPOCH]
        yield from np.array_split(shuffled, -(-len(shuffled) // SECTOR_BATCH))


def _masked_loss(logits: torch.Tensor, labels: F32, weight: torch.Tensor) -> torch.Tensor:
    """Return the weighted cross entropy of logits against labels, where these are known."""
    target = torch.from_numpy(labels)
    known = ~torch.isnan(target)
    losses = binary_cross_entropy_with_logits(logits[known], target[known], weight[known], reduction="sum")
    return losses / len(labels)
