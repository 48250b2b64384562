"""Convert CustomMsg of Livox's drivers (``livox_ros_driver`` and ``livox_ros_driver2``) to a Sweep."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from viewshed.sweep import Sweep


class LivoxPoint(Protocol):
    """The fields of a point that are read: nanoseconds since the first point, meters, reflectivity (0 to 255)."""

    offset_time: int
    x: float
    y: float
    z: float
    reflectivity: int


class LivoxMessage(Protocol):
    """The field of the message that is read."""

    points: Sequence[LivoxPoint]


def sweep_of_livox(message: LivoxMessage) -> Sweep:
    """Convert a message to a sweep (N returns, meters); beams without a return (points at the origin) are dropped.

    A Livox has no fixed scan lines, so there are no rings; ``line`` is the number of a laser.

    Raises:
        ValueError: times span more than one revolution.
    """
    rows = [(p.x, p.y, p.z, p.reflectivity, p.offset_time) for p in message.points]
    table = np.array(rows, np.float64).reshape(-1, 5)
    table = table[table[:, :3].any(axis=1)]
    return Sweep(
        table[:, :3].astype(np.float32),
        table[:, 3].astype(np.float32),
        time_s=(table[:, 4] * 1e-9).astype(np.float32),
        infer_sensor=False,
    )
