"""Fuse the reports of several agents of one time: joint tracks, and how far each agent is trusted.

Five steps:

1. correct each pose within its stated errors (:mod:`viewshed.agents.registration`);
2. match the detections of all agents, at most one detection of each agent to an object;
3. run one tracker on the joint detections; its probability of detection is that *any* trusted agent sees the box;
4. explain by sets of liars (:mod:`viewshed.agents.trust`) each agent's report of each track, its silence where it
  claims to see, and how the agents' views compare (:mod:`viewshed.agents.view_evidence`);
5. believe a track by its probability of existence, averaged over the sets of liars.

An agent's report about the box of its own vehicle is ignored: it cannot see itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.honest import (
    NO_DETECTION_M,
    HonestModel,
    ObjectReports,
    honest_model,
    own_box_columns,
    place_columns,
    reported_columns,
    withholding,
)
from viewshed.agents.joint_fov import JointFov, confirmed, joint_fov
from viewshed.agents.registration import registered_poses
from viewshed.agents.report import FAR_M, AgentReport
from viewshed.agents.trust import SCENE_S, Reports, Trust, TrustRules, Verdicts
from viewshed.agents.view_evidence import ComparedView, Comparisons, compare_views
from viewshed.arrays import F64, Mask
from viewshed.detections import Detections
from viewshed.objects.association import assign
from viewshed.objects.cells import BoxCells, SeenCells
from viewshed.objects.tracker import MAX_DETECTIONS, MAX_TRACKS, Tracker
from viewshed.objects.tracks import Tracks
from viewshed.objects.views import hidden_within

__all__ = [
    "AgentReport", "CommandCenter", "CommonPicture", "JointFov", "confirmed", "joint_fov", "match_agents",
]  # fmt: skip

GATE_M, STORY_M = 4.0, 2.5
"""Detections of two agents farther apart than this, horizontally or in height, belong to different objects."""

STD_M, STD_PER_M = 0.5, 0.012
"""Standard deviation of a detection's center along each axis in meters: at the sensor, and added per meter of range."""

_UNSEEN = np.array([0.0, 0.0, np.nan, np.nan])
"""History of an object that an agent has not reported: looks with a report, consecutive looks without one since, and
surface share and returns at the last report."""

SAMPLE_COUNTS = (13, 7)
"""Sample points along and across a box at which views are looked up."""

MIN_TRUST = 0.05
"""Minimum weight of an agent's detections, kept even when the agent is not trusted at all."""

LOOK_S = 0.5
"""Interval in which each view is compared with the others once; an agent's reports within it count as one look."""

FALSE_ODDS = 0.1
"""False joint detections per true one."""

BELIEVED = 0.5
"""A track is believed from this probability of existence on, averaged over the sets of liars."""


def chances(reports: Sequence[AgentReport], boxes: F64, honest: HonestModel) -> F64:
    """Return the probability (K, R) that each of R agents, if honest, reports each box (K, 7) of the world."""
    probs = np.zeros((len(boxes), len(reports)))
    for column, report in enumerate(reports):
        range_m = report.range_m(boxes)
        near = np.flatnonzero(range_m <= FAR_M)
        near = near[~report.is_own(boxes[near]) & report.on_its_level(boxes[near])]
        targets = boxes[near]
        probs[near, column] = honest.chance(report.view.visible(targets), targets, range_m[near], height=report.height)
    return probs


@dataclass(frozen=True, slots=True, eq=False)
class JointView:
    """What at least one of several agents could see, each weighted by its trust; a :class:`View` for the tracker."""

    t_s: float
    reports: tuple[AgentReport, ...]
    trust: F64
    honest: HonestModel
    in_world: bool = True

    def visible(self, boxes: F64) -> F64:
        """Return the probability (K,) that at least one trusted agent reports each box."""
        missed: F64 = (1.0 - self.trust * chances(self.reports, boxes, self.honest)).prod(axis=1)
        return 1.0 - missed

    def detectable(self, boxes: F64, kinds: NDArray[np.uint8]) -> F64:
        """Return ones (K,): :meth:`visible` includes the detector already."""
        return np.ones(len(boxes))

    def false_odds(self, boxes: F64, kinds: NDArray[np.uint8]) -> F64:
        """Return the same odds (K,) for all boxes: a joint detection combines several detectors."""
        return np.full(len(boxes), FALSE_ODDS)

    def hides_near(self, boxes: F64, within_m: F64) -> F64:
        """Return the greatest probability (K,) of not being seen within (K,) meters of each box."""
        return hidden_within(self, boxes, within_m)


@dataclass(frozen=True, slots=True, eq=False)
class CommonPicture:
    """Joint tracks and verdicts of all agents at one time."""

    t_s: float  # time in seconds
    agents: tuple[str, ...]  # names of all agents
    reports: tuple[AgentReport, ...]  # of the agents that reported, with corrected poses
    tracks: Tracks  # joint tracks in the world
    verdicts: Verdicts  # on the agents, and on the tracks that at least one agent reports now
    elevated: Mask  # (A,) bool, agents whose sensor looks over the traffic
    existence: F64  # (N,) probability that each track exists, averaged over the sets of liars
    reporters: Mask  # (N, A) bool, agents that report each track now
    deniers: Mask  # (N, A) bool, agents that claim to see the place of a track that others report, and do not
    said: ObjectReports  # what all agents report about the tracks that at least one reports now, in their order
    compared: Comparisons  # comparisons of the views with each other
    notes: tuple[str, ...] = ()  # what was left out, one sentence each

    @property
    def believed(self) -> Mask:
        """(N,) bool, tracks whose existence is at least ``BELIEVED``."""
        return np.asarray(self.existence >= BELIEVED)

    @property
    def reported(self) -> Mask:
        """(N,) bool, tracks that at least one agent reports now."""
        return np.asarray(self.tracks.detection >= 0)


@dataclass(slots=True)
class CommandCenter:
    """Fuses the reports of a group of agents, time step by time step.

    Args:
        agents: names of all agents that may report.
        rules: parameters of the trust model.
        honest: model of honest agents.
        trusting: trust all agents alike and compare no views, as a baseline.
    """

    agents: tuple[str, ...]
    rules: TrustRules = field(default_factory=TrustRules)
    trusting: bool = False
    honest: HonestModel = field(default_factory=honest_model)
    _trust: Trust = field(init=False, repr=False)
    _tracker: Tracker = field(default_factory=Tracker, repr=False)
    _existence: dict[int, float] = field(default_factory=dict, repr=False)
    _reported: dict[int, F64] = field(default_factory=dict, repr=False)
    _weights: F64 = field(init=False, repr=False)
    _elevated: Mask = field(init=False, repr=False)
    _heard_s: F64 = field(init=False, repr=False)  # (A,) time of the last report of each agent
    _views: dict[int, ComparedView] = field(default_factory=dict, repr=False)
    _last_turn: dict[int, int] = field(default_factory=dict, repr=False)
    _times: int = 0
    _last_s: float | None = None

    def __post_init__(self) -> None:
        _require_different(self.agents)
        self._trust = Trust(len(self.agents), self.rules)
        self._weights = np.ones(len(self.agents))
        self._elevated, self._heard_s = np.zeros(len(self.agents), np.bool_), np.full(len(self.agents), -np.inf)

    def regroup(self, agents: tuple[str, ...]) -> None:
        """Change the group of agents: those that stay keep their record, new ones begin at the prior.

        Args:
            agents: names of all agents that may report from now on.

        Raises:
            ValueError: there are none, or two have the same name.
        """
        _require_different(agents)
        kept = [self.agents.index(agent) if agent in self.agents else -1 for agent in agents]
        self._trust.regroup(kept)
        self._views = {number: self._views[old] for number, old in enumerate(kept) if old in self._views}
        self._last_turn = {number: self._last_turn[old] for number, old in enumerate(kept) if old in self._last_turn}
        # kept is -1 for new agents, which selects the appended last element.
        self._weights = np.append(self._weights, 1.0)[kept]
        self._elevated, self._heard_s = np.append(self._elevated, False)[kept], np.append(self._heard_s, -np.inf)[kept]
        self._reported = {number: np.column_stack([past, _UNSEEN])[:, kept] for number, past in self._reported.items()}
        self.agents = agents

    def add(self, t_s: float, reports: Sequence[AgentReport]) -> CommonPicture:
        """Return the joint picture after the reports of one time, at most one per agent.

        Raises:
            ValueError: an agent is unknown or reports twice, or ``t_s`` does not rise.
        """
        columns = self._columns(reports)
        if self._last_s is not None and t_s <= self._last_s:
            raise ValueError(f"t_s must increase, got {t_s:.3f} s after {self._last_s:.3f} s; create a new center")
        # 1. to 3. Correct poses, match detections, track.
        trust = np.ones(len(reports)) if self.trusting else self._weights[columns]
        reports = registered(reports)
        matches, notes = _bounded(match_agents([report.in_world for report in reports]), reports, trust)
        joint, noise = _joint(reports, matches, trust)
        tracks = self._tracker.step(t_s, joint, JointView(t_s, tuple(reports), trust, self.honest), noise)

        # 4. Judge what each agent says of the tracks that are reported now, and how its view compares with the others.
        reported = np.flatnonzero(tracks.detection >= 0)
        members, track_ids, ids = matches[tracks.detection[reported]], tracks.ids.tolist(), tracks.ids[reported]
        unseen = np.repeat(_UNSEEN[:, None], len(self.agents), axis=1)
        self._reported = {number: self._reported.get(number, unseen) for number in track_ids}
        past = np.array([self._reported[number] for number in ids.tolist()]).reshape(-1, len(_UNSEEN), len(self.agents))
        said = object_reports(reports, columns, len(self.agents), tracks.boxes[reported], members, past)
        # An agent without a report now keeps its sensor height class: it is judged by its earlier reports.
        self._elevated[columns] = said.height[columns] > 0
        seconds = 0.5 if self._last_s is None else t_s - self._last_s
        compared = self._compared(dict(zip(columns.tolist(), reports, strict=True)), seconds)
        ratio, views = self.honest.withheld_ratio(said), self.honest.views(compared, self._elevated)
        judged = self._judged(ids, said, reports, columns, members, ratio)
        self._heard_s[columns] = t_s
        present = t_s - self._heard_s < SCENE_S
        verdicts = self._trust.add(judged, seconds, views, withholding(said, ratio), present)
        self._weights, self._last_s = np.maximum(verdicts.trust, MIN_TRUST), t_s
        # Update the history per track and agent: looks, and surface share and returns at the last report.
        look, surface = min(seconds / LOOK_S, 1.0), said.cells[..., BoxCells._fields.index("surface")]
        returns = _returns(reports, columns, len(self.agents), members)
        last = np.where(said.seen, np.stack([surface, returns]), np.moveaxis(past[:, 2:], 1, 0))
        silent = np.where(said.seen, 0.0, past[:, 1] + look * said.able)
        now = np.stack([past[:, 0] + look * said.seen, silent, *last], axis=1)
        self._reported |= dict(zip(ids.tolist(), now, strict=True))

        # 5. An unreported track keeps its last existence, bounded by that of the tracker.
        self._existence |= dict(zip(ids.tolist(), verdicts.existence.tolist(), strict=True))
        self._existence = {number: self._existence.get(number, 1.0) for number in track_ids}
        existence = np.array(tracks.existence)
        if not self.trusting:
            existence = np.minimum(existence, [self._existence[number] for number in track_ids])
            existence[reported] = verdicts.existence
        reporters, deniers = np.zeros((2, len(tracks), len(self.agents)), np.bool_)
        reporters[reported], deniers[reported] = said.seen, said.sees & ~said.seen
        return CommonPicture(
            t_s, self.agents, tuple(reports), tracks, verdicts, self._elevated.copy(), existence, reporters, deniers,
            said, compared, (*notes, *tracks.notes),
        )  # fmt: skip

    def _columns(self, reports: Sequence[AgentReport]) -> NDArray[np.intp]:
        names = [report.agent for report in reports]
        for name in names:
            if name not in self.agents or names.count(name) > 1:
                raise ValueError(f"reports must be of {', '.join(self.agents)}, one each, got {', '.join(names)}")
        return np.array([self.agents.index(name) for name in names], np.intp)

    def _compared(self, views: dict[int, AgentReport], seconds: float) -> Comparisons:
        """Compare views of some agents in turn, so that the work is bounded at any rate of reports."""
        count = 0 if self.trusting else min(len(views), int(np.ceil(len(views) * seconds / LOOK_S - 1e-6)))
        compared_agents = sorted(views, key=lambda number: (self._last_turn.get(number, -1), number))[:count]
        compared, compared_views = compare_views(views, len(self.agents), self._views, compared_agents)
        self._views |= compared_views
        self._times += 1
        self._last_turn |= dict.fromkeys(compared_agents, self._times)
        return compared

    def _judged(
        self, ids: NDArray[np.int64], said: ObjectReports, reports: Sequence[AgentReport], columns: NDArray[np.intp],
        members: NDArray[np.int32], ratio: F64,
    ) -> Reports:  # fmt: skip
        """Return the reports with what honest agents would report.

        ``members`` (J, R) are the agents' detections, ``ratio`` (J, A) the log-ratios that they withhold the objects.
        """
        xy_m, std_m = np.full((*said.seen.shape, 2), np.nan), np.ones(said.seen.shape)
        for k, (report, column) in enumerate(zip(reports, columns, strict=True)):
            reported = members[:, k] >= 0
            xy_m[reported, column] = report.in_world.boxes[members[reported, k], :2]
            std_m[:, column] = STD_M + STD_PER_M * said.range_m[:, column]
        model = self.honest
        own, at_place = own_box_columns(said)[0], place_columns(said)
        return Reports(
            ids, said.seen, said.able, said.sees, model.reported(reported_columns(said)[0]), model.of_others,
            model.invented(own), model.silent_views(at_place[0], said.silent_now),
            np.array([model.alone.bias, model.shared.bias]), model.displaced(own),
            model.there(said, at_place, own, ratio), model.real.bias, xy_m, std_m, said.repeats,
        )  # fmt: skip


def _require_different(agents: tuple[str, ...]) -> None:
    if len(set(agents)) != len(agents) or not agents:
        raise ValueError(f"agents must be different names, got {', '.join(agents)}")


def registered(reports: Sequence[AgentReport]) -> Sequence[AgentReport]:
    """Return reports with poses corrected within their stated errors; see :mod:`viewshed.agents.registration`."""
    poses = registered_poses([report.estimate for report in reports], [report.pose_std for report in reports])
    return [
        report if pose is report.world_from_level else report.placed_at(pose)
        for report, pose in zip(reports, poses, strict=True)
    ]


def object_reports(
    reports: Sequence[AgentReport], columns: NDArray[np.intp], agents: int, boxes: F64, members: NDArray[np.int32],
    past: F64, own: F64 | None = None,
) -> ObjectReports:  # fmt: skip
    """Return what all agents report about objects, and what their views claim there.

    Args:
        reports: of R agents.
        columns: (R,) their agent numbers.
        agents: number of agents.
        boxes: (J, 7) of the objects, in the world.
        members: (J, R) index of each agent's detection of each object, -1 for none.
        past: (J, 4, agents) history of each object and agent: looks with a report, consecutive looks without one since,
            and surface share and returns at the last report.
        own: (J, R, 7) boxes that the agents report of the objects, NaN for none; None takes those of ``members``.
    """
    shape = (len(boxes), agents)
    seen, able, visible = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_), np.zeros(shape)
    range_m, apart_m = np.full(shape, 2.0 * FAR_M), np.full(shape, NO_DETECTION_M)
    cells, own_cells = (np.zeros((*shape, len(BoxCells._fields))) for _ in range(2))
    height = np.zeros(agents, np.int64)
    for k, (report, column) in enumerate(zip(reports, columns, strict=True)):
        agent_boxes, reported = report.in_world.boxes, members[:, k] >= 0
        own_boxes = np.full((len(boxes), 7), np.nan)
        own_boxes[reported] = agent_boxes[members[reported, k]]
        if own is not None:
            own_boxes, reported = own[:, k], np.isfinite(own[:, k, 0])
        # Ignore reports of the own vehicle: an agent cannot see itself.
        reported = reported & ~report.is_own(boxes)
        height[column], seen[:, column] = report.height, reported
        range_m[:, column] = own_range_m = report.range_m(boxes)
        near = (own_range_m <= FAR_M) & (own_range_m >= report.blind_m) & report.on_its_level(boxes)
        able[:, column] = near & ~report.is_own(boxes)
        visible[near, column] = report.view.visible(boxes[near])
        # One lookup for the near objects and the agent's own boxes.
        box_cells = SeenCells.of(report.estimate).look(
            np.concatenate([boxes[near], own_boxes[reported]]), report.world_from_level.translation[:2], SAMPLE_COUNTS
        )
        values = np.column_stack(box_cells)
        cells[near, column], own_cells[reported, column] = values[: near.sum()], values[near.sum() :]
        distance_m = np.linalg.norm(boxes[:, None, :2] - agent_boxes[None, :, :2], axis=2)
        distance_m[np.flatnonzero(members[:, k] >= 0), members[members[:, k] >= 0, k]] = NO_DETECTION_M
        apart_m[:, column] = distance_m.min(axis=1, initial=NO_DETECTION_M)
    before, silent = np.ceil(np.moveaxis(past[:, :2], 1, 0) - 1e-6).astype(np.int64)
    return ObjectReports(
        seen, able, visible, range_m, height, boxes[:, 3:5].max(axis=1, initial=0.0), cells, own_cells, apart_m,
        before, silent, past[:, 2], past[:, 3],
    )  # fmt: skip


def _returns(reports: Sequence[AgentReport], columns: NDArray[np.intp], agents: int, members: NDArray[np.int32]) -> F64:
    """Return the number of returns (J, agents) of each agent's detection of each object, NaN for none."""
    returns = np.full((len(members), agents), np.nan)
    for k, (report, column) in enumerate(zip(reports, columns, strict=True)):
        reported = members[:, k] >= 0
        returns[reported, column] = report.in_world.returns[members[reported, k]]
    return returns


def match_agents(detections: Sequence[Detections]) -> NDArray[np.int32]:
    """Return which detections of R agents, in the world, are the same object: (J, R) their indices, -1 for none.

    Match agent by agent with the objects found so far, by the smallest total distance within ``GATE_M``.

    >>> two = Detections(np.array([[0, 0, 0, 4, 2, 2, 0], [9, 0, 0, 4, 2, 2, 0]]), np.array([3, 3]), np.array([9, 9]))
    >>> match_agents([two, two.take(np.array([1]))]).tolist()
    [[0, -1], [1, 0]]
    """
    members, centers = np.zeros((0, len(detections)), np.int32), np.zeros((0, 3))
    for k, agent_detections in enumerate(detections):
        agent_centers = agent_detections.boxes[:, :3]
        offsets = np.abs(centers[:, None] - agent_centers[None])
        benefit = GATE_M - np.hypot(offsets[..., 0], offsets[..., 1])
        matched = assign(np.where(offsets[..., 2] < STORY_M, benefit, -1.0))
        is_matched = matched >= 0
        members[is_matched, k] = matched[is_matched]
        # An object's center is the mean of its detections.
        count = (members[is_matched] >= 0).sum(axis=1, keepdims=True)
        centers[is_matched] += (agent_centers[matched[is_matched]] - centers[is_matched]) / count
        is_new = np.ones(len(agent_detections), np.bool_)
        is_new[matched[is_matched]] = False
        unmatched = np.flatnonzero(is_new).astype(np.int32)
        new = np.full((len(unmatched), len(detections)), -1, np.int32)
        new[:, k] = unmatched
        members, centers = np.concatenate([members, new]), np.concatenate([centers, agent_centers[unmatched]])
    return members


def _bounded(
    matches: NDArray[np.int32], reports: Sequence[AgentReport], trust: F64
) -> tuple[NDArray[np.int32], list[str]]:
    """Return the matches (J, R) that the tracker can take, and notes of those left out.

    Of the objects that one agent alone reports, those with the most returns are kept, up to an equal part of the tracks
    for each: so no agent fills the tables of all. If there are still too many, those that are trusted most are kept.
    """
    kept, notes, most = np.ones(len(matches), np.bool_), list[str](), MAX_TRACKS // (len(reports) + 1)
    reporters = matches >= 0
    is_alone = reporters.sum(axis=1) == 1
    for k, report in enumerate(reports):
        alone = np.flatnonzero(is_alone & reporters[:, k])
        returns = report.in_world.returns[matches[alone, k]]
        extra = alone[np.argsort(-returns.astype(np.int64), kind="stable")[most:]]
        kept[extra] = False
        if len(extra):
            notes.append(
                f"{report.agent}: {len(extra)} objects that no other agent reports are left out, of {len(alone)}"
            )
    rows = np.flatnonzero(kept)
    if len(rows) > MAX_DETECTIONS:
        rows = np.sort(rows[np.argsort(-(reporters[rows] @ trust), kind="stable")[:MAX_DETECTIONS]])
        notes.append(
            f"{kept.sum() - MAX_DETECTIONS} objects are left out: at most {MAX_DETECTIONS} are tracked at a time"
        )
    return matches[rows], notes


def _joint(reports: Sequence[AgentReport], matches: NDArray[np.int32], trust: F64) -> tuple[Detections, F64]:
    """Return one detection per object, and the covariance (J, 2, 2) of its center, weighted by trust.

    The box is that of the agent with the most trusted returns, moved to the weighted mean of all centers.
    """
    boxes, best_score = np.zeros((len(matches), 7)), np.full(len(matches), -1.0)
    kinds, returns = np.zeros(len(matches), np.uint8), np.zeros(len(matches), np.int64)
    moment, total = np.zeros((len(matches), 2)), np.zeros(len(matches))
    for k, report in enumerate(reports):
        hit, detections = np.flatnonzero(matches[:, k] >= 0), report.in_world
        indices = matches[hit, k]
        weight = trust[k] / (STD_M + STD_PER_M * report.range_m(detections.boxes[indices])) ** 2
        moment[hit] += weight[:, None] * detections.boxes[indices, :2]
        total[hit] += weight
        score = trust[k] * (1.0 + detections.returns[indices])
        better = score > best_score[hit]
        boxes[hit[better]], kinds[hit[better]] = detections.boxes[indices[better]], detections.kinds[indices[better]]
        best_score[hit] = np.maximum(best_score[hit], score)
        returns[hit] += detections.returns[indices]
    boxes[:, :2] = moment / np.maximum(total, 1e-12)[:, None]
    in_int32 = np.minimum(returns, np.iinfo(np.int32).max).astype(np.int32)
    return Detections(boxes, kinds, in_int32), np.eye(2) / np.maximum(total, 1e-12)[:, None, None]
