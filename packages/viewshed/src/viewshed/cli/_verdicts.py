"""The monitor that a command was given, and what it says of sweeps in lines."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from viewshed.monitor import IntegrityReport, StreamMonitor
    from viewshed.monitor.evidence import MonitoredSweep
    from viewshed.monitor.stream_monitor import RecentSweeps, StreamReport
    from viewshed.monitor.sweep_monitor import SweepMonitor
    from viewshed.preprocess.leveling import LeveledSweep

HZ = 10.0
"""How often a second a sensor turns, as far as alarms over time are counted in hours."""

SCENE_NS = 20_000_000_000
"""A longer drive counts as several scenes."""


def monitor_of(file: Path | None) -> SweepMonitor:
    """Return the monitor in a file of ``viewshed monitor calibrate``, or the shipped one."""
    from viewshed.monitor.sweep_monitor import load_sweep_monitor, shipped_monitor

    return shipped_monitor() if file is None else load_sweep_monitor(file)


def stream_monitor(file: Path | None) -> StreamMonitor:
    """Return what watches a stream: :func:`monitor_of` a file, and its alarms over time.

    Raises:
        ValueError: the file is no such monitor.
        OSError: it cannot be read.
    """
    from viewshed.monitor import StreamMonitor

    monitor = monitor_of(file)
    return StreamMonitor(monitor, monitor.detector(hz=HZ))


@dataclass(slots=True)
class Drives:
    """Goes through sweeps drive by drive, and says what was measured before each of them."""

    name: str = ""
    began_ns: int = 0
    earlier: RecentSweeps | None = None
    goes_on: bool = False

    def next(self, leveled: LeveledSweep, drive: str) -> MonitoredSweep:
        """Return the next sweep with those before it, and keep it."""
        from viewshed.monitor.evidence import MonitoredSweep
        from viewshed.monitor.stream_monitor import RecentSweeps

        self.goes_on = self.earlier is not None and drive == self.name and not self.earlier.why_anew(leveled)
        if self.earlier is None or not self.goes_on:
            self.name, self.began_ns, self.earlier = drive, leveled.sweep.t_ns or 0, RecentSweeps()
        monitored = MonitoredSweep(leveled, self.earlier.before(leveled))
        self.earlier.add(leveled)
        return monitored

    def scene(self, leveled: LeveledSweep) -> str:
        """Return the scene of the last sweep: a piece of 20 s of its drive."""
        return f"{self.name} {self.began_ns} {((leveled.sweep.t_ns or 0) - self.began_ns) // SCENE_NS}"


def watching(wanted: bool, file: Path | None) -> StreamMonitor | None:
    """Return the :func:`stream_monitor` of ``--monitor`` and ``--monitor-file``; None where neither was given."""
    return stream_monitor(file) if wanted or file is not None else None


def stream_verdicts(report: StreamReport) -> str:
    """Return what a monitor says of a sweep and of its stream so far, in a line: see :func:`verdicts`."""
    over_time = f"; ALARM over the last {report.doubtful_sweeps} sweeps" if report.alarm else ""
    return f"{verdicts(report.now)}{over_time}{''.join(f'; {note}' for note in report.notes)}"


def verdicts(report: IntegrityReport) -> str:
    """Return what a monitor says of a sweep in a line: verdicts, p-values, suspect azimuths, and the first reason.

    The published detector has no p-value: score, limit and suspect area.

    >>> import numpy as np
    >>> from viewshed.monitor import IntegrityReport
    >>> suspect = np.arange(72) == 40
    >>> reasons = ("7 % of the returns at 22° lie on no beam",)
    >>> verdicts(IntegrityReport("sweep", 3.0, 2.0, 0.002, suspect=suspect, reasons=reasons))
    'INCONSISTENT (p = 0.002) at 20° to 25°: 7 % of the returns at 22° lie on no beam'
    """
    if math.isnan(report.p_value):
        alarm = f"ALARM, {report.suspect_m2:.0f} m² suspect" if report.alarm else "no alarm"
        return f"score {report.score:.4f}, limit {report.threshold:.4f}, {alarm}"
    found = (
        ("INCONSISTENT", report.inconsistent, report.p_value), ("DEGRADED", report.degraded, report.degraded_p_value)
    )  # fmt: skip
    verdicts = [word if math.isnan(p) else f"{word} (p = {p:.2g})" for word, is_so, p in found if is_so]
    where = f" at {azimuths(report.suspect)}" if report.suspect.any() else ""
    why = f": {report.reasons[0]}" if report.reasons and verdicts else ""
    notes = "".join(f"; {note}" for note in report.notes)
    return f"{' and '.join(verdicts) or f'nothing found (p = {report.p_value:.2g})'}{where}{why}{notes}"


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
