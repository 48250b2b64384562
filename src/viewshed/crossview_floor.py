"""The floor of cross-view truth: how wrong the metric calls a mask that is exact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from viewshed.bev import BevGrid
from viewshed.crossview import CrossViewRow, CrossViewRules, evaluate_crossview
from viewshed.estimate import FovEstimate, FovEstimator
from viewshed.ground import Ground
from viewshed.sensors import lidar_model
from viewshed.sim.scene import junction
from viewshed.sim.views import drive
from viewshed.sweep import Sweep
from viewshed.visible import CAR, Beams, expected_returns, probability_of_visible

POSES = (
    (-30.0, 3.4, 3.14), (-20.0, 3.4, 3.14), (-6.0, 0.3, 0.0), (2.0, 0.2, 0.0), (14.0, 0.3, 0.1),
    (24.0, -8.0, -1.5), (24.5, 6.0, 1.57), (30.0, 20.0, -1.57), (34.0, 0.2, 0.0), (50.0, 0.2, 0.0),
)  # fmt: skip
"""Where the sensor stands in the simulated junction: x, y in metres and yaw."""


@dataclass(frozen=True, slots=True, eq=False)
class ExactMask:
    """The definition of visible on each simulated sweep's noise-free beams and its level ground."""

    grid: BevGrid
    beams: Mapping[int, Beams]
    height_m: float = 1.8

    def estimate(self, sweep: Sweep) -> FovEstimate:
        """Return the exact mask; the sweep's time says which view it is."""
        beams = self.beams[sweep.t_ns or 0]
        returns, _ = expected_returns(beams, self.height_m, Ground.flat(64.0), self.grid, CAR)
        prob = probability_of_visible(returns, CAR.min_returns)
        return FovEstimate(self.grid, prob, (prob >= 0.5).astype(np.uint8), method="exact mask")


def evaluate_floor(
    estimators: Mapping[str, FovEstimator], *, rng: np.random.Generator, rules: CrossViewRules | None = None
) -> list[CrossViewRow]:
    """Return the rates of the exact mask, then of ``estimators``, in a simulated junction seen from ten places."""
    views = drive(junction(), lidar_model("hdl64e"), POSES, rng)
    exact = ExactMask(BevGrid(256, 64.0), {sweep.t_ns or 0: beams for sweep, beams in views})
    sweeps = [sweep for sweep, _ in views]
    return evaluate_crossview([sweeps], {"exact mask": exact, **estimators}, rng=rng, rules=rules)
