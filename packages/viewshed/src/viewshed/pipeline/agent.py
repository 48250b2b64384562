"""A pipeline's state and answers for each agent, and the bounded table of agents."""

from __future__ import annotations

import math
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Container
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING

from viewshed.estimators.temporal import SweepBuffer
from viewshed.fov.estimate import FovEstimate
from viewshed.monitor.stream_monitor import StreamMonitor, StreamReport
from viewshed.pipeline.reactions import ReactionState
from viewshed.preprocess.held_ground import Rest
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.preprocess.sensor_identification import UNIDENTIFIED, SensorId
from viewshed.preprocess.streams import AGENTS, FORGET_S, why_anew

if TYPE_CHECKING:  # tracks need scipy, which a robot that tracks nothing does without
    from viewshed.objects.object_stream import ObjectStream, SeenObjects

UNHEARD_S = 10.0
"""An agent without a sweep for this long can be replaced by a new agent."""

_MAX_PERIOD_S = 1.0
"""Maximum period used for staleness (two periods); a slower sensor needs a larger ``stale_after_s``."""


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """The answer to one sweep; or, with STALE caution and a repeated number, notice that no newer sweep came."""

    agent: str  # name of the agent
    number: int  # of the sweep in order of :meth:`Pipeline.put`, from 0
    leveled: LeveledSweep | None  # the sweep; None if it could not be decoded
    estimate: FovEstimate | None  # field of view after the reaction withdrew cells; None if it failed
    report: StreamReport | None  # the monitor's report; None without a monitor or an estimate
    reaction: ReactionState  # how far the view is trusted
    # speed from which a vehicle can stop within the free cells ahead; 0 without an estimate, or if STALE
    speed_mps: float
    notes: tuple[str, ...]  # events such as a clock that jumps, one sentence each
    refused: str  # why there is no estimate; empty if there is one
    latency_s: float  # from putting the sweep in to its answer
    # detections and explained tracks, from the estimate before cells were withdrawn; None if not requested or failed
    # (a note says why)
    objects: SeenObjects | None = None
    # when the sweep was put in, on the clock of :func:`time.perf_counter`
    put_s: float = field(default_factory=time.perf_counter)

    @property
    def age_s(self) -> float:
        """Seconds since the sweep was put in, independent of the sweep's own clock."""
        return time.perf_counter() - self.put_s


@dataclass(slots=True, eq=False)
class Agent:
    """A pipeline's state for one agent. Each stage of the pipeline changes only its own fields."""

    name: str
    heard_s: float = 0.0  # time of its last sweep in the inbox
    history: SweepBuffer | None = None  # earlier sweeps for the estimator, or None
    monitor: StreamMonitor | None = None
    objects: ObjectStream | None = None  # detector and tracker, or None
    last_ns: int | None = None  # time stamp of its last sweep
    sensor: SensorId = UNIDENTIFIED  # sensor identified in its last sweep, tried first for the next one
    rest: Rest = field(default_factory=Rest)  # ground held while it stands still without poses
    reaction: ReactionState = field(default_factory=ReactionState)  # the last one
    newest: Answer | None = None
    seen_s: float = math.inf  # when the sweep of its newest estimate was put in; inf without one
    # when its last answered sweeps were put in
    puts_s: deque[float] = field(default_factory=lambda: deque(maxlen=6))

    @property
    def period_s(self) -> float:
        """Median time between its sweeps, at most 1 s; 0 if unknown."""
        intervals_s = [after_s - before_s for before_s, after_s in pairwise(self.puts_s.copy())]
        return min(median(intervals_s), _MAX_PERIOD_S) if intervals_s else 0.0

    @property
    def age_s(self) -> float:
        """Seconds since the sweep of its newest view was put in; -inf without one."""
        return time.perf_counter() - self.seen_s

    @property
    def stale_note(self) -> str:
        """Note that the newest view is too old."""
        return f"the newest view is {self.age_s:.2g} s old: nothing is claimed"

    def time_note(self, t_ns: int | None) -> str:
        """Return one sentence why its stream restarts at this sweep; empty if it continues.

        Raises:
            ValueError: the time equals that of the last sweep.
        """
        if t_ns is None:
            return ""
        before_ns, self.last_ns = self.last_ns, t_ns
        if t_ns == before_ns:
            raise ValueError("a sweep must have another time than the one before, got the same again")
        return why_anew(before_ns, t_ns, FORGET_S)


class Agents(OrderedDict[str, Agent]):
    """The agents of a stream by name, the least recently heard first; at most ``AGENTS``.

    A new agent is refused while the table is full, so that a flood of names neither uses memory nor evicts anyone.

    Attributes:
        refused: number of sweeps refused because the table was full.
    """

    refused = 0

    def heard(self, name: str, now_s: float, begin: Callable[[str], Agent], waiting: Container[str]) -> Agent | None:
        """Return the agent of a sweep that arrives now; count it as refused and return None if the table is full.

        Args:
            name: of the agent.
            now_s: seconds of a monotonic clock.
            begin: creates a new agent.
            waiting: agents with queued sweeps, which are not evicted.
        """
        if name not in self and len(self) >= AGENTS:
            unheard = next((agent for agent in self.values() if agent.name not in waiting), None)
            if unheard is None or now_s - unheard.heard_s < UNHEARD_S:
                self.refused += 1
                return None
            del self[unheard.name]
        agent = self[name] = self.get(name) or begin(name)
        agent.heard_s = now_s
        self.move_to_end(name)
        return agent
