"""Far walls: obstacles become free road with a wall at its end, the dangerous direction (families 7 and 14)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viewshed.attacks.checks import require, require_azimuth, require_budget
from viewshed.attacks.rays import rays_in
from viewshed.attacks.scene import azimuth_of_obstacle, drawn_azimuth, is_obstacle, street_depth_m
from viewshed.attacks.spoofer import AS_MEASURED, LEAVE, NO_RETURN, Spoofer, limits_m, nearest_first
from viewshed.attacks.tampering import Tampered, Wedge
from viewshed.sweep import Sweep

_MARGIN_M = 2.0


@dataclass(frozen=True, slots=True)
class FarWall:
    """Beams that hit a near obstacle report what an empty street would: the ground behind it, or a far wall.

    Opens a false corridor. The wedge is aimed at a near obstacle drawn at random.

    Attributes:
        budget: most beams, those nearest to the middle of the wedge; None for all.
        sector_deg: width of the wedge.
        near_m: obstacles nearer than this disappear.
        far_m: range of the wall; at most 2 m less than the sensor's maximum.
        azimuth: middle of the wedge in the sensor's frame; None aims.
        spoofer: how well the beams are won.
    """

    budget: int | None = None
    sector_deg: float = 30.0
    near_m: float = 25.0
    far_m: float = 50.0
    azimuth: float | None = None
    spoofer: Spoofer = AS_MEASURED

    def __post_init__(self) -> None:
        require_budget(self.budget)
        require_azimuth(self.azimuth)
        require("sector_deg", self.sector_deg, 0.01, 360.0)
        require("near_m", self.near_m, 0.5, 1000.0)
        require("far_m", self.far_m, 0.5, 1000.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        wedge = aimed(sweep, self.azimuth, self.sector_deg, self.near_m, rng)
        rays = rays_in(sweep, wedge)
        near = is_obstacle(sweep, rays) & (rays.depth_m < self.near_m)
        chosen = np.flatnonzero(nearest_first(rays, near, wedge, self.budget))
        rays = rays.select(chosen)
        depth_m = street_depth_m(sweep, rays, min(self.far_m, limits_m(sweep)[1] - _MARGIN_M))
        return self.spoofer.spoof(sweep, rays, np.where(depth_m > rays.depth_m, depth_m, LEAVE), wedge, rng)


@dataclass(frozen=True, slots=True)
class RemovalAndFarWall:
    """Every obstacle in the wedge is removed, then its beams and the empty ones report an empty street to a far wall.

    The strongest over-claim. A beam won by the removal and lost by the injection does not return.

    Attributes:
        budget: most beams, those nearest to the middle of the wedge; None for all.
        sector_deg: width of the wedge.
        far_m: range of the wall; at most 2 m less than the sensor's maximum.
        azimuth: middle of the wedge in the sensor's frame; None aims at an obstacle.
        spoofer: how well the beams are won, at each of the two steps.
    """

    budget: int | None = None
    sector_deg: float = 30.0
    far_m: float = 50.0
    azimuth: float | None = None
    spoofer: Spoofer = AS_MEASURED

    def __post_init__(self) -> None:
        require_budget(self.budget)
        require_azimuth(self.azimuth)
        require("sector_deg", self.sector_deg, 0.01, 360.0)
        require("far_m", self.far_m, 0.5, 1000.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        wedge = aimed(sweep, self.azimuth, self.sector_deg, self.far_m, rng)
        rays = rays_in(sweep, wedge, empty=True)
        wall_m = min(self.far_m, limits_m(sweep)[1] - _MARGIN_M)
        low = (rays.row < 0) & (rays.start_m[:, 2] + wall_m * rays.direction[:, 2] < _MARGIN_M)
        chosen = nearest_first(rays, is_obstacle(sweep, rays) | low, wedge, self.budget)
        rays = rays.select(chosen)
        depth_m = street_depth_m(sweep, rays, wall_m)
        depth_m = np.where((depth_m > rays.depth_m) | (rays.row < 0), depth_m, LEAVE)
        lost = ~self.spoofer.wins(sweep, len(rays), rng)
        return self.spoofer.spoof(sweep, rays, np.where(lost, NO_RETURN, depth_m), wedge, rng)


def aimed(sweep: Sweep, azimuth: float | None, sector_deg: float, near_m: float, rng: np.random.Generator) -> Wedge:
    """Return the wedge at ``azimuth``; where that is None, at an obstacle nearer than ``near_m``, else anywhere."""
    if azimuth is None:
        azimuth = azimuth_of_obstacle(sweep, 0.0, near_m, rng)
    return Wedge(drawn_azimuth(azimuth, rng), float(np.deg2rad(sector_deg)))
