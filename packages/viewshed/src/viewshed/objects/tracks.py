"""Tracks: what a tracker holds of all objects at one time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """All tracks after one sweep, in the world (or in the sensor's ``level`` frame where there is no pose)."""

    t_s: float  # time of the sweep
    ids: NDArray[np.int64]  # (N,) int64, the same for one object over time, never given twice
    states: F64  # (N, 4) x, y in meters and their velocities in m/s
    covariances: F64  # (N, 4, 4) of the states
    boxes: F64  # (N, 7) columns ``viewshed.detections.BOX_COLUMNS``; the centers are those of the states
    box_variances: F64  # (N, 5) of z, length, width, height (square meters) and yaw (square radians)
    kinds: NDArray[np.uint8]  # (N,) uint8 of :class:`viewshed.detections.ObjectKind`
    existence: F64  # (N,) probability that there is such an object
    confirmed: NDArray[np.bool_]  # (N,) bool, existence has been high enough once; what others are shown
    # (N,) int32 number of the detection that each was matched with in this sweep, -1 for none
    detection: NDArray[np.int32]
    visible: F64  # (N,) probability that the view let it be seen in this sweep
    detectable: F64  # (N,) probability that the detector finds it where the view lets it be seen
    born_s: F64  # (N,) time of its first detection
    seen_s: F64  # (N,) time of its last detection
    born_hidden: F64  # (N,) probability, at its first detection, that it could have come from where nothing was seen
    in_world: bool = True  # False where the sweep had no pose, so that all of this is in its ``level`` frame
    notes: tuple[str, ...] = ()  # what was refused or dropped in this sweep, and why, in sentences

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.ids)

    def take(self, chosen: Mask | NDArray[np.intp]) -> Tracks:
        """Return some tracks, by a mask (N,) or by their numbers."""
        return replace(self, **{name: getattr(self, name)[chosen] for name in TRACK_ROWS})

    def joined(self, others: Tracks) -> Tracks:
        """Return these tracks and others of the same time after them."""
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in TRACK_ROWS
        }
        return replace(self, **arrays)


TRACK_ROWS = tuple(name for name in Tracks.__slots__ if name not in {"t_s", "in_world", "notes"})
"""The arrays of ``Tracks`` with a row for each track."""
