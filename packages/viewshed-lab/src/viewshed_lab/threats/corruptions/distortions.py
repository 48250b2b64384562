"""Returns in the wrong place: noise along the ray, motion that was not undone, a wrong attitude, sloping ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid, attitude_of, polar, rotation_from_quaternion
from viewshed.sweep import Sweep
from viewshed_lab.threats.corruptions.base import at_ranges, ranges_of
from viewshed_lab.threats.parameters import Between, Checked

PERIOD_S = 0.1
"""Duration of a revolution where the sweep has no times."""


@dataclass(frozen=True, slots=True)
class RangeNoise(Checked):
    """Normal noise along the ray, beyond the sensor's own."""

    sigma_m: Annotated[float, Between(0, 10)]  # its standard deviation

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with noisy ranges."""
        return at_ranges(sweep, ranges_of(sweep) + self.sigma_m * rng.standard_normal(len(sweep)))


@dataclass(frozen=True, slots=True)
class MotionDistortion(Checked):
    """Ego motion that nobody undid: each return stays in the sensor's frame at its own time.

    The sensor drives forward and turns to a random side at constant rates; the middle of the revolution is the
    reference. Times are the sweep's own, else by azimuth: from -π to π in :data:`PERIOD_S`.
    """

    speed_mps: Annotated[float, Between(0, 100)]  # forward
    yaw_rate_degps: Annotated[float, Between(0, 360)]  # how fast it turns

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` sheared by the motion; firing azimuths and times are as before."""
        time_s = _from_middle_s(sweep)
        turned = -time_s * np.deg2rad(self.yaw_rate_degps) * (1 if rng.random() < 0.5 else -1)
        x, y, z = sweep.points.T
        x = x - self.speed_mps * time_s
        c, s = np.cos(turned), np.sin(turned)
        return sweep.replace(points=np.stack([c * x - s * y, s * x + c * y, z], axis=1).astype(np.float32))


def _from_middle_s(sweep: Sweep) -> NDArray[np.float64]:
    """Return the time of each return (N,) from the middle of the revolution, in seconds."""
    if sweep.time_s is not None and len(sweep) and np.ptp(sweep.time_s) > 0:
        time_s = sweep.time_s.astype(np.float64)
        return np.asarray(time_s - (time_s.min() + time_s.max()) / 2)
    return polar(sweep.points)[1].astype(np.float64) * (PERIOD_S / (2 * np.pi))


@dataclass(frozen=True, slots=True)
class Miscalibration(Checked):
    """Roll and pitch are wrong by a tilt about a random horizontal axis; a sweep without an attitude gets this one."""

    tilt_deg: Annotated[float, Between(0, 45)]  # angle between the vertical that is claimed and the true one

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with a wrong attitude, and a wrong rotation of its pose; the points are as measured."""
        known, pose = sweep.known_attitude, sweep.world_from_sensor
        level_from_sensor = np.eye(3) if known is None else rotation_from_quaternion(known)
        tilt = _tilt(float(rng.uniform(-np.pi, np.pi)), np.deg2rad(self.tilt_deg))
        error = level_from_sensor.T @ tilt @ level_from_sensor
        return sweep.replace(
            attitude=attitude_of(level_from_sensor @ error),
            world_from_sensor=None if pose is None else Rigid(pose.rotation @ error, pose.translation),
        )


def _tilt(heading: float, angle: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) by ``angle`` about the horizontal axis at ``heading`` (Rodrigues)."""
    x, y = np.cos(heading), np.sin(heading)
    cross = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross), np.float64)


@dataclass(frozen=True, slots=True)
class Slope(Checked):
    """The world bends upward: beyond a line to a random side, everything is raised in proportion to its distance."""

    grade: Annotated[float, Between(-1, 1)]  # rise over run
    start_m: Annotated[float, Between(0, 1000)]  # where the slope begins

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` sheared along the sensor's z; x, y and the rings stay."""
        return self.apply_at(sweep, self.place(sweep, rng), rng)

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the nearest point of the line where the slope begins, and one a meter up the slope from it (2, 3)."""
        heading = rng.uniform(-np.pi, np.pi)
        uphill = np.array([np.cos(heading), np.sin(heading), 0.0])
        return np.stack([self.start_m * uphill, (self.start_m + 1.0) * uphill])

    def apply_at(self, sweep: Sweep, places: NDArray[np.float64], rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with a slope that begins at the first of ``places`` (2, 3) and rises towards the second."""
        foot, above = places[:, :2]
        beyond = (sweep.points[:, :2] - foot) @ (above - foot)
        points = sweep.points.copy()
        points[:, 2] += (self.grade * np.maximum(beyond, 0)).astype(np.float32)
        return sweep.replace(points=points)
