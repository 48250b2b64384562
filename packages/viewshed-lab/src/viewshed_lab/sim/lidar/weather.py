"""Conditions: weather and faults of a measurement, and a table of named ones.

Extinction: 3 / visibility in fog (Koschmieder, 5 % contrast), 1.076 R^0.67 dB/km in rain of R mm/h (Carbonneau and
Wisely 1998), dry snow of ITU-R P.1814. Density and brightness of particles are our choice, because no real sweep with
weather was available.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from viewshed_lab._config import Between, Checked, Share, one_of


@dataclass(frozen=True, slots=True)
class Conditions(Checked):
    """Effects of air, wet surfaces and faults on a measurement; the default is a clear day and a healthy sensor.

    Raises:
        ValueError: a number is out of range.
    """

    # share of the light lost per meter of air, one way (Beer's law); 3 / visibility in fog
    extinction_per_m: Share = 0.0
    # drops or flakes per meter of beam that are strong enough to be detected close to the sensor
    particles_per_m: Annotated[float, Between(0, 100)] = 0.0
    # detection range of a particle of mean size, as a share of that of a 10 % target
    particle_reach: Annotated[float, Between(0, 1, open=True)] = 0.1
    wet: Share = 1.0  # reflectivity of the ground relative to dry ground; water reflects the light away
    noise: Annotated[float, Between(0, 100)] = 1.0  # multiplies the sensor's range noise
    missing_share: Share = 0.0  # share of beams that return nothing, in addition to the sensor's own
    mixed_share: Share = 0.2  # share of the beams at an edge that return from between the two surfaces
    lost_block_share: Share = 0.0  # share of blocks of 12 columns (packets) that are lost
    dead_ring_share: Share = 0.0  # share of rings that are dead
    dead_sector_share: Share = 0.0  # probability that one sector of the revolution is lost
    dead_sector_deg: Annotated[float, Between(0, 360, open=True)] = 30.0  # width of that sector, in degrees
    # share of beams that receive another sensor's pulse, at a random time; it counts if it arrives first
    crosstalk_share: Share = 0.0


CONDITIONS: dict[str, Conditions] = {
    "clear": Conditions(),
    "rain": Conditions(extinction_per_m=0.0012, particles_per_m=0.003, particle_reach=0.12, wet=0.5, noise=1.1),
    "heavy_rain": Conditions(extinction_per_m=0.0034, particles_per_m=0.015, particle_reach=0.12, wet=0.3, noise=1.3),
    "fog": Conditions(extinction_per_m=0.015, particles_per_m=0.04, particle_reach=0.15, wet=0.8, noise=1.2),
    "dense_fog": Conditions(extinction_per_m=0.06, particles_per_m=0.3, particle_reach=0.15, wet=0.7, noise=1.4),
    "snow": Conditions(extinction_per_m=0.0035, particles_per_m=0.02, particle_reach=0.2, wet=0.9, noise=1.2),
    "faulty": Conditions(missing_share=0.03, lost_block_share=0.01, dead_ring_share=0.02, dead_sector_share=0.2),
    "crosstalk": Conditions(crosstalk_share=0.003),
}
"""By name: rain of 10 and 50 mm/h, fog with 200 m and 50 m visibility, snow of 2 mm/h, a worn sensor, and other
sensors nearby."""


def conditions_named(name: str) -> Conditions:
    """Return the conditions called ``name``.

    Raises:
        ValueError: there are no such conditions.

    >>> conditions_named("fog").extinction_per_m
    0.015
    """
    one_of("conditions", name, CONDITIONS)
    return CONDITIONS[name]
