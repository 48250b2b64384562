"""Where an attack gains most: which ground the obstacles of the sweep itself hide, and where a wedge would open it.

An attacker who sees the same scene can know this. Neither the truth nor what the victim estimates has a say.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.fov.visibility import CAR
from viewshed.sweep import Sweep
from viewshed_lab.threats.attacks.beam_lattice import rays_in
from viewshed_lab.threats.attacks.spoofer import FULL_CIRCLE, is_obstacle, level_rays, scene_of

Placement = Literal["random", "behind_nearest_obstacle", "largest_hidden_area"]
"""At a near obstacle drawn at random; where the nearest obstacle hides the most ground; where the wedge opens most."""

BINS = 360
"""Bins of azimuth in which hidden ground is looked for."""

_RANGES = 64
"""Steps of range up to the end of the attacker's reach."""

_ONE_OBSTACLE_M = 1.0
"""Obstacles of neighboring bins whose nearest ranges differ by no more belong together."""


_MUCH = 0.5
"""Share of the largest hidden area of any bin from which on an obstacle hides much."""


@dataclass(frozen=True, slots=True, eq=False)
class HiddenGround:
    """What near obstacles hide, by bins of azimuth in the sensor's frame, the first from -π on."""

    area_m2: F64  # (BINS,) float64 ground behind them at which beams aim and which none reaches
    # (BINS,) float64 horizontal range of the nearest one, infinite where they hide little: less than half of what they
    # hide in the bin where they hide most. A post is no place to hide behind.
    nearest_m: F64
    beams: NDArray[np.int64]  # (BINS,) int64 returns from them, which an attacker must move to open it

    def opened_m2(self, sector_deg: float, budget: int | None = None) -> F64:
        """Return the hidden area (BINS,) in m² that a wedge about the middle of each bin opens.

        A budget is spent from the middle outward; where it ends, it opens its share of the bin.
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
        """Return the bin in which the nearest obstacle that hides much hides the most ground."""
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
    """Return where a wedge is centered, radians in the sensor's frame; None where no near obstacle hides any ground.

    Args:
        placement: one that is not ``random``.
        sweep: the clean one.
        sector_deg: width of the wedge.
        budget: most returns, None for all of the wedge.
        near_m: obstacles nearer than this can be made to disappear.
        reach_m: ground up to here can be opened, at most to the edge of the scene.
    """
    hidden = hidden_ground_of(sweep, near_m, min(reach_m, scene_of(sweep).ground.half_extent_m))
    if not hidden.area_m2.any():
        return None
    best = hidden.behind_nearest()
    if placement == "largest_hidden_area":
        best = int(np.argmax(hidden.opened_m2(sector_deg, budget)))
    return float(azimuth_of_bin(best))


def azimuth_of_bin(number: Any) -> Any:
    """Return the middle of a bin, in radians."""
    return (number + 0.5) * (2 * np.pi / BINS) - np.pi


@lru_cache(maxsize=4)
def hidden_ground_of(sweep: Sweep, near_m: float, reach_m: float) -> HiddenGround:
    """Return the ground up to ``reach_m`` that obstacles nearer than ``near_m`` hide, by the returns of ``sweep``.

    A beam aims at a place where a car of 1.5 m would meet it, on the ground there, and reaches it if it returned from
    no nearer.
    """
    rays = rays_in(sweep, FULL_CIRCLE)
    start, direction = level_rays(sweep, rays)
    flat = np.maximum(np.hypot(direction[:, 0], direction[:, 1]), 1e-6)
    range_m, slope = rays.depth_m * flat, direction[:, 2] / flat
    azimuth = np.arctan2(rays.direction[:, 1], rays.direction[:, 0])
    bins = np.clip(((azimuth + np.pi) * (BINS / (2 * np.pi))).astype(np.intp), 0, BINS - 1)
    blocks = is_obstacle(sweep, rays) & (rays.depth_m < near_m)
    # The ground along the middle of each bin.
    step_m, scene, middle = reach_m / _RANGES, scene_of(sweep), azimuth_of_bin(np.arange(BINS))
    ranges = (np.arange(_RANGES) + 0.5) * step_m
    ahead = np.stack([np.cos(middle), np.sin(middle), np.zeros(BINS)], axis=1) @ scene.level_from_sensor.rotation.T
    ground = scene.ground.at((ranges[:, None, None] * ahead[:, :2]).reshape(-1, 2)).reshape(_RANGES, BINS)
    # Step by step outward: in which bins beams aim at the ground there, and an obstacle keeps all of them from it.
    hidden = np.zeros((_RANGES, BINS), np.bool_)
    for k, at_m in enumerate(ranges):
        height = start[:, 2] + at_m * slope - ground[k, bins]
        aims = (height >= 0.0) & (height <= CAR.height_m)
        reached = np.bincount(bins[aims & (range_m >= at_m - step_m / 2)], minlength=BINS)
        hidden[k] = (np.bincount(bins[aims & blocks], minlength=BINS) > 0) & (reached == 0)
    area_m2 = (hidden * (ranges * step_m * (2 * np.pi / BINS))[:, None]).sum(axis=0)
    nearest_m = np.full(BINS, np.inf)
    np.minimum.at(nearest_m, bins[blocks], range_m[blocks])
    nearest_m[area_m2 < _MUCH * area_m2.max()] = np.inf
    return HiddenGround(area_m2, nearest_m, np.bincount(bins[blocks], minlength=BINS))
