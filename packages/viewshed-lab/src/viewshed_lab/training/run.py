"""``train``: from a config to weights; a run that was stopped resumes. Imports torch only when it is called."""

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
    """What a training left."""

    weights: Path  # ``network.onnx`` of the best epoch
    checkpoint: Path  # ``last.ckpt``, from which training would go on
    history: tuple[Epoch, ...]  # its epochs
    frames_per_s: float  # frames trained on in a second, waiting for frames counted
    network_share: float  # share of the time in which the network ran

    @property
    def best(self) -> Epoch:
        """The epoch whose weights are kept."""
        return best_of(self.history)

    @classmethod
    def of(cls, out: Path, history: Sequence[Epoch]) -> Trained:
        """Return what lies in a folder."""
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
    """Return what training left in ``out``; a run that was stopped goes on after its last whole epoch.

    The end does not depend on whether and where it was stopped.

    Args:
        config: what is trained.
        out: folder of this training alone.
        device: ``cpu`` or ``cuda``.
        devices: processes or graphics cards of each machine, each with ``batch`` frames a step.
        nodes: machines, each of which runs this call.
        on_progress: is called after every batch; where several processes train, it is sent to them.
        cache: folder for simulated archives and labels, which several trainings may share; None is inside ``out``.
        fold: which scenes validate, in cross-validation.

    Raises:
        ValueError: the data do not fit the config, ``out`` holds another training, or the loss is not finite.
        OSError: something cannot be read or written; the last whole epoch stays.
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
    """Check that what training needs is installed."""
    with needed_for("training"):
        import lightning  # noqa: F401
        import torch  # noqa: F401
