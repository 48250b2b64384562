"""The published trust (``viewshed_lab.studies.agents.mate``) on the picture of a center that believes everybody."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.many import AgentReport, CommonPicture
from viewshed_lab.studies.agents.mate import LEAST_TRUST, MateReport, MateTrust


@dataclass(slots=True)
class PublishedTrust:
    """Follows agents and tracks as published; its crisp polygon is the default estimate's mask.

    So it differs from ours in the trust alone: tracks are the same, and the mask is better than the published polygons.
    """

    least_trust: float = LEAST_TRUST  # tracks below are left out
    _mate: MateTrust = field(default_factory=MateTrust)
    _updates: dict[int, int] = field(default_factory=dict)

    def add(
        self, picture: CommonPicture, reports: Sequence[AgentReport]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the trust (A,) in each agent of a picture, and which of its tracks (N,) are believed."""
        tracks = picture.tracks
        ids = tracks.ids.tolist()
        hits = {number: int(one >= 0) for number, one in zip(ids, tracks.detection.tolist(), strict=True)}
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
    """Return which boxes (N, 7) of the world have their centers in the mask of an agent's view."""
    pose = report.world_from_level.inverse()
    at = boxes[:, :2] @ pose.rotation[:2, :2].T + pose.translation[:2]
    return np.asarray(report.estimate.at(at) >= report.estimate.threshold)
