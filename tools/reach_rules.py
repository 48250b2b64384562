"""Hold rules for the reach without a table against each other.

    python tools/reach_rules.py docs/results/reach_rules.md

On the training set the rule is chosen, on the development set it is confirmed. Sweeps are told nothing but points.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed import CAR
from viewshed._page import facts, page, table
from viewshed.datasets.wild import wild_scenes
from viewshed.fov.estimate import THRESHOLD
from viewshed.fov.visibility import Target
from viewshed.grid import polar_of_cells
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.leveling import Held, LeveledSweep, level
from viewshed.preprocess.reach import LEAST_REACH_M, USUAL_REACH_M, sensing_reach
from viewshed.sim.lidar.optics import optics_of

Floats = NDArray[np.float32]

SETS = {"training": 3, "development": 1}
"""Sets, and every how manieth of their scenes is taken."""

BINS = 10
"""Bins of the calibration error."""

TARGET: Target = CAR

Rule = Callable[[Floats, Floats], float]
"""Reach in meters of the ranges (N,) and azimuths (N,) of the supported returns."""

_ABOUT = """\
Road, car, `shadow_map`, sweeps told nothing but points; every {training}rd scene of the training set, all of the
development set. *Beyond*: share of the claimed area that lies beyond the true reach. *F1 with it*: that area counted as
falsely claimed. *Reach / true reach*: median and range of the middle 80 % of the sweeps whose sensor is not known.
*Added, removed*: how far 150 returns move the reach, in the median sweep and in one of ten, clouds of 5,000 and more:
the worst of walls at 60 m and 200 m, in a wedge of 30° and all around; the worst of the farthest 150 removed, in such a
wedge and all around.

*Mean of usual and …, 2 : 1*: the geometric mean, in which 65 m count twice and the rule once. *Sectors*: 72 of 5°; of
each its n-th farthest return, of these the median. The rule was chosen on the training set."""


def quantile_rule(share: float, times: float) -> Rule:
    """Return so many times a quantile of the ranges."""
    return lambda range_m, azimuth: times * float(np.quantile(range_m, share))


def sector_rule(farthest: int, times: float) -> Rule:
    """Return so many times the median over 72 sectors of a sector's n-th farthest return.

    Where fewer than 18 sectors have so many returns: 2.5 times the 90 % quantile.
    """

    def reach(range_m: Floats, azimuth: Floats) -> float:
        sector = (((azimuth + np.pi) * (72 / (2 * np.pi))).astype(np.intp)) % 72
        order = np.lexsort((range_m, sector))
        counts = np.bincount(sector, minlength=72)
        full = counts >= farthest
        if np.count_nonzero(full) < 18:
            return BULK(range_m, azimuth)
        return times * float(np.median(range_m[order][(np.cumsum(counts) - farthest)[full]]))

    return reach


def larger(one: Rule, other: Rule) -> Rule:
    """Return the larger of two rules' reach."""
    return lambda range_m, azimuth: max(one(range_m, azimuth), other(range_m, azimuth))


def tempered(rule: Rule, weight: float) -> Rule:
    """Return the geometric mean of a rule's reach, with a weight, and of the usual one, with the rest."""
    return lambda range_m, azimuth: float(USUAL_REACH_M ** (1 - weight) * rule(range_m, azimuth) ** weight)


BULK = quantile_rule(0.9, 2.5)

RULES: dict[str, Rule] = {
    "no bound": lambda range_m, azimuth: np.inf,
    f"{USUAL_REACH_M:.0f} m for all": lambda range_m, azimuth: USUAL_REACH_M,
    "2.5 × 90 % quantile (before)": BULK,
    "3.5 × 90 % quantile": quantile_rule(0.9, 3.5),
    "2 × 95 % quantile": quantile_rule(0.95, 2.0),
    "sectors, 2.5 × 8th farthest": sector_rule(8, 2.5),
    "sectors, 3 × 24th farthest": sector_rule(24, 3.0),
    "sectors, 4 × 48th farthest": sector_rule(48, 4.0),
    "larger of sectors (8th) and before": larger(BULK, sector_rule(8, 2.5)),
    "larger of sectors (24th) and before": larger(BULK, sector_rule(24, 3.0)),
    "mean of usual and sectors (8th), 1 : 1": tempered(sector_rule(8, 2.5), 1 / 2),
    "mean of usual and sectors (48th), 1 : 1": tempered(sector_rule(48, 4.0), 1 / 2),
    "mean of usual and sectors (48th), 2 : 1": tempered(sector_rule(48, 4.0), 1 / 3),
    "mean of usual and 2 × 95 %, 1 : 1": tempered(quantile_rule(0.95, 2.0), 1 / 2),
    "mean of usual and 2 × 95 %, 2 : 1": tempered(quantile_rule(0.95, 2.0), 1 / 3),
    "mean of usual and 2.5 × 90 %, 1 : 1": tempered(BULK, 1 / 2),
    "**mean of usual and 2.5 × 90 %, 2 : 1 (now)**": lambda range_m, azimuth: sensing_reach(
        range_m, np.zeros(len(range_m), np.bool_)
    ),
}


@dataclass(slots=True)
class Found:
    """What a rule gave on a set."""

    cells: NDArray[np.int64] = field(default_factory=lambda: np.zeros(4, np.int64))
    bins: NDArray[np.float64] = field(default_factory=lambda: np.zeros((2, BINS)))
    known: int = 0
    ratios: list[float] = field(default_factory=list)
    added: list[float] = field(default_factory=list)
    removed: list[float] = field(default_factory=list)


def unbounded(leveled: LeveledSweep) -> LeveledSweep:
    """Return the sweep of a sensor that reaches any distance."""
    return replace(leveled, held=Held((), np.inf))


def with_150_more(range_m: Floats, azimuth: Floats, rng: np.random.Generator) -> Iterator[tuple[Floats, Floats]]:
    """Yield ranges and azimuths with a wall of 150 returns, in a wedge of 30° around a return and all around."""
    for at_m in (60.0, 200.0):
        wedge = rng.choice(azimuth) + np.deg2rad(rng.uniform(-15, 15, 150))
        for where in (wedge, rng.choice(azimuth, 150), rng.uniform(-np.pi, np.pi, 150)):
            turned = np.angle(np.exp(1j * where)).astype(np.float32)
            yield np.append(range_m, np.full(150, at_m, np.float32)), np.append(azimuth, turned)


def with_150_fewer(range_m: Floats, azimuth: Floats, rng: np.random.Generator) -> Iterator[tuple[Floats, Floats]]:
    """Yield ranges and azimuths without the farthest 150, of a wedge of 30° around a return and of all."""
    off = np.abs(np.angle(np.exp(1j * (azimuth - rng.choice(azimuth)))))
    for inside in (np.flatnonzero(off < np.deg2rad(15)), np.arange(len(range_m))):
        gone = inside[np.argsort(-range_m[inside])][:150]
        yield np.delete(range_m, gone), np.delete(azimuth, gone)


def evaluate(set_name: str, every: int) -> dict[str, Found]:
    """Return what each rule gives on every so manieth scene of a set."""
    found = {name: Found() for name in RULES}
    for scene in wild_scenes(set_name, "road")[::every]:
        seen = scene.observe(0)
        true_m = min(optics_of(seen.sensor.model).reach_m, seen.sensor.model.max_range_m)
        sample = seen.sample("nothing")
        grid = sample.truth.grid
        leveled = level(sample.sweep, grid)
        image, model = leveled.range_image, leveled.sensor_id.model
        supported = np.ones(len(leveled.rows), np.bool_) if image is None else ~image.isolated[leveled.rows]
        range_m, azimuth = leveled.range_m[supported], leveled.azimuth[supported]
        prob = beam_evidence(unbounded(leveled), grid, TARGET).visible_prob[sample.known]
        cell_m, visible = polar_of_cells(grid)[0][sample.known], sample.truth.visible(TARGET)[sample.known]
        near = cell_m <= true_m
        rng = np.random.default_rng(0)
        more, fewer = list(with_150_more(range_m, azimuth, rng)), list(with_150_fewer(range_m, azimuth, rng))
        for name, rule in RULES.items():
            one = found[name]
            if model is None or model.reach_m is None:
                reach_m = min(_at_least(rule, range_m, azimuth), np.inf if model is None else model.max_range_m)
                one.ratios.append(reach_m / true_m)
            else:
                reach_m = model.reach_m
            bounded = np.where(cell_m <= reach_m, prob, np.minimum(prob, np.nextafter(np.float32(THRESHOLD), 0)))
            claimed = bounded >= THRESHOLD
            beyond = claimed & (cell_m > true_m + grid.cell_m)
            kinds = claimed & visible & near, claimed & ~visible & near, ~claimed & visible & near, beyond
            one.cells += [int(kind.sum()) for kind in kinds]
            in_bin = np.minimum((bounded[near] * BINS).astype(np.intp), BINS - 1)
            one.bins += [np.bincount(in_bin, weights, BINS) for weights in (visible[near], bounded[near])]
            one.known += int(near.sum())
            if len(range_m) < 5000 or not np.isfinite(reach_m):
                continue
            own_m = _at_least(rule, range_m, azimuth)
            one.added.append(max(abs(_at_least(rule, *changed) / own_m - 1) for changed in more))
            one.removed.append(max(abs(_at_least(rule, *changed) / own_m - 1) for changed in fewer))
    return found


def _at_least(rule: Rule, range_m: Floats, azimuth: Floats) -> float:
    return max(LEAST_REACH_M, rule(range_m, azimuth))


def _row(name: str, one: Found) -> list[str]:
    both, over, under, beyond = (int(count) for count in one.cells)
    precision, recall = both / max(both + over, 1), both / max(both + under, 1)
    ece = np.abs(one.bins[0] - one.bins[1]).sum() / max(one.known, 1)
    ratios = np.quantile(one.ratios, (0.5, 0.1, 0.9)) if np.isfinite(one.ratios).all() else np.full(3, np.inf)
    moved = [
        " / ".join(f"{share:.1%}" for share in np.quantile(shares, (0.5, 0.9))) if shares else "–"
        for shares in (one.added, one.removed)
    ]
    return [
        name,
        f"{precision:.3f} / {recall:.3f}",
        f"{2 * both / (2 * both + over + under + beyond):.3f}",
        f"{ece:.3f}",
        f"{beyond / max(both + over + beyond, 1):.3f}",
        f"{ratios[0]:.2f} ({ratios[1]:.2f}–{ratios[2]:.2f})" if np.isfinite(ratios).all() else "–",
        *moved,
    ]


def main() -> None:
    """Write the page."""
    [out] = sys.argv[1:]
    header = ("reach", "precision / recall", "F1 with it", "ECE", "beyond", "reach / true reach", "added", "removed")
    blocks = [_ABOUT.format(training=SETS["training"])]
    for set_name, every in SETS.items():
        found = evaluate(set_name, every)
        blocks += [f"## {set_name.capitalize()}", table(header, [_row(name, one) for name, one in found.items()])]
    Path(out).write_text(page("The reach without a table", facts(), *blocks), encoding="utf-8")


if __name__ == "__main__":
    main()
