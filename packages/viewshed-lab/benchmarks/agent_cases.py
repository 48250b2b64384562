"""The four published cases and their Monte Carlo: ``python -m benchmarks.agent_cases [--scenes N] [--out FOLDER]``.

Four cars and a sensor on a mast report what they see; detections of one or two are forged as published: false objects
that stand, false objects that move, and objects moved, on the mast or on a car. Our trust beside the published one
(``viewshed.agents.mate``), on the same tracks, with exact truth. Writes a page and a picture for each case, and one for
the Monte Carlo. Scenes are kept in ``--work``: a run that was stopped goes on.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot
from numpy.typing import NDArray

from benchmarks.agent_scenes import share
from viewshed.agents.many import AgentReport, CommandCenter
from viewshed.agents.rounds import judged
from viewshed.arrays import F64
from viewshed.objects.detector import Detector
from viewshed.objects.metrics import gospa
from viewshed_lab._page import facts, page, table
from viewshed_lab.data.drive import drive_sweeps
from viewshed_lab.studies.agents.page import DISTRUSTED
from viewshed_lab.studies.agents.plan import AgentsPlan
from viewshed_lab.studies.agents.published import PublishedTrust
from viewshed_lab.studies.agents.runs import seen_objects
from viewshed_lab.studies.agents.scenes import MAST_M, PITCH_DEG, Scene, scene_world
from viewshed_lab.studies.cases import generator
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS, RunningAttack

SEED = 20_261_124
ONSET_S = 2.0
PLAN = replace(AgentsPlan.load("small"), tall_masts=1, seconds=12.0, seed=SEED)
MAST = PLAN.moving
"""Number of the agent on the mast."""

TEN = replace(PLAN, moving=9, seed=SEED + 1)
COUNTS = (2, 3, 5, 10)
"""Agents that report, the mast among them."""

DRAWS = 3
"""Monte Carlo runs of each scene."""

ON = 0.7
"""Probability that an agent is attacked at all in the Monte Carlo."""

FALSE_COST = 8.0
"""What a false track adds to GOSPA's sum: half the square of its cutoff of 4 m."""

OURS, MATE, NOBODY = "ours", "published", "no trust"

Attacked = Mapping[int, Sequence[RunningAttack]]


@dataclass(frozen=True, slots=True)
class Case:
    """One published case."""

    title: str  # of its page
    text: str  # what is forged
    attack: str  # of ``OBJECT_ATTACKS``
    count: int  # objects at a time
    agents: Callable[[list[int]], list[int]]  # who is attacked, from the cars of a scene in random order


CASES = {
    "case_static_ghosts": Case(
        "Case 1: false objects that stand, on one car",
        "The detector of one car reports two objects that are not there and do not move.",
        "fabricate_static", 2, lambda cars: cars[:1],
    ),
    "case_moving_ghosts": Case(
        "Case 2: false objects that move, on two cars",
        "The detectors of two cars report two objects each that are not there and walk at random, each car its own.",
        "fabricate_markov", 2, lambda cars: cars[:2],
    ),
    "case_mast_shifts": Case(
        "Case 3: moved objects, on the mast",
        "The detector of the mast reports three objects 2 to 6 m from where they are.",
        "translate_static", 3, lambda cars: [MAST],
    ),
    "case_car_shifts": Case(
        "Case 4: moved objects, on a car",
        "The detector of one car reports three objects 2 to 6 m from where they are.",
        "translate_static", 3, lambda cars: cars[:1],
    ),
}  # fmt: skip
"""By the name of its page."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What one run came to, of T times and A agents.

    Attributes:
        scene: its number.
        attacked: numbers of the agents.
        trust: (T, A) by ours and as published.
        accused, disputed: (A,) bool, by the shipped limits, at any time.
        gospa: (T,) meters by whose trust.
        false: (T,) tracks in the picture that are of no object, by whose trust.
        round_ms: median of the processor time that our center takes for the reports of one time.
    """

    scene: int
    attacked: tuple[int, ...]
    trust: dict[str, F64]
    accused: NDArray[np.bool_]
    disputed: NDArray[np.bool_]
    gospa: dict[str, F64]
    false: dict[str, F64]
    round_ms: float = float("nan")

    @property
    def honest(self) -> list[int]:
        """Numbers of the agents that nobody attacked."""
        return [number for number in range(len(self.accused)) if number not in self.attacked]

    def lowest(self, name: str) -> F64:
        """Return the lowest trust (A,) after the onset."""
        return np.asarray(self.trust[name][_after()].min(axis=0))


def _after() -> slice:
    return slice(round(ONSET_S * PLAN.hz), None)


def main() -> None:
    """Simulate what is not there, run all cases and write the pages."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.agent_cases", description=__doc__)
    parser.add_argument("--scenes", type=int, default=12, help="worlds, each from a seed of its own")
    parser.add_argument("--ten", type=int, default=4, help="worlds with ten agents")
    parser.add_argument("--work", type=Path, help="where scenes are kept; a new folder if not given")
    parser.add_argument("--out", type=Path, default=Path("cases"), help="where the pages go")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        work: Path = chosen.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        found: dict[str, list[Outcome]] = {name: [] for name in (*CASES, "case_monte_carlo")}
        by_count: dict[int, list[Outcome]] = {count: [] for count in COUNTS}
        for number in range(chosen.scenes):
            scene = scene_of(number, work)
            for name, case in CASES.items():
                rng = generator(SEED, name, number)
                cars = [int(car) for car in rng.permutation(MAST)]
                attack = OBJECT_ATTACKS[case.attack](counts="exact", mean_count=float(case.count), start_s=ONSET_S)
                attacked = {agent: [attack.begin(rng)] for agent in case.agents(cars)}
                found[name].append(run(number, scene, attacked))
            for draw in range(DRAWS):
                found["case_monte_carlo"].append(
                    run(number, scene, drawn(generator(SEED, "monte carlo", number, draw)))
                )
            for count in COUNTS[:-1]:
                by_count[count].append(run_some(number, scene, count))
            print(f"scene {number} of {chosen.scenes}", flush=True)
        for number in range(chosen.ten):
            by_count[10].append(run_some(number, scene_of(number, work, TEN), 10))
            print(f"scene {number} of {chosen.ten} with ten agents", flush=True)
    chosen.out.mkdir(parents=True, exist_ok=True)
    for name, case in CASES.items():
        draw_trust(found[name], chosen.out / f"{name}.png")
        (chosen.out / f"{name}.md").write_text(page_of(name, case, found[name]), encoding="utf-8")
    (chosen.out / "case_monte_carlo.md").write_text(
        monte_carlo_page(found["case_monte_carlo"], by_count), encoding="utf-8"
    )


def scene_of(number: int, work: Path, study: AgentsPlan = PLAN) -> Scene:
    """Return a scene with a mast as published, simulated where it is not there."""
    path = work / (f"case-{number:03d}.npz" if study is PLAN else f"case-{study.moving}-{number:03d}.npz")
    if not path.exists():
        plan = study.scene("test", number)
        sweeps = drive_sweeps(plan, scene_world(study, "test", number))
        Scene.simulate(plan, Detector(), sweeps).save(path)
    return Scene.load(path)


def run_some(number: int, scene: Scene, count: int) -> Outcome:
    """Return what becomes of the first case where ``count`` agents report: the attacked car, others, and the mast."""
    rng = generator(SEED, "count", number)
    cars = [int(car) for car in rng.permutation(len(scene.agents) - 1)]
    attack = OBJECT_ATTACKS["fabricate_static"](counts="exact", mean_count=2.0, start_s=ONSET_S)
    some = only(scene, [*cars[: count - 1], len(scene.agents) - 1])
    return run(number, some, {0: [attack.begin(rng)]})


def only(scene: Scene, agents: Sequence[int]) -> Scene:
    """Return a scene in which only some of the agents report, in a new order."""
    keep, at = list(agents), scene.found_at
    rows = np.isin(at[:, 1], keep)
    numbers = [keep.index(number) for number in at[rows, 1].tolist()]
    return replace(
        scene, prob=scene.prob[:, keep], state=scene.state[:, keep], poses=scene.poses[:, keep],
        bases=[[of_time[number] for number in keep] for of_time in scene.bases], found=scene.found[rows],
        found_at=np.column_stack([at[rows, 0], np.array(numbers, np.int16)]), returns=scene.returns[:, keep],
        carriers=scene.carriers[keep],
    )  # fmt: skip


def drawn(rng: np.random.Generator) -> dict[int, list[RunningAttack]]:
    """Return the attack of a Monte Carlo run: one car, 0 to 4 false and 0 to 4 missing objects, at all in 7 of 10."""
    agent, fabricated, removed = (int(rng.integers(high)) for high in (MAST, 5, 5))
    if rng.random() >= ON:
        return {}
    counts = {"fabricate_static": fabricated, "remove_static": removed}
    attacks = [
        OBJECT_ATTACKS[name](counts="exact", mean_count=float(count), start_s=ONSET_S).begin(rng)
        for name, count in counts.items() if count
    ]  # fmt: skip
    return {agent: attacks} if attacks else {}


def run(number: int, scene: Scene, attacked: Attacked) -> Outcome:
    """Return what becomes of a scene whose agents are attacked."""
    centers = {OURS: CommandCenter(scene.agents), NOBODY: CommandCenter(scene.agents, trusting=True)}
    published = PublishedTrust()
    trust: dict[str, list[F64]] = {OURS: [], MATE: []}
    distance, false = ({name: list[float]() for name in (OURS, MATE, NOBODY)} for _ in range(2))
    accused, disputed = (np.zeros(len(scene.agents), np.bool_) for _ in range(2))
    round_s: list[float] = []
    for time, t_s in enumerate(scene.times_s.tolist()):
        reports = [forged(report, attacked.get(agent, ()), t_s) for agent, report in enumerate(scene.reports(time))]
        pictures = {NOBODY: centers[NOBODY].add(t_s, reports)}
        began_s = process_time()
        pictures[OURS] = centers[OURS].add(t_s, reports)
        round_s.append(process_time() - began_s)
        of_agents, believed = published.add(pictures[NOBODY], reports)
        trust[MATE].append(of_agents)
        trust[OURS].append(pictures[OURS].verdicts.trust)
        now_accused, now_disputed = judged(pictures[OURS])
        accused, disputed = accused | now_accused, disputed | now_disputed
        shown = {
            OURS: pictures[OURS].tracks.boxes[pictures[OURS].believed],
            MATE: pictures[NOBODY].tracks.boxes[believed],
            NOBODY: pictures[NOBODY].tracks.boxes[pictures[NOBODY].tracks.confirmed],
        }
        truth = seen_objects(scene, time)[:, :2]
        for name, boxes in shown.items():
            apart = gospa(boxes[:, :2], truth)
            distance[name].append(apart.distance_m)
            false[name].append(apart.false / FALSE_COST)
    return Outcome(
        number, tuple(attacked), {name: np.array(rows) for name, rows in trust.items()}, accused, disputed,
        {name: np.array(row) for name, row in distance.items()}, {name: np.array(row) for name, row in false.items()},
        1e3 * float(np.median(round_s)),
    )  # fmt: skip


def forged(report: AgentReport, attacks: Sequence[RunningAttack], t_s: float) -> AgentReport:
    """Return a report with its detections forged, in the world and back."""
    pose, found = report.world_from_level, report.detections
    for attack in attacks:
        found = attack.apply(found.moved(pose), t_s, pose.translation).detections.moved(pose.inverse())
    return replace(report, detections=found)


def auroc(outcomes: Sequence[Outcome], name: str) -> float:
    """Return the share of pairs of an attacked and an honest agent in which the attacked one is trusted less."""
    bad = np.concatenate([one.lowest(name)[list(one.attacked)] for one in outcomes])
    good = np.concatenate([one.lowest(name)[one.honest] for one in outcomes])
    return float(((bad[:, None] < good) + 0.5 * (bad[:, None] == good)).mean())


def rows_of(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """Return the rows that compare ours, the published trust and none."""
    after = _after()

    def shares(pick: Callable[[Outcome], float], whole: Callable[[Outcome], float]) -> str:
        return share(*by_scene(outcomes, pick, whole))

    def below(name: str, who: Callable[[Outcome], Sequence[int]]) -> str:
        return shares(
            lambda one: float((one.lowest(name)[list(who(one))] < DISTRUSTED).sum()), lambda one: float(len(who(one)))
        )

    some = [one for one in outcomes if one.attacked]
    rows = [
        ["AUROC of the lowest trust", f"{auroc(some, OURS):.3f}", f"{auroc(some, MATE):.3f}", "–"],
        [
            f"attacked agents whose trust falls below {DISTRUSTED:g}",
            below(OURS, lambda one: one.attacked), below(MATE, lambda one: one.attacked), "–",
        ],
        [
            f"honest agents whose trust falls below {DISTRUSTED:g}",
            below(OURS, lambda one: one.honest), below(MATE, lambda one: one.honest), "–",
        ],
        [
            "attacked agents accused",
            shares(lambda one: float(one.accused[list(one.attacked)].sum()), lambda one: float(len(one.attacked))),
            "–", "–",
        ],
        [
            "honest agents accused",
            shares(lambda one: float(one.accused[one.honest].sum()), lambda one: float(len(one.honest))), "–", "–",
        ],
    ]  # fmt: skip
    for words, values in (("GOSPA, m", "gospa"), ("false tracks in the picture", "false")):
        rows.append([
            words,
            *(f"{np.mean([getattr(one, values)[name][after].mean() for one in outcomes]):.2f}"
              for name in (OURS, MATE, NOBODY)),
        ])  # fmt: skip
    return rows


def by_scene(
    outcomes: Sequence[Outcome], part: Callable[[Outcome], float], whole: Callable[[Outcome], float]
) -> tuple[list[float], list[float]]:
    """Return sums of two values over the runs of each scene."""
    scenes = sorted({one.scene for one in outcomes})
    together = [[one for one in outcomes if one.scene == scene] for scene in scenes]
    return [sum(map(part, runs)) for runs in together], [sum(map(whole, runs)) for runs in together]


HEADER = ("", "ours", "published", "no trust")

ABOUT = f"""{PLAN.moving} cars and a sensor on a mast ({MAST_M:g} m, pitched {PITCH_DEG:g}° down, as published) at a
junction, in a street or in a car park, {PLAN.seconds:g} s at {PLAN.hz:g} Hz; forged from {ONSET_S:g} s on. Every sweep
is simulated, estimated by the default method and searched by our detector. The published trust gets the same tracks
and the mask of the same estimate as its polygon; it begins at .5, and drops tracks below .4. In brackets 95 % intervals
over scenes."""


def page_of(name: str, case: Case, outcomes: list[Outcome]) -> str:
    """Return the page of a case."""
    rows = rows_of(outcomes)
    return page(
        case.title,
        facts(seed=str(SEED), scenes=str(len(outcomes)), runs="one a scene"),
        case.text,
        f"![Trust in attacked and honest agents over time]({name}.png)",
        "Median and middle 90 % over scenes; what is forged begins at the dashed line.",
        "## Trust and picture",
        table(HEADER, rows),
        "## What was run",
        ABOUT,
        LIMITS,
    )


LIMITS = """False objects lie anywhere about their car, as published: one that no other agent could see contradicts
nobody, and cannot be found. Our detector errs as well, and its errors look like small lies: see
[many agents](agents.md)."""


def count_rows(by_count: Mapping[int, list[Outcome]]) -> list[list[str]]:
    """Return a row for each number of agents."""

    def shares(outcomes: list[Outcome], name: str, *, honest: bool) -> str:
        def who(one: Outcome) -> list[int]:
            return one.honest if honest else list(one.attacked)

        return share(
            *by_scene(outcomes, lambda one: float(getattr(one, name)[who(one)].sum()), lambda one: float(len(who(one))))
        )

    return [
        [
            str(count), f"{auroc(outcomes, OURS):.3f}", f"{auroc(outcomes, MATE):.3f}",
            shares(outcomes, "accused", honest=False), shares(outcomes, "disputed", honest=False),
            shares(outcomes, "accused", honest=True), shares(outcomes, "disputed", honest=True),
            f"{np.median([one.round_ms for one in outcomes]):.1f}", str(len(outcomes)),
        ]
        for count, outcomes in by_count.items() if outcomes
    ]  # fmt: skip


COUNT_HEADER = (
    "agents", "AUROC, ours", "AUROC, published", "attacked accused", "attacked disputed", "honest accused",
    "honest disputed", "a round, ms", "scenes",
)  # fmt: skip


def monte_carlo_page(outcomes: list[Outcome], by_count: Mapping[int, list[Outcome]]) -> str:
    """Return the page of the Monte Carlo."""
    rows, some = rows_of(outcomes), [one for one in outcomes if one.attacked]
    return page(
        "The published cases: Monte Carlo",
        facts(seed=str(SEED), scenes=str(len({one.scene for one in outcomes})), runs=f"{DRAWS} a scene"),
        f"""In each run one of the cars is drawn, with 0 to 4 false objects and 0 to 4 missing ones, and with
probability {ON:g} that it is attacked at all: {len(some)} of {len(outcomes)} runs.""",
        "## Trust and picture",
        table(HEADER, rows),
        "## By the number of agents",
        """The first case, two false objects that stand on one car, where fewer or more agents report; the mast is
always one of them. With two it is word against word: what is doubted is what the model of honest errors makes
unlikely. *A round*: what the center takes for the reports of one time, on one core, with the check of one claimed view;
to be ≤ 20 ms with ten agents.""",
        table(COUNT_HEADER, count_rows(by_count)),
        "## What was run",
        ABOUT,
        LIMITS,
    )


def draw_trust(outcomes: Sequence[Outcome], path: Path) -> None:
    """Draw the trust in attacked and honest agents over time, ours beside the published one."""
    mpl.use("Agg")
    figure, axes = pyplot.subplots(1, 2, figsize=(8.4, 2.8), dpi=100, layout="constrained", sharey=True)
    times_s = (np.arange(len(outcomes[0].trust[OURS])) + 0.5) / PLAN.hz
    for axis, name in zip(axes, (OURS, MATE), strict=True):
        groups = (
            ("honest", "#0072b2", [one.trust[name][:, one.honest] for one in outcomes]),
            ("attacked", "#d55e00", [one.trust[name][:, list(one.attacked)] for one in outcomes]),
        )
        for word, color, values in groups:
            low, middle, high = np.quantile(np.concatenate(values, axis=1), (0.05, 0.5, 0.95), axis=1)
            axis.fill_between(times_s, low, high, color=color, alpha=0.2, linewidth=0)
            axis.plot(times_s, middle, color=color, label=word)
        axis.axvline(ONSET_S, color="#888888", linestyle="--", linewidth=0.8)
        axis.set(title=f"trust, {name}", xlabel="seconds", ylim=(0, 1.02), xlim=(0, PLAN.seconds))
    axes[0].legend(frameon=False, loc="lower left")
    figure.savefig(path, metadata={"Software": ""})
    pyplot.close(figure)


if __name__ == "__main__":
    main()
