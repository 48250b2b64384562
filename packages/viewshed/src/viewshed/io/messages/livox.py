"""CustomMsg of Livox's drivers (``livox_ros_driver`` and ``livox_ros_driver2``) as a Sweep."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from viewshed.sweep import Sweep


class LivoxPoint(Protocol):
    """The parts of a point that are read: nanoseconds after the first, meters, reflectivity of 0 to 255."""

    offset_time: int
    x: float
    y: float
    z: float
    reflectivity: int


class LivoxMessage(Protocol):
    """The part of the message that is read."""

    points: Sequence[LivoxPoint]


def sweep_of_livox(message: LivoxMessage) -> Sweep:
    """Return the sweep (N returns, meters) of a message; beams without a return, which lie at the origin, are left out.

    A Livox fires anywhere in its field: there are no rings, and its ``line`` is the number of a laser.

    Raises:
        ValueError: times do not lie within one revolution.
    """
    rows = [(each.x, each.y, each.z, each.reflectivity, each.offset_time) for each in message.points]
    table = np.array(rows, np.float64).reshape(-1, 5)
    table = table[table[:, :3].any(axis=1)]
    return Sweep(
        table[:, :3].astype(np.float32),
        table[:, 3].astype(np.float32),
        time_s=(table[:, 4] * 1e-9).astype(np.float32),
        infer_sensor=False,
    )
