"""Simulate the measurement of an exact scan: noise, weak returns, weather and faults.

Random numbers are hashes of a seed and the beam's number (SplitMix64: Steele, Lea & Flood 2014), so they do not depend
on other beams. Hashing and rounding to range steps are integer arithmetic, equal on every machine.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.sensors import LidarModel
from viewshed_lab.sim.assets.shapes import GLINT, GLOSS, REFLECTIVITY
from viewshed_lab.sim.lidar.optics import Optics, optics_of, step_of
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep
from viewshed_lab.sim.lidar.weather import Conditions
from viewshed_lab.sim.raycast.scan import ExactScan

ROUGHNESS = 0.2
"""Slope of the facets of a surface, radians (Oren & Nayar 1994); makes roads visible at grazing incidence."""

STEEPNESS = 4.0
"""A signal s, in units of the threshold, is detected with probability 1 / (1 + s ** -STEEPNESS)."""

BLOCK_COLUMNS = 12
"""Columns per packet."""

_QUANTILES = 4096
"""Rows of the quantile tables."""

_AIR = 1024
"""Rows of the table of air by range, less one."""

_ENDLESS_M = 1e6
"""Reach of a sensor that detects everything."""

# SplitMix64's multipliers, and the shifts that split a hash into four 16-bit numbers.
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_A = np.uint64(0xBF58476D1CE4E5B9)
_MIX_B = np.uint64(0x94D049BB133111EB)
_LOW = np.uint64(0xFFFF)
_S16, _S27, _S30, _S31, _S32, _S48 = (np.uint64(shift) for shift in (16, 27, 30, 31, 32, 48))

_NORMAL = np.float32(1.0 / np.sqrt(4.0 * (65536.0**2 - 1.0) / 12.0))
"""1 / standard deviation of a sum of four uniform integers below 65536."""

_WEAK = np.float32(3.0)
"""A return of signal s has the noise σ √(1 + 3 / s)."""

_MIXED_GAP_M = (np.float32(0.15), np.float32(2.0))
"""Smallest and largest gap at an edge across which a beam may return from between the two surfaces."""

_PER_GLINT2 = np.float32(2.0 / GLINT**2)

_PARTICLE_SHINE = np.float32(0.03)
"""Share of light that a particle reflects, for its intensity."""

_GROUND = -1


class Surfaces(NamedTuple):
    """Exact hits of the beams, (C, R) each, as in :class:`viewshed_lab.sim.raycast.scan.ExactScan`."""

    depth: F32
    cosine: F32
    material: NDArray[np.uint8]
    thing: NDArray[np.int32]


class Tables(NamedTuple):
    """Lookup tables of the measurement loop."""

    reflectivity: F32  # by material
    gloss: F32  # specular reflectivity, by material
    facing: tuple[np.float32, np.float32]  # factors of the cosine and of the squared sine of incidence
    threshold: F32  # smallest detected signal, by quantile
    air: F32  # share of light that returns through the air, by range
    particle: F32  # range of the nearest particle in meters, by quantile


class Numbers(NamedTuple):
    """Sensor and conditions as float32."""

    reach2: np.float32  # squared range at which a surface of reflectivity 1 gives a signal of 1
    sigma: np.float32  # range noise of a strong return, meters
    per_step: np.float32  # range steps per meter
    wet: np.float32  # reflectivity of the ground relative to dry ground
    missing: np.float32  # beams out of 65536 that return nothing without a visible reason
    mixed: np.float32  # beams at an edge, out of 65536, that return from between the two surfaces
    near: np.float32  # minimum range in meters
    far: np.float32  # maximum range in meters
    particle2: np.float32  # squared detection range of a particle of mean size; 0 without particles


def measure(
    scan: ExactScan,
    conditions: Conditions,
    rng: np.random.Generator,
    *,
    sensor_height_m: float | None = None,
    t_ns: int | None = None,
    agent: str = "ego",
) -> StoredSweep:
    """Simulate the measurement of a scan under ``conditions``; return range steps and intensities (C, R).

    The signal of a beam follows the LiDAR equation for a surface that fills it,
    s = ρ f(θ) / 0.1 · (reach / r)² · exp(-2 α r), with f of Oren & Nayar (1994) towards the source; it is detected with
    probability 1 / (1 + s⁻⁴). Range noise is σ √(1 + 3 / s). A random particle in front of the surface replaces the
    return if its signal is stronger. A pulse of another sensor, at a random time, replaces the return if it is first.

    Args:
        scan: exact hits of the beams.
        conditions: weather and faults.
        rng: provides one seed; the same state gives the same image.
        sensor_height_m: above the ground below, if known.
        t_ns: time of the reference pose.
        agent: name of the measuring agent.
    """
    model, optics = scan.model, optics_of(scan.model)
    seed = rng.integers(2**63, dtype=np.uint64)
    shape = scan.depth_m.shape
    steps, intensity = np.zeros(shape, np.uint16), np.zeros(shape, np.uint8)
    step_m = step_of(model)
    columns_alive, rings_alive = _alive(model, conditions, int(seed))
    measure_beams(
        Surfaces(scan.depth_m, scan.cos_incidence, scan.material, scan.thing),
        Tables(REFLECTIVITY, GLOSS, _facing(), _thresholds(), *air(optics, conditions, model.max_range_m)),
        columns_alive,
        rings_alive,
        _numbers(model, optics, conditions, step_m),
        seed,
        steps,
        intensity,
    )
    if conditions.crosstalk_share > 0.0:
        _add_crosstalk(model, conditions, int(seed), steps, intensity)
        steps[~columns_alive], steps[:, ~rings_alive] = 0, 0
    if model.fired is not None:  # a shot that was not fired has no return from particles either
        steps[~model.fired], intensity[~model.fired] = 0, 0
    return StoredSweep(
        model=model, steps=steps, intensity=intensity, step_m=step_m, world_from_sensor=scan.world_from_sensor,
        motion=scan.motion, sensor_height_m=sensor_height_m, t_ns=t_ns, agent=agent,
    )  # fmt: skip


def detection_probability(signal: F32) -> F32:
    """Return the detection probability (same shape) of a signal; 0.5 at a signal of 1.

    >>> detection_probability(np.array([1.0, 2.0], np.float32)).round(2).tolist()
    [0.5, 0.9399999976158142]
    """
    return (1.0 / (1.0 + np.maximum(signal, 1e-6) ** -STEEPNESS)).astype(np.float32)


def _numbers(model: LidarModel, optics: Optics, conditions: Conditions, step_m: float) -> Numbers:
    missing = 1 - (1 - optics.missing_share) * (1 - conditions.missing_share)
    particle_m = particle_reach_m(optics, conditions, model.max_range_m) if conditions.particles_per_m > 0 else 0.0
    numbers = (
        min(optics.reach_m, _ENDLESS_M) ** 2 / 0.1, optics.sigma_m * conditions.noise, 1 / step_m, conditions.wet,
        65536 * missing, 65536 * conditions.mixed_share, model.min_range_m, model.max_range_m, particle_m**2,
    )  # fmt: skip
    return Numbers(*(np.float32(number) for number in numbers))


@lru_cache(maxsize=1)
def _facing() -> tuple[np.float32, np.float32]:
    """Return a and b of the reflected light a cos θ + b sin² θ, 1 at normal incidence (Oren & Nayar 1994, eq. 30).

    With source and receiver at the same position, sin α tan β is sin² θ / cos θ; the cosine of the incident light
    cancels the denominator.
    """
    variance = ROUGHNESS**2
    a = 1 - 0.5 * variance / (variance + 0.33)
    b = 0.45 * variance / (variance + 0.09)
    return np.float32(1.0), np.float32(b / a)


@lru_cache(maxsize=1)
def _thresholds() -> F32:
    """Return the quantiles (4096,) float32 of the smallest detected signal."""
    quantile = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    return ((quantile / (1 - quantile)) ** (1 / STEEPNESS)).astype(np.float32)


@lru_cache(maxsize=64)
def air(optics: Optics, conditions: Conditions, max_range_m: float) -> tuple[F32, F32]:
    """Return the share of light that returns through the air, by range, and the quantiles of the particle range.

    Detected particles have a rate of n exp(-(r / reach)² exp(2 α r)) per meter: their sizes are exponentially
    distributed, and their signal falls like that of a point that fills part of the beam.
    """
    range_m = np.linspace(0.0, max_range_m, _AIR)
    loss = np.exp(-2 * conditions.extinction_per_m * range_m)
    reach_m = particle_reach_m(optics, conditions, max_range_m)
    with np.errstate(over="ignore", under="ignore"):
        rate = conditions.particles_per_m * np.exp(-((range_m / reach_m) ** 2) / np.maximum(loss, 1e-30))
    cumulative = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(range_m))])
    quantiles = -np.log1p(-np.arange(_QUANTILES) / _QUANTILES)
    particle = np.interp(quantiles, cumulative, range_m)
    particle[quantiles >= cumulative[-1]] = np.inf
    return np.append(loss, loss[-1]).astype(np.float32), np.append(particle, np.inf).astype(np.float32)


def particle_reach_m(optics: Optics, conditions: Conditions, max_range_m: float) -> float:
    """Return the detection range of a particle of mean size, meters."""
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


def _add_crosstalk(
    model: LidarModel, conditions: Conditions, seed: int, steps: NDArray[np.uint16], intensity: NDArray[np.uint8]
) -> None:
    """Replace returns of an image (C, R) by pulses of other sensors that arrive first."""
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, 1])))
    count = rng.binomial(steps.size, conditions.crosstalk_share)
    beams = rng.choice(steps.size, count, replace=False)
    range_m = rng.uniform(model.min_range_m, model.max_range_m, count)
    pulse, own = np.maximum(range_m / step_of(model), 1.0).astype(np.uint16), steps.reshape(-1)[beams]
    first = (own == 0) | (pulse < own)
    steps.reshape(-1)[beams[first]] = pulse[first]
    intensity.reshape(-1)[beams[first]] = rng.integers(1, 100, int(first.sum()))


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _hash(seed: Any, number: Any) -> Any:
    """Return 64 well-mixed bits for a beam's number."""
    z = seed + (number + np.uint64(1)) * _GOLDEN
    z = (z ^ (z >> _S30)) * _MIX_A
    z = (z ^ (z >> _S27)) * _MIX_B
    return z ^ (z >> _S31)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _normal(bits: Any) -> Any:
    """Sum of four uniform numbers: nearly normal, with tails that end at 3.5 standard deviations."""
    total = (bits & _LOW) + ((bits >> _S16) & _LOW) + ((bits >> _S32) & _LOW) + (bits >> _S48)
    return np.float32(np.int64(total) - 131070) * _NORMAL


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _lookup(table: Any, row: Any) -> Any:
    """Interpolate between entries; +inf where the next one is."""
    k = np.int32(row)
    return table[k] + (table[k + 1] - table[k]) * (row - np.float32(k))


@njit(cache=True, nogil=True, error_model="numpy")
def measure_beams(
    surfaces: Any,
    tables: Any,
    columns_alive: Any,
    rings_alive: Any,
    numbers: Any,
    seed: Any,
    steps: Any,
    intensity: Any,
) -> None:
    """Fill steps (C, R) uint16 and intensity (C, R) uint8, both initially 0, in one pass over the beams.

    ``surfaces``, ``tables`` and ``numbers`` are the named tuples above; dead columns (C,) and rings (R,) return
    nothing; ``seed`` is a uint64. One hash per beam (``luck``) gives four 16-bit numbers: whether it is missing, the
    quantile of the detection threshold, the quantile of the particle range, and the speckle of its intensity.
    """
    depth = surfaces.depth
    columns, rings = depth.shape
    for c in range(columns):
        after = c + 1 if c + 1 < columns else 0
        for r in range(rings):
            number = np.uint64(c * rings + r)
            luck = _hash(seed, number)
            if not (columns_alive[c] and rings_alive[r]) or np.float32(luck & _LOW) < numbers.missing:
                continue
            # The signal of the surface, or of a particle in front of it with a stronger signal.
            d = depth[c, r]
            signal, shine = _surface(surfaces, c, r, tables, numbers, luck)
            if numbers.particle2 > 0:
                extra = _hash(seed ^ _MIX_A, number)
                d, signal, shine = _particle(d, signal, shine, tables.particle, numbers, luck, extra)
            if signal <= 0:
                continue
            # The range: at an edge possibly between two surfaces, with noise, in range steps.
            if numbers.mixed > 0:
                d += _mix_at_edge(depth[after, r] - d, numbers.mixed, seed ^ _GOLDEN, number)
            noise = _normal(_hash(seed ^ _MIX_B, number))
            d += numbers.sigma * np.sqrt(np.float32(1.0) + _WEAK / signal) * noise
            if numbers.near <= d <= numbers.far:
                steps[c, r] = np.uint16(d * numbers.per_step + np.float32(0.5))
                intensity[c, r] = _intensity(shine, np.float32(luck >> _S48))


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _surface(surfaces: Any, c: Any, r: Any, tables: Any, numbers: Any, luck: Any) -> Any:
    """Return the signal of the surface, 0 if it is not detected, and the share of light that it reflects."""
    d, cos, far = surfaces.depth[c, r], surfaces.cosine[c, r], numbers.far
    if not np.float32(0.0) < d < far:
        return np.float32(0.0), np.float32(0.0)
    facing = tables.facing[0] * cos + tables.facing[1] * (np.float32(1.0) - cos * cos)
    shine = tables.reflectivity[surfaces.material[c, r]] * facing
    gloss = tables.gloss[surfaces.material[c, r]]
    if gloss > np.float32(0.0):  # the mirror image: a lobe in the angle of incidence, θ² = 2 (1 - cos θ)
        shine += gloss * np.exp(_PER_GLINT2 * (cos - np.float32(1.0)))
    if surfaces.thing[c, r] == _GROUND:
        shine *= numbers.wet
    # The LiDAR equation, in units of the threshold.
    air = _lookup(tables.air, d * (np.float32(len(tables.air) - 2) / far))
    signal = shine * air * numbers.reach2 / (d * d)
    row = np.float32((luck >> _S16) & _LOW) * (np.float32(len(tables.threshold)) / np.float32(65536.0))
    return signal if signal >= tables.threshold[np.int32(row)] else np.float32(0.0), shine


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _particle(d: Any, signal: Any, shine: Any, ranges: Any, numbers: Any, luck: Any, extra: Any) -> Any:
    """Return range, signal and shine of the particle in front of the surface if it is stronger, else of the surface."""
    p = _lookup(ranges, np.float32((luck >> _S32) & _LOW) * np.float32(1 / 16))
    if numbers.near < p < d:
        glint = _glint(p, numbers.particle2, extra)
        if glint > signal:
            return p, glint, _PARTICLE_SHINE
    return d, signal, shine


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _mix_at_edge(gap: Any, share: Any, seed: Any, number: Any) -> Any:
    """Return how far a return at an edge is shifted towards the next surface."""
    if _MIXED_GAP_M[0] < abs(gap) < _MIXED_GAP_M[1]:
        chance = _hash(seed, number)
        if np.float32(chance & _LOW) < share:
            return gap * np.float32(chance >> _S48) * np.float32(1 / 65536)
    return np.float32(0.0)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _glint(range_m: Any, particle2: Any, bits: Any) -> Any:
    """Return the signal of a detected particle: sizes are exponential, so their excess over the threshold is, too."""
    spare = np.float32((bits & _LOW) + np.uint64(1)) * np.float32(1 / 65536)
    extra = (np.float32(1.0) - spare) / spare
    return np.float32(1.0) + extra * particle2 / (range_m * range_m)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _intensity(shine: Any, luck: Any) -> Any:
    """Return the intensity, calibrated like Velodyne's: diffuse 0 to 100 %, retroreflectors to 255; ±30 % speckle."""
    value = shine * (np.float32(0.7) + luck * np.float32(0.6 / 65536))
    level = value * np.float32(100) if value <= 1 else np.float32(100) + (value - np.float32(1)) * np.float32(60)
    return np.uint8(min(max(level + np.float32(0.5), np.float32(1)), np.float32(255)))
