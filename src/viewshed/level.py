"""From a sweep to what every geometric estimator starts from: level points, their heights above local ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.bev import BevGrid
from viewshed.geometry import Rigid
from viewshed.ground import Ground
from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True, eq=False)
class LevelSweep:
    """A sweep in its ``level`` frame, without ego and null returns; M ≤ N rows, in the sweep's order.

    Attributes:
        sweep: the sweep that it came from.
        points: (M, 3) float32 metres in ``level`` (the sensor is at (0, 0, sensor_height_m)).
        range_m: (M,) float32 horizontal range from the sensor.
        azimuth: (M,) float32 radians in [-π, π), counter-clockwise from forward.
        height_m: (M,) float32 height above local ground.
        rows: (M,) row of each point in the sweep.
        level_from_sensor: the transform used.
        ground: the local ground.
    """

    sweep: Sweep
    points: NDArray[np.float32]
    range_m: NDArray[np.float32]
    azimuth: NDArray[np.float32]
    height_m: NDArray[np.float32]
    rows: NDArray[np.intp]
    level_from_sensor: Rigid
    ground: Ground

    @property
    def sensor_height_m(self) -> float:
        """Height of the sensor above the ground below it, in metres."""
        return float(self.level_from_sensor.translation[2])

    @property
    def world_from_level(self) -> Rigid | None:
        """Pose of the ``level`` frame in the map, or None where the sweep has none."""
        pose = self.sweep.world_from_sensor
        return None if pose is None else pose @ self.level_from_sensor.inverse()


def level_sweep(sweep: Sweep, grid: BevGrid) -> LevelSweep:
    """Return ``sweep`` levelled, its ground estimated over the extent of ``grid`` where it is not given."""
    raise NotImplementedError
