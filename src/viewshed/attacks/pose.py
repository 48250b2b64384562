"""Pose spoof: the returns are true, the place they are put at is not (family 13)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viewshed.attacks.assembly import untouched
from viewshed.attacks.checks import require
from viewshed.attacks.tampering import Tampered
from viewshed.geometry import Rigid, quaternion_from_rotation, rotation_from_quaternion
from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True)
class PoseSpoof:
    """A pose that is turned, shifted and tilted, by amounts given and in directions drawn at random.

    The turn is about the vertical through the sensor, the shift is level, the tilt is about a level axis. Returns are
    not touched.

    Attributes:
        yaw_deg: turn.
        shift_m: shift.
        tilt_deg: tilt, of the attitude as well.
    """

    yaw_deg: float = 2.0
    shift_m: float = 1.0
    tilt_deg: float = 0.0

    def __post_init__(self) -> None:
        require("yaw_deg", self.yaw_deg, 0.0, 180.0)
        require("shift_m", self.shift_m, 0.0, 10_000.0)
        require("tilt_deg", self.tilt_deg, 0.0, 90.0)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it.

        Raises:
            ValueError: the sweep has no pose (for a tilt alone: neither pose nor attitude).
        """
        side, around, axis = rng.choice([-1.0, 1.0]), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
        tilt = _about_level_axis(axis, np.deg2rad(self.tilt_deg))
        pose, attitude = sweep.world_from_sensor, sweep.attitude
        if pose is None and (self.yaw_deg > 0 or self.shift_m > 0 or attitude is None):
            raise ValueError("a sweep must have a pose for it to be spoofed, got none; give world_from_sensor")
        if pose is not None:
            turn = Rigid.from_yaw(side * np.deg2rad(self.yaw_deg)).rotation
            shift_m = self.shift_m * np.array([np.cos(around), np.sin(around), 0.0])
            pose = Rigid(turn @ tilt @ pose.rotation, pose.translation + shift_m)
        if attitude is not None and self.tilt_deg > 0:
            attitude = quaternion_from_rotation(tilt @ rotation_from_quaternion(attitude))
        return untouched(sweep.replace(world_from_sensor=pose, attitude=attitude))


def _about_level_axis(axis: float, angle: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the rotation (3, 3) by ``angle`` about the level direction at azimuth ``axis``."""
    half = angle / 2
    x, y = np.sin(half) * np.cos(axis), np.sin(half) * np.sin(axis)
    return rotation_from_quaternion([np.cos(half), x, y, 0.0])
