"""The body of attacks on the beams of a wedge: where it is aimed, which beams it holds, what the budget allows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from viewshed.sweep import Sweep
from viewshed_lab.threats.attacks.base import Tampered, Wedge
from viewshed_lab.threats.attacks.beam_lattice import Rays, rays_in
from viewshed_lab.threats.attacks.placement import Placement, placed_azimuth
from viewshed_lab.threats.attacks.spoofer import MEASURED_SPOOFER, Spoofer, azimuth_or_random, random_obstacle_azimuth
from viewshed_lab.threats.parameters import Azimuth, Budget, Checked, Sector


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
