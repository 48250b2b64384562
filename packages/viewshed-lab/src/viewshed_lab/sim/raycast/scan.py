"""ExactScan: noise-free hits of all beams of a revolution, the input of truth and measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion of a sensor within a revolution, around its reference pose, in world axes."""

    velocity_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)  # (vx, vy, vz)
    yaw_rate: float = 0.0  # radians per second about the world's z
    period_s: float = 0.0  # duration of the revolution; 0 means that all beams fire at once (no rolling shutter)


STILL = Motion()
"""No motion, and all beams fire at once."""


@dataclass(frozen=True, slots=True, eq=False)
class ExactScan:
    """Exact hits of the beams. C columns in firing order, R rings from the lowest up; directions are in world axes."""

    model: LidarModel  # the sensor
    world_from_sensor: Rigid  # reference pose, at the middle of the revolution
    motion: Motion  # motion of the sensor around it
    time_s: NDArray[np.float32]  # (C,) float32 seconds from the reference; all 0 without rolling shutter
    origin_m: NDArray[np.float32]  # (C, R, 3) float32 start of each beam from the reference position of the sensor
    direction: NDArray[np.float32]  # (C, R, 3) float32 unit vectors
    depth_m: NDArray[np.float32]  # (C, R) float32 meters from start to first hit; +inf without one in range
    thing: NDArray[np.int32]  # (C, R) int32 index of the hit thing, ``GROUND``, or ``NOTHING``
    material: NDArray[np.uint8]  # (C, R) uint8 rows of ``MATERIALS`` (0 without a hit)
    cos_incidence: NDArray[np.float32]  # (C, R) float32 in [0, 1] between beam and normal; 1 for volumes
