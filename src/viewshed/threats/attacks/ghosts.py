"""Ghosts: surfaces that are not there, one return for each beam that would meet them (families 5 and 6).

Far walls: obstacles become free road with a wall at its end, the dangerous direction (families 7 and 14).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viewshed.sweep import Sweep
from viewshed.threats.attacks.base import Tampered, Wedge
from viewshed.threats.attacks.beam_lattice import rays_in
from viewshed.threats.attacks.points import wedge_around
from viewshed.threats.attacks.spoofer import (
    LEAVE,
    MEASURED_SPOOFER,
    NO_RETURN,
    Box,
    Spoofer,
    azimuth_or_random,
    choose_nearest,
    chord_m,
    ground_at,
    is_obstacle,
    level_rays,
    limits_m,
    position_at,
    random_obstacle_azimuth,
    random_open_azimuth,
    street_depth_m,
)
from viewshed.threats.parameters import require, require_azimuth, require_budget, require_sector

_MARGIN_M = 2.0
"""A far wall stands so much nearer than the sensor's maximum range."""

CAR_M = (4.2, 1.8, 1.5)
"""Length, width and height of a ghost car."""

_WALL_M = (0.3, 3.0)
"""Thickness and height of a ghost wall."""

_ROOM = 1.05
"""Wedges of ghosts are so much wider than what they show."""

_BEYOND = 1.2
"""Ghosts stand where some beam goes farther than this multiple of their range."""


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
    spoofer: Spoofer = MEASURED_SPOOFER

    def __post_init__(self) -> None:
        require_sector(self.budget, self.azimuth, self.sector_deg)
        require("near_m", self.near_m, 0.5, 1000.0)
        require("far_m", self.far_m, 0.5, 1000.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        wedge = aim_wedge(sweep, self.azimuth, self.sector_deg, self.near_m, rng)
        rays = rays_in(sweep, wedge)
        near = is_obstacle(sweep, rays) & (rays.depth_m < self.near_m)
        depth_m = street_depth_m(sweep, rays, min(self.far_m, limits_m(sweep)[1] - _MARGIN_M))
        depth_m = np.where(depth_m > rays.depth_m, depth_m, LEAVE)
        return self.spoofer.spoof_nearest(sweep, rays, near, depth_m, wedge, self.budget, rng)


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
    spoofer: Spoofer = MEASURED_SPOOFER

    def __post_init__(self) -> None:
        require_sector(self.budget, self.azimuth, self.sector_deg)
        require("far_m", self.far_m, 0.5, 1000.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        wedge = aim_wedge(sweep, self.azimuth, self.sector_deg, self.far_m, rng)
        rays = rays_in(sweep, wedge, empty=True)
        wall_m = min(self.far_m, limits_m(sweep)[1] - _MARGIN_M)
        low = (rays.row < 0) & (rays.start_m[:, 2] + wall_m * rays.direction[:, 2] < _MARGIN_M)
        chosen = choose_nearest(rays, is_obstacle(sweep, rays) | low, wedge, self.budget)
        rays = rays.select(chosen)
        depth_m = street_depth_m(sweep, rays, wall_m)
        depth_m = np.where((depth_m > rays.depth_m) | (rays.row < 0), depth_m, LEAVE)
        lost = ~self.spoofer.wins(sweep, len(rays), rng)
        return self.spoofer.spoof(sweep, rays, np.where(lost, NO_RETURN, depth_m), wedge, rng)


def aim_wedge(sweep: Sweep, azimuth: float | None, sector_deg: float, near_m: float, rng: np.random.Generator) -> Wedge:
    """Return the wedge at ``azimuth``; where that is None, at an obstacle nearer than ``near_m``, else anywhere."""
    if azimuth is None:
        azimuth = random_obstacle_azimuth(sweep, 0.0, near_m, rng)
    return Wedge.of_sector(azimuth_or_random(azimuth, rng), sector_deg)


@dataclass(frozen=True, slots=True)
class GhostCar:
    """A car that is not there: one return for each beam that would meet it, and so a shadow behind it.

    What stands nearer than the ghost hides it as it would hide a car.

    Attributes:
        budget: most beams, those nearest to its middle; None for all that would meet it.
        range_m: horizontal range of its middle.
        azimuth: of its middle in the sensor's frame; None draws one where the view is open.
        heading: yaw against the line of sight; 0 shows its rear.
        size_m: length, width, height.
        spoofer: how well the beams are won.
    """

    budget: int | None = None
    range_m: float = 10.0
    azimuth: float | None = None
    heading: float = 0.0
    size_m: tuple[float, float, float] = CAR_M
    spoofer: Spoofer = MEASURED_SPOOFER

    def __post_init__(self) -> None:
        require_budget(self.budget)
        require_azimuth(self.azimuth)
        require_azimuth(self.heading)
        require("range_m", self.range_m, 0.1, 1000.0)
        for size_m in self.size_m:
            require("size_m", size_m, 0.05, 100.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        azimuth = random_open_azimuth(sweep, _BEYOND * self.range_m, rng) if self.azimuth is None else self.azimuth
        x, y, level_azimuth = position_at(sweep, azimuth, self.range_m)
        box = Box((x, y), level_azimuth + self.heading, self.size_m, ground_at(sweep, x, y))
        radius_m = _ROOM * float(np.hypot(*self.size_m[:2])) / 2
        return spoof_box(sweep, box, wedge_around(azimuth, self.range_m, radius_m), self, rng)


@dataclass(frozen=True, slots=True)
class GhostWall:
    """A wall that is not there, across a sector: blinds what lies behind it.

    Attributes:
        budget: most beams, those nearest to its middle; None for all that would meet it.
        sector_deg: width of the sector.
        range_m: horizontal range of the wall in the middle of the sector.
        azimuth: of its middle in the sensor's frame; None draws one where the view is open.
        height_m: of the wall.
        spoofer: how well the beams are won.
    """

    budget: int | None = None
    sector_deg: float = 30.0
    range_m: float = 15.0
    azimuth: float | None = None
    height_m: float = _WALL_M[1]
    spoofer: Spoofer = MEASURED_SPOOFER

    def __post_init__(self) -> None:
        require_sector(self.budget, self.azimuth, self.sector_deg, 150.0)
        require("range_m", self.range_m, 0.2, 1000.0)
        require("height_m", self.height_m, 0.05, 100.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        azimuth = random_open_azimuth(sweep, _BEYOND * self.range_m, rng) if self.azimuth is None else self.azimuth
        wedge = Wedge.of_sector(azimuth, self.sector_deg)
        x, y, level_azimuth = position_at(sweep, wedge.azimuth, self.range_m + _WALL_M[0] / 2)
        wide = 2 * self.range_m * np.tan(wedge.width / 2) * _ROOM + 1.0
        box = Box((x, y), level_azimuth, (_WALL_M[0], wide, self.height_m), ground_at(sweep, x, y))
        return spoof_box(sweep, box, wedge, self, rng)


def spoof_box(sweep: Sweep, box: Box, wedge: Wedge, ghost: GhostCar | GhostWall, rng: np.random.Generator) -> Tampered:
    """Return ``sweep`` with a box in it, on the beams of the wedge that meet it before anything else."""
    rays = rays_in(sweep, wedge, empty=True)
    enter, _ = chord_m(*level_rays(sweep, rays), box)
    hit = np.isfinite(enter) & (enter < rays.depth_m)
    return ghost.spoofer.spoof_nearest(sweep, rays, hit, enter, wedge, ghost.budget, rng)
