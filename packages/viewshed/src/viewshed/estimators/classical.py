"""The body that classical estimators share, and the check of earlier sweeps that every estimator makes."""

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
"""Every cell is at least this sure to be visible, or not to be."""


class ClassicalEstimator:
    """The body that classical estimators share: they level the sweep once and say how they see a leveled one.

    A subclass is a frozen dataclass with the fields ``grid``, ``target`` and ``name`` and the method
    ``visible_prob(leveled, history)``. The states are those that the beams support, whatever it claims. One whose
    probabilities say how sure it is has the field ``abstain_below`` as well, by default :data:`NEVER_ABSTAIN`.
    """

    __slots__ = ()
    grid: BevGrid
    target: Target
    name: str
    abstain_below: float | None = None

    @property
    def threshold(self) -> float:
        """Probability from which a cell counts as visible: one half, or ``abstain_below`` if that is higher."""
        return max(THRESHOLD, self.abstain_below or 0.0)

    @property
    def uses_history(self) -> bool:
        """Whether earlier sweeps change the estimates."""
        return False

    def estimate(self, sweep: Sweep | LeveledSweep, history: EarlierSweeps = None) -> FovEstimate:
        """Return the field of view of one sweep; see :meth:`Estimator.estimate`."""
        leveled = leveled_on(sweep, self.grid)
        earlier = checked_history(self, leveled, history)
        leveled = leveled if earlier is None else earlier.now
        prob = self.visible_prob(leveled, earlier)
        claimed, sure = prob >= np.float32(self.threshold), self.abstain_below or NEVER_ABSTAIN
        denied = prob <= np.float32(1.0 - sure) if sure > NEVER_ABSTAIN else ~claimed
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
        """Return the probability (cells, cells) that this estimator gives each cell; 0 or 1 if it makes a mask."""
        raise NotImplementedError

    def with_abstention(self, below: float) -> Self:
        """Return the same estimator that leaves cells UNKNOWN of which it is less sure; a mask of 0 and 1 refuses."""
        if self.abstain_below is None:
            raise ValueError(
                f"abstention must be asked of an estimator that says how sure it is, got {below:g} for {self.name},"
                " whose masks are 0 or 1; use shadow_map, unet or mc_dropout"
            )
        changed: Self = replace(cast("Any", self), abstain_below=checked_abstention(below))
        return changed

    def batch_steps(self) -> BatchSteps:
        """Return whole estimates as the step that many threads take."""
        return BatchSteps(self.estimate, lambda estimates: estimates, lambda estimate, _: estimate)

    def stream(
        self, sweeps: Iterable[Sweep], history: int = 0, *, require_confirmation: bool = False
    ) -> Iterator[FovEstimate]:
        """Yield the estimate of each sweep of a stream; see :func:`viewshed.estimators.temporal.stream`."""
        return stream(self, sweeps, history, require_confirmation=require_confirmation)


def checked_abstention(below: float) -> float:
    """Return a probability below which an estimator abstains, or raise a ValueError unless it lies in [.5, 1]."""
    if not NEVER_ABSTAIN <= below <= 1.0:
        raise ValueError(f"abstain_below must lie in [0.5, 1], got {below}")
    return below


def checked_history(estimator: Estimator, leveled: LeveledSweep, history: EarlierSweeps) -> History | None:
    """Return earlier sweeps as the sensor sees them now, or None for none.

    Raises:
        ValueError: the estimator uses none, a sweep has no pose, or it is the history of another sweep.
    """
    if history is None or (not isinstance(history, History) and not len(history)):
        return None
    if not estimator.uses_history:
        raise ValueError(f"history must be left out for {estimator.name}, which looks at one sweep; use shadow_map")
    if isinstance(history, History):
        if history.now.sweep is not leveled.sweep:
            raise ValueError("history must be that of the sweep to estimate, got another one's; use History.of")
        return history
    return history_of(leveled, history, estimator.grid)
