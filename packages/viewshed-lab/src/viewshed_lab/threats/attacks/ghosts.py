"""Ghosts: surfaces that do not exist, one return for each beam that would hit them (families 5 and 6).

Far walls: obstacles become free road with a wall at its end, the dangerous error (families 7 and 14).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from viewshed.sweep import Sweep
from viewshed_lab._config import Angle, Azimuth, Between, Budget, Checked, Range
from viewshed_lab.threats.attacks.base import Tampered, Wedge
from viewshed_lab.threats.attacks.beam_lattice import Rays, rays_in
from viewshed_lab.threats.attacks.points import wedge_around
from viewshed_lab.threats.attacks.spoofer import (
    LEAVE,
    MEASURED_SPOOFER,
    NO_RETURN,
    GroundBox,
    Spoofer,
    choose_nearest,
    chord_m,
    ground_at,
    is_obstacle,
    level_rays,
    limits_m,
    position_at,
    random_open_azimuth,
    street_depth_m,
)
from viewshed_lab.threats.attacks.wedge_attack import WedgeAttack

_MARGIN_M = 2.0
"""Minimum distance of a far wall from the sensor's maximum range."""

CAR_M = (4.2, 1.8, 1.5)
"""Length, width and height of a ghost car."""

_WALL_M = (0.3, 3.0)
"""Thickness and height of a ghost wall."""

_WIDER = 1.05
"""Ratio of the width of a ghost and of the wedge around it, for some margin."""

_BEYOND = 1.2
"""Ghosts are placed where some beam returns from beyond this multiple of their range."""


@dataclass(frozen=True, slots=True)
class FarWall(WedgeAttack):
    """Beams that hit a near obstacle report what an empty street would: the ground behind it, or a far wall.

    This opens a false corridor.
    """

    near_m: Range = 25.0  # obstacles nearer than this are aimed at and disappear
    far_m: Range = 50.0  # range of the wall; at most 2 m less than the sensor's maximum

    @property
    def aim_m(self) -> float:
        """Obstacles nearer than this are aimed at."""
        return self.near_m

    @property
    def reach_m(self) -> float:
        """Ground up to the wall can be opened."""
        return self.far_m

    def plan(self, sweep: Sweep, rays: Rays, rng: np.random.Generator) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Return the beams that hit near obstacles, and their depths on an empty street where these are farther."""
        near = is_obstacle(sweep, rays) & (rays.depth_m < self.near_m)
        depth_m = street_depth_m(sweep, rays, _wall_m(sweep, self.far_m))
        return near, np.where(depth_m > rays.depth_m, depth_m, LEAVE)


@dataclass(frozen=True, slots=True)
class RemovalAndFarWall(WedgeAttack):
    """Every obstacle in the wedge is removed, then its beams and the empty ones report an empty street to a far wall.

    The strongest over-claim. A beam must be won twice: one that is removed but not injected does not return.
    """

    # range of the wall; at most 2 m less than the sensor's maximum. Obstacles nearer than this are aimed at.
    far_m: Range = 50.0

    @property
    def aim_m(self) -> float:
        """Obstacles nearer than this are aimed at."""
        return self.far_m

    reach_m = aim_m

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        wedge = self.aim(sweep, rng)
        rays = rays_in(sweep, wedge, empty=True)
        wall_m = _wall_m(sweep, self.far_m)
        low = (rays.row < 0) & (rays.start_m[:, 2] + wall_m * rays.direction[:, 2] < _MARGIN_M)
        rays = rays.select(choose_nearest(rays, is_obstacle(sweep, rays) | low, wedge, self.budget))
        depth_m = street_depth_m(sweep, rays, wall_m)
        depth_m = np.where((depth_m > rays.depth_m) | (rays.row < 0), depth_m, LEAVE)
        lost = ~self.spoofer.wins(sweep, len(rays), rng)
        return self.spoofer.spoof(sweep, rays, np.where(lost, NO_RETURN, depth_m), wedge, rng)


def _wall_m(sweep: Sweep, far_m: float) -> float:
    """Return the range of a far wall in meters, limited to what the sensor can report."""
    return min(far_m, limits_m(sweep)[1] - _MARGIN_M)


@dataclass(frozen=True, slots=True)
class GhostCar(Checked):
    """A car that does not exist: one return for each beam that would hit it, and so a shadow behind it.

    Nearer objects hide the ghost as they would hide a car.
    """

    budget: Budget = None  # maximum number of beams, nearest to its center first; None for all that would hit it
    range_m: Annotated[float, Between(0.1, 1000.0)] = 10.0  # horizontal range of its center
    azimuth: Azimuth = None  # of its center in the sensor's frame; None draws one where the view is open
    heading: Angle = 0.0  # yaw relative to the line of sight; 0 shows its rear
    size_m: Annotated[tuple[float, float, float], Between(0.05, 100.0)] = CAR_M  # length, width, height
    spoofer: Spoofer = MEASURED_SPOOFER  # success rate and range noise

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        azimuth = random_open_azimuth(sweep, _BEYOND * self.range_m, rng) if self.azimuth is None else self.azimuth
        x, y, level_azimuth = position_at(sweep, azimuth, self.range_m)
        box = GroundBox((x, y), level_azimuth + self.heading, self.size_m, ground_at(sweep, x, y))
        radius_m = _WIDER * float(np.hypot(*self.size_m[:2])) / 2
        return spoof_box(sweep, box, wedge_around(azimuth, self.range_m, radius_m), self, rng)


@dataclass(frozen=True, slots=True)
class GhostWall(Checked):
    """A wall that does not exist, across a sector: hides everything behind it."""

    budget: Budget = None  # maximum number of beams, nearest to its center first; None for all that would hit it
    sector_deg: Annotated[float, Between(0.01, 150.0)] = 30.0  # width of the sector
    range_m: Annotated[float, Between(0.2, 1000.0)] = 15.0  # horizontal range of the wall at the center of the sector
    azimuth: Azimuth = None  # of its center in the sensor's frame; None draws one where the view is open
    height_m: Annotated[float, Between(0.05, 100.0)] = _WALL_M[1]  # of the wall
    spoofer: Spoofer = MEASURED_SPOOFER  # success rate and range noise

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        azimuth = random_open_azimuth(sweep, _BEYOND * self.range_m, rng) if self.azimuth is None else self.azimuth
        wedge = Wedge.of_sector(azimuth, self.sector_deg)
        x, y, level_azimuth = position_at(sweep, wedge.azimuth, self.range_m + _WALL_M[0] / 2)
        wide = 2 * self.range_m * np.tan(wedge.width / 2) * _WIDER + 1.0
        box = GroundBox((x, y), level_azimuth, (_WALL_M[0], wide, self.height_m), ground_at(sweep, x, y))
        return spoof_box(sweep, box, wedge, self, rng)


def spoof_box(
    sweep: Sweep, box: GroundBox, wedge: Wedge, ghost: GhostCar | GhostWall, rng: np.random.Generator
) -> Tampered:
    """Return ``sweep`` with a ghost box, on the beams of the wedge that hit it before anything else."""
    rays = rays_in(sweep, wedge, empty=True)
    enter, _ = chord_m(*level_rays(sweep, rays), box)
    hit = np.isfinite(enter) & (enter < rays.depth_m)
    return ghost.spoofer.spoof_nearest(sweep, rays, hit, enter, wedge, ghost.budget, rng)
