"""Height of the local ground and its standard deviation; it decides on obstacles and on beams that would hit a target.

On a lattice around the sensor (nodes of 1 m on roads, of .5 m indoors), from the second-lowest return of each node:

1. Ground plane: fit a plane through the nodes around the sensor (``src/core/ground_plane.cpp``).
2. Patches: find nodes on one plane with their neighbors, and the size of each connected patch.
3. Region growing outwards from the sensor, with height and slope. A node is ground if the step to it is possible for
   ground: up to the height of a curb, up to 1.5 m onto a large patch, or any height along a slope that starts at the
   ground; down to a height on which returns agree or that is clearly lower, because nothing lies below ground. Nodes
   that continue accepted ground sideways are added. Then the growing is repeated, which suppresses levels that only
   one narrow sector shows (``src/core/ground.cpp``).
4. Prediction of the remaining nodes by a network that sees returns, seen ground and passing beams in polar bins around
   the sensor; it states three quantiles of the height (``src/core/unseen_ground.cpp``, fitted by
   ``tools/fit_ground.py``). The ground lies below beams that pass over it. Only the merged ground of several sweeps
   (:func:`ground_of_lows`) is interpolated instead, by averages over coarser and coarser nodes (pull-push, Gortler et
   al. 1996; ``src/core/ground_fill.cpp``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.fov.height_map import HeightMap

UNSEEN_STD_M = 1.0
"""Standard deviation of ground without any return."""


def ground_of_lows(
    lows_m: NDArray[np.float32], rise_m: NDArray[np.float32], half_extent_m: float, sensor_height_m: float | None
) -> HeightMap:
    """Return the ground, z relative to the sensor, from a low point of each node.

    Args:
        lows_m: (n, n, 3) float32 the second-lowest point of each node, to ignore one return below the ground; the only
            point of a node with one, +inf for none.
        rise_m: (n, n) float32 from that point up to the highest return of the node.
        half_extent_m: half the side of the lattice in meters.
        sensor_height_m: known mounting height, or None.
    """
    height_m = np.nan if sensor_height_m is None else float(sensor_height_m)
    ground = _core.ground_of_lows(lows_m, rise_m, half_extent_m, height_m)
    heights_m, std_m, seen, plane, support, level_m = ground
    if not np.isnan(level_m):  # no ground is seen
        return HeightMap.flat(half_extent_m, level_m, UNSEEN_STD_M)
    return HeightMap(heights_m, half_extent_m, seen, plane, support, std_m)
