"""Returns where earlier sweeps saw through."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.geometry import Rigid, polar
from viewshed.preprocess.ring_recovery import RingAssignment, rings_of_sweep
from viewshed.sweep import Sweep
from viewshed_lab.threats.defenses.base import Defended, without

_NEAREST_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class TemporalConsistency:
    """Drops returns where at least one earlier sweep saw through, and none saw a surface.

    A return is seen through where both rings next to its direction, in the three columns about it, returned from more
    than ``margin_m`` behind it; a surface was seen where one of them returned from within that of it. Where the two
    rings are more than ``gap_m`` apart something may stand between them, and nothing is concluded. What has moved there
    since is dropped, too: that is the cost.

    Raises:
        ValueError: an earlier sweep has no pose or no rings, or a distance is not positive.
    """

    # sweeps with poses and rings in the same map; none make a defense that drops nothing
    earlier: tuple[Sweep, ...] = ()
    margin_m: float = 1.0  # how much farther than the return an earlier one must lie
    gap_m: float = 1.0  # greatest distance of two rings at the return
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
    """What one earlier sweep saw: its nearest return a pixel (rings, columns), +inf where there is none."""

    sensor_from_world: Rigid
    elevation: F64
    order: NDArray[np.intp]
    depth_m: F64

    @classmethod
    def of(cls, sweep: Sweep) -> _View:
        """Return the view of a sweep with a pose and rings."""
        pose, beams = _pose(sweep), rings_of_sweep(sweep)
        range_m = np.linalg.norm(sweep.points.astype(np.float64), axis=1)
        depth_m = np.full((beams.rings, beams.columns), np.inf)
        used = (beams.ring >= 0) & (range_m > _NEAREST_M)
        np.minimum.at(depth_m, (beams.ring[used], beams.column[used]), range_m[used])
        order = _rings_with_returns(beams, used)
        return cls(pose.inverse(), beams.elevation[order], order, depth_m)

    def judge(self, in_world: F64, margin_m: float, gap_m: float) -> tuple[Mask, Mask]:
        """Return which points (N, 3) it saw through (N,), and at which it saw a surface (N,)."""
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


def _rings_with_returns(beams: RingAssignment, used: Mask) -> NDArray[np.intp]:
    """Return the rings that have returns, from the lowest elevation up."""
    rings = np.unique(beams.ring[used]).astype(np.intp)
    return rings[np.argsort(beams.elevation[rings], kind="stable")]
