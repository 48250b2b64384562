"""Null attacks: every attack at zero strength. It chooses its beams and changes nothing but their noise.

Evidence that tells a null attack from a benign sweep has learned how attacks are made here, not what attacks do.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from viewshed.sweep import Sweep
from viewshed_lab.threats.attacks.base import Attack
from viewshed_lab.threats.attacks.beam_lattice import Rays, lattice_of
from viewshed_lab.threats.attacks.replay import depths_in
from viewshed_lab.threats.attacks.spoofer import Spoofer


@dataclass(frozen=True, slots=True, eq=False)
class NullSpoofer(Spoofer):
    """A spoofer whose returns are those of the surfaces that are there: ranges of the same instant, measured once more.

    Sensor and surface make their noise, so it is that of a benign return in level and steps. Beams that did not return,
    in one of the two sweeps, stay as they are: number and order of the rows are those of the clean sweep.
    """

    again: Sweep = field(kw_only=True)  # the same instant of the same sensor, with other noise

    def reported_m(
        self, sweep: Sweep, rays: Rays, wanted_m: NDArray[np.float64], rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return the ranges (K,) of the second measurement; of a beam that has none in one of the two, its own."""
        again_m = depths_in(self.again, lattice_of(sweep), rays)
        redrawn = np.isfinite(again_m) & (rays.row >= 0) & (rays.ring >= 0)
        return Spoofer.reported_m(self, sweep, rays, np.where(redrawn, again_m, rays.depth_m), rng)


def null_of(attack: Attack, again: Sweep) -> Attack:
    """Return an attack with a spoofer at zero strength: the same beams, wedge and code, returns as of a benign sweep.

    Free points replace no return; there it is the mode on beams. Intensities are drawn from the sweep's own, as for
    every attack.
    """
    changed: Any = attack
    null = NullSpoofer(changed.spoofer.reliability, 0.0, 0.0, again=again)
    mode = {"mode": "beam_constrained"} if "mode" in {setting.name for setting in fields(changed)} else {}
    return cast(Attack, replace(changed, spoofer=null, **mode))
