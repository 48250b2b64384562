"""Post-training quantization of a network to int8: calibrated and checked on sweeps like those it was trained on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from viewshed._files import write_atomic
from viewshed.estimators.unet import PASSES
from viewshed.metrics import Scores
from viewshed.networks.card import Bytes
from viewshed.networks.mc_dropout import mean_and_deviation
from viewshed.networks.runtime import OnnxRunner
from viewshed.sweep import Sweep
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import ScenePlan, simulate_frame
from viewshed_lab.training.config import TrainConfig
from viewshed_lab.training.data import archived_samples
from viewshed_lab.training.samples import CleanSample, TrainingFrames, TrainingSample, labeled, paper_label

MAX_F1_LOSS = 0.002
"""F1 that quantization may cost."""

FRAMES = 64
"""Sweeps that calibrate, and as many others that check, unless other numbers are given."""

_CLIPS, _CHOOSING = (127, 63, 31, 15), 8
"""Counts above which a network in bytes may stop counting, beside its own limit; sweeps on which each is tried."""

_EPOCH, _FRESH, _STEP = 0x62797465, 0x7665777368, 8
"""Seeds, and the step in the numbers of new frames: the shipped weights were calibrated with these."""


@dataclass(frozen=True, slots=True)
class QuantizationCost:
    """What int8 costs, on sweeps of other scenes than those that calibrated."""

    passes: int  # 1 with dropout off, else those of Monte Carlo dropout, whose mean is compared
    f1: float  # of the network in float32, all cells of all sweeps together
    f1_int8: float  # of the network in int8
    mean_difference: float  # mean absolute difference of their probabilities
    flipped_share: float  # share of the known cells that one calls visible and the other does not
    deviation: float  # mean over the cells of the deviation over passes, in float32; 0 for one pass
    deviation_int8: float  # the same in int8


def quantize(config: TrainConfig, network: str | Path, out: str | Path, frames: int = FRAMES) -> list[QuantizationCost]:
    """Write a network in int8 to a new file ``out`` and return what that costs, and with dropout what passes cost.

    The sweeps are attacked as often as in the training; the first ``frames`` calibrate, as many others check. Those of
    presets are simulated anew, each in a scene of its own that no epoch has seen; of archives they are sweeps of the
    training, spread evenly, with other attacks.

    Args:
        config: that the network was trained with.
        network: file of the network in float32.
        out: file to be written, whole or not at all.
        frames: sweeps that calibrate.

    Raises:
        ValueError: the network is not one of the config, or loses more F1 than ``MAX_F1_LOSS``; nothing is written.
        ImportError: onnx is not installed.
    """
    from viewshed_lab.training.quantize import quantize_network

    if frames < 1:
        raise ValueError(f"frames must be at least 1, got {frames}")
    content = Path(network).read_bytes()
    whole = OnnxRunner.of_content(content, str(network), 1)
    _check(config, whole)
    drawn = _draw(config, 2 * frames)
    calibration_maps = [next(drawn).maps for _ in range(frames)]
    training_facts = {"calibration": f"{frames} sweeps of {', '.join(config.data)}, {config.attack_share:.0%} attacked"}
    clip = _choose_clip(content, whole, calibration_maps) if whole.card.counts == "linear" else None
    small = quantize_network(content, str(network), calibration_maps, training_facts, clip)
    checks, runners = list(drawn), (whole, OnnxRunner.of_content(small, str(out), 1))
    counts = (1, PASSES) if whole.card.shape.dropout else (1,)
    costs = [_compare(*runners, checks, passes) for passes in counts]
    for cost in costs:
        if cost.f1 - cost.f1_int8 > MAX_F1_LOSS:
            raise ValueError(
                f"F1 in bytes must be within {MAX_F1_LOSS} of float32, got {cost.f1_int8:.4f} and {cost.f1:.4f}; "
                "calibrate with more frames, or keep float32"
            )
    write_atomic(out, small)
    return costs


def _choose_clip(content: bytes, whole: OnnxRunner, maps: Sequence[Bytes]) -> int:
    """Return where counting stops so that bytes are most like float32.

    Most cells have few returns, some beside the sensor hundreds. Where these decide the range of the first layers, one
    step of a byte is more than most cells differ by.
    """
    from viewshed_lab.training.quantize import quantize_network

    used, differences = maps[:_CHOOSING], dict[int, float]()
    for clip in (whole.card.clip, *(clip for clip in _CLIPS if clip < whole.card.clip)):
        small = OnnxRunner.of_content(quantize_network(content, whole.card.name, used, clip=clip), "int8", 1)
        found = [[runner.run(runner.card.shown(each)[None], None) for runner in (whole, small)] for each in used]
        differences[clip] = float(np.mean([np.abs(one - other).mean() for one, other in found]))
    return min(differences, key=differences.__getitem__)


def _draw(config: TrainConfig, count: int) -> Iterator[TrainingSample]:
    """Yield ``count`` frames, in no order; see :func:`quantize`."""
    if config.simulated:
        source, numbers = TrainingFrames(_NewScenes(config, count), config), np.arange(count) * _STEP
    else:
        source = TrainingFrames(archived_samples(config), config)
        if (most := len(source) // 2) < count // 2:
            raise ValueError(f"frames must be at most {most}, half of the sweeps in the data, got {count // 2}")
        spread = np.linspace(0, len(source) - 1, count).astype(np.intp)
        numbers = np.random.default_rng(config.seed).permutation(spread)
    return (source.draw(_EPOCH, int(number)) for number in numbers)


@dataclass(frozen=True, slots=True)
class _NewScenes:
    """Frames of scenes that no training has seen, one of each, numbered in steps; the presets in turn."""

    config: TrainConfig  # seed and presets
    count: int  # how many

    def __len__(self) -> int:
        return self.count

    def clean(self, index: int) -> CleanSample:
        """Return one frame, simulated now."""
        sample, config = simulate_frame(*self._place(index)), self.config
        if config.truth == "probe":
            return CleanSample(sample.sweep, sample.truth.visible(config.target), sample.known)
        return labeled(sample.sweep, paper_label(sample.sweep, config.grid, config.indoor))

    def earlier(self, index: int) -> tuple[Sweep, ...]:
        """Return the sweep of the same agent just before it, or none at the start of a scene."""
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
    card, wanted = runner.card, config.card()
    for name in ("grid", "target", "truth", "max_range_m", "heights_m", "counts"):
        if getattr(card, name) != getattr(wanted, name):
            raise ValueError(
                f"the network must be one of the config {config.name}, with {name} {getattr(wanted, name)}, got"
                f" {getattr(card, name)}"
            )


def _compare(whole: OnnxRunner, small: OnnxRunner, frames: list[TrainingSample], passes: int) -> QuantizationCost:
    scores, differences, flipped, deviations = (Scores(), Scores()), [], [], []
    masks = whole.card.shape.masks(passes, np.random.default_rng(0)) if passes > 1 else None
    for frame in frames:
        found = [
            mean_and_deviation(runner.run(runner.card.shown(frame.maps)[None], masks)) for runner in (whole, small)
        ]
        probs = [prob for prob, _ in found]
        for score, prob in zip(scores, probs, strict=True):
            score.add(prob[frame.known], frame.visible[frame.known])
        claims = [prob >= np.float32(whole.card.threshold) for prob in probs]
        differences.append(float(np.abs(probs[0] - probs[1]).mean()))
        flipped.append(float((claims[0] != claims[1])[frame.known].mean()))
        deviations.append([float(std.mean()) for _, std in found])
    f1, f1_int8 = (score.f1(whole.card.threshold) for score in scores)
    std, std_int8 = np.mean(deviations, axis=0).tolist()
    return QuantizationCost(passes, f1, f1_int8, float(np.mean(differences)), float(np.mean(flipped)), std, std_int8)
