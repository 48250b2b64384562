"""Local ground, and how sure it is: it decides what is an obstacle and which beams would meet a target.

On a lattice about the sensor (nodes of 1 m on roads, of .5 m indoors), from the second-lowest return of each node:

1. The plane that carries the sensor, through the nodes around it (``src/core/ground_plane.cpp``).
2. Patches: nodes that lie on one plane with their neighbors, and how many of them hang together.
3. A walk outwards from the sensor that carries height and slope and takes a node for ground where ground can make the
   step to it: up as far as a curb, 1.5 m onto a large patch, or any way along a slope that meets the ground at its
   foot; down to whatever returns agree on or is clearly lower, for nothing but ground lies below ground. What goes on
   beside accepted ground is attached to it, and the walk repeated: now a level that only one narrow sector shows is
   hardly carried on any more (``src/core/ground.cpp``).
4. Heights in between, by averages over coarser and coarser nodes above the carrier's plane, whose slope fades beyond
   the ground that is seen (pull-push, Gortler et al. 1996), with the spread of what was averaged as standard deviation.
   Where the ground breaks off along a line of sight it lies between the beam that passes the edge and not far below
   where that beam ends (``src/core/ground_fill.cpp``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.fov.height_map import HeightMap

UNSEEN_STD_M = 1.0
"""Standard deviation of ground that no return lies on."""

_CoreGround = tuple[
    NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], tuple[float, float, float], float, float
]


def ground_of_lows(
    lows_m: NDArray[np.float32], rise_m: NDArray[np.float32], half_extent_m: float, sensor_height_m: float | None
) -> HeightMap:
    """Return the ground, z from the sensor, from a low point of each node.

    Args:
        lows_m: (n, n, 3) float32 the second-lowest point of each node (the lowest where it is alone, so that one
            return below the ground does not count); +inf where there is none.
        rise_m: (n, n) float32 from that point up to the highest return of the node.
        half_extent_m: half the side of the lattice in meters.
        sensor_height_m: known mounting height, or None.
    """
    found = _core.ground_of_lows(lows_m, rise_m, half_extent_m, _or_nan(sensor_height_m))
    return _height_map(found, half_extent_m)


def _or_nan(height_m: float | None) -> float:
    return np.nan if height_m is None else float(height_m)


def _height_map(found: _CoreGround, half_extent_m: float) -> HeightMap:
    """Return what the core found; level ground where that is not seen."""
    heights_m, std_m, seen, plane, support, level_m = found
    if not np.isnan(level_m):
        return HeightMap.flat(half_extent_m, level_m, UNSEEN_STD_M)
    return HeightMap(heights_m, half_extent_m, seen, plane, support, std_m)
