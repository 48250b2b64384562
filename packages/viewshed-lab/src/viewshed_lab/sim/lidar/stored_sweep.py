"""StoredSweep: one revolution as a range image, integer range steps for each column and ring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep
from viewshed_lab.sim.lidar.firing import column_poses, still_firing
from viewshed_lab.sim.raycast.scan import STILL, Motion


@dataclass(frozen=True, slots=True, eq=False)
class StoredSweep:
    """One measured revolution. C columns in firing order, R rings from the lowest up."""

    model: LidarModel  # the sensor
    steps: NDArray[np.uint16]  # (C, R) uint16 range from the start of the beam in units of ``step_m``; 0 is no return
    intensity: NDArray[np.uint8]  # (C, R) uint8, 0 where there is no return
    step_m: float  # 2 mm unless the maximum range exceeds 131 m
    world_from_sensor: Rigid  # reference pose, at the middle of the revolution
    motion: Motion = STILL  # motion of the sensor around it
    sensor_height_m: float | None = None  # above the ground below
    t_ns: int | None = None  # time of the reference pose
    agent: str = "ego"  # name of the measuring agent

    def __post_init__(self) -> None:
        shape = (self.model.azimuth_columns, self.model.rings)
        for name, dtype in (("steps", np.uint16), ("intensity", np.uint8)):
            array = getattr(self, name)
            if array.shape != shape or array.dtype != dtype:
                raise ValueError(f"{name} must be {dtype.__name__} {shape}, got {array.dtype} {array.shape}")
        if not 0 < self.step_m < 1:
            raise ValueError(f"step_m must lie in (0, 1), got {self.step_m}")

    def sweep(self) -> Sweep:
        """Return the sweep in firing order: points in the sensor's reference frame (motion undone), ring and time.

        Times start with the revolution, half a period before the reference pose and ``t_ns``.
        """
        start_m, direction, _ = still_firing(self.model)
        turn, shift_m, time_s = column_poses(self.model, self.motion, self.world_from_sensor)
        points, intensity, ring, time_s = _returns(
            self.steps, self.intensity, np.float32(self.step_m), start_m, direction, turn, shift_m, time_s
        )
        return Sweep(
            points=points,
            intensity=intensity,
            ring=ring,
            time_s=time_s + np.float32(self.motion.period_s / 2),
            t_ns=self.t_ns,
            sensor_height_m=self.sensor_height_m,
            world_from_sensor=self.world_from_sensor,
            model=self.model,
            agent=self.agent,
        )


@njit(cache=True, nogil=True, error_model="numpy")
def _returns(
    steps: Any, level: Any, step_m: Any, start_m: Any, direction: Any, turn: Any, shift_m: Any, column_s: Any
) -> Any:
    """Return points (N, 3), intensity, ring and time of the returns, column by column.

    ``steps`` and ``level`` (intensity) are (C, R); start heights ``start_m`` (R,) and ``direction`` (C, R, 3) are in
    the sensor's frame at the firing; ``turn`` (C, 3, 3), ``shift_m`` (C, 3) and ``column_s`` (C,) are the columns'
    poses and times.
    """
    columns, rings = steps.shape
    points = np.empty((steps.size, 3), np.float32)
    intensity, time_s = np.empty(steps.size, np.float32), np.empty(steps.size, np.float32)
    ring = np.empty(steps.size, np.int16)
    n = 0
    for c in range(columns):
        pose = turn[c]
        for r in range(rings):
            if steps[c, r] == 0:
                continue
            d = np.float32(steps[c, r]) * step_m
            x, y, z = direction[c, r, 0] * d, direction[c, r, 1] * d, direction[c, r, 2] * d + start_m[r]
            for axis in range(3):
                points[n, axis] = pose[axis, 0] * x + pose[axis, 1] * y + pose[axis, 2] * z + shift_m[c, axis]
            intensity[n], ring[n], time_s[n] = level[c, r], r, column_s[c]
            n += 1
    return points[:n], intensity[:n], ring[:n], time_s[:n]
