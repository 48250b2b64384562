"""A stream of sweeps: what earlier sweeps saw helps the estimate now, and claims can rest on two sweeps."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from viewshed.estimators.base import BatchSteps, EarlierSweeps, Estimator
from viewshed.fov.estimate import CellState, FovEstimate, is_visible
from viewshed.fov.visibility import Target
from viewshed.grid import BevGrid
from viewshed.preprocess.basis import basis_of
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.held_ground import Rest
from viewshed.preprocess.history import HISTORY_SWEEPS, History
from viewshed.preprocess.leveling import LeveledSweep, leveled_on
from viewshed.preprocess.sensor_identification import UNIDENTIFIED
from viewshed.preprocess.streams import AGENTS, FORGET_S, remember
from viewshed.sweep import Sweep


@dataclass(slots=True)
class SweepBuffer:
    """The last sweeps of each agent of a stream, as many and as far apart as a :class:`History` is made of.

    The times of all agents are those of one clock.
    """

    sweeps: int = HISTORY_SWEEPS  # how many are kept of an agent
    every_s: float = 1.0  # least time in seconds between two of them
    # those from longer before are not used any more; agents not seen for this time are dropped
    forget_s: float = FORGET_S
    agents: int = AGENTS  # how many agents are kept; of more the one that was seen longest ago is dropped
    _kept: dict[str, deque[LeveledSweep]] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.sweeps < 1 or not (self.every_s >= 0.0 and self.forget_s > 0.0):
            raise ValueError(
                "sweeps must be at least 1, every_s at least 0 and forget_s above 0, got "
                f"{self.sweeps}, {self.every_s} and {self.forget_s}"
            )
        if self.agents < 1:
            raise ValueError(f"agents must be at least 1, got {self.agents}")

    def fresh(self) -> SweepBuffer:
        """Return a buffer like this one, without any sweep."""
        return replace(self, _kept={})

    def history(self, leveled: LeveledSweep) -> History | None:
        """Return what is kept of a sweep's agent, seen from there; None for nothing, or without its pose or time."""
        now_ns, kept = leveled.sweep.t_ns, self._kept.get(leveled.sweep.agent, ())
        if now_ns is None or leveled.world_from_level is None:
            return None
        recent = [sweep for sweep in kept if 0 < now_ns - (sweep.sweep.t_ns or 0) <= self.forget_s * 1e9]
        return History.of(leveled, recent)

    def add(self, leveled: LeveledSweep) -> None:
        """Keep a sweep, if it has a pose and a time at least ``every_s`` after the last one that was kept.

        One from before it begins a new stream.
        """
        t_ns = leveled.sweep.t_ns
        if t_ns is None or leveled.world_from_level is None:
            return
        kept = self._kept.get(leveled.sweep.agent) or deque(maxlen=self.sweeps)
        if kept and t_ns < (kept[-1].sweep.t_ns or 0):
            kept.clear()
        if not kept or t_ns - (kept[-1].sweep.t_ns or 0) >= self.every_s * 1e9:
            kept.append(leveled)
        remember(self._kept, leveled.sweep.agent, kept, self.agents)
        self.drop_gone(t_ns)

    def drop_gone(self, now_ns: int) -> None:
        """Drop the agents whose sweeps are all too old to be used."""
        oldest_ns = now_ns - max(self.forget_s, self.every_s) * 1e9
        for agent in [name for name, kept in self._kept.items() if (kept[-1].sweep.t_ns or 0) < oldest_ns]:
            del self._kept[agent]

    def reset(self, agent: str | None = None) -> None:
        """Forget the sweeps of an agent, or of all: what they hold is gone, and the stream begins anew."""
        for name in [agent] if agent is not None else list(self._kept):
            self._kept.pop(name, None)


@dataclass(frozen=True, slots=True)
class TemporalEstimator:
    """An estimator for a stream: each estimate uses what the agent's earlier sweeps saw.

    Sweeps without a pose or a time are estimated by themselves.

    Raises:
        ValueError: the estimator uses no history.
    """

    inner: Estimator  # what estimates; one that uses history
    buffer: SweepBuffer = field(default_factory=SweepBuffer)  # the earlier sweeps that it is given
    # claim only what an earlier sweep would have seen as well, see :func:`where_confirmed`; without earlier sweeps that
    # is nothing
    require_confirmation: bool = False

    def __post_init__(self) -> None:
        if not self.inner.uses_history:
            raise ValueError(f"history helps shadow_map, got {self.inner.name}, which looks at one sweep")

    @property
    def name(self) -> str:
        """Name of the estimator inside."""
        return self.inner.name

    @property
    def grid(self) -> BevGrid:
        """Grid of the estimates."""
        return self.inner.grid

    @property
    def target(self) -> Target:
        """What would have to be seen."""
        return self.inner.target

    @property
    def threshold(self) -> float:
        """Probability from which a cell counts as visible."""
        return self.inner.threshold

    @property
    def uses_history(self) -> bool:
        """It brings its own."""
        return True

    def estimate(self, sweep: Sweep | LeveledSweep, history: EarlierSweeps = None) -> FovEstimate:
        """Return the estimate for the next sweep of the stream, and remember the sweep."""
        if history is not None:
            raise ValueError("history must be left out: a TemporalEstimator remembers its own stream")
        leveled = leveled_on(sweep, self.grid)
        seen = self.buffer.history(leveled)
        leveled = leveled if seen is None else seen.now
        estimate = self.inner.estimate(leveled, seen)
        self.buffer.add(leveled)
        return where_confirmed(estimate, seen) if self.require_confirmation else estimate

    def reset(self) -> None:
        """Forget all earlier sweeps: the next one begins a new stream."""
        self.buffer.reset()

    def with_abstention(self, below: float) -> TemporalEstimator:
        """Return the same estimator of the same stream that abstains below another probability."""
        return replace(self, inner=self.inner.with_abstention(below))

    def stream(
        self, sweeps: Iterable[Sweep], history: int = 0, *, require_confirmation: bool = False
    ) -> Iterator[FovEstimate]:
        """Yield the estimate of each sweep of a stream, with the history that this estimator keeps."""
        if history or require_confirmation:
            raise ValueError("history must be left out: a TemporalEstimator remembers its own stream")
        return map(self.estimate, _leveled(sweeps, self.grid))

    def batch_steps(self) -> BatchSteps:
        """Refuse: sweeps of a stream are taken one after the other."""
        raise ValueError("an estimator that remembers takes sweeps one after the other; call its estimate")


def stream(
    estimator: Estimator, sweeps: Iterable[Sweep], history: int = 0, *, require_confirmation: bool = False
) -> Iterator[FovEstimate]:
    """Yield the estimate of each sweep of a stream, in order.

    Args:
        estimator: what estimates.
        sweeps: a recording, or any sweeps in the order in which they were measured.
        history: how many earlier sweeps help each estimate, where poses are known; 0 takes each sweep by itself.
        require_confirmation: claim only what an earlier sweep would have seen as well.

    Raises:
        ValueError: the estimator uses no history, or confirmation is required without any.
    """
    if history == 0 and require_confirmation:
        raise ValueError("require_confirmation goes with a history of 1 or more: it claims what earlier sweeps saw")
    if history:
        estimator = TemporalEstimator(estimator, SweepBuffer(history), require_confirmation)
    return map(estimator.estimate, _leveled(sweeps, estimator.grid))


def _leveled(sweeps: Iterable[Sweep], grid: BevGrid) -> Iterator[LeveledSweep]:
    """Yield the sweeps of a stream leveled, with what a sensor without poses holds while it stands still.

    The sensor of each is identified by that of the one before.
    """
    sensor, rest = UNIDENTIFIED, Rest()
    for sweep in sweeps:
        leveled = leveled_on(sweep, grid, sensor)
        sensor = leveled.sensor_id
        yield rest.hold(leveled)


def where_confirmed(estimate: FovEstimate, history: History | None) -> FovEstimate:
    """Return an estimate whose claims each rest on two sweeps: this one, and an earlier one that saw the cell as well.

    Elsewhere its probability is 0, and what was claimed is UNKNOWN. Who opens a view by spoofed returns must have begun
    before the earlier sweeps; what comes into view for the first time waits for the next one.
    """
    confirmed = np.zeros(estimate.grid.shape, np.bool_)
    if history is not None:
        confirmed = history.confirmations(estimate.grid, estimate.target) > 0
    state = np.where(is_visible(estimate.state) & ~confirmed, np.uint8(CellState.UNKNOWN), estimate.state)
    # What is left of the claims may rest on other shares of unsure ground and inferred beams.
    basis = estimate.basis and replace(estimate.basis, unsure_ground_share=0.0, inferred_share=0.0)
    if history is not None:
        basis = basis_of(history.now, beam_evidence(history.now, estimate.grid, estimate.target, history), state)
    visible_prob = np.where(confirmed, estimate.visible_prob, np.float32(0.0))
    return replace(estimate, visible_prob=visible_prob, state=state, basis=basis)
