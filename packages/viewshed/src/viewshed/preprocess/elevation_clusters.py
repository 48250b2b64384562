"""Rings of an unknown sensor: clusters of the elevations of its returns.

Each beam of a spinning sensor has a fixed elevation. So in the sensor's own frame the elevations of a revolution form
one narrow cluster per beam. Non-repetitive patterns, merged clouds of several sensors and points in another frame have
no clusters: then nothing is inferred.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32


class ElevationClusters(NamedTuple):
    """Beams recovered from the elevations of a cloud."""

    elevation: NDArray[np.float64]  # (K,) radians, ascending
    origin_m: NDArray[np.float64]  # (K,) height of each beam above the sensor's origin at range 0
    sharpness: float  # share of the returns close to a beam, minus chance level


def find_clusters(azimuth: F32, slope: F32, range_m: F32) -> ElevationClusters | None:
    """Return the clusters of the elevations of N returns, or None if there are none.

    The scatter of a beam's returns is unknown, so several window widths are tried. The narrowest is used whose clusters
    explain about as many returns as those of any other.

    Args:
        azimuth: (N,) radians in [-π, π).
        slope: (N,) z over horizontal range.
        range_m: (N,) horizontal range in meters.
    """
    clusters = _core.find_clusters(azimuth, slope, range_m)
    return None if clusters is None else ElevationClusters(*clusters)
