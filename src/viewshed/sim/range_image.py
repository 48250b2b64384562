"""RangeImage: one revolution as the sensor stores it, whole steps of range for each column and ring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed.sim.firing import firing
from viewshed.sim.scan import STILL, Motion
from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True, eq=False)
class RangeImage:
    """One measured revolution. C columns in firing order, R rings from the lowest up.

    Attributes:
        model: the sensor.
        steps: (C, R) uint16 range from the start of the beam in ``step_m``; 0 is no return.
        intensity: (C, R) uint8, 0 where there is no return.
        step_m: metres a step, 2 mm unless the sensor sees farther than 131 m.
        world_from_sensor: reference pose, of the middle of the revolution.
        motion: how the sensor moved about it.
        sensor_height_m: above the ground below.
        t_ns: time of the reference pose.
        agent: who measured it.
    """

    model: LidarModel
    steps: NDArray[np.uint16]
    intensity: NDArray[np.uint8]
    step_m: float
    world_from_sensor: Rigid
    motion: Motion = STILL
    sensor_height_m: float | None = None
    t_ns: int | None = None
    agent: str = "ego"

    def __post_init__(self) -> None:
        shape = (self.model.azimuth_columns, self.model.rings)
        for name, dtype in (("steps", np.uint16), ("intensity", np.uint8)):
            array = getattr(self, name)
            if array.shape != shape or array.dtype != dtype:
                raise ValueError(f"{name} must be {dtype.__name__} {shape}, got {array.dtype} {array.shape}")
        if not 0 < self.step_m < 1:
            raise ValueError(f"step_m must lie in (0, 1), got {self.step_m}")

    def sweep(self) -> Sweep:
        """Return the sweep: points in the sensor's reference frame (motion undone), firing order, ring and time."""
        column, ring = np.nonzero(self.steps)
        origin, direction, time_s = firing(self.model, self.motion, self.world_from_sensor)
        range_m = self.steps[column, ring].astype(np.float32) * np.float32(self.step_m)
        return Sweep(
            points=origin[column, ring] + direction[column, ring] * range_m[:, None],
            intensity=self.intensity[column, ring].astype(np.float32),
            ring=ring.astype(np.int16),
            time_s=time_s[column],
            t_ns=self.t_ns,
            sensor_height_m=self.sensor_height_m,
            world_from_sensor=self.world_from_sensor,
            model=self.model,
            agent=self.agent,
        )
