"""The monitor of streams: earlier sweeps of each agent are kept, and each sweep is judged by its own past."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from viewshed.arrays import F32, Mask
from viewshed.grid import BevGrid
from viewshed.monitor.calibration import NAME, Calibration, load_calibration, shipped_calibration
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

LOOKED_SWEEPS = 20
"""Sweeps of a stream after which evidence that looked at nothing yet is noted: the slowest needs a second."""


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
    _last_ns: int | None = None

    def copy(self) -> EvidenceStream:
        """Return a stream with the same past, which goes on by itself."""
        return replace(self, _earlier=self._earlier.copy(), _memory=self._memory.copy())

    def why_anew(self, leveled: LeveledSweep) -> str:
        """Return why the stream must begin anew with a sweep, in a sentence; empty where it goes on."""
        return why_anew(self._last_ns, leveled.sweep.t_ns, FORGET_S)

    def gap_s(self, leveled: LeveledSweep) -> float:
        """Return the time since the last sweep, in seconds, if the next one is not compared with it; 0 if it is."""
        now_ns = leveled.sweep.t_ns
        if self._last_ns is None or now_ns is None or not why_anew(self._last_ns, now_ns, self.jump_s):
            return 0.0
        return (now_ns - self._last_ns) * 1e-9

    def measure(self, leveled: LeveledSweep) -> F32:
        """Return what all evidence says (E, SECTORS) of the next sweep."""
        if self.gap_s(leveled):
            self._earlier.clear()
        return measure_all(MonitoredSweep(leveled, tuple(self._earlier), self._memory))

    def add(self, leveled: LeveledSweep, *, compared: bool = True) -> None:
        """Remember a sweep; the next ones are compared with it if wanted."""
        self._last_ns = leveled.sweep.t_ns
        if compared:
            self._earlier.append(leveled)
            self._memory.add(leveled)


@dataclass(slots=True)
class _Agent:
    """What is kept of one sensor of an agent."""

    stream: EvidenceStream
    watch: Watch
    state: SensorState = field(default_factory=SensorState)
    onset_ns: int | None = None
    sweeps: int = 0
    silent: Mask = field(default_factory=lambda: np.ones(len(EVIDENCE), np.bool_))  # kinds that looked at nothing yet


@dataclass(slots=True)
class StreamMonitor:
    """Checks the sweeps of a stream in the order of time, of any number of agents.

    Each sensor of an agent that ``Sweep.model`` names is a stream of its own. A stream begins anew, without a past and
    without an alarm, where its time goes back, repeats or jumps; the report says so. Whoever can forge times can make
    it forget: who trusts no clock should take such a note for an alarm.

    Attributes:
        calibration: says how rare a change is, and which limit a rate needs; the shipped one unless given.
        per_hour: expected false alarms an hour.
        jump_s: see :class:`EvidenceStream`; after ``FORGET_S`` without a sweep a stream begins anew.
        agents: how many streams are kept; of more the one that was seen longest ago is dropped.

    Raises:
        ValueError: a number is not positive, or no agent may be kept.
    """

    calibration: Calibration = field(default_factory=shipped_calibration)
    per_hour: float = PER_HOUR
    jump_s: float = 0.5
    agents: int = AGENTS
    limit: float = field(init=False)
    _agents: dict[tuple[str, str], _Agent] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.jump_s > 0.0:
            raise ValueError(f"jump_s must be positive, got {self.jump_s}")
        if self.agents < 1:
            raise ValueError(f"agents must be 1 at least, got {self.agents}")
        self.limit = self.calibration.limit(self.per_hour, extrapolate=True)

    @classmethod
    def of_file(cls, path: str | Path, per_hour: float | None = None) -> StreamMonitor:
        """Return the monitor of a file of ``viewshed monitor calibrate``, at the file's rate unless another is given.

        Raises:
            ValueError: the file is none, of other evidence, or damaged.
            OSError: it cannot be read.
        """
        calibration = load_calibration(path)
        return cls(calibration, float(calibration.facts.get("per_hour", PER_HOUR)) if per_hour is None else per_hour)

    def fresh(self) -> StreamMonitor:
        """Return a monitor like this one, without any sweep."""
        return replace(self)

    def check(self, leveled: LeveledSweep, grid: BevGrid | None = None) -> StreamReport:
        """Return what the monitor says of the next sweep of an agent, and keep the sweep.

        Args:
            leveled: the sweep; it may be empty.
            grid: on which the report marks suspect cells.
        """
        key, now_ns = self._key_of(leveled), leveled.sweep.t_ns
        # 1. Does the stream go on?
        agent = self._agents.get(key)
        note = "" if agent is None else agent.stream.why_anew(leveled)
        if agent is None or note:
            agent = _Agent(EvidenceStream(self.jump_s), Watch(self.calibration, self.limit))
        gap_s = agent.stream.gap_s(leveled)
        # 2. The evidence of the sweep, against the past of the stream; and what is impossible without any past.
        evidence = agent.stream.measure(leveled)
        impossible = impossible_reasons(leveled)
        verdict = agent.watch.check(evidence, impossible=bool(impossible))
        degraded = agent.state.check(leveled, evidence)
        agent.sweeps, agent.silent = agent.sweeps + 1, agent.silent & ~np.isfinite(evidence).any(axis=1)
        lacks = self._lacks(agent, leveled, gap_s)
        # 3. What is remembered: sweeps that do not fit are no past, until the world seems to have changed.
        fits = not verdict.inconsistent or (verdict.sweeps > EARLIER_SWEEPS and not impossible)
        agent.stream.add(leveled, compared=fits)
        agent.onset_ns = now_ns if verdict.sweeps <= 1 else agent.onset_ns
        remember(self._agents, key, agent, self.agents)
        delay_s = 0.0 if now_ns is None or agent.onset_ns is None else (now_ns - agent.onset_ns) * 1e-9
        now = self._report(verdict, impossible, degraded, evidence, grid, lacks)
        notes = (note,) if note else ()
        return StreamReport(now, verdict.alarm, delay_s, verdict.suspect, notes, verdict.sweeps)

    def _key_of(self, leveled: LeveledSweep) -> tuple[str, str]:
        """Return agent and sensor of a sweep; one that names no sensor is of the last one of its agent.

        What is only identified by the points is no name of a sensor: an attack may change it.
        """
        agent, model = leveled.sweep.agent, leveled.sweep.model
        if model is not None:
            return agent, model.name
        return next((key for key in reversed(self._agents) if key[0] == agent), (agent, ""))

    def _lacks(self, agent: _Agent, leveled: LeveledSweep, gap_s: float) -> tuple[str, ...]:
        """Return what a report does not rest on, a sentence each: of the stream once, and of a gap before the sweep."""
        notes = [f"the last sweep is {gap_s:.1f} s old: it is not compared"] if gap_s else []
        least = self.calibration.least_per_hour
        if agent.sweeps == 1 and self.per_hour < least * (1.0 - 1e-9):
            notes.append(f"{self.per_hour:g} false alarms an hour are an extrapolation: the drives support {least:.2g}")
        if agent.sweeps == LOOKED_SWEEPS and agent.silent.any():
            has_rings = leveled.range_image is not None and leveled.sensor_id.layout is None
            missing = (("poses", leveled.sweep.world_from_sensor is not None), ("rings", has_rings))
            words = " or ".join(word for word, is_there in missing if not is_there)
            if words:
                count = int(agent.silent.sum())
                look = "looks" if count == 1 else "look"
                notes.append(f"without {words}, {count} of {len(EVIDENCE)} kinds of evidence {look} at nothing")
        return tuple(notes)

    def _report(
        self, verdict: Verdict, impossible: tuple[str, ...], degraded: tuple[str, ...], evidence: F32,
        grid: BevGrid | None, lacks: tuple[str, ...],
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
        # No p-value without a past, or where all evidence abstains.
        p_value = np.nan if np.isnan(verdict.sectors).all() else self.calibration.p_value(verdict.score)
        return IntegrityReport(
            NAME, score, self.limit, p_value, bool(degraded), suspect=suspect, grid=grid,
            suspect_cells=np.zeros((0, 0), np.bool_) if grid is None else cells_of_sectors(suspect, grid),
            reasons=(*impossible, *degraded, *(changed if verdict.inconsistent else ())),
            notes=(*(() if impossible or not alone else (ALONE,)), *lacks), evidence=verdict.sectors,
        )  # fmt: skip

    def reset(self, agent: str | None = None) -> None:
        """Forget an agent with all its sensors, or all: its streams begin anew."""
        for key in [key for key in self._agents if agent in (None, key[0])]:
            del self._agents[key]
