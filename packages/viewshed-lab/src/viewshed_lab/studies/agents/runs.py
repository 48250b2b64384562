"""Runs the cases of a scene through command centers: ours, one without trust, and the published trust."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.honest import KNOWN, HonestExamples, HonestModel, ObjectReports
from viewshed.agents.many import GATE_M, CommandCenter, object_reports
from viewshed.agents.registration import PoseStd
from viewshed.agents.report import FAR_M, AgentReport
from viewshed.agents.view_evidence import Comparisons
from viewshed.arrays import F64
from viewshed.geometry import Rigid
from viewshed.objects.metrics import gospa
from viewshed.objects.views import GridView
from viewshed_lab.data.drive import SEEN_RETURNS
from viewshed_lab.studies.agents.lies import LIES, Liars
from viewshed_lab.studies.agents.plan import ONSET_S, POSE_NOISE, STATED
from viewshed_lab.studies.agents.published import PublishedTrust
from viewshed_lab.studies.agents.scenes import Scene
from viewshed_lab.studies.cases import generator

CENTERS = ("ours", "no trust", "published", "all tracks")
"""Pictures whose GOSPA is measured: the tracks that some agent reports now; ``all tracks`` has all of no trust."""

FOUND_M = 2.0
"""A detection nearer than this to an object counts as a detection of it."""

MOVED_M = (0.6, 4.0)
"""Minimum and maximum shift of boxes for examples of moved objects."""

LEARNED_EACH = 2
"""Examples are taken from every k-th time of a scene."""

ELSEWHERE_EACH = 2
"""Every k-th box gives an example of a displaced and of a moved object."""

LEFT_OUT = 0.15
"""Probability at each time that an agent stops reporting a known object."""

POSE_STD = PoseStd(0.2, float(np.radians(0.5)))
"""Standard deviation of pose errors in the cases with pose noise; drawn once per agent and scene."""


@dataclass(frozen=True, slots=True)
class Run:
    """Result of one case of a scene, in plain values for the result store."""

    case: str  # ``HONEST``, pose noise, or a lie
    liars: list[int]  # numbers of the lying agents
    victim: int  # agent that the liars try to get expelled, or -1
    answers: list[list[list[float]]]  # [T][A][5] evidence against each agent by ``QUESTIONS``
    doubt: list[float]  # [T] doubt about all agents
    trust: list[list[float]]  # [T][A]
    published_trust: list[list[float]]  # [T][A] by the published formulas
    suspects: list[list[int]]  # [T][A] 0 or 1
    gospa: dict[str, list[float]]  # by center, [T] meters
    touched: list[float]  # [T] number of objects, or share of the area, that the liars changed
    # (J,) for each object lied about, the mean number over time of honest agents that report it at its place
    witnesses: list[float]


@dataclass(slots=True)
class SceneCases:
    """Runs the cases of one scene; its honest reports are computed once."""

    scene: Scene
    seed: tuple[int, str, int]  # seed of the study, split and number of the scene
    honest: HonestModel  # model of honest agents
    compared: bool = True  # whether a center without trust and the published trust also run
    _reports: list[list[AgentReport]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._reports = [self.scene.reports(time) for time in range(len(self.scene.times_s))]

    def said(self, case: str) -> tuple[Liars | None, Iterator[list[AgentReport]]]:
        """Return the liars of a case and an iterator over the reports of all agents at each time."""
        scene, agents = self.scene, self.scene.agents
        rng = generator(*self.seed, case)
        order = [int(number) for number in rng.permutation(len(agents))]
        lie = LIES.get(case)
        count = min(lie.liars, (len(agents) - 1) // 2) if lie is not None else 0
        liars = None if lie is None else Liars(lie, tuple(order[:count]), order[count] if lie.flips else -1, rng)
        errors = rng.normal(size=(len(agents), 3)) * (POSE_STD.place_m, POSE_STD.place_m, POSE_STD.yaw)

        def reports() -> Iterator[list[AgentReport]]:
            for t_s, honest in zip(scene.times_s, self._reports, strict=True):
                sent = list(honest)
                if case in POSE_NOISE:
                    pairs = zip(sent, errors, strict=True)
                    sent = [_misplaced(report, error, stated=case == STATED) for report, error in pairs]
                if liars is not None:
                    sent = liars.forge(sent) if t_s >= ONSET_S else liars.look(sent)
                yield sent

        return liars, reports()

    def run(self, case: str) -> Run:
        """Run one case of the scene."""
        scene, agents, (liars, sent) = self.scene, self.scene.agents, self.said(case)
        centers = {"ours": CommandCenter(agents, honest=self.honest)}
        if self.compared:
            centers["no trust"] = CommandCenter(agents, honest=self.honest, trusting=True)
        distances: dict[str, list[float]] = {name: [] for name in CENTERS}
        answers, doubt, trust, suspects, published_trust = [], [], [], [], []
        published, witnesses = PublishedTrust(), list[list[int]]()
        for time, reports in enumerate(sent):
            truth = seen_objects(scene, time)
            if liars is not None and liars.places is not None:
                witnesses.append(_witnesses(liars.places, self._reports[time], liars.numbers))
            for name, center in centers.items():
                picture = center.add(float(scene.times_s[time]), reports)
                xy_m, now = picture.tracks.boxes[:, :2], picture.reported
                shown = picture.tracks.confirmed if center.trusting else picture.believed
                distances[name].append(gospa(xy_m[shown & now], truth[:, :2]).distance_m)
                if center.trusting:
                    agents_trust, believed = published.add(picture, reports)
                    published_trust.append(agents_trust)
                    distances["published"].append(gospa(xy_m[believed & now], truth[:, :2]).distance_m)
                    distances["all tracks"].append(gospa(xy_m[shown], truth[:, :2]).distance_m)
                else:
                    answers.append(picture.verdicts.answers)
                    doubt.append(picture.verdicts.doubt)
                    trust.append(picture.verdicts.trust)
                    suspects.append(picture.verdicts.suspects)
        return Run(
            case, list(liars.numbers) if liars else [], liars.victim if liars else -1, _rounded(answers),
            _rounded(doubt), _rounded(trust), _rounded(published_trust), np.array(suspects, int).tolist(),
            {name: _rounded(values) for name, values in distances.items()},
            liars.touched if liars else [], _rounded(np.mean(witnesses, axis=0) if witnesses else []),
        )  # fmt: skip


def _misplaced(report: AgentReport, error: F64, *, stated: bool) -> AgentReport:
    """Return a report with a pose error (3,): x and y of the world in meters, heading in radians."""
    shift = Rigid(np.eye(3), np.array([error[0], error[1], 0.0]))
    moved = report.placed_at(shift @ report.world_from_level @ Rigid.from_yaw(float(error[2])))
    return replace(moved, pose_std=POSE_STD) if stated else moved


def _witnesses(places: F64, honest: Sequence[AgentReport], liars: Sequence[int]) -> list[int]:
    """Return the number (J,) of honest agents with a detection at each place (J, 2 or more) of the world."""
    count = np.zeros(len(places), np.int64)
    for number, report in enumerate(honest):
        if number not in liars:
            distance_m = np.linalg.norm(places[:, None, :2] - report.in_world.boxes[None, :, :2], axis=2)
            count += distance_m.min(axis=1, initial=np.inf) < FOUND_M
    return count.tolist()


def seen_objects(scene: Scene, time: int) -> F64:
    """Return the boxes (K, 7) of the objects that some agent sees at a time, near enough to report them."""
    returns = scene.returns[time].copy()
    places = scene.poses[time, :, :2, 3]
    distance_m = np.linalg.norm(scene.objects[time, None, :, :2] - places[:, None], axis=2)
    own = scene.carriers >= 0
    returns[np.flatnonzero(own), scene.carriers[own]] = 0
    seen = ((returns >= SEEN_RETURNS) & (distance_m < FAR_M)).any(axis=0)
    boxes: F64 = scene.objects[time, seen]
    return boxes


def honest_examples(scene: Scene, rng: np.random.Generator) -> tuple[list[HonestExamples], list[Comparisons]]:
    """Return examples of honest reports (also with displaced, moved and left-out objects), and comparisons of views."""
    center = CommandCenter(scene.agents, honest=HonestModel.blank())
    out, compared = [], []
    numbers, left_out = np.arange(len(scene.agents)), _LeftOut(rng)
    for time, t_s in enumerate(scene.times_s):
        reports = scene.reports(time)
        picture = center.add(float(t_s), reports)
        compared.append(picture.compared)
        without = left_out.of(picture.tracks.ids[picture.reported], picture.said)
        if time % LEARNED_EACH:
            continue
        truth = seen_objects(scene, time)
        # Assign each detection near a true object to it.
        members = np.full((len(truth), len(numbers)), -1, np.int32)
        for number, report in enumerate(reports):
            distance_m = np.linalg.norm(truth[:, None, :2] - report.in_world.boxes[None, :, :2], axis=2)
            if distance_m.size:
                members[:, number] = np.where(distance_m.min(axis=1) < FOUND_M, distance_m.argmin(axis=1), -1)
        past = np.zeros((len(truth), 4, len(numbers)))
        objects = object_reports(reports, numbers, len(numbers), truth, members, past)
        distance_m = np.linalg.norm(picture.tracks.boxes[picture.reported, None, :2] - truth[None, :, :2], axis=2)
        is_object = distance_m.min(axis=1, initial=np.inf) < FOUND_M
        out.append(HonestExamples.of(picture.said, is_object, objects, *_displaced(reports, rng), without))
    return out, compared


@dataclass(slots=True)
class _LeftOut:
    """Stops some agents from reporting known objects, from a random time on."""

    rng: np.random.Generator
    _past: dict[int, F64] = field(default_factory=dict)  # (5, A) by id of the object; see ``of``

    def of(self, ids: NDArray[np.int64], said: ObjectReports) -> ObjectReports:
        """Return the reports at the next time without the left-out ones; only these count as able to be reported."""
        blank = np.zeros((5, said.seen.shape[1]))
        past = np.array([self._past.get(number, blank) for number in ids.tolist()]).reshape(-1, *blank.shape)
        begins = said.seen & (said.before >= KNOWN) & (self.rng.random(said.seen.shape) < LEFT_OUT)
        # Per object and agent: left out, looks before, silent looks since, surface and returns at the last report.
        now = np.stack([begins, said.before, np.zeros_like(said.returns), said.surface, said.returns], axis=1)
        now = np.where(past[:, :1] > 0, past, now)
        chosen = now[:, 0] > 0
        left_out = replace(
            said, seen=said.seen & ~chosen, able=said.able & chosen, before=now[:, 1].astype(np.int64),
            silent=now[:, 2].astype(np.int64), surface=now[:, 3], returns=now[:, 4],
        )  # fmt: skip
        now[:, 2] += left_out.able
        self._past |= dict(zip(ids.tolist(), now, strict=True))
        return left_out


def _displaced(reports: Sequence[AgentReport], rng: np.random.Generator) -> tuple[ObjectReports, ObjectReports]:
    """Return honest boxes turned around their sensor to empty visible places, and honest boxes shifted a little."""
    agents, all_xy = len(reports), np.concatenate([report.in_world.boxes[:, :2] for report in reports])
    turned, moved = list[tuple[int, F64]](), list[tuple[int, F64]]()
    for number, report in enumerate(reports):
        own = report.in_world.boxes[::ELSEWHERE_EACH]
        azimuth, yaw = rng.uniform(-np.pi, np.pi, (2, len(own)))
        boxes, range_m = own.copy(), report.range_m(own)
        boxes[:, :2] = report.world_from_level.translation[:2] + range_m[:, None] * _directions(azimuth)
        boxes[:, 6] = yaw
        free = np.linalg.norm(boxes[:, None, :2] - all_xy[None], axis=2).min(axis=1, initial=np.inf) > GATE_M
        visible = GridView(report.estimate, 0.0).visible(boxes) > 0.5
        turned += [(number, box) for box in boxes[free & visible]]
        boxes = own.copy()
        boxes[:, :2] += rng.uniform(*MOVED_M, (len(own), 1)) * _directions(azimuth)
        moved += [(number, box) for box in boxes]
    out = []
    for rows in (turned, moved):
        boxes = np.array([box for _, box in rows]).reshape(-1, 7)
        own = np.full((len(rows), agents, 7), np.nan)
        for row, (number, box) in enumerate(rows):
            own[row, number] = box
        members, past = np.full((len(rows), agents), -1, np.int32), np.zeros((len(rows), 4, agents))
        out.append(object_reports(reports, np.arange(agents), agents, boxes, members, past, own))
    return out[0], out[1]


def _directions(azimuth: F64) -> F64:
    """Return unit vectors (N, 2) at azimuths (N,)."""
    return np.column_stack([np.cos(azimuth), np.sin(azimuth)])


def _rounded(values: Any) -> Any:
    return np.round(np.array(values, np.float64), 4).tolist()
