"""Protocol of all estimators, classical and networks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.fov.visibility import Target
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep

EarlierSweeps = History | Sequence[Sweep | LeveledSweep] | None
"""Earlier sweeps of the same sensor with poses, oldest first; or a :class:`History` made from them."""


class Estimator(FovEstimator, Protocol):
    """Protocol of the estimators in ``ESTIMATORS``.

    Callers use only these members to find out what an estimator can do, never its class or name.
    """

    @property
    def name(self) -> str:
        """Name in ``ESTIMATORS``; becomes :attr:`FovEstimate.method`."""
        ...

    @property
    def target(self) -> Target:
        """The target whose visibility is estimated."""
        ...

    @property
    def threshold(self) -> float:
        """Minimum probability of a visible cell."""
        ...

    @property
    def uses_history(self) -> bool:
        """Whether the estimator uses earlier sweeps."""
        ...

    def estimate(self, sweep: Sweep | LeveledSweep, history: EarlierSweeps = None) -> FovEstimate:
        """Return the field of view of one sweep; ``sweep`` is not modified.

        Args:
            sweep: the sweep; a sweep leveled on this grid is not leveled again.
            history: earlier sweeps, for an estimator that uses them.

        Raises:
            TypeError: ``sweep`` is neither a Sweep nor a LeveledSweep.
            ValueError: ``history`` is given but the estimator does not use it, or a pose is missing.
        """
        ...

    def with_abstention(self, below: float) -> Self:
        """Return a copy that marks cells UNKNOWN if neither answer has at least the probability ``below``, in [.5, 1].

        Raises:
            ValueError: the estimator gives masks of 0 and 1, not probabilities.
        """
        ...

    def batch_steps(self) -> BatchSteps:
        """Return the steps that :func:`viewshed.estimators.batch.estimate_all` runs in threads and in batches.

        Raises:
            ValueError: the estimator keeps state, so sweeps must be estimated in sequence.
        """
        ...

    def stream(
        self, sweeps: Iterable[Sweep], history: int = 0, *, require_confirmation: bool = False
    ) -> Iterator[FovEstimate]:
        """Yield the estimate of each sweep of a stream; see :func:`viewshed.estimators.temporal.stream`."""
        ...


@dataclass(frozen=True, slots=True)
class BatchSteps:
    """The steps of an estimate: ``prepare`` and ``finish`` run in many threads, ``infer`` once for a batch."""

    prepare: Callable[[Sweep], Any]  # sweep → one input of ``infer``
    infer: Callable[[list[Any]], list[Any]]  # list of inputs → list of outputs
    finish: Callable[[Any, Any], FovEstimate]  # input and output of one sweep → estimate
