"""How well an agent's tracks agree with the objects of a simulated drive, sweep by sweep."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from viewshed.objects.metrics import IdSwitches, gospa, match_objects, ospa_m
from viewshed.objects.object_stream import SeenObjects
from viewshed.recordings.write.moment import DriveTruth

RANGE_M = 50.0
"""Objects and tracks that are farther from the sensor do not count."""

REMEMBERED_S = 5.0
"""An object counts from when it was seen until this time after it was seen last."""

NEAR_M = 2.0
"""A track within this distance of an object that does not count is neither right nor false."""


@dataclass(slots=True)
class TrackMetrics:
    """Compares the tracks of several agents with the truth of their drive; ids are remembered over time."""

    _seen_s: dict[tuple[str, int], float] = field(default_factory=dict)
    _switches: dict[str, IdSwitches] = field(default_factory=dict)

    def of(self, agent: str, t_s: float, objects: SeenObjects, truth: DriveTruth) -> dict[str, float]:
        """Return GOSPA with its parts, OSPA, the numbers of tracks and objects, and id switches so far."""
        place = objects.tracks_from_level.translation[:2]
        self._seen_s |= {(agent, each.number): t_s for each in truth.seen}
        world = [
            (each.number, each.world_from_box.translation) for each in truth.objects if each.number != truth.carrier
        ]
        numbers = np.array([number for number, _ in world], np.int64)
        xy = np.array([center[:2] for _, center in world]).reshape(-1, 2)
        seen_s = np.array([self._seen_s.get((agent, number), -np.inf) for number in numbers.tolist()])
        counted = (t_s - seen_s <= REMEMBERED_S) & (np.hypot(*(xy - place).T) < RANGE_M)

        tracks, chosen = objects.explained.tracks, objects.shown
        ids, at = tracks.ids[chosen], tracks.boxes[chosen, :2]
        away = np.linalg.norm(at[:, None] - xy[None], axis=2)
        is_ignored = (away[:, ~counted].min(axis=1, initial=np.inf) < NEAR_M) & (
            away[:, counted].min(axis=1, initial=np.inf) >= NEAR_M
        )
        near = (np.hypot(*(at - place).T) < RANGE_M) & ~is_ignored
        ids, at, numbers, xy = ids[near], at[near], numbers[counted], xy[counted]

        whole = gospa(at, xy)
        switches = self._switches.setdefault(agent, IdSwitches()).add(match_objects(at, ids, xy, numbers))
        return {
            "gospa_m": whole.distance_m, "localization_m2": whole.localization, "missed_m2": whole.missed,
            "false_m2": whole.false, "ospa_m": ospa_m(at, xy), "tracks": float(len(at)), "objects": float(len(xy)),
            "id_switches": float(switches),
        }  # fmt: skip
