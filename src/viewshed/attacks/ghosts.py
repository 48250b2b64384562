"""Ghosts: surfaces that are not there, one return for each beam that would meet them (families 5 and 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viewshed.attacks.checks import require, require_azimuth, require_budget
from viewshed.attacks.rays import rays_in
from viewshed.attacks.scatter import wedge_around
from viewshed.attacks.scene import Box, ahead, chord_m, ground_at, level_rays, open_azimuth
from viewshed.attacks.spoofer import AS_MEASURED, LEAVE, Spoofer, nearest_first
from viewshed.attacks.tampering import Tampered, Wedge
from viewshed.sweep import Sweep

CAR_M = (4.2, 1.8, 1.5)
"""Length, width and height of a ghost car."""
_WALL_M = (0.3, 3.0)
_ROOM = 1.05
_BEYOND = 1.2
"""Ghosts stand where some beam goes farther than this multiple of their range."""


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
    spoofer: Spoofer = AS_MEASURED

    def __post_init__(self) -> None:
        require_budget(self.budget)
        require_azimuth(self.azimuth)
        require_azimuth(self.heading)
        require("range_m", self.range_m, 0.1, 1000.0)
        for size_m in self.size_m:
            require("size_m", size_m, 0.05, 100.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        azimuth = open_azimuth(sweep, _BEYOND * self.range_m, rng) if self.azimuth is None else self.azimuth
        x, y, level_azimuth = ahead(sweep, azimuth, self.range_m)
        box = Box((x, y), level_azimuth + self.heading, self.size_m, ground_at(sweep, x, y))
        radius_m = _ROOM * float(np.hypot(*self.size_m[:2])) / 2
        return haunt(sweep, box, wedge_around(azimuth, self.range_m, radius_m), self, rng)


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
    spoofer: Spoofer = AS_MEASURED

    def __post_init__(self) -> None:
        require_budget(self.budget)
        require_azimuth(self.azimuth)
        require("sector_deg", self.sector_deg, 0.01, 150.0)
        require("range_m", self.range_m, 0.2, 1000.0)
        require("height_m", self.height_m, 0.05, 100.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        azimuth = open_azimuth(sweep, _BEYOND * self.range_m, rng) if self.azimuth is None else self.azimuth
        wedge = Wedge(azimuth, float(np.deg2rad(self.sector_deg)))
        x, y, level_azimuth = ahead(sweep, wedge.azimuth, self.range_m + _WALL_M[0] / 2)
        wide = 2 * self.range_m * np.tan(wedge.width / 2) * _ROOM + 1.0
        box = Box((x, y), level_azimuth, (_WALL_M[0], wide, self.height_m), ground_at(sweep, x, y))
        return haunt(sweep, box, wedge, self, rng)


def haunt(sweep: Sweep, box: Box, wedge: Wedge, ghost: GhostCar | GhostWall, rng: np.random.Generator) -> Tampered:
    """Return ``sweep`` with a box in it, on the beams of the wedge that meet it before anything else."""
    rays = rays_in(sweep, wedge, empty=True)
    enter, _ = chord_m(*level_rays(sweep, rays), box)
    hit = np.isfinite(enter) & (enter < rays.depth_m)
    chosen = nearest_first(rays, hit, wedge, ghost.budget)
    return ghost.spoofer.spoof(sweep, rays, np.where(chosen, enter, LEAVE), wedge, rng)
