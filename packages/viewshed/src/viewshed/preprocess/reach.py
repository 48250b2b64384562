"""Reach: how far a sensor sees, beyond which nothing may be claimed, and the returns beyond its maximum range."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sensors import LidarModel


def sensing_reach(
    range_m: NDArray[Any],
    isolated: NDArray[np.bool_],
    model: LidarModel | None = None,
    rows: NDArray[np.int32] | None = None,
) -> float:
    """Return up to which range in meters a sensor sees a dark target.

    The table's own reach. Where the sensor is not known, or its table has none: the usual reach, more where its returns
    show more, and within the table's maximum range.

    Returns show 2.5 times the range within which 90 % of the supported ones lie. They tell of the place more than of
    the sensor: from an embankment whose fields give few returns they show 20 m, from an open field 150 m. So less than
    the usual reach says nothing of the sensor; of more the geometric mean is taken, with the usual reach counted twice:
    103 m for the open field.

    In a cloud of 35,000 returns, 150 returns more or fewer are 0.4 %: they would decide on the 99.5 % quantile, hardly
    move the 90 % quantile, and its cube root a third as much.

    Args:
        range_m: (N,) distance of each return from the sensor.
        isolated: (N,) returns that nothing around confirms (:mod:`viewshed.preprocess.range_image`).
        model: the sensor, or None where it is not known.
        rows: (N,) where in ``isolated`` each return stands, or None where it stands at its own place.

    >>> from viewshed.sensors import lidar_model
    >>> sensing_reach(np.zeros(0), np.zeros(0, np.bool_), lidar_model("os0_128"))
    22.0
    """
    if model is not None and model.reach_m is not None:
        return model.reach_m
    most_m = np.inf if model is None else model.max_range_m
    return _core.sensing_reach(np.ascontiguousarray(range_m, np.float32), isolated, rows, most_m)


def returns_beyond(points: NDArray[np.float32], model: LidarModel | None) -> int:
    """Return how many of the points (N, 3) lie beyond the sensor's maximum range; 0 where it is not known."""
    if model is None:
        return 0
    squared_m2 = np.einsum("nk,nk->n", points, points)
    return int(np.count_nonzero(squared_m2 > np.float32(model.max_range_m) ** 2))


def reach_of_sweep(leveled: LeveledSweep) -> float:
    """Return how far in meters the sensor of a sweep sees a dark target; see :func:`sensing_reach`."""
    if leveled.held is not None:
        return leveled.held.reach_m
    image, planar = leveled.range_image, leveled.sweep.planar
    isolated = np.zeros(len(leveled.sweep), np.bool_) if image is None else image.isolated
    reach_m = sensing_reach(leveled.range_m, isolated, leveled.sensor_id.model, leveled.rows)
    return reach_m if planar is None else min(reach_m, planar.max_range_m)
