"""What a monitor says of sweeps, one after the other, in lines: for ``estimate --monitor`` and ``monitor check``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from viewshed.integrity import IntegrityReport
    from viewshed.integrity.evidence import MonitoredSweep
    from viewshed.integrity.over_time import EDetector
    from viewshed.integrity.score import HeldEvidence
    from viewshed.integrity.stream_monitor import EarlierSweeps
    from viewshed.integrity.sweep_monitor import SweepMonitor
    from viewshed.preprocess.leveling import LeveledSweep

FALSE_ALARMS_PER_HOUR, HZ = 1.0, 10.0
"""Stated rate of false alarms over time, for a sensor that turns so often a second."""

SCENE_NS = 20_000_000_000
"""A longer drive counts as several scenes."""


def monitor_of(file: Path | None) -> SweepMonitor:
    """Return the monitor in a file of ``viewshed monitor calibrate``, or the one in the box."""
    from viewshed.integrity.sweep_monitor import load_sweep_monitor, shipped_monitor

    return shipped_monitor() if file is None else load_sweep_monitor(file)


@dataclass(slots=True)
class Drives:
    """Goes through sweeps drive by drive, and says what was measured before each of them."""

    name: str = ""
    began_ns: int = 0
    earlier: EarlierSweeps | None = None
    goes_on: bool = False

    def next(self, leveled: LeveledSweep, drive: str) -> MonitoredSweep:
        """Return the next sweep with those before it, and keep it."""
        from viewshed.integrity.evidence import MonitoredSweep
        from viewshed.integrity.stream_monitor import EarlierSweeps

        self.goes_on = self.earlier is not None and drive == self.name and not self.earlier.why_anew(leveled)
        if self.earlier is None or not self.goes_on:
            self.name, self.began_ns, self.earlier = drive, leveled.sweep.t_ns or 0, EarlierSweeps()
        monitored = MonitoredSweep(leveled, self.earlier.before(leveled))
        self.earlier.add(leveled)
        return monitored

    def scene(self, leveled: LeveledSweep) -> str:
        """Return the scene of the last sweep: a piece of 20 s of its drive."""
        return f"{self.name} {self.began_ns} {((leveled.sweep.t_ns or 0) - self.began_ns) // SCENE_NS}"


@dataclass(slots=True)
class Judge:
    """A monitor at work on sweeps in their order."""

    monitor: SweepMonitor
    checked: int = 0
    inconsistent: int = 0
    degraded: int = 0
    alarms: int = 0
    _drives: Drives = field(default_factory=Drives)
    _detector: EDetector | None = None
    _held: HeldEvidence | None = None

    def judge(self, leveled: LeveledSweep, drive: str) -> tuple[MonitoredSweep, IntegrityReport, str]:
        """Return the next sweep with those before it, what the monitor says of it, and that in words."""
        from viewshed.integrity.over_time import EDetector
        from viewshed.integrity.score import HeldEvidence

        monitored = self._drives.next(leveled, drive)
        if self._detector is None or self._held is None or not self._drives.goes_on:
            self._detector = EDetector.for_rate(per_hour=FALSE_ALARMS_PER_HOUR, hz=HZ)
            self._held = HeldEvidence()
        report = self.monitor.check(monitored, held=self._held)
        alarm = self._detector.add(report.p_value)
        self.checked += 1
        self.inconsistent += report.inconsistent
        self.degraded += report.degraded
        self.alarms += alarm
        over_time = f"; ALARM over the last {self._detector.doubtful_sweeps} sweeps" if alarm else ""
        return monitored, report, f"{verdicts(report)}{over_time}"

    def summary(self) -> str:
        """Return how many sweeps were checked and what was found, in a line."""
        over_time = f", {self.alarms} alarms over time" if self.alarms else ""
        return f"{self.checked} sweeps, {self.inconsistent} inconsistent, {self.degraded} degraded{over_time}"


def verdicts(report: IntegrityReport) -> str:
    """Return what a monitor says of a sweep in a line: verdicts, p-value, suspect azimuths, and the first reason.

    >>> import numpy as np
    >>> from viewshed.integrity import IntegrityReport
    >>> suspect = np.arange(72) == 40
    >>> reasons = ("7 % of the returns at 22° lie on no beam",)
    >>> verdicts(IntegrityReport("sweep", 3.0, 2.0, 0.002, suspect=suspect, reasons=reasons))
    'INCONSISTENT (p = 0.002) at 20° to 25°: 7 % of the returns at 22° lie on no beam'
    """
    said = [word for word, is_so in (("INCONSISTENT", report.inconsistent), ("DEGRADED", report.degraded)) if is_so]
    where = f" at {azimuths(report.suspect)}" if report.suspect.any() else ""
    why = f": {report.reasons[0]}" if report.reasons and said else ""
    notes = "".join(f"; {note}" for note in report.notes)
    return f"{' and '.join(said) or 'nothing found'} (p = {report.p_value:.2g}){where}{why}{notes}"


def azimuths(suspect: NDArray[Any]) -> str:
    """Return which azimuths some sectors (SECTORS,) cover, in degrees counter-clockwise from ahead.

    >>> import numpy as np
    >>> azimuths(np.isin(np.arange(72), [0, 1, 40]))
    '-180° to -170°, 20° to 25°'
    """
    import numpy as np

    width = 360 // len(suspect)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], suspect, [False]])))
    return ", ".join(
        f"{first * width - 180}° to {last * width - 180}°" for first, last in edges.reshape(-1, 2).tolist()
    )
