"""A stream of sweeps: what is remembered of the earlier ones helps the estimate now, and claims can rest on two."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.grid import BevGrid
from viewshed.preprocess.history import HISTORY_SWEEPS, History
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep


@dataclass(slots=True)
class SweepBuffer:
    """The last sweeps of each agent of a stream, as many and as far apart as a :class:`History` is made of.

    The times of all agents are those of one clock.

    Attributes:
        sweeps: how many are kept of an agent.
        every_s: least time in seconds between two of them.
        forget_s: those from longer before are not used any more; agents not seen for so long are dropped.
        agents: how many agents are kept; of more the one that was seen longest ago is dropped.
    """

    sweeps: int = HISTORY_SWEEPS
    every_s: float = 1.0
    forget_s: float = 10.0
    agents: int = 64
    _kept: dict[str, deque[LeveledSweep]] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.sweeps < 1 or not (self.every_s >= 0.0 and self.forget_s > 0.0):
            raise ValueError(
                "sweeps must be at least 1, every_s at least 0 and forget_s above 0, got "
                f"{self.sweeps}, {self.every_s} and {self.forget_s}"
            )
        if self.agents < 1:
            raise ValueError(f"agents must be at least 1, got {self.agents}")

    def past(self, leveled: LeveledSweep) -> History | None:
        """Return what is kept of a sweep's agent, seen from there; None for nothing, or without its pose or time."""
        now_ns, kept = leveled.sweep.t_ns, self._kept.get(leveled.sweep.agent, ())
        if now_ns is None or leveled.world_from_level is None:
            return None
        return History.of(
            leveled, [before for before in kept if 0 < now_ns - (before.sweep.t_ns or 0) <= self.forget_s * 1e9]
        )

    def add(self, leveled: LeveledSweep) -> None:
        """Keep a sweep, if it has a pose and a time at least ``every_s`` after the last one that was kept.

        One from before it begins a new stream.
        """
        t_ns = leveled.sweep.t_ns
        if t_ns is None or leveled.world_from_level is None:
            return
        # Taken out and put back last: the first agent is the one that was seen longest ago.
        kept = self._kept.pop(leveled.sweep.agent, None) or deque(maxlen=self.sweeps)
        if kept and t_ns < (kept[-1].sweep.t_ns or 0):
            kept.clear()
        if not kept or t_ns - (kept[-1].sweep.t_ns or 0) >= self.every_s * 1e9:
            kept.append(leveled)
        self._kept[leveled.sweep.agent] = kept
        self._drop_agents(t_ns)

    def _drop_agents(self, now_ns: int) -> None:
        """Drop the agents whose sweeps are all too old to be used, and those that are too many."""
        oldest_ns = now_ns - max(self.forget_s, self.every_s) * 1e9
        for agent in [name for name, kept in self._kept.items() if (kept[-1].sweep.t_ns or 0) < oldest_ns]:
            del self._kept[agent]
        while len(self._kept) > self.agents:
            del self._kept[next(iter(self._kept))]


class PastEstimator(Protocol):
    """An estimator that earlier sweeps help."""

    @property
    def grid(self) -> BevGrid:
        """The grid of every estimate that comes back."""
        ...

    def estimate_level(self, leveled: LeveledSweep, past: History | None = None) -> FovEstimate:
        """Return the estimate for a sweep that is already leveled, and what earlier ones tell of it."""
        ...


@dataclass(frozen=True, slots=True)
class TemporalEstimator:
    """An estimator for a stream: each estimate uses what the agent's earlier sweeps saw.

    Sweeps without a pose or a time are estimated by themselves.

    Attributes:
        inner: what estimates.
        memory: what it is told of the past.
        wary: claim only what an earlier sweep would have seen as well, see :func:`where_confirmed`; without earlier
            sweeps that is nothing.
    """

    inner: PastEstimator
    memory: SweepBuffer = field(default_factory=SweepBuffer)
    wary: bool = False

    @property
    def grid(self) -> BevGrid:
        """Grid of the estimates."""
        return self.inner.grid

    def estimate(self, sweep: Sweep) -> FovEstimate:
        """Return the estimate for the next sweep of the stream, and remember the sweep."""
        leveled = level(sweep, self.grid)
        past = self.memory.past(leveled)
        found = self.inner.estimate_level(leveled, past)
        self.memory.add(leveled)
        return where_confirmed(found, past) if self.wary else found


def where_confirmed(estimate: FovEstimate, past: History | None) -> FovEstimate:
    """Return an estimate whose claims each rest on two sweeps: this one, and an earlier one that saw the cell as well.

    Elsewhere its probability is 0, and what was claimed is UNKNOWN. Who opens a view by spoofed returns must have begun
    before the earlier sweeps; what comes into view for the first time waits for the next one.
    """
    confirmed = np.zeros(estimate.grid.shape, np.bool_)
    if past is not None:
        confirmed = past.confirmations(estimate.grid, estimate.target) > 0
    claimed = (estimate.state == CellState.FREE) | (estimate.state == CellState.SURFACE)
    return replace(
        estimate,
        visible_prob=np.where(confirmed, estimate.visible_prob, np.float32(0.0)),
        state=np.where(claimed & ~confirmed, np.uint8(CellState.UNKNOWN), estimate.state),
    )
