"""The monitor of streams: earlier sweeps of each agent are kept, and each sweep is judged by its own past."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from viewshed.arrays import F32, Mask
from viewshed.grid import BevGrid
from viewshed.monitor.calibration import NAME, Calibration, shipped_calibration
from viewshed.monitor.degraded import SensorState
from viewshed.monitor.evidence import EARLIER_SWEEPS, EVIDENCE, SECTORS, CellMemory, MonitoredSweep, measure_all
from viewshed.monitor.impossible import impossible_reasons
from viewshed.monitor.report import IntegrityReport, cells_of_sectors
from viewshed.monitor.score import RARE
from viewshed.monitor.watch import Verdict, Watch
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.preprocess.streams import AGENTS, FORGET_S, remember, why_anew

PER_HOUR = 6.0
"""False alarms an hour that are asked for unless another number is given."""

ALONE = "one sweep cannot tell a forgery that keeps to the beams"


@dataclass(frozen=True, slots=True, eq=False)
class StreamReport:
    """Doubt about a stream, at one of its sweeps.

    Attributes:
        now: the report on the sweep.
        alarm: whether the stream is to be doubted: from the first inconsistent sweep on, until enough were not.
        delay_s: time since the alarm began, in seconds; 0 where there is none, or without times.
        suspect: (SECTORS,) bool, where, of all sweeps of the alarm.
        notes: what became of the stream: a sentence each.
        doubtful_sweeps: sweeps of the alarm so far.
    """

    now: IntegrityReport
    alarm: bool
    delay_s: float = 0.0
    suspect: Mask = field(default_factory=lambda: np.zeros(SECTORS, np.bool_))
    notes: tuple[str, ...] = ()
    doubtful_sweeps: int = 0


@dataclass(slots=True)
class EvidenceStream:
    """The last sweeps of one stream, and what all evidence says of the next one against them.

    Attributes:
        jump_s: after a longer time without a sweep the next one is not compared with those before it: what appeared or
            vanished meanwhile may have done so for a cause that nobody saw.
    """

    jump_s: float = 0.5
    _earlier: deque[LeveledSweep] = field(default_factory=lambda: deque(maxlen=EARLIER_SWEEPS), repr=False)
    _memory: CellMemory = field(default_factory=CellMemory, repr=False)
    _sensor: str = ""
    _last_ns: int | None = None

    def copy(self) -> EvidenceStream:
        """Return a stream with the same past, which goes on by itself."""
        return replace(self, _earlier=self._earlier.copy(), _memory=self._memory.copy())

    def why_anew(self, leveled: LeveledSweep) -> str:
        """Return why the stream must begin anew with a sweep, in a sentence; empty where it goes on."""
        sensor = _sensor_of(leveled)
        if sensor and self._sensor and sensor != self._sensor:
            return f"the sensor changed from {self._sensor} to {sensor}: the stream begins anew"
        return why_anew(self._last_ns, leveled.sweep.t_ns, FORGET_S)

    def measure(self, leveled: LeveledSweep) -> F32:
        """Return what all evidence says (E, SECTORS) of the next sweep."""
        if why_anew(self._last_ns, leveled.sweep.t_ns, self.jump_s):
            self._earlier.clear()
        return measure_all(MonitoredSweep(leveled, tuple(self._earlier), self._memory))

    def add(self, leveled: LeveledSweep, *, compared: bool = True) -> None:
        """Remember a sweep; the next ones are compared with it if wanted."""
        self._sensor, self._last_ns = _sensor_of(leveled) or self._sensor, leveled.sweep.t_ns
        if compared:
            self._earlier.append(leveled)
            self._memory.add(leveled)


@dataclass(slots=True)
class _Agent:
    """What is kept of one agent."""

    stream: EvidenceStream
    watch: Watch
    state: SensorState = field(default_factory=SensorState)
    onset_ns: int | None = None


@dataclass(slots=True)
class StreamMonitor:
    """Checks the sweeps of a stream in the order of time, of any number of agents.

    A stream begins anew, without a past and without an alarm, where its time goes back, repeats or jumps, or its sensor
    changes; the report says so. Whoever can forge times can make it forget: who trusts no clock should take such a note
    for an alarm.

    Attributes:
        calibration: says how rare a change is, and which limit a rate needs; the shipped one unless given.
        per_hour: expected false alarms an hour.
        jump_s: see :class:`EvidenceStream`; after ``FORGET_S`` without a sweep a stream begins anew.
        agents: how many are kept; of more the one that was seen longest ago is dropped.

    Raises:
        ValueError: a number is not positive, or no agent may be kept.
    """

    calibration: Calibration = field(default_factory=shipped_calibration)
    per_hour: float = PER_HOUR
    jump_s: float = 0.5
    agents: int = AGENTS
    limit: float = field(init=False)
    _agents: dict[str, _Agent] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.jump_s > 0.0:
            raise ValueError(f"jump_s must be positive, got {self.jump_s}")
        if self.agents < 1:
            raise ValueError(f"agents must be 1 at least, got {self.agents}")
        self.limit = self.calibration.limit(self.per_hour, extrapolate=True)

    def fresh(self) -> StreamMonitor:
        """Return a monitor like this one, without any sweep."""
        return replace(self)

    def check(self, leveled: LeveledSweep, grid: BevGrid | None = None) -> StreamReport:
        """Return what the monitor says of the next sweep of an agent, and keep the sweep.

        Args:
            leveled: the sweep; it may be empty.
            grid: on which the report marks suspect cells.
        """
        name, now_ns = leveled.sweep.agent, leveled.sweep.t_ns
        # 1. Does the stream go on?
        agent = self._agents.get(name)
        note = "" if agent is None else agent.stream.why_anew(leveled)
        if agent is None or note:
            agent = _Agent(EvidenceStream(self.jump_s), Watch(self.calibration, self.limit))
        # 2. The evidence of the sweep, against the past of the stream; and what is impossible without any past.
        evidence = agent.stream.measure(leveled)
        impossible = impossible_reasons(leveled)
        verdict = agent.watch.check(evidence, impossible=bool(impossible))
        degraded = agent.state.check(leveled, evidence)
        # 3. What is remembered: sweeps that do not fit are no past, until the world seems to have changed.
        fits = not verdict.inconsistent or (verdict.sweeps > EARLIER_SWEEPS and not impossible)
        agent.stream.add(leveled, compared=fits)
        agent.onset_ns = now_ns if verdict.sweeps <= 1 else agent.onset_ns
        remember(self._agents, name, agent, self.agents)
        delay_s = 0.0 if now_ns is None or agent.onset_ns is None else (now_ns - agent.onset_ns) * 1e-9
        now = self._report(verdict, impossible, degraded, evidence, grid)
        notes = (note,) if note else ()
        return StreamReport(now, verdict.alarm, delay_s, verdict.suspect, notes, verdict.sweeps)

    def _report(
        self, verdict: Verdict, impossible: tuple[str, ...], degraded: tuple[str, ...], evidence: F32,
        grid: BevGrid | None,
    ) -> IntegrityReport:  # fmt: skip
        """Return the report on one sweep; its reasons are the rarest changes, the rarest first."""
        surprises = np.nan_to_num(verdict.sectors).max(axis=1)
        kinds = list(EVIDENCE.values())
        order = np.argsort(-surprises, kind="stable")
        rare = order[: max(int((surprises >= RARE).sum()), int(verdict.inconsistent))]
        changed = tuple(kinds[k].reason(evidence[k]) for k in rare if np.isfinite(evidence[k]).any())
        suspect = verdict.suspect if verdict.inconsistent else np.zeros(SECTORS, np.bool_)
        alone = bool(np.isnan(verdict.score))
        score = 0.0 if alone else verdict.score
        score = max(score, self.limit + 1.0) if impossible else score
        return IntegrityReport(
            NAME, score, self.limit,
            np.nan if alone else self.calibration.p_value(verdict.score), bool(degraded), suspect=suspect, grid=grid,
            suspect_cells=np.zeros((0, 0), np.bool_) if grid is None else cells_of_sectors(suspect, grid),
            reasons=(*impossible, *degraded, *(changed if verdict.inconsistent else ())),
            notes=() if impossible or not alone else (ALONE,), evidence=verdict.sectors,
        )  # fmt: skip

    def reset(self, agent: str | None = None) -> None:
        """Forget an agent, or all: its stream begins anew."""
        for name in [agent] if agent is not None else list(self._agents):
            self._agents.pop(name, None)


def _sensor_of(leveled: LeveledSweep) -> str:
    """Return the name of the sensor that a sweep says it is of; empty where it says none.

    What is only identified by the points is no change of the sensor: an attack may hide it.
    """
    model = leveled.sweep.model
    return "" if model is None else model.name
