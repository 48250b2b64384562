"""Removal: returns pushed inside the minimum range, or drowned in pulses (families 8, 9 and 10).

Relay: the sensor's own pulses, sent back later (family 12).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viewshed.sweep import Sweep
from viewshed.threats.attacks.base import Tampered, Wedge
from viewshed.threats.attacks.beam_lattice import rays_in
from viewshed.threats.attacks.ghosts import aim_wedge
from viewshed.threats.attacks.spoofer import (
    LEAVE,
    MEASURED_SPOOFER,
    NO_RETURN,
    NOISELESS_SPOOFER,
    Spoofer,
    azimuth_or_random,
    choose_random,
    limits_m,
)
from viewshed.threats.parameters import require, require_sector


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
    spoofer: Spoofer = MEASURED_SPOOFER

    def __post_init__(self) -> None:
        require_sector(self.budget, self.azimuth, self.sector_deg)
        require("offset_m", self.offset_m, -1000.0, 1000.0)
        require("aim_m", self.aim_m, 0.5, 1000.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        wedge = aim_wedge(sweep, self.azimuth, self.sector_deg, self.aim_m, rng)
        rays = rays_in(sweep, wedge)
        every, shifted_m = np.ones(len(rays), np.bool_), rays.depth_m + self.offset_m
        return self.spoofer.spoof_nearest(sweep, rays, every, shifted_m, wedge, self.budget, rng)


@dataclass(frozen=True, slots=True)
class PhysicalRemoval:
    """The returns of a sector are pushed inside the sensor's minimum range, which drops them: hides what is there.

    Attributes:
        budget: most returns, those nearest to the middle of the sector; None for all.
        sector_deg: width of the sector.
        azimuth: middle of the sector in the sensor's frame; None aims at an obstacle.
        aim_m: obstacles nearer than this are aimed at.
        spoofer: how well the beams are won.
    """

    budget: int | None = None
    sector_deg: float = 30.0
    azimuth: float | None = None
    aim_m: float = 30.0
    spoofer: Spoofer = MEASURED_SPOOFER

    def __post_init__(self) -> None:
        require_sector(self.budget, self.azimuth, self.sector_deg)
        require("aim_m", self.aim_m, 0.5, 1000.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        wedge = aim_wedge(sweep, self.azimuth, self.sector_deg, self.aim_m, rng)
        rays = rays_in(sweep, wedge)
        every, gone = np.ones(len(rays), np.bool_), np.full(len(rays), NO_RETURN)
        return self.spoofer.spoof_nearest(sweep, rays, every, gone, wedge, self.budget, rng)


@dataclass(frozen=True, slots=True)
class HighFrequencyRemoval:
    """Pulses at a high rate drown a sector: some of its beams return at random ranges, the others not at all.

    Attributes:
        budget: most beams, those nearest to the middle of the sector; None for all.
        sector_deg: width of the sector.
        noise_rate: share of the beams won that return noise.
        noise_m: noise ranges are uniform from 0 to this; those below the minimum range are dropped.
        azimuth: middle of the sector in the sensor's frame; None aims at an obstacle.
        aim_m: obstacles nearer than this are aimed at.
        spoofer: how well the beams are won.
    """

    budget: int | None = None
    sector_deg: float = 13.0
    noise_rate: float = 0.3
    noise_m: float = 50.0
    azimuth: float | None = None
    aim_m: float = 30.0
    spoofer: Spoofer = NOISELESS_SPOOFER

    def __post_init__(self) -> None:
        require_sector(self.budget, self.azimuth, self.sector_deg)
        require("noise_rate", self.noise_rate, 0.0, 1.0)
        require("noise_m", self.noise_m, 0.5, 1000.0)
        require("aim_m", self.aim_m, 0.5, 1000.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        wedge = aim_wedge(sweep, self.azimuth, self.sector_deg, self.aim_m, rng)
        rays = rays_in(sweep, wedge, empty=True)
        noisy, every = rng.random(len(rays)) < self.noise_rate, np.ones(len(rays), np.bool_)
        depth_m = np.where(noisy, rng.uniform(0.0, self.noise_m, len(rays)), NO_RETURN)
        return self.spoofer.spoof_nearest(sweep, rays, every, depth_m, wedge, self.budget, rng)


@dataclass(frozen=True, slots=True)
class Jamming:
    """A light that saturates the sensor: beams of the whole scan return at random ranges, or not at all.

    Attributes:
        budget: most beams, drawn at random; None for the share.
        share: of the beams that are jammed.
        blind_share: of those, beams that do not return at all.
        sector_deg: width of the sector that is jammed.
        azimuth: middle of the sector in the sensor's frame; None draws one.
        spoofer: how well the beams are won.
    """

    budget: int | None = None
    share: float = 0.3
    blind_share: float = 0.0
    sector_deg: float = 360.0
    azimuth: float | None = None
    spoofer: Spoofer = NOISELESS_SPOOFER

    def __post_init__(self) -> None:
        require_sector(self.budget, self.azimuth, self.sector_deg)
        require("share", self.share, 0.0, 1.0)
        require("blind_share", self.blind_share, 0.0, 1.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        wedge = Wedge.of_sector(azimuth_or_random(self.azimuth, rng), self.sector_deg)
        rays = rays_in(sweep, wedge, empty=True)
        chosen = choose_random(rng.random(len(rays)) < self.share, self.budget, rng)
        depth_m = rng.uniform(*limits_m(sweep), len(rays))
        depth_m[rng.random(len(rays)) < self.blind_share] = NO_RETURN
        return self.spoofer.spoof(sweep, rays, np.where(chosen, depth_m, LEAVE), wedge, rng)
