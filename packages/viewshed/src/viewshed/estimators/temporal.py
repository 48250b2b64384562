"""Estimates of a stream of sweeps: use of earlier sweeps, and confirmation of claims by a second sweep."""

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
    """Buffer of the last sweeps of each agent, the input of :class:`History`.

    The times of all agents must be of one clock.
    """

    sweeps: int = HISTORY_SWEEPS  # maximum number of sweeps per agent
    every_s: float = 1.0  # minimum time in seconds between two of them
    forget_s: float = FORGET_S  # older sweeps are not used; agents without a newer sweep are dropped
    agents: int = AGENTS  # maximum number of agents; beyond it the least recently seen agent is dropped
    _kept: dict[str, deque[LeveledSweep]] = field(default_factory=dict, repr=False)
    _last_ns: dict[str, int] = field(default_factory=dict, repr=False)  # time of each agent's last sweep

    def __post_init__(self) -> None:
        if self.sweeps < 1 or not (self.every_s >= 0.0 and self.forget_s > 0.0):
            raise ValueError(
                "sweeps must be at least 1, every_s at least 0 and forget_s above 0, got "
                f"{self.sweeps}, {self.every_s} and {self.forget_s}"
            )
        if self.agents < 1:
            raise ValueError(f"agents must be at least 1, got {self.agents}")

    def fresh(self) -> SweepBuffer:
        """Return an empty buffer with the same settings."""
        return replace(self, _kept={}, _last_ns={})

    def history(self, leveled: LeveledSweep) -> History | None:
        """Return the history of a sweep from its agent's earlier ones; None if empty, or without pose or time.

        A sweep older than the last one starts a new stream: the agent's sweeps are dropped first.
        """
        now_ns, agent = leveled.sweep.t_ns, leveled.sweep.agent
        if now_ns is None or leveled.world_from_level is None:
            return None
        if now_ns < self._last_ns.get(agent, now_ns):
            self.reset(agent)
        earlier = self._kept.get(agent, ())
        recent = [sweep for sweep in earlier if 0 < now_ns - (sweep.sweep.t_ns or 0) <= self.forget_s * 1e9]
        return History.of(leveled, recent)

    def add(self, leveled: LeveledSweep) -> None:
        """Keep a sweep if it has a pose and a time at least ``every_s`` after the last kept sweep of its agent.

        A sweep older than the last one starts a new stream: the agent's sweeps are dropped first.
        """
        t_ns, agent = leveled.sweep.t_ns, leveled.sweep.agent
        if t_ns is None or leveled.world_from_level is None:
            return
        if t_ns < self._last_ns.get(agent, t_ns):
            self.reset(agent)
        remember(self._last_ns, agent, t_ns, self.agents)
        sweeps = self._kept.get(agent) or deque(maxlen=self.sweeps)
        if not sweeps or t_ns - (sweeps[-1].sweep.t_ns or 0) >= self.every_s * 1e9:
            sweeps.append(leveled)
        remember(self._kept, agent, sweeps, self.agents)
        self.drop_gone(t_ns)

    def drop_gone(self, now_ns: int) -> None:
        """Drop the agents whose sweeps are all too old."""
        oldest_ns = now_ns - max(self.forget_s, self.every_s) * 1e9
        for agent in [name for name, sweeps in self._kept.items() if (sweeps[-1].sweep.t_ns or 0) < oldest_ns]:
            self.reset(agent)

    def reset(self, agent: str | None = None) -> None:
        """Drop the sweeps of one agent, or of all agents (None)."""
        for name in [agent] if agent is not None else list(self._kept):
            self._kept.pop(name, None)
            self._last_ns.pop(name, None)


@dataclass(frozen=True, slots=True)
class TemporalEstimator:
    """Stateful estimator for a stream: each estimate uses earlier sweeps of the same agent.

    Sweeps without a pose or a time are estimated without history.

    Raises:
        ValueError: the inner estimator uses no history.
    """

    inner: Estimator  # an estimator that uses history
    buffer: SweepBuffer = field(default_factory=SweepBuffer)  # the earlier sweeps
    # claim only cells that an earlier sweep confirms, see :func:`where_confirmed`; without earlier sweeps, none
    require_confirmation: bool = False

    def __post_init__(self) -> None:
        if not self.inner.uses_history:
            raise ValueError(f"history is for shadow_map, got {self.inner.name}, which uses one sweep only")

    @property
    def name(self) -> str:
        """Name of the inner estimator."""
        return self.inner.name

    @property
    def grid(self) -> BevGrid:
        """Grid of the estimates."""
        return self.inner.grid

    @property
    def target(self) -> Target:
        """The target whose visibility is estimated."""
        return self.inner.target

    @property
    def threshold(self) -> float:
        """Minimum probability of a visible cell."""
        return self.inner.threshold

    @property
    def uses_history(self) -> bool:
        """True; the history is its own buffer."""
        return True

    def estimate(self, sweep: Sweep | LeveledSweep, history: EarlierSweeps = None) -> FovEstimate:
        """Return the estimate of the next sweep of the stream, and add the sweep to the buffer."""
        if history is not None:
            raise ValueError("history must be left out: a TemporalEstimator remembers its own stream")
        leveled = leveled_on(sweep, self.grid)
        earlier = self.buffer.history(leveled)
        leveled = leveled if earlier is None else earlier.now
        estimate = self.inner.estimate(leveled, earlier)
        self.buffer.add(leveled)
        return where_confirmed(estimate, earlier) if self.require_confirmation else estimate

    def reset(self) -> None:
        """Drop all earlier sweeps; the next sweep starts a new stream."""
        self.buffer.reset()

    def with_abstention(self, below: float) -> TemporalEstimator:
        """Return a copy with the same buffer that abstains below another probability."""
        return replace(self, inner=self.inner.with_abstention(below))

    def stream(
        self, sweeps: Iterable[Sweep], history: int = 0, *, require_confirmation: bool = False
    ) -> Iterator[FovEstimate]:
        """Yield the estimate of each sweep of a stream, with this estimator's own history."""
        if history or require_confirmation:
            raise ValueError("history must be left out: a TemporalEstimator remembers its own stream")
        return map(self.estimate, _leveled(sweeps, self.grid))

    def batch_steps(self) -> BatchSteps:
        """Raise ValueError: sweeps of a stream must be estimated in sequence."""
        raise ValueError("an estimator with its own history takes sweeps one after the other; call its estimate")


def stream(
    estimator: Estimator, sweeps: Iterable[Sweep], history: int = 0, *, require_confirmation: bool = False
) -> Iterator[FovEstimate]:
    """Yield the estimate of each sweep of a stream, in order.

    Args:
        estimator: the estimator.
        sweeps: a recording, or any sweeps in measurement order.
        history: number of earlier sweeps that each estimate uses, if poses are known; 0 uses none.
        require_confirmation: claim only cells that an earlier sweep confirms.

    Raises:
        ValueError: the estimator uses no history, or confirmation is required with ``history`` 0.
    """
    if history == 0 and require_confirmation:
        raise ValueError("require_confirmation needs a history of 1 or more: it claims what earlier sweeps saw")
    if history:
        estimator = TemporalEstimator(estimator, SweepBuffer(history), require_confirmation)
    return map(estimator.estimate, _leveled(sweeps, estimator.grid))


def _leveled(sweeps: Iterable[Sweep], grid: BevGrid) -> Iterator[LeveledSweep]:
    """Yield the sweeps of a stream, leveled; the ground of a standing sensor without poses is held over sweeps.

    The sensor identified in one sweep is the hint for the next.
    """
    sensor, rest = UNIDENTIFIED, Rest()
    for sweep in sweeps:
        leveled = leveled_on(sweep, grid, sensor)
        sensor = leveled.sensor_id
        yield rest.hold(leveled)


def where_confirmed(estimate: FovEstimate, history: History | None) -> FovEstimate:
    """Return the estimate restricted to cells that at least one earlier sweep of ``history`` confirms as visible.

    In other cells the probability becomes 0 and a claim becomes UNKNOWN. An attacker must then spoof the earlier sweeps
    too; a cell that comes into view is claimed one sweep later.
    """
    confirmed = np.zeros(estimate.grid.shape, np.bool_)
    if history is not None:
        confirmed = history.confirmations(estimate.grid, estimate.target) > 0
    state = np.where(is_visible(estimate.state) & ~confirmed, np.uint8(CellState.UNKNOWN), estimate.state)
    # The remaining claims have other shares of unsure ground and inferred beams.
    basis = estimate.basis and replace(estimate.basis, unsure_ground_share=0.0, inferred_share=0.0)
    if history is not None:
        basis = basis_of(history.now, beam_evidence(history.now, estimate.grid, estimate.target, history), state)
    visible_prob = np.where(confirmed, estimate.visible_prob, np.float32(0.0))
    return replace(estimate, visible_prob=visible_prob, state=state, basis=basis)
