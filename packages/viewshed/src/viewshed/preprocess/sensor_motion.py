"""How a spinning sensor moved while it measured, inferred from its points alone.

Points that were put straight lie in one frame, though each was measured from where the sensor was at its time. Seen
from one place the elevations of a beam are blurred then. A sensor turns evenly, so its place follows from the azimuth:
that motion is sought from which the elevations gather most, and undone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32


@dataclass(frozen=True, slots=True, eq=False)
class SensorMotion:
    """An even motion during one revolution."""

    # (3,) float64 meters from the beginning to the end, counter-clockwise, in the frame of the points
    way_m: NDArray[np.float64]
    seam: float  # azimuth in radians at which the revolution begins and ends
    reference: float  # part of the turn from there, counter-clockwise, at which the sensor was at the origin

    def undo(self, points: F32) -> F32:
        """Return points (N, 3) as the sensor measured them, each in its frame at that time."""
        x_m, y_m, z_m = self.way_m.tolist()
        return _core.undo_motion(points, x_m, y_m, z_m, self.seam, self.reference)


def find_motion(points: F32) -> SensorMotion | None:
    """Return the motion by which the elevations of points (N, 3) gather most; None where they gather by none."""
    found = _core.find_motion(points)
    return None if found is None else SensorMotion(np.array(found[:3]), *found[3:])
