"""Stream monitor: compares each sweep of an agent with the recent past of its own stream."""

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
"""Default number of false alarms an hour."""

SINGLE_SWEEP_NOTE = "one sweep alone cannot reveal a forgery that keeps to the beams"

SILENT_SWEEPS = 20
"""Number of sweeps after which evidence that has always abstained is noted; the slowest kind needs a second."""


@dataclass(frozen=True, slots=True, eq=False)
class StreamReport:
    """Report on a stream at one of its sweeps.

    Attributes:
        now: report on this sweep.
        alarm: latched alarm: begins with an inconsistent sweep, ends after enough consistent ones.
        delay_s: seconds since the alarm began; 0 without an alarm or without times.
        suspect: (SECTORS,) bool, suspect sectors of all sweeps of the alarm.
        notes: events of the stream, one sentence each.
        doubtful_sweeps: number of sweeps of the alarm so far.
    """

    now: IntegrityReport
    alarm: bool
    delay_s: float = 0.0
    suspect: Mask = field(default_factory=lambda: np.zeros(SECTORS, np.bool_))
    notes: tuple[str, ...] = ()
    doubtful_sweeps: int = 0


@dataclass(slots=True)
class EvidenceStream:
    """The last sweeps of one stream, against which all evidence of the next sweep is measured.

    Attributes:
        jump_s: after a longer gap the next sweep is not compared with earlier ones, because changes during the gap may
            have honest causes.
    """

    jump_s: float = 0.5
    _earlier: deque[LeveledSweep] = field(default_factory=lambda: deque(maxlen=EARLIER_SWEEPS), repr=False)
    _memory: CellMemory = field(default_factory=CellMemory, repr=False)
    _last_ns: int | None = None

    def copy(self) -> EvidenceStream:
        """Return an independent copy."""
        return replace(self, _earlier=self._earlier.copy(), _memory=self._memory.copy())

    def why_anew(self, leveled: LeveledSweep) -> str:
        """Return one sentence why the stream must restart at this sweep; empty if it continues."""
        return why_anew(self._last_ns, leveled.sweep.t_ns, FORGET_S)

    def gap_s(self, leveled: LeveledSweep) -> float:
        """Return the seconds since the last sweep if they exceed ``jump_s``, else 0."""
        now_ns = leveled.sweep.t_ns
        if self._last_ns is None or now_ns is None or not why_anew(self._last_ns, now_ns, self.jump_s):
            return 0.0
        return (now_ns - self._last_ns) * 1e-9

    def measure(self, leveled: LeveledSweep) -> F32:
        """Return all evidence (E, SECTORS) of the next sweep."""
        if self.gap_s(leveled):
            self._earlier.clear()
        return measure_all(MonitoredSweep(leveled, tuple(self._earlier), self._memory))

    def add(self, leveled: LeveledSweep, *, compared: bool = True) -> None:
        """Remember a sweep; later sweeps are compared with it only if ``compared``."""
        self._last_ns = leveled.sweep.t_ns
        if compared:
            self._earlier.append(leveled)
            self._memory.add(leveled)


@dataclass(slots=True)
class _Agent:
    """State of one sensor of an agent."""

    stream: EvidenceStream
    watch: Watch
    state: SensorState = field(default_factory=SensorState)
    onset_ns: int | None = None
    sweeps: int = 0
    silent: Mask = field(default_factory=lambda: np.ones(len(EVIDENCE), np.bool_))  # kinds that always abstained


@dataclass(slots=True)
class StreamMonitor:
    """Checks the sweeps of any number of agents, each in temporal order.

    Each sensor of an agent that ``Sweep.model`` names is a stream of its own. A stream restarts without past and alarm
    when its time goes back, repeats or jumps; the report notes that. An attacker who can forge time stamps can force a
    restart, so if you do not trust the clock, treat that note as an alarm.

    Attributes:
        calibration: rarity of benign changes, and the limit for a rate; the shipped one by default.
        per_hour: expected number of false alarms an hour.
        jump_s: see :class:`EvidenceStream`; after ``FORGET_S`` without a sweep a stream restarts.
        agents: maximum number of streams kept; beyond it the least recently seen one is dropped.

    Raises:
        ValueError: a number is not positive, or ``agents`` is below 1.
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
        """Return the monitor in a file of ``viewshed monitor calibrate``; ``per_hour`` overrides the file's rate.

        Raises:
            ValueError: the file is no monitor, of other evidence, or damaged.
            OSError: it cannot be read.
        """
        calibration = load_calibration(path)
        return cls(calibration, float(calibration.facts.get("per_hour", PER_HOUR)) if per_hour is None else per_hour)

    def fresh(self) -> StreamMonitor:
        """Return a monitor with the same settings and no sweeps."""
        return replace(self)

    def check(self, leveled: LeveledSweep, grid: BevGrid | None = None) -> StreamReport:
        """Return the report on the next sweep of an agent, and remember the sweep.

        Args:
            leveled: the sweep; it may be empty.
            grid: grid of the report's suspect cells.
        """
        key, now_ns = self._key_of(leveled), leveled.sweep.t_ns
        # 1. Continue or restart the stream.
        agent = self._agents.get(key)
        note = "" if agent is None else agent.stream.why_anew(leveled)
        if agent is None or note:
            agent = _Agent(EvidenceStream(self.jump_s), Watch(self.calibration, self.limit))
        gap_s = agent.stream.gap_s(leveled)
        # 2. Evidence against the past of the stream, and impossible sweeps, which need no past.
        evidence = agent.stream.measure(leveled)
        impossible = impossible_reasons(leveled)
        verdict = agent.watch.check(evidence, impossible=bool(impossible))
        degraded = agent.state.check(leveled, evidence)
        agent.sweeps, agent.silent = agent.sweeps + 1, agent.silent & ~np.isfinite(evidence).any(axis=1)
        limitations = self._limitations(agent, leveled, gap_s)
        # 3. Remember the sweep; inconsistent ones are not compared with, unless the alarm lasts.
        fits = not verdict.inconsistent or (verdict.sweeps > EARLIER_SWEEPS and not impossible)
        agent.stream.add(leveled, compared=fits)
        agent.onset_ns = now_ns if verdict.sweeps <= 1 else agent.onset_ns
        remember(self._agents, key, agent, self.agents)
        delay_s = 0.0 if now_ns is None or agent.onset_ns is None else (now_ns - agent.onset_ns) * 1e-9
        now = self._report(verdict, impossible, degraded, evidence, grid, limitations)
        notes = (note,) if note else ()
        return StreamReport(now, verdict.alarm, delay_s, verdict.suspect, notes, verdict.sweeps)

    def _key_of(self, leveled: LeveledSweep) -> tuple[str, str]:
        """Return agent and sensor of a sweep; a sweep that names no sensor belongs to its agent's last one.

        A sensor that is only identified from the points does not count, because an attack may change it.
        """
        agent, model = leveled.sweep.agent, leveled.sweep.model
        if model is not None:
            return agent, model.name
        return next((key for key in reversed(self._agents) if key[0] == agent), (agent, ""))

    def _limitations(self, agent: _Agent, leveled: LeveledSweep, gap_s: float) -> tuple[str, ...]:
        """Return one sentence for each limitation of a report: of the stream (once), and of a gap before the sweep."""
        notes = [f"the last sweep is {gap_s:.1f} s old: it is not compared"] if gap_s else []
        rate = self.calibration.least_per_hour
        if agent.sweeps == 1 and self.per_hour < rate * (1.0 - 1e-9):
            notes.append(f"{self.per_hour:g} false alarms an hour are an extrapolation: the drives support {rate:.2g}")
        if agent.sweeps == SILENT_SWEEPS and agent.silent.any():
            has_rings = leveled.range_image is not None and leveled.sensor_id.layout is None
            inputs = (("poses", leveled.sweep.world_from_sensor is not None), ("rings", has_rings))
            words = " or ".join(name for name, is_given in inputs if not is_given)
            if words:
                count = int(agent.silent.sum())
                verb = "has" if count == 1 else "have"
                notes.append(f"without {words}, {count} of {len(EVIDENCE)} kinds of evidence {verb} no data")
        return tuple(notes)

    def _report(
        self, verdict: Verdict, impossible: tuple[str, ...], degraded: tuple[str, ...], evidence: F32,
        grid: BevGrid | None, limitations: tuple[str, ...],
    ) -> IntegrityReport:  # fmt: skip
        """Return the report on one sweep; its reasons are the rarest changes, the rarest first."""
        surprises = np.nan_to_num(verdict.sectors).max(axis=1)
        kinds = list(EVIDENCE.values())
        order = np.argsort(-surprises, kind="stable")
        rare = order[: max(int((surprises >= RARE).sum()), int(verdict.inconsistent))]
        changed = tuple(kinds[k].reason(evidence[k]) for k in rare if np.isfinite(evidence[k]).any())
        suspect = verdict.suspect if verdict.inconsistent else np.zeros(SECTORS, np.bool_)
        has_no_past = bool(np.isnan(verdict.score))
        score = 0.0 if has_no_past else verdict.score
        score = max(score, self.limit + 1.0) if impossible else score
        # No p-value without a past, or if all evidence abstains.
        p_value = np.nan if np.isnan(verdict.sectors).all() else self.calibration.p_value(verdict.score)
        return IntegrityReport(
            NAME, score, self.limit, p_value, bool(degraded), suspect=suspect, grid=grid,
            suspect_cells=np.zeros((0, 0), np.bool_) if grid is None else cells_of_sectors(suspect, grid),
            reasons=(*impossible, *degraded, *(changed if verdict.inconsistent else ())),
            notes=(*((SINGLE_SWEEP_NOTE,) if has_no_past and not impossible else ()), *limitations),
            evidence=verdict.sectors,
        )  # fmt: skip

    def reset(self, agent: str | None = None) -> None:
        """Forget one agent with all its sensors, or all agents."""
        for key in [key for key in self._agents if agent in (None, key[0])]:
            del self._agents[key]
