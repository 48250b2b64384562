"""The vehicle that carries the sensor: where its own returns lie, however the sensor is turned on it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

EGO_BOX_M = (2.7, 1.1)
"""Half length and half width of the vehicle below the sensor."""

EGO_HEIGHTS_M = (1.2, 3.0)
"""Sensor heights at which such a vehicle is assumed; lower ones are robots, higher ones stand at the roadside."""

_NEAR_M, _BELOW_M = 1.2, 0.05
"""Returns of hood and trunk: from this horizontal range on, so far below the sensor, and above any ground."""

_FEWEST = 40

_ALONG = 0.4
"""Least concentration of the doubled azimuths of these returns: they lie ahead and behind, not all around."""

_INSIDE, _BOTH_ENDS = 0.9, 0.15
"""So many of them lie in the turned box, and so many at each of its ends: a car beside lies at one side alone, ..."""

_ROOF = 200
"""... unless so many returns are nearer still: then the sensor sees the roof that it stands on, ..."""

_WIDE_M = 0.3
"""... and the returns at the one end spread so far across (root mean square): a person beside does not."""

_MOST_ABOVE = 0.2
"""At most so many returns, of these, are as near but higher: a wall is higher than the sensor, a hood is not."""

_ALIGNED = np.deg2rad(20.0)
"""Headings within this of the sensor's x axis are taken as along it."""


def vehicle_heading(points: NDArray[np.float32], rotation: NDArray[np.float64], given: float | None) -> float:
    """Return the heading of the own vehicle in radians from the sensor's x, in the frame leveled by ``rotation``.

    The given one, else that of the returns near the sensor, if they are a hood and a trunk across its x axis; else 0.
    Ahead and behind are not told apart: a vehicle's box has no front.

    Args:
        points: (N, 3) in the sensor's frame.
        rotation: (3, 3) from the sensor's frame to a level one.
        given: heading in radians, or None where it is not known.
    """
    if given is not None:
        return given
    turn = rotation.astype(np.float32)
    count, cosine, sine, _, _, _, roof, _ = _near_returns(points, turn, np.float32(1.0), np.float32(0.0))
    if count < _FEWEST or np.hypot(cosine, sine) < _ALONG * count:
        return 0.0
    heading = float(0.5 * np.arctan2(sine, cosine))
    if abs(heading) < _ALIGNED:
        return 0.0
    _, _, _, ahead, behind, above, _, across2 = _near_returns(
        points, turn, np.float32(np.cos(heading)), np.float32(np.sin(heading))
    )
    is_hood = roof >= _ROOF and across2 >= _WIDE_M**2 * count
    has_ends = is_hood or min(ahead, behind) >= _BOTH_ENDS * count
    is_vehicle = has_ends and ahead + behind >= _INSIDE * count and above <= _MOST_ABOVE * count
    return heading if is_vehicle else 0.0


@njit(
    "Tuple((int64, float64, float64, int64, int64, int64, int64, float64))"
    "(Array(float32, 2, 'C', readonly=True), float32[:, ::1], float32, float32)",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def _near_returns(points: Any, rotation: Any, cos: Any, sin: Any) -> Any:  # pragma: no cover - compiled
    """Count the returns near and below the sensor, and sum the cosines and sines of their doubled azimuths.

    Then count those in either half of a box with the heading (cos, sin), the returns as near but not below, those
    below that are nearer, and the sum of the squares of the distance across that heading.
    """
    near2, far2 = np.float32(_NEAR_M * _NEAR_M), np.float32(EGO_BOX_M[0] * EGO_BOX_M[0])
    lowest, highest, half = np.float32(-EGO_HEIGHTS_M[0]), np.float32(-_BELOW_M), np.float32(EGO_BOX_M[1])
    count, ahead, behind, above, roof = 0, 0, 0, 0, 0
    cosine, sine, across2 = 0.0, 0.0, 0.0
    for n in range(points.shape[0]):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        x = rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz
        y = rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz
        r2 = x * x + y * y
        if not r2 < far2:
            continue
        z = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz
        if z <= lowest:
            continue
        if r2 < near2:
            roof += z < highest
            continue
        if z >= highest:
            above += 1
            continue
        count += 1
        # cos 2a = (x² - y²) / r², sin 2a = 2 x y / r²
        cosine += np.float64((x * x - y * y) / r2)
        sine += np.float64(np.float32(2.0) * x * y / r2)
        across = cos * y - sin * x
        across2 += np.float64(across * across)
        if abs(across) < half:
            along = cos * x + sin * y
            ahead += along > 0
            behind += along <= 0
    return count, cosine, sine, ahead, behind, above, roof, across2
