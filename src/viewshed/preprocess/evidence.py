"""What the beams of a sweep say about a target in each cell: the evidence that decides every estimate's states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from weakref import ReferenceType, WeakKeyDictionary, ref

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import THRESHOLD, CellState
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import (
    Beams,
    Target,
    beams_that_aim,
    probability_of_visible,
    returns_by_kind,
)
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.preprocess.no_return import beams_by_evidence
from viewshed.preprocess.reach import sensing_reach

if TYPE_CHECKING:
    from viewshed.preprocess.history import History

GROUND_STEPS = ((-1.22, 0.3), (1.22, 0.3))
"""Heights of the ground, in standard deviations, and their weights; the height itself has what is left. Together they
have nearly the variance of a normal distribution."""

SURE_AIM = 0.9
"""Probability from which enough beams aim at a target to call its cell hidden: a beam more or less must not decide."""

Floats = NDArray[np.float32]

Mask = NDArray[np.bool_]

States = NDArray[np.uint8]

_EVIDENCE: WeakKeyDictionary[
    LeveledSweep | History, dict[tuple[BevGrid, Target, ReferenceType[LeveledSweep]], BeamEvidence]
]
_EVIDENCE = WeakKeyDictionary()
"""The evidence of sweeps that are still in use, by the sweep or by its history: every estimator asks for the same.

It holds no sweep: that of a history, which holds the sweeps before, would keep those of a whole stream.
"""


@dataclass(frozen=True, slots=True, eq=False)
class BeamEvidence:
    """Beams at a target in each cell, counted as the definition of visible counts them; (cells, cells) each.

    Attributes:
        grid: where the cells are.
        target: what would have to be seen.
        measured: float32 expected returns by beams whose depth is measured.
        inferred: float32 expected returns by beams without a return whose depth is inferred.
        unresolved: float32 expected returns by the other beams without a return, as if nothing had stopped them.
        aimed: float32 beams of the first two kinds that aim at the target, whatever their depth.
        visible_prob: float32 probability that both kinds give ``target.min_returns`` returns, averaged over the heights
            that the ground may have; below the threshold where no claim is supported.
        within_reach: bool, not farther from the sensor than it sees a dark target.
    """

    grid: BevGrid
    target: Target
    measured: Floats
    inferred: Floats
    unresolved: Floats
    aimed: Floats
    visible_prob: Floats
    within_reach: Mask

    @property
    def reaching(self) -> Floats:
        """(cells, cells) float32 expected returns by both kinds of beams."""
        return self.measured + self.inferred

    def supports_claim(self) -> Mask:
        """Return where a cell may be called visible (cells, cells).

        Within reach, where enough beams reach a target on the ground as it was estimated, and on average over the
        heights that the ground may have.
        """
        return np.asarray(self.visible_prob >= np.float32(THRESHOLD))

    def supports_denial(self) -> Mask:
        """Return where a cell may be called hidden (cells, cells).

        Within reach, where surely enough beams aim at a target and too few reach it on the ground as it was estimated.
        """
        aimed = probability_of_visible(self.aimed, self.target.min_returns) >= np.float32(SURE_AIM)
        return aimed & ~_enough(self.reaching, self.target) & self.within_reach

    def bounded(self, prob: Floats, threshold: float) -> Floats:
        """Return an estimator's probability (cells, cells), below its threshold where the beams support no claim."""
        most = np.nextafter(np.float32(threshold), np.float32(0.0))
        return np.where(self.supports_claim(), prob, np.minimum(prob, most))

    def states(self, visible: Mask, denied: Mask, obstacle: Mask) -> States:
        """Return the states (cells, cells) uint8 of what an estimator calls visible, or not visible.

        FREE or SURFACE where it claims and the beams support that, HIDDEN where it denies and they support that,
        everything else UNKNOWN.

        Args:
            visible: what the estimator calls visible.
            denied: what it calls not visible.
            obstacle: cells that hold an obstacle return.
        """
        claimed = visible & self.supports_claim()
        state = np.where(denied & self.supports_denial(), np.uint8(CellState.HIDDEN), np.uint8(CellState.UNKNOWN))
        state[claimed] = CellState.FREE
        state[claimed & obstacle] = CellState.SURFACE
        return state

    def inferred_share(self, visible: Mask) -> float:
        """Return the share of the claimed cells that measured beams alone would not support; 0 without claims."""
        claimed = visible & self.supports_claim()
        count = np.count_nonzero(claimed)
        short = np.count_nonzero(claimed & ~_enough(self.measured, self.target))
        return short / count if count else 0.0


def beam_evidence(leveled: LeveledSweep, grid: BevGrid, target: Target, history: History | None = None) -> BeamEvidence:
    """Return the evidence of a leveled sweep; computed once for a grid, a target and a history while they are used.

    Beams end at the obstacles that earlier sweeps saw.
    """
    known = _EVIDENCE.setdefault(history or leveled, {})
    key = grid, target, ref(leveled)
    if key not in known:
        known[key] = _count_beams(leveled, grid, target, history)
    return known[key]


def _count_beams(leveled: LeveledSweep, grid: BevGrid, target: Target, history: History | None) -> BeamEvidence:
    beams = beams_by_evidence(leveled, target.height_m)
    kinds = [beams.measured, beams.inferred, beams.unresolved]
    if history is not None:
        kinds = [history.within(kind) for kind in kinds]
    ground, height_m = leveled.ground, leveled.sensor_height_m
    measured, inferred, unresolved = returns_by_kind(kinds, height_m, ground, grid, target)
    # The probability at the ground's height, and at heights around it.
    both = kinds[0] + kinds[1]
    within = polar_of_cells(grid)[0] <= np.float32(reach_of_sweep(leveled))
    prob = _probability(both, measured + inferred, ground, height_m, grid, target)
    # No claim rests on other heights of the ground alone, and none lies beyond the reach, where things may be too dark.
    most = np.nextafter(np.float32(THRESHOLD), np.float32(0.0))
    prob = np.where(_enough(measured + inferred, target) & within, prob, np.minimum(prob, most))
    aimed = beams_that_aim(both, height_m, ground, grid, target)
    evidence = BeamEvidence(grid, target, measured, inferred, unresolved, aimed, prob, within)
    for array in (measured, inferred, unresolved, aimed, prob, within):
        array.setflags(write=False)
    return evidence


def _probability(
    beams: Beams, counts: Floats, ground: HeightMap, sensor_height_m: float, grid: BevGrid, target: Target
) -> Floats:
    """Return P(visible) (cells, cells), averaged over the heights of the ground; ``counts`` are returns at its own."""
    own = 1.0 - sum(weight for _, weight in GROUND_STEPS)
    prob = np.float32(own) * probability_of_visible(counts, target.min_returns)
    for deviations, weight in GROUND_STEPS:
        [returns] = returns_by_kind([beams], sensor_height_m, ground.shifted(deviations), grid, target)
        prob += np.float32(weight) * probability_of_visible(returns, target.min_returns)
    return prob


def _enough(returns: Floats, target: Target) -> Mask:
    """Return where the expected returns (cells, cells) are as likely as not to show the target."""
    return np.asarray(probability_of_visible(returns, target.min_returns) >= np.float32(THRESHOLD))


def reach_of_sweep(leveled: LeveledSweep) -> float:
    """Return how far in meters the sensor of a sweep sees a dark target; see :func:`sensing_reach`."""
    if leveled.held is not None:
        return leveled.held.reach_m
    image = leveled.range_image
    isolated = np.zeros(len(leveled.rows), np.bool_) if image is None else image.isolated[leveled.rows]
    return sensing_reach(leveled.range_m, isolated, leveled.sensor_id.model)
