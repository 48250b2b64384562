"""Ground rings at the wrong radius: a relay sends the sensor's own pulses back later, so that all ranges are too long.

On ground of slope s a return at distance x lies at height z = s x - Δ q, where Δ is the offset of range and q = (h -
z) / r the descent of its beam a meter, h the height of the sensor. The ground below the sensor is at z = 0. Near rings
descend steeply and far ones hardly, so slope and offset part. Each sector is fitted by itself, the returns far from
the fit counting less (iterated least squares with Cauchy's weights).
"""

from __future__ import annotations

import numpy as np

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import SECTORS, MonitoredSweep


def measure_range_offset(monitored: MonitoredSweep) -> F32:
    """Return the absolute offset of range (SECTORS,) in meters that flattens the ground; NaN for too little ground."""
    leveled = monitored.leveled
    return np.abs(_core.measure_range_offset(leveled.points, leveled.sensor_height_m, SECTORS))
