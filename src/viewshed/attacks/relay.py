"""Relay: the sensor's own pulses, sent back later (family 12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viewshed.attacks.checks import require, require_azimuth, require_budget
from viewshed.attacks.far_wall import aimed
from viewshed.attacks.rays import rays_in
from viewshed.attacks.spoofer import AS_MEASURED, LEAVE, Spoofer, nearest_first
from viewshed.attacks.tampering import Tampered
from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True)
class Relay:
    """A sector of the scan with a constant offset in range: its objects stand elsewhere.

    Attributes:
        budget: most returns, those nearest to the middle of the sector; None for all.
        offset_m: added to each range; returns that would be nearer than the minimum range are dropped.
        sector_deg: width of the sector.
        azimuth: middle of the sector in the sensor's frame; None aims at an obstacle.
        aim_m: obstacles nearer than this are aimed at.
        spoofer: how well the beams are won.
    """

    budget: int | None = None
    offset_m: float = 5.0
    sector_deg: float = 30.0
    azimuth: float | None = None
    aim_m: float = 30.0
    spoofer: Spoofer = AS_MEASURED

    def __post_init__(self) -> None:
        require_budget(self.budget)
        require_azimuth(self.azimuth)
        require("offset_m", self.offset_m, -1000.0, 1000.0)
        require("sector_deg", self.sector_deg, 0.01, 360.0)
        require("aim_m", self.aim_m, 0.5, 1000.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        wedge = aimed(sweep, self.azimuth, self.sector_deg, self.aim_m, rng)
        rays = rays_in(sweep, wedge)
        chosen = nearest_first(rays, np.ones(len(rays), np.bool_), wedge, self.budget)
        return self.spoofer.spoof(sweep, rays, np.where(chosen, rays.depth_m + self.offset_m, LEAVE), wedge, rng)
