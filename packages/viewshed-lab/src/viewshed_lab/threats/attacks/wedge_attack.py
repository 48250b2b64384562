"""Attacks on the beams of a wedge: where the wedge is placed, and which of its beams the budget allows.

Placement: computes which ground the obstacles hide, and where a wedge would open it. It uses only what an attacker in
the same scene can see, neither the truth nor the victim's estimate.

Removal: returns are pushed inside the minimum range, or drowned in pulses (families 8, 9 and 10). Relay: the sensor's
own pulses are sent back later (family 12).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.fov.visibility import CAR
from viewshed.sweep import Sweep
from viewshed_lab._config import Azimuth, Between, Budget, Checked, Range, Sector, Share
from viewshed_lab.threats.attacks.base import Tampered, Wedge
from viewshed_lab.threats.attacks.beam_lattice import Rays, rays_in
from viewshed_lab.threats.attacks.spoofer import (
    FULL_CIRCLE,
    MEASURED_SPOOFER,
    NO_RETURN,
    NOISELESS_SPOOFER,
    Spoofer,
    azimuth_or_random,
    choose_random,
    is_obstacle,
    level_rays,
    limits_m,
    random_obstacle_azimuth,
    scene_of,
)

Placement = Literal["random", "behind_nearest_obstacle", "largest_hidden_area"]
"""At a random near obstacle; where the nearest obstacle hides the most ground; where the wedge opens most ground."""

BINS = 360
"""Number of azimuth bins for hidden ground."""

_RANGES = 64
"""Number of range steps up to the attacker's reach."""

_ONE_OBSTACLE_M = 1.0
"""Neighboring bins belong to one obstacle if their nearest ranges differ by at most this."""

_LARGE_SHARE = 0.5
"""An obstacle hides little if it hides less than this share of the largest hidden area of any bin."""


@dataclass(frozen=True, slots=True, eq=False)
class HiddenGround:
    """Ground that near obstacles hide, by azimuth bins of the sensor's frame, from -π on."""

    area_m2: F64  # (BINS,) float64 area of ground behind them at which beams aim and which none reaches
    # (BINS,) float64 horizontal range of the nearest obstacle; infinite if it hides less than half of the largest
    # hidden area of any bin, as a post does
    nearest_m: F64
    beams: NDArray[np.int64]  # (BINS,) int64 number of their returns, which an attacker must move to open the ground

    def opened_m2(self, sector_deg: float, budget: int | None = None) -> F64:
        """Return the hidden area (BINS,) in m² that a wedge centered at each bin opens.

        The budget is spent from the center outward; in the bin where it ends, the area counts in proportion.
        """
        side = round((sector_deg * BINS / 360 - 1) / 2)
        steps = np.arange(-side, side + 1)[:BINS]
        steps = steps[np.argsort(np.abs(steps), kind="stable")]
        bins = (np.arange(BINS)[:, None] + steps) % BINS
        beams, area_m2 = self.beams[bins], self.area_m2[bins]
        if budget is not None:
            before = np.cumsum(beams, axis=1) - beams
            area_m2 = area_m2 * np.clip((budget - before) / np.maximum(beams, 1), 0.0, 1.0)
        return np.asarray(area_m2.sum(axis=1))

    def behind_nearest(self) -> int:
        """Return the bin where the nearest obstacle hides the most ground; obstacles that hide little do not count."""
        first = int(np.argmin(self.nearest_m))
        bins = [first]
        for way in (1, -1):
            b = first
            while len(bins) < BINS and abs(self.nearest_m[(b + way) % BINS] - self.nearest_m[b]) <= _ONE_OBSTACLE_M:
                b = (b + way) % BINS
                bins.append(b)
        return max(bins, key=lambda b: (self.area_m2[b], -b))


def placed_azimuth(
    placement: Placement, sweep: Sweep, sector_deg: float, budget: int | None, near_m: float, reach_m: float
) -> float | None:
    """Return the azimuth of a wedge's center, radians in the sensor's frame; None if no near obstacle hides any ground.

    Args:
        placement: any but ``random``.
        sweep: the clean sweep.
        sector_deg: width of the wedge.
        budget: maximum number of returns, None for all of the wedge.
        near_m: obstacles nearer than this can be made to disappear.
        reach_m: maximum range of ground that can be opened; limited to the edge of the scene.
    """
    hidden = hidden_ground_of(sweep, near_m, min(reach_m, scene_of(sweep).ground.half_extent_m))
    if not hidden.area_m2.any():
        return None
    best = hidden.behind_nearest()
    if placement == "largest_hidden_area":
        best = int(np.argmax(hidden.opened_m2(sector_deg, budget)))
    return float(azimuth_of_bin(best))


def azimuth_of_bin(number: Any) -> Any:
    """Return the center of a bin, in radians."""
    return (number + 0.5) * (2 * np.pi / BINS) - np.pi


@lru_cache(maxsize=4)
def hidden_ground_of(sweep: Sweep, near_m: float, reach_m: float) -> HiddenGround:
    """Return the ground up to ``reach_m`` that obstacles nearer than ``near_m`` hide, from the returns of ``sweep``.

    A beam aims at a place if it passes between the ground there and 1.5 m above it (the height of a car), and reaches
    the place if its return is not nearer.
    """
    rays = rays_in(sweep, FULL_CIRCLE)
    start, direction = level_rays(sweep, rays)
    flat = np.maximum(np.hypot(direction[:, 0], direction[:, 1]), 1e-6)
    range_m, slope = rays.depth_m * flat, direction[:, 2] / flat
    azimuth = np.arctan2(rays.direction[:, 1], rays.direction[:, 0])
    bins = np.clip(((azimuth + np.pi) * (BINS / (2 * np.pi))).astype(np.intp), 0, BINS - 1)
    blocks = is_obstacle(sweep, rays) & (rays.depth_m < near_m)
    # Ground height along the center of each bin.
    step_m, scene, middle = reach_m / _RANGES, scene_of(sweep), azimuth_of_bin(np.arange(BINS))
    ranges = (np.arange(_RANGES) + 0.5) * step_m
    ahead = np.stack([np.cos(middle), np.sin(middle), np.zeros(BINS)], axis=1) @ scene.level_from_sensor.rotation.T
    ground = scene.ground.at((ranges[:, None, None] * ahead[:, :2]).reshape(-1, 2)).reshape(_RANGES, BINS)
    # For each range: bins where beams aim at the ground there, a near obstacle blocks some, and none reaches it.
    hidden = np.zeros((_RANGES, BINS), np.bool_)
    for k, at_m in enumerate(ranges):
        height = start[:, 2] + at_m * slope - ground[k, bins]
        aims = (height >= 0.0) & (height <= CAR.height_m)
        reached = np.bincount(bins[aims & (range_m >= at_m - step_m / 2)], minlength=BINS)
        hidden[k] = (np.bincount(bins[aims & blocks], minlength=BINS) > 0) & (reached == 0)
    area_m2 = (hidden * (ranges * step_m * (2 * np.pi / BINS))[:, None]).sum(axis=0)
    nearest_m = np.full(BINS, np.inf)
    np.minimum.at(nearest_m, bins[blocks], range_m[blocks])
    nearest_m[area_m2 < _LARGE_SHARE * area_m2.max()] = np.inf
    return HiddenGround(area_m2, nearest_m, np.bincount(bins[blocks], minlength=BINS))


@dataclass(frozen=True, slots=True)
class WedgeAttack(Checked):
    """Base of attacks that change the ranges of a wedge's beams, at most ``budget`` of them from the center outward.

    A subclass defines in :meth:`plan` the attacked beams and the depths that they report.
    """

    budget: Budget = None  # maximum number of beams, nearest to the center of the wedge first; None for all
    sector_deg: Sector = 30.0  # width of the wedge
    azimuth: Azimuth = None  # center of the wedge in the sensor's frame; None uses ``placement``
    # ``random`` aims at a random near obstacle; ``behind_nearest_obstacle`` where the nearest obstacle hides the most
    # ground; ``largest_hidden_area`` where the wedge opens the most hidden ground. Without hidden ground: ``random``.
    placement: Placement = "random"
    spoofer: Spoofer = MEASURED_SPOOFER  # success rate and range noise

    takes_empty: ClassVar[bool] = False
    """Whether the plan also covers beams without a return."""

    @property
    def aim_m(self) -> float:
        """Obstacles nearer than this, in meters, are aimed at; 0 draws a uniform azimuth."""
        return 0.0

    @property
    def reach_m(self) -> float:
        """Ground up to this range, in meters, can be opened."""
        return np.inf

    def plan(self, sweep: Sweep, rays: Rays, rng: np.random.Generator) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """Return the mask (K,) of the wedge's rays that are attacked, and their target depths (K,) in meters."""
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
        """Return the attacked sweep and the record of its changes."""
        wedge = self.aim(sweep, rng)
        rays = rays_in(sweep, wedge, empty=self.takes_empty)
        attacked, depth_m = self.plan(sweep, rays, rng)
        return self.spoofer.spoof_nearest(sweep, rays, attacked, depth_m, wedge, self.budget, rng)


Plan = tuple[NDArray[np.bool_], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class Relay(WedgeAttack):
    """A sector of the scan with a constant offset in range: its objects stand elsewhere."""

    # added to each range; returns nearer than the minimum range are dropped
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
    noise_rate: Share = 0.3  # of the won beams, share that returns noise
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

    The budget is spent on random beams. Without an azimuth, the sector is random.
    """

    sector_deg: Sector = 360.0
    share: Share = 0.3  # of the beams, those that are jammed
    blind_share: Share = 0.0  # of the jammed beams, those that do not return at all
    spoofer: Spoofer = NOISELESS_SPOOFER

    takes_empty = True

    def plan(self, sweep: Sweep, rays: Rays, rng: np.random.Generator) -> Plan:
        """Return a share of the beams, with random ranges or without a return."""
        chosen = choose_random(rng.random(len(rays)) < self.share, self.budget, rng)
        depth_m = rng.uniform(*limits_m(sweep), len(rays))
        depth_m[rng.random(len(rays)) < self.blind_share] = NO_RETURN
        return chosen, depth_m
