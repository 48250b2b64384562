"""Sensor identification: the rings of a cloud, and the beam table that agrees with them, or none."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import FloatArray
from viewshed.preprocess.beam_matching import EXPLAINED, NEAR_M, Angles, match_beams, polar
from viewshed.preprocess.elevation_clusters import rings_by_clusters
from viewshed.preprocess.ring_recovery import ring_medians, rings_by_order
from viewshed.preprocess.sensor_motion import find_motion
from viewshed.sensors import LidarModel, lidar_model, sensor_names
from viewshed.sweep import Sweep

Floats = NDArray[np.float64]

SAMPLE = 16_384
"""Returns by which a sensor is identified."""

AGREEING = 0.8
"""Least share of the returns whose ring must lie where the table has it."""

_NEAR_SHARE, _MOST_OFF = 0.25, np.deg2rad(0.25)
"""A ring lies at a beam within a quarter of the gap to the next beam, and within 0.25°, ..."""

_TYPICAL_SHARE, _LEAST_GAP = 0.1, np.deg2rad(0.3)
"""... the median ring within a tenth of it, or 0.03°: a sensor with a calibration of its own is none of the table's."""

_FEWEST_OF_RING = 4

_LEAST_OF_TABLE, _MOST_OF_TABLE = 0.5, 1.15
"""Rings that are fewer than this share of a table's beams do not name it, nor clusters that are more than this, ..."""

_NEXT_BEAM = 0.8
"""... nor do rings of which fewer lie at the very next beam: every second beam of a table is another sensor."""

_HIT = 0.9
"""Where no rings are known: least share of a table's beams that must be hit."""

_SHARP = 0.97
"""Clusters that explain so many of the returns are the sensor's beams, whatever a table says."""

_SHARP_AT_REST = 0.95
"""The same of a sensor whose motion was undone: near the seam a return may be of either end of the revolution."""

_CERTAIN = 0.5

_OF_RINGS = 8192
"""So many returns tell the elevations of rings."""

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


@dataclass(frozen=True, slots=True, eq=False)
class _Rings:
    """Rings (N,) of returns, -1 for none, how many there are in the whole cloud, what shows them, and how sharply."""

    ring: NDArray[np.int16]
    count: int
    source: Literal["file", "file order", "elevation clusters"]
    sharpness: float = 1.0

    def of(self, rows: NDArray[np.int64] | slice) -> _Rings:
        """Return the rings of some of the returns."""
        return _Rings(self.ring[rows], self.count, self.source, self.sharpness)


def identify_sensor(sweep: Sweep) -> SensorId:
    """Return the sweep's own rings and sensor; where it has none, those that its points show.

    Rings come from the order of the points, else from the elevations at which they gather. The sensor is the table that
    these rings agree with, if the sweep lets it be inferred; where there are no rings, one that explains points beside
    its beams as well, as those of a moving sensor are. Where no table does, rings come from the elevations at which the
    returns gather once the motion of the sensor is undone. None of this is guessed: a cloud that gathers at no
    elevations has no rings, and rings that agree with no table have no sensor.
    """
    if len(sweep) == 0 or (sweep.ring is not None and (sweep.model is not None or not sweep.infer_sensor)):
        return SensorId(sweep.ring, sweep.model)
    azimuth, slope, range_m = polar(sweep.points)
    if sweep.model is not None:
        ordered = rings_by_order(azimuth, slope)
        if ordered is not None and int(ordered.max()) < sweep.model.rings:
            return SensorId(ordered, sweep.model)
        return SensorId(_beams_of_known_sensor(sweep.model, sweep.points, slope, range_m), sweep.model)
    if not sweep.infer_sensor:
        first = next(_shown_rings(None, azimuth, slope, range_m), None)
        return UNIDENTIFIED if first is None else SensorId(first.ring, None)
    model, _, rings = _identify(sweep.ring, azimuth, slope, range_m)
    at_rest = _rings_at_rest(sweep.points) if _is_doubtful(rings, model) else None
    if at_rest is not None and _is_better(at_rest[0], rings):
        # The motion blurred them: look again without it.
        rings, slope, range_m = at_rest
        rows = _sample_rows(len(slope))
        model = _agreeing_table(rings.of(rows), slope[rows], range_m[rows])[0] or model
    if rings is None:
        return UNIDENTIFIED if model is None else SensorId(_nearest_beams(slope, range_m, model), model)
    if model is None:
        return SensorId(rings.ring, None)
    if rings.source == "elevation clusters":
        # Clusters skip a beam that has no return.
        return SensorId(_nearest_beams(slope, range_m, model), model)
    return SensorId(_counted_as_beams(rings, slope, range_m, model), model)


def infer_sensor(points: FloatArray, ring: NDArray[np.integer[Any]] | None = None) -> tuple[LidarModel | None, float]:
    """Return the beam table that explains points (N, 3) best, and its score in [0, 1]; None where none does.

    Where rings are known (given, or shown by the order of the points or by the elevations at which they gather) the
    score is the share of returns whose ring lies, in the median, where the table has it. At least 0.8 names the sensor,
    if the rings are in the table's order without leaving out beams and the median ring lies within a tenth of the gap
    between beams: a sensor with a calibration of its own agrees with no table.

    Where no rings are known, the score is the share of returns near a beam, less what chance would give, times the
    share of the table's beams that were hit. A score of at least 0.3 explains the cloud (a moving sensor's points lie
    beside its beams), below 0.5 only if no ring has more returns than columns: two sensors in one frame are none. Of
    large clouds ``SAMPLE`` returns are used, drawn by a fixed seed.

    >>> infer_sensor(np.zeros((0, 3)))
    (None, 0.0)
    """
    own = None if ring is None else np.asarray(ring, np.int16)
    model, score, _ = _identify(own, *polar(np.ascontiguousarray(points, dtype=np.float32)))
    return model, score


def _identify(
    own: NDArray[np.int16] | None, azimuth: Angles, slope: Angles, range_m: Angles
) -> tuple[LidarModel | None, float, _Rings | None]:
    """Return the sensor of returns (N,), its score and their rings; the first two rings shown are tried in turn."""
    rows = _sample_rows(len(slope))
    few_slopes, few_ranges_m = slope[rows], range_m[rows]
    first, best_score = None, 0.0
    for rings in _shown_rings(own, azimuth, slope, range_m):
        model, score = _agreeing_table(rings.of(rows), few_slopes, few_ranges_m)
        if model is not None:
            return model, score, rings
        first, best_score = first or rings, max(score, best_score)
    # Where nothing shows rings, or clusters are blurred, a table may know what they do not: origins of its beams.
    if first is None or (first.source == "elevation clusters" and first.sharpness < _SHARP):
        model, score = _explaining_table(few_slopes, few_ranges_m, len(slope))
        if first is None or score > first.sharpness:
            return model, score, None
    return None, best_score, first


def _shown_rings(own: NDArray[np.int16] | None, azimuth: Angles, slope: Angles, range_m: Angles) -> Iterator[_Rings]:
    """Yield the rings of returns (N,): the file's own alone, else those of their order, then those of clusters."""
    if own is not None:
        yield _Rings(own, int(own.max(initial=0)) + 1, "file")
        return
    ordered = rings_by_order(azimuth, slope)
    if ordered is not None:
        yield _Rings(ordered, int(ordered.max()) + 1, "file order")
    clustered = rings_by_clusters(azimuth, slope, range_m)
    if clustered is not None:
        yield _Rings(clustered[0], len(clustered[1].elevation), "elevation clusters", clustered[1].sharpness)


def _beams_of_known_sensor(
    model: LidarModel, points: FloatArray, slope: Angles, range_m: Angles
) -> NDArray[np.int16] | None:
    """Return the beam of each point (N, 3) of a sensor that is known; None where the points do not gather at its beams.

    Where its table does not explain them sharply, the sensor moved or has a calibration of its own: then the clusters
    without its motion are counted as the table's beams, if the two go together.
    """
    match = match_beams(slope, range_m, model)
    motion = find_motion(points) if match.excess < _SHARP else None
    if motion is not None:
        azimuth, slope, range_m = polar(motion.undo(points))
        rings = _sharp_clusters(azimuth, slope, range_m)
        if rings is not None and (
            rings.count == model.rings or _beams_of_rings(rings, slope, range_m, model) is not None
        ):
            return _counted_as_beams(rings, slope, range_m, model)
        match = max(match, match_beams(slope, range_m, model), key=lambda one: one.excess)
    return match.ring if match.excess >= EXPLAINED else None


def _is_doubtful(rings: _Rings | None, model: LidarModel | None) -> bool:
    """Return whether nothing shows rings, only clusters that are not sharp, or an order that no table confirms."""
    if rings is None:
        return True
    if rings.source == "elevation clusters":
        return rings.sharpness < _SHARP
    return rings.source == "file order" and model is None


def _is_better(clusters: _Rings, rings: _Rings | None) -> bool:
    """Return whether sharp clusters tell more than the rings: sharper ones, or more than an order that skips rings."""
    if rings is None:
        return True
    if rings.source == "file order":
        return clusters.count > rings.count
    return clusters.sharpness >= rings.sharpness


def _rings_at_rest(points: FloatArray) -> tuple[_Rings, Angles, Angles] | None:
    """Return the rings of points (N, 3) after the motion of their sensor is undone, and slope and range (N,) then.

    None where no motion makes the elevations gather sharply.
    """
    motion = find_motion(points)
    if motion is None:
        return None
    azimuth, slope, range_m = polar(motion.undo(points))
    rings = _sharp_clusters(azimuth, slope, range_m)
    return None if rings is None else (rings, slope, range_m)


def _sharp_clusters(azimuth: Angles, slope: Angles, range_m: Angles) -> _Rings | None:
    """Return the rings of returns (N,) at whose elevations nearly all of them gather, or None."""
    found = rings_by_clusters(azimuth, slope, range_m)
    if found is None or found[1].sharpness < _SHARP_AT_REST:
        return None
    return _Rings(found[0], len(found[1].elevation), "elevation clusters", found[1].sharpness)


def _sample_rows(count: int) -> NDArray[np.int64]:
    """Return rows of a cloud in random order: all of them, or ``SAMPLE`` of a larger one."""
    rng = np.random.default_rng(0)
    return rng.permutation(count) if count <= SAMPLE else rng.integers(count, size=SAMPLE)


def _nearest_beams(slope: Angles, range_m: Angles, model: LidarModel) -> NDArray[np.int16] | None:
    """Return the nearest beam of each return (N,), None where the returns do not gather at the beams."""
    match = match_beams(slope, range_m, model)
    return match.ring if match.excess >= EXPLAINED else None


def _counted_as_beams(rings: _Rings, slope: Angles, range_m: Angles, model: LidarModel) -> NDArray[np.int16]:
    """Return rings (N,) counted as the table's beams, where rings are fewer than these."""
    beam = None if rings.count == model.rings else _beams_of_rings(rings, slope, range_m, model)
    if beam is None or (beam == np.arange(len(beam))).all():
        return rings.ring
    return np.where(rings.ring >= 0, beam[rings.ring], -1).astype(np.int16)


def _agreeing_table(rings: _Rings, slope: Angles, range_m: Angles) -> tuple[LidarModel | None, float]:
    """Return the table that the rings of a sample agree with and its score, None where they agree with none."""
    rings, slope, range_m = rings.of(slice(_OF_RINGS)), slope[:_OF_RINGS], range_m[:_OF_RINGS]
    # 1. Roughly: a slope is the beam's and its origin's height times the nearness 1 / range, and so are their medians.
    far = range_m > NEAR_M
    medians = ring_medians(rings.ring, np.where(far, slope, np.float32(np.nan)), rings.count)
    nearness = ring_medians(rings.ring, np.where(far, 1.0 / np.maximum(range_m, NEAR_M), np.nan), rings.count)
    near = {name: -_roughly_off(rings, medians, nearness, model) for name, model in _tables().items()}
    # 2. The likeliest tables, each ring seen from its own beam's origin.
    likely = [name for name in _likeliest(near) if np.isfinite(near[name])]
    if not likely:
        return None, 0.0
    best, score = _highest_score({name: _ring_score(rings, slope, range_m, _tables()[name]) for name in likely})
    return (best if score >= AGREEING else None), score


def _roughly_off(rings: _Rings, medians: Floats, nearness: Floats, model: LidarModel) -> float:
    """Return how far the median ring lies from a beam, in gaps between beams; inf where the numbers do not fit."""
    if not _is_as_many(rings, model):
        return float(np.inf)
    known = np.isfinite(medians)
    if np.count_nonzero(known) < 2:
        return float(np.inf)
    medians, nearness = medians[known], nearness[known]
    gap = np.diff(model.elevation, prepend=-np.pi, append=np.pi)
    gap = np.minimum(gap[:-1], gap[1:])
    if rings.count == model.rings and rings.source != "elevation clusters":
        own = np.abs(model.elevation[known] - np.arctan(medians - model.origin_m[known] * nearness))
        return float(np.median(own / gap[known]))
    off, origin_m = np.zeros(0), np.full(len(medians), model.origin_m.mean())
    for _ in range(2):  # the second time each ring is seen from its own beam's origin
        off = np.abs(model.elevation - np.arctan(medians - origin_m * nearness)[:, None])
        beam = off.argmin(axis=1)
        origin_m = model.origin_m[beam]
    # Beams that are left out count against a table.
    typical = np.median(off.min(axis=1) / gap[beam])
    return float(typical + (np.diff(beam) > 1).mean())


def _is_as_many(rings: _Rings, model: LidarModel) -> bool:
    """Return whether the rings are neither too few nor too many for a table."""
    most = _MOST_OF_TABLE if rings.source == "elevation clusters" else 1.0
    return _LEAST_OF_TABLE * model.rings <= rings.count <= most * model.rings


def _explaining_table(slope: Angles, range_m: Angles, count: int) -> tuple[LidarModel | None, float]:
    """Return the table whose beams lie nearest to a sample of ``count`` returns, None where it explains too little."""
    few = slope[:_FEW], range_m[:_FEW]
    likely = _likeliest({name: _cluster_score(*few, model) for name, model in _tables().items()})
    best, score = _highest_score({name: _cluster_score(slope, range_m, _tables()[name]) for name in likely})
    if best is None or score < EXPLAINED or (score < _CERTAIN and _crowded(slope, range_m, best, count)):
        return None, score
    return best, score


@lru_cache(maxsize=1)
def _tables() -> dict[str, LidarModel]:
    """Return the beam tables that travel with the package by name."""
    return {name: lidar_model(name) for name in sensor_names()}


def _likeliest(scores: Mapping[str, float]) -> list[str]:
    """Return the names of the ``_LIKELY`` highest scores."""
    return sorted(scores, key=lambda name: scores[name], reverse=True)[:_LIKELY]


def _highest_score(scores: Mapping[str, float]) -> tuple[LidarModel | None, float]:
    """Return the sensor with the highest score, None where none has any."""
    name = max(scores, key=lambda name: scores[name])
    return (_tables()[name] if scores[name] > 0.0 else None), scores[name]


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
    share = float(hit[first : last + 1].mean())
    return match.excess * share if share >= _HIT else 0.0


def _ring_score(rings: _Rings, slope: Angles, range_m: Angles, model: LidarModel) -> float:
    """Return the share of returns whose ring lies at a beam of the table, 0 where rings and beams do not go together.

    Of rings whose elevation is known: some have near returns alone.
    """
    beam = _beams_of_rings(rings, slope, range_m, model)
    if beam is None:
        return 0.0
    gap = np.diff(model.elevation, prepend=-np.pi, append=np.pi)
    gap = np.minimum(gap[:-1], gap[1:])[beam]
    off = np.abs(_ring_elevations(rings, slope, range_m, model.origin_m[beam]) - model.elevation[beam])
    sizes = np.bincount(rings.ring[rings.ring >= 0], minlength=rings.count)
    known = np.isfinite(off) & (sizes >= _FEWEST_OF_RING)
    if not known.any() or np.median(off[known] / np.maximum(gap[known], _LEAST_GAP)) > _TYPICAL_SHARE:
        return 0.0
    agrees = off < np.minimum(_NEAR_SHARE * gap, _MOST_OFF)
    return float(sizes[agrees].sum() / max(sizes[np.isfinite(off)].sum(), 1))


def _beams_of_rings(rings: _Rings, slope: Angles, range_m: Angles, model: LidarModel) -> NDArray[np.intp] | None:
    """Return the beam (count,) of the table at which each ring lies, None where they do not go together.

    They go together where each ring has a beam of its own, in the same order, and most returns are of a ring at the
    very next beam. Clusters may be one beam's by twos.
    """
    clusters = rings.source == "elevation clusters"
    if not _is_as_many(rings, model):
        return None
    if rings.count == model.rings and not clusters:
        return np.arange(model.rings)
    beam, known = np.zeros(0, np.intp), np.zeros(0, np.intp)
    origin_m = np.full(rings.count, model.origin_m.mean())
    for _ in range(2):  # the second time each ring is seen from its own beam's origin
        medians = _ring_elevations(rings, slope, range_m, origin_m)
        known = np.flatnonzero(np.isfinite(medians))
        if len(known) < 2:
            return None
        at = np.abs(model.elevation - medians[known, None]).argmin(axis=1)
        beam = np.round(np.interp(np.arange(rings.count), known, at)).astype(np.intp)
        origin_m = model.origin_m[beam]
    # Rings whose returns are all near have no elevation and stand between those beside them.
    steps = np.diff(beam[known])
    sizes = np.bincount(rings.ring[rings.ring >= 0], minlength=rings.count)[known]
    weights = np.minimum(sizes[1:], sizes[:-1])
    next_beam = float(weights[steps == 1].sum() / max(weights.sum(), 1))
    return beam if (steps >= (0 if clusters else 1)).all() and next_beam >= _NEXT_BEAM else None


def _ring_elevations(
    rings: _Rings, slope: Angles, range_m: Angles, origin_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the median elevation (count,) of each ring's returns beyond 1 m, seen from its origin (count,)."""
    corrected = slope - (origin_m[np.maximum(rings.ring, 0)] / np.maximum(range_m, NEAR_M)).astype(np.float32)
    medians = ring_medians(rings.ring, np.where(range_m > NEAR_M, corrected, np.float32(np.nan)), rings.count)
    return np.asarray(np.arctan(medians), np.float64)
