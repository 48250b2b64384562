"""Reach of a sensor: maximum range of a dark target, beyond which no cell is claimed; returns beyond maximum range."""

from __future__ import annotations

import numpy as np

from viewshed import _core
from viewshed.arrays import F32
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sensors import LidarModel

USUAL_REACH_M = _core.USUAL_REACH_M
"""Reach of a sensor that is unknown or has none in its table: the median of the shipped tables.

It is not estimated from the returns, which depend on the place more than on the sensor: their range is 20 m on an
embankment between fields with few returns, 150 m on an open field.
"""


def sensing_reach(model: LidarModel | None) -> float:
    """Return the maximum range of a dark target in meters, from the sensor's table, else the usual reach.

    >>> from viewshed.sensors import lidar_model
    >>> sensing_reach(lidar_model("os0_128")), sensing_reach(None)
    (22.0, 85.0)
    """
    if model is None:
        return USUAL_REACH_M
    return min(USUAL_REACH_M, model.max_range_m) if model.reach_m is None else model.reach_m


def returns_beyond(points: F32, model: LidarModel | None) -> int:
    """Return the number of points (N, 3) beyond the sensor's maximum range; 0 if the sensor is unknown."""
    if model is None:
        return 0
    squared_m2 = np.einsum("nk,nk->n", points, points)
    return int(np.count_nonzero(squared_m2 > np.float32(model.max_range_m) ** 2))


def reach_of_sweep(leveled: LeveledSweep) -> float:
    """Return the maximum range in meters of a dark target for the sensor of a sweep."""
    model = leveled.sensor_id.model if leveled.sweep.model is None else leveled.sweep.model
    reach_m, planar = sensing_reach(model), leveled.sweep.planar
    return reach_m if planar is None else min(reach_m, planar.max_range_m)
