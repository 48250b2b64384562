"""The monitor of a stream: earlier sweeps of each agent are kept for the evidence, and doubt adds up over time."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from viewshed.fov.estimate import FovEstimate
from viewshed.integrity.evidence import EVIDENCE, Evidence, MonitoredSweep
from viewshed.integrity.over_time import EDetector
from viewshed.integrity.report import IntegrityReport
from viewshed.integrity.sweep_monitor import EARLIER_SWEEPS, SweepMonitor, group_of
from viewshed.preprocess.leveling import LeveledSweep


@dataclass(frozen=True, slots=True, eq=False)
class StreamReport:
    """Doubt about a stream, at one of its sweeps.

    Attributes:
        now: what is said of the sweep alone.
        alarm: whether the sweeps together speak against the stream.
        wealth: how much; it alarms from ``limit`` on, and begins anew after that.
        limit: of the wealth.
        delay_s: time since the doubt that is left began, in seconds; 0 where there is none, or without times.
        notes: what became of the stream: a sentence each.
    """

    now: IntegrityReport
    alarm: bool
    wealth: float
    limit: float
    delay_s: float
    notes: tuple[str, ...] = ()


@dataclass(slots=True)
class _Agent:
    """What is kept of one agent."""

    detector: EDetector
    sensor: str
    kept: deque[LeveledSweep] = field(default_factory=lambda: deque(maxlen=EARLIER_SWEEPS + 1))
    last_ns: int | None = None
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
    agents: int = 64
    evidence: Mapping[str, Evidence] = field(default_factory=lambda: EVIDENCE)
    _agents: dict[str, _Agent] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if not (self.every_s > 0.0 and self.jump_s > 0.0) or self.agents < 1:
            raise ValueError(
                f"every_s and jump_s must be positive and agents 1 at least, got {self.every_s}, {self.jump_s} and"
                f" {self.agents}"
            )

    def check(self, leveled: LeveledSweep, estimates: Mapping[str, FovEstimate] | None = None) -> StreamReport:
        """Return what the monitor says of the next sweep of an agent, and keep the sweep.

        Args:
            leveled: the sweep.
            estimates: of it that were made anyway, by method.

        Raises:
            ValueError: as for :meth:`SweepMonitor.check`; the sweep is then not kept.
        """
        # Taken out and put back last: the first agent is the one that was seen longest ago.
        name, now_ns = leveled.sweep.agent, leveled.sweep.t_ns
        agent, notes = self._continued(self._agents.get(name), leveled)
        earlier = () if now_ns is None else tuple(
            each for each in agent.kept if self._apart(now_ns, each.sweep.t_ns)
        )  # fmt: skip
        monitored = MonitoredSweep(leveled, earlier[-EARLIER_SWEEPS:], estimates or {})
        now = self.monitor.check(monitored, self.evidence)
        alarm = agent.detector.add(now.p_value)
        if agent.detector.doubtful_sweeps <= 1:
            agent.onset_ns = now_ns
        delay_s = 0.0 if now_ns is None or agent.onset_ns is None else (now_ns - agent.onset_ns) * 1e-9
        agent.last_ns = now_ns
        if now_ns is not None and (not agent.kept or self._apart(now_ns, agent.kept[-1].sweep.t_ns)):
            agent.kept.append(leveled)
        self._agents.pop(name, None)
        self._agents[name] = agent
        while len(self._agents) > self.agents:
            del self._agents[next(iter(self._agents))]
        return StreamReport(now, alarm, agent.detector.wealth, agent.detector.limit, delay_s, notes)

    def _apart(self, now_ns: int, then_ns: int | None) -> bool:
        """Return whether a sweep is early enough before another to be one of its earlier sweeps."""
        return then_ns is not None and now_ns - then_ns >= 0.75e9 * self.every_s

    def _continued(self, agent: _Agent | None, leveled: LeveledSweep) -> tuple[_Agent, tuple[str, ...]]:
        """Return the agent of a sweep, or one that begins anew where the sweep does not follow, and why."""
        sensor, now_ns = group_of(MonitoredSweep(leveled)).sensor, leveled.sweep.t_ns
        new = _Agent(self.detector.fresh(), sensor)
        if agent is None:
            return new, ()
        if sensor != agent.sensor:
            return new, (f"the sensor changed from {agent.sensor} to {sensor}: the stream begins anew",)
        if now_ns is None or agent.last_ns is None:
            agent.kept.clear()
            return agent, ("the sweep has no time: it is judged without earlier sweeps",) if now_ns is None else ()
        gap_s = (now_ns - agent.last_ns) * 1e-9
        if gap_s == 0.0:
            return new, ("the time repeats that of the sweep before: the stream begins anew",)
        if gap_s < 0.0:
            return new, (f"the time goes back by {-gap_s:.3g} s: the stream begins anew",)
        if gap_s > self.jump_s:
            return new, (f"the time jumps by {gap_s:.3g} s: the stream begins anew",)
        return agent, ()
