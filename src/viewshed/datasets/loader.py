"""ArchiveFrames: an archive as arrays for training; works with torch's DataLoader and needs no torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.bev import BevGrid
from viewshed.datasets.archive import Archive
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.level import level_sweep
from viewshed.sweep import Sweep
from viewshed.visible import CAR, Target

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class ArchiveFrames:
    """An archive as a map-style data set: ``len(frames)`` and ``frames[i]``, in any number of processes.

    Attributes:
        archive: the archive, or one of its splits.
        target: whose visibility is wanted.
    """

    archive: Archive
    target: Target = CAR

    def __len__(self) -> int:
        return len(self.archive)

    def __getitem__(self, index: int) -> Arrays:
        """Return one frame as writable arrays (cells, cells) of its own.

        ``counts``, int32: returns in each cell; ``visible``, bool: the truth; ``known``, bool: where it is known.

        Raises:
            IndexError: there is no such frame.
            ValueError: its shard is damaged, or the truth was not made for the target.
            OSError: its shard cannot be read.
        """
        frame, _ = self.archive.frame(index)
        sweep, truth = frame.sweep, frame.truth
        return {
            "counts": truth.grid.count(sweep.points, level_from_sensor(sweep, truth.grid)),
            "visible": truth.visible(self.target),
            "known": np.array(frame.known),
        }


def level_from_sensor(sweep: Sweep, grid: BevGrid) -> Rigid:
    """Return the transform to the ``level`` frame: from attitude and height where both are known, else estimated."""
    attitude, height_m = sweep.known_attitude, sweep.sensor_height_m
    if attitude is None or height_m is None:
        return level_sweep(sweep, grid).level_from_sensor
    return Rigid(rotation_from_quaternion(attitude), np.array([0.0, 0.0, height_m]))
