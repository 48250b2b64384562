"""Views and detections with given values."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.detections import Detections, ObjectKind
from viewshed.objects.views import hidden_within


@dataclass(frozen=True, slots=True)
class ScriptedView:
    """A view whose probability of visible is a given function of positions (K, 2)."""

    t_s: float
    seen: Callable[[F64], F64]
    found: float = 1.0
    in_world: bool = True

    def visible(self, boxes: F64) -> F64:
        return np.asarray(self.seen(boxes[:, :2]), np.float64)

    def detectable(self, boxes: F64, kinds: NDArray[np.uint8]) -> F64:
        return np.full(len(boxes), self.found)

    def false_odds(self, boxes: F64, kinds: NDArray[np.uint8]) -> F64 | None:
        return None

    def hides_near(self, boxes: F64, within_m: F64) -> F64:
        return hidden_within(self, boxes, within_m)


def everywhere(prob: float) -> Callable[[F64], F64]:
    """Return a function that gives each place the same probability."""
    return lambda xy: np.full(len(xy), prob)


def cars(*centers: tuple[float, float], yaw: float = 0.0) -> Detections:
    """Return cars (4.2 x 1.8 m) at these places."""
    boxes = np.array([[x, y, 0.75, 4.2, 1.8, 1.5, yaw] for x, y in centers]).reshape(-1, 7)
    return Detections(boxes, np.full(len(boxes), ObjectKind.CAR), np.full(len(boxes), 50))
