"""What single things do to the beams that meet them: panes and absorbers return nothing, leaves return too early."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from viewshed.sweep import Sweep
from viewshed_lab.sim.assets.shapes import PER_M, material_index
from viewshed_lab.threats.corruptions.base import at_ranges, heights_of, ranges_of
from viewshed_lab.threats.parameters import Between, Checked

ABOVE_GROUND_M = 0.3
"""Surfaces whose returns lie higher than this above local ground may be panes, if there are any."""

BUSH_RANGES_M = (3.0, 40.0)
"""Horizontal ranges at which bushes stand."""

BEFORE_SURFACE = (0.3, 0.9)
"""A bush stands at this share of the way to the surface that it hides."""


@dataclass(frozen=True, slots=True)
class GlassPatches(Checked):
    """Glass, mirrors and absorbers: contiguous patches of surfaces return nothing."""

    patches: Annotated[int, Between(0, 1000)]  # how many
    radius_m: Annotated[float, Between(0, 100)]  # returns within this distance of the middle of a patch are gone

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the patches."""
        return self.apply_at(sweep, self.place(sweep, rng), rng)

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the middles (patches, 3) of the patches: returns above the ground, where there are any."""
        if len(sweep) == 0:
            return np.zeros((0, 3))
        raised = np.flatnonzero(heights_of(sweep) > ABOVE_GROUND_M)
        chosen = rng.choice(raised if len(raised) else len(sweep), self.patches)
        return np.asarray(sweep.points[chosen], np.float64)

    def apply_at(self, sweep: Sweep, places: NDArray[np.float64], rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the patches around ``places`` (K, 3)."""
        keep = np.ones(len(sweep), np.bool_)
        for middle in places.astype(np.float32):
            apart = sweep.points - middle
            keep &= np.einsum("ij,ij->i", apart, apart) > self.radius_m**2
        return sweep.select(keep)


@dataclass(frozen=True, slots=True)
class Vegetation(Checked):
    """Bushes before surfaces: balls of leaves in which a beam stops after a random path (Beer's law), or passes."""

    bushes: Annotated[int, Between(0, 1000)]  # how many
    radius_m: Annotated[float, Between(0, BUSH_RANGES_M[0] - 0.5)]  # of each
    # stops per meter of path; the simulator's leaves by default
    per_m: Annotated[float, Between(0, 1e6)] = float(PER_M[material_index("leaves")])

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with the returns that the leaves stopped moved nearer along their rays."""
        return self.apply_at(sweep, self.place(sweep, rng), rng)

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the middles (bushes, 3) of the bushes, each before a return; none where all returns are near."""
        flat_m = np.hypot(sweep.points[:, 0], sweep.points[:, 1])
        hidden = np.flatnonzero(flat_m * BEFORE_SURFACE[0] > BUSH_RANGES_M[0])
        if len(hidden) == 0:
            return np.zeros((0, 3))
        chosen = hidden[rng.integers(len(hidden), size=self.bushes)]
        share = np.minimum(rng.uniform(*BEFORE_SURFACE, self.bushes), BUSH_RANGES_M[1] / flat_m[chosen])
        return np.asarray(sweep.points[chosen] * share[:, None], np.float64)

    def apply_at(self, sweep: Sweep, places: NDArray[np.float64], rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with bushes around ``places`` (K, 3)."""
        if len(places) == 0:
            return sweep
        range_m = ranges_of(sweep).astype(np.float64)
        direction = sweep.points / np.maximum(range_m, 1e-9)[:, None]
        for middle in places:
            self._grow(middle, direction, range_m, rng)
        return at_ranges(sweep, range_m)

    def _grow(
        self,
        middle: NDArray[np.float64],
        direction: NDArray[np.float64],
        range_m: NDArray[np.float64],
        rng: np.random.Generator,
    ) -> None:
        """Shorten the ranges (N,) of the beams that stop in the ball around ``middle``."""
        nearest = direction @ middle
        half2 = self.radius_m**2 - (middle @ middle - nearest**2)
        crossing = np.flatnonzero((half2 > 0) & (nearest > 0) & (range_m > 0))
        half = np.sqrt(half2[crossing])
        path = rng.standard_exponential(len(crossing)) / max(self.per_m, 1e-9)
        stop = nearest[crossing] - half + path
        stopped = (path < 2 * half) & (stop < range_m[crossing])
        range_m[crossing[stopped]] = stop[stopped]
