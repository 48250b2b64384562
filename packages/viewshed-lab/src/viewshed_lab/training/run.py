"""``train``: train a network from a config; an interrupted run resumes. Imports torch only when called."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from viewshed._extras import needed_for
from viewshed_lab.training.config import TrainConfig
from viewshed_lab.training.data import Fold, check_data, prepare
from viewshed_lab.training.log import CHECKPOINT, WEIGHTS, Epoch, Machines, OnProgress, Step, best_of


@dataclass(frozen=True, slots=True)
class Trained:
    """Result of a training."""

    weights: Path  # ``network.onnx`` of the best epoch
    checkpoint: Path  # ``last.ckpt``, from which training resumes
    history: tuple[Epoch, ...]  # one entry per epoch
    frames_per_s: float  # training frames per second, including the time waiting for frames
    network_share: float  # share of the time in which the network ran

    @property
    def best(self) -> Epoch:
        """The epoch whose weights were exported."""
        return best_of(self.history)

    @classmethod
    def of(cls, out: Path, history: Sequence[Epoch]) -> Trained:
        """Return the result of the training in folder ``out``; rates are weighted by the seconds of each epoch."""
        seconds = sum(epoch.seconds for epoch in history)
        share = sum(epoch.network_share * epoch.seconds for epoch in history) / max(seconds, 1e-9)
        rate = sum(epoch.frames_per_s * epoch.seconds for epoch in history) / max(seconds, 1e-9)
        return cls(out / WEIGHTS, out / CHECKPOINT, tuple(history), rate, share)


def train(
    config: TrainConfig,
    out: str | Path,
    *,
    device: str = "cpu",
    devices: int = 1,
    nodes: int = 1,
    on_progress: OnProgress | None = None,
    cache: str | Path | None = None,
    fold: Fold | None = None,
) -> Trained:
    """Train a network in folder ``out`` and return the result; an interrupted run resumes after its last full epoch.

    The result is the same with and without interruptions.

    Args:
        config: settings of the training.
        out: folder of this training only.
        device: ``cpu`` or ``cuda``.
        devices: processes or GPUs of each machine, each with ``batch`` frames per step.
        nodes: number of machines; each of them runs this call.
        on_progress: called after every batch; pickled where several processes train.
        cache: folder of simulated archives and labels, which trainings may share; None is a folder in ``out``.
        fold: validation scenes, in cross-validation.

    Raises:
        ValueError: the data do not fit the config, ``out`` holds another training, or the loss is not finite.
        OSError: a file cannot be read or written; the last full epoch is kept.
        ImportError: torch is not installed.
    """
    machines, folder = Machines(device, devices, nodes), Path(out)
    require_torch()
    from viewshed_lab.training.fit import check_device, fit, read_history

    check_device(machines)
    check_data(config)
    history = read_history(config, folder)

    def on_preparation(stage: str, done: int, total: int) -> None:
        if on_progress is not None:
            on_progress(Step(stage, 0, config.epochs, done, total, float("nan")))

    data = prepare(config, folder / "cache" if cache is None else Path(cache), fold, on_preparation)
    return Trained.of(folder, fit(config, data, folder, machines, on_progress, history))


def require_torch() -> None:
    """Raise an ImportError unless torch and Lightning are installed."""
    with needed_for("training"):
        import lightning  # noqa: F401
        import torch  # noqa: F401
