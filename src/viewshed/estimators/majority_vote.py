"""The vote of five classical masks: the strong baseline that stands in every table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators.base import ClassicalEstimator
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.shadow_map import NoReturn, ShadowMap
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.visibility import CAR, Target
from viewshed.grid import BevGrid
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep

MAJORITY = 3

VOTE_RULES: tuple[NoReturn, ...] = ("unknown", "max_range", "fill")
"""What a missing return means to the three shadow maps that vote."""


@dataclass(frozen=True, slots=True)
class MajorityVote(ClassicalEstimator):
    """Visible where at least three of five masks agree.

    The five: the shadow map with a missing return as unknown, as maximum range and filled from its neighbors; the
    first blocker with and without the farthest return as a limit. The probability is the share of votes, so that
    0.6 (three votes) is the first value above the threshold; ``std`` stays NaN, votes are not a posterior.

    Limits: three of the five trust measured depths, so a far wall of spoofed returns still opens a corridor.
    """

    grid: BevGrid
    target: Target = CAR
    name: str = "majority_vote"

    def _estimate(self, leveled: LeveledSweep, history: History | None) -> FovEstimate:
        """Count the votes of five masks for each cell."""
        shadow = [ShadowMap(self.grid, self.target, rule).estimate(leveled) for rule in VOTE_RULES]
        blockers = [
            FirstBlocker(self.grid, self.target, limit_farthest=limit).estimate(leveled) for limit in (True, False)
        ]
        votes: NDArray[Any] = np.sum([voter.visible() for voter in (*shadow, *blockers)], axis=0)
        visible = votes >= MAJORITY
        # HIDDEN only where the most careful shadow map says so; whom it alone would call visible stays UNKNOWN.
        state = np.where(shadow[0].state == CellState.HIDDEN, np.uint8(CellState.HIDDEN), np.uint8(CellState.UNKNOWN))
        state[~visible & shadow[0].visible()] = CellState.UNKNOWN
        state[visible] = CellState.FREE
        state[visible & leveled.obstacle_cells(self.grid)] = CellState.SURFACE
        prob = (votes / np.float32(5.0)).astype(np.float32)
        return replace(shadow[0], visible_prob=prob, state=state, method=self.name)
