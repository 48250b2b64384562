"""Teaches a trained network's second head what Monte Carlo dropout would say: its deviation, in one pass [torch]."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from viewshed.networks.spec import MOST_DEVIATION
from viewshed.networks.unet import UNet
from viewshed.training.config import TrainConfig
from viewshed.training.frames import TrainingFrames
from viewshed.training.order import TrainingOrder

PASSES = 20
"""Passes whose deviation is the target."""
_BATCH = 4
_RATE = 3e-3
_SEED = 0x646F756274
Told = Callable[[int, int, float], None]
"""Is told how many frames are done, how many there are, and the loss."""


def with_doubt(
    config: TrainConfig, module: UNet, frames: TrainingFrames, device: torch.device, told: Told | None = None
) -> UNet:
    """Return the network with a second head, fitted to the deviation over ``PASSES`` dropout masks; the rest stays.

    The loss is the cross-entropy to twice the deviation, which lies in [0, 1], over known cells.

    Args:
        config: of the training; says how many frames.
        module: the trained network.
        frames: that it was trained on.
        device: where it runs.
        told: hears how far it is.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        student = UNet(replace(module.shape, doubt=True))
    student.load_state_dict(module.state_dict(), strict=False)
    student = student.to(device).eval()
    assert student.doubt is not None
    optimizer = torch.optim.Adam(student.doubt.parameters(), lr=_RATE)
    steps = max(config.doubt_frames // _BATCH, 1)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for done, (inputs, masks, known) in enumerate(_batches(config, frames, steps), 1):
        loss = _loss(student, inputs.to(device), masks.to(device), known.to(device))
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
        if told is not None:
            told(done * _BATCH, steps * _BATCH, float(loss.detach()))
    return student.cpu()


def _batches(config: TrainConfig, frames: TrainingFrames, steps: int) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Yield inputs (B, channels, cells, cells), masks (B, passes, M) and known (B, cells, cells)."""
    rng = np.random.default_rng([config.seed, _SEED])
    epoch, keys = 0, list[tuple[int, int]]()
    for _ in range(steps):
        while len(keys) < _BATCH:
            keys += TrainingOrder(len(frames), len(frames), frames.source.block, config.seed, epoch=epoch)
            epoch += 1
        drawn, keys = [frames[key] for key in keys[:_BATCH]], keys[_BATCH:]
        masks = np.stack([config.shape.masks(PASSES, rng) for _ in drawn])
        inputs, known = (torch.from_numpy(np.stack([each[name] for each in drawn])) for name in ("inputs", "known"))
        yield inputs, torch.from_numpy(masks), known


def _loss(student: UNet, inputs: Tensor, masks: Tensor, known: Tensor) -> Tensor:
    assert student.doubt is not None
    with torch.no_grad(), torch.autocast(inputs.device.type, torch.bfloat16):
        off = torch.ones_like(masks[:, 0])
        features = student.features(inputs, off)
        passes = [torch.sigmoid(student(inputs, masks[:, k]).float()) for k in range(masks.shape[1])]
    target = torch.stack(passes).std(dim=0, correction=0)[:, 0] / MOST_DEVIATION
    logits = functional.pixel_shuffle(student.doubt(features.float()), student.shape.fold)[:, 0]
    cells = functional.binary_cross_entropy_with_logits(logits, target, reduction="none") * known
    return cells.sum() / known.sum().clamp(min=1.0)
