"""The trainings of the study, one configuration for each model, and the trained networks as estimators."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from viewshed.estimators.base import EarlierSweeps
from viewshed.estimators.classical import ClassicalEstimator, checked_history
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.visibility import TARGETS, Target
from viewshed.grid import BevGrid
from viewshed.networks.card import NetworkCard, Runner
from viewshed.networks.mc_dropout import mean_and_std
from viewshed.preprocess.leveling import LeveledSweep, leveled_on
from viewshed.sweep import Sweep
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.paper.data import archive_path
from viewshed_lab.studies.paper.plan import Model, PaperPlan
from viewshed_lab.studies.paper.protocols import ProtocolSetting, setting_of
from viewshed_lab.studies.plan import JobKey
from viewshed_lab.studies.records import PAPER as PAPER_PROTOCOL
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.training.config import PAPER, TrainConfig
from viewshed_lab.training.cross_validation import FoldScore, Hyperparameters, mean_f1
from viewshed_lab.training.data import Fold

WEIGHTS = "network.onnx"

CHECKPOINT = "network.pt"


def weights_of(folder: Path, model: Model) -> Path:
    """Return the file of a model's weights."""
    return folder / "models" / model.protocol / model.name / WEIGHTS


def load_runner(path: Path, device: str = "cpu") -> Runner:
    """Return what runs a network: one core, as jobs run beside each other, or a GPU."""
    if device == "cpu":
        from viewshed.networks.runtime import OnnxRunner

        return OnnxRunner(path, threads=1)
    from viewshed_lab.training.unet_torch import TorchRunner, load_weights

    return TorchRunner(*load_weights(path.with_name(CHECKPOINT)), device)


def passes_of(plan: PaperPlan, model: Model) -> int:
    """Return how many passes a model's estimate takes: one with dropout off, or several with dropout on."""
    return plan.passes if model.variant == "mcd" else 1


@dataclass(frozen=True, slots=True, eq=False)
class NetworkAlone(ClassicalEstimator):
    """A network as the published study tries it: its probabilities as they are, on the grid of the setting."""

    runner: Runner  # of the network
    card: NetworkCard  # of the network as it is used here, wherever it was trained
    passes: int  # 1 with dropout off, or how many with dropout on
    seed: int  # of the masks, the same for every sweep
    name: str = "network"

    @property
    def grid(self) -> BevGrid:  # type: ignore[override]
        """The grid of the setting."""
        return self.card.grid

    @property
    def target(self) -> Target:  # type: ignore[override]
        """The target that the network was trained for."""
        return TARGETS[self.card.target]

    def estimate(self, sweep: Sweep | LeveledSweep, history: EarlierSweeps = None) -> FovEstimate:
        """Return one pass, or mean and deviation of several, not bounded by the beams; no state is given."""
        leveled = leveled_on(sweep, self.grid)
        checked_history(self, leveled, history)
        inputs, state = self.card.input_of(leveled.sweep), np.zeros(self.grid.shape, np.uint8)
        if self.passes == 1:
            return FovEstimate(self.grid, self.runner.run(inputs[None])[0], state)
        mean, std = mean_and_std(self.runner, inputs, self.passes, generator(self.seed, "masks"))
        return FovEstimate(self.grid, mean, state, std)


def network_of(
    plan: PaperPlan, folder: Path, model: Model, setting: ProtocolSetting, device: str = "cpu"
) -> NetworkAlone:
    """Return a trained network in a setting."""
    runner = load_runner(weights_of(folder, model), device)
    return NetworkAlone(runner, setting.card(runner.card), passes_of(plan, model), plan.test_seed)


def config_of(plan: PaperPlan, folder: Path, model: Model) -> TrainConfig:
    """Return how a model is trained: paper's mixture or the plan's attacks, on the archive of its domain.

    Dropout and learning rate are those that cross-validation chose, where the plan has one that is done.
    """
    chosen, config = chosen_of(plan, folder), _planned_config(plan, folder, model)
    return config if chosen is None else chosen.of(config)


def chosen_of(plan: PaperPlan, folder: Path) -> Hyperparameters | None:
    """Return the setting with the highest mean F1 over the folds that are done; None where none is."""
    scored = fold_scores(plan, folder)
    return min(scored, key=lambda one: (-mean_f1(scored[one]), one), default=None)


def fold_scores(plan: PaperPlan, folder: Path) -> dict[Hyperparameters, list[FoldScore]]:
    """Return the scores of the folds that are done in a study's folder, by setting."""
    found: dict[Hyperparameters, list[FoldScore]] = {}
    for key, facts in ResultStore(folder, plan).results("crossval").facts.items():
        setting, best = _setting_of(plan, key), facts["history"][facts["best"] - 1]
        score = FoldScore(
            setting.name, int(key[-1]), best["f1"], best["iou"], best["validation_loss"], best["number"]
        )  # fmt: skip
        found.setdefault(setting, []).append(score)
    return found


def crossval_config(plan: PaperPlan, folder: Path, key: JobKey) -> TrainConfig:
    """Return how a network of cross-validation is trained: the paper's, with dropout and attacks, on few cells."""
    base = _planned_config(plan, folder, Model(PAPER_PROTOCOL, "mcd", "adversarial", plan.trade_domain))
    setting = _setting_of(plan, key)
    return replace(
        setting.of(base), name=f"crossval-{setting.name}", cells=plan.crossval_cells, epochs=plan.crossval_epochs,
        frames_per_epoch=plan.crossval_frames,
    )  # fmt: skip


def _setting_of(plan: PaperPlan, key: JobKey) -> Hyperparameters:
    return Hyperparameters(plan.width, float(key[1]), float(key[2]))


def _planned_config(plan: PaperPlan, folder: Path, model: Model) -> TrainConfig:
    """Return how a model is trained with the plan's own dropout and learning rate."""
    setting = setting_of(plan, model.protocol, model.domain)
    attacks: tuple[str, ...] = ()
    share = 0.0
    if model.mixture == "adversarial":
        paper = model.protocol == "paper"
        attacks, share = ((PAPER,), 1.0) if paper else (plan.trained_attacks, plan.attack_share)
    return TrainConfig(
        name=f"{model.protocol}-{model.name}", about=f"{plan.name} plan of the paper's study",
        data=(str(archive_path(folder, model.domain, "train")),), train_split="train",
        validation_share=plan.validation_share, cells=plan.cells, half_extent_m=setting.grid.half_extent_m,
        target="car", truth=setting.truth, variant=model.variant, attacks=attacks, attack_share=share,
        width=plan.width, depth=plan.depth, dropout=plan.dropout,
        loss=plan.loss, learning_rate=plan.learning_rate,
        schedule=plan.schedule, batch=plan.batch, epochs=plan.epochs, patience=plan.patience,
        frames_per_epoch=plan.frames_per_epoch, versions=plan.versions,
        mirrored=plan.mirrored, precision=plan.precision, workers=plan.workers,
        threshold=setting.threshold, seed=plan.seed, counts=plan.counts,
        max_range_m=setting.max_range_m, heights_m=setting.heights_m,
    )  # fmt: skip


def trade_config(plan: PaperPlan, folder: Path, shape: tuple[int, int, int]) -> TrainConfig:
    """Return how a network of the trade study is trained: benign, one pass, the paper's protocol, fewer epochs."""
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


def train(config: TrainConfig, out: Path, cache: Path, device: str, fold: Fold | None = None) -> dict[str, Any]:
    """Return the facts of a training, which goes on where it was stopped; all share the labels in ``cache``."""
    from viewshed_lab.training import run

    done = run.train(config, out, device=device, cache=cache, fold=fold)
    return {
        "weights": done.weights.name, "history": [asdict(epoch) for epoch in done.history], "best": done.best.number,
        "frames_per_s": done.frames_per_s, "network_share": done.network_share, "device": device,
        "seconds": sum(epoch.seconds for epoch in done.history),  # also those before it was resumed
    }  # fmt: skip


def check_training(device: str) -> None:
    """Check that trainings can run on a device."""
    from viewshed_lab.training.log import Machines
    from viewshed_lab.training.run import require_torch

    require_torch()
    from viewshed_lab.training.fit import check_device

    check_device(Machines(device))
