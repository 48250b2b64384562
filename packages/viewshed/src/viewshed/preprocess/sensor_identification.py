"""Sensor identification: the rings of a cloud, and the beam table that matches them, if any."""

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
"""Number of last sweeps whose most frequent number of rings is that of the stream."""


@dataclass(frozen=True, slots=True, eq=False)
class RingLayout:
    """Rings of a sensor that matches no beam table, from the lowest to the highest."""

    elevation: NDArray[np.float64]  # (rings,) in radians
    origin_m: NDArray[np.float64]  # (rings,) height of each beam above the sensor's origin at range 0
    ring_counts: tuple[int, ...]  # number of rings recovered from each of the last sweeps


@dataclass(frozen=True, slots=True, eq=False)
class SensorId:
    """Rings and sensor of a sweep; a hint for the next sweep of the stream."""

    # (N,) int16 beam of each return, 0 the lowest, -1 if it matches no beam; None if the rings are unknown
    ring: NDArray[np.int16] | None
    model: LidarModel | None  # the sensor, or None if unknown
    layout: RingLayout | None = None  # layout of rings that were recovered from the points and match no table


UNIDENTIFIED = SensorId(None, None)


def identify_sensor(sweep: Sweep, before: SensorId = UNIDENTIFIED) -> SensorId:
    """Return the sweep's own rings and sensor; if it has none, recover them from its points.

    Rings come from the order of the points, else from clusters of their elevations. The sensor is the table that
    matches these rings, if ``infer_sensor`` allows it. Without rings, it is a table that also explains points beside
    its beams, as a moving sensor measures them. If no table does, rings come from clusters of the elevations after
    compensation of the sensor's motion. Nothing is guessed: a cloud without elevation clusters has no rings, and rings
    that match no table have no sensor, not even the sweep's own.

    The sensor of ``before`` is tried first: if about 2,000 returns confirm it, the search is skipped. This saves time
    and does not change the result. Rings that match no table are aligned with the layout of ``before``, which has as
    many rings as most sweeps show: the order of points misses a ring that is interrupted by the vehicle where rings
    begin. If they cannot be aligned, the sensor changed and a new layout begins.

    Args:
        sweep: the sweep to identify.
        before: result for the previous sweep of the stream.
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
        # A sweep without rings does not invalidate the layout of earlier sweeps.
        return SensorId(sweep.ring if ring is None else ring, known, held if ring is None else None)
    if held is None or not is_held:
        return SensorId(ring, known, RingLayout(*layout, (count,)))
    counts = (*held.ring_counts, count)[-COUNTED_SWEEPS:]
    usual, _ = Counter(counts).most_common(1)[0]
    if count == usual != len(held.elevation):
        return identify_sensor(sweep, SensorId(None, before.model))
    return SensorId(ring, known, RingLayout(*layout, counts))


def infer_sensor(points: FloatArray, ring: NDArray[np.integer[Any]] | None = None) -> tuple[LidarModel | None, float]:
    """Return the beam table that matches points (N, 3) best, and its score in [0, 1]; None if no table matches.

    With rings (given, or recovered from the order of the points or from elevation clusters), the score is the share of
    returns in rings whose median elevation is that of a beam of the table. The sensor is accepted if the score is at
    least 0.8, the rings are in the table's order without gaps, and the median ring is within a tenth of the gap between
    beams: a sensor with its own calibration matches no table.

    Without rings, the score is the share of returns near a beam, minus chance level, times the share of the table's
    beams with returns. The sensor is accepted if the score is at least 0.3 (points of a moving sensor lie beside its
    beams); below 0.5 also no ring may have more returns than columns, to reject two sensors in one frame. Of large
    clouds 16,384 returns are used, sampled with a fixed seed.

    >>> infer_sensor(np.zeros((0, 3)))
    (None, 0.0)
    """
    rings = None if ring is None else np.ascontiguousarray(ring, dtype=np.int16)
    number, score = _core.infer_sensor(np.ascontiguousarray(points, dtype=np.float32), rings)
    return _inferable_sensors()[number] if number >= 0 else None, score


_NO_BEAMS = np.zeros(0), np.zeros(0)


@lru_cache(maxsize=1)
def _inferable_sensors() -> tuple[LidarModel, ...]:
    """Return the sensors that may be inferred, in the core's order."""
    return tuple(map(lidar_model, inferable_sensors()))
