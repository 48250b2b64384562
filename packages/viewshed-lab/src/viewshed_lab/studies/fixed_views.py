"""Fields of view that no return changes, as earlier work on many agents assumes them: a circle, a cone.

They are the floor of every table of methods: whoever does not beat them has learned nothing from the sweep.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators import EstimatorFactory
from viewshed.estimators.classical import ClassicalEstimator
from viewshed.fov.visibility import CAR, Target
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep


@dataclass(frozen=True, slots=True)
class FixedView(ClassicalEstimator):
    """Everything within a range and an opening about forward is visible, whatever hides it.

    Attributes:
        grid: of the estimate.
        target: that would have to be seen; it changes nothing.
        range_m: how far is seen, horizontally.
        opening_deg: whole opening, 360 for a circle.
        name: of the estimator.

    Raises:
        ValueError: a number is out of range.
    """

    grid: BevGrid
    target: Target = CAR
    range_m: float = 70.0
    opening_deg: float = 360.0
    name: str = "circle"

    def __post_init__(self) -> None:
        if not (self.range_m > 0.0 and 0.0 < self.opening_deg <= 360.0):
            raise ValueError(
                f"range_m must be positive and opening_deg lie in (0, 360], got {self.range_m:g} and"
                f" {self.opening_deg:g}"
            )

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return 1 for the cells (cells, cells) inside, 0 for the others."""
        range_m, azimuth = polar_of_cells(self.grid)
        inside = (range_m <= self.range_m) & (np.abs(azimuth) <= np.deg2rad(self.opening_deg / 2))
        prob: NDArray[np.float32] = inside.astype(np.float32)
        return prob


FIXED_VIEWS: dict[str, EstimatorFactory] = {
    "circle": FixedView,
    "cone": partial(FixedView, opening_deg=120.0, name="cone"),
}
"""By name: 70 m about the sensor, the range of the published ray trace; and a third of it, about forward."""
