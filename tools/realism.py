"""How much simulated sweeps look like real ones: statistics of a sweep, and whether two sets of them agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import NULL_RANGE_M, level
from viewshed.preprocess.ring_recovery import RingAssignment, recover_rings
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

RANGE_EDGES_M = (0.0, 2.5, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, np.inf)
"""Horizontal ranges at which returns are counted."""

HEIGHT_EDGES_M = (-np.inf, -0.3, 0.3, 1.0, 2.0, 3.0, 5.0, 8.0, np.inf)
"""Heights above local ground at which returns are counted."""

ROAD_EDGES_M = (4.0, 6.0, 8.0, 10.0, 13.0, 16.0, 20.0, 25.0, 32.0, 40.0, 85.0)
"""Ranges at which beams meet level ground."""

_HORIZON = -0.012

_EVEN_M = 0.35

_ROAD = BevGrid(256, 64.0)

_SMOOTH_M = (3.0, 25.0)

_SMOOTH_STEP_M = 0.15

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SweepStatistics:
    """What a sweep looks like from far away; returns of the vehicle itself and null returns are left out.

    Attributes:
        rings: (rings,) returns of each ring, lowest first, divided by the firings of a revolution: the columns that
            the returns show, or the returns of the fullest ring where those are more.
        ranges: (11,) share of the returns between :data:`RANGE_EDGES_M`.
        heights: (8,) share of the returns between :data:`HEIGHT_EDGES_M` above local ground.
        occupied: (1,) cells of the grid with a return.
        returns: (1,) returns divided by the beams of a revolution.
    """

    rings: Floats
    ranges: Floats
    heights: Floats
    occupied: Floats
    returns: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """How far a set of simulated sweeps lies from real ones in one statistic.

    Attributes:
        real: (k,) mean over the real sweeps.
        low: (k,) least of them.
        high: (k,) greatest of them.
        simulated: (k,) mean over the simulated sweeps.
        distance: half the sum of the absolute differences of two histograms; their mean for rings; the absolute
            difference of two numbers.
        spread: the greatest such distance of one real sweep from the mean of the others, 0 where there is but one.
    """

    real: Floats
    low: Floats
    high: Floats
    simulated: Floats
    distance: float
    spread: float

    @property
    def within(self) -> bool:
        """Whether the simulated mean lies among the real sweeps.

        A number: between the least and the greatest. A histogram: no farther from the real mean than the farthest real
        sweep from the mean of the others.
        """
        return self.inside_share == 1.0 if len(self.real) == 1 else self.distance <= self.spread

    @property
    def inside_share(self) -> float:
        """Share of the k entries whose simulated mean lies between the least and the greatest real one."""
        return float(np.mean((self.simulated >= self.low) & (self.simulated <= self.high)))


def sweep_statistics(sweep: Sweep, grid: BevGrid, model: LidarModel | None = None) -> SweepStatistics:
    """Return the statistics of ``sweep``, with its cells on ``grid`` and its rings by ``model`` where it has none."""
    beams = recover_rings(sweep, model)
    leveled = level(sweep, grid)
    ring = beams.ring[leveled.rows]
    firings = _firings(beams)
    count = max(len(leveled.rows), 1)
    # Ranges and heights beyond the last edge are counted in the last bin, as the edges are infinite there.
    ranges = np.histogram(leveled.range_m, RANGE_EDGES_M)[0] / count
    heights = np.histogram(leveled.height_m, HEIGHT_EDGES_M)[0] / count
    cells = grid.count(leveled.points) > 0
    return SweepStatistics(
        rings=np.bincount(ring[ring >= 0], minlength=beams.rings) / firings,
        ranges=ranges,
        heights=heights,
        occupied=np.array([float(cells.sum())]),
        returns=np.array([len(leveled.rows) / (firings * beams.rings)]),
    )


def range_noise(sweep: Sweep, model: LidarModel | None = None) -> float:
    """Return the standard deviation in meters of ranges between neighboring columns, NaN where no surface is smooth.

    Taken from the second differences along a ring where three columns between 3 and 25 m lie within 15 cm: their median
    absolute value is 0.6745 √6 standard deviations of normal noise; what surfaces bend is counted, too.
    """
    beams = recover_rings(sweep, model)
    range_m = np.linalg.norm(sweep.points, axis=1)
    keep = (beams.ring >= 0) & (range_m > _SMOOTH_M[0]) & (range_m < _SMOOTH_M[1])
    image = np.full((beams.rings, beams.columns), np.nan)
    image[beams.ring[keep], beams.column[keep]] = range_m[keep]
    before, here, after = image[:, :-2], image[:, 1:-1], image[:, 2:]
    bend = np.abs(before - 2 * here + after)[np.abs(after - before) < _SMOOTH_STEP_M]
    bend = bend[np.isfinite(bend)]
    return float(np.median(bend) / (0.6745 * np.sqrt(6))) if bend.size else float("nan")


def road_seen(sweeps: Sequence[Sweep], model: LidarModel, sensor_height_m: float) -> Floats:
    """Return the share (10,) of beams that see the road, by where level ground is met (:data:`ROAD_EDGES_M`).

    Of the beams of a ring below the horizon that return from within 0.35 m of the ground or do not return at all, over
    all ``sweeps``; NaN where no ring points. It is what the reach of a sensor's optics is tuned on.
    """
    ground, none = np.zeros(len(ROAD_EDGES_M) - 1), np.zeros(len(ROAD_EDGES_M) - 1)
    downward = model.elevation < _HORIZON
    at_m = sensor_height_m / np.tan(-model.elevation[downward])
    for sweep in sweeps:
        beams, leveled = recover_rings(sweep, model), level(sweep, _ROAD)
        ring = beams.ring[leveled.rows]
        near = (np.abs(leveled.height_m) < _EVEN_M) & (ring >= 0)
        real = (beams.ring >= 0) & (np.linalg.norm(sweep.points, axis=1) > NULL_RANGE_M)
        returned = np.bincount(beams.ring[real], minlength=model.rings)[: model.rings]
        met = np.bincount(ring[near], minlength=model.rings)[: model.rings]
        missed = np.maximum(_firings(beams) - returned, 0)
        ground += np.histogram(at_m, ROAD_EDGES_M, weights=met[downward])[0]
        none += np.histogram(at_m, ROAD_EDGES_M, weights=missed[downward])[0]
    with np.errstate(invalid="ignore"):
        return np.asarray(ground / (ground + none))


def _firings(beams: RingAssignment) -> int:
    return max(beams.columns, int(np.bincount(beams.ring[beams.ring >= 0], minlength=1).max()))


def agreement(name: str, real: Sequence[SweepStatistics], simulated: Sequence[SweepStatistics]) -> Agreement:
    """Return how well ``simulated`` agrees with ``real`` in the statistic called ``name``.

    Raises:
        ValueError: a side is empty.
    """
    if not real or not simulated:
        raise ValueError(f"agreement needs sweeps on both sides, got {len(real)} real and {len(simulated)} simulated")
    rows = np.array([getattr(one, name) for one in real])
    mean = np.mean([getattr(one, name) for one in simulated], axis=0)
    others = [np.delete(rows, k, axis=0).mean(axis=0) for k in range(len(rows))] if len(rows) > 1 else [rows[0]]
    return Agreement(
        real=rows.mean(axis=0),
        low=rows.min(axis=0),
        high=rows.max(axis=0),
        simulated=mean,
        distance=_distance(name, mean, rows.mean(axis=0)),
        spread=max(_distance(name, row, other) for row, other in zip(rows, others, strict=True)),
    )


def _distance(name: str, one: Floats, other: Floats) -> float:
    total = float(np.abs(one - other).sum())
    return total / 2 if name in ("ranges", "heights") else total / len(one)
