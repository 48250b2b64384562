"""The trainings of the study: one configuration for each model, made from the plan."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from viewshed.reproduce.data import place_of
from viewshed.reproduce.plan import StudyPlan
from viewshed.reproduce.protocols import Model, setting_of
from viewshed.training.config import PAPER, TrainConfig
from viewshed.training.history import plain


def config_of(plan: StudyPlan, folder: Path, model: Model) -> TrainConfig:
    """Return how a model is trained: paper's mixture or the plan's attacks, on the archive of its domain."""
    setting = setting_of(plan, model.protocol, model.domain)
    attacks: tuple[str, ...] = ()
    share = 0.0
    if model.mixture == "adversarial":
        paper = model.protocol == "paper"
        attacks, share = ((PAPER,), 1.0) if paper else (plan.trained_attacks, plan.attack_share)
    return TrainConfig(
        name=f"{model.protocol}-{model.name}", about=f"{plan.name} plan of the reproduced study",
        data=(str(place_of(folder, model.domain, "train")),), train_split="train",
        validation_share=plan.validation_share, cells=plan.cells, half_extent_m=setting.grid.half_extent_m,
        target="car", truth=setting.truth, variant=model.variant, attacks=attacks, attack_share=share,
        ringless_share=0.0, past_share=0.0, width=plan.width, depth=plan.depth, fold=1, dropout=plan.dropout,
        doubt_frames=0, loss=plan.loss, learning_rate=plan.learning_rate,
        schedule=plan.schedule, batch=plan.batch, epochs=plan.epochs, patience=plan.patience,
        frames_per_epoch=plan.frames_per_epoch, fresh=False, versions=plan.versions,
        mirrored=plan.mirrored, precision=plan.precision, workers=plan.workers,
        threshold=setting.threshold, seed=plan.seed, inputs=("counts",), counts=plan.counts,
        max_range_m=setting.max_range_m, heights_m=setting.heights_m,
    )  # fmt: skip


def trade_config(plan: StudyPlan, folder: Path, shape: tuple[int, int, int]) -> TrainConfig:
    """Return how a network of the trade study is trained: benign, one pass, the paper's protocol, fewer epochs.

    Args:
        plan: of the study.
        folder: of the study.
        shape: width, depth and cells.
    """
    width, depth, cells = shape
    base = config_of(plan, folder, Model("paper", "mle", "benign", plan.trade_domain))
    name = f"trade-{trade_name(shape)}"
    return replace(base, name=name, width=width, depth=depth, cells=cells, epochs=plan.trade_epochs)


def trade_name(shape: tuple[int, int, int]) -> str:
    """Return the name of a network of the trade study.

    >>> trade_name((8, 4, 128))
    'w8-d4-c128'
    """
    return "w{}-d{}-c{}".format(*shape)


def trained(config: TrainConfig, out: Path, cache: Path, device: str) -> dict[str, Any]:
    """Return the facts of a training, which goes on where it was stopped.

    Args:
        config: of the training.
        out: folder of its checkpoints and weights.
        cache: folder of labels that all trainings share.
        device: ``cpu`` or ``cuda``.

    Raises:
        ImportError: the extra for training is not installed.
        ValueError: there is no such device, or the folder holds another training.
        OSError: something cannot be read or written.
    """
    from viewshed.training.run import train

    start = time.perf_counter()
    done = train(config, out, device=device, cache=cache)
    return {
        "weights": done.weights.name, "history": plain(done.history), "best": done.best.number,
        "frames_per_s": done.frames_per_s, "network_share": done.network_share, "device": device,
        "seconds": time.perf_counter() - start,
    }  # fmt: skip


def check_training(device: str) -> None:
    """Check that trainings can run on a device.

    Raises:
        ImportError: the extra for training is not installed.
        ValueError: there is no such device.
    """
    from viewshed.training.run import Machines, require_torch

    require_torch()
    from viewshed.training.fit import check_device

    check_device(Machines(device))
