"""Returns that a faulty or cheaper sensor never delivers: single beams, sectors, rings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from viewshed.geometry import polar
from viewshed.preprocess.ring_recovery import rings_of_sweep
from viewshed.sweep import Sweep
from viewshed_lab.threats.parameters import Between, Checked, Share


@dataclass(frozen=True, slots=True)
class DroppedBeams(Checked):
    """Beams chosen at random return nothing."""

    share: Share  # of the returns, rounded to whole ones

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the share."""
        keep = np.ones(len(sweep), np.bool_)
        keep[rng.permutation(len(sweep))[: round(self.share * len(sweep))]] = False
        return sweep.select(keep)


@dataclass(frozen=True, slots=True)
class DroppedSectors(Checked):
    """Sectors of the revolution are lost: packets that did not arrive, dirt on the window."""

    sectors: Annotated[int, Between(0, 360)]  # how many; they may overlap
    width_deg: Annotated[float, Between(0, 360)]  # of each

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without returns in the sectors, by the azimuths of its points."""
        azimuth = polar(sweep.points)[1]
        keep = np.ones(len(sweep), np.bool_)
        for middle in rng.uniform(-np.pi, np.pi, self.sectors):
            apart = np.abs((azimuth - middle + np.pi) % (2 * np.pi) - np.pi)
            keep &= apart > np.deg2rad(self.width_deg) / 2
        return sweep.select(keep)


@dataclass(frozen=True, slots=True)
class DeadRings(Checked):
    """Some of the lasers are dead. Needs rings."""

    share: Share  # of the sensor's rings, rounded to whole ones, at least one

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the rings, drawn from all that the sensor has.

        Raises:
            ValueError: the sweep's rings are not known.
        """
        if len(sweep) == 0:
            return sweep
        beams = rings_of_sweep(sweep)
        dead = rng.permutation(beams.rings)[: max(1, round(self.share * beams.rings))]
        return sweep.select(~np.isin(beams.ring, dead))


@dataclass(frozen=True, slots=True)
class FewerBeams(Checked):
    """A sensor with fewer rings: of each ``of`` neighbors the lowest ``kept`` keep their numbers. Needs rings."""

    kept: int  # rings that remain of each group
    of: Annotated[int, Between(1, 4096)]  # rings in a group

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        Between(1, self.of).check("kept", self.kept)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the other rings; nothing is random, and ``rng`` is left as it was.

        Raises:
            ValueError: the sweep's rings are not known.
        """
        if len(sweep) == 0:
            return sweep
        ring = rings_of_sweep(sweep).ring
        return sweep.select((ring >= 0) & (ring % self.of < self.kept))
