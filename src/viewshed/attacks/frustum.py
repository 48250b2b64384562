"""Points in the frustum of a real object, where a camera sees the object too (family 4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from viewshed.attacks.assembly import added, untouched
from viewshed.attacks.checks import require, require_budget, require_one_of
from viewshed.attacks.rays import Rays, rays_in
from viewshed.attacks.scatter import MODES, Mode, wedge_around
from viewshed.attacks.scene import azimuth_of_obstacle, is_obstacle, level_rays, street_depth_m
from viewshed.attacks.spoofer import AS_MEASURED, LEAVE, Spoofer, some_of
from viewshed.attacks.tampering import Tampered, Wedge
from viewshed.sweep import Sweep

Side = Literal["behind", "before"]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Frustum:
    """Points behind or before a real object, on beams that meet it: consistent with what a camera sees.

    The object is the obstacle around a return drawn at random. Without any obstacle in range nothing is done.

    Attributes:
        budget: most points; None for all beams of the object.
        side: ``behind`` or ``before`` the object.
        apart_m: how far behind or before; never nearer than 1 m to the sensor, never below the ground.
        range_m: nearest and farthest object.
        radius_m: returns within this of the drawn one belong to the object.
        mode: ``beam_constrained`` moves the object's returns, ``free_form`` adds points and leaves them.
        spoofer: of the mode on beams.
    """

    budget: int | None = 200
    side: Side = "behind"
    apart_m: float = 8.0
    range_m: tuple[float, float] = (4.0, 40.0)
    radius_m: float = 2.5
    mode: Mode = "beam_constrained"
    spoofer: Spoofer = AS_MEASURED

    def __post_init__(self) -> None:
        require_budget(self.budget)
        require_one_of("side", self.side, ("behind", "before"))
        require_one_of("mode", self.mode, MODES)
        require("apart_m", self.apart_m, 0.1, 200.0)
        require("range_m[0]", self.range_m[0], 0.1, self.range_m[1])
        require("radius_m", self.radius_m, 0.1, 50.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        azimuth = azimuth_of_obstacle(sweep, *self.range_m, rng)
        if azimuth is None:
            return untouched(sweep)
        rays, wedge = self._object(sweep, azimuth)
        chosen = some_of(np.ones(len(rays), np.bool_), self.budget, rng)
        if self.mode == "beam_constrained":
            wanted_m = np.where(chosen, self._depth_m(sweep, rays, self.apart_m), LEAVE)
            return self.spoofer.spoof(sweep, rays, wanted_m, wedge, rng)
        rays = rays.select(chosen)
        apart_m = self.apart_m * rng.uniform(0.5, 1.5, len(rays))
        return added(sweep, rays.at(self._depth_m(sweep, rays, apart_m)), rng)

    def _object(self, sweep: Sweep, azimuth: float) -> tuple[Rays, Wedge]:
        """Return the rays that meet the nearest obstacle at ``azimuth``, and a wedge around them."""
        thin = rays_in(sweep, Wedge(azimuth, 0.01))
        nearest_m = _range_m(sweep, thin)[is_obstacle(sweep, thin)].min(initial=np.inf)
        nearest_m = float(nearest_m) if np.isfinite(nearest_m) else self.range_m[0]
        wedge = wedge_around(azimuth, nearest_m, self.radius_m)
        rays = rays_in(sweep, wedge)
        near = np.abs(_range_m(sweep, rays) - nearest_m) < self.radius_m
        return rays.select(near & is_obstacle(sweep, rays)), wedge

    def _depth_m(self, sweep: Sweep, rays: Rays, apart_m: Floats | float) -> Floats:
        """Return depths (K,) of the points: the object's, moved, but not below the ground."""
        if self.side == "before":
            return np.maximum(rays.depth_m - apart_m, 1.0)
        return np.maximum(np.minimum(rays.depth_m + apart_m, street_depth_m(sweep, rays, 1000.0)), rays.depth_m)


def _range_m(sweep: Sweep, rays: Rays) -> Floats:
    _, way = level_rays(sweep, rays)
    return rays.depth_m * np.hypot(way[:, 0], way[:, 1])
