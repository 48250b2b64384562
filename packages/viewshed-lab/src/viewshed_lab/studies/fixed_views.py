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
    """Everything within a range and an opening about forward is visible, whatever hides it."""

    grid: BevGrid  # of the estimate
    target: Target = CAR  # that would have to be seen; it changes nothing
    range_m: float = 70.0  # how far is seen, horizontally
    opening_deg: float = 360.0  # whole opening, in (0, 360]
    name: str = "circle"  # of the estimator

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
