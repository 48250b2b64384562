"""The files, progress and history of a training: one record an epoch, whether it is finished. Needs no torch."""

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

_FULL = (errno.ENOSPC, errno.EDQUOT)

CHECKPOINT, WEIGHTS, STATE, HISTORY, CURVES = "last.ckpt", "network.onnx", "network.pt", "history.csv", "curves.png"
"""What a training leaves in its folder."""


@dataclass(frozen=True, slots=True)
class Machines(Checked):
    """What a training runs on: ``cpu`` or ``cuda``, processes or graphics cards of each machine, and machines."""

    device: Annotated[str, OneOf(("cpu", "cuda"))] = "cpu"
    devices: Annotated[int, Between(1)] = 1
    nodes: Annotated[int, Between(1)] = 1


def save(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all; one that exists is replaced, or stays where an OSError is raised."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, content)
    except OSError as error:
        what = "the disk is full; free some space" if error.errno in _FULL else f"{error.strerror or error}; mend that"
        named = type(error)(f"{path}: {what} and start the same command again, it goes on from the last whole epoch")
        named.errno = error.errno
        raise named from error


def build_files(
    work: Callable[[J], int], folder: Path, jobs: Sequence[J], workers: int, on_progress: Callable[[int], None] | None
) -> None:
    """Run jobs that each write a file into a folder and return how many frames it holds, in ``workers`` processes.

    Raises:
        OSError: a job failed; files that are finished stay.
    """
    if jobs:
        folder.mkdir(parents=True, exist_ok=True)
    with contextlib.closing(LocalEngine(workers).run(work, jobs)) as run:
        for done in run:
            if done.result is None:
                raise OSError(f"{done.error}; what is finished is kept, the same command goes on from here")
            if on_progress is not None:
                on_progress(done.result)


def write_array(path: Path, rows: NDArray[np.uint8]) -> None:
    """Write an array as NPY, whole or not at all."""
    buffer = io.BytesIO()
    np.save(buffer, rows)
    write_atomic(path, buffer.getvalue())


@lru_cache(maxsize=4096)
def mapped_array(path: Path) -> NDArray[np.uint8]:
    """Return an array of :func:`write_array`, mapped into memory: all processes share one copy in the page cache."""
    rows: NDArray[np.uint8] = np.load(path, mmap_mode="r")
    return rows


@dataclass(frozen=True, slots=True)
class Step:
    """How far a training is."""

    stage: str  # ``train``, ``validate``, or what is prepared before
    epoch: int  # number, from 1; 0 before the first
    epochs: int  # at most
    done: int  # batches or frames of the stage that are done
    total: int  # how many there are
    loss: float  # of the last batch


OnProgress = Callable[[Step], None]


@dataclass(frozen=True, slots=True)
class Epoch:
    """One epoch."""

    number: int  # from 1
    train_loss: float  # mean over the frames it showed, while the weights changed
    validation_loss: float  # over the frames that validate, without dropout
    precision: float  # of the cells called visible there, the share that is
    recall: float  # of the visible cells there, the share that is called so
    f1: float  # harmonic mean of these two
    iou: float  # cells both called and truly visible, of those that are either
    accuracy: float  # share of cells that are called what they are
    learning_rate: float  # at its end
    seconds: float  # that it took
    frames_per_s: float  # frames trained on in a second of training, waiting counted, validation not
    network_share: float  # share of training and validation in which the network ran, not waiting for frames


TIMES = ("seconds", "frames_per_s", "network_share")
"""Measured times: another run of the same config has others."""


def best_of(history: Sequence[Epoch]) -> Epoch:
    """Return the first epoch with the lowest validation loss."""
    return min(history, key=lambda epoch: epoch.validation_loss)


def is_finished(history: Sequence[Epoch], config: TrainConfig) -> bool:
    """Return whether training has ended: all epochs done, or ``patience`` of them without a lower validation loss."""
    if not history:
        return False
    return len(history) >= config.epochs or len(history) - best_of(history).number >= config.patience


def csv_of(history: Sequence[Epoch]) -> str:
    """Return a history as a table with commas, one epoch a line."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, [item.name for item in fields(Epoch)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(asdict, history))
    return buffer.getvalue()


def scores_of(counts: Sequence[float]) -> dict[str, float]:
    """Return the scores of cells: true and false positives, false and true negatives; 0 where there is nothing.

    >>> scores_of([6, 2, 1, 11])["f1"]
    0.8
    """
    hit, over, missed, right = counts
    shares = {
        "precision": (hit, hit + over),
        "recall": (hit, hit + missed),
        "f1": (2 * hit, 2 * hit + over + missed),
        "iou": (hit, hit + over + missed),
        "accuracy": (hit + right, hit + over + missed + right),
    }
    return {name: part / whole if whole else 0.0 for name, (part, whole) in shares.items()}
