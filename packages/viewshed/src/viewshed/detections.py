"""Detections: the boxes of a detector in one frame, with kind and number of returns of each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import frozen
from viewshed.geometry import Rigid

BOX_COLUMNS = ("x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "yaw")
"""Columns of a box: center, size, and heading in radians, counter-clockwise from x."""


class ObjectKind(IntEnum):
    """Class of an object, by its size."""

    OTHER = 0
    PEDESTRIAN = 1
    CYCLIST = 2
    CAR = 3
    TRUCK = 4


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Objects detected in one sweep, in one frame (``level`` of the sweep, unless stated otherwise).

    Raises:
        ValueError: the lengths differ, a number is not finite, a size is not positive, or a count is negative.
    """

    boxes: NDArray[np.float64]  # (K, 7) float64, columns ``BOX_COLUMNS``
    kinds: NDArray[np.uint8]  # (K,) uint8 of :class:`ObjectKind`; unknown values become OTHER
    returns: NDArray[np.int32]  # (K,) int32 number of returns in each box; 0 if unknown

    def __post_init__(self) -> None:
        kinds, returns = np.asarray(self.kinds), np.asarray(self.returns)
        # Replace values out of range and NaN before the cast, which would wrap them.
        kinds = np.where((kinds >= 0) & (kinds < len(ObjectKind)), kinds, ObjectKind.OTHER)
        invalid = ~((returns >= 0) & (returns <= np.iinfo(np.int32).max))
        if invalid.any():
            raise ValueError(
                f"returns must be counts of 0 or more, got {returns[invalid][0]}; give 0 where none is known"
            )
        for name, values, kind in (
            ("boxes", self.boxes, np.float64), ("kinds", kinds, np.uint8), ("returns", returns, np.int32)
        ):  # fmt: skip
            object.__setattr__(self, name, frozen(np.array(values, kind)))
        count = len(self.boxes)
        if self.boxes.shape != (count, 7) or self.kinds.shape != (count,) or self.returns.shape != (count,):
            raise ValueError(
                "detections must be boxes (K, 7), kinds (K,) and returns (K,), got"
                f" {self.boxes.shape}, {self.kinds.shape} and {self.returns.shape}"
            )
        bad = np.flatnonzero(~np.isfinite(self.boxes).all(axis=1) | (self.boxes[:, 3:6] <= 0).any(axis=1))
        if len(bad):
            numbers = ", ".join(
                f"{name} {value:g}" for name, value in zip(BOX_COLUMNS, self.boxes[bad[0]], strict=True)
            )
            raise ValueError(f"boxes must be finite and have positive sizes, got box {bad[0]}: {numbers}; leave it out")

    def __len__(self) -> int:
        """Return the number of objects."""
        return len(self.boxes)

    @classmethod
    def none(cls) -> Self:
        """Return the detections of a sweep without objects."""
        return cls(np.zeros((0, 7)), np.zeros(0, np.uint8), np.zeros(0, np.int32))

    def take(self, chosen: NDArray[Any]) -> Self:
        """Return the objects selected by a mask (K,) or by indices."""
        return type(self)(self.boxes[chosen], self.kinds[chosen], self.returns[chosen])

    def moved(self, other_from_here: Rigid) -> Self:
        """Return the objects in another frame with a vertical z axis."""
        return type(self)(moved_boxes(self.boxes, other_from_here), self.kinds, self.returns)


def moved_boxes(boxes: NDArray[np.floating[Any]], other_from_here: Rigid) -> NDArray[np.float64]:
    """Return boxes (K, 7) in another frame with a vertical z axis: center and heading are transformed.

    >>> quarter_turn = Rigid.from_yaw(np.pi / 2)
    >>> moved_boxes(np.array([[1.0, 0.0, 0.5, 4.0, 2.0, 1.5, 0.0]]), quarter_turn).round(3).tolist()
    [[0.0, 1.0, 0.5, 4.0, 2.0, 1.5, 1.571]]
    """
    moved = np.array(boxes, np.float64)
    rotation = other_from_here.rotation
    moved[:, :3] = moved[:, :3] @ rotation.T + other_from_here.translation
    moved[:, 6] = (moved[:, 6] + np.arctan2(rotation[1, 0], rotation[0, 0]) + np.pi) % (2 * np.pi) - np.pi
    return moved
