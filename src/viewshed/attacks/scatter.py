"""Points without a shape: over the whole extent, in a cluster, in a narrow wedge (families 1, 2 and 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from viewshed.attacks.assembly import added
from viewshed.attacks.checks import require, require_azimuth, require_budget, require_one_of
from viewshed.attacks.rays import rays_in
from viewshed.attacks.scene import (
    Box,
    ahead,
    chord_m,
    drawn_azimuth,
    ground_at,
    level_rays,
    open_azimuth,
    scene_of,
    to_sensor,
)
from viewshed.attacks.spoofer import AS_MEASURED, LEAVE, Spoofer, some_of
from viewshed.attacks.tampering import Tampered, Wedge
from viewshed.sweep import Sweep

Mode = Literal["free_form", "beam_constrained"]
MODES: tuple[Mode, ...] = ("free_form", "beam_constrained")
ANYWHERE = Wedge(0.0, 2 * np.pi)
HEIGHTS_M = (0.2, 1.8)
"""Free points lie between these heights above the ground."""
MOST_FREE = 1_000_000
"""The largest budget of free points; nothing else bounds them."""
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Uniform:
    """Points over the whole extent: the paper's, which stretches whatever trusts the farthest return.

    Free-form, x and y are uniform over the square. On beams, those to hit are drawn at random and their ranges so that
    places are uniform over the disc.

    Attributes:
        budget: most points.
        half_extent_m: half the side of the square, and radius of the disc.
        mode: ``free_form`` or ``beam_constrained``.
        spoofer: of the mode on beams.
    """

    budget: int = 150
    half_extent_m: float = 64.0
    mode: Mode = "free_form"
    spoofer: Spoofer = AS_MEASURED

    def __post_init__(self) -> None:
        require_budget(self.budget)
        require("half_extent_m", self.half_extent_m, 1.0, 1000.0)
        _require_mode(self.mode, self.budget)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        half = self.half_extent_m
        if self.mode == "free_form":
            xy = rng.uniform(-half, half, (self.budget, 2))
            return added(sweep, _standing(sweep, xy, rng), rng)
        rays = rays_in(sweep, ANYWHERE, empty=True)
        rays = rays.select(some_of(np.ones(len(rays), np.bool_), self.budget, rng))
        _, way = level_rays(sweep, rays)
        range_m = half * np.sqrt(rng.random(len(rays)))
        depth_m = range_m / np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-6)
        return self.spoofer.spoof(sweep, rays, depth_m, ANYWHERE, rng)


@dataclass(frozen=True, slots=True)
class Cluster:
    """Points in one cluster: the paper's, an object where there is none.

    Attributes:
        budget: most points.
        spread_m: they lie within this of the cluster's middle, in x and in y.
        range_m: nearest and farthest range of its middle.
        mode: ``free_form`` or ``beam_constrained``.
        azimuth: of its middle in the sensor's frame; None draws one.
        spoofer: of the mode on beams.
    """

    budget: int = 150
    spread_m: float = 3.0
    range_m: tuple[float, float] = (10.0, 70.0)
    mode: Mode = "free_form"
    azimuth: float | None = None
    spoofer: Spoofer = AS_MEASURED

    def __post_init__(self) -> None:
        require_budget(self.budget)
        require("spread_m", self.spread_m, 0.01, 100.0)
        require("range_m[0]", self.range_m[0], 0.1, self.range_m[1])
        require("range_m[1]", self.range_m[1], self.range_m[0], 1000.0)
        require_azimuth(self.azimuth)
        _require_mode(self.mode, self.budget)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        azimuth, range_m = drawn_azimuth(self.azimuth, rng), float(rng.uniform(*self.range_m))
        x, y, _ = ahead(sweep, azimuth, range_m)
        if self.mode == "free_form":
            xy = np.array([x, y]) + rng.uniform(-self.spread_m, self.spread_m, (self.budget, 2))
            return added(sweep, _standing(sweep, xy, rng), rng)
        wide = 2 * self.spread_m
        box = Box((x, y), 0.0, (wide, wide, 3.0), ground_at(sweep, x, y))
        wedge = wedge_around(azimuth, range_m, np.sqrt(2.0) * self.spread_m)
        rays = rays_in(sweep, wedge, empty=True)
        enter, leave = chord_m(*level_rays(sweep, rays), box)
        hit = np.isfinite(enter)
        depth_m = np.where(hit, rng.uniform(np.where(hit, enter, 0.0), np.where(hit, leave, 1.0)), LEAVE)
        chosen = some_of(hit, self.budget, rng)
        return self.spoofer.spoof(sweep, rays, np.where(chosen, depth_m, LEAVE), wedge, rng)


@dataclass(frozen=True, slots=True)
class WedgeCluster:
    """Points within a few degrees at one range: the classic spoof of an object.

    Attributes:
        budget: most points.
        sector_deg: width of the wedge.
        range_m: where the object is to be.
        mode: ``beam_constrained`` or ``free_form``.
        azimuth: middle of the wedge in the sensor's frame; None draws one where the view is open.
        spoofer: of the mode on beams.
    """

    budget: int = 100
    sector_deg: float = 8.0
    range_m: float = 10.0
    mode: Mode = "beam_constrained"
    azimuth: float | None = None
    spoofer: Spoofer = AS_MEASURED

    def __post_init__(self) -> None:
        require_budget(self.budget)
        require("sector_deg", self.sector_deg, 0.01, 180.0)
        require("range_m", self.range_m, 0.1, 1000.0)
        require_azimuth(self.azimuth)
        _require_mode(self.mode, self.budget)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        azimuth = open_azimuth(sweep, self.range_m, rng) if self.azimuth is None else self.azimuth
        wedge = Wedge(azimuth, float(np.deg2rad(self.sector_deg)))
        x, y, level_azimuth = ahead(sweep, wedge.azimuth, self.range_m)
        if self.mode == "free_form":
            around = level_azimuth + rng.uniform(-0.5, 0.5, self.budget) * wedge.width
            range_m = rng.normal(self.range_m, self.spoofer.point_sigma_m, self.budget)
            xy = range_m[:, None] * np.stack([np.cos(around), np.sin(around)], axis=1)
            return added(sweep, _standing(sweep, xy, rng), rng)
        rays = rays_in(sweep, wedge, empty=True)
        start, way = level_rays(sweep, rays)
        depth_m = self.range_m / np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-6)
        height_m = start[:, 2] + depth_m * way[:, 2] - ground_at(sweep, x, y)
        fits = (height_m > HEIGHTS_M[0]) & (height_m < HEIGHTS_M[1])
        chosen = some_of(fits, self.budget, rng)
        return self.spoofer.spoof(sweep, rays, np.where(chosen, depth_m, LEAVE), wedge, rng)


def wedge_around(azimuth: float, range_m: float, radius_m: float) -> Wedge:
    """Return the wedge that holds a disc of ``radius_m`` at ``range_m``; everything if the sensor is inside."""
    return Wedge(azimuth, 2 * np.pi if radius_m >= range_m else 2 * float(np.arcsin(radius_m / range_m)))


def _require_mode(mode: str, budget: int | None) -> None:
    require_one_of("mode", mode, MODES)
    if mode == "free_form" and budget is not None and budget > MOST_FREE:
        raise ValueError(f"budget must lie in [0, {MOST_FREE}] for free points, got {budget}")


def _standing(sweep: Sweep, xy: Floats, rng: np.random.Generator) -> Floats:
    """Return points (A, 3) of the sensor's frame over places (A, 2) of the level frame, at heights of an obstacle."""
    z = scene_of(sweep).ground.at(xy) + rng.uniform(*HEIGHTS_M, len(xy))
    return to_sensor(sweep, np.column_stack([xy, z]))
