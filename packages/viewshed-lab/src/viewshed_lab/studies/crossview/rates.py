"""Cross-view truth: posed sweeps of a static scene show what another sweep of it should have seen.

This truth needs no estimator: a tall column that sweep B sees is either shown or missed by sweep A, which is a known
answer about A's field of view. Rates: ``over`` = P(claimed visible | A does not see the column), ``under`` =
P(not claimed visible | A sees it).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import binomtest

from viewshed.fov.estimate import FovEstimator
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep

OnStep = Callable[[str], None]
"""Is called with the name of the next step."""


# Selection of columns; all heights are in meters above each sweep's own local ground.
BODY_M, BODY_RETURNS = (0.5, 1.5), 3  # a column needs at least this many returns of B between these heights
TOP_M = (1.1, 2.2)  # and at least one return between these, so that it is about as tall as a car
# A column counts as not seen only if another sweep has a return near it between these heights, so that A's beams cannot
# pass below it as they do below a bus, ...
FOOT_M = (0.1, 0.3)
ACROSS_M = 0.9  # ... and only if there are columns this far to its left and right: a target, not a post beside a gap
RANGE_A_M, RANGE_B_M = (4.0, 45.0), (3.0, 50.0)  # distance of the column from A and from B
STATIC_S = 0.7  # another sweep, at least this many seconds from B, must see it too, or it may have moved
TOGETHER_S = 0.02  # columns that B measured within this time of A need no such second sweep
NEAR_M = 0.5  # returns within this distance of the column's center belong to it
SEEN_M, SEEN_RETURNS = (0.2, 1.7), 2  # A sees a column with at least this many returns between these heights
CLEAR_M = 1.5  # A does not see a column without a return between those heights within this distance
COVERAGE = 3  # minimum number of returned beams of A that aim at the column
# A column has moved or is transparent if at least this share (and at least two) of those beams end more than this
# distance behind it; it is dropped.
THROUGH_SHARE, THROUGH_M = 0.3, 1.0


@dataclass(frozen=True, slots=True, eq=False)
class SeenColumns:
    """Cross-view truth of a sweep A: columns in its ``level`` frame, and whether it sees each."""

    xy: NDArray[np.float64]  # (M, 2) meters
    seen: NDArray[np.bool_]  # (M,) bool: A sees the column
    through: NDArray[np.bool_]  # (M,) bool: not seen, but A's beams pass it (moved or transparent); not in ``over``

    @property
    def hidden(self) -> NDArray[np.bool_]:
        """(M,) bool: A does not see the column, and its beams do not pass it."""
        return ~self.seen & ~self.through


CrossViewTruth = Sequence[tuple[Sweep, SeenColumns]]
"""Sweeps, each with its columns known from the other sweeps of its scene."""


@dataclass(frozen=True, slots=True)
class ColumnRate:
    """A rate, its 95 % interval, and its number of columns.

    The interval is the union of a bootstrap over sweeps and the exact binomial one (Clopper and Pearson 1934): without
    any error among a few columns, the bootstrap alone would have zero width.
    """

    value: float
    low: float
    high: float
    columns: int


@dataclass(frozen=True, slots=True)
class CrossViewRow:
    """One estimator's rates: over-claim, under-claim, over-claim with no column dropped, and the share dropped."""

    method: str
    over: ColumnRate
    under: ColumnRate
    over_unfiltered: ColumnRate
    dropped_share: float


@dataclass(frozen=True, slots=True, eq=False)
class _TallColumns:
    """Columns of one sweep that are as tall as the target, and the other sweeps that see them."""

    sweep: LeveledSweep
    feet: NDArray[np.float64]  # (M, 3) on the ground, in the sweep's ``level`` frame
    # sweeps of another time, each with the mask (M,) of columns that it sees too
    witnesses: Sequence[tuple[LeveledSweep, NDArray[np.bool_]]]

    @classmethod
    def of(cls, b: LeveledSweep, scene: Sequence[LeveledSweep]) -> _TallColumns:
        """Return the columns of one sweep of a scene; all sweeps need poses and times."""
        xy, witnesses = _tall_columns(b), list[tuple[LeveledSweep, NDArray[np.bool_]]]()
        for c in (c for c in scene if _seconds_apart(b, c) >= STATIC_S):
            witnesses.append((c, _shows(c, BODY_M, b, xy)))
        return cls(b, np.column_stack([xy, b.ground.at(xy)]), witnesses)

    def known_to(self, a: LeveledSweep) -> NDArray[np.float64]:
        """Return the static columns (M, 2) in A's level frame: seen at the time of A, or at two times."""
        static = np.full(len(self.feet), _seconds_apart(a, self.sweep) <= TOGETHER_S)
        for c, sees in self.witnesses:
            if c is not a:
                static |= sees
        if not static.any():
            return np.empty((0, 2))
        columns: NDArray[np.float64] = (_between(a, self.sweep) @ self.feet[static])[:, :2]
        range_a = np.hypot(columns[:, 0], columns[:, 1])
        return columns[(range_a > RANGE_A_M[0]) & (range_a < RANGE_A_M[1])]


def _columns_of(a: LeveledSweep, scene: Sequence[_TallColumns]) -> SeenColumns:
    """Return the truth of ``a`` from the columns of the other sweeps of a scene."""
    others = [tall.sweep for tall in scene if tall.sweep is not a]
    columns = [xy for tall in scene if tall.sweep is not a for xy in [tall.known_to(a)] if len(xy)]
    if not columns:
        return SeenColumns(np.empty((0, 2)), np.empty(0, bool), np.empty(0, bool))
    # Round to a lattice of 0.25 m and remove duplicates.
    xy = np.unique(np.round(np.concatenate(columns) / 0.25), axis=0) * 0.25
    tree = cKDTree(_returns(a, SEEN_M)[:, :2].astype(np.float64).reshape(-1, 2))
    near = _counts(tree, xy, NEAR_M)
    # Its foot must be seen by any other sweep.
    on_ground = np.any([_shows(b, FOOT_M, a, xy) for b in others], axis=0)
    clear = (_counts(tree, xy, CLEAR_M) == 0) & on_ground & _as_wide_as_target(xy)
    seen = near >= SEEN_RETURNS
    aimed, through = _aimed_and_through(a, xy)
    known = (seen | clear) & (aimed >= COVERAGE)
    passes = (through >= 2) & (through >= THROUGH_SHARE * aimed) & ~seen
    return SeenColumns(xy[known], seen[known], passes[known])


def _returns(b: LeveledSweep, height_m: tuple[float, float]) -> NDArray[np.float32]:
    """Return the returns (N, 3) of a sweep between two heights."""
    return b.points[(b.height_m > height_m[0]) & (b.height_m < height_m[1])]


def _shows(
    b: LeveledSweep, height_m: tuple[float, float], a: LeveledSweep, xy: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return the mask (M,) of places (M, 2) in A's level frame where ``b`` has a return between two heights."""
    in_a = _between(a, b) @ _returns(b, height_m)
    return _counts(cKDTree(in_a[:, :2].reshape(-1, 2)), xy, NEAR_M) > 0


def _as_wide_as_target(xy: NDArray[np.float64]) -> NDArray[np.bool_]:
    tree = cKDTree(xy)
    left = np.column_stack([-xy[:, 1], xy[:, 0]]) / np.hypot(xy[:, 0], xy[:, 1])[:, None] * ACROSS_M
    return (_counts(tree, xy + left, NEAR_M) > 0) & (_counts(tree, xy - left, NEAR_M) > 0)


def _tall_columns(b: LeveledSweep) -> NDArray[np.float64]:
    """Return the columns (M, 2) of ``b`` that are as tall as the target, in its level frame."""
    grid = BevGrid(round(4 * RANGE_B_M[1]), RANGE_B_M[1])
    range_b = np.hypot(grid.centers[..., 0], grid.centers[..., 1])
    enough = (range_b > RANGE_B_M[0]) & (range_b < RANGE_B_M[1])
    enough &= grid.count(_returns(b, BODY_M)) >= BODY_RETURNS
    enough &= grid.count(_returns(b, TOP_M)) >= 1
    return grid.centers[enough]


def _between(to: LeveledSweep, source: LeveledSweep) -> Any:
    """Return the transform from the level frame of ``source`` to that of ``to``."""
    to_pose, source_pose = to.world_from_level, source.world_from_level
    if to_pose is None or source_pose is None:
        raise ValueError("cross-view truth needs the pose of every sweep (world_from_sensor)")
    return to_pose.inverse() @ source_pose


def _seconds_apart(b: LeveledSweep, c: LeveledSweep) -> float:
    if b.sweep.t_ns is None or c.sweep.t_ns is None:
        raise ValueError("cross-view truth needs the time of every sweep (t_ns)")
    return abs(b.sweep.t_ns - c.sweep.t_ns) * 1e-9


def _counts(tree: Any, xy: NDArray[np.float64], radius_m: float) -> NDArray[np.intp]:
    if tree.n == 0:
        return np.zeros(len(xy), np.intp)
    counts: NDArray[np.intp] = tree.query_ball_point(xy, radius_m, return_length=True)
    return counts


def _aimed_and_through(a: LeveledSweep, xy: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the number (M,) of returned beams of ``a`` that aim at each column, and of those ending well behind it."""
    beams = a.beams()
    order = np.argsort(beams.azimuth, kind="stable")
    # float64 like the searched values; otherwise searchsorted converts all beams at each call.
    azimuth = beams.azimuth[order].astype(np.float64)
    slope, depth = beams.slope[order], beams.depth_m[order]
    ground = a.ground.at(xy) - a.sensor_height_m
    aimed, through = np.zeros(len(xy), np.intp), np.zeros(len(xy), np.intp)
    for n, (x, y) in enumerate(xy):
        r = float(np.hypot(x, y))
        middle, half = np.arctan2(y, x), np.arctan2(NEAR_M / 2, r)
        for turn in (-2 * np.pi, 0.0, 2 * np.pi):
            i, j = np.searchsorted(azimuth, [middle - half + turn, middle + half + turn])
            height = slope[i:j] * r - ground[n]
            hits = (height > SEEN_M[0]) & (height < SEEN_M[1])
            aimed[n] += hits.sum()
            through[n] += (hits & (depth[i:j] > r + THROUGH_M)).sum()
    return aimed, through


def evaluate_crossview(
    sequences: Sequence[Sequence[Sweep]], estimators: Mapping[str, FovEstimator], *, rng: np.random.Generator
) -> list[CrossViewRow]:
    """Return one row of rates per estimator, over all sweeps of all sequences (each a static scene)."""
    return rows_of(crossview_truth(sequences), estimators, rng=rng)


def crossview_truth(
    sequences: Sequence[Sequence[Sweep]], on_step: OnStep = lambda _: None
) -> list[tuple[Sweep, SeenColumns]]:
    """Return each sweep of all sequences with its truth from the other sweeps; see :func:`evaluate_crossview`."""
    truth: list[tuple[Sweep, SeenColumns]] = []
    for sweeps in sequences:
        levels = [level(sweep, BevGrid(256, 64.0)) for sweep in sweeps]
        scene = [_TallColumns.of(b, levels) for b in levels]
        for a in levels:
            on_step(f"truth of sweep {len(truth) + 1}")
            truth.append((a.sweep, _columns_of(a, scene)))
    return truth


def rows_of(
    truth: CrossViewTruth,
    estimators: Mapping[str, FovEstimator],
    *,
    rng: np.random.Generator,
    on_step: OnStep = lambda _: None,
    shown: Callable[[Sweep], Sweep] = lambda sweep: sweep,
) -> list[CrossViewRow]:
    """Return one row of rates per estimator against a truth of :func:`crossview_truth`.

    ``shown`` changes a sweep before it is estimated, for example by an attack; the truth is of the original sweep.
    """
    changed = [(shown(sweep), columns) for sweep, columns in truth]
    rows = []
    for method, estimator in estimators.items():
        on_step(method)
        rows.append(_row(method, estimator, changed, rng))
    return rows


def _row(method: str, estimator: FovEstimator, truth: CrossViewTruth, rng: np.random.Generator) -> CrossViewRow:
    counts = np.zeros((len(truth), 3, 2))
    dropped = unseen = 0
    for n, (sweep, columns) in enumerate(truth):
        estimate = estimator.estimate(sweep)
        claimed = np.nan_to_num(estimate.at(columns.xy)) >= 0.5
        for k, (wrong, base) in enumerate(
            (
                (claimed & columns.hidden, columns.hidden),
                (~claimed & columns.seen, columns.seen),
                (claimed & ~columns.seen, ~columns.seen),
            )
        ):
            counts[n, k] = wrong.sum(), base.sum()
        dropped += int(columns.through.sum())
        unseen += int((~columns.seen).sum())
    picks = rng.integers(0, len(truth), (2000, len(truth)))
    rates = [_rate(counts[:, k], picks) for k in range(3)]
    return CrossViewRow(method, rates[0], rates[1], rates[2], dropped / max(unseen, 1))


def _rate(counts: NDArray[np.float64], picks: NDArray[np.intp]) -> ColumnRate:
    total = counts.sum(axis=0)
    if total[1] == 0:
        return ColumnRate(float("nan"), float("nan"), float("nan"), 0)
    sums = counts[picks].sum(axis=1)
    low, high = np.quantile(sums[sums[:, 1] > 0, 0] / sums[sums[:, 1] > 0, 1], [0.025, 0.975])
    wrong, columns = (int(count) for count in total)
    exact = binomtest(wrong, columns).proportion_ci(0.95)
    return ColumnRate(wrong / columns, min(float(low), exact.low), max(float(high), exact.high), columns)
