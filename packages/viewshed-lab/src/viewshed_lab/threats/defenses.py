"""Defenses: filters that drop implausible returns, or raise an alarm, without knowing the attack."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import KDTree

from viewshed.arrays import F64, Mask
from viewshed.geometry import Rigid, polar
from viewshed.preprocess.leveling import MAX_RANGE_M, NULL_RANGE_M
from viewshed.preprocess.ring_recovery import rings_of_sweep
from viewshed.sweep import Sweep
from viewshed_lab._config import Between, Checked


@dataclass(frozen=True, slots=True, eq=False)
class Defended:
    """A sweep after a defense.

    Raises:
        ValueError: the mask does not match the sweep.
    """

    sweep: Sweep  # the kept returns, in their order, with all columns
    dropped: NDArray[np.bool_]  # (N,) bool, dropped rows of the input sweep
    alarm: bool | None  # whether an alarm is raised; None if the defense only drops returns
    # anomaly score in [0, 1]: the share of dropped returns, or the quantity that the alarm tests
    score: float

    def __post_init__(self) -> None:
        dropped = np.array(self.dropped, np.bool_)
        dropped.setflags(write=False)
        object.__setattr__(self, "dropped", dropped)
        if dropped.ndim != 1 or (~dropped).sum() != len(self.sweep):
            raise ValueError(f"dropped must keep {len(self.sweep)} rows, got {dropped.shape} with {(~dropped).sum()}")


class Defense(Protocol):
    """A filter or check of a sweep that does not know the attack. The sweep is never modified."""

    def apply(self, sweep: Sweep) -> Defended:
        """Return the kept returns, the dropped rows and the alarm. The order of the points does not matter."""
        ...


def without(sweep: Sweep, dropped: NDArray[np.bool_]) -> Defended:
    """Return ``sweep`` without the rows ``dropped`` (N,), scored by their share, with no alarm.

    >>> without(Sweep(np.eye(3)), np.array([True, False, False])).score
    0.3333333333333333
    """
    return Defended(sweep.select(~dropped), dropped, None, float(dropped.mean()) if len(dropped) else 0.0)


HOUSING_M = 1.0
"""Returns nearer than this are null returns or the sensor's own housing: there may be several per beam."""

BINS = 360
"""Number of azimuth bins of the search for empty sectors."""


@dataclass(frozen=True, slots=True)
class RangeValidation:
    """Drops returns nearer or farther than the sensor can measure.

    The limits are those of the sweep's sensor; 0.5 and 250 m if the sensor is unknown.
    """

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without impossible ranges."""
        model = sweep.model
        near_m, far_m = (NULL_RANGE_M, MAX_RANGE_M) if model is None else (model.min_range_m, model.max_range_m)
        range_m = np.linalg.norm(sweep.points, axis=1)
        return without(sweep, (range_m < near_m) | (range_m > far_m))


@dataclass(frozen=True, slots=True)
class OneReturnPerBeam(Checked):
    """Drops all returns of a beam except the nearest. Needs rings.

    Two returns share a beam if they share a ring and their firing azimuths (without these, azimuths of the points)
    differ by at most ``tolerance`` firing steps. Which one is real is unknown; the nearest is kept because seeing
    through a surface is the dangerous error. Returns nearer than 1 m, and those without a ring, are kept.
    """

    tolerance: Annotated[float, Between(0, 0.999)] = 0.25  # share of the azimuth step between two firings

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` with one return per beam.

        Raises:
            ValueError: the sweep's rings are not known.
        """
        dropped = np.zeros(len(sweep), np.bool_)
        if len(sweep) == 0:
            return without(sweep, dropped)
        beams = rings_of_sweep(sweep)
        range_m = np.linalg.norm(sweep.points, axis=1)
        azimuth = polar(sweep.points)[1] if sweep.azimuth is None else sweep.azimuth
        rows = np.flatnonzero((beams.ring >= 0) & (range_m >= HOUSING_M))
        rows = rows[np.lexsort((range_m[rows], azimuth[rows], beams.ring[rows]))]
        nearest_first = np.argsort(range_m[rows], kind="stable")
        reach = self.tolerance * beams.azimuth_step
        dropped[rows] = _farther_on_beam(beams.ring[rows], azimuth[rows].astype(np.float64), nearest_first, reach)
        return without(sweep, dropped)


@njit(cache=True, nogil=True, error_model="numpy")
def _farther_on_beam(ring: Any, azimuth: Any, nearest_first: Any, reach: float) -> Any:
    """Return the returns (N,) bool within ``reach`` radians of a kept nearer one; input sorted by ring and azimuth."""
    count = len(ring)
    starts = np.searchsorted(ring, ring, side="left")
    ends = np.searchsorted(ring, ring, side="right")
    gone = np.zeros(count, np.bool_)
    for n in nearest_first:
        if gone[n]:
            continue
        start, size = starts[n], ends[n] - starts[n]
        for way in (1, -1):
            for step in range(1, size):
                m = start + (n - start + way * step) % size
                apart = abs((azimuth[m] - azimuth[n] + np.pi) % (2 * np.pi) - np.pi)
                if apart > reach:
                    break
                gone[m] = True
    return gone


@dataclass(frozen=True, slots=True)
class EmptySectorCheck(Checked):
    """Raises an alarm if a sector of the revolution has hardly any returns; drops nothing.

    A bin of one degree is empty if it has fewer returns than ``share`` of the median of the bins with any. The score
    is the widest run of empty bins as a share of the revolution.
    """

    width_deg: Annotated[float, Between(0, 360, open=True)] = 5.0  # minimum width of a run that raises the alarm
    share: Annotated[float, Between(0, 1, open=True)] = 0.1  # of the median bin

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` unchanged, with the alarm; an empty sweep raises it."""
        range_m = np.linalg.norm(sweep.points, axis=1)
        azimuth = polar(sweep.points[range_m >= HOUSING_M])[1].astype(np.float64)
        counts = np.bincount(((azimuth + np.pi) * (BINS / (2 * np.pi))).astype(np.intp) % BINS, minlength=BINS)
        positive = counts[counts > 0]
        empty = counts < max(self.share * np.median(positive), 1) if len(positive) else np.ones(BINS, np.bool_)
        score = _longest_run(empty) / BINS
        return Defended(sweep, np.zeros(len(sweep), np.bool_), score * 360 >= self.width_deg, score)


def _longest_run(empty: NDArray[np.bool_]) -> int:
    """Return the length of the longest run of True in a circular mask."""
    full = np.flatnonzero(~empty)
    if len(full) == 0:
        return len(empty)
    return int(np.diff(full, append=full[0] + len(empty)).max()) - 1


_ROUNDING = 1e-6
"""Relative tolerance of the limit, so that rounding does not make outliers in a regular lattice."""


@dataclass(frozen=True, slots=True)
class StatisticalOutlierRemoval(Checked):
    """Drops returns whose mean distance to their nearest neighbors exceeds mean + ``deviations`` σ over the sweep.

    Rusu et al. 2008 ("Towards 3D point cloud based object maps for household environments"), as PCL's
    ``StatisticalOutlierRemoval`` with the parameters of its tutorial.
    """

    # number of nearest other returns; all others if there are fewer
    neighbors: Annotated[int, Between(1, 1000)] = 50
    deviations: Annotated[float, Between(-1e6, 1e6)] = 1.0  # multiples of the standard deviation (of N - 1)

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without statistical outliers; a sweep of fewer than three returns is kept."""
        count = len(sweep)
        if count < 3:
            return without(sweep, np.zeros(count, np.bool_))
        points, k = sweep.points.astype(np.float64), min(self.neighbors, count - 1)
        distances_m, _ = KDTree(points).query(points, k=k + 1)  # a return is its own nearest, at 0
        means = distances_m.sum(axis=1) / k
        ordered = np.sort(means)  # makes the sums independent of the order of the points
        limit = ordered.mean() + self.deviations * ordered.std(ddof=1)
        return without(sweep, means > limit * (1 + _ROUNDING))


@dataclass(frozen=True, slots=True)
class RadiusOutlierRemoval(Checked):
    """Drops returns with fewer than ``neighbors`` others within ``radius_m``.

    As PCL's ``RadiusOutlierRemoval`` with the parameters of its tutorial.
    """

    radius_m: Annotated[float, Between(0, 1000, open=True)] = 0.8  # inclusive
    neighbors: Annotated[int, Between(1)] = 2  # minimum number of other returns

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without isolated returns."""
        points = sweep.points.astype(np.float64)
        return without(sweep, ~_has_neighbors(points, points, self.neighbors + 1, self.radius_m))


@dataclass(frozen=True, slots=True)
class ClusteringOutlierRemoval(Checked):
    """Drops returns that DBSCAN calls noise: no core point lies within ``radius_m``.

    Ester et al. 1996 with scikit-learn's parameters: a core point has ``fewest`` returns within the radius, itself
    included. Noise follows from the core points alone, so the clusters are not computed.
    """

    radius_m: Annotated[float, Between(0, 1000, open=True)] = 0.5  # ``eps``, inclusive
    fewest: Annotated[int, Between(2)] = 5  # minimum number of returns around a core point (``min_samples``)

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without noise."""
        points = sweep.points.astype(np.float64)
        in_cluster = _has_neighbors(points, points, self.fewest, self.radius_m)
        in_cluster[~in_cluster] = _has_neighbors(points[in_cluster], points[~in_cluster], 1, self.radius_m)
        return without(sweep, ~in_cluster)


def _has_neighbors(points: F64, queried: F64, count: int, radius_m: float) -> Mask:
    """Return which of ``queried`` (M, 3) have at least ``count`` of ``points`` (N, 3) within a radius, (M,) bool."""
    if not len(points) or not len(queried):
        return np.zeros(len(queried), np.bool_)
    beyond_m = np.nextafter(radius_m, np.inf)  # the bound of the query is exclusive
    farthest_m, _ = KDTree(points).query(queried, k=[count], distance_upper_bound=beyond_m)
    return np.asarray(farthest_m[:, 0] <= radius_m)


_NEAREST_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class TemporalConsistency:
    """Drops returns through which an earlier sweep saw, unless an earlier sweep saw a surface there.

    Compare a return with the earlier pixels around its direction: the two nearest rings, three columns each. It is
    seen through if both rings returned and all returns are more than ``margin_m`` behind it. A surface was seen if any
    of them is within ``margin_m`` of it. Nothing is concluded if the two rings are more than ``gap_m`` apart, as an
    object may stand between them. The cost: objects that moved there since are dropped, too.

    Raises:
        ValueError: an earlier sweep has no pose or no rings, or a distance is not positive.
    """

    # sweeps with rings and poses in the same map; without any, nothing is dropped
    earlier: tuple[Sweep, ...] = ()
    margin_m: float = 1.0  # minimum distance of an earlier return behind the return
    gap_m: float = 1.0  # maximum distance of the two rings at the return
    _views: tuple[_View, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not (self.margin_m > 0 and self.gap_m > 0):
            raise ValueError(f"margin_m and gap_m must be positive, got {self.margin_m} and {self.gap_m}")
        object.__setattr__(self, "_views", tuple(_View.of(sweep) for sweep in self.earlier if len(sweep)))

    def apply(self, sweep: Sweep) -> Defended:
        """Return ``sweep`` without returns that contradict the earlier sweeps.

        Raises:
            ValueError: there are earlier sweeps, but this one has no pose.
        """
        contradicted, confirmed = np.zeros((2, len(sweep)), np.bool_)
        if self._views:
            in_world = _pose(sweep) @ sweep.points
            for view in self._views:
                through, surface = view.judge(in_world, self.margin_m, self.gap_m)
                contradicted |= through
                confirmed |= surface
        return without(sweep, contradicted & ~confirmed)


def _pose(sweep: Sweep) -> Rigid:
    if sweep.world_from_sensor is None:
        raise ValueError("every sweep must have a pose to be compared with others, got none; give world_from_sensor")
    return sweep.world_from_sensor


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """Range image of one earlier sweep."""

    sensor_from_world: Rigid
    elevation: F64  # (R,) radians of the rings with returns, ascending
    order: NDArray[np.intp]  # (R,) numbers of these rings
    depth_m: F64  # (rings, columns) range of the nearest return of each pixel, +inf if there is none

    @classmethod
    def of(cls, sweep: Sweep) -> _View:
        """Return the view of a sweep with a pose and rings."""
        pose, beams = _pose(sweep), rings_of_sweep(sweep)
        range_m = np.linalg.norm(sweep.points.astype(np.float64), axis=1)
        depth_m = np.full((beams.rings, beams.columns), np.inf)
        used = (beams.ring >= 0) & (range_m > _NEAREST_M)
        np.minimum.at(depth_m, (beams.ring[used], beams.column[used]), range_m[used])
        rings = np.unique(beams.ring[used]).astype(np.intp)
        order = rings[np.argsort(beams.elevation[rings], kind="stable")]
        return cls(pose.inverse(), beams.elevation[order], order, depth_m)

    def judge(self, in_world: F64, margin_m: float, gap_m: float) -> tuple[Mask, Mask]:
        """Return the masks (N,) of points (N, 3) that it saw through, and of those where it saw a surface."""
        points = self.sensor_from_world @ in_world
        flat_m, azimuth = polar(points)
        range_m = np.hypot(flat_m, points[:, 2])
        above = np.searchsorted(self.elevation, np.arctan2(points[:, 2], flat_m))
        between = (above > 0) & (above < len(self.elevation))
        rings = np.clip(np.stack([above - 1, above]), 0, max(len(self.elevation) - 1, 0))
        if len(self.elevation) < 2:
            return between, between
        between &= (self.elevation[rings[1]] - self.elevation[rings[0]]) * range_m <= gap_m
        columns = self.depth_m.shape[1]
        column = ((azimuth + np.pi) * (columns / (2 * np.pi))).astype(np.intp) + np.arange(-1, 2)[:, None, None]
        seen_m = self.depth_m[self.order[rings], column % columns]  # (3, 2, N)
        returned = np.isfinite(seen_m).any(axis=0).all(axis=0)
        nearest_m = seen_m.min(axis=(0, 1))
        surface = between & (np.abs(seen_m - range_m) <= margin_m).any(axis=(0, 1))
        return between & returned & (nearest_m > range_m + margin_m), surface


__all__ = [
    "DEFENSES", "ClusteringOutlierRemoval", "Defended", "Defense", "EmptySectorCheck", "OneReturnPerBeam",
    "RadiusOutlierRemoval", "RangeValidation", "StatisticalOutlierRemoval", "TemporalConsistency",
]  # fmt: skip

DEFENSES: dict[str, Callable[[], Defense]] = {
    "statistical": StatisticalOutlierRemoval,
    "radius": RadiusOutlierRemoval,
    "clustering": ClusteringOutlierRemoval,
    "range": RangeValidation,
    "one_return": OneReturnPerBeam,
    "empty_sector": EmptySectorCheck,
    "temporal": TemporalConsistency,
}
"""By name, with the published parameters: ``DEFENSES[name]().apply(sweep)``. ``temporal`` drops nothing unless it is
given earlier sweeps: ``TemporalConsistency(earlier)``."""
