"""What every estimator promises, whether classical or a network."""

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
"""Earlier sweeps of the same sensor, the oldest first, all with poses; or the :class:`History` made of them."""


class Estimator(FovEstimator, Protocol):
    """An estimator of the table: what it needs, what it can do, and its one call.

    These attributes say what an estimator can do: nothing else looks at its class or its name.
    """

    @property
    def name(self) -> str:
        """Its name in the table; goes into :attr:`FovEstimate.method`."""
        ...

    @property
    def target(self) -> Target:
        """What would have to be seen."""
        ...

    @property
    def threshold(self) -> float:
        """Probability from which its estimates call a cell visible."""
        ...

    @property
    def uses_history(self) -> bool:
        """Whether earlier sweeps change its estimates."""
        ...

    def estimate(self, sweep: Sweep | LeveledSweep, history: EarlierSweeps = None) -> FovEstimate:
        """Return the field of view of one sweep; ``sweep`` is not modified.

        Args:
            sweep: what the sensor measured; leveled already (on this grid), it is not leveled again.
            history: earlier sweeps, for an estimator that uses them.

        Raises:
            TypeError: ``sweep`` is neither a Sweep nor a LeveledSweep.
            ValueError: the estimator uses no history and there is some, or a pose is missing.
        """
        ...

    def with_abstention(self, below: float) -> Self:
        """Return the same estimator that leaves cells UNKNOWN of which it is less sure than ``below``, in [.5, 1].

        Raises:
            ValueError: its probabilities say nothing of how sure it is, so that it cannot abstain.
        """
        ...

    def batch_steps(self) -> BatchSteps:
        """Return how many sweeps are estimated at once.

        Raises:
            ValueError: sweeps must be taken one after the other.
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

    prepare: Callable[[Sweep], Any]  # from a sweep to what ``infer`` takes
    infer: Callable[[list[Any]], list[Any]]  # from a list of those to a list of results
    finish: Callable[[Any, Any], FovEstimate]  # from what was prepared and its result to the estimate
