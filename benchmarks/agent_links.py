"""Many agents with poor poses and poor links: ``python -m benchmarks.agent_links --study FOLDER [--scenes N]``.

Test scenes of ``viewshed study agents`` (``--study`` is its folder) once more, with noise on poses, reports that come
late, and reports that are lost (``viewshed.messages.transport.Radio``); then false objects with the LiDAR of the liar,
or of an honest agent, spoofed to show them. Scores and limits are those of the study. Writes
docs/results/agent_links.md. Runs that are done are kept in ``--work``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.agent_scenes import share
from viewshed._page import facts, page, table
from viewshed.datasets.simulated import scan_frame
from viewshed.estimators import load_estimator
from viewshed.fusion.claims import ClaimTable
from viewshed.fusion.honest import HonestModel
from viewshed.fusion.many import AgentReport, CommandCenter
from viewshed.fusion.registration import PoseStd
from viewshed.geometry import Rigid
from viewshed.messages.transport import Radio, RadioFaults
from viewshed.objects import Detections
from viewshed.perception.detector import Detector
from viewshed.preprocess.leveling import level
from viewshed.studies.agents.jobs import CLAIMS, HONEST_MODEL
from viewshed.studies.agents.lies import LIES, Liars
from viewshed.studies.agents.page import AgentsResults, ScoredRun
from viewshed.studies.agents.plan import HONEST, ONSET_S, AgentsPlan
from viewshed.studies.agents.runs import Run, plain_checks
from viewshed.studies.agents.scenes import GRID, Scene, scene_path, scene_world
from viewshed.studies.cases import generator
from viewshed.studies.records import Results
from viewshed.studies.store import ResultStore
from viewshed.sweep import Sweep
from viewshed.threats.attacks.ghosts import GhostCar

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "results" / "agent_links.md"

GROUPS = {
    "objects": ("fabricate", "remove", "translate"),
    "views": ("over_claim", "under_claim"),
    "poses": ("shifted_pose", "turned_pose"),
}
"""Lies that are told of together."""

CASES = tuple(name for names in GROUPS.values() for name in names)

FALSE_ALARMS = 0.03
"""Share of honest agents at which detection of false objects is stated, as by CAD."""

WITHIN_M = 30.0
"""LiDARs are spoofed to show a false object that is so near."""

NEAR_OBJECT_M = 2.5

_NS = 1_000_000_000

Floats = NDArray[np.float64]

Learned = tuple[ClaimTable, HonestModel]
"""What claims are worth and what honest agents report, from scenes of the study."""


@dataclass(frozen=True, slots=True)
class Link:
    """What happens to poses and reports on the way to the center.

    Attributes:
        pose_m, pose_deg: standard deviations of each axis of a position and of a heading, new for each report.
        stated: whether reports state these, as the covariances of poses in messages do.
        late_s: reports of all agents but the first, in whose car the center is, are so old, and taken as if new.
        loss: probability that a report does not arrive.
    """

    pose_m: float = 0.0
    pose_deg: float = 0.0
    stated: bool = True
    late_s: float = 0.0
    loss: float = 0.0


LINKS = {
    "as it is": Link(),
    "poses .2 m and .5°": Link(pose_m=0.2, pose_deg=0.5),
    "the same, not stated": Link(pose_m=0.2, pose_deg=0.5, stated=False),
    "20 % lost": Link(loss=0.2),
    "poses and losses": Link(pose_m=0.2, pose_deg=0.5, loss=0.2),
    "200 ms late, taken as new": Link(late_s=0.2),
}

SPOOFED = {"": "by reports alone", "liar": "its own LiDAR spoofed as well", "honest": "an honest agent's LiDAR spoofed"}


def main() -> None:
    """Run what is not there, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.agent_links", description=__doc__)
    parser.add_argument("--study", type=Path, required=True, help="folder of viewshed study agents")
    parser.add_argument("--preset", default="small", help="of that study")
    parser.add_argument("--scenes", type=int, default=48, help="test scenes of it that are run")
    parser.add_argument("--spoofed", type=int, default=48, help="of them, those in which LiDARs are spoofed")
    parser.add_argument("--work", type=Path, default=Path("agent_links"), help="where runs are kept")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    chosen = parser.parse_args()
    store = ResultStore.open(chosen.study, AgentsPlan.load(chosen.preset))
    chosen.work.mkdir(parents=True, exist_ok=True)
    study = store.results("run")
    learned = (
        ClaimTable.from_json((chosen.study / CLAIMS).read_text("utf-8")),
        HonestModel.from_json((chosen.study / HONEST_MODEL).read_text("utf-8")),
    )
    found: dict[str, dict[int, list[Run]]] = {name: {} for name in (*LINKS, *SPOOFED)}
    for number in range(min(max(chosen.scenes, chosen.spoofed), store.plan.test)):
        scene = Scene.load(scene_path(store.folder, "test", number))
        seed = (store.plan.seed, "test", number)
        # Each scene is tried with nobody lying, and with two of the lies in turn.
        cases = (HONEST, CASES[number % len(CASES)], CASES[(number + 3) % len(CASES)])
        for name, link in LINKS.items() if number < chosen.scenes else ():
            path = chosen.work / f"{name.replace(' ', '_')}-{number:04d}.json"
            found[name][number] = kept(path, partial(run_cases, scene, cases, seed, learned, link, None))
        for who in SPOOFED if number < chosen.spoofed else ():
            path = chosen.work / f"spoofed_{who or 'nobody'}-{number:04d}.json"
            spoofing = Spoofing(store.plan, number, who)
            found[who][number] = kept(path, partial(run_cases, scene, ("fabricate",), seed, learned, Link(), spoofing))
        print(f"scene {number}", flush=True)
    scored = {name: scored_runs(store.plan, study, runs) for name, runs in found.items()}
    text = page_of(scored, AgentsResults(store.plan, study))
    chosen.page.write_text(text, encoding="utf-8")
    print(text)


def kept(path: Path, make: Callable[[], list[Run]]) -> list[Run]:
    """Return the runs in a file, made if it is not there."""
    if not path.exists():
        path.write_text(json.dumps([asdict(run) for run in make()]), encoding="utf-8")
    return [Run(**run) for run in json.loads(path.read_text(encoding="utf-8"))]


def scored_runs(plan: AgentsPlan, study: Results[AgentsPlan], runs: dict[int, list[Run]]) -> list[ScoredRun]:
    """Return runs with the scores that the study gives them: by its honest scenes."""
    facts_of = {key: value for key, value in study.facts.items() if key[:2] != ("run", "test")}
    ours = {("run", "test", str(number)): {"runs": [asdict(run) for run in each]} for number, each in runs.items()}
    return AgentsResults(plan, replace(study, facts=facts_of | ours)).scored("test")


@dataclass(frozen=True, slots=True)
class Spoofing:
    """A LiDAR that is spoofed to show the false object nearest to it: of the ``liar``, an ``honest`` agent or none."""

    plan: AgentsPlan
    number: int
    who: str

    def applied(
        self, reports: list[AgentReport], liars: Liars, time: int, rng: np.random.Generator
    ) -> list[AgentReport]:
        """Return the reports with that of the spoofed agent made from its spoofed sweep."""
        if not self.who or liars.places is None or not len(liars.places):
            return reports
        agents = liars.numbers if self.who == "liar" else [n for n in range(len(reports)) if n not in liars.numbers]
        away = {
            number: np.linalg.norm(liars.places[:, :2] - reports[number].world_from_level.translation[:2], axis=1)
            for number in agents
        }
        who = min(away, key=lambda number: float(away[number].min()))
        if away[who].min() > WITHIN_M:
            return reports
        plan, world = self.plan.scene("test", self.number), scene_world(self.plan, "test", self.number)
        sweep = scan_frame(plan, time * len(reports) + who, world=world)[1].sweep()
        sweep = with_car(sweep, liars.places[int(away[who].argmin())], rng)
        leveled = level(sweep, GRID)
        estimate = replace(load_estimator("shadow_map", grid=GRID).estimate(leveled), agent=reports[who].agent)
        seen = Detector().detect(leveled)
        if self.who == "liar":  # what it reports of the false objects stays
            seen = reports[who].detections
        return [replace(one, estimate=estimate, detections=seen) if n == who else one for n, one in enumerate(reports)]


def with_car(sweep: Sweep, place: Floats, rng: np.random.Generator) -> Sweep:
    """Return a sweep in which beams meet a car at x, y and yaw of the world."""
    assert sweep.world_from_sensor is not None
    x, y, _ = sweep.world_from_sensor.inverse() @ np.array([*place[:2], sweep.world_from_sensor.translation[2]])
    heading = place[2] - sweep.world_from_sensor.yaw - np.arctan2(y, x)
    turn = float((heading + np.pi) % (2 * np.pi) - np.pi)
    attack = GhostCar(range_m=float(np.hypot(x, y)), azimuth=float(np.arctan2(y, x)), heading=turn)
    return attack.apply(sweep, rng).sweep


def run_cases(
    scene: Scene, cases: Sequence[str], seed: tuple[int, str, int], learned: Learned, link: Link,
    spoofing: Spoofing | None,
) -> list[Run]:  # fmt: skip
    """Return what the cases of a scene come to over a link."""
    return [run_case(scene, case, seed, learned, link, spoofing) for case in cases]


def run_case(
    scene: Scene, case: str, seed: tuple[int, str, int], learned: Learned, link: Link, spoofing: Spoofing | None
) -> Run:
    """Return what a case of a scene comes to over a link; liars and lies are those of the study."""
    rng, noise = generator(*seed, case), generator(*seed, case, "link")
    order = [int(number) for number in rng.permutation(len(scene.agents))]
    lie = LIES.get(case)
    liars = None if lie is None else Liars(lie, tuple(order[: lie.liars]), -1, rng)
    radio = Radio(noise, RadioFaults(loss=link.loss, delay_s=link.late_s))
    here, ends = radio.join("center"), [radio.join(agent) for agent in scene.agents]
    center = CommandCenter(scene.agents, claims=learned[0], honest=learned[1])
    evidence, doubt, trust, suspects, checks = [], [], [], [], []
    for time, t_s in enumerate(scene.times_s.tolist()):
        reports = scene.reports(time)
        if liars is not None:
            reports = liars.forge(reports) if t_s >= ONSET_S else liars.look(reports)
            if spoofing is not None and t_s >= ONSET_S:
                reports = spoofing.applied(reports, liars, time, noise)
        reports = [
            changed(report, scene, time, link, noise, is_near=number == 0) for number, report in enumerate(reports)
        ]
        # What the radio carries is who speaks: the report itself is known here.
        for number, end in enumerate(ends):
            end.send(bytes([number]), round(t_s * _NS))
        arrived = {each.data[0] for each in here.take(round((t_s + link.late_s) * _NS) + 1)} | {0}
        picture = center.add(t_s, [reports[number] for number in sorted(arrived)])
        verdicts = picture.verdicts
        evidence.append(verdicts.evidence)
        doubt.append(verdicts.doubt)
        trust.append(verdicts.trust)
        suspects.append(verdicts.suspects)
        checks.append(picture.checks)
    return Run(
        case, list(liars.numbers) if liars else [], -1, _rounded(evidence), _rounded(doubt), _rounded(trust),
        _rounded(trust), np.array(suspects, int).tolist(), plain_checks(checks), {}, liars.touched if liars else [],
        -1.0,
    )  # fmt: skip


def changed(
    report: AgentReport, scene: Scene, time: int, link: Link, rng: np.random.Generator, *, is_near: bool
) -> AgentReport:
    """Return a report with a noisy pose, and where it comes late, of so long ago."""
    pose, found = report.world_from_level, report.detections
    if link.late_s and not is_near:
        # Boxes stand where their objects were then; objects that nobody knows rest.
        now, step_s = scene.objects[time], float(scene.times_s[1] - scene.times_s[0])
        before = scene.objects[max(time - 1, 0)]
        moved = (before[:, :2] - now[:, :2]) * (link.late_s / step_s)
        boxes = np.array(report.detections.moved(pose).boxes)
        away = np.linalg.norm(boxes[:, None, :2] - now[None, :, :2], axis=2)
        hit = away.min(axis=1, initial=np.inf) < NEAR_OBJECT_M
        boxes[hit, :2] += moved[away[hit].argmin(axis=1)]
        number = scene.agents.index(report.agent)
        back = scene.poses[max(time - 1, 0), number, :3, 3] - scene.poses[time, number, :3, 3]
        pose = Rigid(pose.rotation, pose.translation + back * (link.late_s / step_s))
        found = Detections(boxes, found.kinds, found.returns).moved(pose.inverse())
    if link.pose_m or link.pose_deg:
        step = rng.normal(0.0, link.pose_m, 3) * np.array([1.0, 1.0, 0.0])
        pose = Rigid(np.eye(3), step) @ pose @ Rigid.from_yaw(float(np.radians(rng.normal(0.0, link.pose_deg))))
    said = PoseStd(link.pose_m, float(np.radians(link.pose_deg))) if link.stated else PoseStd()
    estimate = replace(report.estimate, world_from_level=pose)
    return replace(report, estimate=estimate, detections=found, pose_std=said)


def _rounded(values: Any) -> Any:
    return np.round(np.array(values, np.float64), 4).tolist()


def auroc(bad: Floats, good: Floats) -> float:
    """Return the share of pairs in which the bad one scores higher, ties half."""
    return float(((bad[:, None] > good) + 0.5 * (bad[:, None] == good)).mean())


def page_of(scored: dict[str, list[ScoredRun]], study: AgentsResults) -> str:
    """Return the page."""
    benign = {name: [one for one in runs if one.run.case == HONEST] for name, runs in scored.items()}
    honest = {name: np.concatenate([one.score for one in runs]) for name, runs in benign.items() if runs}
    clear = next(iter(LINKS))

    def area(name: str, cases: Sequence[str], against: str) -> float:
        runs = [one for one in scored[name] if one.run.case in cases]
        scores = [one.score[one.run.liars] for one in runs]
        return auroc(np.concatenate(scores), honest[against]) if scores else float("nan")

    rows, means = [], {}
    for name in LINKS:
        accused = [float(study.accused(one).any()) for one in benign[name]]
        areas = [area(name, cases, name) for cases in (*GROUPS.values(), CASES)]
        means[name] = areas[-1]
        rows.append([
            name, *(f"{one:.3f}" for one in areas), f"{means[clear] - means[name]:+.3f}",
            share(accused, [1.0] * len(accused)),
        ])  # fmt: skip
    limit = float(np.quantile(honest[clear], 1.0 - FALSE_ALARMS))
    spoofed = []
    for who, words in SPOOFED.items():
        if not scored[who]:
            continue
        caught = [float((one.score[one.run.liars] > limit).any()) for one in scored[who]]
        accused = [float(np.delete(study.accused(one), one.run.liars).any()) for one in scored[who]]
        spoofed.append([
            words, f"{area(who, ('fabricate',), clear):.3f}", share(caught, [1.0] * len(caught)),
            share(accused, [1.0] * len(accused)),
        ])  # fmt: skip
    of_spoofed = (
        "## False objects, with LiDARs spoofed",
        f"""One of five reports three cars that are not there; from the same time on the LiDAR of the liar, or of the
honest agent that is nearest to one of them (within {WITHIN_M:g} m), is spoofed with the returns of a car at that place.
*Found*: the liar scores higher than 97 % of the honest agents of scenes without lies; to reach: ≥ .95 at 3 % false
alarms, CAD .915.""",
        table(["false objects", "AUROC", "found at 3 %", "honest ones accused"], spoofed),
    )
    scenes = len(benign[clear])
    return page(
        "Many agents with poor poses and poor links",
        facts(
            seed=str(study.plan.seed), scenes=f"{scenes} test scenes of the study, each with nobody lying and two lies"
        ),
        f"""{scenes} test scenes of the [study of many agents](agents.md): 4 cars and a mast, 8 s at 2 Hz; scores and
limits are the study's own, from scenes without these faults.""",
        "## Poses and links",
        f"""*Poses*: of each report anew, standard deviation of x, y and heading. *Lost*: at random, by the radio of
`viewshed.messages.transport`. Reports state these deviations, and the center puts poses right within them
(`viewshed.fusion.registration`); *not stated*: it takes poses as exact. Reports carry their times: a center that waits
200 ms puts late ones together by these, and the delay costs nothing but the wait. *Taken as new*: it does not, and all
reports but the first car's are of 200 ms ago. AUROC of a liar against honest agents with the same fault; over all lies
it is to lose ≤ .03, and an honest agent is to be accused (at {100 * study.rate:.3g} %, nobody lies) in ≤ .015 of the
scenes. In brackets 95 % intervals over scenes.""",
        table(["fault", *(f"lies about {name}" for name in GROUPS), "all", "loss", "honest accused"], rows),
        *(of_spoofed if spoofed else ()),
    )


if __name__ == "__main__":
    main()
