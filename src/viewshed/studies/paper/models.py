"""The trainings of the study: one configuration for each model, made from the plan.

Who is tried: the trained networks and the classical estimators, each as a function of a sweep.

The trade study: what width, depth and resolution cost and bring.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

from viewshed.estimators import Estimator
from viewshed.networks.card import Runner
from viewshed.networks.mc_dropout import mean_and_std
from viewshed.studies.paper.data import Predict, Said, place_of, score_contestants, test_sweeps
from viewshed.studies.paper.plan import StudyPlan
from viewshed.studies.paper.protocols import Model, Setting, generator, setting_of
from viewshed.sweep import Sweep
from viewshed.training.config import PAPER, TrainConfig
from viewshed.training.log import history_to_json

WEIGHTS = "network.onnx"

CHECKPOINT = "network.pt"


def weights_of(folder: Path, model: Model) -> Path:
    """Return where the weights of a model lie."""
    return folder / "models" / model.protocol / model.name / WEIGHTS


def load_runner(path: Path, device: str = "cpu") -> Runner:
    """Return what runs a network: one core, as jobs run beside each other, or a GPU.

    Raises:
        ValueError: the file is damaged or of another version.
        OSError: it cannot be read.
    """
    if device == "cpu":
        from viewshed.networks.runtime import OnnxRunner

        return OnnxRunner(path, threads=1)
    from viewshed.networks.unet_torch import TorchRunner, load_weights

    return TorchRunner(*load_weights(path.with_name(CHECKPOINT)), device)


def passes_of(plan: StudyPlan, model: Model) -> int:
    """Return how many passes a model's estimate takes: one with dropout off, or several with dropout on."""
    return plan.passes if model.variant == "mcd" else 1


def network(runner: Runner, setting: Setting, passes: int, seed: int) -> Predict:
    """Return a network as a function of a sweep: one pass with dropout off, or mean and deviation of several.

    The sweep is put on the grid of the setting, wherever the network was trained.

    Args:
        runner: of the network.
        setting: where it is tried.
        passes: 1 for dropout off.
        seed: of the masks, the same for every sweep.
    """
    card = setting.card(runner.card)

    def predict(sweep: Sweep) -> Said:
        inputs = card.input_of(sweep)
        if passes == 1:
            return runner.run(inputs[None], card.shape.no_masks(1))[0], None
        return mean_and_std(runner, inputs, passes, generator(seed, "masks"))

    return predict


def classical(setting: Setting) -> dict[str, Predict]:
    """Return the classical estimators of a setting by name."""
    return {name: _claims(make(setting.grid)) for name, make in setting.classical().items()}


def _claims(estimator: Estimator) -> Predict:
    return lambda sweep: (estimator.estimate(sweep).visible_prob, None)


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
        "weights": done.weights.name, "history": history_to_json(done.history), "best": done.best.number,
        "frames_per_s": done.frames_per_s, "network_share": done.network_share, "device": device,
        "seconds": time.perf_counter() - start,
    }  # fmt: skip


def check_training(device: str) -> None:
    """Check that trainings can run on a device.

    Raises:
        ImportError: the extra for training is not installed.
        ValueError: there is no such device.
    """
    from viewshed.training.log import Machines
    from viewshed.training.run import require_torch

    require_torch()
    from viewshed.training.fit import check_device

    check_device(Machines(device))


THREADS = (2, 1)

Shape = tuple[int, int, int]
"""Width, depth, cells."""


def trade_shapes(plan: StudyPlan) -> Iterator[Shape]:
    """Yield width, depth and cells of every network of the trade study."""
    for cells in plan.trade_cells:
        for depth in plan.trade_depths:
            yield from ((width, depth, cells) for width in plan.trade_widths)


def trade_line(plan: StudyPlan, folder: Path, config: TrainConfig) -> dict[str, Any]:
    """Return what a trained network scores on the held-out sweeps, how long it takes, and its size.

    Args:
        plan: of the study.
        folder: of the study.
        config: of its training.
    """
    from viewshed.networks.runtime import OnnxRunner

    path, setting = folder / "trade" / config.name / WEIGHTS, trade_setting(plan, config)
    sweeps = list(test_sweeps(plan, folder, setting, plan.pair_frames))
    runners = {threads: OnnxRunner(path, threads=threads, engine="onnxruntime") for threads in THREADS}
    found = score_contestants(sweeps, {"network": network(runners[2], setting, 1, 0)}, setting.threshold)
    latency = {
        str(threads): latency_ms(runner, setting, sweeps[0].benign, plan.trade_repeats)
        for threads, runner in runners.items()
    }
    size = {"parameters": config.shape.parameters, "flops": config.shape.flops(config.cells)}
    return found | size | {"latency_ms": latency}


def trade_setting(plan: StudyPlan, config: TrainConfig) -> Setting:
    """Return the paper's setting of the trade study's domain, on the network's own grid."""
    base = setting_of(plan, "paper", plan.trade_domain)
    return Setting(
        base.protocol, base.domain, config.grid, base.truth, base.threshold, base.max_range_m, base.heights_m
    )


def latency_ms(runner: Runner, setting: Setting, sweep: Sweep, repeats: int) -> float:
    """Return the median time of one pass through the network in milliseconds, its input made already."""
    card = setting.card(runner.card)
    inputs, masks = card.input_of(sweep)[None], card.shape.no_masks(1)
    times = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        runner.run(inputs, masks)
        times.append(1e3 * (time.perf_counter() - start))
    return median(times[1:])
