"""Fixed fields of view, a circle and a cone, as assumed in earlier work on many agents; they ignore the sweep.

They are the lower bound in every table of methods: a method that does not beat them learns nothing from the sweep.
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
    """Everything within a range and an opening around forward is visible, regardless of occlusion."""

    grid: BevGrid  # of the estimate
    target: Target = CAR  # not used
    range_m: float = 70.0  # horizontal
    opening_deg: float = 360.0  # full opening, in (0, 360]
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
"""By name: 70 m around the sensor, the range of the published ray trace; and a third of that circle, around forward."""
