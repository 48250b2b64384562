"""Checkpoints that are whole or not there, of this config and version [torch]."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.plugins.io import TorchCheckpointIO

import viewshed
from viewshed.training.config import TrainConfig
from viewshed.training.files import save
from viewshed.training.learner import FORMAT, KEY

_REPAIR = "delete it, and training begins again"


class WholeCheckpoints(TorchCheckpointIO):
    """Writes a checkpoint beside the old one and moves it into place; reads tensors and plain values only."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Write a checkpoint.

        Raises:
            OSError: it cannot be written; the one before is still there.
        """
        buffer = io.BytesIO()
        torch.save(checkpoint, buffer)
        save(Path(path), buffer.getvalue())

    def load_checkpoint(self, path: Any, map_location: Any = "cpu", weights_only: bool | None = True) -> dict[str, Any]:
        """Return a checkpoint of anything that Lightning wrote.

        Raises:
            ValueError: it is damaged.
            OSError: it cannot be read.
        """
        return _loaded(Path(path))


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Return a checkpoint on the processor.

    Raises:
        ValueError: it is damaged, or no training's of this format.
        OSError: it cannot be read.
    """
    found = _loaded(path)
    if not isinstance(found.get(KEY), dict):
        raise ValueError(f"{path} must be a checkpoint of viewshed train, got another; {_REPAIR}")
    version = found[KEY].get("format")
    if version != FORMAT:
        raise ValueError(f"{path} must have format {FORMAT}, got {version}; {_REPAIR}")
    return found


def _loaded(path: Path) -> dict[str, Any]:
    content = path.read_bytes()
    try:
        found: Any = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        return dict(found)
    except Exception as error:  # torch raises whatever its parts raise
        raise ValueError(f"{path} is damaged or no checkpoint; {_REPAIR}") from error


def check_same(found: dict[str, Any], config: TrainConfig, path: Path) -> None:
    """Check that a checkpoint is of this config and version of the code.

    Raises:
        ValueError: it is of another one.
    """
    before, now = found[KEY]["config"], config.to_json()
    if before != now:
        keys = ", ".join(sorted(key for key in {*before, *now} if before.get(key) != now.get(key)))
        raise ValueError(f"{path} is of a training with other {keys}; choose another --out, or delete it")
    version = found[KEY]["version"]
    if version != viewshed.__version__:
        raise ValueError(
            f"{path} was begun with viewshed {version}, this is {viewshed.__version__}; finish it with that version, "
            "or choose another --out"
        )
