"""The monitor of a stream: earlier sweeps of each agent are kept for the evidence, and doubt adds up over time."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from viewshed.arrays import F32
from viewshed.fov.estimate import FovEstimate
from viewshed.monitor.evidence import EVIDENCE, Evidence, MonitoredSweep
from viewshed.monitor.over_time import EDetector
from viewshed.monitor.report import IntegrityReport
from viewshed.monitor.sweep_monitor import EARLIER_SWEEPS, SweepMonitor, group_of
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.preprocess.streams import AGENTS, remember, why_anew


@dataclass(frozen=True, slots=True, eq=False)
class StreamReport:
    """Doubt about a stream, at one of its sweeps.

    Attributes:
        now: the report on the sweep alone.
        alarm: whether the sweeps together speak against the stream.
        wealth: how much: the value of the e-detector; it alarms from ``limit`` on, and begins anew after that.
        limit: of ``wealth``.
        delay_s: time since the doubt that is left began, in seconds; 0 where there is none, or without times.
        notes: what became of the stream: a sentence each.
        doubtful_sweeps: sweeps since the doubt that is left began.
    """

    now: IntegrityReport
    alarm: bool
    wealth: float
    limit: float
    delay_s: float
    notes: tuple[str, ...] = ()
    doubtful_sweeps: int = 0


@dataclass(slots=True)
class RecentSweeps:
    """The last sweeps of one stream, as evidence over time is given them.

    A stream begins anew, without earlier sweeps, where its time goes back, repeats or jumps, or its sensor changes.

    Attributes:
        every_s: time between the earlier sweeps that the evidence is given; they may be a quarter nearer.
        jump_s: a stream without a sweep for longer begins anew: what appeared or vanished meanwhile may have done so
            for a cause that nobody saw. Estimates are helped by sweeps of up to 10 s ago (``temporal.FORGET_S``).

    Raises:
        ValueError: a time is not positive.
    """

    every_s: float = 0.1
    jump_s: float = 0.5
    _kept: deque[LeveledSweep] = field(default_factory=lambda: deque(maxlen=EARLIER_SWEEPS + 1), repr=False)
    _sensor: str = ""
    _last_ns: int | None = None

    def __post_init__(self) -> None:
        if not (self.every_s > 0.0 and self.jump_s > 0.0):
            raise ValueError(f"every_s and jump_s must be positive, got {self.every_s} and {self.jump_s}")

    def before(self, leveled: LeveledSweep) -> tuple[LeveledSweep, ...]:
        """Return the earlier sweeps (up to EARLIER_SWEEPS) of the next sweep, the oldest first."""
        now_ns = leveled.sweep.t_ns
        earlier = [each for each in self._kept if now_ns is not None and self._apart(now_ns, each.sweep.t_ns)]
        return tuple(earlier[-EARLIER_SWEEPS:])

    def add(self, leveled: LeveledSweep) -> None:
        """Keep a sweep, if it has a time and the last one that is kept lies far enough before."""
        now_ns = leveled.sweep.t_ns
        self._sensor, self._last_ns = _sensor_of(leveled), now_ns
        if now_ns is None:
            self._kept.clear()
        elif not self._kept or self._apart(now_ns, self._kept[-1].sweep.t_ns):
            self._kept.append(leveled)

    def why_anew(self, leveled: LeveledSweep) -> str:
        """Return why the stream must begin anew with a sweep, in a sentence; empty where it goes on."""
        sensor = _sensor_of(leveled)
        if self._sensor and sensor != self._sensor:
            return f"the sensor changed from {self._sensor} to {sensor}: the stream begins anew"
        return why_anew(self._last_ns, leveled.sweep.t_ns, self.jump_s)

    def _apart(self, now_ns: int, then_ns: int | None) -> bool:
        """Return whether a sweep is early enough before another to be one of its earlier sweeps."""
        return then_ns is not None and now_ns - then_ns >= 0.75e9 * self.every_s


def _sensor_of(leveled: LeveledSweep) -> str:
    return group_of(MonitoredSweep(leveled)).sensor


@dataclass(slots=True)
class _Agent:
    """What is kept of one agent."""

    detector: EDetector
    earlier: RecentSweeps
    evidence: list[F32] = field(default_factory=list)
    onset_ns: int | None = None


@dataclass(slots=True)
class StreamMonitor:
    """Checks the sweeps of a stream in the order of time, of any number of agents.

    A stream begins anew, without earlier sweeps and without doubt, where its time goes back, repeats or jumps, or its
    sensor changes; the report says so. Whoever can forge times can make it forget: who trusts no clock should take
    such a note for an alarm.

    Attributes:
        monitor: of each sweep.
        detector: over time; each agent has one like it.
        every_s: time between the earlier sweeps that the evidence is given; they may be a quarter nearer.
        jump_s: a stream without a sweep for longer begins anew.
        agents: how many are kept; of more the one that was seen longest ago is dropped.
        evidence: what is measured.

    Raises:
        ValueError: a time is not positive, or no agent may be kept.
    """

    monitor: SweepMonitor
    detector: EDetector
    every_s: float = 0.1
    jump_s: float = 0.5
    agents: int = AGENTS
    evidence: Mapping[str, Evidence] = field(default_factory=lambda: EVIDENCE)
    _agents: dict[str, _Agent] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        RecentSweeps(self.every_s, self.jump_s)
        if self.agents < 1:
            raise ValueError(f"agents must be 1 at least, got {self.agents}")

    def fresh(self) -> StreamMonitor:
        """Return a monitor like this one, without any sweep."""
        return replace(self, _agents={})

    def check(self, leveled: LeveledSweep, estimates: Mapping[str, FovEstimate] | None = None) -> StreamReport:
        """Return what the monitor says of the next sweep of an agent, and keep the sweep.

        Args:
            leveled: the sweep.
            estimates: of it that were made anyway, by method.

        Raises:
            ValueError: as for :meth:`SweepMonitor.check`; the sweep is then not kept.
        """
        name, now_ns = leveled.sweep.agent, leveled.sweep.t_ns
        agent = self._agents.get(name)
        note = "" if agent is None else agent.earlier.why_anew(leveled)
        if agent is None or note:
            agent = _Agent(self.detector.fresh(), RecentSweeps(self.every_s, self.jump_s))
        elif now_ns is None:
            note = "the sweep has no time: it is judged without earlier sweeps"
        monitored = MonitoredSweep(leveled, agent.earlier.before(leveled), estimates or {})
        now = self.monitor.check(monitored, self.evidence, agent.evidence)
        alarm = agent.detector.add(now.tail_p_value)
        if agent.detector.doubtful_sweeps <= 1:
            agent.onset_ns = now_ns
        delay_s = 0.0 if now_ns is None or agent.onset_ns is None else (now_ns - agent.onset_ns) * 1e-9
        agent.earlier.add(leveled)
        remember(self._agents, name, agent, self.agents)
        detector, notes = agent.detector, (note,) if note else ()
        return StreamReport(now, alarm, detector.wealth, detector.limit, delay_s, notes, detector.doubtful_sweeps)

    def reset(self, agent: str | None = None) -> None:
        """Forget an agent, or all: its stream begins anew, without earlier sweeps and without doubt."""
        for name in [agent] if agent is not None else list(self._agents):
            self._agents.pop(name, None)
