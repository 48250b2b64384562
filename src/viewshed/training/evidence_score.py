"""Trains the score of a monitor's evidence on sweeps that are benign, attacked or degraded [torch]."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import binary_cross_entropy_with_logits

from viewshed.integrity.evidence import SECTORS
from viewshed.integrity.score import SECTOR_FEATURES, SWEEP_FEATURES, EvidenceScore, SurpriseScale, features

HIDDEN = 32

BATCH = 256

LEARNING_RATE = 3e-3

WEIGHT_DECAY = 1e-3

ALONE_SHARE = 0.25
"""Share of the sweeps that are trained on as if nothing had been measured before."""

ABSTAIN_SHARE = 0.04
"""Chance that any one kind of evidence abstains in training."""

SECTOR_SHARE = 0.5
"""Weight of the sectors' loss beside the sweeps'."""

_CHUNK = 4096

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class ScoreExamples:
    """Sweeps to train on; NaN where a label is not known.

    Attributes:
        names: (E,) of the evidence.
        evidence: (N, E, SECTORS) floats.
        inconsistent: (N,) 1 where a sweep is attacked, 0 where it is benign, however bad.
        degraded: (N,) 1 where a sweep shows less or worse, 0 where it is as good as can be.
        sectors: (N, SECTORS) 1 where a sector is attacked.
        weight: (N,) of the sweeps.
        earlier: (E,) bool, evidence that abstains where nothing was measured before.
    """

    names: tuple[str, ...]
    evidence: NDArray[np.floating[Any]]
    inconsistent: Floats
    degraded: Floats
    sectors: Floats
    weight: Floats
    earlier: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class _Features:
    """Features of all sweeps, standardized; 0 where evidence abstains."""

    of_sectors: torch.Tensor
    of_sweep: torch.Tensor
    mean: Floats
    spread: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ScoreTrainer:
    """Trains scores on any part of some examples; scale and features are computed once.

    Attributes:
        examples: to train on.
        scale: of their benign sweeps of a good view, so that bad weather is a surprise in all sectors.
    """

    examples: ScoreExamples
    scale: SurpriseScale
    _features: _Features

    @classmethod
    def of(cls, examples: ScoreExamples) -> ScoreTrainer:
        """Return the trainer of some examples.

        Raises:
            ValueError: none is benign with a good view.
        """
        benign = examples.inconsistent == 0
        clear = benign & (examples.degraded == 0)
        if not clear.any():
            raise ValueError("a score needs benign sweeps of a good view to train on, got none")
        scale = SurpriseScale.fit(examples.evidence[clear])
        return cls(examples, scale, _features_of(examples, scale, benign))

    def train(self, chosen: NDArray[np.bool_], epochs: int, seed: int) -> EvidenceScore:
        """Return the score trained on the chosen (N,) sweeps; the same seed, the same score on the same machine."""
        torch.manual_seed(seed)
        rng = np.random.Generator(np.random.PCG64(seed))
        count = len(self._features.mean)
        hidden, outputs = torch.nn.Linear(count, HIDDEN), torch.nn.Linear(HIDDEN, 2)
        network = torch.nn.ModuleList([hidden, outputs])
        rows = np.flatnonzero(chosen)
        steps = epochs * -(-len(rows) // BATCH)
        optimizer = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=WEIGHT_DECAY)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, LEARNING_RATE, total_steps=steps)
        for batch in _batches(rows, epochs, rng):
            optimizer.zero_grad()
            self._loss(batch, hidden, outputs, rng).backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            schedule.step()
        weights, offsets, out, out_offsets = (
            values.detach().numpy() for values in (hidden.weight.T, hidden.bias, outputs.weight.T, outputs.bias)
        )
        # What evidence says that never spoke in training must not count.
        spoke = np.isfinite(self.examples.evidence).any(axis=(0, 2))
        heard = np.tile(spoke, SECTOR_FEATURES + SWEEP_FEATURES)[:, None]
        return EvidenceScore(
            self.examples.names, self.scale, self._features.mean, self._features.spread,
            np.ascontiguousarray(weights * heard, np.float32), offsets, np.ascontiguousarray(out), out_offsets,
        )  # fmt: skip

    def _loss(
        self, rows: NDArray[np.intp], hidden: torch.nn.Linear, outputs: torch.nn.Linear, rng: np.random.Generator
    ) -> torch.Tensor:
        kept = torch.from_numpy(self._kept(len(rows), rng))
        index = torch.from_numpy(rows)
        of_sectors = self._features.of_sectors[index].float() * kept.repeat(1, SECTOR_FEATURES)[:, None]
        of_sweep = self._features.of_sweep[index] * kept.repeat(1, SWEEP_FEATURES)
        split = of_sectors.shape[-1]
        units = of_sectors @ hidden.weight[:, :split].T + (of_sweep @ hidden.weight[:, split:].T + hidden.bias)[:, None]
        logits = outputs(torch.relu(units))
        pooled = torch.logsumexp(logits, 1) - np.log(SECTORS)
        examples, weight = self.examples, torch.from_numpy(self.examples.weight[rows])
        loss = _masked_loss(pooled[:, 0], examples.inconsistent[rows], weight)
        loss = loss + _masked_loss(pooled[:, 1], examples.degraded[rows], weight)
        sector_weight = weight[:, None].expand(-1, SECTORS) / SECTORS
        return loss + SECTOR_SHARE * _masked_loss(logits[..., 0], examples.sectors[rows], sector_weight)

    def _kept(self, count: int, rng: np.random.Generator) -> Floats:
        """Return 1 where evidence (count, E) speaks and 0 where it is made to abstain."""
        kept = rng.random((count, len(self.examples.names))) >= ABSTAIN_SHARE
        kept &= ~(self.examples.earlier & (rng.random((count, 1)) < ALONE_SHARE))
        return kept.astype(np.float32)


def _batches(rows: NDArray[np.intp], epochs: int, rng: np.random.Generator) -> Iterator[NDArray[np.intp]]:
    for _ in range(epochs):
        shuffled = rng.permutation(rows)
        yield from np.array_split(shuffled, -(-len(rows) // BATCH))


def _features_of(examples: ScoreExamples, scale: SurpriseScale, benign: NDArray[np.bool_]) -> _Features:
    """Return the features of all examples, standardized by those of benign ones."""
    parts: list[tuple[Floats, Floats]] = []
    for start in range(0, len(examples.evidence), _CHUNK):
        of_sectors, of_sweep = features(scale(examples.evidence[start : start + _CHUNK]))
        parts.append((of_sectors.astype(np.float16), of_sweep))
    of_sectors, of_sweep = (np.concatenate(column) for column in zip(*parts, strict=True))
    moments = [_moments(of_sectors[benign].reshape(-1, of_sectors.shape[-1])), _moments(of_sweep[benign])]
    mean, spread = (np.concatenate(values) for values in zip(*moments, strict=True))
    split = of_sectors.shape[-1]
    for start in range(0, len(of_sectors), _CHUNK):
        part = slice(start, start + _CHUNK)
        of_sectors[part] = np.nan_to_num((of_sectors[part] - mean[:split]) / spread[:split])
    of_sweep = np.nan_to_num((of_sweep - mean[split:]) / spread[split:])
    return _Features(torch.from_numpy(of_sectors), torch.from_numpy(of_sweep), mean, spread)


def _moments(values: NDArray[np.floating[Any]]) -> tuple[Floats, Floats]:
    """Return mean and standard deviation (F,) of the known values (N, F); 0 and 1 where there are none."""
    known = np.isfinite(values)
    count = np.maximum(known.sum(axis=0), 1)
    filled = np.where(known, values, 0.0).astype(np.float32)
    mean = filled.sum(axis=0, dtype=np.float64) / count
    variance = (filled.astype(np.float64) ** 2).sum(axis=0) / count - mean**2
    spread = np.sqrt(np.maximum(variance, 0.0))
    return mean.astype(np.float32), np.where(spread > 1e-3, spread, 1.0).astype(np.float32)


def _masked_loss(logits: torch.Tensor, labels: Floats, weight: torch.Tensor) -> torch.Tensor:
    """Return the weighted cross entropy of logits against labels, where these are known."""
    target = torch.from_numpy(labels)
    known = ~torch.isnan(target)
    losses = binary_cross_entropy_with_logits(logits[known], target[known], weight[known], reduction="sum")
    return losses / len(labels)
