"""What a reader found in a file, before it is a Sweep; and the step from one to the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viewshed.geometry import Rigid
from viewshed.io.frames import IDENTITY, is_identity
from viewshed.io.kernels import move_points
from viewshed.io.rings import rings_by_elevation
from viewshed.io.source import Source
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep


@dataclass(slots=True, eq=False)
class Columns:
    """Columns of one revolution (not frozen, which costs as much as opening a file).

    Attributes:
        points: (N, 3) float32, metres, writable, in ``frame``.
        intensity: (N,) float32, or None.
        ring: (N,) beam index, 0 the lowest, or None.
        laser: (N,) beam number in the file's own order, turned into ``ring`` by elevation, or None.
        azimuth: (N,) float32 radians, counter-clockwise from x of ``frame``, or None.
        time_s: (N,) float32 seconds since the start of the sweep, or None.
        t_ns: time of the sweep in nanoseconds, or None.
        model: beams as the file describes them, or None.
        frame: what is still to be done: ``sensor_from_columns``.
        saved: the other attributes of a Sweep that this package wrote, or None.
    """

    points: NDArray[np.float32]
    intensity: NDArray[np.float32] | None = None
    ring: NDArray[np.int16] | None = None
    laser: NDArray[np.int64] | None = None
    azimuth: NDArray[np.float32] | None = None
    time_s: NDArray[np.float32] | None = None
    t_ns: int | None = None
    model: LidarModel | None = None
    frame: Rigid = IDENTITY
    saved: Saved | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Saved:
    """Attributes of a Sweep that only this package's NPZ keeps."""

    attitude: NDArray[np.float64] | None = None
    sensor_height_m: float | None = None
    world_from_sensor: Rigid | None = None
    agent: str = "ego"
    dropped_points: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """What the caller knows about a sweep; it goes before what the file says.

    Attributes:
        model: beams of the sensor, or None.
        frame: ``sensor_from_file``, or None for the format's own.
        sensor_height_m: mounting height, or None.
        attitude: quaternion (w, x, y, z) of ``level_from_sensor``, or None.
        world_from_sensor: pose, or None.
    """

    model: LidarModel | None = None
    frame: Rigid | None = None
    sensor_height_m: float | None = None
    attitude: ArrayLike | None = None
    world_from_sensor: Rigid | None = None


_NOTHING_SAVED = Saved()


def sweep_of(columns: Columns, source: Source, given: Given) -> Sweep:
    """Return the Sweep of a file's columns, in the sensor's frame.

    Raises:
        ValueError: a column is not as a Sweep needs it, or no point is finite; one line with the file's name.
    """
    points, azimuth = columns.points, columns.azimuth
    if columns.frame is not IDENTITY and not is_identity(columns.frame):
        move_points(points, columns.frame.rotation, columns.frame.translation)
        azimuth = None if azimuth is None else _turned(azimuth, columns.frame)
    model = given.model if given.model is not None else columns.model
    saved = columns.saved or _NOTHING_SAVED
    ring: NDArray[np.int16] | None = columns.ring
    try:
        if columns.laser is not None:
            ring = rings_by_elevation(columns.laser, points, model)
        sweep = Sweep(
            points, columns.intensity, ring, azimuth, columns.time_s, columns.t_ns,
            attitude=saved.attitude if given.attitude is None else np.asarray(given.attitude),
            sensor_height_m=saved.sensor_height_m if given.sensor_height_m is None else given.sensor_height_m,
            world_from_sensor=given.world_from_sensor or saved.world_from_sensor,
            model=model, agent=saved.agent, dropped_points=saved.dropped_points,
        )  # fmt: skip
    except ValueError as error:
        raise source.error(error) from error
    if len(sweep) == 0 and len(points) > 0:
        raise source.error(f"none of the {len(points)} points is finite")
    return sweep


def _turned(azimuth: NDArray[np.float32], frame: Rigid) -> NDArray[np.float32]:
    x, y = np.cos(azimuth, dtype=np.float64), np.sin(azimuth, dtype=np.float64)
    r = frame.rotation
    turned = np.arctan2(r[1, 0] * x + r[1, 1] * y, r[0, 0] * x + r[0, 1] * y)
    return np.asarray(turned, dtype=np.float32)
