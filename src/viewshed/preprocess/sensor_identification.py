"""Sensor identification: the beam table that explains a cloud, and the ring of each return."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import FloatArray
from viewshed.preprocess.ring_recovery import (
    EXPLAINED,
    NEAR_M,
    Angles,
    match_beams,
    polar,
    ring_medians,
    rings_by_order,
)
from viewshed.sensors import LidarModel, lidar_model, sensor_names
from viewshed.sweep import Sweep

SAMPLE = 16_384
"""Returns by which a sensor is identified."""

Rings = tuple[NDArray[np.int16], int]
"""Ring of each return, and how many rings there are."""

_CERTAIN = 0.5

_FEW, _LIKELY = 2048, 2
"""So many returns choose so many likely tables, which are then compared on the whole sample."""

_CROWDED = 1.3


@dataclass(frozen=True, slots=True, eq=False)
class SensorId:
    """What is known of a sweep's beams.

    Attributes:
        ring: (N,) int16 beam of each return, 0 the lowest, -1 where no beam explains it; None where nothing shows it.
        model: the sensor, or None where it is not known.
    """

    ring: NDArray[np.int16] | None
    model: LidarModel | None


UNIDENTIFIED = SensorId(None, None)


def identify_sensor(sweep: Sweep) -> SensorId:
    """Return the sweep's own rings and sensor; where it has none, those that its points show.

    Rings come from the order of the points, else from the nearest beam of the sensor, which :func:`infer_sensor` finds
    if it is not known and the sweep lets it be inferred. Neither is guessed: a cloud that no beam table explains has
    none.
    """
    if len(sweep) == 0 or (sweep.ring is not None and sweep.model is not None):
        return SensorId(sweep.ring, sweep.model)
    may_infer = sweep.model is None and sweep.infer_sensor
    if sweep.ring is not None:
        model = infer_sensor(sweep.points, sweep.ring)[0] if may_infer else None
        fits = model is not None and int(sweep.ring.max()) < model.rings
        return SensorId(sweep.ring, model if fits else None)
    # Points stored ring after ring show their rings without any table.
    azimuth, slope, range_m = polar(sweep.points)
    ordered, model = rings_by_order(azimuth, slope), sweep.model
    if may_infer:
        rows = _sample_rows(len(sweep))
        model = _best_table(slope[rows], range_m[rows], _rings_of_sample(ordered, rows), len(sweep))[0]
    if ordered is not None and (model is None or int(ordered.max()) < model.rings):
        return SensorId(ordered, model)
    if model is None:
        return UNIDENTIFIED
    # Else the nearest beam of the table, if the returns gather at its beams.
    match = match_beams(slope, range_m, model)
    return SensorId(match.ring if match.excess >= EXPLAINED else None, model)


def infer_sensor(points: FloatArray, ring: NDArray[np.integer[Any]] | None = None) -> tuple[LidarModel | None, float]:
    """Return the beam table that explains points (N, 3) best, and its score in [0, 1]; None where none does.

    Where the rings are known (given, or shown by the order of the points) the score is the share of returns whose ring
    lies, in the median, where the table has it. Where that is below 0.5, or the rings are not known, it is the share of
    returns near a beam, less what chance would give, times the share of the table's beams that were hit. A score of at
    least 0.3 explains the cloud (a moving sensor's points lie beside its beams), below 0.5 only if no ring has more
    returns than columns: two sensors in one frame are none. Of large clouds ``SAMPLE`` returns are used, drawn by a
    fixed seed.

    >>> infer_sensor(np.zeros((0, 3)))
    (None, 0.0)
    """
    points = np.ascontiguousarray(points, dtype=np.float32)
    if ring is None:
        azimuth, slope, _ = polar(points)
        ring = rings_by_order(azimuth, slope)
    rows = _sample_rows(len(points))
    _, slope, range_m = polar(points[rows])
    return _best_table(slope, range_m, _rings_of_sample(ring, rows), len(points))


def _sample_rows(count: int) -> NDArray[np.int64]:
    """Return rows of a cloud in random order: all of them, or ``SAMPLE`` of a larger one."""
    rng = np.random.default_rng(0)
    return rng.permutation(count) if count <= SAMPLE else rng.integers(count, size=SAMPLE)


def _rings_of_sample(ring: NDArray[np.integer[Any]] | None, rows: NDArray[np.int64]) -> Rings | None:
    """Return the rings of a sample, and how many the whole cloud has."""
    return None if ring is None else (np.asarray(ring[rows], np.int16), int(ring.max(initial=0)) + 1)


def _best_table(slope: Angles, range_m: Angles, rings: Rings | None, count: int) -> tuple[LidarModel | None, float]:
    """Return the best table for a sample of ``count`` returns and its score, None where it explains too little."""
    few = slope[:_FEW], range_m[:_FEW]
    if rings is not None:
        first = rings[0][:_FEW], rings[1]
        best, score = _highest_score({name: _ring_score(first, *few, lidar_model(name)) for name in sensor_names()})
        if score >= _CERTAIN:
            return best, score
    roughly = {name: _cluster_score(*few, lidar_model(name)) for name in sensor_names()}
    likely = sorted(roughly, key=lambda name: roughly[name], reverse=True)[:_LIKELY]
    best, score = _highest_score({name: _cluster_score(slope, range_m, lidar_model(name)) for name in likely})
    if best is None or score < EXPLAINED or (score < _CERTAIN and _crowded(slope, range_m, best, count)):
        return None, score
    return best, score


def _highest_score(scores: Mapping[str, float]) -> tuple[LidarModel | None, float]:
    """Return the sensor with the highest score, None where none has any."""
    name = max(scores, key=lambda name: scores[name])
    return (lidar_model(name) if scores[name] > 0.0 else None), scores[name]


def _crowded(slope: Angles, range_m: Angles, model: LidarModel, count: int) -> bool:
    """Return whether the median of the table's rings would hold clearly more returns than a revolution has columns."""
    ring = match_beams(slope, range_m, model).ring
    sizes = np.bincount(ring[ring >= 0], minlength=model.rings) * (count / max(len(slope), 1))
    return bool(np.median(sizes) > _CROWDED * model.azimuth_columns)


def _cluster_score(slope: Angles, range_m: Angles, model: LidarModel) -> float:
    """Return ``excess`` times the share of beams that were hit, among those inside the elevations of the returns."""
    match = match_beams(slope, range_m, model)
    hit = match.hits > max(2.0, 0.02 * match.hits.sum() / model.rings)
    if not hit.any():
        return 0.0
    first, last = np.flatnonzero(hit)[[0, -1]]
    return match.excess * float(hit[first : last + 1].mean())


def _ring_score(rings: Rings, slope: Angles, range_m: Angles, model: LidarModel) -> float:
    """Return the share of returns whose ring's median lies within half a gap, and 0.5°, of the table's beam."""
    ring, count = rings
    if len(ring) == 0 or count != model.rings:
        return 0.0
    corrected = slope - (model.origin_m[ring] / np.maximum(range_m, NEAR_M)).astype(np.float32)
    medians = np.arctan(ring_medians(ring, np.where(range_m > NEAR_M, corrected, np.nan), count))
    gap = np.diff(model.elevation, prepend=-np.pi, append=np.pi)
    limit = np.minimum(np.minimum(gap[:-1], gap[1:]) / 2, np.deg2rad(0.5))
    return float((np.abs(medians - model.elevation) < limit)[ring].mean())
