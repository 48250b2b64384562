"""The attack of arXiv 2503.07375 as its code draws it, for its own profile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.attacks.assembly import added, untouched
from viewshed.attacks.checks import require
from viewshed.attacks.scene import scene_of
from viewshed.attacks.tampering import Tampered
from viewshed.geometry import rotation_from_quaternion
from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True)
class PaperAttack:
    """For each sweep one of: points over the extent (p .6), one cluster (p .2), nothing (p .2).

    The paper adds its points to the projection; here they are returns at the sensor's own height in the level frame,
    which its profile projects to the same place.

    Attributes:
        uniform_share: probability of points over the extent.
        cluster_share: probability of a cluster.
        half_extent_m: half the side of the extent.
        uniform_points: fewest and most points over the extent.
        cluster_points: fewest and most points of a cluster.
        cluster_m: nearest and farthest middle of a cluster, along each axis.
        spread_m: points lie within this of the middle, along each axis.
    """

    uniform_share: float = 0.6
    cluster_share: float = 0.2
    half_extent_m: float = 80.0
    uniform_points: tuple[int, int] = (80, 119)
    cluster_points: tuple[int, int] = (10, 159)
    cluster_m: tuple[float, float] = (40.0, 70.0)
    spread_m: float = 3.0

    def __post_init__(self) -> None:
        require("uniform_share", self.uniform_share, 0.0, 1.0)
        require("cluster_share", self.cluster_share, 0.0, 1.0 - self.uniform_share + 1e-9)
        require("half_extent_m", self.half_extent_m, 1.0, 1000.0)
        require("uniform_points[0]", self.uniform_points[0], 0, self.uniform_points[1])
        require("cluster_points[0]", self.cluster_points[0], 0, self.cluster_points[1])
        require("cluster_m[0]", self.cluster_m[0], 0.0, self.cluster_m[1])
        require("spread_m", self.spread_m, 0.0, 100.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        which = rng.random()
        if which < self.uniform_share:
            count = int(rng.integers(*self.uniform_points, endpoint=True))
            xy = rng.uniform(-self.half_extent_m, self.half_extent_m, (count, 2))
        elif which < self.uniform_share + self.cluster_share:
            count = int(rng.integers(*self.cluster_points, endpoint=True))
            middle = rng.uniform(*self.cluster_m, 2) * rng.choice([-1.0, 1.0], 2)
            xy = middle + rng.uniform(-self.spread_m, self.spread_m, (count, 2))
        else:
            return untouched(sweep)
        return added(sweep, _level_with_sensor(sweep, xy), rng)


def _level_with_sensor(sweep: Sweep, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (A, 3) of the sensor's frame at its own height, over places (A, 2) of the level frame."""
    attitude = sweep.known_attitude
    rotation = scene_of(sweep).level_from_sensor.rotation if attitude is None else rotation_from_quaternion(attitude)
    return np.column_stack([xy, np.zeros(len(xy))]) @ rotation


PAPER_ATTACK = PaperAttack()
"""The paper's, for cars on roads."""
PAPER_INDOOR_ATTACK = PaperAttack(half_extent_m=18.0, cluster_m=(9.0, 15.75), spread_m=0.675)
"""The same in proportion to its indoor extent of 18 m."""
