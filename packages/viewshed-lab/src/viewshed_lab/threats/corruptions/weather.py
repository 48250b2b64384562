"""Rain, fog and snow on a sweep that was measured in clear air, by the simulator's model of both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep
from viewshed_lab.sim.lidar.measurement import air, detection_probability, particle_reach_m
from viewshed_lab.sim.lidar.optics import Optics, optics_of
from viewshed_lab.sim.lidar.weather import Conditions
from viewshed_lab.threats.corruptions.base import at_ranges, heights_of, ranges_of

REFLECTIVITY = 0.2
"""What a surface is taken to send back: its own is not known, intensities have no common scale."""

GROUND_M = 0.2
"""Returns lower than this above local ground are the ground, which may be wet."""

NO_SENSOR = (Optics(), (0.5, 100.0))
"""Optics, and minimum and maximum range in meters, of a sweep whose sensor is not known."""

FAINT = 0.05
"""A particle is given the intensity below which this share of the sweep's returns lies."""

_WEAK = 3.0


@dataclass(frozen=True, slots=True)
class Weather:
    """Conditions of the simulator on a sweep that was measured without them.

    A return of signal s was detected, with probability F(s) = 1 / (1 + s⁻⁴); in weather its signal is s' = s · wet ·
    exp(-2 α r), and it survives with probability F(s') / F(s). Particles in the air replace a return where theirs is
    the stronger signal. Range noise grows by what s' adds to √(1 + 3 / s). All as in ``sim.lidar.measurement``;
    s = 0.2 / 0.1 · (reach / r)², as the surface's own reflectivity is not known.
    """

    conditions: Conditions  # of the simulator; shares of missing beams, dead rings and sectors are not used here

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` as it would have been in this weather; beams without a return stay without one."""
        optics, (near_m, far_m) = _sensor(sweep.model)
        range_m = np.maximum(ranges_of(sweep).astype(np.float64), 1e-3)
        kept_light, particle_m, glint = self._air(optics, far_m, range_m, rng)
        dry = REFLECTIVITY / 0.1 * (optics.reach_m / range_m) ** 2
        signal = dry * kept_light * np.where(heights_of(sweep) < GROUND_M, self.conditions.wet, 1.0)
        seen = rng.random(len(sweep)) * _detected(dry) < _detected(signal)
        hit = (particle_m > near_m) & (particle_m < range_m) & (glint > np.where(seen, signal, 0.0))
        noise = _extra_noise(dry, signal, optics.sigma_m, self.conditions.noise) * rng.standard_normal(len(sweep))
        moved = at_ranges(sweep, np.where(hit, particle_m, range_m + noise))
        return _fainter(moved, kept_light, hit).select(seen | hit)

    def _air(self, optics: Optics, far_m: float, range_m: F64, rng: np.random.Generator) -> tuple[F64, F64, F64]:
        """Return, for each return, the light that the air leaves, the range of a particle before it, and its signal.

        The range is infinite where the beam meets none that would be detected.
        """
        loss, particles = air(optics, self.conditions, far_m)
        kept_light = np.interp(range_m, np.linspace(0.0, far_m, len(loss) - 1), loss[:-1])
        luck, size = rng.random((2, len(range_m)))
        particle_m = _between(particles, luck)
        reach_m = particle_reach_m(optics, self.conditions, far_m)
        return kept_light, particle_m, 1 + size / (1 - size) * (reach_m / particle_m) ** 2


def _between(table: NDArray[np.float32], luck: F64) -> F64:
    """Return the entry at each luck (N,) in [0, 1), interpolated; infinite where the next one is."""
    position = luck * (len(table) - 1)
    low = position.astype(np.intp)
    ends = table.astype(np.float64)[np.stack([low, low + 1])]
    finite = np.isfinite(ends[1])
    range_m = np.full(len(luck), np.inf)
    range_m[finite] = ends[0][finite] + (ends[1][finite] - ends[0][finite]) * (position - low)[finite]
    return np.asarray(np.maximum(range_m, 1e-3), np.float64)


def _sensor(model: LidarModel | None) -> tuple[Optics, tuple[float, float]]:
    """Return optics, minimum and maximum range in meters; one that detects everything gets an unknown one's reach."""
    if model is None:
        return NO_SENSOR
    optics = optics_of(model)
    if np.isinf(optics.reach_m):
        optics = Optics(optics.sigma_m, NO_SENSOR[0].reach_m, optics.missing_share)
    return optics, (model.min_range_m, model.max_range_m)


def _detected(signal: F64) -> F64:
    return detection_probability(signal.astype(np.float32)).astype(np.float64)


def _extra_noise(dry: F64, signal: F64, sigma_m: float, factor: float) -> F64:
    """Return the standard deviation (N,) in meters that weather adds to the noise that is there."""
    added = factor**2 * (1 + _WEAK / np.maximum(signal, 1e-3)) - (1 + _WEAK / dry)
    return np.asarray(sigma_m * np.sqrt(np.maximum(added, 0.0)), np.float64)


def _fainter(sweep: Sweep, kept_light: F64, hit: NDArray[np.bool_]) -> Sweep:
    """Return ``sweep`` with the intensities that the air leaves, and those of particles."""
    if sweep.intensity is None or len(sweep) == 0:
        return sweep
    faint = np.quantile(sweep.intensity, FAINT)
    return sweep.replace(intensity=np.where(hit, faint, sweep.intensity * kept_light).astype(np.float32))
