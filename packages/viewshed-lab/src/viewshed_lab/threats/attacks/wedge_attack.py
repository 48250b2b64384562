"""Attacks on the beams of a wedge: where it is aimed, which beams it holds, what the budget allows.

Removal: returns pushed inside the minimum range, or drowned in pulses (families 8, 9 and 10). Relay: the sensor's own
pulses, sent back later (family 12).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from viewshed.sweep import Sweep
from viewshed_lab._config import Azimuth, Between, Budget, Checked, Range, Sector, Share
from viewshed_lab.threats.attacks.base import Tampered, Wedge
from viewshed_lab.threats.attacks.beam_lattice import Rays, rays_in
from viewshed_lab.threats.attacks.placement import Placement, placed_azimuth
from viewshed_lab.threats.attacks.spoofer import (
    MEASURED_SPOOFER,
    NO_RETURN,
    NOISELESS_SPOOFER,
    Spoofer,
    azimuth_or_random,
    choose_random,
    limits_m,
    random_obstacle_azimuth,
)


@dataclass(frozen=True, slots=True)
class WedgeAttack(Checked):
    """The beams of a wedge report something else: of the beams that a plan names, those nearest to the wedge's middle.

    A member says in :meth:`plan` which beams it attacks and what they are to report.
    """

    budget: Budget = None  # most beams, those nearest to the middle of the wedge; None for all
    sector_deg: Sector = 30.0  # width of the wedge
    azimuth: Azimuth = None  # middle of the wedge in the sensor's frame; None aims as ``placement`` says
    # ``random`` aims at a near obstacle drawn at random; ``behind_nearest_obstacle`` where the nearest obstacle hides
    # the most ground; ``largest_hidden_area`` where the wedge opens most of what obstacles hide. A sweep without hidden
    # ground leaves it to chance.
    placement: Placement = "random"
    spoofer: Spoofer = MEASURED_SPOOFER  # how well the beams are won

    takes_empty: ClassVar[bool] = False
    """Whether the plan also covers beams without a return."""

    @property
    def aim_m(self) -> float:
        """Obstacles nearer than this, in meters, are aimed at; 0 draws any azimuth."""
        return 0.0

    @property
    def reach_m(self) -> float:
        """Ground up to this range, in meters, can be opened."""
        return np.inf

    def plan(self, sweep: Sweep, rays: Rays, rng: np.random.Generator) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """Return which rays (K,) of the wedge are attacked, and the depths (K,) in meters that they are to report."""
        raise NotImplementedError

    def aim(self, sweep: Sweep, rng: np.random.Generator) -> Wedge:
        """Return the wedge that the attacker reaches."""
        azimuth = self.azimuth
        if azimuth is None and self.placement != "random":
            near_m = self.aim_m or np.inf
            azimuth = placed_azimuth(self.placement, sweep, self.sector_deg, self.budget, near_m, self.reach_m)
        if azimuth is None and self.aim_m > 0:
            azimuth = random_obstacle_azimuth(sweep, 0.0, self.aim_m, rng)
        return Wedge.of_sector(azimuth_or_random(azimuth, rng), self.sector_deg)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        wedge = self.aim(sweep, rng)
        rays = rays_in(sweep, wedge, empty=self.takes_empty)
        attacked, depth_m = self.plan(sweep, rays, rng)
        return self.spoofer.spoof_nearest(sweep, rays, attacked, depth_m, wedge, self.budget, rng)


Plan = tuple[NDArray[np.bool_], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class Relay(WedgeAttack):
    """A sector of the scan with a constant offset in range: its objects stand elsewhere."""

    # added to each range; returns that would be nearer than the minimum range are dropped
    offset_m: Annotated[float, Between(-1000.0, 1000.0)] = 5.0
    aim_m: Range = 30.0  # obstacles nearer than this are aimed at

    def plan(self, sweep: Sweep, rays: Rays, rng: np.random.Generator) -> Plan:
        """Return every beam, with its range and the offset."""
        return np.ones(len(rays), np.bool_), rays.depth_m + self.offset_m


@dataclass(frozen=True, slots=True)
class PhysicalRemoval(WedgeAttack):
    """The returns of a sector are pushed inside the sensor's minimum range, which drops them: hides what is there."""

    aim_m: Range = 30.0  # obstacles nearer than this are aimed at

    def plan(self, sweep: Sweep, rays: Rays, rng: np.random.Generator) -> Plan:
        """Return every beam, without a return."""
        return np.ones(len(rays), np.bool_), np.full(len(rays), NO_RETURN)


@dataclass(frozen=True, slots=True)
class HighFrequencyRemoval(WedgeAttack):
    """Pulses at a high rate drown a sector: some of its beams return at random ranges, the others not at all."""

    sector_deg: Sector = 13.0
    noise_rate: Share = 0.3  # share of the beams won that return noise
    noise_m: Range = 50.0  # noise ranges are uniform from 0 to this; those below the minimum range are dropped
    aim_m: Range = 30.0  # obstacles nearer than this are aimed at
    spoofer: Spoofer = NOISELESS_SPOOFER

    takes_empty = True

    def plan(self, sweep: Sweep, rays: Rays, rng: np.random.Generator) -> Plan:
        """Return every beam, with a random range or without a return."""
        noisy = rng.random(len(rays)) < self.noise_rate
        depth_m = np.where(noisy, rng.uniform(0.0, self.noise_m, len(rays)), NO_RETURN)
        return np.ones(len(rays), np.bool_), depth_m


@dataclass(frozen=True, slots=True)
class Jamming(WedgeAttack):
    """A light that saturates the sensor: beams of the whole scan return at random ranges, or not at all.

    A budget is spent on beams drawn at random; the sector is drawn where no azimuth is given.
    """

    sector_deg: Sector = 360.0
    share: Share = 0.3  # of the beams that are jammed
    blind_share: Share = 0.0  # of those, beams that do not return at all
    spoofer: Spoofer = NOISELESS_SPOOFER

    takes_empty = True

    def plan(self, sweep: Sweep, rays: Rays, rng: np.random.Generator) -> Plan:
        """Return a share of the beams, with random ranges or without a return."""
        chosen = choose_random(rng.random(len(rays)) < self.share, self.budget, rng)
        depth_m = rng.uniform(*limits_m(sweep), len(rays))
        depth_m[rng.random(len(rays)) < self.blind_share] = NO_RETURN
        return chosen, depth_m
