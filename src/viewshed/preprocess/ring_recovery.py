"""Which beam and which column each return belongs to: the range image of a sweep, recovered from its points.

Column 0 starts at azimuth -π (behind the sensor) and columns count counter-clockwise: the middle of column c is at
``(c + 0.5) * azimuth_step - π``. The column is that of the return itself, not of the firing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.preprocess.beam_matching import EXPLAINED, NEAR_M, Angles, match_beams, polar
from viewshed.preprocess.elevation_clusters import rings_by_clusters
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

_COARSE = 1024

_FINE = 512

_BACK, _SOON = 0.35, 8
"""Azimuths jitter across the seam by at most so many radians, for fewer than so many points."""


@njit(cache=True, nogil=True)
def order_rings(azimuth: Any, slope: Any, start: float, turn: float) -> Any:  # pragma: no cover - compiled
    """Return rings (N,) counted from the wraps of the azimuth past ``start`` in the sense ``turn``.

    Also their number, the steps against that sense, and the share of wraps at which the slope rises. A step back over
    ``start`` soon after a wrap takes the wrap back. First and last rings of less than a hundredth of the others' size
    are joined to their neighbor. Stops early on a shuffled cloud.
    """
    count = azimuth.shape[0]
    ring = np.zeros(count, np.int16)
    backward, wraps, upward, first_end, last_start = 0, 0, 0, 0, 0
    before = 0.0
    for n in range(count):
        angle = (turn * (azimuth[n] - start)) % (2 * np.pi)
        step = angle - before
        if n > 0 and step < -np.pi:
            wraps += 1
            upward += slope[n] > slope[n - 1]
            first_end = n if wraps == 1 else first_end
            last_start = n
        elif wraps > 0 and step > 2 * np.pi - _BACK and n - last_start < _SOON:
            wraps -= 1
            upward -= slope[n] < slope[n - 1]
        elif n > 0 and step < -0.003:
            backward += 1
        if backward > 100 + 0.1 * n or wraps > 4096:
            return ring, 0, count, 0.5
        ring[n] = wraps
        before = angle
    share = upward / wraps if wraps else 0.5
    typical = count / (wraps + 1)
    if wraps and count - last_start < 0.01 * typical:
        ring[last_start:] = wraps - 1
        wraps -= 1
    if wraps and first_end < 0.01 * typical:
        for n in range(first_end, count):
            ring[n] -= 1
        wraps -= 1
    return ring, wraps + 1, backward, share


@njit(cache=True, nogil=True, inline="always")
def _squeeze(slope: Any) -> Any:  # pragma: no cover - compiled
    """Map a slope to [0, 1024), ascending."""
    return min((0.5 + 0.5 * slope / (1.0 + abs(slope))) * _COARSE, _COARSE - 1e-6)


@njit(cache=True, nogil=True, inline="always")
def _bin_of_rank(counts: Any, rank: int) -> Any:  # pragma: no cover - compiled
    """Return the bin that holds the ``rank``-th item (from 1), and its rank within that bin; (-1, 0) for none."""
    seen = 0
    for b in range(len(counts)):
        if seen + counts[b] >= rank > 0:
            return b, rank - seen
        seen += counts[b]
    return -1, 0


@njit(cache=True, nogil=True)
def _count_slopes(ring: Any, slope: Any, rings: int) -> Any:  # pragma: no cover - compiled
    """Return (rings, 1024) int32 counts of squeezed slopes."""
    counts = np.zeros((rings, _COARSE), np.int32)
    for n in range(ring.shape[0]):
        if ring[n] >= 0 and slope[n] == slope[n]:
            counts[ring[n], int(_squeeze(slope[n]))] += 1
    return counts


@njit(cache=True, nogil=True)
def ring_medians(ring: Any, slope: Any, rings: int) -> Any:  # pragma: no cover - compiled
    """Return (rings,) float64 lower medians of the slopes within 1e-5 (NaN for none; NaN slopes are left out).

    Two rounds of counting (a radix select): the order of the points does not matter.
    """
    coarse = _count_slopes(ring, slope, rings)
    bins = np.empty(rings, np.int64)
    ranks = np.empty(rings, np.int64)
    for r in range(rings):
        bins[r], ranks[r] = _bin_of_rank(coarse[r], (coarse[r].sum() + 1) // 2)
    fine = np.zeros((rings, _FINE), np.int32)
    for n in range(ring.shape[0]):
        if ring[n] >= 0 and slope[n] == slope[n]:
            u = _squeeze(slope[n])
            if int(u) == bins[ring[n]]:
                fine[ring[n], int((u - int(u)) * _FINE)] += 1
    medians = np.full(rings, np.nan)
    for r in range(rings):
        if bins[r] >= 0:
            v = 2.0 * (bins[r] + (_bin_of_rank(fine[r], ranks[r])[0] + 0.5) / _FINE) / _COARSE - 1.0
            medians[r] = v / (1.0 - abs(v))
    return medians


@njit(cache=True, nogil=True)
def count_alone(azimuth: Any, ring: Any, columns: int, rings: int) -> Any:  # pragma: no cover - compiled
    """Return the column of each point (N,), the points with a ring, and those of them alone in their pixel."""
    column = np.empty(azimuth.shape[0], np.int32)
    counts = np.zeros((rings, columns), np.uint8)
    per_radian = columns / (2 * np.pi)
    for n in range(azimuth.shape[0]):
        c = int((azimuth[n] + np.pi) * per_radian)
        c = min(max(c, 0), columns - 1)
        column[n] = c
        if ring[n] >= 0:
            counts[ring[n], c] = min(counts[ring[n], c] + 1, 2)
    placed, alone = 0, 0
    for n in range(azimuth.shape[0]):
        if ring[n] >= 0:
            placed += 1
            alone += counts[ring[n], column[n]] == 1
    return column, placed, alone


Source = Literal["file", "file order", "beam table", "elevation clusters", "elevation bins"]

DEFAULT_COLUMNS = 1024
"""Columns of a revolution where neither the points nor a model tell."""

PSEUDO_RINGS = 64
"""Elevation bins of a cloud without beams and without a model."""

_MOST_WAY = 1.5
"""Median slopes of rings go from the first to the last in at most this much of the way between these."""

_LITTLE = 0.3
"""Rings told by the order of the points are taken at once where they change by less than this share of a step."""

_SAMPLED_RINGS = 6


@dataclass(frozen=True, slots=True, eq=False)
class RingAssignment:
    """The beam and the column of each return.

    Attributes:
        ring: (N,) int16 beam of each return, 0 the lowest; -1 where no beam explains the return.
        column: (N,) int32 azimuth column of each return, in [0, columns).
        columns: azimuth columns in a revolution.
        elevation: (rings,) float64 radians: median direction of the beam's returns seen from the sensor's origin; the
            model's, or interpolated, for beams without a return.
        placed_share: share of the returns that have a beam.
        alone_share: share of the placed returns that are alone in their pixel (ring, column).
        source: how the rings were found.
    """

    ring: NDArray[np.int16]
    column: NDArray[np.int32]
    columns: int
    elevation: NDArray[np.float64]
    placed_share: float
    alone_share: float
    source: Source

    @property
    def rings(self) -> int:
        """Number of beams in a column."""
        return len(self.elevation)

    @property
    def azimuth_step(self) -> float:
        """Width of a column in radians."""
        return 2.0 * np.pi / self.columns


def recover_rings(
    sweep: Sweep, model: LidarModel | None = None, known: NDArray[np.int16] | None = None
) -> RingAssignment:
    """Return the beam and column of every return of ``sweep``.

    Rings are ``known`` (N,), -1 where no beam explains a return; else they come from the sweep's own ring column; else
    from the order of the points (ring after ring, as in KITTI files); else from the nearest beam of ``model`` (or the
    sweep's model), if the elevations gather at its beams; else, without a model, from the elevations at which the
    returns themselves gather; else from bins of elevation. All but the order do not depend on the order of the points.

    >>> points = np.array([[10.0, 1.0, -1.0], [0.0, 10.0, 1.0]])
    >>> recover_rings(Sweep(points, ring=np.array([0, 1]))).ring.tolist()
    [0, 1]
    """
    model = sweep.model if model is None else model
    azimuth, slope, range_m = polar(sweep.points)
    ring, rings, source = _rings(sweep.ring if known is None else known, model, azimuth, slope, range_m)
    columns = _columns(azimuth, ring, range_m, model, source)
    column, placed, alone = count_alone(azimuth, ring, columns, rings)
    return RingAssignment(
        ring=_frozen(ring),
        column=_frozen(column),
        columns=columns,
        elevation=_frozen(_elevations(ring, slope, range_m, rings, model)),
        placed_share=placed / len(sweep) if len(sweep) else 0.0,
        alone_share=alone / placed if placed else 0.0,
        source=source,
    )


def rings_of_sweep(sweep: Sweep) -> RingAssignment:
    """Return the beams of ``sweep`` where its rings are told, not guessed from elevations alone.

    Raises:
        ValueError: the sweep has no rings, and neither the order of its points nor a sensor's table tells them.
    """
    beams = recover_rings(sweep)
    if beams.source == "elevation bins":
        raise ValueError(
            "the sweep must have rings, got none that can be told; give its ring column or name its sensor"
        )
    return beams


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array = array.view()
    array.setflags(write=False)
    return array


def _rings(
    known: NDArray[np.int16] | None, model: LidarModel | None, azimuth: Angles, slope: Angles, range_m: Angles
) -> tuple[NDArray[np.int16], int, Source]:
    """Return the ring of each point, the number of rings and where they come from."""
    if known is not None:
        rings = int(known.max(initial=0)) + 1
        return known, rings if model is None else max(rings, model.rings), "file"
    ordered = rings_by_order(azimuth, slope)
    if ordered is not None and (model is None or ordered.max() < model.rings):
        return ordered, int(ordered.max()) + 1, "file order"
    if model is not None:
        match = match_beams(slope, range_m, model)
        if match.excess >= EXPLAINED:
            return match.ring, model.rings, "beam table"
    else:
        clustered = rings_by_clusters(azimuth, slope, range_m)
        if clustered is not None:
            return clustered[0], len(clustered[1].elevation), "elevation clusters"
    return *_elevation_bins(slope, range_m, model), "elevation bins"


def rings_by_order(azimuth: Angles, slope: Angles) -> NDArray[np.int16] | None:
    """Return the rings told by the order of the points, or None where they are not stored ring after ring.

    Rings begin behind or before the sensor. Counted from the wrong side each holds halves of two, and its slope changes
    by a whole step on the way: the rings whose slope changes less are right.
    """
    best, least = None, np.inf
    for start in (0.0, np.pi):
        for turn in (1.0, -1.0):
            ring, rings, backward, upward = order_rings(azimuth, slope, start, turn)
            if rings < 4 or backward > 0.03 * len(azimuth) or max(upward, 1 - upward) < 0.7:
                continue
            medians = ring_medians(ring, slope, rings)
            medians = medians[np.isfinite(medians)]
            steps = np.diff(medians)
            rising = float((steps > 0).mean())
            # Two sensors one after the other rise twice.
            once = np.abs(steps).sum() <= _MOST_WAY * abs(medians[-1] - medians[0])
            change = _change_within(ring, slope) / np.median(np.abs(steps))
            if change < least and once and max(rising, 1 - rising) >= 0.9:
                ascending: NDArray[np.int16] = ring if rising > 0.5 else (rings - 1 - ring).astype(np.int16)
                best, least = ascending, change
                if change < _LITTLE:
                    return best
    return best


def _change_within(ring: NDArray[np.int16], slope: Angles) -> float:
    """Return how much the slope changes, in the median ring, from a quarter of its returns to three quarters."""
    starts = np.append(0, np.flatnonzero(np.diff(ring)) + 1)
    sizes = np.diff(starts, append=len(ring))
    return float(np.median(np.abs(slope[starts + sizes // 4] - slope[starts + 3 * sizes // 4])))


def _elevation_bins(slope: Angles, range_m: Angles, model: LidarModel | None) -> tuple[NDArray[np.int16], int]:
    """Return pseudo-rings and their number: the model's nearest beams, else bins with equally many returns each."""
    edges = np.zeros(0)
    if model is not None:
        edges = np.tan((model.elevation[1:] + model.elevation[:-1]) / 2)
    elif (range_m > 0).any():
        ascending = np.sort(slope[range_m > 0])
        edges = np.unique(ascending[np.arange(1, PSEUDO_RINGS) * len(ascending) // PSEUDO_RINGS])
    ring = np.where(range_m > 0, np.searchsorted(edges, slope, side="right"), -1).astype(np.int16)
    return ring, len(edges) + 1


def _columns(
    azimuth: Angles, ring: NDArray[np.int16], range_m: Angles, model: LidarModel | None, source: Source
) -> int:
    """Return the columns of a revolution: measured, else the model's, else ``DEFAULT_COLUMNS``."""
    fallback = DEFAULT_COLUMNS if model is None else model.azimuth_columns
    used = (ring >= 0) & (range_m > NEAR_M)
    if source == "elevation bins" or not used.any():
        return fallback
    sizes = np.bincount(ring[used])
    fullest = np.argsort(-sizes, kind="stable")[:_SAMPLED_RINGS]
    sampled = [np.sort(azimuth[used & (ring == r)]).astype(np.float64) for r in fullest]
    pooled = np.diff(np.sort(np.concatenate(sampled)))
    step = _firing_step(np.concatenate([np.diff(a) for a in sampled]), pooled, model)
    return fallback if step is None else int(np.clip(round(2 * np.pi / step), 4, 36_000))


def _firing_step(own: NDArray[np.float64], pooled: NDArray[np.float64], model: LidarModel | None) -> float | None:
    """Return the azimuth step behind the gaps within rings (``own``) and in several rings taken together (``pooled``).

    The mean of the gaps within a quarter of the most frequent one. Where firing is irregular (CARLA's overlaid
    revolutions leave gaps in all rings at once) it is the gap that 90 % of the angle does not exceed, so that columns
    are not empty between firings, unless the model knows the step within 5 %. None for fewer than 16 gaps.
    """
    width = np.deg2rad(0.01)
    own, pooled = (gaps[(gaps > 3 * width) & (gaps < 300 * width)] for gaps in (own, pooled))
    if len(own) < 16:
        return None
    peak = np.convolve(np.bincount((own / width).astype(np.intp)), [1, 1, 1], "same").argmax()
    mode = float(np.median(own[np.abs(own - (peak + 0.5) * width) <= 1.5 * width]))
    step = float(own[np.abs(own - mode) < mode / 4].mean())
    if model is not None and abs(step / model.azimuth_step - 1) < 0.05:
        return step
    pooled = np.sort(pooled)
    widest = float(pooled[np.searchsorted(np.cumsum(pooled), 0.9 * pooled.sum())]) if len(pooled) else step
    return widest if widest > 1.3 * step else step


def _elevations(
    ring: NDArray[np.int16], slope: Angles, range_m: Angles, rings: int, model: LidarModel | None
) -> NDArray[np.float64]:
    """Return (rings,) median elevations; the model's, or interpolated, where a ring has no return beyond 1 m."""
    medians = np.arctan(ring_medians(ring, np.where(range_m > NEAR_M, slope, np.float32(np.nan)), rings))
    seen = np.isfinite(medians)
    if model is not None and model.rings == rings:
        return np.where(seen, medians, model.elevation).astype(np.float64)
    if not seen.any():
        return np.zeros(rings)
    index = np.arange(rings)
    return np.asarray(np.interp(index, index[seen], medians[seen]), np.float64)
