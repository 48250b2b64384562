"""What a pipeline remembers of each agent and answers it, and who has a place in it."""

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
"""An agent that was not heard for this time gives up its place in a stream."""

_LONGEST_PERIOD_S = 1.0
"""Of sweeps whose view is stale after two periods; a slower sensor needs a larger ``stale_after_s``."""


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What became of one sweep; or, with STALE caution and a number that was answered before, that none came since."""

    agent: str  # whose it was
    number: int  # of the sweep among all that were put in, from 0
    leveled: LeveledSweep | None  # the sweep; None where it could not be decoded
    estimate: FovEstimate | None  # what it sees, without what the reaction withdraws; None where it could not be had
    report: StreamReport | None  # what the monitor says; None without one, or without an estimate
    reaction: ReactionState  # how far the view is trusted
    # from which a vehicle stops within what is seen free ahead of it; 0 without an estimate, or if STALE
    speed_mps: float
    notes: tuple[str, ...]  # what was noticed on the way (a clock that jumps, say), a sentence each
    refused: str  # why there is no estimate; empty where there is one
    latency_s: float  # from putting the sweep in to its answer
    # detections and explained tracks, by the estimate before anything was withdrawn; None where they are not wanted, or
    # failed: a note says why
    objects: SeenObjects | None = None
    # when the sweep was put in, on the clock of :func:`time.perf_counter`
    put_s: float = field(default_factory=time.perf_counter)

    @property
    def age_s(self) -> float:
        """Seconds since the sweep was put in, whatever its own clock says."""
        return time.perf_counter() - self.put_s


@dataclass(slots=True, eq=False)
class Agent:
    """What a pipeline remembers of an agent; each step of the pipeline changes what it alone uses."""

    name: str  # of the agent
    heard_s: float = 0.0  # when it was heard last
    history: SweepBuffer | None = None  # its earlier sweeps that help an estimate; None for none
    monitor: StreamMonitor | None = None  # what watches its sweeps, or None
    objects: ObjectStream | None = None  # what follows its objects, or None
    last_ns: int | None = None  # time of its last sweep
    sensor: SensorId = UNIDENTIFIED  # what was identified of its last sweep, which is looked at first
    rest: Rest = field(default_factory=Rest)  # what it holds while it stands still, without poses
    reaction: ReactionState = field(default_factory=ReactionState)  # the last one
    newest: Answer | None = None  # its newest answer
    seen_s: float = math.inf  # when the sweep of its newest estimate was put in; inf where there is none yet
    # when its last sweeps with an answer were put in
    puts_s: deque[float] = field(default_factory=lambda: deque(maxlen=6))

    @property
    def period_s(self) -> float:
        """Median time between its sweeps; 0 where it is not known yet."""
        apart_s = [after_s - before_s for before_s, after_s in pairwise(self.puts_s.copy())]
        return min(median(apart_s), _LONGEST_PERIOD_S) if apart_s else 0.0

    @property
    def age_s(self) -> float:
        """Seconds since the sweep of its newest view was put in; -inf where there is none yet."""
        return time.perf_counter() - self.seen_s

    @property
    def stale_note(self) -> str:
        """The report on a view that is too old."""
        return f"the newest view is {self.age_s:.2g} s old: nothing is claimed"

    def time_note(self, t_ns: int | None) -> str:
        """Return why its stream begins anew with a sweep, in a sentence; empty where it goes on.

        Raises:
            ValueError: the time is that of the sweep before.
        """
        if t_ns is None:
            return ""
        before_ns, self.last_ns = self.last_ns, t_ns
        if t_ns == before_ns:
            raise ValueError("a sweep must have another time than the one before, got the same again")
        return why_anew(before_ns, t_ns, FORGET_S)


class Agents(OrderedDict[str, Agent]):
    """The agents that have a place in a stream, by name, the longest unheard one first.

    Each has it from its first sweep on. Where there is none left a new one is refused, so that a flood of names holds
    no memory and takes nobody's place.

    Attributes:
        refused: sweeps of agents that had no place.
    """

    refused = 0

    def heard(self, name: str, now_s: float, begin: Callable[[str], Agent], waiting: Container[str]) -> Agent | None:
        """Return an agent that is heard now; None, and counted, where there is no place for it.

        Args:
            name: of the agent.
            now_s: seconds of a clock that never goes back.
            begin: returns a new agent.
            waiting: agents with something waiting; of these none gives up its place.
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
