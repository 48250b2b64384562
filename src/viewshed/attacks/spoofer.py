"""What a laser that fires at a sensor achieves: which beams it wins and how exactly it sets their ranges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.attacks.assembly import Made, assembled, untouched
from viewshed.attacks.checks import require
from viewshed.attacks.lattice import lattice_of
from viewshed.attacks.rays import Rays, within
from viewshed.attacks.tampering import Tampered, Wedge
from viewshed.sweep import Sweep

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

RELIABILITY: dict[str, float] = {"VLP-16": 0.985, "VLP-32C": 0.83, "OS1-32": 0.44, "OS1-32 gradient": 0.44}
"""Share of the aimed beams that a spoofer wins, by the name of the sensor."""
DEFAULT_RELIABILITY = 0.985
"""The same for other sensors."""
FINGERPRINT_RELIABILITY = 0.02
"""The same for a sensor whose pulses carry a fingerprint."""
LEAVE, NO_RETURN = np.nan, np.inf
"""Wanted depths with a meaning of their own: do not touch the beam; make it return nothing."""
_MAX_RANGE_M = 100.0


@dataclass(frozen=True, slots=True)
class Spoofer:
    """A spoofer: one return for each beam that it wins.

    Attributes:
        reliability: share of the aimed beams that it wins; None takes it from ``RELIABILITY`` by the sensor's name.
        point_sigma_m: noise of each range along its ray.
        frame_sigma_m: noise that all ranges of a sweep share.
    """

    reliability: float | None = None
    point_sigma_m: float = 0.10
    frame_sigma_m: float = 0.35

    def __post_init__(self) -> None:
        if self.reliability is not None:
            require("reliability", self.reliability, 0.0, 1.0)
        require("point_sigma_m", self.point_sigma_m, 0.0, 10.0)
        require("frame_sigma_m", self.frame_sigma_m, 0.0, 10.0)

    def wins(self, sweep: Sweep, count: int, rng: np.random.Generator) -> Mask:
        """Return which of ``count`` beams are won."""
        name = "" if sweep.model is None else sweep.model.name
        share = RELIABILITY.get(name, DEFAULT_RELIABILITY) if self.reliability is None else self.reliability
        return rng.random(count) < share

    def spoof(self, sweep: Sweep, rays: Rays, wanted_m: Floats, wedge: Wedge, rng: np.random.Generator) -> Tampered:
        """Return ``sweep`` after an attempt to give the rays depths (K,) in metres, ``LEAVE`` or ``NO_RETURN``.

        A return nearer or farther than the sensor reports is none. A beam whose return would leave the wedge is left
        as it is.
        """
        aimed = np.flatnonzero(~np.isnan(wanted_m))
        aimed = aimed[self.wins(sweep, len(aimed), rng)]
        rays, depth_m = rays.select(aimed), self._noisy(sweep, wanted_m[aimed], rng)
        low_m, high_m = limits_m(sweep)
        reported = (depth_m >= low_m) & (depth_m <= high_m)
        points = rays.at(np.where(reported, depth_m, 0.0))
        stays = ~reported | within(points, wedge)
        if not stays.any():
            return untouched(sweep, wedge)
        removed = np.zeros(len(sweep), np.bool_)
        removed[rays.row[stays & (rays.row >= 0)]] = True
        kept = reported & stays
        made = Made(points[kept], rays.ring[kept], rays.column[kept], rays.row[kept])
        return assembled(sweep, removed, made, wedge, rng)

    def _noisy(self, sweep: Sweep, depth_m: Floats, rng: np.random.Generator) -> Floats:
        """Return depths (K,) with noise, in whole steps of the sensor's range where they are known."""
        noise_m = rng.normal(0.0, 1.0) * self.frame_sigma_m + rng.normal(0.0, 1.0, len(depth_m)) * self.point_sigma_m
        lattice = lattice_of(sweep)
        step_m = 0.0 if lattice is None else lattice.step_m
        noisy = depth_m + noise_m
        return np.rint(noisy / step_m) * step_m if step_m > 0 else noisy


AS_MEASURED = Spoofer()
"""What was measured on commercial sensors."""
NOISELESS = Spoofer(point_sigma_m=0.0, frame_sigma_m=0.0)
"""For ranges that are random anyway, or recorded with the noise of their own sweep."""


def limits_m(sweep: Sweep) -> tuple[float, float]:
    """Return the nearest and farthest depth in metres that the sensor reports, as far as it is known."""
    if sweep.model is not None:
        return max(sweep.model.min_range_m, 0.05), sweep.model.max_range_m
    if len(sweep) == 0:
        return 0.5, _MAX_RANGE_M
    farthest2 = float((sweep.points.astype(np.float64) ** 2).sum(axis=1).max())
    return 0.5, max(_MAX_RANGE_M, float(np.sqrt(farthest2)))


def nearest_first(rays: Rays, candidates: NDArray[Any], wedge: Wedge, budget: int | None) -> Mask:
    """Return which rays (K,) to attack: those among ``candidates`` (K,) nearest to the wedge's middle, in azimuth."""
    if budget is None or int(candidates.sum()) <= budget:
        return np.asarray(candidates, np.bool_)
    azimuth = np.arctan2(rays.direction[:, 1], rays.direction[:, 0])
    apart = np.abs((azimuth - wedge.azimuth + np.pi) % (2 * np.pi) - np.pi)
    among = np.flatnonzero(candidates)
    chosen = np.zeros(len(rays), np.bool_)
    chosen[among[np.argsort(apart[among], kind="stable")[:budget]]] = True
    return chosen


def some_of(candidates: Mask, budget: int | None, rng: np.random.Generator) -> Mask:
    """Return which rays (K,) to attack: at most ``budget`` of ``candidates`` (K,), drawn at random."""
    among = np.flatnonzero(candidates)
    chosen = np.zeros(len(candidates), np.bool_)
    chosen[rng.permutation(among)[: len(among) if budget is None else budget]] = True
    return chosen
