"""The published trust (``viewshed_lab.studies.agents.mate``) on the picture of a center that trusts all agents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.many import AgentReport, CommonPicture
from viewshed_lab.studies.agents.mate import MIN_TRUST, MateReport, MateTrust


@dataclass(slots=True)
class PublishedTrust:
    """Published trust of agents and tracks, with the mask of the default estimate in place of a polygon.

    It thus differs from ours in the trust alone: tracks are the same, and the mask is better than published polygons.
    """

    least_trust: float = MIN_TRUST  # tracks with less trust are not believed
    _mate: MateTrust = field(default_factory=MateTrust)
    _updates: dict[int, int] = field(default_factory=dict)

    def add(
        self, picture: CommonPicture, reports: Sequence[AgentReport]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the trust (A,) in each agent of a picture, and which of its tracks (N,) are believed."""
        tracks = picture.tracks
        ids = tracks.ids.tolist()
        hits = {number: int(row >= 0) for number, row in zip(ids, tracks.detection.tolist(), strict=True)}
        self._updates = {number: self._updates.get(number, 0) + hits[number] for number in ids}
        xy_m = tracks.boxes[:, :2]
        mate_reports = [
            MateReport(
                report.agent, report.world_from_level.translation[:2], report.in_world.boxes[:, :2],
                _covered(report, tracks.boxes),
            )
            for report in reports
        ]  # fmt: skip
        self._mate.update(picture.t_s, mate_reports, tracks.ids, xy_m, np.array(list(self._updates.values()), np.int32))
        trust = np.array([self._mate.of_agent(agent) for agent in picture.agents])
        believed = tracks.confirmed & (self._mate.of_tracks(tracks.ids) >= self.least_trust)
        return trust, np.asarray(believed)


def _covered(report: AgentReport, boxes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask (N,) of boxes (N, 7) in the world with their centers in an agent's visible cells."""
    pose = report.world_from_level.inverse()
    at = boxes[:, :2] @ pose.rotation[:2, :2].T + pose.translation[:2]
    return np.asarray(report.estimate.at(at) >= report.estimate.threshold)
