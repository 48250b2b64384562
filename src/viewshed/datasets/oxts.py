"""KITTI's inertial records: poses from latitude, longitude, altitude, roll, pitch and yaw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.number_text import numbers_of, text_lines
from viewshed.geometry import Rigid

EARTH_RADIUS_M = 6378137.0
"""Radius that KITTI's development kit uses."""

_COLUMNS = 6


def read_oxts(place: Path) -> NDArray[np.float64]:
    """Return latitude and longitude in degrees, altitude in metres, roll, pitch and yaw in radians, (6,) float64.

    Raises:
        OSError: the file cannot be read.
        ValueError: its first line is not as above, or the latitude is that of a pole.
    """
    record = numbers_of(text_lines(place)[0], _COLUMNS, str(place))
    if abs(record[0]) >= 89.0:
        raise ValueError(f"{place}: latitude must lie in (-89, 89) degrees, got {record[0]}")
    return record


def world_from_imu(record: NDArray[np.float64], first: NDArray[np.float64]) -> Rigid:
    """Return the pose of a record (6,) in the map: x east, y north, z up, metres from where ``first`` (6,) was taken.

    Mercator projection with the scale at the first latitude, and rotation Rz(yaw) Ry(pitch) Rx(roll), as in
    ``convertOxtsToPose.m`` of KITTI's development kit; unlike there the first pose keeps its rotation, so z is up.

    >>> record = np.array([49.0, 8.4, 110.0, 0.0, 0.0, np.pi / 2])
    >>> pose = world_from_imu(record + [0.0, 0.001, 2.0, 0.0, 0.0, 0.0], record)
    >>> pose.translation.round(2).tolist(), (pose.rotation @ [1.0, 0.0, 0.0]).round(6).tolist()
    ([73.03, 0.0, 2.0], [0.0, 1.0, 0.0])
    """
    scale = np.cos(np.deg2rad(first[0]))
    translation = _mercator(record, scale) - _mercator(first, scale)
    roll, pitch, yaw = record[3:6]
    return Rigid(_about(2, yaw) @ _about(1, pitch) @ _about(0, roll), translation)


def _mercator(record: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    latitude, longitude = np.deg2rad(record[:2])
    north = EARTH_RADIUS_M * np.log(np.tan(np.pi / 4 + latitude / 2))
    return np.array([scale * EARTH_RADIUS_M * longitude, scale * north, record[2]])


def _about(axis: int, angle: float) -> NDArray[np.float64]:
    """Return the (3, 3) rotation about one axis."""
    rotation = np.eye(3)
    one, other = (axis + 1) % 3, (axis + 2) % 3
    rotation[[one, other], [one, other]] = np.cos(angle)
    rotation[one, other], rotation[other, one] = -np.sin(angle), np.sin(angle)
    return rotation
