"""Compiled loop of :mod:`viewshed.sim.measure`: one pass over the beams of a revolution.

Random numbers are hashes of a seed and the beam's number (SplitMix64: Steele, Lea & Flood 2014), so that a beam's luck
does not depend on the others. They and the rounding to whole steps are integer arithmetic, equal on every machine.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_A = np.uint64(0xBF58476D1CE4E5B9)
_MIX_B = np.uint64(0x94D049BB133111EB)
_LOW = np.uint64(0xFFFF)
_S16, _S27, _S30, _S31, _S32, _S48 = (np.uint64(shift) for shift in (16, 27, 30, 31, 32, 48))
_NORMAL = np.float32(1.0 / np.sqrt(4.0 * (65536.0**2 - 1.0) / 12.0))
_TENTH = np.float32(0.1)
_WEAK = np.float32(3.0)
_MIXED_GAP_M = (np.float32(0.15), np.float32(2.0))
_PARTICLE_SHINE = np.float32(0.03)
_GROUND = -1


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _hash(seed: Any, number: Any) -> Any:  # pragma: no cover - compiled
    z = seed + (number + np.uint64(1)) * _GOLDEN
    z = (z ^ (z >> _S30)) * _MIX_A
    z = (z ^ (z >> _S27)) * _MIX_B
    return z ^ (z >> _S31)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _normal(bits: Any) -> Any:  # pragma: no cover - compiled
    """Sum of four uniform numbers: normal but for tails that end at 3.5 standard deviations."""
    total = (bits & _LOW) + ((bits >> _S16) & _LOW) + ((bits >> _S32) & _LOW) + (bits >> _S48)
    return np.float32(np.int64(total) - 131070) * _NORMAL


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _lookup(table: Any, place: Any) -> Any:  # pragma: no cover - compiled
    """Interpolate between entries; +inf where the next one is."""
    k = np.int32(place)
    return table[k] + (table[k + 1] - table[k]) * (place - np.float32(k))


@njit(cache=True, nogil=True, error_model="numpy")
def measured(
    surface: Any, tables: Any, alive: Any, numbers: Any, seed: Any, out: Any
) -> None:  # pragma: no cover - compiled
    """Fill ``out``: steps (C, R) uint16 and intensity (C, R) uint8, both 0 before.

    Args:
        surface: depth, cosine of incidence, material and thing of every beam, (C, R) each.
        tables: reflectivity by material; factors of the cosine and of the squared sine of incidence; thresholds of
            the signal by luck; share of light that returns through the air by range; ranges of particles by luck.
        alive: (C,) and (R,) bool.
        numbers: float32 as :func:`viewshed.sim.measure.measure` packs them.
        seed: uint64.
        out: see above.
    """
    depth = surface[0]
    reach2, sigma, per_step, wet, missing, mixed, near, far, particle2 = numbers
    columns, rings = depth.shape
    for c in range(columns):
        after = c + 1 if c + 1 < columns else 0
        for r in range(rings):
            number = np.uint64(c * rings + r)
            luck = _hash(seed, number)
            if not (alive[0][c] and alive[1][r]) or np.float32(luck & _LOW) < missing:
                continue
            d = depth[c, r]
            signal, shine = _surface(surface, c, r, tables, (reach2, wet, far), luck)
            if particle2 > 0:
                extra = _hash(seed ^ _MIX_A, number)
                d, signal, shine = _particle(d, signal, shine, tables[4], (near, particle2), (luck, extra))
            if signal <= 0:
                continue
            if mixed > 0:
                d += _mixed(depth[after, r] - d, mixed, seed ^ _GOLDEN, number)
            d += sigma * np.sqrt(np.float32(1.0) + _WEAK / signal) * _normal(_hash(seed ^ _MIX_B, number))
            if near <= d <= far:
                out[0][c, r] = np.uint16(d * per_step + np.float32(0.5))
                out[1][c, r] = _intensity(shine, np.float32(luck >> _S48))


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _surface(surface: Any, c: Any, r: Any, tables: Any, numbers: Any, luck: Any) -> Any:  # pragma: no cover - compiled
    """Signal of the surface, 0 where it is missed, and the share of light it sends back."""
    depth, cosine, material, thing = surface
    reflectivity, facing, threshold, air, _ = tables
    reach2, wet, far = numbers
    d, cos = depth[c, r], cosine[c, r]
    if not np.float32(0.0) < d < far:
        return np.float32(0.0), np.float32(0.0)
    shine = reflectivity[material[c, r]] * (facing[0] * cos + facing[1] * (np.float32(1.0) - cos * cos))
    if thing[c, r] == _GROUND:
        shine *= wet
    signal = shine * _lookup(air, d * (np.float32(len(air) - 2) / far)) * reach2 / (d * d)
    place = np.float32((luck >> _S16) & _LOW) * (np.float32(len(threshold)) / np.float32(65536.0))
    return signal if signal >= threshold[np.int32(place)] else np.float32(0.0), shine


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _particle(
    d: Any, signal: Any, shine: Any, ranges: Any, numbers: Any, bits: Any
) -> Any:  # pragma: no cover - compiled
    """Range, signal and shine of the particle before the surface where it outshines it, else of the surface."""
    near, particle2 = numbers
    p = _lookup(ranges, np.float32((bits[0] >> _S32) & _LOW) * np.float32(1 / 16))
    if near < p < d:
        glint = _glint(p, particle2, bits[1])
        if glint > signal:
            return p, glint, _PARTICLE_SHINE
    return d, signal, shine


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _mixed(gap: Any, share: Any, seed: Any, number: Any) -> Any:  # pragma: no cover - compiled
    """How far a return at an edge lies towards the next surface."""
    if _MIXED_GAP_M[0] < abs(gap) < _MIXED_GAP_M[1]:
        chance = _hash(seed, number)
        if np.float32(chance & _LOW) < share:
            return gap * np.float32(chance >> _S48) * np.float32(1 / 65536)
    return np.float32(0.0)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _glint(range_m: Any, particle2: Any, bits: Any) -> Any:  # pragma: no cover - compiled
    """Signal of a particle that is detected: sizes are exponential, so what exceeds the threshold is, too."""
    spare = np.float32((bits & _LOW) + np.uint64(1)) * np.float32(1 / 65536)
    extra = (np.float32(1.0) - spare) / spare
    return np.float32(1.0) + extra * particle2 / (range_m * range_m)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _intensity(shine: Any, luck: Any) -> Any:  # pragma: no cover - compiled
    """Calibrated as Velodyne's: 0 to 100 % diffuse is 0 to 100, retroreflectors go up to 255; ±30 % speckle."""
    value = shine * (np.float32(0.7) + luck * np.float32(0.6 / 65536))
    level = value * np.float32(100) if value <= 1 else np.float32(100) + (value - np.float32(1)) * np.float32(60)
    return np.uint8(min(max(level + np.float32(0.5), np.float32(1)), np.float32(255)))
