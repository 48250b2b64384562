"""Tracks of all objects at one time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """All tracks after one sweep, in the world (in the sensor's ``level`` frame if there is no pose)."""

    t_s: float  # time of the sweep in seconds
    ids: NDArray[np.int64]  # (N,) int64, constant over time for one object, never reused
    states: F64  # (N, 4) x, y in meters and their velocities in m/s
    covariances: F64  # (N, 4, 4) of the states
    boxes: F64  # (N, 7) columns ``viewshed.detections.BOX_COLUMNS``; the centers are those of the states
    box_variances: F64  # (N, 5) of z, length, width, height (square meters) and yaw (square radians)
    kinds: NDArray[np.uint8]  # (N,) uint8 of :class:`viewshed.detections.ObjectKind`
    existence: F64  # (N,) probability that the object exists
    confirmed: NDArray[np.bool_]  # (N,) bool, existence has been high enough once; only these are shown to others
    detection: NDArray[np.int32]  # (N,) int32 index of the matched detection in this sweep, -1 for none
    visible: F64  # (N,) probability that it could be seen in this sweep
    detectable: F64  # (N,) probability that the detector finds it, given that it can be seen
    born_s: F64  # (N,) time of its first detection
    seen_s: F64  # (N,) time of its last detection
    born_hidden: F64  # (N,) probability, at its first detection, that it could have come from an unseen place
    in_world: bool = True  # False if the sweep had no pose, so that everything is in its ``level`` frame
    notes: tuple[str, ...] = ()  # what was refused or dropped in this sweep, and why, one sentence each

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.ids)

    def take(self, chosen: Mask | NDArray[np.intp]) -> Tracks:
        """Return some tracks, by a mask (N,) or by their indices."""
        return replace(self, **{name: getattr(self, name)[chosen] for name in TRACK_ROWS})

    def joined(self, others: Tracks) -> Tracks:
        """Return these tracks followed by others of the same time."""
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in TRACK_ROWS
        }
        return replace(self, **arrays)


TRACK_ROWS = tuple(name for name in Tracks.__slots__ if name not in {"t_s", "in_world", "notes"})
"""The arrays of ``Tracks`` with one row per track."""
