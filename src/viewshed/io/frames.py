"""Coordinate frames that files come in, as ``sensor_from_file`` (sensor: x forward, y left, z up)."""

from __future__ import annotations

import numpy as np

from viewshed.geometry import Rigid

FILE_FRAMES: dict[str, Rigid] = {
    "sensor": Rigid.identity(),
    "nuscenes": Rigid(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3)),
    "carla": Rigid(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.zeros(3)),
    "argoverse2": Rigid(np.eye(3), np.array([-1.35018, 0.0, -1.64042])),
    "pandaset": Rigid(np.eye(3), np.array([0.0, 0.0, -1.8])),
}
"""Name → ``sensor_from_file``.

sensor: as it is. nuscenes: x right, y forward. carla: raw files of CARLA ≤ 0.9.9, x right, y backward, z down.
argoverse2: the car's frame (rear axle) → its ``up_lidar``. pandaset: the car's frame → a sensor 1.8 m above its origin
(inferred from the innermost ring, not documented by the data set).
"""


def file_frame_named(frame: str | Rigid) -> Rigid:
    """Return the ``sensor_from_file`` of a name in :data:`FILE_FRAMES`; a transform is returned as it is.

    >>> (file_frame_named("nuscenes") @ np.array([0.0, 5.0, 0.0])).tolist()
    [5.0, 0.0, 0.0]
    """
    if isinstance(frame, Rigid):
        return frame
    if frame not in FILE_FRAMES:
        raise ValueError(f"file_frame must be one of {', '.join(FILE_FRAMES)} or a Rigid, got {frame!r}")
    return FILE_FRAMES[frame]


def is_identity(frame: Rigid) -> bool:
    """Return whether a transform changes nothing."""
    return bool((frame.rotation == np.eye(3)).all() and not frame.translation.any())


IDENTITY = FILE_FRAMES["sensor"]
