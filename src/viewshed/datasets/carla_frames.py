"""CARLA's left-handed frames (x forward, y right, z up; degrees) as our right-handed ones.

Mirroring y, S = diag(1, -1, 1), turns one into the other: a pose (R, t) of CARLA becomes (S R S, S t).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.source import ObjectBox
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

MIRROR = np.array([1.0, -1.0, 1.0])
"""What turns a vector of CARLA into one of ours, and back."""


def rotation_of_carla(roll_deg: float, pitch_deg: float, yaw_deg: float) -> NDArray[np.float64]:
    """Return the (3, 3) rotation that CARLA's ``Transform.get_matrix`` has, still in CARLA's left-handed axes.

    Source: ``carla/geom/Transform.h``. Yaw turns x towards y (right), pitch lifts x, roll lowers the right side (y).

    >>> rotation_of_carla(0.0, 0.0, 90.0).round(6).tolist()[1]
    [1.0, 0.0, 0.0]
    """
    (cr, cp, cy), (sr, sp, sy) = (f(np.deg2rad([roll_deg, pitch_deg, yaw_deg])) for f in (np.cos, np.sin))
    return np.array(
        [
            [cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr],
            [cp * sy, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr],
            [sp, -cp * sr, cp * cr],
        ]
    )


def rigid_of_carla(location_m: Sequence[float], roll_deg: float, pitch_deg: float, yaw_deg: float) -> Rigid:
    """Return the right-handed pose of a CARLA transform: (x, y, z) in metres, angles in degrees.

    >>> rigid_of_carla((10.0, 2.0, 1.0), 0.0, 0.0, 90.0).translation.tolist()
    [10.0, -2.0, 1.0]
    """
    rotation = rotation_of_carla(roll_deg, pitch_deg, yaw_deg)
    return Rigid(MIRROR[:, None] * rotation * MIRROR, MIRROR * np.asarray(location_m, np.float64))


def mirrored(sweep: Sweep) -> Sweep:
    """Return a sweep read from points in CARLA's axes, in the sensor's frame: y and azimuth change their sign."""
    azimuth = None if sweep.azimuth is None else -sweep.azimuth
    return sweep.replace(points=sweep.points * MIRROR.astype(np.float32), azimuth=azimuth)


def box_of_carla(world_from_box: Rigid, extent_m: Sequence[float], category: str, track: str | None) -> ObjectBox:
    """Return the box with CARLA's extent: half of its length, width and height, metres."""
    length, width, height = (2.0 * float(half) for half in extent_m)
    return ObjectBox(world_from_box, (length, width, height), category, track)


def lidar_of_carla(
    channels: int,
    upper_fov_deg: float,
    lower_fov_deg: float,
    range_m: float,
    points_per_second: float,
    rotation_hz: float,
) -> LidarModel:
    """Return the beams of ``sensor.lidar.ray_cast`` with these attributes: channels evenly spaced, the lowest first.

    Source: ``RayCastSemanticLidar.cpp``, CreateLasers and SimulateLidar.

    Raises:
        ValueError: an attribute is out of range.

    >>> lidar_of_carla(64, 2.0, -25.0, 120.0, 1_300_000, 20.0).azimuth_columns
    1016
    """
    if channels < 1 or rotation_hz <= 0:
        raise ValueError(f"channels and rotation_frequency must be positive, got {channels} and {rotation_hz}")
    columns = round(points_per_second / (channels * rotation_hz))
    elevation = np.deg2rad(np.linspace(lower_fov_deg, upper_fov_deg, channels))
    source = f"CARLA sensor.lidar.ray_cast, {channels} channels, {lower_fov_deg:g} to {upper_fov_deg:g} degrees"
    return LidarModel(f"CARLA {channels}", elevation, columns, min_range_m=0.3, max_range_m=range_m, source=source)
