"""Conditions: weather and faults that a measurement suffers, and the table of those with a name.

Extinction: 3 / visibility in fog (Koschmieder, 5 % contrast), 1.076 R^0.67 dB/km in rain of R mm/h (Carbonneau and
Wisely 1998), dry snow of ITU-R P.1814. How many particles there are and how strongly they return is our choice, as no
real sweep at hand shows weather.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from viewshed_lab._config import Between, Checked, Share, one_of


@dataclass(frozen=True, slots=True)
class Conditions(Checked):
    """What air, surfaces and faults do to a measurement; the default is a clear day and a healthy sensor.

    Raises:
        ValueError: a number is out of range.
    """

    # share of the light lost a meter of air, one way (Beer's law); 3 / visibility in fog
    extinction_per_m: Share = 0.0
    # drops or flakes a meter of beam that are strong enough to be detected close to the sensor
    particles_per_m: Annotated[float, Between(0, 100)] = 0.0
    # range at which a particle of mean size is only just detected, as a share of the range at which the sensor detects
    # a 10 % target
    particle_reach: Annotated[float, Between(0, 1, open=True)] = 0.1
    wet: Share = 1.0  # reflectivity of the ground as a share of that when dry; water mirrors the light away
    noise: Annotated[float, Between(0, 100)] = 1.0  # multiplies the sensor's range noise
    missing_share: Share = 0.0  # beams that return nothing, beyond the sensor's own share
    mixed_share: Share = 0.2  # share of the beams at an edge that return from between the two surfaces
    lost_block_share: Share = 0.0  # share of the blocks of 12 columns (a packet) that are lost
    dead_ring_share: Share = 0.0  # share of the rings that are dead
    dead_sector_share: Share = 0.0  # chance that one sector of the revolution is lost
    dead_sector_deg: Annotated[float, Between(0, 360, open=True)] = 30.0  # width of that sector, in degrees
    # share of the beams that take a pulse of another sensor for their own, which comes at any time and counts if first
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
"""By name: 10 and 50 mm/h of rain, fog with 200 m and 50 m of visibility, 2 mm/h of snow, a worn sensor, and
sensors of others near by."""


def conditions_named(name: str) -> Conditions:
    """Return the conditions called ``name``.

    Raises:
        ValueError: there are none of that name.

    >>> conditions_named("fog").extinction_per_m
    0.015
    """
    one_of("conditions", name, CONDITIONS)
    return CONDITIONS[name]
