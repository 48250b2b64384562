"""The body that classical estimators share, and the check of earlier sweeps that every estimator makes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Self

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


class ClassicalEstimator:
    """The body that classical estimators share: they level the sweep once and say how they see a leveled one.

    A subclass is a frozen dataclass with the fields ``grid``, ``target`` and ``name`` and the method
    ``visible_prob(leveled, history)``. The states are those that the beams support, whatever it claims.
    """

    __slots__ = ()
    grid: BevGrid
    target: Target
    name: str

    @property
    def threshold(self) -> float:
        """Probability from which a cell counts as visible."""
        return THRESHOLD

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
        claimed = prob >= np.float32(self.threshold)
        evidence = beam_evidence(leveled, self.grid, self.target, earlier)
        state = evidence.states(claimed, ~claimed, leveled.obstacle_cells(self.grid))
        return FovEstimate(
            grid=self.grid,
            visible_prob=prob,
            state=state,
            method=self.name,
            target=self.target,
            world_from_level=leveled.world_from_level,
            t_ns=leveled.sweep.t_ns,
            agent=leveled.sweep.agent,
            basis=basis_of(leveled, evidence, state),
        )

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return the probability (cells, cells) that this estimator gives each cell; 0 or 1 if it makes a mask."""
        raise NotImplementedError

    def with_abstention(self, below: float) -> Self:
        """Refuse: a classical mask says nothing of how sure it is."""
        raise ValueError(
            f"abstention must be asked of a network, got {below:g} for {self.name}, whose probabilities are no measure"
            " of doubt; use viewnet, unet or mc_dropout"
        )

    def batch_steps(self) -> BatchSteps:
        """Return whole estimates as the step that many threads take."""
        return BatchSteps(self.estimate, lambda estimates: estimates, lambda estimate, _: estimate)

    def stream(
        self, sweeps: Iterable[Sweep], history: int = 0, *, require_confirmation: bool = False
    ) -> Iterator[FovEstimate]:
        """Yield the estimate of each sweep of a stream; see :func:`viewshed.estimators.temporal.stream`."""
        return stream(self, sweeps, history, require_confirmation=require_confirmation)


def checked_history(estimator: Estimator, leveled: LeveledSweep, history: EarlierSweeps) -> History | None:
    """Return earlier sweeps as the sensor sees them now, or None for none.

    Raises:
        ValueError: the estimator uses none, a sweep has no pose, or it is the history of another sweep.
    """
    if history is None or (not isinstance(history, History) and not len(history)):
        return None
    if not estimator.uses_history:
        raise ValueError(
            f"history must be left out for {estimator.name}, which looks at one sweep; use viewnet or shadow_map"
        )
    if isinstance(history, History):
        if history.now.sweep is not leveled.sweep:
            raise ValueError("history must be that of the sweep to estimate, got another one's; use History.of")
        return history
    return history_of(leveled, history, estimator.grid)
