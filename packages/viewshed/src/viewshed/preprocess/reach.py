"""Reach: how far a sensor sees, beyond which nothing may be claimed, and the returns beyond its maximum range."""

from __future__ import annotations

import numpy as np

from viewshed import _core
from viewshed.arrays import F32
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sensors import LidarModel

USUAL_REACH_M = _core.USUAL_REACH_M
"""Reach of a sensor that is not known, or whose table has none: the median of the shipped tables.

Returns tell of the place more than of the sensor: from an embankment whose fields give few returns they show 20 m, from
an open field 150 m.
"""


def sensing_reach(model: LidarModel | None) -> float:
    """Return up to which range in meters a sensor sees a dark target: by its table, else the usual reach.

    >>> from viewshed.sensors import lidar_model
    >>> sensing_reach(lidar_model("os0_128")), sensing_reach(None)
    (22.0, 85.0)
    """
    if model is None:
        return USUAL_REACH_M
    return min(USUAL_REACH_M, model.max_range_m) if model.reach_m is None else model.reach_m


def returns_beyond(points: F32, model: LidarModel | None) -> int:
    """Return how many of the points (N, 3) lie beyond the sensor's maximum range; 0 where it is not known."""
    if model is None:
        return 0
    squared_m2 = np.einsum("nk,nk->n", points, points)
    return int(np.count_nonzero(squared_m2 > np.float32(model.max_range_m) ** 2))


def reach_of_sweep(leveled: LeveledSweep) -> float:
    """Return how far in meters the sensor of a sweep sees a dark target."""
    model = leveled.sensor_id.model if leveled.sweep.model is None else leveled.sweep.model
    reach_m, planar = sensing_reach(model), leveled.sweep.planar
    return reach_m if planar is None else min(reach_m, planar.max_range_m)
