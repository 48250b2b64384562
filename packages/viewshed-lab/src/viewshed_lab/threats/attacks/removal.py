"""Removal: returns pushed inside the minimum range, or drowned in pulses (families 8, 9 and 10).

Relay: the sensor's own pulses, sent back later (family 12).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from viewshed.sweep import Sweep
from viewshed_lab.threats.attacks.beam_lattice import Rays
from viewshed_lab.threats.attacks.spoofer import NO_RETURN, NOISELESS_SPOOFER, Spoofer, choose_random, limits_m
from viewshed_lab.threats.attacks.wedge_attack import WedgeAttack
from viewshed_lab.threats.parameters import Between, Range, Sector, Share

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
