"""Many agents, one picture: joint tracks, who is trusted, and what all of them see together.

What agents report of one time is put together in six steps:

1. poses are put right within their stated errors (:mod:`viewshed.agents.registration`);
2. detections of all agents are matched with each other, each agent's with at most one of another's;
3. the joint detections go through one tracker, whose probability of detection is that *any* trusted agent sees;
4. of each track every agent says by its report, or by its silence where it claims to see, how well it agrees
   (:mod:`viewshed.agents.trust`);
5. a track is believed if it exists whoever lies;
6. one claimed view after the other is checked (:mod:`viewshed.agents.view_checks`), and what an agent reports and what
   it claims make it more or less suspicious (:mod:`viewshed.agents.suspicion`).

What an agent claims about its own vehicle's box is no report: it cannot see itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.claims import ClaimTable, claim_table
from viewshed.agents.honest import (
    NO_DETECTION_M,
    HonestModel,
    ObjectReports,
    contradicted_columns,
    honest_model,
    own_box_columns,
    reported_columns,
    there_columns,
)
from viewshed.agents.registration import EXACT, PoseStd, registered_poses
from viewshed.agents.suspicion import Suspicion, suspicion_in_box
from viewshed.agents.trust import Reports, Trust, TrustRules, Verdicts
from viewshed.agents.view_checks import CheckedViews, height_of
from viewshed.arrays import F64, Mask
from viewshed.detections import Detections
from viewshed.fov.estimate import Basis, CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.objects.association import assign
from viewshed.objects.cells import BoxCells, SeenCells
from viewshed.objects.tracker import Tracker
from viewshed.objects.tracks import Tracks
from viewshed.objects.views import GridView, hidden_within, points_before

if TYPE_CHECKING:
    from viewshed.agents.view_message import ViewMessage

GATE_M = 4.0
"""Detections of two agents farther apart are of two objects."""

FAR_M = 50.0
"""Reports from farther than this, and silence about what is farther, say nothing."""

OWN_SIZE_M = (4.8, 2.0, 1.6)
"""Size of the vehicle below a low sensor, where it is not known."""

STD_M, STD_PER_M = 0.5, 0.012
"""Standard deviation of a detection's center along each axis: at the sensor, and what each meter of range adds."""

LOOKED_AT = (13, 7)
"""Points along and across a box at which views are looked up."""

LEAST_TRUST = 0.05
"""Weight of an agent's detections that is left when nobody trusts it."""

BELIEVED = 0.5
"""Probability of existence, whoever lies, from which a track is believed."""


@dataclass(frozen=True, eq=False)
class AgentReport:
    """What one agent says of one time.

    Attributes:
        estimate: its field of view, with a pose and its name.
        detections: its objects, in ``level``.
        own_box: (7,) box of its own vehicle in ``level``, which others see; None for a sensor on a mast.
        pose_std: what it says of the errors of its pose.

    Raises:
        ValueError: the view has no pose.
    """

    estimate: FovEstimate
    detections: Detections
    own_box: F64 | None = None
    pose_std: PoseStd = EXACT

    def __post_init__(self) -> None:
        if self.estimate.world_from_level is None:
            raise ValueError(f"the view of {self.estimate.agent} must have a pose: without one it cannot be placed")

    @classmethod
    def of(cls, estimate: FovEstimate, detections: Detections, pose_std: PoseStd = EXACT) -> AgentReport:
        """Return the report of an agent whose vehicle is not known: one of usual size below a low sensor.

        Raises:
            ValueError: the view has no pose.
        """
        report = cls(estimate, detections, None, pose_std)
        own = np.array([0.0, 0.0, OWN_SIZE_M[2] / 2, *OWN_SIZE_M, 0.0])
        return report if report.elevated else replace(report, own_box=own)

    @classmethod
    def of_message(cls, message: ViewMessage) -> AgentReport:
        """Return what a message with a view reports.

        Raises:
            ValueError: it has no view.
        """
        if message.view is None:
            raise ValueError(f"the message of {message.agent} must have a view, got none")
        view, sensor = message.view, message.sensor
        if np.isfinite(sensor.height_m):
            reach_m = sensor.reach_m if np.isfinite(sensor.reach_m) else view.grid.half_extent_m
            view = replace(view, basis=Basis(sensor.height_m, "given", 1.0, 0.0, 0.0, reach_m))
        return cls.of(view, message.detections or Detections.none(), PoseStd.of(message.pose_covariance))

    @property
    def agent(self) -> str:
        """Its name."""
        return self.estimate.agent

    @cached_property
    def world_from_level(self) -> Rigid:
        """Its pose."""
        assert self.estimate.world_from_level is not None
        return self.estimate.world_from_level

    @property
    def elevated(self) -> bool:
        """Whether its sensor looks over cars."""
        return self.height > 0

    @property
    def height(self) -> int:
        """Where its sensor is: 0 among the traffic, 1 above it, 2 on a tall mast."""
        return height_of(self.estimate)

    @cached_property
    def in_world(self) -> Detections:
        """Its detections within ``FAR_M`` in the world."""
        near = np.hypot(self.detections.boxes[:, 0], self.detections.boxes[:, 1]) <= FAR_M
        return self.detections.take(near).moved(self.world_from_level)

    def range_m(self, boxes: F64) -> F64:
        """Return the horizontal range (K,) of boxes (K, 7) of the world."""
        away = boxes[:, :2] - self.world_from_level.translation[:2]
        return np.hypot(away[:, 0], away[:, 1])

    @cached_property
    def view(self) -> GridView:
        """Its field of view, looked up in the world."""
        return GridView(self.estimate, 0.0)

    def chance(self, boxes: F64, claims: ClaimTable) -> F64:
        """Return the chance (K,) that an honest agent in its place reports each box (K, 7) of the world."""
        return chances([self], boxes, claims)[:, 0]

    def is_own(self, boxes: F64) -> Mask:
        """Return which boxes (K, 7) of the world are its own vehicle."""
        if self.own_box is None:
            return np.zeros(len(boxes), np.bool_)
        x_m, y_m = self._own_place
        return np.asarray(np.hypot(boxes[:, 0] - x_m, boxes[:, 1] - y_m) < self.own_box[3] / 2)

    @cached_property
    def _own_place(self) -> F64:
        assert self.own_box is not None
        place: F64 = (self.world_from_level @ self.own_box[:3])[:2]
        return place


def chances(reports: Sequence[AgentReport], boxes: F64, claims: ClaimTable) -> F64:
    """Return the chance (K, R) that each honest agent in its place reports each box (K, 7) of the world."""
    out = np.zeros((len(boxes), len(reports)))
    range_m = np.array([report.range_m(boxes) for report in reports]).reshape(len(reports), len(boxes))
    near = [
        np.flatnonzero((away <= FAR_M) & ~report.is_own(boxes)) for report, away in zip(reports, range_m, strict=True)
    ]
    for column, (report, chosen, visible) in enumerate(
        zip(reports, near, visible_to(reports, [boxes[chosen] for chosen in near]), strict=True)
    ):
        out[chosen, column] = claims(visible, boxes[chosen], range_m[column, chosen], height=report.height)
    return out


def visible_to(reports: Sequence[AgentReport], boxes: Sequence[F64]) -> list[F64]:
    """Return the probability (K,) that each agent could see its boxes (K, 7) of the world, as it claims.

    Lines of sight of all agents whose grids are alike are followed at once: that is most of the work.
    """
    levels = [report.view.in_level(some) for report, some in zip(reports, boxes, strict=True)]
    steps = {report.estimate.grid.cell_m for report in reports}
    if len(steps) == 1:
        ends = np.cumsum([len(some) for some in boxes])[:-1]
        points = np.split(points_before(np.concatenate(levels), steps.pop()), ends)
    else:
        points = [
            points_before(level, report.estimate.grid.cell_m) for report, level in zip(reports, levels, strict=True)
        ]
    return [report.view.visible_at(some) for report, some in zip(reports, points, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class JointView:
    """What any of several agents could see, each weighted by how far it is trusted; a :class:`View` of tracking."""

    t_s: float
    reports: tuple[AgentReport, ...]
    trust: F64
    claims: ClaimTable
    in_world: bool = True

    def visible(self, boxes: F64) -> F64:
        """Return the chance (K,) that any trusted agent reports each box."""
        missed: F64 = (1.0 - self.trust * chances(self.reports, boxes, self.claims)).prod(axis=1)
        return 1.0 - missed

    def detectable(self, boxes: F64, kinds: NDArray[np.uint8]) -> F64:
        """Return ones (K,): what a claim is worth holds the detector already."""
        return np.ones(len(boxes))

    def hides_near(self, boxes: F64, within_m: F64) -> F64:
        """Return the greatest probability (K,) of not being seen within (K,) meters of each box."""
        return hidden_within(self, boxes, within_m)


@dataclass(frozen=True, slots=True, eq=False)
class CommonPicture:
    """What all agents say together of one time.

    Attributes:
        t_s: the time.
        agents: names of all agents.
        reports: of the agents that reported, their poses put right.
        tracks: joint tracks in the world.
        verdicts: of the agents, and of those tracks that somebody reports now.
        existence: (N,) probability of each track, whoever lies.
        reporters: (N, A) bool, who reports each track now.
        said: what all agents report about those tracks that somebody reports now, in their order.
        checks: (A, C) of the agents' views, the mean of the last ones; NaN where there is none.
        suspicion: (A,) how suspicious each agent is, by what it reports and what it claims.
        notes: what was left out, a sentence each.
    """

    t_s: float
    agents: tuple[str, ...]
    reports: tuple[AgentReport, ...]
    tracks: Tracks
    verdicts: Verdicts
    existence: F64
    reporters: Mask
    said: ObjectReports
    checks: F64
    suspicion: F64
    notes: tuple[str, ...] = ()

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
        claims: what a claim of visibility is worth.
        honest: what honest agents report.
        suspicion: how rare evidence and checks of views are among honest agents.
        trusting: believe everybody alike and check no view, for comparison.
    """

    agents: tuple[str, ...]
    rules: TrustRules = field(default_factory=TrustRules)
    claims: ClaimTable = field(default_factory=claim_table)
    trusting: bool = False
    honest: HonestModel = field(default_factory=honest_model)
    suspicion: Suspicion = field(default_factory=suspicion_in_box)
    _trust: Trust = field(init=False, repr=False)
    _tracker: Tracker = field(default_factory=Tracker, repr=False)
    _existence: dict[int, float] = field(default_factory=dict, repr=False)
    _reported: dict[int, NDArray[np.int64]] = field(default_factory=dict, repr=False)
    _weights: F64 = field(init=False, repr=False)
    _elevated: Mask = field(init=False, repr=False)
    _checked: CheckedViews = field(init=False, repr=False)
    _last_s: float | None = None

    def __post_init__(self) -> None:
        _require_different(self.agents)
        self._trust = Trust(len(self.agents), self.rules)
        self._weights = np.ones(len(self.agents))
        self._elevated = np.zeros(len(self.agents), np.bool_)
        self._checked = CheckedViews(len(self.agents))

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
        self._checked.regroup(kept)
        # The last column is that of those who come.
        self._weights = np.append(self._weights, 1.0)[kept]
        self._elevated = np.append(self._elevated, False)[kept]
        self._reported = {number: np.append(times, 0)[kept] for number, times in self._reported.items()}
        self.agents = agents

    def add(self, t_s: float, reports: Sequence[AgentReport]) -> CommonPicture:
        """Return the picture after the reports of one time, at most one of each agent.

        Raises:
            ValueError: an agent is not known, or reports twice.
        """
        columns = self._columns(reports)
        if self._last_s is not None and t_s <= self._last_s:
            raise ValueError(f"t_s must rise, got {t_s:.3f} s after {self._last_s:.3f} s; begin a new center")
        trust = np.ones(len(reports)) if self.trusting else self._weights[columns]
        reports = registered(reports)
        matches = match_agents([report.in_world for report in reports])
        joint, noise = _joint(reports, matches, trust)
        tracks = self._tracker.step(t_s, joint, JointView(t_s, tuple(reports), trust, self.claims), noise)

        # Tracks that somebody reports now: what does each agent say of them?
        reported = np.flatnonzero(tracks.detection >= 0)
        members = matches[tracks.detection[reported]]
        held = tracks.ids.tolist()
        nobody = np.zeros(len(self.agents), np.int64)
        self._reported = {number: self._reported.get(number, nobody) for number in held}
        before = np.array([self._reported[number] for number in tracks.ids[reported].tolist()], np.int64)
        of_objects = object_reports(
            reports, columns, len(self.agents), tracks.boxes[reported], members, before.reshape(-1, len(self.agents)),
            tracks.existence[reported],
        )  # fmt: skip
        # An agent that is silent now stays of its kind: it is judged by what it reported before.
        self._elevated[columns] = of_objects.height[columns] > 0
        seconds = 0.5 if self._last_s is None else t_s - self._last_s
        judged = self._judged(tracks.ids[reported], of_objects, reports, columns, members)
        verdicts, self._last_s = self._trust.add(judged, seconds), t_s
        self._weights = np.maximum(verdicts.trust, LEAST_TRUST)
        for number, seen in zip(tracks.ids[reported].tolist(), of_objects.seen, strict=True):
            self._reported[number] = self._reported[number] + seen
        self._existence |= dict(zip(verdicts.ids.tolist(), verdicts.existence.tolist(), strict=True))
        self._existence = {number: self._existence.get(number, 1.0) for number in held}
        # What nobody reports now exists as far as it did, and as far as views allow.
        existence = np.array(tracks.existence)
        if not self.trusting:
            existence = np.minimum(existence, [self._existence[number] for number in held])
            existence[reported] = verdicts.existence
        reporters = np.zeros((len(tracks), len(self.agents)), np.bool_)
        reporters[reported] = of_objects.seen
        claimed = {
            int(column): (report.estimate, report.detections) for column, report in zip(columns, reports, strict=True)
        }
        checks = self._checked.add({} if self.trusting else claimed)
        suspicion = self.suspicion(verdicts.evidence, checks, self._elevated)
        return CommonPicture(
            t_s, self.agents, tuple(reports), tracks, verdicts, existence, reporters, of_objects, checks, suspicion,
            tuple(tracks.notes),
        )  # fmt: skip

    def _columns(self, reports: Sequence[AgentReport]) -> NDArray[np.intp]:
        names = [report.agent for report in reports]
        for name in names:
            if name not in self.agents or names.count(name) > 1:
                raise ValueError(f"reports must be of {', '.join(self.agents)}, one each, got {', '.join(names)}")
        return np.array([self.agents.index(name) for name in names], np.intp)

    def _judged(
        self, ids: NDArray[np.int64], of_objects: ObjectReports, reports: Sequence[AgentReport],
        columns: NDArray[np.intp], members: NDArray[np.int32],
    ) -> Reports:  # fmt: skip
        """Return reports with what honest agents would report; ``members`` (J, R) are the agents' detections."""
        model = self.honest
        xy_m, std_m = np.full((*of_objects.seen.shape, 2), np.nan), np.ones(of_objects.seen.shape)
        for place, (report, column) in enumerate(zip(reports, columns, strict=True)):
            hit = members[:, place] >= 0
            xy_m[hit, column] = report.in_world.boxes[members[hit, place], :2]
            std_m[:, column] = STD_M + STD_PER_M * of_objects.range_m[:, column]
        of_agents, _, whole = there_columns(of_objects)
        own = own_box_columns(of_objects)[0]
        there, prior = model.there(of_agents) - model.there.bias, model.there(whole)
        return Reports(
            ids, of_objects.seen, of_objects.able, of_objects.sees, model.reported(reported_columns(of_objects)[0]),
            model.of_others, model.invented(own), model.contradicted(contradicted_columns(of_objects)[0]),
            model.displaced(own), there, prior, xy_m, std_m, self._elevated.copy(),
        )  # fmt: skip


def _require_different(agents: tuple[str, ...]) -> None:
    if len(set(agents)) != len(agents) or not agents:
        raise ValueError(f"agents must be different names, got {', '.join(agents)}")


def registered(reports: Sequence[AgentReport]) -> Sequence[AgentReport]:
    """Return reports with their poses put right within their stated errors; see the module of that name."""
    poses = registered_poses([report.estimate for report in reports], [report.pose_std for report in reports])
    return [
        report
        if pose is report.world_from_level
        else replace(report, estimate=replace(report.estimate, world_from_level=pose))
        for report, pose in zip(reports, poses, strict=True)
    ]


def object_reports(
    reports: Sequence[AgentReport], columns: NDArray[np.intp], agents: int, boxes: F64, members: NDArray[np.int32],
    before: NDArray[np.int64], existence: F64, own: F64 | None = None,
) -> ObjectReports:  # fmt: skip
    """Return what all agents say of objects, and what their views claim there.

    Args:
        reports: of R agents.
        columns: (R,) their numbers.
        agents: how many there are.
        boxes: (J, 7) of the objects, in the world.
        members: (J, R) numbers of the agents' detections of them, -1 for none.
        before: (J, agents) how often each agent reported them before.
        existence: (J,) of their tracks.
        own: (J, R, 7) boxes that the agents report of them, NaN for none; None are those of ``members``.
    """
    shape = (len(boxes), agents)
    seen, able, visible = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_), np.zeros(shape)
    range_m, apart_m = np.full(shape, 2.0 * FAR_M), np.full(shape, NO_DETECTION_M)
    cells, own_cells = (np.zeros((*shape, len(BoxCells._fields))) for _ in range(2))
    height = np.zeros(agents, np.int64)
    for report, column in zip(reports, columns, strict=True):
        range_m[:, column] = report.range_m(boxes)
    nearby = range_m <= FAR_M
    seen_before = visible_to(reports, [boxes[nearby[:, column]] for column in columns]) if len(reports) else []
    for place, (report, column) in enumerate(zip(reports, columns, strict=True)):
        found, hit = report.in_world.boxes, members[:, place] >= 0
        theirs = np.full((len(boxes), 7), np.nan)
        theirs[hit] = found[members[hit, place]]
        if own is not None:
            theirs, hit = own[:, place], np.isfinite(own[:, place, 0])
        height[column], seen[:, column] = report.height, hit
        near = nearby[:, column]
        able[:, column] = near & ~report.is_own(boxes)
        visible[near, column] = seen_before[place]
        # One look at the objects that are near, and at the agent's own boxes.
        looked = SeenCells.of(report.estimate).look(
            np.concatenate([boxes[near], theirs[hit]]), report.world_from_level.translation[:2], LOOKED_AT
        )
        values = np.column_stack(looked)
        cells[near, column], own_cells[hit, column] = values[: near.sum()], values[near.sum() :]
        away = np.linalg.norm(boxes[:, None, :2] - found[None, :, :2], axis=2)
        away[np.flatnonzero(members[:, place] >= 0), members[members[:, place] >= 0, place]] = NO_DETECTION_M
        apart_m[:, column] = away.min(axis=1, initial=NO_DETECTION_M)
    return ObjectReports(
        seen, able, visible, range_m, height, boxes[:, 3:5].max(axis=1, initial=0.0), cells, own_cells, apart_m,
        before, existence,
    )  # fmt: skip


def match_agents(detections: Sequence[Detections]) -> NDArray[np.int32]:
    """Return which detections of R agents, in the world, are of one object: (J, R) their numbers, -1 for none.

    Agent after agent is matched with the objects found so far, by the smallest total distance within ``GATE_M``.

    >>> two = Detections(np.array([[0, 0, 0, 4, 2, 2, 0], [9, 0, 0, 4, 2, 2, 0]]), np.array([3, 3]), np.array([9, 9]))
    >>> match_agents([two, two.take(np.array([1]))]).tolist()
    [[0, -1], [1, 0]]
    """
    members, centers = np.zeros((0, len(detections)), np.int32), np.zeros((0, 2))
    for place, found in enumerate(detections):
        xy = found.boxes[:, :2]
        matched = assign(GATE_M - np.linalg.norm(centers[:, None] - xy[None], axis=2))
        hit = matched >= 0
        members[hit, place] = matched[hit]
        # The center of an object is the mean of those that see it.
        count = (members[hit] >= 0).sum(axis=1, keepdims=True)
        centers[hit] += (xy[matched[hit]] - centers[hit]) / count
        is_new = np.ones(len(found), np.bool_)
        is_new[matched[hit]] = False
        left = np.flatnonzero(is_new).astype(np.int32)
        new = np.full((len(left), len(detections)), -1, np.int32)
        new[:, place] = left
        members, centers = np.concatenate([members, new]), np.concatenate([centers, xy[left]])
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


@dataclass(frozen=True, slots=True, eq=False)
class JointFov:
    """What several agents see together, on one grid of the world.

    Attributes:
        grid: where the cells are, about ``world_from_grid``.
        world_from_grid: pose of the grid.
        agents: names.
        visible_prob: (cells, cells) probability that any trusted agent sees a target there.
        seen_by: (cells, cells) uint8, how many agents claim to see it.
        surest: (cells, cells) int8 number of the agent that sees it most surely, -1 where nobody sees it.
        state: (cells, cells) uint8: SURFACE or FREE as the surest agent says, HIDDEN where somebody says so and nobody
            sees it, UNKNOWN elsewhere.
    """

    grid: BevGrid
    world_from_grid: Rigid
    agents: tuple[str, ...]
    visible_prob: NDArray[np.float32]
    seen_by: NDArray[np.uint8]
    surest: NDArray[np.int8]
    state: NDArray[np.uint8]

    def estimate(self, t_ns: int | None = None) -> FovEstimate:
        """Return it as one estimate, to be drawn and saved as others are."""
        return FovEstimate(
            self.grid, self.visible_prob, self.state, method=f"joint view of {len(self.agents)}",
            world_from_level=self.world_from_grid, t_ns=t_ns, agent=" ".join(self.agents),
        )  # fmt: skip


def joint_fov(
    views: Sequence[FovEstimate], grid: BevGrid, world_from_grid: Rigid, trust: NDArray[np.floating] | None = None
) -> JointFov:
    """Return what views with poses see together; an agent's claims count by how far it is trusted (A,).

    Raises:
        ValueError: a view has no pose, or there is another number of trusts.
    """
    weights = np.ones(len(views)) if trust is None else np.asarray(trust, np.float64)
    if len(weights) != len(views):
        raise ValueError(f"trust must be of {len(views)} views, got {len(weights)}")
    missed, seen_by = np.ones(grid.shape), np.zeros(grid.shape, np.uint8)
    most, surest = np.zeros(grid.shape), np.full(grid.shape, -1, np.int8)
    state = np.full(grid.shape, CellState.UNKNOWN, np.uint8)
    for number, (view, weight) in enumerate(zip(views, weights, strict=True)):
        prob, claimed = claimed_at(view, grid, world_from_grid)
        prob = weight * prob
        state[(claimed == CellState.HIDDEN) & (surest < 0)] = CellState.HIDDEN
        missed *= 1.0 - prob
        seen_by += prob >= view.threshold
        better = (prob > most) & (prob >= view.threshold)
        surest[better], state[better], most = number, claimed[better], np.maximum(most, prob)
    agents = tuple(view.agent for view in views)
    return JointFov(grid, world_from_grid, agents, (1.0 - missed).astype(np.float32), seen_by, surest, state)


def claimed_at(view: FovEstimate, grid: BevGrid, world_from_grid: Rigid) -> tuple[F64, NDArray[np.uint8]]:
    """Return the probability and the state (cells, cells) that a view claims in the cells of another grid.

    Outside its own they are 0 and UNKNOWN.

    Raises:
        ValueError: the view has no pose.
    """
    if view.world_from_level is None:
        raise ValueError(f"the view of {view.agent} must have a pose: without one it cannot be placed")
    pose = view.world_from_level.inverse() @ world_from_grid
    centers = grid.centers @ pose.rotation[:2, :2].T + pose.translation[:2]
    cells, inside = view.grid.index(centers)
    state = np.where(inside, view.state[cells[..., 0], cells[..., 1]], np.uint8(CellState.UNKNOWN))
    return np.nan_to_num(view.at(centers).astype(np.float64), nan=0.0), state


def confirmed(
    view: FovEstimate, cells: Mask, others: Sequence[FovEstimate], trust: F64, least: float, votes: int = 1
) -> FovEstimate:
    """Return a view that claims some cells only where trusted agents claim them as well; UNKNOWN elsewhere.

    Args:
        view: with a pose.
        cells: (cells, cells) bool, those in doubt: a wedge that opened, or all.
        others: views of other agents, with poses.
        trust: (O,) in the others.
        least: trust from which an agent may confirm.
        votes: least number of agents that must; with two, one liar alone confirms nothing.

    Raises:
        ValueError: a view has no pose.
    """
    if view.world_from_level is None:
        raise ValueError(f"the view of {view.agent} must have a pose: without one it cannot be confirmed")
    agreed = np.zeros(view.grid.shape, np.uint8)
    for other, one in zip(others, trust, strict=True):
        if one >= least:
            agreed += claimed_at(other, view.grid, view.world_from_level)[0] >= other.threshold
    doubtful = cells & view.visible() & (agreed < votes)
    prob = np.where(doubtful, np.minimum(view.visible_prob, np.float32(0.5 * view.threshold)), view.visible_prob)
    return replace(view, visible_prob=prob, state=np.where(doubtful, np.uint8(CellState.UNKNOWN), view.state))
