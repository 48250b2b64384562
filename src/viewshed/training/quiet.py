"""What Lightning and torch say and choose while a training runs [torch]."""

from __future__ import annotations

import contextlib
import logging
import os
import warnings
from collections.abc import Iterator

import torch

_LOGGERS = ("lightning.pytorch", "lightning.fabric", "torch.onnx")


def hush() -> None:
    """Keep what Lightning and torch say to themselves: our progress and our errors say it.

    A graphics card chooses only convolutions that give the same bits again.
    """
    for name in _LOGGERS:
        logging.getLogger(name).setLevel(logging.ERROR)
    for module in ("lightning", "torch"):
        warnings.filterwarnings("ignore", module=module)
    torch.backends.cudnn.deterministic = True


@contextlib.contextmanager
def own_cores(workers: int) -> Iterator[None]:
    """Leave a core to each worker: torch's threads wait for the slowest, and one that has to wait stops them all."""
    before = torch.get_num_threads()
    torch.set_num_threads(min(before, max((os.cpu_count() or 1) - workers, 1)))
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """As :func:`hush`, and afterwards all is as it was."""
    levels = {name: logging.getLogger(name).level for name in _LOGGERS}
    deterministic = torch.backends.cudnn.deterministic
    with warnings.catch_warnings():
        hush()
        try:
            yield
        finally:
            torch.backends.cudnn.deterministic = deterministic
            for name, level in levels.items():
                logging.getLogger(name).setLevel(level)
