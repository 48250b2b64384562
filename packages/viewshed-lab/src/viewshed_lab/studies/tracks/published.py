"""The published rule (avstack's box tracker) including its bug: the baseline of trackers with a field of view.

Its code is public. An unmatched track counts as missed if the polygon covers its center ("observable"). If the polygon
covers none of the tracks, the list of observable tracks is empty, which the code treats as not given, and **all** of
them count as missed. A track ends after too many consecutive misses, or after too long without a match, visible or
hidden. Each unmatched detection starts a track.

Left out: the velocity along z, and the score of a later version of its code, which misses improve.
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
"""Its published parameters; yaw is that of the last detection."""


@dataclass(frozen=True, slots=True)
class PublishedRules:
    """Tracks are kept by their counts of hits and misses."""

    motion: Motion = PUBLISHED_MOTION  # motion and measurement noise
    # matching by ``overlap`` (intersection over union of boxes) or ``center`` (distance of centers)
    cost: Literal["overlap", "center"] = "overlap"
    least_overlap: float = 0.10  # minimum intersection over union of a match
    radius_m: float = 4.0  # maximum distance of a match
    confirm_updates: int = 3  # number of detections that confirm a track
    coast_s: float = 3.0  # maximum time without a match
    most_misses: int = 6  # maximum number of consecutive misses
    duplicate_m: float = 1.0  # of tracks nearer to each other than this, the one with the most detections is kept
    fastest_mps: float = 60.0  # maximum speed
    # False keeps the published bug: a view that covers no track counts as one that covers all
    repairs_empty_view: bool = False
    false_odds: float = 1.0  # not used

    def __post_init__(self) -> None:
        if self.cost not in ("overlap", "center"):
            raise ValueError(f"cost must be overlap or center, got {self.cost!r}")
        for name in ("radius_m", "coast_s", "fastest_mps"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")

    def look(self, tracks: TrackTable, view: View, dt_s: float) -> None:
        """Set whether the view covers each track: with a probability of at least .5."""
        tracks.visible = np.asarray(view.visible(tracks.boxes) >= 0.5, np.float64)
        if not tracks.visible.any() and not self.repairs_empty_view:
            tracks.visible = np.ones(len(tracks))
        tracks.detectable = np.ones(len(tracks))

    def match(self, tracks: TrackTable, measured: Measured) -> NDArray[np.int32]:
        """Return the assignment of maximum overlap or minimum distance."""
        if self.cost == "overlap":
            overlap = volume_overlaps(tracks.boxes, measured.boxes)
            return assign(np.where(overlap > self.least_overlap, overlap, 0.0))
        off = tracks.boxes[:, None, :2] - measured.boxes[None, :, :2]
        return assign(self.radius_m - np.hypot(off[..., 0], off[..., 1]))

    def judge(self, tracks: TrackTable, measured: Measured, matched: NDArray[np.int32]) -> None:
        """Count the misses of tracks that the view covers."""
        tracks.misses = tracks.misses + ((matched < 0) & (tracks.visible > 0.5)).astype(np.int32)

    def begin(
        self, born: TrackTable, measured: Measured, tracks: TrackTable, view: View, before: View | None
    ) -> TrackTable:
        """Return all new tracks: each unmatched detection starts one."""
        return born

    def keep(self, tracks: TrackTable, t_s: float) -> NDArray[np.bool_]:
        """Keep tracks matched lately and not missed too often; of close ones the one with the most detections."""
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

    With cutoff and order 1: the mean over the larger set, plus the *difference of the set sizes* outside of the mean.
    So each false track adds more than 1, and five among ten score 5.45 where OSPA is at most 1.
    """
    distance_m = np.linalg.norm(tracks[:, None, :3] - truths[None, :, :3], axis=2)
    larger, smaller = max(distance_m.shape), min(distance_m.shape)
    if larger == 0:
        return 0.0
    rows, columns = assignment_solver()(np.where(distance_m < 1.0, distance_m, 1e8))
    is_pair = distance_m[rows, columns] < 1.0
    unmatched = larger - int(is_pair.sum())
    return float((distance_m[rows, columns][is_pair].sum() + unmatched) / larger + (larger - smaller))
