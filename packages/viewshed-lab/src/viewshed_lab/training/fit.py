"""Run one training with Lightning: loaders, processes, checkpoints, and the final weights [torch].

A checkpoint is Lightning's (weights, optimizer, schedule, epoch, random states) plus one entry of ours: config,
version, history and the weights of the best epoch. It is written to disk before it replaces the previous one, so a kill
or a power failure leaves a complete checkpoint. A resumed training is bit-equal to an uninterrupted one. The history
table is rewritten after every epoch, because Lightning's CSV logger deletes the old table on a resume.
"""

from __future__ import annotations

import contextlib
import io
import logging
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import lightning as L  # noqa: N812
import torch
from lightning.pytorch.callbacks import Callback, EarlyStopping, ModelCheckpoint
from lightning.pytorch.plugins.io import TorchCheckpointIO
from torch.multiprocessing.spawn import ProcessRaisedException
from torch.utils.data import DataLoader, Dataset

import viewshed
from viewshed_lab._page import facts
from viewshed_lab.training.config import TrainConfig, current_keys, differing_keys
from viewshed_lab.training.data import TrainingData
from viewshed_lab.training.log import (
    CHECKPOINT,
    CURVES,
    HISTORY,
    STATE,
    WEIGHTS,
    Epoch,
    Machines,
    OnProgress,
    best_of,
    csv_of,
    is_finished,
    save,
)
from viewshed_lab.training.module import FORMAT, KEY, Learner
from viewshed_lab.training.samples import Share, TrainingFrames, TrainingOrder, ValidationOrder
from viewshed_lab.training.unet_torch import UNet, save_weights

_REPAIR = "delete it, and training begins again"


class AtomicCheckpoints(TorchCheckpointIO):
    """Replaces checkpoints atomically; reads tensors and plain values only."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Write a checkpoint; on an OSError the previous one is kept."""
        buffer = io.BytesIO()
        torch.save(checkpoint, buffer)
        save(Path(path), buffer.getvalue())

    def load_checkpoint(self, path: Any, map_location: Any = "cpu", weights_only: bool | None = True) -> dict[str, Any]:
        """Return a checkpoint that Lightning wrote, on the CPU."""
        return _load(Path(path))


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Return a training checkpoint on the CPU; raise a ValueError if it is damaged or has another format."""
    checkpoint = _load(path)
    if not isinstance(checkpoint.get(KEY), dict):
        raise ValueError(f"{path} must be a checkpoint of viewshed train, got another; {_REPAIR}")
    version = checkpoint[KEY].get("format")
    if version != FORMAT:
        raise ValueError(f"{path} must have format {FORMAT}, got {version}; {_REPAIR}")
    return checkpoint


def _load(path: Path) -> dict[str, Any]:
    content = path.read_bytes()
    try:
        checkpoint: Any = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        return dict(checkpoint)
    except Exception as error:  # torch.load raises many types
        raise ValueError(f"{path} is damaged or not a checkpoint; {_REPAIR}") from error


def _check_same(checkpoint: dict[str, Any], config: TrainConfig, path: Path) -> None:
    """Check that a checkpoint has the same config and viewshed version."""
    before, now = current_keys(checkpoint[KEY]["config"]), config.to_json()
    if before != now:
        other = differing_keys(before, now)
        raise ValueError(f"{path} belongs to a training with different {other}; choose another --out, or delete it")
    version = checkpoint[KEY]["version"]
    if version != viewshed.__version__:
        raise ValueError(
            f"{path} was begun with viewshed {version}, this is {viewshed.__version__}; finish it with that version, "
            "or choose another --out"
        )


_LOGGERS = ("lightning.pytorch", "lightning.fabric", "torch.onnx")


def silence() -> None:
    """Silence the loggers and warnings of Lightning and torch, and restrict cuDNN to deterministic convolutions.

    Our own progress and errors report the same.
    """
    for name in _LOGGERS:
        logging.getLogger(name).setLevel(logging.ERROR)
    for module in ("lightning", "torch"):
        warnings.filterwarnings("ignore", module=module)
    torch.backends.cudnn.deterministic = True


@contextlib.contextmanager
def leave_cores_to_workers(workers: int) -> Iterator[None]:
    """Leave one core to each loader process: a torch operation waits for its slowest thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(min(before, max((os.cpu_count() or 1) - workers, 1)))
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Apply :func:`silence`, and restore everything afterwards."""
    levels = {name: logging.getLogger(name).level for name in _LOGGERS}
    deterministic = torch.backends.cudnn.deterministic
    with warnings.catch_warnings():
        silence()
        try:
            yield
        finally:
            torch.backends.cudnn.deterministic = deterministic
            for name, level in levels.items():
                logging.getLogger(name).setLevel(level)


_PREFETCH = 4
_CAUGHT = "Caught "  # prefix of torch's message about an error in a worker; its last line is type and message


def check_device(machines: Machines) -> None:
    """Check that the machine has the graphics cards that were requested."""
    if machines.device == "cuda" and torch.cuda.device_count() < machines.devices:
        raise ValueError(
            f"device cuda needs {machines.devices} graphics card(s), {torch.cuda.device_count()} found; use --device "
            "cpu, fewer --devices, or install a torch built for CUDA"
        )


def read_history(config: TrainConfig, out: Path) -> list[Epoch]:
    """Return the epochs of the checkpoint in a folder; an empty list without a checkpoint."""
    path = out / CHECKPOINT
    if not path.is_file():
        return []
    checkpoint = read_checkpoint(path)
    _check_same(checkpoint, config, path)
    return [Epoch(**table) for table in checkpoint[KEY]["history"]]


def fit(
    config: TrainConfig,
    frames: TrainingData,
    out: Path,
    machines: Machines,
    on_progress: OnProgress | None,
    history: list[Epoch],
) -> list[Epoch]:
    """Train or resume; write checkpoint, weights, history table and curves to ``out``, and return the history."""
    if not is_finished(history, config):
        out.mkdir(parents=True, exist_ok=True)
        for name in (WEIGHTS, CURVES):  # left by a training whose checkpoint was deleted
            (out / name).unlink(missing_ok=True)
        loaders = Loaders(frames, config, machines)
        learner = Learner(config, loaders.steps, on_progress)
        with silenced(), leave_cores_to_workers(config.workers):
            trainer = _build_trainer(config, out, machines)
            last = out / CHECKPOINT
            _run(trainer, learner, loaders, str(last) if history else None)
        if not trainer.is_global_zero:
            return learner.history
    return _finish(config, out)


class Loaders(L.LightningDataModule):
    """Loads batches of frames, divided among the training processes."""

    def __init__(self, frames: TrainingData, config: TrainConfig, machines: Machines) -> None:
        super().__init__()
        self.frames, self.config = frames, config
        self.world = machines.devices * machines.nodes
        self.frames_per_epoch = min(config.frames_per_epoch or len(frames.train), len(frames.train))

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Unpickle in another training process, and silence its loggers as in the first one."""
        silence()
        self.__dict__.update(state)

    @property
    def steps(self) -> int:
        """Batches per epoch in one process."""
        count, batch = len(self._order(Share(0, self.world))), self.config.batch
        return count // batch if count >= batch else 1

    def train_dataloader(self) -> DataLoader[Any]:
        """Return the loader of the training frames; a partial last batch is dropped."""
        order = self._order(self._share())
        return self._loader(self.frames.train, order, len(order) >= self.config.batch)

    def val_dataloader(self) -> DataLoader[Any]:
        """Return the loader of the validation frames."""
        return self._loader(self.frames.validation, ValidationOrder(len(self.frames.validation), self._share()), False)

    def _order(self, share: Share) -> TrainingOrder:
        return TrainingOrder(len(self.frames.train), self.frames_per_epoch, self.config.seed, share)

    def _share(self) -> Share:
        return Share(self.trainer.global_rank, self.world) if self.trainer is not None else Share(0, self.world)

    def _loader(self, frames: TrainingFrames, order: Any, drop_last: bool) -> DataLoader[Any]:
        workers = self.config.workers
        return DataLoader[Any](
            cast(Dataset[Any], frames),
            batch_size=self.config.batch, sampler=order, drop_last=drop_last, num_workers=workers,
            persistent_workers=workers > 0, prefetch_factor=_PREFETCH if workers else None,
            pin_memory=torch.cuda.is_available(), generator=torch.Generator().manual_seed(self.config.seed),
        )  # fmt: skip


class _HistoryTable(Callback):
    """Writes the history table after every epoch."""

    def __init__(self, out: Path) -> None:
        self.out = out

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if trainer.is_global_zero and isinstance(pl_module, Learner):
            save(self.out / HISTORY, csv_of(pl_module.history).encode())


def _build_trainer(config: TrainConfig, out: Path, machines: Machines) -> L.Trainer:
    multiple_processes = machines.devices * machines.nodes > 1
    launched = machines.nodes > 1 or int(os.environ.get("WORLD_SIZE", "1")) > 1
    checkpoints = ModelCheckpoint(
        out, Path(CHECKPOINT).stem, save_top_k=1, save_on_train_epoch_end=True, enable_version_counter=False
    )
    stop = EarlyStopping("validation_loss", patience=config.patience, check_on_train_epoch_end=True)
    return L.Trainer(
        accelerator="cuda" if machines.device == "cuda" else "cpu", devices=machines.devices, num_nodes=machines.nodes,
        strategy=("ddp" if launched else "ddp_spawn") if multiple_processes else "auto",
        precision="bf16-mixed" if config.precision == "bf16" else "32-true", max_epochs=config.epochs,
        callbacks=[stop, checkpoints, _HistoryTable(out)], plugins=[AtomicCheckpoints()], default_root_dir=out,
        use_distributed_sampler=False, num_sanity_val_steps=0, logger=False, enable_progress_bar=False,
        enable_model_summary=False, benchmark=False,
    )  # fmt: skip


def _run(trainer: L.Trainer, learner: Learner, loaders: Loaders, last: str | None) -> None:
    """Fit; errors of other processes and workers become one line, Lightning's SystemExit a KeyboardInterrupt."""
    try:
        trainer.fit(learner, loaders, ckpt_path=last)
    except SystemExit as error:
        raise KeyboardInterrupt from error
    except ProcessRaisedException as error:
        raise OSError(str(error).strip().splitlines()[-1]) from error
    except (ValueError, OSError) as error:
        if not str(error).startswith(_CAUGHT):
            raise
        raise type(error)(str(error).strip().splitlines()[-1].partition(": ")[2]) from error
    except RuntimeError as error:
        if "DataLoader worker" not in str(error):
            raise
        what = "it may have run out of memory: use fewer workers, or a smaller batch"
        raise OSError(f"a worker ended early; {what}; the same command resumes from the last complete epoch") from error


def _finish(config: TrainConfig, out: Path) -> list[Epoch]:
    """Return the history in a folder; write weights, history table and learning curves if they are missing."""
    from viewshed_lab.training.figures import curve_figure
    from viewshed_lab.training.onnx_export import export_onnx

    checkpoint = read_checkpoint(out / CHECKPOINT)[KEY]
    history = [Epoch(**table) for table in checkpoint["history"]]
    if (out / WEIGHTS).is_file() and (out / CURVES).is_file():
        return history
    module = UNet(config.shape)
    module.load_state_dict(checkpoint["best"])
    card = config.card(**_training_facts(config, history))
    with silenced():
        save_weights(out / STATE, card, module.eval())
        save(out / HISTORY, csv_of(history).encode())
        save(out / CURVES, curve_figure(config.name, history))
        export_onnx(out / WEIGHTS, card, module.eval())
    return history


def _training_facts(config: TrainConfig, history: list[Epoch]) -> dict[str, str]:
    run, best = facts(), best_of(history)
    return {
        "data": ", ".join(Path(place).name for place in config.data), "split": config.train_split,
        "variant": config.variant, "attacks": ", ".join(config.attacks) or "none",
        "attack_share": f"{config.attack_share:g}", "loss": config.loss, "seed": str(config.seed),
        "epochs": str(len(history)), "best_epoch": str(best.number), "validation_f1": f"{best.f1:.4f}",
        "version": run["version"], "date": run["date"],
    }  # fmt: skip
