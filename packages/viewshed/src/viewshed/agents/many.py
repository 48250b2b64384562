"""Many agents, one picture: joint tracks, and who is trusted.

What agents report of one time is put together in five steps:

1. poses are put right within their stated errors (:mod:`viewshed.agents.registration`);
2. detections of all agents are matched with each other, each agent's with at most one of another's;
3. the joint detections go through one tracker, whose probability of detection is that *any* trusted agent sees;
4. all that agents report of each track, by a report or by silence where they claim to see, and how their views compare
   (:mod:`viewshed.agents.view_evidence`), is explained by sets of liars (:mod:`viewshed.agents.trust`);
5. a track is believed if it exists whoever lies.

What an agent claims about its own vehicle's box is no report: it cannot see itself.
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
from viewshed.agents.trust import Reports, Trust, TrustRules, Verdicts
from viewshed.agents.view_evidence import ComparedView, Comparisons, compare_views
from viewshed.arrays import F64, Mask
from viewshed.detections import Detections
from viewshed.objects.association import assign
from viewshed.objects.cells import BoxCells, SeenCells
from viewshed.objects.tracker import Tracker
from viewshed.objects.tracks import Tracks
from viewshed.objects.views import hidden_within

__all__ = [
    "AgentReport", "CommandCenter", "CommonPicture", "JointFov", "confirmed", "joint_fov", "match_agents",
]  # fmt: skip

GATE_M, STORY_M = 4.0, 2.5
"""Detections of two agents farther apart, in the plane or in height, are of two objects."""

STD_M, STD_PER_M = 0.5, 0.012
"""Standard deviation of a detection's center along each axis: at the sensor, and what each meter of range adds."""

_NOBODY = np.array([0.0, 0.0, np.nan, np.nan])
"""Of an object that an agent has not reported: looks with a report, looks without one since, surface and returns at the
last report."""

LOOKED_AT = (13, 7)
"""Points along and across a box at which views are looked up."""

LEAST_TRUST = 0.05
"""Weight of an agent's detections that is left when nobody trusts it."""

LOOK_S = 0.5
"""The view of each agent is compared with the others' once in this time; reports within it are one look."""

FALSE_ODDS = 0.1
"""False joint detections for one of an object."""

BELIEVED = 0.5
"""Probability of existence, whoever lies, from which a track is believed."""


def chances(reports: Sequence[AgentReport], boxes: F64, honest: HonestModel) -> F64:
    """Return the chance (K, R) that each honest agent in its place reports each box (K, 7) of the world."""
    out = np.zeros((len(boxes), len(reports)))
    for column, report in enumerate(reports):
        range_m = report.range_m(boxes)
        chosen = np.flatnonzero(range_m <= FAR_M)
        chosen = chosen[~report.is_own(boxes[chosen]) & report.on_its_level(boxes[chosen])]
        some = boxes[chosen]
        out[chosen, column] = honest.chance(report.view.visible(some), some, range_m[chosen], height=report.height)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class JointView:
    """What any of several agents could see, each weighted by how far it is trusted; a :class:`View` of tracking."""

    t_s: float
    reports: tuple[AgentReport, ...]
    trust: F64
    honest: HonestModel
    in_world: bool = True

    def visible(self, boxes: F64) -> F64:
        """Return the chance (K,) that any trusted agent reports each box."""
        missed: F64 = (1.0 - self.trust * chances(self.reports, boxes, self.honest)).prod(axis=1)
        return 1.0 - missed

    def detectable(self, boxes: F64, kinds: NDArray[np.uint8]) -> F64:
        """Return ones (K,): what a claim is worth holds the detector already."""
        return np.ones(len(boxes))

    def false_odds(self, boxes: F64, kinds: NDArray[np.uint8]) -> F64:
        """Return the same odds (K,) for all boxes: a joint detection is of several agents."""
        return np.full(len(boxes), FALSE_ODDS)

    def hides_near(self, boxes: F64, within_m: F64) -> F64:
        """Return the greatest probability (K,) of not being seen within (K,) meters of each box."""
        return hidden_within(self, boxes, within_m)


@dataclass(frozen=True, slots=True, eq=False)
class CommonPicture:
    """What all agents say together of one time."""

    t_s: float  # the time
    agents: tuple[str, ...]  # names of all agents
    reports: tuple[AgentReport, ...]  # of the agents that reported, their poses put right
    tracks: Tracks  # joint tracks in the world
    verdicts: Verdicts  # of the agents, and of those tracks that somebody reports now
    elevated: Mask  # (A,) bool, whose sensors look over the traffic
    existence: F64  # (N,) probability of each track, whoever lies
    reporters: Mask  # (N, A) bool, who reports each track now
    deniers: Mask  # (N, A) bool, who claims to see the place of each track that others report now, and is silent
    said: ObjectReports  # what all agents report about those tracks that somebody reports now, in their order
    compared: Comparisons  # what views say of each other
    notes: tuple[str, ...] = ()  # what was left out, a sentence each

    @property
    def believed(self) -> Mask:
        """(N,) bool, tracks that exist whoever lies."""
        return np.asarray(self.existence >= BELIEVED)

    @property
    def reported(self) -> Mask:
        """(N,) bool, tracks that somebody reports now."""
        return np.asarray(self.tracks.detection >= 0)


@dataclass(slots=True)
class CommandCenter:
    """Puts together what agents report, time by time.

    Args:
        agents: names of all that may report.
        rules: of the trust in them.
        honest: what honest agents do.
        trusting: believe everybody alike and compare no views, for comparison.
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
    _views: dict[int, ComparedView] = field(default_factory=dict, repr=False)
    _asked: dict[int, int] = field(default_factory=dict, repr=False)
    _times: int = 0
    _last_s: float | None = None

    def __post_init__(self) -> None:
        _require_different(self.agents)
        self._trust = Trust(len(self.agents), self.rules)
        self._weights = np.ones(len(self.agents))
        self._elevated = np.zeros(len(self.agents), np.bool_)

    def regroup(self, agents: tuple[str, ...]) -> None:
        """Hear other agents from now on: who stays keeps its record, who comes begins at the prior.

        Args:
            agents: names of all that may report.

        Raises:
            ValueError: there are none, or two of one name.
        """
        _require_different(agents)
        kept = [self.agents.index(agent) if agent in self.agents else -1 for agent in agents]
        self._trust.regroup(kept)
        self._views = {number: self._views[old] for number, old in enumerate(kept) if old in self._views}
        self._asked = {number: self._asked[old] for number, old in enumerate(kept) if old in self._asked}
        # The last column is that of those who come.
        self._weights = np.append(self._weights, 1.0)[kept]
        self._elevated = np.append(self._elevated, False)[kept]
        self._reported = {number: np.column_stack([past, _NOBODY])[:, kept] for number, past in self._reported.items()}
        self.agents = agents

    def add(self, t_s: float, reports: Sequence[AgentReport]) -> CommonPicture:
        """Return the picture after the reports of one time, at most one of each agent.

        Raises:
            ValueError: an agent is not known, or reports twice.
        """
        columns = self._columns(reports)
        if self._last_s is not None and t_s <= self._last_s:
            raise ValueError(f"t_s must rise, got {t_s:.3f} s after {self._last_s:.3f} s; begin a new center")
        # 1. to 3. Poses, matches, tracks.
        trust = np.ones(len(reports)) if self.trusting else self._weights[columns]
        reports = registered(reports)
        matches = match_agents([report.in_world for report in reports])
        joint, noise = _joint(reports, matches, trust)
        tracks = self._tracker.step(t_s, joint, JointView(t_s, tuple(reports), trust, self.honest), noise)

        # 4. What does each agent say of the tracks that somebody reports now, and of the others' views?
        reported = np.flatnonzero(tracks.detection >= 0)
        members, held, ids = matches[tracks.detection[reported]], tracks.ids.tolist(), tracks.ids[reported]
        nobody = np.repeat(_NOBODY[:, None], len(self.agents), axis=1)
        self._reported = {number: self._reported.get(number, nobody) for number in held}
        past = np.array([self._reported[number] for number in ids.tolist()]).reshape(-1, len(_NOBODY), len(self.agents))
        said = object_reports(reports, columns, len(self.agents), tracks.boxes[reported], members, past)
        # An agent that is silent now stays of its kind: it is judged by what it reported before.
        self._elevated[columns] = said.height[columns] > 0
        seconds = 0.5 if self._last_s is None else t_s - self._last_s
        compared = self._compared(dict(zip(columns.tolist(), reports, strict=True)), seconds)
        ratio, views = self.honest.withheld_ratio(said), self.honest.views(compared, self._elevated)
        judged = self._judged(ids, said, reports, columns, members, ratio)
        verdicts = self._trust.add(judged, seconds, views, withholding(said, ratio))
        self._weights, self._last_s = np.maximum(verdicts.trust, LEAST_TRUST), t_s
        # What is remembered until the next report: looks, and what the view and the detector had at the last report.
        look, surface = min(seconds / LOOK_S, 1.0), said.cells[..., BoxCells._fields.index("surface")]
        returns = _returns(reports, columns, len(self.agents), members)
        last = np.where(said.seen, np.stack([surface, returns]), np.moveaxis(past[:, 2:], 1, 0))
        silent = np.where(said.seen, 0.0, past[:, 1] + look * said.able)
        now = np.stack([past[:, 0] + look * said.seen, silent, *last], axis=1)
        self._reported |= dict(zip(ids.tolist(), now, strict=True))

        # 5. What nobody reports now exists as far as it did, and as far as views allow.
        self._existence |= dict(zip(ids.tolist(), verdicts.existence.tolist(), strict=True))
        self._existence = {number: self._existence.get(number, 1.0) for number in held}
        existence = np.array(tracks.existence)
        if not self.trusting:
            existence = np.minimum(existence, [self._existence[number] for number in held])
            existence[reported] = verdicts.existence
        reporters, deniers = np.zeros((2, len(tracks), len(self.agents)), np.bool_)
        reporters[reported], deniers[reported] = said.seen, said.sees & ~said.seen
        return CommonPicture(
            t_s, self.agents, tuple(reports), tracks, verdicts, self._elevated.copy(), existence, reporters, deniers,
            said, compared, tuple(tracks.notes),
        )  # fmt: skip

    def _columns(self, reports: Sequence[AgentReport]) -> NDArray[np.intp]:
        names = [report.agent for report in reports]
        for name in names:
            if name not in self.agents or names.count(name) > 1:
                raise ValueError(f"reports must be of {', '.join(self.agents)}, one each, got {', '.join(names)}")
        return np.array([self.agents.index(name) for name in names], np.intp)

    def _compared(self, views: dict[int, AgentReport], seconds: float) -> Comparisons:
        """Return how views compare: of some agents in turn, so that work is bounded whatever the rate of reports."""
        count = 0 if self.trusting else min(len(views), int(np.ceil(len(views) * seconds / LOOK_S - 1e-6)))
        asked = sorted(views, key=lambda number: (self._asked.get(number, -1), number))[:count]
        compared, seen = compare_views(views, len(self.agents), self._views, asked)
        self._views |= seen
        self._times += 1
        self._asked |= dict.fromkeys(asked, self._times)
        return compared

    def _judged(
        self, ids: NDArray[np.int64], said: ObjectReports, reports: Sequence[AgentReport], columns: NDArray[np.intp],
        members: NDArray[np.int32], ratio: F64,
    ) -> Reports:  # fmt: skip
        """Return reports with what honest agents would report.

        ``members`` (J, R) are the agents' detections, ``ratio`` (J, A) is that of what they withhold.
        """
        xy_m, std_m = np.full((*said.seen.shape, 2), np.nan), np.ones(said.seen.shape)
        for place, (report, column) in enumerate(zip(reports, columns, strict=True)):
            hit = members[:, place] >= 0
            xy_m[hit, column] = report.in_world.boxes[members[hit, place], :2]
            std_m[:, column] = STD_M + STD_PER_M * said.range_m[:, column]
        model = self.honest
        own, of_place = own_box_columns(said)[0], place_columns(said)
        return Reports(
            ids, said.seen, said.able, said.sees, model.reported(reported_columns(said)[0]), model.of_others,
            model.invented(own), model.silent_views(of_place[0], said.silent_now),
            np.array([model.alone.bias, model.shared.bias]), model.displaced(own),
            model.there(said, of_place, own, ratio), model.real.bias, xy_m, std_m, said.repeats,
        )  # fmt: skip


def _require_different(agents: tuple[str, ...]) -> None:
    if len(set(agents)) != len(agents) or not agents:
        raise ValueError(f"agents must be different names, got {', '.join(agents)}")


def registered(reports: Sequence[AgentReport]) -> Sequence[AgentReport]:
    """Return reports with their poses put right within their stated errors; see the module of that name."""
    poses = registered_poses([report.estimate for report in reports], [report.pose_std for report in reports])
    return [
        report if pose is report.world_from_level else report.placed_at(pose)
        for report, pose in zip(reports, poses, strict=True)
    ]


def object_reports(
    reports: Sequence[AgentReport], columns: NDArray[np.intp], agents: int, boxes: F64, members: NDArray[np.int32],
    past: F64, own: F64 | None = None,
) -> ObjectReports:  # fmt: skip
    """Return what all agents say of objects, and what their views claim there.

    Args:
        reports: of R agents.
        columns: (R,) their numbers.
        agents: how many there are.
        boxes: (J, 7) of the objects, in the world.
        members: (J, R) numbers of the agents' detections of them, -1 for none.
        past: (J, 4, agents) at how many looks each agent reported them before, at how many in a row it did not
            since, how much surface its view held there at its last report, and how many returns it had then.
        own: (J, R, 7) boxes that the agents report of them, NaN for none; None are those of ``members``.
    """
    shape = (len(boxes), agents)
    seen, able, visible = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_), np.zeros(shape)
    range_m, apart_m = np.full(shape, 2.0 * FAR_M), np.full(shape, NO_DETECTION_M)
    cells, own_cells = (np.zeros((*shape, len(BoxCells._fields))) for _ in range(2))
    height = np.zeros(agents, np.int64)
    for place, (report, column) in enumerate(zip(reports, columns, strict=True)):
        found, hit = report.in_world.boxes, members[:, place] >= 0
        theirs = np.full((len(boxes), 7), np.nan)
        theirs[hit] = found[members[hit, place]]
        if own is not None:
            theirs, hit = own[:, place], np.isfinite(own[:, place, 0])
        # Nobody sees itself: such reports say nothing.
        hit = hit & ~report.is_own(boxes)
        height[column], seen[:, column] = report.height, hit
        range_m[:, column] = own_range_m = report.range_m(boxes)
        near = (own_range_m <= FAR_M) & (own_range_m >= report.blind_m) & report.on_its_level(boxes)
        able[:, column] = near & ~report.is_own(boxes)
        visible[near, column] = report.view.visible(boxes[near])
        # One look at the objects that are near, and at the agent's own boxes.
        looked = SeenCells.of(report.estimate).look(
            np.concatenate([boxes[near], theirs[hit]]), report.world_from_level.translation[:2], LOOKED_AT
        )
        values = np.column_stack(looked)
        cells[near, column], own_cells[hit, column] = values[: near.sum()], values[near.sum() :]
        away = np.linalg.norm(boxes[:, None, :2] - found[None, :, :2], axis=2)
        away[np.flatnonzero(members[:, place] >= 0), members[members[:, place] >= 0, place]] = NO_DETECTION_M
        apart_m[:, column] = away.min(axis=1, initial=NO_DETECTION_M)
    before, silent = np.ceil(np.moveaxis(past[:, :2], 1, 0) - 1e-6).astype(np.int64)
    return ObjectReports(
        seen, able, visible, range_m, height, boxes[:, 3:5].max(axis=1, initial=0.0), cells, own_cells, apart_m,
        before, silent, past[:, 2], past[:, 3],
    )  # fmt: skip


def _returns(reports: Sequence[AgentReport], columns: NDArray[np.intp], agents: int, members: NDArray[np.int32]) -> F64:
    """Return how many returns each agent's detection of each object has (J, agents), NaN where it has none."""
    out = np.full((len(members), agents), np.nan)
    for place, (report, column) in enumerate(zip(reports, columns, strict=True)):
        hit = members[:, place] >= 0
        out[hit, column] = report.in_world.returns[members[hit, place]]
    return out


def match_agents(detections: Sequence[Detections]) -> NDArray[np.int32]:
    """Return which detections of R agents, in the world, are of one object: (J, R) their numbers, -1 for none.

    Agent after agent is matched with the objects found so far, by the smallest total distance within ``GATE_M``.

    >>> two = Detections(np.array([[0, 0, 0, 4, 2, 2, 0], [9, 0, 0, 4, 2, 2, 0]]), np.array([3, 3]), np.array([9, 9]))
    >>> match_agents([two, two.take(np.array([1]))]).tolist()
    [[0, -1], [1, 0]]
    """
    members, centers = np.zeros((0, len(detections)), np.int32), np.zeros((0, 3))
    for place, found in enumerate(detections):
        xyz = found.boxes[:, :3]
        apart = np.abs(centers[:, None] - xyz[None])
        nearness = GATE_M - np.hypot(apart[..., 0], apart[..., 1])
        matched = assign(np.where(apart[..., 2] < STORY_M, nearness, -1.0))
        hit = matched >= 0
        members[hit, place] = matched[hit]
        # The center of an object is the mean of those that see it.
        count = (members[hit] >= 0).sum(axis=1, keepdims=True)
        centers[hit] += (xyz[matched[hit]] - centers[hit]) / count
        is_new = np.ones(len(found), np.bool_)
        is_new[matched[hit]] = False
        left = np.flatnonzero(is_new).astype(np.int32)
        new = np.full((len(left), len(detections)), -1, np.int32)
        new[:, place] = left
        members, centers = np.concatenate([members, new]), np.concatenate([centers, xyz[left]])
    return members


def _joint(reports: Sequence[AgentReport], matches: NDArray[np.int32], trust: F64) -> tuple[Detections, F64]:
    """Return one detection for each object, with the covariance (J, 2, 2) of its center; trusted agents count most.

    The box is that of the agent with most returns, moved to the weighted mean of all centers.
    """
    boxes, best = np.zeros((len(matches), 7)), np.full(len(matches), -1.0)
    kinds, returns = np.zeros(len(matches), np.uint8), np.zeros(len(matches), np.int32)
    moment, total = np.zeros((len(matches), 2)), np.zeros(len(matches))
    for place, report in enumerate(reports):
        hit, found = np.flatnonzero(matches[:, place] >= 0), report.in_world
        of = matches[hit, place]
        weight = trust[place] / (STD_M + STD_PER_M * report.range_m(found.boxes[of])) ** 2
        moment[hit] += weight[:, None] * found.boxes[of, :2]
        total[hit] += weight
        merit = trust[place] * (1.0 + found.returns[of])
        better = merit > best[hit]
        boxes[hit[better]], kinds[hit[better]] = found.boxes[of[better]], found.kinds[of[better]]
        best[hit] = np.maximum(best[hit], merit)
        returns[hit] += found.returns[of]
    boxes[:, :2] = moment / np.maximum(total, 1e-12)[:, None]
    return Detections(boxes, kinds, returns), np.eye(2) / np.maximum(total, 1e-12)[:, None, None]
