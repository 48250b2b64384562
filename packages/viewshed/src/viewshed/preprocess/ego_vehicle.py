"""The vehicle that carries the sensor: where its own returns lie, however the sensor is turned on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed import _core

EGO_BOX_M = _core.EGO_BOX_M
"""Half length and half width of the vehicle below the sensor."""

EGO_HEIGHTS_M = _core.EGO_HEIGHTS_M
"""Sensor heights at which such a vehicle is assumed; lower ones are robots, higher ones stand at the roadside."""


def vehicle_heading(points: NDArray[np.float32], rotation: NDArray[np.float64], given: float | None) -> float:
    """Return the heading of the own vehicle in radians from the sensor's x, in the frame leveled by ``rotation``.

    The given one, else that of the returns near the sensor, if they are a hood and a trunk across its x axis; else 0.
    Ahead and behind are not distinguished: a vehicle's box has no front.

    Args:
        points: (N, 3) in the sensor's frame.
        rotation: (3, 3) from the sensor's frame to a level one.
        given: heading in radians, or None where it is not known.
    """
    if given is not None:
        return given
    return _core.vehicle_heading(points, rotation.astype(np.float32))
