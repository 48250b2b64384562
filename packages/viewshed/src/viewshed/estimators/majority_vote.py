"""Majority vote of five classical masks: the strong baseline of every results table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators.classical import ClassicalEstimator
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.shadow_map import NoReturn, ShadowMap
from viewshed.fov.visibility import CAR, Target
from viewshed.grid import BevGrid
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep

VOTE_RULES: tuple[NoReturn, ...] = ("unknown", "max_range", "fill")
"""The ``no_return`` rules of the three shadow maps that vote."""


@dataclass(frozen=True, slots=True)
class MajorityVote(ClassicalEstimator):
    """Visible where at least three of five masks agree.

    The five: the shadow map with the ``no_return`` rules unknown, max_range and fill; the first blocker with and
    without ``limit_farthest``. The probability is the share of votes: 0.6 (three votes) is the lowest value above the
    threshold. ``std`` is NaN, because votes are not a posterior.

    Limits: three of the five trust measured depths, so a far wall of spoofed returns still opens a false corridor.
    """

    grid: BevGrid
    target: Target = CAR
    name: str = "majority_vote"

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return the share of five masks that claim each cell."""
        voters: list[ClassicalEstimator] = [ShadowMap(self.grid, self.target, rule) for rule in VOTE_RULES]
        voters += [FirstBlocker(self.grid, self.target, limit_farthest=limit) for limit in (True, False)]
        votes = sum((voter.visible_prob(leveled, None) >= voter.threshold).astype(np.float32) for voter in voters)
        return np.asarray(votes / np.float32(len(voters)), np.float32)
