"""Cross-view truth: what one posed sweep sees of a static scene tells what another one should have seen.

No estimator makes this truth: a column that sweep B sees, and that sweep A must either show or miss, is a known
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
"""Is called with what is done next."""


@dataclass(frozen=True, slots=True)
class CrossViewRules:
    """How columns are chosen; every length in meters above each sweep's own local ground."""

    body_m: tuple[float, float] = (0.5, 1.5)  # a column needs ``body_returns`` returns of B between these heights
    body_returns: int = 3  # how many
    top_m: tuple[float, float] = (1.1, 2.2)  # and one return between these, so that it is about as tall as a car
    # a column counts as not seen only if another sweep has a return near it between these heights, so that
    # A's beams cannot pass below it as they do below a bus
    foot_m: tuple[float, float] = (0.1, 0.3)
    range_a_m: tuple[float, float] = (4.0, 45.0)  # distance of the column from A
    range_b_m: tuple[float, float] = (3.0, 50.0)  # and from B
    static_s: float = 0.7  # another sweep, this many seconds from B or more, must see it too, or it may have moved
    together_s: float = 0.02  # what B measured within this time of A needs no such witness
    near_m: float = 0.5  # returns within this distance of the column's middle belong to it
    seen_m: tuple[float, float] = (0.2, 1.7)  # A sees the column with ``seen_returns`` returns between these heights
    seen_returns: int = 2  # how many
    clear_m: float = 1.5  # A does not see it if it has no return between those heights within this distance
    coverage: int = 3  # returned beams of A that must aim at the column
    # a column that this share (and at least two) of those beams pass by ``through_m`` has moved or can be
    # seen through, and is dropped
    through_share: float = 0.3
    through_m: float = 1.0  # see there
    # a column counts as not seen only if the scene is as tall this far to its left and right as A looks at
    # it, so that it hides a target and not a post in front of a gap
    across_m: float = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class SeenColumns:
    """What is known of A's view: columns (M, 2) in A's ``level`` frame, and whether A sees each."""

    xy: NDArray[np.float64]  # (M, 2) meters
    seen: NDArray[np.bool_]  # (M,) bool: A sees the column; the others it does not
    through: NDArray[np.bool_]  # (M,) bool: not seen, but A's beams pass it: moved or see-through; left out of ``over``

    @property
    def hidden(self) -> NDArray[np.bool_]:
        """(M,) bool: A does not see the column; those that its beams pass are left out."""
        return ~self.seen & ~self.through


CrossViewTruth = Sequence[tuple[Sweep, SeenColumns]]
"""Sweeps, each with what the others of its scene know about its view."""


@dataclass(frozen=True, slots=True)
class ColumnRate:
    """A rate, its 95 % interval, and how many columns it rests on.

    The interval is the wider of a bootstrap over sweeps and the exact binomial one (Clopper and Pearson 1934): with
    no error among a few columns the bootstrap alone would claim certainty.
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
    """What one sweep sees that is as tall as the target, and who sees it as well."""

    sweep: LeveledSweep
    feet: NDArray[np.float64]  # (M, 3) on the ground, in the sweep's ``level`` frame
    # sweeps of another time, each with which of the columns (M,) it sees too
    witnesses: Sequence[tuple[LeveledSweep, NDArray[np.bool_]]]

    @classmethod
    def of(cls, b: LeveledSweep, scene: Sequence[LeveledSweep], rules: CrossViewRules) -> _TallColumns:
        """Return the columns of one sweep of a scene; all sweeps need poses and times."""
        xy, witnesses = _tall_columns(b, rules), list[tuple[LeveledSweep, NDArray[np.bool_]]]()
        for c in (c for c in scene if _seconds_apart(b, c) >= rules.static_s):
            body = (c.height_m > rules.body_m[0]) & (c.height_m < rules.body_m[1])
            in_b = _between(b, c) @ c.points[body]
            witnesses.append((c, _counts(cKDTree(in_b[:, :2].reshape(-1, 2)), xy, rules.near_m) > 0))
        return cls(b, np.column_stack([xy, b.ground.at(xy)]), witnesses)

    def known_to(self, a: LeveledSweep, rules: CrossViewRules) -> NDArray[np.float64]:
        """Return the columns (M, 2), in A's level frame, that stand still: seen at the time of A, or twice."""
        static = np.full(len(self.feet), _seconds_apart(a, self.sweep) <= rules.together_s)
        for c, sees in self.witnesses:
            if c is not a:
                static |= sees
        if not static.any():
            return np.empty((0, 2))
        columns: NDArray[np.float64] = (_between(a, self.sweep) @ self.feet[static])[:, :2]
        range_a = np.hypot(columns[:, 0], columns[:, 1])
        return columns[(range_a > rules.range_a_m[0]) & (range_a < rules.range_a_m[1])]


def _columns_of(a: LeveledSweep, scene: Sequence[_TallColumns], rules: CrossViewRules) -> SeenColumns:
    """Return the columns that the other sweeps of a scene know about the view of ``a``."""
    others = [tall.sweep for tall in scene if tall.sweep is not a]
    found = [xy for tall in scene if tall.sweep is not a for xy in [tall.known_to(a, rules)] if len(xy)]
    if not found:
        return SeenColumns(np.empty((0, 2)), np.empty(0, bool), np.empty(0, bool))
    # Places on a lattice of 0.25 m, each once.
    xy = np.unique(np.round(np.concatenate(found) / 0.25), axis=0) * 0.25
    band = (a.height_m > rules.seen_m[0]) & (a.height_m < rules.seen_m[1])
    tree = cKDTree(a.points[band, :2].astype(np.float64).reshape(-1, 2))
    near = _counts(tree, xy, rules.near_m)
    clear = (_counts(tree, xy, rules.clear_m) == 0) & _standing(a, others, xy, rules) & _as_wide_as_target(xy, rules)
    seen = near >= rules.seen_returns
    aimed, through = _aimed_and_through(a, xy, rules)
    known = (seen | clear) & (aimed >= rules.coverage)
    passes = (through >= 2) & (through >= rules.through_share * aimed) & ~seen
    return SeenColumns(xy[known], seen[known], passes[known])


def _standing(
    a: LeveledSweep, others: Sequence[LeveledSweep], xy: NDArray[np.float64], rules: CrossViewRules
) -> NDArray[np.bool_]:
    """Return which columns (M,) at ``xy`` stand on the ground: a foot of them that any other sweep saw is enough."""
    standing = np.zeros(len(xy), bool)
    for b in others:
        foot = (b.height_m > rules.foot_m[0]) & (b.height_m < rules.foot_m[1])
        in_a = _between(a, b) @ b.points[foot]
        standing |= _counts(cKDTree(in_a[:, :2].reshape(-1, 2)), xy, rules.near_m) > 0
    return standing


def _as_wide_as_target(xy: NDArray[np.float64], rules: CrossViewRules) -> NDArray[np.bool_]:
    tree = cKDTree(xy)
    left = np.column_stack([-xy[:, 1], xy[:, 0]]) / np.hypot(xy[:, 0], xy[:, 1])[:, None] * rules.across_m
    return (_counts(tree, xy + left, rules.near_m) > 0) & (_counts(tree, xy - left, rules.near_m) > 0)


def _tall_columns(b: LeveledSweep, rules: CrossViewRules) -> NDArray[np.float64]:
    """Return the columns (M, 2) of ``b`` that are as tall as the target."""
    grid = BevGrid(round(4 * rules.range_b_m[1]), rules.range_b_m[1])
    range_b = np.hypot(grid.centers[..., 0], grid.centers[..., 1])
    enough = (range_b > rules.range_b_m[0]) & (range_b < rules.range_b_m[1])
    enough &= _between_heights(b, grid, rules.body_m) >= rules.body_returns
    enough &= _between_heights(b, grid, rules.top_m) >= 1
    return grid.centers[enough]


def _between_heights(b: LeveledSweep, grid: BevGrid, height_m: tuple[float, float]) -> NDArray[np.int32]:
    return grid.count(b.points[(b.height_m > height_m[0]) & (b.height_m < height_m[1])])


def _between(to: LeveledSweep, of: LeveledSweep) -> Any:
    to_pose, of_pose = to.world_from_level, of.world_from_level
    if to_pose is None or of_pose is None:
        raise ValueError("cross-view truth needs the pose of every sweep (world_from_sensor)")
    return to_pose.inverse() @ of_pose


def _seconds_apart(b: LeveledSweep, c: LeveledSweep) -> float:
    if b.sweep.t_ns is None or c.sweep.t_ns is None:
        raise ValueError("cross-view truth needs the time of every sweep (t_ns)")
    return abs(b.sweep.t_ns - c.sweep.t_ns) * 1e-9


def _counts(tree: Any, xy: NDArray[np.float64], radius_m: float) -> NDArray[np.intp]:
    if tree.n == 0:
        return np.zeros(len(xy), np.intp)
    counts: NDArray[np.intp] = tree.query_ball_point(xy, radius_m, return_length=True)
    return counts


def _aimed_and_through(
    a: LeveledSweep, xy: NDArray[np.float64], rules: CrossViewRules
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return how many returned beams of ``a`` aim at each column, and how many of them end well behind it."""
    beams = a.beams()
    order = np.argsort(beams.azimuth, kind="stable")
    # In double precision, as what is looked up: else each look-up would convert all beams.
    azimuth = beams.azimuth[order].astype(np.float64)
    slope, depth = beams.slope[order], beams.depth_m[order]
    ground = a.ground.at(xy) - a.sensor_height_m
    aimed, through = np.zeros(len(xy), np.intp), np.zeros(len(xy), np.intp)
    for n, (x, y) in enumerate(xy):
        r = float(np.hypot(x, y))
        middle, half = np.arctan2(y, x), np.arctan2(rules.near_m / 2, r)
        for turn in (-2 * np.pi, 0.0, 2 * np.pi):
            i, j = np.searchsorted(azimuth, [middle - half + turn, middle + half + turn])
            height = slope[i:j] * r - ground[n]
            hits = (height > rules.seen_m[0]) & (height < rules.seen_m[1])
            aimed[n] += hits.sum()
            through[n] += (hits & (depth[i:j] > r + rules.through_m)).sum()
    return aimed, through


def evaluate_crossview(
    sequences: Sequence[Sequence[Sweep]],
    estimators: Mapping[str, FovEstimator],
    *,
    rng: np.random.Generator,
    on_step: OnStep = lambda _: None,
) -> list[CrossViewRow]:
    """Return one row of rates for each estimator, over all sweeps of all sequences (each a static scene)."""
    return rows_of(crossview_truth(sequences, on_step), estimators, rng=rng, on_step=on_step)


def crossview_truth(
    sequences: Sequence[Sequence[Sweep]], on_step: OnStep = lambda _: None
) -> list[tuple[Sweep, SeenColumns]]:
    """Return each sweep of all sequences with what the others of its scene know; see :func:`evaluate_crossview`."""
    truth: list[tuple[Sweep, SeenColumns]] = []
    for sweeps in sequences:
        rules, levels = CrossViewRules(), [level(sweep, BevGrid(256, 64.0)) for sweep in sweeps]
        scene = [_TallColumns.of(b, levels, rules) for b in levels]
        for a in levels:
            on_step(f"truth of sweep {len(truth) + 1}")
            truth.append((a.sweep, _columns_of(a, scene, rules)))
    return truth


def rows_of(
    truth: CrossViewTruth,
    estimators: Mapping[str, FovEstimator],
    *,
    rng: np.random.Generator,
    on_step: OnStep = lambda _: None,
    shown: Callable[[Sweep], Sweep] = lambda sweep: sweep,
) -> list[CrossViewRow]:
    """Return one row of rates for each estimator against the truth of some sweeps, of :func:`crossview_truth`.

    ``shown`` returns what estimators are shown of a sweep, perhaps attacked; the truth is of the sweep itself.
    """
    seen = [(shown(sweep), columns) for sweep, columns in truth]
    rows = []
    for method, estimator in estimators.items():
        on_step(method)
        rows.append(_row(method, estimator, seen, rng))
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
