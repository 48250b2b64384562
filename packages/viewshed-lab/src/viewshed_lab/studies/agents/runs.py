"""A scene run in a case: what a center that trusts, one that does not, and the published trust make of the reports."""

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
"""Whose pictures are measured, by what somebody reports now; of no trust also by all of its tracks, seen now or not."""

FOUND_M = 2.0
"""A detection this near to an object is of it."""

MOVED_M = (0.6, 4.0)
"""How far boxes are moved to learn what moved ones look like."""

LEARNED_EACH = 2
"""What honest agents do is learned from every k-th time of a scene, ..."""

ELSEWHERE_EACH = 2
"""... and of every k-th box, once put elsewhere, once moved."""

LEFT_OUT = 0.15
"""Chance at each time that a report of a known object is left out from then on."""

POSE_STD = PoseStd(0.2, float(np.radians(0.5)))
"""Errors of poses in the cases of noise, drawn once for each agent of a scene."""


@dataclass(frozen=True, slots=True)
class Run:
    """What one case of a scene came to; plain values, which a line of results holds."""

    case: str  # ``HONEST`` or a lie
    liars: list[int]  # numbers of the agents that lied
    victim: int  # of a lie about another one, or -1
    answers: list[list[list[float]]]  # [T][A][5] what speaks against each agent by ``QUESTIONS``
    doubt: list[float]  # [T] of all
    trust: list[list[float]]  # [T][A]
    published_trust: list[list[float]]  # [T][A], of the published formulas
    suspects: list[list[int]]  # [T][A] 0 or 1
    gospa: dict[str, list[float]]  # by center, [T] meters
    touched: list[float]  # [T] objects, or share of the area, that the liars changed
    # (J,) of each object lied about how many honest agents report it where it is, on average over time
    witnesses: list[float]


@dataclass(slots=True)
class SceneCases:
    """Runs the cases of one scene; its honest reports are made once."""

    scene: Scene  # to be run
    seed: tuple[int, str, int]  # of the study, split and number of the scene
    honest: HonestModel  # what honest agents do
    compared: bool = True  # whether a center that believes everybody and the published trust are run as well
    _reports: list[list[AgentReport]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._reports = [self.scene.reports(time) for time in range(len(self.scene.times_s))]

    def said(self, case: str) -> tuple[Liars | None, Iterator[list[AgentReport]]]:
        """Return the liars of a case, and what all agents say, time after time."""
        scene, agents = self.scene, self.scene.agents
        rng = generator(*self.seed, case)
        order = [int(number) for number in rng.permutation(len(agents))]
        lie = LIES.get(case)
        count = min(lie.liars, (len(agents) - 1) // 2) if lie is not None else 0
        liars = None if lie is None else Liars(lie, tuple(order[:count]), order[count] if lie.flips else -1, rng)
        errors = rng.normal(size=(len(agents), 3)) * (POSE_STD.place_m, POSE_STD.place_m, POSE_STD.yaw)

        def reports() -> Iterator[list[AgentReport]]:
            for t_s, honest in zip(scene.times_s, self._reports, strict=True):
                said = list(honest)
                if case in POSE_NOISE:
                    pairs = zip(said, errors, strict=True)
                    said = [_misplaced(report, error, stated=case == STATED) for report, error in pairs]
                if liars is not None:
                    said = liars.forge(said) if t_s >= ONSET_S else liars.look(said)
                yield said

        return liars, reports()

    def run(self, case: str) -> Run:
        """Return what a case of the scene comes to."""
        scene, agents, (liars, said) = self.scene, self.scene.agents, self.said(case)
        centers = {"ours": CommandCenter(agents, honest=self.honest)}
        if self.compared:
            centers["no trust"] = CommandCenter(agents, honest=self.honest, trusting=True)
        distances: dict[str, list[float]] = {name: [] for name in CENTERS}
        answers, doubt, trust, suspects, published_trust = [], [], [], [], []
        published, witnesses = PublishedTrust(), list[list[int]]()
        for time, reports in enumerate(said):
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
    """Return a report whose pose is off along x and y of the world in meters and in heading, in radians (3,)."""
    shift = Rigid(np.eye(3), np.array([error[0], error[1], 0.0]))
    moved = report.placed_at(shift @ report.world_from_level @ Rigid.from_yaw(float(error[2])))
    return replace(moved, pose_std=POSE_STD) if stated else moved


def _witnesses(places: F64, honest: Sequence[AgentReport], liars: Sequence[int]) -> list[int]:
    """Return how many agents other than the liars detect something at each place (J, 2 or more) of the world."""
    count = np.zeros(len(places), np.int64)
    for number, report in enumerate(honest):
        if number not in liars:
            away = np.linalg.norm(places[:, None, :2] - report.in_world.boxes[None, :, :2], axis=2)
            count += away.min(axis=1, initial=np.inf) < FOUND_M
    return count.tolist()


def seen_objects(scene: Scene, time: int) -> F64:
    """Return the boxes (K, 7) of the objects that some agent sees at a time, near enough to report them."""
    returns = scene.returns[time].copy()
    places = scene.poses[time, :, :2, 3]
    away = np.linalg.norm(scene.objects[time, None, :, :2] - places[:, None], axis=2)
    own = scene.carriers >= 0
    returns[np.flatnonzero(own), scene.carriers[own]] = 0
    seen = ((returns >= SEEN_RETURNS) & (away < FAR_M)).any(axis=0)
    boxes: F64 = scene.objects[time, seen]
    return boxes


def honest_examples(scene: Scene, rng: np.random.Generator) -> tuple[list[HonestExamples], list[Comparisons]]:
    """Return what honest agents of a scene report, of some times and of boxes put elsewhere, and how views compare."""
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
        # Objects in truth, as if each detection near one were of it.
        nobody = np.full((len(truth), len(numbers)), -1, np.int32)
        members = nobody.copy()
        for number, report in enumerate(reports):
            away = np.linalg.norm(truth[:, None, :2] - report.in_world.boxes[None, :, :2], axis=2)
            if away.size:
                members[:, number] = np.where(away.min(axis=1) < FOUND_M, away.argmin(axis=1), -1)
        past = np.zeros((len(truth), 4, len(numbers)))
        objects = object_reports(reports, numbers, len(numbers), truth, members, past)
        away = np.linalg.norm(picture.tracks.boxes[picture.reported, None, :2] - truth[None, :, :2], axis=2)
        is_object = away.min(axis=1, initial=np.inf) < FOUND_M
        out.append(HonestExamples.of(picture.said, is_object, objects, *_put_elsewhere(reports, rng), without))
    return out, compared


@dataclass(slots=True)
class _LeftOut:
    """Leaves out some reports of known objects from some time on."""

    rng: np.random.Generator
    _past: dict[int, F64] = field(default_factory=dict)  # (5, A) of each object; see ``of``

    def of(self, ids: NDArray[np.int64], said: ObjectReports) -> ObjectReports:
        """Return the next reports without what is left out; nobody is able to report anything else."""
        nothing = np.zeros((5, said.seen.shape[1]))
        past = np.array([self._past.get(number, nothing) for number in ids.tolist()]).reshape(-1, *nothing.shape)
        begins = said.seen & (said.before >= KNOWN) & (self.rng.random(said.seen.shape) < LEFT_OUT)
        # Left out or not, looks before, silent looks since, surface and returns at the last report: kept from then on.
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


def _put_elsewhere(reports: Sequence[AgentReport], rng: np.random.Generator) -> tuple[ObjectReports, ObjectReports]:
    """Return honest boxes turned about their sensor to where nobody reports anything, and moved a little."""
    agents, everything = len(reports), np.concatenate([report.in_world.boxes[:, :2] for report in reports])
    turned, moved = list[tuple[int, F64]](), list[tuple[int, F64]]()
    for number, report in enumerate(reports):
        own = report.in_world.boxes[::ELSEWHERE_EACH]
        way = rng.uniform(-np.pi, np.pi, (2, len(own)))
        box, range_m = own.copy(), report.range_m(own)
        box[:, :2] = report.world_from_level.translation[:2] + range_m[:, None] * _ways(way[0])
        box[:, 6] = way[1]
        free = np.linalg.norm(box[:, None, :2] - everything[None], axis=2).min(axis=1, initial=np.inf) > GATE_M
        sees = GridView(report.estimate, 0.0).visible(box) > 0.5
        turned += [(number, each) for each in box[free & sees]]
        box = own.copy()
        box[:, :2] += rng.uniform(*MOVED_M, (len(own), 1)) * _ways(way[0])
        moved += [(number, each) for each in box]
    out = []
    for rows in (turned, moved):
        boxes = np.array([each for _, each in rows]).reshape(-1, 7)
        own = np.full((len(rows), agents, 7), np.nan)
        for line, (number, each) in enumerate(rows):
            own[line, number] = each
        nobody, past = np.full((len(rows), agents), -1, np.int32), np.zeros((len(rows), 4, agents))
        out.append(object_reports(reports, np.arange(agents), agents, boxes, nobody, past, own))
    return out[0], out[1]


def _ways(azimuth: F64) -> F64:
    return np.column_stack([np.cos(azimuth), np.sin(azimuth)])


def _rounded(values: Any) -> Any:
    return np.round(np.array(values, np.float64), 4).tolist()
