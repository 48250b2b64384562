"""From the exact stops of a scan to what a sensor would have stored: noise, weak returns, weather and faults."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.sensors import LidarModel
from viewshed.sim.materials import REFLECTIVITY
from viewshed.sim.measure_kernels import measured
from viewshed.sim.optics import Optics, optics_of, step_of
from viewshed.sim.range_image import RangeImage
from viewshed.sim.scan import Scan
from viewshed.sim.weather import Conditions

ROUGHNESS = 0.2
"""Slope of the facets of a surface, radians (Oren & Nayar 1994): why a road is seen at grazing incidence."""
STEEPNESS = 4.0
"""A signal s, in units of the threshold, is detected with probability 1 / (1 + s ** -STEEPNESS)."""
BLOCK_COLUMNS = 12
"""Columns that travel in one packet."""
_LUCK = 4096
_AIR = 1024
_ENDLESS_M = 1e6

Floats = NDArray[np.float32]


def measure(
    scan: Scan,
    conditions: Conditions,
    rng: np.random.Generator,
    *,
    sensor_height_m: float | None = None,
    t_ns: int | None = None,
    agent: str = "ego",
) -> RangeImage:
    """Return what the sensor of ``scan`` stores under ``conditions``: (C, R) whole steps of range, and intensity.

    The signal of a beam is that of the LiDAR equation for a surface that fills it,
    s = ρ f(θ) / 0.1 · (reach / r)² · exp(-2 α r), with f of Oren & Nayar (1994) towards the source; it is detected with
    probability 1 / (1 + s⁻⁴). Range noise is σ √(1 + 3 / s). Particles in the air are met at random before the surface
    and win where their signal is the stronger one.

    Args:
        scan: exact stops of the beams.
        conditions: weather and faults.
        rng: gives one seed; the same state gives the same image.
        sensor_height_m: above the ground below, if it is known.
        t_ns: time of the reference pose.
        agent: who measures.
    """
    model, optics = scan.model, optics_of(scan.model)
    seed = rng.integers(2**63, dtype=np.uint64)
    shape = scan.depth_m.shape
    steps, intensity = np.zeros(shape, np.uint16), np.zeros(shape, np.uint8)
    step_m = step_of(model)
    measured(
        (scan.depth_m, scan.cos_incidence, scan.material, scan.thing),
        (REFLECTIVITY, _facing(), _thresholds(), *air(optics, conditions, model.max_range_m)),
        _alive(model, conditions, int(seed)),
        _numbers(model, optics, conditions, step_m),
        seed,
        (steps, intensity),
    )
    return RangeImage(
        model=model, steps=steps, intensity=intensity, step_m=step_m, world_from_sensor=scan.world_from_sensor,
        motion=scan.motion, sensor_height_m=sensor_height_m, t_ns=t_ns, agent=agent,
    )  # fmt: skip


def detection_probability(signal: Floats) -> Floats:
    """Return the probability (same shape) that a signal is detected; 1 is the threshold, seen every second time.

    >>> detection_probability(np.array([1.0, 2.0], np.float32)).round(2).tolist()
    [0.5, 0.9399999976158142]
    """
    return (1.0 / (1.0 + np.maximum(signal, 1e-6) ** -STEEPNESS)).astype(np.float32)


def _numbers(model: LidarModel, optics: Optics, conditions: Conditions, step_m: float) -> tuple[np.float32, ...]:
    missing = 1 - (1 - optics.missing_share) * (1 - conditions.missing_share)
    particle_m = particle_reach_m(optics, conditions, model.max_range_m) if conditions.particles_per_m > 0 else 0.0
    numbers = (
        min(optics.reach_m, _ENDLESS_M) ** 2 / 0.1, optics.sigma_m * conditions.noise, 1 / step_m, conditions.wet,
        65536 * missing, 65536 * conditions.mixed_share, model.min_range_m, model.max_range_m, particle_m**2,
    )  # fmt: skip
    return tuple(np.float32(number) for number in numbers)


@lru_cache(maxsize=1)
def _facing() -> tuple[np.float32, np.float32]:
    """Return a and b of the light sent back, a cos θ + b sin² θ, 1 at normal incidence (Oren & Nayar 1994, eq. 30).

    With source and receiver in one place their sin α tan β is sin² θ / cos θ, which the cosine of the incident light
    cancels.
    """
    variance = ROUGHNESS**2
    a = 1 - 0.5 * variance / (variance + 0.33)
    b = 0.45 * variance / (variance + 0.09)
    return np.float32(1.0), np.float32(b / a)


@lru_cache(maxsize=1)
def _thresholds() -> Floats:
    """Return (4096,) float32: the signal that is just detected, by luck from 0 to 1."""
    luck = (np.arange(_LUCK) + 0.5) / _LUCK
    return ((luck / (1 - luck)) ** (1 / STEEPNESS)).astype(np.float32)


@lru_cache(maxsize=64)
def air(optics: Optics, conditions: Conditions, max_range_m: float) -> tuple[Floats, Floats]:
    """Return the share of light that comes back through the air by range, and the range of a particle by luck.

    Particles that are detected are met at a rate of n exp(-(r / reach)² exp(2 α r)) a metre: sizes are exponential and
    the signal of each falls as that of a point that fills part of the beam.
    """
    range_m = np.linspace(0.0, max_range_m, _AIR)
    loss = np.exp(-2 * conditions.extinction_per_m * range_m)
    reach_m = particle_reach_m(optics, conditions, max_range_m)
    with np.errstate(over="ignore", under="ignore"):
        rate = conditions.particles_per_m * np.exp(-((range_m / reach_m) ** 2) / np.maximum(loss, 1e-30))
    met = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(range_m))])
    wanted = -np.log1p(-np.arange(_LUCK) / _LUCK)
    particle = np.interp(wanted, met, range_m)
    particle[wanted >= met[-1]] = np.inf
    return np.append(loss, loss[-1]).astype(np.float32), np.append(particle, np.inf).astype(np.float32)


def particle_reach_m(optics: Optics, conditions: Conditions, max_range_m: float) -> float:
    """Return the range in metres at which a particle of mean size is only just detected."""
    return conditions.particle_reach * min(optics.reach_m, max_range_m)


def _alive(model: LidarModel, conditions: Conditions, seed: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which columns (C,) and rings (R,) work."""
    columns, rings = np.ones(model.azimuth_columns, np.bool_), np.ones(model.rings, np.bool_)
    if not (conditions.lost_block_share or conditions.dead_ring_share or conditions.dead_sector_share):
        return columns, rings
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed])))
    blocks = rng.random(-(-len(columns) // BLOCK_COLUMNS)) >= conditions.lost_block_share
    columns &= np.repeat(blocks, BLOCK_COLUMNS)[: len(columns)]
    rings &= rng.random(len(rings)) >= conditions.dead_ring_share
    if rng.random() < conditions.dead_sector_share:
        first, width = rng.integers(len(columns)), round(len(columns) * conditions.dead_sector_deg / 360)
        columns[(first + np.arange(width)) % len(columns)] = False
    return columns, rings
