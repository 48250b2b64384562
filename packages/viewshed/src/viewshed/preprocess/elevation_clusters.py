"""Rings without a table: the elevations at which the returns of an unknown sensor gather.

Each beam of a spinning sensor keeps its elevation, so that in the sensor's own frame the elevations of a revolution
fall into as many narrow clusters as it has beams. Patterns that do not repeat, several sensors in one cloud and points
that are not in the sensor's frame have none: then nothing is inferred.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32


class ElevationClusters(NamedTuple):
    """Beams that a cloud shows."""

    elevation: NDArray[np.float64]  # (K,) radians, ascending
    origin_m: NDArray[np.float64]  # (K,) height of each beam above the sensor's origin at range 0
    sharpness: float  # share of the returns that lie at the beams, less what chance gives


def find_clusters(azimuth: F32, slope: F32, range_m: F32) -> ElevationClusters | None:
    """Return the elevations at which returns (N,) gather, or None where they do not gather at any.

    How far the returns of a beam scatter is not known before: windows of several widths are tried, and the narrowest
    one is taken whose clusters explain about as many returns as those of any other.

    Args:
        azimuth: (N,) radians in [-π, π).
        slope: (N,) z over horizontal range.
        range_m: (N,) horizontal range in meters.
    """
    found = _core.find_clusters(azimuth, slope, range_m)
    return None if found is None else ElevationClusters(*found)
