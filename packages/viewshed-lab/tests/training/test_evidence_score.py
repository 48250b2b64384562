"""Training of the score: it finds what it was shown and what is rare, tells one sector from all, ignores silence."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from viewshed.monitor.evidence import SECTORS
from viewshed.monitor.roc import auroc
from viewshed_lab.training.evidence_score import ScoreExamples, ScoreTrainer

COUNT = 600


def _examples(seed: int) -> ScoreExamples:
    """Return sweeps, some attacked in five sectors, some rained on in all; the third evidence never spoke."""
    rng = np.random.Generator(np.random.PCG64(seed))
    evidence = rng.exponential(size=(COUNT, 3, SECTORS))
    kind = np.arange(COUNT) % 3
    sectors = np.zeros((COUNT, SECTORS), np.float32)
    for row in np.flatnonzero(kind == 1):
        hit = (int(rng.integers(SECTORS)) + np.arange(5)) % SECTORS
        evidence[row, 0, hit] += 8.0
        sectors[row, hit] = 1.0
    evidence[kind == 2, 0] += 8.0
    evidence[:, 2] = np.nan
    return ScoreExamples(
        ("a", "b", "c"), evidence, (kind == 1).astype(np.float32), (kind == 2).astype(np.float32), sectors,
        np.ones(COUNT, np.float32), (kind == 0) | ((kind == 2) & (np.arange(COUNT) % 2 == 0)), np.zeros(3, np.bool_),
    )  # fmt: skip


def test_a_sector_is_an_attack_and_all_of_them_are_rain() -> None:
    trainer = ScoreTrainer.of(_examples(0))
    score = trainer.train(np.ones(COUNT, np.bool_), epochs=110, seed=3)
    unseen = _examples(1)
    found = [score(evidence.astype(np.float32)) for evidence in unseen.evidence[:90]]
    attacked, rained = unseen.inconsistent[:90] == 1, unseen.degraded[:90] == 1
    inconsistent, degraded = np.array([[one.inconsistent, one.degraded] for one in found]).T
    assert auroc(inconsistent[~attacked], inconsistent[attacked]) > 0.98
    assert auroc(degraded[~rained], degraded[rained]) > 0.98
    where = [int(one.sectors.argmax()) for one, hit in zip(found, attacked, strict=True) if hit]
    assert np.mean(unseen.sectors[:90][attacked][np.arange(len(where)), where]) > 0.7


def test_rare_evidence_that_no_attack_had_counts() -> None:
    trainer = ScoreTrainer.of(_examples(0))
    score = trainer.train(np.ones(COUNT, np.bool_), epochs=5, seed=3)
    benign = _examples(1).evidence[::3][:90].astype(np.float32)
    unseen = benign.copy()
    unseen[:, 1, 7:9] += 12.0
    inconsistent = [score.of_sweeps(evidence)[:, 0] for evidence in (benign, unseen)]
    assert auroc(*inconsistent) > 0.9


def test_the_same_seed_gives_the_same_score_and_silence_stays_silent() -> None:
    trainer = ScoreTrainer.of(_examples(0))
    one, other = (trainer.train(np.arange(COUNT) % 2 == 0, epochs=2, seed=3) for _ in range(2))
    for name, values in one.arrays().items():
        assert_array_equal(values, other.arrays()[name])
    evidence = _examples(1).evidence[:1].astype(np.float32)
    spoken = evidence.copy()
    spoken[:, 2] = 5.0
    assert_array_equal(one.logits(evidence), one.logits(spoken))
    assert_array_equal(one.of_sweeps(evidence), one.of_sweeps(spoken))


def test_only_attacked_sweeps_are_refused() -> None:
    examples = _examples(0)
    examples.usual[:] = False
    with pytest.raises(ValueError, match="a score needs benign sweeps to train on, got none"):
        ScoreTrainer.of(examples)
