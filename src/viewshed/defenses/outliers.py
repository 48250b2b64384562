"""Returns far from all others: statistical, radius and clustering outlier removal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viewshed.defenses.grid_kernels import have_neighbors
from viewshed.defenses.role import Defended, without
from viewshed.defenses.tree_kernels import mean_distances
from viewshed.sweep import Sweep

_ROUNDING = 1e-6
_FARTHEST_M = 1e9


@dataclass(frozen=True, slots=True)
class StatisticalOutlierRemoval:
    """Drops returns whose mean distance to their nearest neighbors exceeds mean + ``deviations`` σ over the sweep.

    Rusu et al. 2008 ("Towards 3D point cloud based object maps for household environments"), as PCL's
    ``StatisticalOutlierRemoval`` with the parameters of its tutorial.

    Attributes:
        neighbors: nearest others of each return; all others where there are fewer.
        deviations: multiples of the standard deviation (of N - 1).
    """

    neighbors: int = 50
    deviations: float = 1.0

    def __post_init__(self) -> None:
        if not (1 <= self.neighbors <= 1000 and np.isfinite(self.deviations)):
            raise ValueError(f"neighbors must lie in [1, 1000] and deviations be finite, got {self}")

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without statistical outliers; one of fewer than three returns is kept."""
        count = len(sweep)
        if count < 3:
            return without(sweep, np.zeros(count, np.bool_))
        points = np.clip(sweep.points, -_FARTHEST_M, _FARTHEST_M)  # squares must stay finite
        means = mean_distances(points, min(self.neighbors, count - 1))
        ordered = np.sort(means)  # so that the order of the points has no say in the sums
        limit = ordered.mean() + self.deviations * ordered.std(ddof=1)
        return without(sweep, means > limit * (1 + _ROUNDING))


@dataclass(frozen=True, slots=True)
class RadiusOutlierRemoval:
    """Drops returns with fewer than ``neighbors`` others within ``radius_m``.

    As PCL's ``RadiusOutlierRemoval`` with the parameters of its tutorial.

    Attributes:
        radius_m: the distance itself counts as within.
        neighbors: others that a return needs.
    """

    radius_m: float = 0.8
    neighbors: int = 2

    def __post_init__(self) -> None:
        if not (0 < self.radius_m < 1e3 and self.neighbors >= 1):
            raise ValueError(f"radius_m must lie in (0, 1000) and neighbors be at least 1, got {self}")

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without lonely returns."""
        every = np.ones(len(sweep), np.bool_)
        return without(sweep, ~have_neighbors(sweep.points, every, every, self.radius_m, self.neighbors))


@dataclass(frozen=True, slots=True)
class ClusteringOutlierRemoval:
    """Drops returns that DBSCAN calls noise: no cluster's core lies within ``radius_m``.

    Ester et al. 1996 with scikit-learn's parameters: a core has ``fewest`` returns within the radius, itself included.
    The clusters themselves are not needed to know what belongs to none.

    Attributes:
        radius_m: the distance itself counts as within (``eps``).
        fewest: returns about a core (``min_samples``).
    """

    radius_m: float = 0.5
    fewest: int = 5

    def __post_init__(self) -> None:
        if not (0 < self.radius_m < 1e3 and self.fewest >= 2):
            raise ValueError(f"radius_m must lie in (0, 1000) and fewest be at least 2, got {self}")

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without noise."""
        every = np.ones(len(sweep), np.bool_)
        core = have_neighbors(sweep.points, every, every, self.radius_m, self.fewest - 1)
        border = have_neighbors(sweep.points, core, ~core, self.radius_m, 1)
        return without(sweep, ~(core | border))
