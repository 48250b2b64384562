"""Sensor identification: the rings of a cloud, and the beam table that agrees with them, or none."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.geometry import FloatArray
from viewshed.sensors import LidarModel, inferable_sensors, lidar_model
from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True, eq=False)
class SensorId:
    """What is known of a sweep's beams."""

    # (N,) int16 beam of each return, 0 the lowest, -1 where no beam explains it; None where nothing shows it
    ring: NDArray[np.int16] | None
    model: LidarModel | None  # the sensor, or None where it is not known


UNIDENTIFIED = SensorId(None, None)


def identify_sensor(sweep: Sweep, expected: LidarModel | None = None) -> SensorId:
    """Return the sweep's own rings and sensor; where it has none, those that its points show.

    Rings come from the order of the points, else from the elevations at which they gather. The sensor is the table that
    these rings agree with, if the sweep lets it be inferred; where there are no rings, one that explains points beside
    its beams as well, as those of a moving sensor are. Where no table does, rings come from the elevations at which the
    returns gather once the motion of the sensor is undone. None of this is guessed: a cloud that gathers at no
    elevations has no rings, and rings that agree with no table have no sensor.

    A sensor that is expected, as that of the sweep before in a stream, is looked at first: about 2,000 returns confirm
    it, or all is done as without. It saves time and changes nothing else.
    """
    if sweep.model is not None and not sweep.model.fires_rings:
        return SensorId(None, sweep.model)
    if len(sweep) == 0 or (sweep.ring is not None and (sweep.model is not None or not sweep.infer_sensor)):
        return SensorId(sweep.ring, sweep.model)
    if sweep.model is not None:
        ring = _core.beams_of_sensor(sweep.points, sweep.model.elevation, sweep.model.origin_m)
        return SensorId(ring, sweep.model)
    if not sweep.infer_sensor:
        return SensorId(_core.rings_of_points(sweep.points), None)
    models, tables = _known_sensors()
    number = next((k for k, model in enumerate(models) if model is expected), -1)
    if sweep.ring is None:
        ring, number = _core.identify_by_points(sweep.points, *tables, number)
    else:
        ring, number = _core.identify_by_rings(sweep.points, sweep.ring, *tables, number)
        ring = sweep.ring if ring is None else ring
    return SensorId(ring, models[number] if number >= 0 else None)


def infer_sensor(points: FloatArray, ring: NDArray[np.integer[Any]] | None = None) -> tuple[LidarModel | None, float]:
    """Return the beam table that explains points (N, 3) best, and its score in [0, 1]; None where none does.

    Where rings are known (given, or shown by the order of the points or by the elevations at which they gather) the
    score is the share of returns whose ring lies, in the median, where the table has it. At least 0.8 names the sensor,
    if the rings are in the table's order without leaving out beams and the median ring lies within a tenth of the gap
    between beams: a sensor with a calibration of its own agrees with no table.

    Where no rings are known, the score is the share of returns near a beam, less what chance would give, times the
    share of the table's beams that were hit. A score of at least 0.3 explains the cloud (a moving sensor's points lie
    beside its beams), below 0.5 only if no ring has more returns than columns: two sensors in one frame are none. Of
    large clouds 16,384 returns are used, drawn by a fixed seed.

    >>> infer_sensor(np.zeros((0, 3)))
    (None, 0.0)
    """
    models, tables = _known_sensors()
    own = None if ring is None else np.ascontiguousarray(ring, dtype=np.int16)
    number, score = _core.infer_sensor(np.ascontiguousarray(points, dtype=np.float32), own, *tables)
    return models[number] if number >= 0 else None, score


_Tables = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]


@lru_cache(maxsize=1)
def _known_sensors() -> tuple[tuple[LidarModel, ...], _Tables]:
    """Return the sensors that may be inferred of those that travel with the package, and their tables.

    Elevation and height of the origin of all beams, then the number of beams and of columns of each table.
    """
    models = tuple(map(lidar_model, inferable_sensors()))
    return models, (
        np.concatenate([model.elevation for model in models]),
        np.concatenate([model.origin_m for model in models]),
        np.array([model.rings for model in models], np.int64),
        np.array([model.azimuth_columns for model in models], np.int64),
    )
