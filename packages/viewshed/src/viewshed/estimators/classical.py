"""Base class of the classical estimators; checks of abstention and history for all estimators."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators.base import BatchSteps, EarlierSweeps, Estimator
from viewshed.estimators.temporal import stream
from viewshed.fov.estimate import THRESHOLD, FovEstimate
from viewshed.fov.visibility import Target
from viewshed.grid import BevGrid
from viewshed.preprocess.basis import basis_of
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.history import History, history_of
from viewshed.preprocess.leveling import LeveledSweep, leveled_on
from viewshed.sweep import Sweep

NEVER_ABSTAIN = 0.5
"""``abstain_below`` that never abstains: one of visible and not visible always has at least this probability."""


class ClassicalEstimator:
    """Base class of the classical estimators: levels the sweep, calls ``visible_prob``, derives the states.

    A subclass is a frozen dataclass with the fields ``grid``, ``target`` and ``name`` and the method
    ``visible_prob(leveled, history)``. A claim without support by the beams does not become a visible state. An
    estimator that can abstain also has the field ``abstain_below``, by default :data:`NEVER_ABSTAIN`.
    """

    __slots__ = ()
    grid: BevGrid
    target: Target
    name: str
    abstain_below: float | None = None

    @property
    def threshold(self) -> float:
        """Minimum probability of a visible cell: one half, or ``abstain_below`` if that is higher."""
        return max(THRESHOLD, self.abstain_below or 0.0)

    @property
    def uses_history(self) -> bool:
        """Whether the estimator uses earlier sweeps."""
        return False

    def estimate(self, sweep: Sweep | LeveledSweep, history: EarlierSweeps = None) -> FovEstimate:
        """Return the field of view of one sweep; see :meth:`Estimator.estimate`."""
        leveled = leveled_on(sweep, self.grid)
        earlier = checked_history(self, leveled, history)
        leveled = leveled if earlier is None else earlier.now
        prob = self.visible_prob(leveled, earlier)
        claimed, min_sure = prob >= np.float32(self.threshold), self.abstain_below or NEVER_ABSTAIN
        denied = prob <= np.float32(1.0 - min_sure) if min_sure > NEVER_ABSTAIN else ~claimed
        evidence = beam_evidence(leveled, self.grid, self.target, earlier)
        state = evidence.states(claimed, denied, leveled.obstacle_cells(self.grid))
        return FovEstimate(
            grid=self.grid,
            visible_prob=prob,
            state=state,
            method=self.name,
            target=self.target,
            threshold=self.threshold,
            world_from_level=leveled.world_from_level,
            t_ns=leveled.sweep.t_ns,
            agent=leveled.sweep.agent,
            basis=basis_of(leveled, evidence, state),
        )

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return the probability (cells, cells) float32 that each cell is visible; 0 or 1 for a mask."""
        raise NotImplementedError

    def with_abstention(self, below: float) -> Self:
        """Return a copy that abstains; see :meth:`Estimator.with_abstention`."""
        if self.abstain_below is None:
            raise ValueError(
                f"abstention must be used with an estimator of probabilities, got {below:g} for {self.name},"
                " whose masks are 0 or 1; use shadow_map, unet or mc_dropout"
            )
        changed: Self = replace(cast("Any", self), abstain_below=checked_abstention(below))
        return changed

    def batch_steps(self) -> BatchSteps:
        """Return steps that compute the whole estimate in ``prepare``, in many threads."""
        return BatchSteps(self.estimate, lambda estimates: estimates, lambda estimate, _: estimate)

    def stream(
        self, sweeps: Iterable[Sweep], history: int = 0, *, require_confirmation: bool = False
    ) -> Iterator[FovEstimate]:
        """Yield the estimate of each sweep of a stream; see :func:`viewshed.estimators.temporal.stream`."""
        return stream(self, sweeps, history, require_confirmation=require_confirmation)


def checked_abstention(below: float) -> float:
    """Return ``abstain_below`` if it lies in [.5, 1]; else raise ValueError."""
    if not NEVER_ABSTAIN <= below <= 1.0:
        raise ValueError(f"abstain_below must lie in [0.5, 1], got {below}")
    return below


def checked_history(estimator: Estimator, leveled: LeveledSweep, history: EarlierSweeps) -> History | None:
    """Return the earlier sweeps as a :class:`History` of ``leveled``, or None if there are none.

    Raises:
        ValueError: the estimator uses no history, a sweep has no pose, or the history belongs to another sweep.
    """
    if history is None or (not isinstance(history, History) and not len(history)):
        return None
    if not estimator.uses_history:
        raise ValueError(f"history must be left out for {estimator.name}, which uses one sweep only; use shadow_map")
    if isinstance(history, History):
        if history.now.sweep is not leveled.sweep:
            raise ValueError("history must be that of the sweep to estimate, got another one's; use History.of")
        return history
    return history_of(leveled, history, estimator.grid)
