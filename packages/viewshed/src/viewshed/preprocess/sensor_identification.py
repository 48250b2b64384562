"""Sensor identification: the rings of a cloud, and the beam table that agrees with them, or none."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.geometry import FloatArray
from viewshed.sensors import LidarModel, inferable_sensors, lidar_model
from viewshed.sweep import Sweep

COUNTED_SWEEPS = 100
"""Last sweeps whose most frequent number of rings is taken for the stream's."""


@dataclass(frozen=True, slots=True, eq=False)
class RingLayout:
    """The rings of a sensor that no beam table explains, from the lowest to the highest."""

    elevation: NDArray[np.float64]  # (rings,) in radians
    origin_m: NDArray[np.float64]  # (rings,) height of each beam above the sensor's origin at range 0
    shown: tuple[int, ...]  # how many rings each of the last sweeps showed by itself


@dataclass(frozen=True, slots=True, eq=False)
class SensorId:
    """What is known of a sweep's beams; the sweep after it in a stream is identified by it."""

    # (N,) int16 beam of each return, 0 the lowest, -1 where no beam explains it; None where nothing shows it
    ring: NDArray[np.int16] | None
    model: LidarModel | None  # the sensor, or None where it is not known
    layout: RingLayout | None = None  # of rings that the points alone show, where no table explains them


UNIDENTIFIED = SensorId(None, None)


def identify_sensor(sweep: Sweep, before: SensorId = UNIDENTIFIED) -> SensorId:
    """Return the sweep's own rings and sensor; where it has none, those that its points show.

    Rings come from the order of the points, else from the elevations at which they gather. The sensor is the table that
    these rings agree with, if the sweep lets it be inferred; where there are no rings, one that explains points beside
    its beams as well, as those of a moving sensor are. Where no table does, rings come from the elevations at which the
    returns gather once the motion of the sensor is undone. None of this is guessed: a cloud that gathers at no
    elevations has no rings, and rings that agree with no table have no sensor, not even the sweep's own one.

    A sensor that was identified ``before``, in the last sweep of the stream, is looked at first: about 2,000 returns
    confirm it, or all is done as without. It saves time and changes nothing else. Rings that no table explains are
    counted by those of the sweeps before, as many as most sweeps show, where both go together: an order of points
    misses a ring that meets the vehicle where rings begin. Where they do not, the sensor changed, and the count begins
    anew.

    Args:
        sweep: what is identified.
        before: what was identified of the sweep before in the stream.
    """
    model = sweep.model
    if model is not None and not model.fires_rings:
        return SensorId(None, model)
    if sweep.ring is not None and (model is not None or not sweep.infer_sensor):
        return SensorId(sweep.ring, model)
    sensors, table = _inferable_sensors(), _NO_BEAMS if model is None else (model.elevation, model.origin_m)
    number, held = next((k for k, sensor in enumerate(sensors) if sensor is before.model), -1), before.layout
    ring, number, layout, count, is_held = _core.identify_sensor(
        sweep.points, sweep.ring, *table, sweep.infer_sensor, number,
        *(_NO_BEAMS if held is None else (held.elevation, held.origin_m)),
    )  # fmt: skip
    if number == _core.OTHER_BEAMS and ring is not None:
        return SensorId(ring, None)
    known = sensors[number] if number >= 0 else model
    if layout is None:
        # A sweep that shows no rings says nothing against those before it.
        return SensorId(sweep.ring if ring is None else ring, known, held if ring is None else None)
    if held is None or not is_held:
        return SensorId(ring, known, RingLayout(*layout, (count,)))
    shown = (*held.shown, count)[-COUNTED_SWEEPS:]
    usual, _ = Counter(shown).most_common(1)[0]
    if count == usual != len(held.elevation):
        return identify_sensor(sweep, SensorId(None, before.model))
    return SensorId(ring, known, RingLayout(*layout, shown))


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
    own = None if ring is None else np.ascontiguousarray(ring, dtype=np.int16)
    number, score = _core.infer_sensor(np.ascontiguousarray(points, dtype=np.float32), own)
    return _inferable_sensors()[number] if number >= 0 else None, score


_NO_BEAMS = np.zeros(0), np.zeros(0)


@lru_cache(maxsize=1)
def _inferable_sensors() -> tuple[LidarModel, ...]:
    """Return the sensors that may be inferred, in the order by which the core numbers them."""
    return tuple(map(lidar_model, inferable_sensors()))
