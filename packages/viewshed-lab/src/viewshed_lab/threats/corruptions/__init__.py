"""Corruptions: what degrades a sweep without anybody's intent, in five severities each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from viewshed_lab.sim.lidar.weather import CONDITIONS, Conditions
from viewshed_lab.threats.corruptions.base import Corruption, InTheWorld
from viewshed_lab.threats.corruptions.distortions import Miscalibration, MotionDistortion, RangeNoise, Slope
from viewshed_lab.threats.corruptions.losses import DeadRings, DroppedBeams, DroppedSectors, FewerBeams
from viewshed_lab.threats.corruptions.surfaces import GlassPatches, Vegetation
from viewshed_lab.threats.corruptions.weather import Weather

__all__ = [
    "CORRUPTIONS", "SEVERITIES", "Corruption", "DeadRings", "DroppedBeams", "DroppedSectors", "FewerBeams",
    "GlassPatches", "InTheWorld", "Miscalibration", "MotionDistortion", "RangeNoise", "Slope", "Vegetation", "Weather",
]  # fmt: skip


def _like(name: str, extinction_per_m: float, particles_per_m: float, wet: float, noise: float) -> Conditions:
    return replace(
        CONDITIONS[name], extinction_per_m=extinction_per_m, particles_per_m=particles_per_m, wet=wet, noise=noise
    )


_RAIN = (
    _like("rain", 0.0007, 0.0015, 0.7, 1.05),
    CONDITIONS["rain"],
    _like("rain", 0.0021, 0.0075, 0.4, 1.2),
    CONDITIONS["heavy_rain"],
    _like("rain", 0.0054, 0.03, 0.25, 1.5),
)

_FOG = (
    _like("fog", 0.006, 0.01, 0.9, 1.1),
    CONDITIONS["fog"],
    _like("fog", 0.03, 0.11, 0.75, 1.3),
    CONDITIONS["dense_fog"],
    _like("fog", 0.12, 0.8, 0.65, 1.5),
)

_SNOW = (
    _like("snow", 0.0013, 0.01, 0.95, 1.1),
    CONDITIONS["snow"],
    _like("snow", 0.0058, 0.03, 0.85, 1.3),
    _like("snow", 0.0118, 0.05, 0.8, 1.4),
    _like("snow", 0.0225, 0.08, 0.75, 1.5),
)

SEVERITIES: dict[str, tuple[Corruption, ...]] = {
    "rain": tuple(map(Weather, _RAIN)),
    "fog": tuple(map(Weather, _FOG)),
    "snow": tuple(map(Weather, _SNOW)),
    "dropped_beams": tuple(map(DroppedBeams, (0.05, 0.1, 0.2, 0.4, 0.7))),
    "dropped_sectors": tuple(map(DroppedSectors, (1, 1, 1, 2, 3), (5.0, 15.0, 30.0, 30.0, 45.0))),
    "dead_rings": tuple(map(DeadRings, (0.03, 0.06, 0.12, 0.25, 0.5))),
    "fewer_beams": tuple(map(FewerBeams, (3, 1, 1, 1, 1), (4, 2, 3, 4, 8))),
    "range_noise": tuple(map(RangeNoise, (0.02, 0.05, 0.1, 0.2, 0.4))),
    "motion": tuple(map(MotionDistortion, (2.0, 5.0, 10.0, 20.0, 30.0), (2.0, 5.0, 10.0, 20.0, 40.0))),
    "attitude": tuple(map(Miscalibration, (0.5, 1.0, 1.5, 2.0, 3.0))),
    "glass": tuple(map(GlassPatches, (1, 2, 4, 8, 16), (1.0, 1.5, 2.0, 2.5, 3.0))),
    "vegetation": tuple(map(Vegetation, (2, 4, 8, 12, 20), (0.8, 1.0, 1.2, 1.5, 2.0))),
    "slope": tuple(map(Slope, (0.02, 0.04, 0.06, 0.09, 0.12), (5.0, 5.0, 5.0, 5.0, 5.0))),
}
"""By name, from severity 1 to 5; rain of 5, 10, 25, 50 and 100 mm/h, fog with 500, 200, 100, 50 and 25 m of visibility,
and snow of 1, 2, 3, 5 and 8 mm/h."""


def _of_severity(name: str, severity: int) -> Corruption:
    if isinstance(severity, bool) or severity not in (1, 2, 3, 4, 5):
        raise ValueError(f"severity must be a whole number from 1 to 5, got {severity!r}")
    return SEVERITIES[name][int(severity) - 1]


CORRUPTIONS: dict[str, Callable[[int], Corruption]] = {name: partial(_of_severity, name) for name in SEVERITIES}
"""By name: ``CORRUPTIONS[name](severity).apply(sweep, rng)``, severity from 1 to 5."""
