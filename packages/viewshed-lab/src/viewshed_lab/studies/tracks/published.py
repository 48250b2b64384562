"""The published rule (avstack's box tracker), bug and all: the baseline that a tracker with a field of view must beat.

Its code is public. A track that was not matched is missed if the polygon covers its center: then it is "observable".
Where the polygon covers none of the tracks, the list of observable ones is empty, is taken for one that was not given,
and **all** tracks are missed. A track ends after too many misses in a row, or when nothing was matched for too long,
seen or hidden. Each detection that is left over begins a track.

Not taken over: the velocity of z, and the score that a later version of its code keeps beside the counts and that
misses improve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.objects.association import assign, assignment_solver, volume_overlaps
from viewshed.objects.kalman import Motion
from viewshed.objects.tracker import Measured, TrackTable
from viewshed.objects.views import View

PUBLISHED_MOTION = Motion(
    acceleration_density=0.0, state_drift=(2.0, 2.0, 3.0, 3.0), velocity_std_mps=10.0, position_std_m=5.0,
    center_std_m=1.0, box_drift=(2.0, 0.2, 0.2, 0.2, 10.0), box_std=(1.0, 0.25, 0.25, 0.25, 0.01),
    new_box_std=(5.0, 2.0, 2.0, 2.0, 5.0), heading_from_mps=np.inf,
)  # fmt: skip
"""Its numbers; yaw is that of the last detection."""


@dataclass(frozen=True, slots=True)
class PublishedRules:
    """A track is kept by counts of hits and of misses."""

    motion: Motion = PUBLISHED_MOTION  # how objects move and are measured
    # what is compared: ``overlap`` is the intersection over union of boxes, ``center`` the distance of centers
    cost: Literal["overlap", "center"] = "overlap"
    least_overlap: float = 0.10  # intersection over union below which no detection is of a track
    radius_m: float = 4.0  # distance beyond which no detection is of a track
    confirm_updates: int = 3  # detections from which on a track is confirmed
    coast_s: float = 3.0  # a track ends when nothing was matched with it for this time
    most_misses: int = 6  # a track ends after more misses than this in a row
    duplicate_m: float = 1.0  # of tracks nearer to each other than this the one with most detections is kept
    fastest_mps: float = 60.0  # faster tracks end
    # False is the published bug: a view that covers no track counts as one that covers all
    repairs_empty_view: bool = False
    false_odds: float = 1.0  # is not used

    def __post_init__(self) -> None:
        if self.cost not in ("overlap", "center"):
            raise ValueError(f"cost must be overlap or center, got {self.cost!r}")
        for name in ("radius_m", "coast_s", "fastest_mps"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")

    def look(self, tracks: TrackTable, view: View, dt_s: float) -> None:
        """Ask the view whether it covers each track: more likely than not is yes."""
        tracks.visible = np.asarray(view.visible(tracks.boxes) >= 0.5, np.float64)
        if not tracks.visible.any() and not self.repairs_empty_view:
            tracks.visible = np.ones(len(tracks))
        tracks.detectable = np.ones(len(tracks))

    def match(self, tracks: TrackTable, measured: Measured) -> NDArray[np.int32]:
        """Return the assignment of greatest overlap, or of least distance."""
        if self.cost == "overlap":
            shared = volume_overlaps(tracks.boxes, measured.boxes)
            return assign(np.where(shared > self.least_overlap, shared, 0.0))
        off = tracks.boxes[:, None, :2] - measured.boxes[None, :, :2]
        return assign(self.radius_m - np.hypot(off[..., 0], off[..., 1]))

    def judge(self, tracks: TrackTable, measured: Measured, matched: NDArray[np.int32]) -> None:
        """Count the misses of tracks that the view covers."""
        tracks.misses = tracks.misses + ((matched < 0) & (tracks.visible > 0.5)).astype(np.int32)

    def begin(
        self, born: TrackTable, measured: Measured, tracks: TrackTable, view: View, before: View | None
    ) -> TrackTable:
        """Return all: each detection that is left begins a track."""
        return born

    def keep(self, tracks: TrackTable, t_s: float) -> NDArray[np.bool_]:
        """Keep what was matched lately and not missed too often, and of close tracks the one with most detections."""
        tracks.confirmed = tracks.updates >= self.confirm_updates
        kept = (t_s - tracks.seen_s < self.coast_s) & (tracks.misses <= self.most_misses)
        kept &= np.hypot(tracks.states[:, 2], tracks.states[:, 3]) <= self.fastest_mps
        off = tracks.states[:, None, :2] - tracks.states[None, :, :2]
        is_close = np.hypot(off[..., 0], off[..., 1]) < self.duplicate_m
        for k in np.argsort(-tracks.updates, kind="stable"):
            if kept[k]:
                closer = is_close[k] & kept
                closer[k] = False
                kept &= ~closer
        return np.asarray(kept)


def published_ospa(tracks: F64, truths: F64) -> float:
    """Return what the published evaluation calls OSPA, as its code computes it from x, y and z; it is not OSPA.

    With cutoff and order 1: the mean over the larger set, plus the *difference of the numbers* outside of the mean. So
    each false track adds more than one whole unit, and five among ten score 5.45 where OSPA is at most 1.
    """
    apart = np.linalg.norm(tracks[:, None, :3] - truths[None, :, :3], axis=2)
    more, fewer = max(apart.shape), min(apart.shape)
    if more == 0:
        return 0.0
    rows, columns = assignment_solver()(np.where(apart < 1.0, apart, 1e8))
    is_pair = apart[rows, columns] < 1.0
    alone = more - int(is_pair.sum())
    return float((apart[rows, columns][is_pair].sum() + alone) / more + (more - fewer))
