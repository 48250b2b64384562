"""What an attacker who adapts wants, as a number for each sweep that the victim might read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.attacks.checks import require
from viewshed.attacks.scene import scene_of
from viewshed.attacks.tampering import Wedge
from viewshed.bev import BevGrid
from viewshed.estimate import THRESHOLD, FovEstimator
from viewshed.sweep import Sweep

Value = Callable[[Sweep], float]
"""From an attacked sweep to what it is worth to the attacker."""


class Objective(Protocol):
    """Anything that an attacker wants more of."""

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return what sweeps made from ``clean`` are worth, where the attacker reaches ``wedge``."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class OverClaim:
    """Area in the wedge, in m², that the victim claims under attack and did not claim before.

    The attacker has no truth: the victim's own clean estimate stands for it.

    Attributes:
        estimator: what the victim runs.
        threshold: probability from which a cell is claimed.
    """

    estimator: FovEstimator
    threshold: float = THRESHOLD

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the objective; the victim is asked once."""
        hidden = ~self.estimator.estimate(clean).visible(self.threshold) & cells_in(self.estimator.grid, clean, wedge)
        return _Area(self.estimator, hidden, True, self.threshold)


@dataclass(frozen=True, slots=True, eq=False)
class UnderClaim:
    """Area in the wedge, in m², that the victim claimed before and no longer claims under attack.

    Attributes:
        estimator: what the victim runs.
        threshold: probability from which a cell is claimed.
    """

    estimator: FovEstimator
    threshold: float = THRESHOLD

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the objective; the victim is asked once."""
        seen = self.estimator.estimate(clean).visible(self.threshold) & cells_in(self.estimator.grid, clean, wedge)
        return _Area(self.estimator, seen, False, self.threshold)


@dataclass(frozen=True, slots=True, eq=False)
class Trip:
    """A monitor's or a defense's score: the attacker wants a false alarm.

    Attributes:
        score: from a sweep to the doubt of a monitor, or 1 for an alarm and 0 for none.
    """

    score: Value

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the score itself."""
        return self.score


@dataclass(frozen=True, slots=True, eq=False)
class Evade:
    """Another objective, worth nothing like as much where a monitor's score is above a limit.

    Attributes:
        aim: what the attacker wants.
        score: from a sweep to the doubt of a monitor, or 1 for an alarm and 0 for none.
        limit: the highest score that goes unnoticed.
        penalty: what one unit of score above the limit costs, in units of the aim.
    """

    aim: Objective
    score: Value
    limit: float = 0.0
    penalty: float = 1e6

    def __post_init__(self) -> None:
        require("penalty", self.penalty, 0.0, 1e12)

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the aim less the penalty."""
        aim = self.aim.on(clean, wedge)
        return lambda sweep: aim(sweep) - self.penalty * max(0.0, float(self.score(sweep)) - self.limit)


@dataclass(frozen=True, slots=True, eq=False)
class _Area:
    """Area of some cells, in m², that the victim claims (or does not)."""

    estimator: FovEstimator
    cells: NDArray[np.bool_]
    claimed: bool
    threshold: float

    def __call__(self, sweep: Sweep) -> float:
        claimed = self.estimator.estimate(sweep).visible(self.threshold)
        return float((self.cells & (claimed == self.claimed)).sum()) * self.estimator.grid.cell_area_m2


def cells_in(grid: BevGrid, sweep: Sweep, wedge: Wedge) -> NDArray[np.bool_]:
    """Return which cells (cells, cells) have their center in the wedge, seen from the sensor of ``sweep``."""
    rotation = scene_of(sweep).level_from_sensor.rotation
    x, y = np.moveaxis(grid.centers @ rotation[:2, :2], -1, 0)
    return wedge.holds(np.arctan2(y, x))
