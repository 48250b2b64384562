"""The monitor of a command's options, and its reports as lines of text."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from viewshed.monitor import IntegrityReport, StreamMonitor
    from viewshed.monitor.stream_monitor import StreamReport


def stream_monitor(file: Path | None, per_hour: float | None = None) -> StreamMonitor:
    """Return a monitor with the calibration in a file of ``viewshed monitor calibrate``, or with the shipped one."""
    from viewshed.monitor import StreamMonitor
    from viewshed.monitor.stream_monitor import PER_HOUR

    if file is not None:
        return StreamMonitor.of_file(file, per_hour)
    return StreamMonitor(per_hour=PER_HOUR if per_hour is None else per_hour)


def optional_monitor(is_requested: bool, file: Path | None) -> StreamMonitor | None:
    """Return the :func:`stream_monitor` of ``--monitor`` and ``--monitor-file``; None if neither is given."""
    return stream_monitor(file) if is_requested or file is not None else None


def stream_verdicts(report: StreamReport) -> str:
    """Return a report on a sweep and its stream as one line; see :func:`verdicts`."""
    lasting = f"; ALARM for {report.doubtful_sweeps} sweeps" if report.alarm and report.doubtful_sweeps > 1 else ""
    return f"{verdicts(report.now)}{lasting}{''.join(f'; {note}' for note in report.notes)}"


def verdicts(report: IntegrityReport) -> str:
    """Return a report as one line: verdicts, p-value, suspect azimuths, and the first reason.

    For the published detector, which has no p-value: score, limit and suspect area.

    >>> import numpy as np
    >>> from viewshed.monitor import IntegrityReport
    >>> suspect = np.arange(72) == 40
    >>> reasons = ("an obstacle at 22° must have come there at 90 m/s",)
    >>> verdicts(IntegrityReport("stream", 3.0, 2.0, 0.002, suspect=suspect, reasons=reasons))
    'INCONSISTENT (p = 0.002) at 20° to 25°: an obstacle at 22° must have come there at 90 m/s'
    """
    if report.monitor == "deviation":
        alarm = f"ALARM, {report.suspect_m2:.0f} m² suspect" if report.alarm else "no alarm"
        return f"score {report.score:.4f}, limit {report.threshold:.4f}, {alarm}"
    p = "" if math.isnan(report.p_value) else f" (p = {report.p_value:.2g})"
    flags = ((f"INCONSISTENT{p}", report.inconsistent), ("DEGRADED", report.degraded))
    words = " and ".join(word for word, is_set in flags if is_set)
    where = f" at {azimuths(report.suspect)}" if report.suspect.any() else ""
    why = f": {report.reasons[0]}" if report.reasons and words else ""
    notes = "".join(f"; {note}" for note in report.notes)
    return f"{words or f'nothing found{p}'}{where}{why}{notes}"


def azimuths(suspect: NDArray[Any]) -> str:
    """Return the two widest ranges of azimuth in a mask of sectors (SECTORS,), in degrees counter-clockwise from ahead.

    >>> import numpy as np
    >>> azimuths(np.isin(np.arange(72), [0, 1, 40])), azimuths(np.isin(np.arange(72), [0, 1, 30, 40, 41, 50]))
    ('-180° to -170°, 20° to 25°', '-180° to -170°, 20° to 30° and 2 more')
    """
    import numpy as np

    width = 360 // len(suspect)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], suspect, [False]]))).reshape(-1, 2)
    widest = np.sort(np.argsort(edges[:, 0] - edges[:, 1], kind="stable")[:2])
    more = f" and {len(edges) - 2} more" if len(edges) > 2 else ""
    return ", ".join(f"{at * width - 180}° to {to * width - 180}°" for at, to in edges[widest].tolist()) + more
