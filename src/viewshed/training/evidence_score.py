"""Trains the score of a monitor's evidence on sweeps that are benign, attacked or degraded [torch]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import binary_cross_entropy_with_logits

from viewshed.integrity.evidence import SECTORS
from viewshed.integrity.score import SECTOR_FEATURES, SWEEP_FEATURES, EvidenceScore, SurpriseScale, features
from viewshed.training.whole_sweep import BATCH, EPOCH, WholeSweepTrainer

LEARNING_RATE = 2e-2

TOWARDS_PRIOR = 3e-3
"""Weight of the squared distance from the prior; it decides what becomes of evidence that training does not need."""

CONTEXT_PRIOR = 3e-2
"""The same for what the medians of all evidence add to each unit."""

ALONE_SHARE = 0.25
"""Share of the sweeps that are trained on as if nothing had been measured before."""

ABSTAIN_SHARE = 0.04
"""Chance that any one kind of evidence abstains in training."""

SECTOR_SHARE = 0.5
"""Weight of the sectors' loss beside the sweeps'."""

_PRIOR = ((0.5, 0.5, -1.0, 0.0, 0.0), (0.5, 0.5, 0.0, 0.0, 0.0), (0.3, 0.3, 0.4, 0.0, 0.0))
"""Of three banks, weights of a unit's own evidence: sector, neighbors, median, maximum, share of raised sectors.

The first bank looks at what a sector has beyond the rest of the sweep, the second at what it has, the third at the
whole sweep."""

_OUTPUT = (0, 0, 1)
"""The output that each bank adds to."""

_FEW = 20
"""Usual sweeps that evidence must speak of for its tail to be known."""

_LEAST_BEGIN, _LEAST_WIDTH = 0.5, 0.1

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
        usual: (N,) bool, benign sweeps in the proportions in which they occur: against these numbers are a surprise.
        earlier: (E,) bool, evidence that abstains where nothing was measured before.
    """

    names: tuple[str, ...]
    evidence: NDArray[np.floating[Any]]
    inconsistent: Floats
    degraded: Floats
    sectors: Floats
    weight: Floats
    usual: NDArray[np.bool_]
    earlier: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class ScoreTrainer:
    """Trains scores on any part of some examples; scale and features are computed once.

    There is a hidden unit for each evidence in each of three banks: what the evidence says of a sector, in surprises,
    beyond a threshold. It never falls when a surprise rises, and training begins at, and is pulled back to, a prior
    that takes all evidence alike. The prior begins where one usual sweep in ten has a sector, and rises by 1 where e
    times fewer have: the sum over evidence is that of Fisher's method. So evidence that none of the attacks in
    training needed still counts against one that was never seen. What honest causes raise in the whole sweep is
    learned from the medians of all evidence, the context.

    Attributes:
        examples: to train on.
        scale: of their usual sweeps.
    """

    examples: ScoreExamples
    scale: SurpriseScale
    _of_sectors: torch.Tensor
    _of_sweep: torch.Tensor
    _tails: Floats
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
        parts = []
        for start in range(0, len(examples.evidence), _CHUNK):
            of_sectors, of_sweep = features(scale(examples.evidence[start : start + _CHUNK]))
            parts.append((np.nan_to_num(of_sectors).astype(np.float16), np.nan_to_num(of_sweep)))
        of_sectors, of_sweep = (np.concatenate(column) for column in zip(*parts, strict=True))
        clear = examples.usual & (examples.degraded == 0)
        tails = [
            _tails(examples.evidence[rows], of_sectors[rows], of_sweep[rows], prior)
            for output, prior in zip(_OUTPUT, _PRIOR, strict=True)
            for rows in [clear if output and clear.any() else examples.usual]
        ]
        whole = WholeSweepTrainer.of(
            examples.evidence, (examples.inconsistent, examples.degraded), examples.weight, examples.usual,
            examples.earlier,
        )  # fmt: skip
        return cls(examples, scale, torch.from_numpy(of_sectors), torch.from_numpy(of_sweep), np.stack(tails), whole)

    def train(self, chosen: NDArray[np.bool_], epochs: int, seed: int) -> EvidenceScore:
        """Return the score trained on the chosen (N,) sweeps; the same seed, the same score on the same machine."""
        rng = np.random.Generator(np.random.PCG64(seed))
        units = _Units(self._tails)
        rows = np.flatnonzero(chosen)
        steps = epochs * -(-min(len(rows), EPOCH) // BATCH)
        optimizer = torch.optim.Adam(units.parameters(), LEARNING_RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        for batch in _batches(rows, epochs, rng):
            optimizer.zero_grad()
            loss = self._loss(batch, units, rng) + units.distance_from_prior()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            units.keep_monotone()
            schedule.step()
        # What evidence says that never spoke in training must not count.
        spoke = np.isfinite(self.examples.evidence).any(axis=(0, 2))
        score = units.score(self.examples.names, self.scale, spoke)
        return replace(score, whole=self._whole.train(chosen, epochs, seed))

    def _loss(self, rows: NDArray[np.intp], units: _Units, rng: np.random.Generator) -> torch.Tensor:
        kept = torch.from_numpy(self._kept(len(rows), rng))
        index = torch.from_numpy(rows)
        of_sectors = self._of_sectors[index].float() * kept.repeat(1, SECTOR_FEATURES)[:, None]
        of_sweep = self._of_sweep[index] * kept.repeat(1, SWEEP_FEATURES)
        logits = units(of_sectors, of_sweep)
        scores = torch.logsumexp(logits, 1) - np.log(SECTORS)
        examples, weight = self.examples, torch.from_numpy(self.examples.weight[rows])
        loss = _masked_loss(scores[:, 0], examples.inconsistent[rows], weight)
        loss = loss + _masked_loss(scores[:, 1], examples.degraded[rows], weight)
        sector_weight = weight[:, None].expand(-1, SECTORS) / SECTORS
        return loss + SECTOR_SHARE * _masked_loss(logits[..., 0], examples.sectors[rows], sector_weight)

    def _kept(self, count: int, rng: np.random.Generator) -> Floats:
        """Return 1 where evidence (count, E) speaks and 0 where it is made to abstain."""
        kept = rng.random((count, len(self.examples.names))) >= ABSTAIN_SHARE
        kept &= ~(self.examples.earlier & (rng.random((count, 1)) < ALONE_SHARE))
        return kept.astype(np.float32)


class _Units(torch.nn.Module):
    """A hidden unit for each evidence in each bank."""

    def __init__(self, tails: Floats) -> None:
        """Begin at the prior of tails (banks, E, 2): where each unit begins, and by how much it rises e-fold."""
        super().__init__()
        self.count = count = tails.shape[1]
        self.widths = torch.from_numpy(tails[..., 1])
        begin = -torch.from_numpy(tails[..., 0]) / self.widths
        prior = torch.tensor(_PRIOR)[:, None].repeat(1, count, 1)
        self.prior = torch.cat([prior, begin[..., None]], -1)
        self.own = torch.nn.Parameter(self.prior.clone())
        self.context = torch.nn.Parameter(torch.zeros(len(_PRIOR), count, count))
        self.heights = torch.nn.Parameter(torch.ones(len(_PRIOR), count))
        self.offsets = torch.nn.Parameter(torch.full((2,), -3.0))

    def forward(self, of_sectors: torch.Tensor, of_sweep: torch.Tensor) -> torch.Tensor:
        """Return both outputs (N, SECTORS, 2) of features (N, SECTORS, 2 E) and (N, 3 E)."""
        count = self.count
        logits = [self.offsets[output].expand(of_sectors.shape[:2]) for output in range(2)]
        sector, neighbors = of_sectors[..., :count], of_sectors[..., count:]
        median, maximum, raised = of_sweep[:, :count], of_sweep[:, count : 2 * count], of_sweep[:, 2 * count :]
        for bank, output in enumerate(_OUTPUT):
            width = self.widths[bank]
            a, b, c, d, e, limit = self.own[bank].T
            whole = (c * median + d * maximum + e * raised) / width + limit + median @ self.context[bank]
            units = torch.relu((a * sector + b * neighbors) / width + whole[:, None])
            logits[output] = logits[output] + units @ self.heights[bank]
        return torch.stack(logits, -1)

    def distance_from_prior(self) -> torch.Tensor:
        """Return the weighted squared distance of all parameters from where they began."""
        distance = ((self.own - self.prior) ** 2).sum() + ((self.heights - 1.0) ** 2).sum()
        return TOWARDS_PRIOR * distance + CONTEXT_PRIOR * (self.context**2).sum()

    def keep_monotone(self) -> None:
        """Keep what a sector's own surprise adds from falling below 0."""
        with torch.no_grad():
            self.own[..., :SECTOR_FEATURES].clamp_(min=0.0)
            self.heights.clamp_(min=0.0)

    def score(self, names: tuple[str, ...], scale: SurpriseScale, spoke: NDArray[np.bool_]) -> EvidenceScore:
        """Return the units as a score; evidence that never ``spoke`` (E,) adds nothing."""
        count, kinds, banks = self.count, SECTOR_FEATURES + SWEEP_FEATURES, len(_PRIOR)
        own, context, heights, offsets = (
            values.detach().numpy() for values in (self.own, self.context, self.heights, self.offsets)
        )
        weights, outputs = np.zeros((kinds, count, banks, count), np.float32), np.zeros((banks, count, 2), np.float32)
        for bank, output in enumerate(_OUTPUT):
            for kind in range(kinds):
                np.fill_diagonal(weights[kind, :, bank], own[bank, :, kind] / self.widths[bank].numpy())
            weights[SECTOR_FEATURES, :, bank] += context[bank]
            outputs[bank, spoke, output] = heights[bank, spoke]
        weights[:, ~spoke] = 0.0
        features_count = kinds * count
        return EvidenceScore(
            names, scale, np.zeros(features_count, np.float32), np.ones(features_count, np.float32),
            weights.reshape(features_count, banks * count), own[..., -1].reshape(-1).astype(np.float32),
            outputs.reshape(banks * count, 2), offsets.astype(np.float32),
        )  # fmt: skip


def _tails(
    evidence: NDArray[np.floating[Any]],
    of_sectors: NDArray[np.floating[Any]],
    of_sweep: NDArray[np.floating[Any]],
    prior: Sequence[float],
) -> Floats:
    """Return for each evidence (E, 2) what one usual sweep in ten exceeds in a sector, and what e times fewer add.

    Args:
        evidence: (N, E, SECTORS) of usual sweeps.
        of_sectors: (N, SECTORS, 2 E) features.
        of_sweep: (N, 3 E) features.
        prior: weights of sector, neighbors and median in a unit.
    """
    count = evidence.shape[1]
    tails = np.tile(np.array([2.0, 1.0], np.float32), (count, 1))
    for number in range(count):
        known = np.isfinite(evidence[:, number]).any(axis=1)
        if known.sum() >= _FEW:
            highest = (
                prior[0] * of_sectors[known, :, number].astype(np.float32)
                + prior[1] * of_sectors[known, :, count + number].astype(np.float32)
            ).max(axis=1) + prior[2] * of_sweep[known, number]
            begin, end = np.quantile(highest, (0.9, 0.99))
            tails[number] = max(begin, _LEAST_BEGIN), max((end - begin) / np.log(10.0), _LEAST_WIDTH)
    return tails


def _batches(rows: NDArray[np.intp], epochs: int, rng: np.random.Generator) -> Iterator[NDArray[np.intp]]:
    for _ in range(epochs):
        shuffled = rng.permutation(rows)[:EPOCH]
        yield from np.array_split(shuffled, -(-len(shuffled) // BATCH))


def _masked_loss(logits: torch.Tensor, labels: Floats, weight: torch.Tensor) -> torch.Tensor:
    """Return the weighted cross entropy of logits against labels, where these are known."""
    target = torch.from_numpy(labels)
    known = ~torch.isnan(target)
    losses = binary_cross_entropy_with_logits(logits[known], target[known], weight[known], reduction="sum")
    return losses / len(labels)
