"""Measures rejected kinds of evidence on development streams, so that the page shows why they were rejected."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from viewshed.arrays import F64
from viewshed.monitor.evidence import EARLIER_SWEEPS, SECTORS
from viewshed.monitor.impossible import OUTSIDE_SHARE, share_out_of_time
from viewshed.monitor.roc import auroc
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab.studies.monitor.plan import MonitorPlan
from viewshed_lab.studies.monitor.streams import Stream
from viewshed_lab.threats.attacks import ATTACKS, Knowledge

STYLES = ("highway", "parking", "hall", "quay", "loft", "slope_town")
DEVELOPMENT = 100
"""Offset of the plan's seed, so that these streams differ from those of the report."""

ATTACKED, SWEEPS = (10, 16, 22), 24
"""Attacked sweeps of a development stream, and its length."""

EARLIER = 8
"""Age of the sweep of a replay, in sweeps."""

EDGE_M, BETWEEN_M = (0.3, 2.5), 0.1
"""A beam is at an edge if the ranges of its two neighbors differ by an amount in this interval; it is mixed if its
return lies between them and at least this far from either."""


def mixed_pixels(leveled: LeveledSweep) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
    """Return the numbers (SECTORS,) of edge beams and of mixed beams in each sector and its two neighbors."""
    image = leveled.range_image
    if image is None:
        return None
    range_m = image.range_m
    before, after = np.roll(range_m, 1, axis=1), np.roll(range_m, -1, axis=1)
    with np.errstate(invalid="ignore"):
        jump_m = np.abs(after - before)
        edge = np.isfinite(range_m) & (jump_m > EDGE_M[0]) & (jump_m < EDGE_M[1])
        lower, upper = np.minimum(before, after) + BETWEEN_M, np.maximum(before, after) - BETWEEN_M
        mixed = edge & (range_m > lower) & (range_m < upper)
    sector = np.arange(range_m.shape[1]) * SECTORS // range_m.shape[1]
    edges, between = (
        np.sum([np.roll(np.bincount(sector, mask.sum(axis=0), SECTORS), step) for step in (-1, 0, 1)], axis=0)
        for mask in (edge, mixed)
    )
    return edges.astype(np.intp), between.astype(np.intp)


def tried(plan: MonitorPlan) -> dict[str, tuple[int, float, float]]:
    """Return by attack: number of cases, AUROC of mixed pixels, share of sweeps with returns out of their time.

    The score of mixed pixels in a sector is the rarity of their number among its edges, given the stream's own share,
    beyond that of the rarest of the last five sweeps; the largest score of any sector counts.
    """
    benign, attacked, late = list[float](), defaultdict[str, list[float]](list), defaultdict[str, list[bool]](list)
    development = replace(plan, seed=plan.seed + DEVELOPMENT)
    for style in (name for name in STYLES if name in plan.report):
        stream = Stream(development, "report", style, 0)
        sweeps = [stream.sweep(number) for number in range(SWEEPS)]
        by_sweep = [mixed_pixels(level(sweep, stream.grid)) for sweep in sweeps]
        counts = [one for one in by_sweep if one is not None]
        if len(counts) < SWEEPS:
            continue
        share = sum(int(between.sum()) for _, between in counts) / sum(int(edges.sum()) for edges, _ in counts)
        rarity = [_rarity(edges, between, share) for edges, between in counts]
        benign += [_change(rarity, number, rarity[number]) for number in range(EARLIER_SWEEPS, SWEEPS)]
        for name, number, sweep in _attacks(stream, sweeps):
            counted = mixed_pixels(level(sweep, stream.grid))
            if counted is not None:
                attacked[name].append(_change(rarity, number, _rarity(*counted, share)))
                late[name].append(share_out_of_time(sweep) > OUTSIDE_SHARE)
    return {
        name: (len(scores), auroc(np.array(benign), np.array(scores)), float(np.mean(late[name])))
        for name, scores in sorted(attacked.items())
    }


def _attacks(stream: Stream, sweeps: list[Sweep]) -> Iterator[tuple[str, int, Sweep]]:
    for name in stream.plan.attacks:
        for number in ATTACKED if name in ATTACKS else ():
            known = Knowledge((sweeps[number - EARLIER],), half_extent_m=stream.grid.half_extent_m)
            try:
                yield name, number, ATTACKS[name](None, known).apply(sweeps[number], stream.rng(name, number)).sweep
            except ValueError:  # the attack is impossible on this sweep
                continue


def _rarity(edges: NDArray[np.intp], between: NDArray[np.intp], share: float) -> F64:
    """Return -log10 of the binomial tail probability (SECTORS,) of ``between`` mixed beams among ``edges``."""
    few, many = stats.binom.cdf(between, edges, share), stats.binom.sf(between - 1, edges, share)
    return np.asarray(-np.log10(np.maximum(np.minimum(few, many), 1e-12)), np.float64)


def _change(rarity: list[F64], number: int, now: F64) -> float:
    return float(np.maximum(now - np.max(rarity[number - EARLIER_SWEEPS : number], axis=0), 0.0).max())
