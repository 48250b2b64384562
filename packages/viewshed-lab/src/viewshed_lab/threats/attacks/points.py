"""Points without a shape: over the whole extent, in a cluster, in a narrow wedge (families 1, 2 and 3).

Points in the frustum of a real object, where a camera sees the object too (family 4).

The attack of arXiv 2503.07375, drawn as in its code, for the paper's own profile.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from viewshed.arrays import F64
from viewshed.geometry import rotation_from_quaternion
from viewshed.sweep import Sweep
from viewshed_lab._config import Ascending, Azimuth, Between, Budget, Checked, Points, Share
from viewshed_lab.threats.attacks.base import Tampered, Wedge
from viewshed_lab.threats.attacks.beam_lattice import Rays, rays_in
from viewshed_lab.threats.attacks.spoofer import (
    FULL_CIRCLE,
    LEAVE,
    MEASURED_SPOOFER,
    GroundBox,
    Spoofer,
    add_points,
    azimuth_or_random,
    choose_random,
    chord_m,
    ground_at,
    is_obstacle,
    level_rays,
    position_at,
    random_obstacle_azimuth,
    random_open_azimuth,
    scene_of,
    street_depth_m,
    to_sensor,
    untouched,
)

Mode = Literal["free_form", "beam_constrained"]

Side = Literal["behind", "before"]

HEIGHTS_M = (0.2, 1.8)
"""Minimum and maximum height of free points above the ground."""

MAX_FREE_POINTS = 1_000_000
"""Maximum budget of free points, which no number of beams limits."""


@dataclass(frozen=True, slots=True)
class Uniform(Checked):
    """Points over the whole extent: the paper's, against estimators that trust the farthest return.

    Free-form, x and y are uniform over the square. On beams, random beams are spoofed at random ranges, so that places
    are uniform over the disc.
    """

    budget: Points = 150  # maximum number of points
    half_extent_m: Annotated[float, Between(1.0, 1000.0)] = 64.0  # half the side of the square, and radius of the disc
    mode: Mode = "free_form"  # ``free_form`` or ``beam_constrained``
    spoofer: Spoofer = MEASURED_SPOOFER  # for ``beam_constrained``

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        check_free_budget(self.mode, self.budget)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        half = self.half_extent_m
        if self.mode == "free_form":
            xy = rng.uniform(-half, half, (self.budget, 2))
            return add_points(sweep, _at_obstacle_heights(sweep, xy, rng), rng)
        rays = rays_in(sweep, FULL_CIRCLE, empty=True)
        rays = rays.select(choose_random(np.ones(len(rays), np.bool_), self.budget, rng))
        _, direction = level_rays(sweep, rays)
        range_m = half * np.sqrt(rng.random(len(rays)))
        depth_m = range_m / np.maximum(np.hypot(direction[:, 0], direction[:, 1]), 1e-6)
        return self.spoofer.spoof(sweep, rays, depth_m, FULL_CIRCLE, rng)


@dataclass(frozen=True, slots=True)
class Cluster(Checked):
    """Points in one cluster: the paper's, an object where there is none."""

    budget: Points = 150  # maximum number of points
    # maximum distance from the cluster's center, in x and in y
    spread_m: Annotated[float, Between(0.01, 100.0)] = 3.0
    # minimum and maximum range of its center
    range_m: Annotated[tuple[float, float], Ascending(0.1, 1000.0)] = (10.0, 70.0)
    mode: Mode = "free_form"  # ``free_form`` or ``beam_constrained``
    azimuth: Azimuth = None  # of its center in the sensor's frame; None draws one
    spoofer: Spoofer = MEASURED_SPOOFER  # for ``beam_constrained``

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        check_free_budget(self.mode, self.budget)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        azimuth, range_m = azimuth_or_random(self.azimuth, rng), float(rng.uniform(*self.range_m))
        x, y, _ = position_at(sweep, azimuth, range_m)
        if self.mode == "free_form":
            xy = np.array([x, y]) + rng.uniform(-self.spread_m, self.spread_m, (self.budget, 2))
            return add_points(sweep, _at_obstacle_heights(sweep, xy, rng), rng)
        wide = 2 * self.spread_m
        box = GroundBox((x, y), 0.0, (wide, wide, 3.0), ground_at(sweep, x, y))
        wedge = wedge_around(azimuth, range_m, np.sqrt(2.0) * self.spread_m)
        rays = rays_in(sweep, wedge, empty=True)
        enter, leave = chord_m(*level_rays(sweep, rays), box)
        hit = np.isfinite(enter)
        depth_m = np.where(hit, rng.uniform(np.where(hit, enter, 0.0), np.where(hit, leave, 1.0)), LEAVE)
        chosen = choose_random(hit, self.budget, rng)
        return self.spoofer.spoof(sweep, rays, np.where(chosen, depth_m, LEAVE), wedge, rng)


@dataclass(frozen=True, slots=True)
class WedgeCluster(Checked):
    """Points within a few degrees at one range: the classic spoof of an object."""

    budget: Points = 100  # maximum number of points
    sector_deg: Annotated[float, Between(0.01, 180.0)] = 8.0  # width of the wedge
    range_m: Annotated[float, Between(0.1, 1000.0)] = 10.0  # horizontal range of the points
    mode: Mode = "beam_constrained"  # ``beam_constrained`` or ``free_form``
    azimuth: Azimuth = None  # center of the wedge in the sensor's frame; None draws one where the view is open
    spoofer: Spoofer = MEASURED_SPOOFER  # for ``beam_constrained``

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        check_free_budget(self.mode, self.budget)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        azimuth = random_open_azimuth(sweep, self.range_m, rng) if self.azimuth is None else self.azimuth
        wedge = Wedge.of_sector(azimuth, self.sector_deg)
        x, y, level_azimuth = position_at(sweep, wedge.azimuth, self.range_m)
        if self.mode == "free_form":
            azimuths = level_azimuth + rng.uniform(-0.5, 0.5, self.budget) * wedge.width
            range_m = rng.normal(self.range_m, self.spoofer.sigma_m(sweep), self.budget)
            xy = range_m[:, None] * np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1)
            return add_points(sweep, _at_obstacle_heights(sweep, xy, rng), rng)
        rays = rays_in(sweep, wedge, empty=True)
        start, direction = level_rays(sweep, rays)
        depth_m = self.range_m / np.maximum(np.hypot(direction[:, 0], direction[:, 1]), 1e-6)
        height_m = start[:, 2] + depth_m * direction[:, 2] - ground_at(sweep, x, y)
        fits = (height_m > HEIGHTS_M[0]) & (height_m < HEIGHTS_M[1])
        chosen = choose_random(fits, self.budget, rng)
        return self.spoofer.spoof(sweep, rays, np.where(chosen, depth_m, LEAVE), wedge, rng)


def wedge_around(azimuth: float, range_m: float, radius_m: float) -> Wedge:
    """Return the wedge around a disc of ``radius_m`` at ``range_m``; the full circle if the sensor is inside."""
    return Wedge(azimuth, 2 * np.pi if radius_m >= range_m else 2 * float(np.arcsin(radius_m / range_m)))


def check_free_budget(mode: str, budget: int | None) -> None:
    """Raise a ValueError if free points have no budget, or too large a one."""
    if mode == "free_form" and (budget is None or budget > MAX_FREE_POINTS):
        raise ValueError(f"budget must lie in [0, {MAX_FREE_POINTS}] for free points, got {budget}")


def _at_obstacle_heights(sweep: Sweep, xy: F64, rng: np.random.Generator) -> F64:
    """Return points (A, 3) in the sensor's frame over places (A, 2) in the level frame, at random obstacle heights."""
    z = scene_of(sweep).ground.at(xy) + rng.uniform(*HEIGHTS_M, len(xy))
    return to_sensor(sweep, np.column_stack([xy, z]))


@dataclass(frozen=True, slots=True)
class Frustum(Checked):
    """Points behind or in front of a real object, on beams that hit it: consistent with what a camera sees.

    The object is the nearest obstacle at the azimuth of a random obstacle return; without any, nothing is changed.
    """

    budget: Budget = 200  # maximum number of points; None for all beams of the object
    side: Side = "behind"  # ``behind`` or ``before`` the object
    # distance behind or before it; never nearer than 1 m to the sensor, never below the ground
    apart_m: Annotated[float, Between(0.1, 200.0)] = 8.0
    range_m: Annotated[tuple[float, float], Ascending(0.1)] = (4.0, 40.0)  # minimum and maximum range of the object
    radius_m: Annotated[float, Between(0.1, 50.0)] = 2.5  # of the object
    # ``beam_constrained`` moves the object's returns, ``free_form`` adds points and keeps them
    mode: Mode = "beam_constrained"
    spoofer: Spoofer = MEASURED_SPOOFER  # for ``beam_constrained``

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        azimuth = random_obstacle_azimuth(sweep, *self.range_m, rng)
        if azimuth is None:
            return untouched(sweep)
        rays, wedge = self._object(sweep, azimuth)
        chosen = choose_random(np.ones(len(rays), np.bool_), self.budget, rng)
        if self.mode == "beam_constrained":
            target_m = np.where(chosen, self._depth_m(sweep, rays, self.apart_m), LEAVE)
            return self.spoofer.spoof(sweep, rays, target_m, wedge, rng)
        rays = rays.select(chosen)
        apart_m = self.apart_m * rng.uniform(0.5, 1.5, len(rays))
        return add_points(sweep, rays.at(self._depth_m(sweep, rays, apart_m)), rng)

    def _object(self, sweep: Sweep, azimuth: float) -> tuple[Rays, Wedge]:
        """Return the rays that hit the nearest obstacle at ``azimuth``, and a wedge around them."""
        thin = rays_in(sweep, Wedge(azimuth, 0.01))
        nearest_m = _range_m(sweep, thin)[is_obstacle(sweep, thin)].min(initial=np.inf)
        nearest_m = float(nearest_m) if np.isfinite(nearest_m) else self.range_m[0]
        wedge = wedge_around(azimuth, nearest_m, self.radius_m)
        rays = rays_in(sweep, wedge)
        near = np.abs(_range_m(sweep, rays) - nearest_m) < self.radius_m
        return rays.select(near & is_obstacle(sweep, rays)), wedge

    def _depth_m(self, sweep: Sweep, rays: Rays, apart_m: F64 | float) -> F64:
        """Return the target depths (K,) in meters: those of the object, moved, but not below the ground."""
        if self.side == "before":
            return np.maximum(rays.depth_m - apart_m, 1.0)
        return np.maximum(np.minimum(rays.depth_m + apart_m, street_depth_m(sweep, rays, 1000.0)), rays.depth_m)


def _range_m(sweep: Sweep, rays: Rays) -> F64:
    _, direction = level_rays(sweep, rays)
    return rays.depth_m * np.hypot(direction[:, 0], direction[:, 1])


@dataclass(frozen=True, slots=True)
class PaperAttack(Checked):
    """For each sweep one of: points over the extent (p .6), one cluster (p .2), nothing (p .2).

    The paper adds its points to the projection. Here they are returns at the sensor's own height in the level frame,
    which the paper's profile projects to the same place.
    """

    uniform_share: Share = 0.6  # probability of points over the extent
    cluster_share: float = 0.2  # probability of a cluster
    half_extent_m: Annotated[float, Between(1.0, 1000.0)] = 80.0  # half the side of the extent
    uniform_points: Annotated[tuple[int, int], Ascending(0)] = (80, 119)  # min and max number of points over the extent
    cluster_points: Annotated[tuple[int, int], Ascending(0)] = (10, 159)  # min and max number of points of a cluster
    # minimum and maximum distance of a cluster's center, along each axis
    cluster_m: Annotated[tuple[float, float], Ascending(0.0)] = (40.0, 70.0)
    spread_m: Annotated[float, Between(0.0, 100.0)] = 3.0  # maximum distance of points from it, along each axis

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        Between(0.0, 1.0 - self.uniform_share + 1e-9).check("cluster_share", self.cluster_share)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        which = rng.random()
        if which < self.uniform_share:
            count = int(rng.integers(*self.uniform_points, endpoint=True))
            xy = rng.uniform(-self.half_extent_m, self.half_extent_m, (count, 2))
        elif which < self.uniform_share + self.cluster_share:
            count = int(rng.integers(*self.cluster_points, endpoint=True))
            center = rng.uniform(*self.cluster_m, 2) * rng.choice([-1.0, 1.0], 2)
            xy = center + rng.uniform(-self.spread_m, self.spread_m, (count, 2))
        else:
            return untouched(sweep)
        # From the level frame to the sensor's frame.
        known = sweep.known_attitude
        rotation = scene_of(sweep).level_from_sensor.rotation if known is None else rotation_from_quaternion(known)
        return add_points(sweep, np.column_stack([xy, np.zeros(len(xy))]) @ rotation, rng)


PAPER_ATTACK = PaperAttack()
"""The paper's attack, for cars on roads."""

PAPER_INDOOR_ATTACK = PaperAttack(half_extent_m=18.0, cluster_m=(9.0, 15.75), spread_m=0.675)
"""The same, scaled to the paper's indoor extent of 18 m."""
