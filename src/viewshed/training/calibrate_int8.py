"""From trained weights to a network that multiplies bytes: calibrated and checked on sweeps like those trained on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed._files import write_atomic
from viewshed.metrics import Scores
from viewshed.networks.runtime import OnnxRunner
from viewshed.training.config import TrainConfig
from viewshed.training.samples import TrainingFrames, TrainingSample
from viewshed.training.sources import FRESH_PER_SCENE, OnlineSimulation

MOST_LOSS = 0.002
"""F1 that a network in bytes may lose."""

FRAMES = 64
"""Sweeps that calibrate, and as many others that check, where not asked otherwise."""

_EPOCH = 0x62797465

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Quantized:
    """What it costs to multiply bytes, on sweeps of other scenes than those that calibrated.

    Attributes:
        f1: of the network in float32, all cells of all sweeps together.
        f1_bytes: of the network in bytes.
        away: mean distance between their probabilities.
        flipped: share of the known cells that one calls visible and the other does not.
    """

    f1: float
    f1_bytes: float
    away: float
    flipped: float


def quantize(config: TrainConfig, network: str | Path, out: str | Path, frames: int = FRAMES) -> Quantized:
    """Write a network in bytes to a new file ``out`` and return what that costs.

    The sweeps are simulated as for the training, each of a scene of its own that no epoch has seen, attacked as often
    as there; the first ``frames`` calibrate, as many others check.

    Args:
        config: that the network was trained with; its data must be presets.
        network: file of the network in float32.
        out: file to be written, whole or not at all.
        frames: sweeps that calibrate.

    Raises:
        ValueError: the network is not one of the config, or loses more F1 than ``MOST_LOSS``; nothing is written.
        ImportError: onnx is not installed.
    """
    from viewshed.networks.quantize import quantized

    if frames < 1:
        raise ValueError(f"frames must be at least 1, got {frames}")
    content = Path(network).read_bytes()
    whole = OnnxRunner.of_content(content, str(network), 1)
    _check(config, whole)
    source = TrainingFrames(OnlineSimulation(config, 2 * frames * FRESH_PER_SCENE), config)
    drawn = (source.draw(_EPOCH, number * FRESH_PER_SCENE) for number in range(2 * frames))
    shown = [next(drawn).maps for _ in range(frames)]
    told = {"calibration": f"{frames} sweeps of {', '.join(config.data)}, {config.attack_share:.0%} attacked"}
    made = quantized(content, str(network), shown, told)
    found = _compared(whole, OnnxRunner.of_content(made, str(out), 1), list(drawn))
    if found.f1 - found.f1_bytes > MOST_LOSS:
        raise ValueError(
            f"F1 in bytes must be within {MOST_LOSS} of float32, got {found.f1_bytes:.4f} and {found.f1:.4f}; calibrate"
            " with more frames, or keep float32"
        )
    write_atomic(out, made)
    return found


def _check(config: TrainConfig, runner: OnnxRunner) -> None:
    card, wanted = runner.card, config.card()
    for name in ("grid", "inputs", "target", "heights_m", "counts"):
        if getattr(card, name) != getattr(wanted, name):
            raise ValueError(
                f"the network must be one of the config {config.name}, with {name} {getattr(wanted, name)}, got"
                f" {getattr(card, name)}"
            )


def _compared(whole: OnnxRunner, small: OnnxRunner, frames: list[TrainingSample]) -> Quantized:
    scores, away, flipped = (Scores(), Scores()), [], []
    for frame in frames:
        probs = [_probability(runner, frame) for runner in (whole, small)]
        for score, prob in zip(scores, probs, strict=True):
            score.add(prob[frame.known], frame.visible[frame.known])
        masks = [prob >= np.float32(whole.card.threshold) for prob in probs]
        away.append(float(np.abs(probs[0] - probs[1]).mean()))
        flipped.append(float((masks[0] != masks[1])[frame.known].mean()))
    f1, f1_bytes = (score.f1(whole.card.threshold) for score in scores)
    return Quantized(f1, f1_bytes, float(np.mean(away)), float(np.mean(flipped)))


def _probability(runner: OnnxRunner, frame: TrainingSample) -> Floats:
    found: Floats = runner.run(runner.card.shown(frame.maps)[None], runner.card.shape.no_masks(1))[0]
    return found
