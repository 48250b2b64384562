"""Field of view of one sensor for fusion: what it could see, the states of its cells, and its monitor's alarm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viewshed.arrays import F64, Mask
from viewshed.detections import Detections
from viewshed.monitor.evidence.base import sector_of
from viewshed.monitor.report import IntegrityReport
from viewshed.objects.cells import SeenCells
from viewshed.objects.tracks import Tracks
from viewshed.objects.views import View

_NEAR_TIME_S = 0.15
"""Maximum time difference between a view and the tracks."""

MAX_TRACKS = 2000
"""Maximum number of tracks per message, to bound the work."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorView:
    """Field of view of one sensor during one sweep."""

    sensor: str  # its name
    view: View  # what could be seen
    place: F64  # (2,) x and y of the sensor in the tracks' frame
    # states of the cells; None if the field of view has none (a polygon, or no field of view)
    cells: SeenCells | None = None
    report: IntegrityReport | None = None  # report of the monitor on this sweep, or None
    yaw: float = 0.0  # heading of the sensor's ``level`` frame in the tracks' frame, radians

    def alarmed(self, boxes: F64) -> Mask:
        """Return which boxes (K,) lie in sectors under alarm; all of them if an alarm names no sector."""
        report = self.report
        if report is None or not report.inconsistent:
            return np.zeros(len(boxes), np.bool_)
        if not report.suspect.any():
            return np.ones(len(boxes), np.bool_)
        away = boxes[:, :2] - self.place
        azimuth = np.arctan2(away[:, 1], away[:, 0]) - self.yaw
        return np.asarray(report.suspect[sector_of((azimuth + np.pi) % (2 * np.pi) - np.pi)])


Observed = tuple[Tracks, Detections, Sequence[SensorView]]
"""Input of fusion for one sweep."""


def check_views(tracks: Tracks, views: Sequence[SensorView]) -> None:
    """Raise ValueError unless views match the tracks' time and frame, sensors are distinct, and tracks are few."""
    if len(tracks) > MAX_TRACKS:
        raise ValueError(f"tracks must be at most {MAX_TRACKS} in one message, got {len(tracks)}")
    names = [view.sensor for view in views]
    if not names or len(set(names)) != len(names):
        raise ValueError(f"views must be of one sensor at least, each once, got {names}; name each sensor differently")
    for view in views:
        if view.view.in_world != tracks.in_world:
            frame = "the world" if tracks.in_world else "the sensor's level frame"
            raise ValueError(f"views must be in the tracks' frame, {frame}, got another one of {view.sensor}")
        if not abs(view.view.t_s - tracks.t_s) <= _NEAR_TIME_S:
            raise ValueError(
                f"views must be of the tracks' time {tracks.t_s:.3f} s, got {view.view.t_s:.3f} s of {view.sensor}"
            )
