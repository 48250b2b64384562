"""Returns far from all others: statistical, radius and clustering outlier removal, by scipy's k-d tree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from viewshed.sweep import Sweep
from viewshed_lab.threats.defenses.base import Defended, without

_ROUNDING = 1e-6
"""Share of the limit by which mean distances may exceed it: rounding makes no outlier of a lattice."""


@dataclass(frozen=True, slots=True)
class StatisticalOutlierRemoval:
    """Drops returns whose mean distance to their nearest neighbors exceeds mean + ``deviations`` σ over the sweep.

    Rusu et al. 2008 ("Towards 3D point cloud based object maps for household environments"), as PCL's
    ``StatisticalOutlierRemoval`` with the parameters of its tutorial.
    """

    neighbors: int = 50  # nearest others of each return; all others where there are fewer
    deviations: float = 1.0  # multiples of the standard deviation (of N - 1)

    def __post_init__(self) -> None:
        if not (1 <= self.neighbors <= 1000 and np.isfinite(self.deviations)):
            raise ValueError(f"neighbors must lie in [1, 1000] and deviations be finite, got {self}")

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without statistical outliers; one of fewer than three returns is kept."""
        count = len(sweep)
        if count < 3:
            return without(sweep, np.zeros(count, np.bool_))
        points, k = sweep.points.astype(np.float64), min(self.neighbors, count - 1)
        distances_m, _ = KDTree(points).query(points, k=k + 1)  # a return is its own nearest, at 0
        means = distances_m.sum(axis=1) / k
        ordered = np.sort(means)  # so that the order of the points has no say in the sums
        limit = ordered.mean() + self.deviations * ordered.std(ddof=1)
        return without(sweep, means > limit * (1 + _ROUNDING))


@dataclass(frozen=True, slots=True)
class RadiusOutlierRemoval:
    """Drops returns with fewer than ``neighbors`` others within ``radius_m``.

    As PCL's ``RadiusOutlierRemoval`` with the parameters of its tutorial.
    """

    radius_m: float = 0.8  # the distance itself counts as within
    neighbors: int = 2  # others that a return needs

    def __post_init__(self) -> None:
        if not (0 < self.radius_m < 1e3 and self.neighbors >= 1):
            raise ValueError(f"radius_m must lie in (0, 1000) and neighbors be at least 1, got {self}")

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without lonely returns."""
        points = sweep.points.astype(np.float64)
        return without(sweep, ~_have(points, points, self.neighbors + 1, self.radius_m))


@dataclass(frozen=True, slots=True)
class ClusteringOutlierRemoval:
    """Drops returns that DBSCAN calls noise: no cluster's core lies within ``radius_m``.

    Ester et al. 1996 with scikit-learn's parameters: a core has ``fewest`` returns within the radius, itself included.
    The clusters themselves are not needed to know what belongs to none.
    """

    radius_m: float = 0.5  # the distance itself counts as within (``eps``)
    fewest: int = 5  # returns about a core (``min_samples``)

    def __post_init__(self) -> None:
        if not (0 < self.radius_m < 1e3 and self.fewest >= 2):
            raise ValueError(f"radius_m must lie in (0, 1000) and fewest be at least 2, got {self}")

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without noise."""
        points = sweep.points.astype(np.float64)
        in_cluster = _have(points, points, self.fewest, self.radius_m)
        in_cluster[~in_cluster] = _have(points[in_cluster], points[~in_cluster], 1, self.radius_m)
        return without(sweep, ~in_cluster)


def _have(points: NDArray[np.float64], queried: NDArray[np.float64], count: int, radius_m: float) -> NDArray[np.bool_]:
    """Return (M,) which of ``queried`` (M, 3) have at least ``count`` of ``points`` (N, 3) within a radius."""
    if not len(points) or not len(queried):
        return np.zeros(len(queried), np.bool_)
    beyond_m = np.nextafter(radius_m, np.inf)  # the search leaves out its own bound
    farthest_m, _ = KDTree(points).query(queried, k=[count], distance_upper_bound=beyond_m)
    return np.asarray(farthest_m[:, 0] <= radius_m)
