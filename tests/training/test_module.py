"""The second head: what it learns, and that the first is left alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from viewshed.networks.mc_dropout import mean_and_std
from viewshed.networks.runtime import OnnxRunner
from viewshed.training import TrainConfig, train
from viewshed.training.data import prepare

pytestmark = pytest.mark.slow


def test_it_learns_where_the_passes_differ_and_nothing_else_changes(
    config: TrainConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Better than the spread that a probability has of itself, p (1 - p), and of the right size."""
    monkeypatch.setattr("viewshed.training.module.PASSES", 8)
    monkeypatch.setattr("viewshed.training.module._RATE", 0.02)
    told: list[str] = []
    plain = train(config, tmp_path / "plain", cache=tmp_path / "cache")
    doubting = replace(config, doubt_frames=1200)
    taught = train(
        doubting, tmp_path / "doubt", cache=tmp_path / "cache", on_progress=lambda step: told.append(step.stage)
    )
    before, after = OnnxRunner(plain.weights, 1), OnnxRunner(taught.weights, 1)
    frames = prepare(config, tmp_path / "cache").validation
    corr, own, size = [], [], []
    for index in range(len(frames)):
        inputs = frames[0, index]["inputs"]
        prob, std = after.run_with_doubt(inputs[None])
        np.testing.assert_allclose(prob, before.run(inputs[None], before.card.shape.no_masks(1)), atol=1e-6)
        _, passes = mean_and_std(before, inputs, 40, np.random.default_rng(index))
        corr.append(np.corrcoef(std[0].ravel(), passes.ravel())[0, 1])
        own.append(np.corrcoef((prob[0] * (1 - prob[0])).ravel(), passes.ravel())[0, 1])
        size.append(std.mean() / passes.mean())
    assert np.median(corr) > np.median(own) + 0.15
    assert 0.5 < np.median(size) < 2.0
    assert "doubt" in told
    assert after.card.shape == replace(before.card.shape, doubt=True)


def test_without_dropout_there_is_no_doubt_to_learn(config: TrainConfig) -> None:
    with pytest.raises(ValueError, match="doubt_frames must be 0 without dropout"):
        replace(config, variant="mle", doubt_frames=8)
