"""Files, progress and history of a training, one record per epoch. Needs no torch."""

from __future__ import annotations

import contextlib
import csv
import errno
import io
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from viewshed._files import write_atomic
from viewshed_lab._config import Between, Checked, OneOf
from viewshed_lab._jobs import J, LocalEngine
from viewshed_lab.training.config import TrainConfig

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)

CHECKPOINT, WEIGHTS, STATE, HISTORY, CURVES = "last.ckpt", "network.onnx", "network.pt", "history.csv", "curves.png"
"""Files that a training writes to its folder."""


@dataclass(frozen=True, slots=True)
class Machines(Checked):
    """Hardware of a training."""

    device: Annotated[str, OneOf(("cpu", "cuda"))] = "cpu"
    devices: Annotated[int, Between(1)] = 1  # processes or GPUs per machine
    nodes: Annotated[int, Between(1)] = 1  # machines


def save(path: Path, content: bytes) -> None:
    """Write or replace a file atomically; on an OSError an existing file is kept."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, content)
    except OSError as error:
        full = error.errno in _DISK_FULL
        what = "the disk is full; free some space" if full else f"{error.strerror or error}; fix that"
        named = type(error)(f"{path}: {what} and run the same command again; it resumes from the last complete epoch")
        named.errno = error.errno
        raise named from error


def build_files(
    work: Callable[[J], int], folder: Path, jobs: Sequence[J], workers: int, on_progress: Callable[[int], None] | None
) -> None:
    """Run jobs in ``workers`` processes; each writes one file into ``folder`` and returns its number of frames.

    Raises:
        OSError: a job failed; finished files are kept.
    """
    if jobs:
        folder.mkdir(parents=True, exist_ok=True)
    with contextlib.closing(LocalEngine(workers).run(work, jobs)) as run:
        for done in run:
            if done.result is None:
                raise OSError(f"{done.error}; finished work is kept; the same command resumes")
            if on_progress is not None:
                on_progress(done.result)


def write_array(path: Path, rows: NDArray[np.uint8]) -> None:
    """Write an array as an NPY file, atomically."""
    buffer = io.BytesIO()
    np.save(buffer, rows)
    write_atomic(path, buffer.getvalue())


@lru_cache(maxsize=4096)
def mapped_array(path: Path) -> NDArray[np.uint8]:
    """Memory-map an array that :func:`write_array` wrote: all processes share one copy in the page cache."""
    rows: NDArray[np.uint8] = np.load(path, mmap_mode="r")
    return rows


@dataclass(frozen=True, slots=True)
class Step:
    """Progress of a training."""

    stage: str  # ``train``, ``validate``, or the preparation stage before them
    epoch: int  # number, from 1; 0 before the first
    epochs: int  # maximum
    done: int  # finished batches or frames of the stage
    total: int  # batches or frames of the stage
    loss: float  # of the last batch


OnProgress = Callable[[Step], None]


@dataclass(frozen=True, slots=True)
class Epoch:
    """Losses, validation scores and times of one epoch. Scores count the cells with known truth."""

    number: int  # from 1
    train_loss: float  # mean over the training frames, while the weights changed
    validation_loss: float  # over the validation frames, without dropout
    precision: float  # truly visible share of the cells predicted visible
    recall: float  # share of the truly visible cells that are predicted visible
    f1: float  # harmonic mean of precision and recall
    iou: float  # cells predicted and truly visible, over cells predicted or truly visible
    accuracy: float  # share of the cells predicted correctly
    learning_rate: float  # at the end of the epoch
    seconds: float  # duration
    frames_per_s: float  # training frames per second of training, including waits, without validation
    network_share: float  # share of training and validation time in which the network ran


TIMES = ("seconds", "frames_per_s", "network_share")
"""Fields of measured times, which differ between runs of the same config."""


def best_of(history: Sequence[Epoch]) -> Epoch:
    """Return the first epoch with the lowest validation loss."""
    return min(history, key=lambda epoch: epoch.validation_loss)


def is_finished(history: Sequence[Epoch], config: TrainConfig) -> bool:
    """Return whether all epochs are done, or the last ``patience`` of them did not lower the validation loss."""
    if not history:
        return False
    return len(history) >= config.epochs or len(history) - best_of(history).number >= config.patience


def csv_of(history: Sequence[Epoch]) -> str:
    """Return a history as CSV, one line per epoch."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, [item.name for item in fields(Epoch)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(asdict, history))
    return buffer.getvalue()


def scores_of(counts: Sequence[float]) -> dict[str, float]:
    """Return the scores of confusion counts; a score without any cells is 0.

    Args:
        counts: true positives, false positives, false negatives, true negatives.

    >>> scores_of([6, 2, 1, 11])["f1"]
    0.8
    """
    tp, fp, fn, tn = counts
    ratios = {
        "precision": (tp, tp + fp),
        "recall": (tp, tp + fn),
        "f1": (2 * tp, 2 * tp + fp + fn),
        "iou": (tp, tp + fp + fn),
        "accuracy": (tp + tn, tp + fp + fn + tn),
    }
    return {name: part / whole if whole else 0.0 for name, (part, whole) in ratios.items()}
