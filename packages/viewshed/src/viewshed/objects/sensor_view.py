"""What fusion needs from one sensor of the agent: what it could see, what its cells are, and whether it alarms."""

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
"""A view of another time than the tracks by more than this says nothing of them."""

MOST_TRACKS = 2000
"""More tracks in one message are refused: the work is bounded."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorView:
    """What one sensor's field of view says at the time of one sweep."""

    sensor: str  # its name
    view: View  # what could be seen
    place: F64  # (2,) x and y of the sensor in the tracks' frame
    # states of the cells, or None where the field of view has none (a polygon, or no field of view)
    cells: SeenCells | None = None
    report: IntegrityReport | None = None  # of the monitor of this sweep, or None
    yaw: float = 0.0  # heading of the sensor's ``level`` frame in the tracks' frame, radians

    def alarmed(self, boxes: F64) -> Mask:
        """Return which boxes (K,) lie in sectors under alarm; all of them where an alarm names no sector."""
        report = self.report
        if report is None or not report.inconsistent:
            return np.zeros(len(boxes), np.bool_)
        if not report.suspect.any():
            return np.ones(len(boxes), np.bool_)
        away = boxes[:, :2] - self.place
        azimuth = np.arctan2(away[:, 1], away[:, 0]) - self.yaw
        return np.asarray(report.suspect[sector_of((azimuth + np.pi) % (2 * np.pi) - np.pi)])


Observed = tuple[Tracks, Detections, Sequence[SensorView]]
"""What fusion is given of one sweep."""


def check_views(tracks: Tracks, views: Sequence[SensorView]) -> None:
    """Raise a ValueError unless views are of the tracks' time and frame, each sensor once, and tracks not too many."""
    if len(tracks) > MOST_TRACKS:
        raise ValueError(f"tracks must be at most {MOST_TRACKS} in one message, got {len(tracks)}")
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
