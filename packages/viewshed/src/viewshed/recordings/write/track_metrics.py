"""Compare an agent's tracks with the ground truth of a simulated drive, sweep by sweep."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from viewshed.objects.metrics import IdSwitches, gospa, match_objects, ospa_m
from viewshed.objects.object_stream import SeenObjects
from viewshed.recordings.write.moment import DriveTruth

RANGE_M = 50.0
"""Objects and tracks beyond this distance from the sensor are ignored."""

REMEMBERED_S = 5.0
"""An object counts while it is seen and for this time after."""

NEAR_M = 2.0
"""A track within this distance of an object that does not count is ignored."""


@dataclass(slots=True)
class TrackMetrics:
    """Compares the tracks of several agents with the truth of their drive; stateful, as ids are compared over time."""

    _seen_s: dict[tuple[str, int], float] = field(default_factory=dict)
    _switches: dict[str, IdSwitches] = field(default_factory=dict)

    def of(self, agent: str, t_s: float, objects: SeenObjects, truth: DriveTruth) -> dict[str, float]:
        """Return GOSPA and its parts, OSPA, the numbers of tracks and objects, and the id switches so far."""
        # Ground truth: objects near the sensor that were seen recently, without the agent's own vehicle.
        sensor_xy = objects.tracks_from_level.translation[:2]
        self._seen_s |= {(agent, seen.number): t_s for seen in truth.seen}
        others = [item for item in truth.objects if item.number != truth.carrier]
        numbers = np.array([item.number for item in others], np.int64)
        xy = np.array([item.world_from_box.translation[:2] for item in others]).reshape(-1, 2)
        seen_s = np.array([self._seen_s.get((agent, number), -np.inf) for number in numbers.tolist()])
        counted = (t_s - seen_s <= REMEMBERED_S) & (np.hypot(*(xy - sensor_xy).T) < RANGE_M)

        # Tracks near the sensor, without those near an object that does not count.
        tracks, shown = objects.explained.tracks, objects.shown
        ids, track_xy = tracks.ids[shown], tracks.boxes[shown, :2]
        distance_m = np.linalg.norm(track_xy[:, None] - xy[None], axis=2)
        is_ignored = (distance_m[:, ~counted].min(axis=1, initial=np.inf) < NEAR_M) & (
            distance_m[:, counted].min(axis=1, initial=np.inf) >= NEAR_M
        )
        near = (np.hypot(*(track_xy - sensor_xy).T) < RANGE_M) & ~is_ignored
        ids, track_xy, numbers, xy = ids[near], track_xy[near], numbers[counted], xy[counted]

        score = gospa(track_xy, xy)
        switches = self._switches.setdefault(agent, IdSwitches()).add(match_objects(track_xy, ids, xy, numbers))
        return {
            "gospa_m": score.distance_m, "localization_m2": score.localization, "missed_m2": score.missed,
            "false_m2": score.false, "ospa_m": ospa_m(track_xy, xy), "tracks": float(len(track_xy)),
            "objects": float(len(xy)), "id_switches": float(switches),
        }  # fmt: skip
