"""Quantize a trained network to int8; calibrate and check it on sweeps like those of its training."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from viewshed._files import write_atomic
from viewshed.estimators.unet import PASSES
from viewshed.metrics import Scores
from viewshed.networks.mc_dropout import mean_and_deviation
from viewshed.networks.runtime import OnnxRunner
from viewshed.sweep import Sweep
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import ScenePlan, simulate_frame
from viewshed_lab.training.config import TrainConfig
from viewshed_lab.training.data import archived_samples
from viewshed_lab.training.samples import CleanSample, TrainingFrames, TrainingSample, labeled, paper_label

MAX_F1_LOSS = 0.002
"""Largest loss of F1 that quantization may cause."""

FRAMES = 64
"""Default number of calibration sweeps, and of check sweeps."""

_CLIPS, _CLIP_FRAMES = (127, 63, 31, 15), 8
"""Clips to try for an int8 network, besides its own, and the number of sweeps to compare them on."""

_EPOCH, _FRESH, _STEP = 0x62797465, 0x7665777368, 8
"""Seeds, and the step between the indices of new frames: the shipped weights were calibrated with these."""


@dataclass(frozen=True, slots=True)
class QuantizationCost:
    """Loss of accuracy by int8, measured on scenes that were not used for calibration."""

    passes: int  # 1 with dropout off, else Monte Carlo dropout passes, whose mean is compared
    f1: float  # of the float32 network, over all cells of all sweeps
    f1_int8: float  # of the int8 network
    mean_difference: float  # mean absolute difference of the two networks' probabilities
    flipped_share: float  # share of the known cells on which the two networks disagree (visible or not)
    deviation: float  # standard deviation over passes in float32, mean over the cells; 0 for one pass
    deviation_int8: float  # the same in int8


def quantize(config: TrainConfig, network: str | Path, out: str | Path, frames: int = FRAMES) -> list[QuantizationCost]:
    """Quantize a network to the int8 file ``out``; return its cost for one pass, and with dropout for several passes.

    The sweeps are attacked as often as in the training; the first ``frames`` calibrate, as many others check. Sweeps of
    presets are simulated, each in a new scene that no epoch has used. Sweeps of archives are training sweeps, evenly
    spaced, with other attacks.

    Args:
        config: of the network's training.
        network: file of the float32 network.
        out: file to write, atomically.
        frames: number of calibration sweeps.

    Raises:
        ValueError: the network does not fit the config, or loses more F1 than ``MAX_F1_LOSS``; nothing is written.
        ImportError: onnx is not installed.
    """
    from viewshed_lab.training.quantize import quantize_network

    if frames < 1:
        raise ValueError(f"frames must be at least 1, got {frames}")
    content = Path(network).read_bytes()
    float32_runner = OnnxRunner.of_content(content, str(network), 1)
    _check(config, float32_runner)
    samples = _samples(config, 2 * frames)
    calibration = [next(samples) for _ in range(frames)]
    training_facts = {"calibration": f"{frames} sweeps of {', '.join(config.data)}, {config.attack_share:.0%} attacked"}
    clip = _choose_clip(content, float32_runner, calibration) if float32_runner.card.counts == "linear" else None
    maps = [sample.maps for sample in calibration]
    int8_content = quantize_network(content, str(network), maps, training_facts, clip)
    int8_runner = OnnxRunner.of_content(int8_content, str(out), 1)
    checks, counts = list(samples), (1, PASSES) if float32_runner.card.shape.dropout else (1,)
    costs = [_compare(float32_runner, int8_runner, checks, passes) for passes in counts]
    for cost in costs:
        if cost.f1 - cost.f1_int8 > MAX_F1_LOSS:
            raise ValueError(
                f"F1 in int8 must be within {MAX_F1_LOSS} of float32, got {cost.f1_int8:.4f} and {cost.f1:.4f}; "
                "calibrate with more frames, or keep float32"
            )
    write_atomic(out, int8_content)
    return costs


def _choose_clip(content: bytes, float32_runner: OnnxRunner, samples: Sequence[TrainingSample]) -> int:
    """Return the clip with the smallest mean difference between int8 and float32.

    Most cells have few returns, some beside the sensor hundreds. If these set the range of the first layers, one step
    of uint8 exceeds the differences between most cells.
    """
    from viewshed_lab.training.quantize import quantize_network

    card, samples, differences = float32_runner.card, samples[:_CLIP_FRAMES], dict[int, float]()
    maps = [sample.maps for sample in samples]
    for clip in (card.clip, *(clip for clip in _CLIPS if clip < card.clip)):
        int8_runner = OnnxRunner.of_content(quantize_network(content, card.name, maps, clip=clip), "int8", 1)
        differences[clip] = _compare(float32_runner, int8_runner, samples, 1).mean_difference
    return min(differences, key=differences.__getitem__)


def _samples(config: TrainConfig, count: int) -> Iterator[TrainingSample]:
    """Yield ``count`` attacked samples; see :func:`quantize`."""
    if config.simulated:
        source, indices = TrainingFrames(_NewScenes(config, count), config), np.arange(count) * _STEP
    else:
        source = TrainingFrames(archived_samples(config), config)
        if (max_frames := len(source) // 2) < count // 2:
            raise ValueError(f"frames must be at most {max_frames}, half of the sweeps in the data, got {count // 2}")
        spread = np.linspace(0, len(source) - 1, count).astype(np.intp)
        indices = np.random.default_rng(config.seed).permutation(spread)
    return (source.draw(_EPOCH, int(index)) for index in indices)


@dataclass(frozen=True, slots=True)
class _NewScenes:
    """Frames of scenes that no training has used, one per scene, at multiples of ``_STEP``; the presets alternate."""

    config: TrainConfig  # seed and presets
    count: int  # number of frames

    def __len__(self) -> int:
        return self.count

    def clean(self, index: int) -> CleanSample:
        """Simulate and return frame ``index``."""
        sample, config = simulate_frame(*self._place(index)), self.config
        if config.truth == "probe":
            return CleanSample(sample.sweep, sample.truth.visible(config.target), sample.known)
        return labeled(sample.sweep, paper_label(sample.sweep, config.grid, config.indoor))

    def earlier(self, index: int) -> tuple[Sweep, ...]:
        """Return the previous sweep of the same agent, or an empty tuple at the start of a scene."""
        scene, number = self._place(index)
        before = number - scene.preset.agents
        return () if before < 0 else (simulate_frame(scene, before).sweep,)

    def _place(self, index: int) -> tuple[ScenePlan, int]:
        config, number = self.config, index // _STEP
        preset = preset_named(config.data[number % len(config.data)])
        at = preset.splits.index(config.train_split)
        length = preset.frames[at] // preset.scenes[at]
        seed = int(np.random.SeedSequence([config.seed, _EPOCH, _FRESH]).generate_state(1)[0])
        new = replace(
            preset, splits=("fresh",), scenes=(self.count,), frames=(self.count * length,), seed=seed,
            grid_cells=config.cells, grid_half_extent_m=config.half_extent_m,
        )  # fmt: skip
        scene, rng = ScenePlan(new, 0, number), np.random.default_rng([config.seed, _EPOCH, number, _FRESH])
        return scene, int(rng.permutation(scene.frames)[0])


def _check(config: TrainConfig, runner: OnnxRunner) -> None:
    card, expected = runner.card, config.card()
    for name in ("grid", "target", "truth", "max_range_m", "heights_m", "counts"):
        if getattr(card, name) != getattr(expected, name):
            raise ValueError(
                f"the network must be one of the config {config.name}, with {name} {getattr(expected, name)}, got"
                f" {getattr(card, name)}"
            )


def _compare(
    float32_runner: OnnxRunner, int8_runner: OnnxRunner, frames: Sequence[TrainingSample], passes: int
) -> QuantizationCost:
    scores, differences, flipped, deviations = (Scores(), Scores()), [], [], []
    runners, card = (float32_runner, int8_runner), float32_runner.card
    masks = card.shape.masks(passes, np.random.default_rng(0)) if passes > 1 else None
    for frame in frames:
        outputs = [mean_and_deviation(runner.run(runner.card.shown(frame.maps)[None], masks)) for runner in runners]
        probs = [prob for prob, _ in outputs]
        for score, prob in zip(scores, probs, strict=True):
            score.add(prob[frame.known], frame.visible[frame.known])
        visible = [prob >= np.float32(card.threshold) for prob in probs]
        differences.append(float(np.abs(probs[0] - probs[1]).mean()))
        flipped.append(float((visible[0] != visible[1])[frame.known].mean()))
        deviations.append([float(std.mean()) for _, std in outputs])
    f1, f1_int8 = (score.f1(card.threshold) for score in scores)
    std, std_int8 = np.mean(deviations, axis=0).tolist()
    return QuantizationCost(passes, f1, f1_int8, float(np.mean(differences)), float(np.mean(flipped)), std, std_int8)
