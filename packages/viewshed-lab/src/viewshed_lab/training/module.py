"""Learner: the network, its loss and its scores as a LightningModule [torch]."""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from typing import Any

import lightning as L  # noqa: N812
import torch
from torch import Tensor
from torch.nn import functional

import viewshed
from viewshed_lab.training.config import TrainConfig
from viewshed_lab.training.log import Epoch, OnProgress, Step, best_of, scores_of
from viewshed_lab.training.unet_torch import UNet

FORMAT = 1
"""Version of our entry in a checkpoint."""

KEY = "viewshed"
_LAST_RATE = 0.01
_MOMENTUM = 0.1
Batch = dict[str, Tensor]


class Learner(L.LightningModule):
    """Fits a U-Net, ``steps`` batches per epoch; checkpoints hold its history and the weights of the best epoch."""

    def __init__(self, config: TrainConfig, steps: int, on_progress: OnProgress | None = None) -> None:
        super().__init__()
        self.config, self.steps, self.on_progress = config, steps, on_progress
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.network = UNet(config.shape).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.history: list[Epoch] = []
        self.best: dict[str, Tensor] = {}
        self._began_s = self._step_s = self._busy_s = self._train_s = 0.0
        self._train = torch.zeros(2)
        self._cells = torch.zeros(6, dtype=torch.float64)

    def loss(self, logits: Tensor, batch: Batch) -> Tensor:
        """Return the config's loss over the cells with known truth."""
        visible, known = batch["visible"], batch["known"]
        logits = logits[:, 0].float()
        cells = functional.binary_cross_entropy_with_logits(logits, visible, reduction="none") * known
        loss = cells.sum() / known.sum().clamp(min=1.0)
        if self.config.loss == "bce":
            return loss
        prob = torch.sigmoid(logits) * known
        both, either = (prob * visible).sum(), prob.sum() + (visible * known).sum()
        return loss + 1.0 - (2.0 * both + 1.0) / (either + 1.0)

    def configure_optimizers(self) -> Any:
        """Return Adam and the config's schedule."""
        optimizer = torch.optim.Adam(self.network.parameters(), lr=self.config.learning_rate)
        if self.config.schedule == "constant":
            return optimizer
        total = max(self.steps * self.config.epochs, 1)
        cosine = torch.optim.lr_scheduler.CosineAnnealingLR(
            optimizer, total, eta_min=_LAST_RATE * self.config.learning_rate
        )
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": cosine, "interval": "step"}}

    def on_train_epoch_start(self) -> None:
        """Reset the timers and the sum of the loss."""
        self._began_s, self._busy_s = time.perf_counter(), 0.0
        self._train = torch.zeros(2, device=self.device)

    def on_train_batch_start(self, batch: Batch, batch_idx: int) -> None:
        """Start the timer of a step. In the very first step, batch normalization copies the statistics of the batch.

        They start at mean 0 and variance 1, but a cell's count / 1000 has a variance near 1e-6: the running average
        would need hundreds of steps.
        """
        self._step_s = time.perf_counter()
        for module in self.network.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.momentum = 1.0 if self.trainer.global_step == 0 else _MOMENTUM

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """Return the loss of a batch."""
        loss = self.loss(self._logits(batch), batch)
        count = len(batch["inputs"])
        self._train += torch.stack([loss.detach() * count, loss.new_tensor(count)])
        return loss

    def on_train_batch_end(self, outputs: Any, batch: Batch, batch_idx: int) -> None:
        """Stop the timer of a step and report progress."""
        self._end_step()
        self._train_s = time.perf_counter() - self._began_s
        self._report("train", batch_idx + 1, self.trainer.num_training_batches, float(outputs["loss"]))

    def on_validation_epoch_start(self) -> None:
        """Reset the sums over cells: loss, known cells, and the four confusion counts."""
        self._cells = torch.zeros(6, dtype=torch.float64, device=self.device)

    def on_validation_batch_start(self, batch: Batch, batch_idx: int, dataloader_idx: int = 0) -> None:
        """Start the timer of a step."""
        self._step_s = time.perf_counter()

    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        """Add the loss and the confusion counts of a batch; dropout is off."""
        logits = self._logits(batch | {"masks": torch.ones_like(batch["masks"])})[:, 0].float()
        visible, known = batch["visible"] > 0, batch["known"] > 0
        cells = functional.binary_cross_entropy_with_logits(logits, batch["visible"], reduction="none")
        predicted = torch.sigmoid(logits) >= self.config.threshold
        masks = (predicted & visible, predicted & ~visible, ~predicted & visible, ~predicted & ~visible)
        counts = [(mask & known).sum() for mask in masks]
        self._cells += torch.stack([(cells * known).sum(dtype=torch.float64), known.sum(), *counts]).double()

    def on_validation_batch_end(self, outputs: Any, batch: Batch, batch_idx: int, dataloader_idx: int = 0) -> None:
        """Stop the timer of a step and report progress."""
        self._end_step()
        total = self.trainer.num_val_batches
        self._report("validate", batch_idx + 1, total[0] if isinstance(total, list) else total, float("nan"))

    def on_validation_epoch_end(self) -> None:
        """Log the mean loss over all processes."""
        self._cells = self._summed(self._cells)
        self.log("validation_loss", self._cells[0] / self._cells[1].clamp(min=1.0), rank_zero_only=False)

    def on_train_epoch_end(self) -> None:
        """Add the epoch to the history; keep its weights if it is the best so far."""
        loss, known, *counts = (float(value) for value in self._cells.cpu())
        trained, frames = (float(value) for value in self._summed(self._train).cpu())
        if not math.isfinite(trained + loss):
            raise ValueError(
                f"{self.config.name}: the loss of epoch {self.current_epoch + 1} is not finite; choose a smaller "
                "learning_rate, or precision 32"
            )
        rate = float(self.optimizers().param_groups[0]["lr"])  # type: ignore[union-attr]
        elapsed = time.perf_counter() - self._began_s
        self.history.append(Epoch(
            self.current_epoch + 1, trained / max(frames, 1.0), loss / max(known, 1.0), **scores_of(counts),
            learning_rate=rate, seconds=elapsed, frames_per_s=frames / max(self._train_s, 1e-9),
            network_share=self._busy_s / elapsed,
        ))  # fmt: skip
        if best_of(self.history) is self.history[-1]:
            self.best = {name: value.detach().cpu().clone() for name, value in self.network.state_dict().items()}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add our entry: format, version, config, history, weights of the best epoch."""
        about = {"format": FORMAT, "version": viewshed.__version__, "config": self.config.to_json()}
        checkpoint[KEY] = about | {"history": [asdict(epoch) for epoch in self.history], "best": self.best}

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Restore the history and the best weights."""
        self.history = [Epoch(**table) for table in checkpoint[KEY]["history"]]
        self.best = checkpoint[KEY]["best"]

    def _end_step(self) -> None:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        self._busy_s += time.perf_counter() - self._step_s

    def _logits(self, batch: Batch) -> Tensor:
        inputs = batch["inputs"].contiguous(memory_format=torch.channels_last)
        logits: Tensor = self.network(inputs, batch["masks"])
        return logits

    def _summed(self, values: Tensor) -> Tensor:
        total = self.trainer.strategy.reduce(values, reduce_op="sum")
        return torch.as_tensor(total)

    def _report(self, stage: str, done: int, total: float, loss: float) -> None:
        if self.on_progress is not None and self.trainer.is_global_zero:
            self.on_progress(Step(stage, self.current_epoch + 1, self.config.epochs, done, int(total), loss))
