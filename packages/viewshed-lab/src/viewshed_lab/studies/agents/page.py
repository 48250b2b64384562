"""The page of the study of many agents: detection of liars, false accusations, and the gain of the common picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from time import thread_time_ns
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.honest import HonestModel
from viewshed.agents.many import CommandCenter
from viewshed.agents.rounds import FALSE_RATE, Round
from viewshed.agents.trust import QUESTIONS, TrustLimits
from viewshed.arrays import F64, Mask
from viewshed.monitor.roc import auroc
from viewshed.show.fused import fused_strip
from viewshed_lab._page import facts
from viewshed_lab.studies.agents.lies import LIES
from viewshed_lab.studies.agents.plan import HONEST, HONEST_MODEL, ONSET_S, STATED, UNSTATED, AgentsPlan
from viewshed_lab.studies.agents.runs import Run, SceneCases
from viewshed_lab.studies.agents.scenes import MAST_M, PITCH_DEG, Scene, scene_path
from viewshed_lab.studies.formatting import commits, format_rate, format_share, mean
from viewshed_lab.studies.pages import Picture, Table, fill_template
from viewshed_lab.studies.records import Results
from viewshed_lab.studies.store import ResultStore

TRUST_BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
"""Bin edges of the reliability table."""

GROUPS = {
    "fabricated": ("fabricate", "fabricate_spoofed", "fabricate_together"),
    "moved": ("translate", "translate_spoofed", "translate_together"),
    "pose": ("shifted_pose", "turned_pose"),
    "removed": ("remove", "remove_spoofed", "remove_together"),
    "stale": ("stale",),
    "over-claim": ("over_claim",),
}
"""Lies by heading of the targets."""

WITNESSED, WITNESS_BINS = ("removed", "moved"), (0.0, 0.5, 1.5, np.inf)
"""Headings of lies about real objects; bin edges of the mean number of honest agents that report such an object."""

SHOWN = "fabricate"
"""The lie of the picture."""

TARGETS = {"fabricated": 0.97, "moved": 0.96, "pose": 0.94, "removed": 0.90, "stale": 0.88, "over-claim": 0.85}
"""Target AUROC by heading."""

ROUND_MS = 8
"""Target time of a round of five agents in milliseconds."""


@dataclass(frozen=True, eq=False)
class AgentsResults:
    """Runs of a study, with their tables and pictures."""

    plan: AgentsPlan  # of the study
    results: Results[AgentsPlan]  # of its runs
    round_ms: list[float] = field(default_factory=list)  # CPU time of each round of the pictures

    def runs(self, split: str) -> list[Run]:
        """Return the runs of a split, in the order of their scenes."""
        keys = sorted((int(key[2]), key) for key in self.results.facts if key[:2] == ("run", split))
        return [Run(**run) for _, key in keys for run in self.results.facts[key]["runs"]]

    @property
    def elevated(self) -> Mask:
        """Mask (A,) of the agents on masts."""
        return np.arange(self.plan.moving + self.plan.roadside) >= self.plan.moving

    @cached_property
    def limits(self) -> TrustLimits:
        """Limits of accusation, from the maximum evidence against each agent in each calibration scene."""
        benign = self.runs("calibration")
        answers = np.array([np.max(run.answers, axis=0) for run in benign])
        return TrustLimits.of(answers, self.elevated, np.array([max(run.doubt) for run in benign]))

    @property
    def rate(self) -> float:
        """Target rate of benign scenes with an accused agent; at least the rate that the calibration can support."""
        return max(FALSE_RATE, self.limits.least_rate)

    def accused(self, run: Run, until: int | None = None) -> Mask:
        """Return the mask (A,) of agents accused in a run at ``rate``, optionally up to a time index."""
        return self.limits.accused(np.max(run.answers[:until], axis=0), self.elevated, self.rate)

    @cached_property
    def test(self) -> list[Run]:
        """Runs of the test scenes."""
        return self.runs("test")

    def of(self, *cases: str, counting: bool = True) -> list[Run]:
        """Return the test runs of cases; with ``counting`` only lies that changed something for at least a second."""
        runs = [run for run in self.test if run.case in cases]
        return [run for run in runs if run.case not in LIES or not counting or _counts(run, self.plan)]

    def benign_table(self) -> Table:
        """Return the table of the cases without lies."""
        rows = []
        for case in (HONEST, STATED, UNSTATED):
            runs = self.of(case)
            lowest = np.array([np.min(run.trust, axis=0) for run in runs])
            centers = ("ours", "no trust", "all tracks")
            ours, other, every = (mean(_gospa(run, name) for run in runs) for name in centers)
            rows.append([
                case, str(len(runs)), format_share([bool(self.accused(run).any()) for run in runs], "wilson"),
                format_rate(float((lowest < 0.5).mean())), f"{ours:.2f} m", f"{other:.2f} m", f"{every:.2f} m",
            ])  # fmt: skip
        header = (
            "nobody lies", "scenes", "of these with somebody accused", "agents ever trusted less than .5", "GOSPA",
            "of no trust", "of no trust, with tracks out of sight",
        )  # fmt: skip
        return Table(header, rows)

    def found_table(self) -> Table:
        """Return the table of detection rates by lie, ours and those of the published trust."""
        rows = []
        for name in self.plan.lies:
            runs = self.of(name)
            if not runs:
                continue
            accused = [self.accused(run) for run in runs]
            liars = [run.liars for run in runs]
            caught = [float(mask[who].mean()) for mask, who in zip(accused, liars, strict=True)]
            honest = [bool(np.delete(mask, who).any()) for mask, who in zip(accused, liars, strict=True)]
            victims = [bool(mask[run.victim]) for mask, run in zip(accused, runs, strict=True) if run.victim >= 0]
            trust = np.concatenate([np.array(run.trust)[-1][run.liars] for run in runs])
            ratio, published = (
                mean(_gospa(run, center) for run in runs) / mean(_gospa(run, "no trust") for run in runs)
                for center in ("ours", "published")
            )
            delay_s = float(np.median([self.delay_s(run) for run in runs]))
            delay = f"{delay_s:g}" if np.isfinite(delay_s) else "–"
            rows.append([
                name, str(len(runs[0].liars)), format_rate(self.area(runs)), format_rate(_published_area(runs, self)),
                format_rate(mean(caught)), format_share(honest, "wilson"), format_share(victims, "wilson"), delay,
                format_rate(float((trust < 0.5).mean())), f"{ratio:.2f} / {published:.2f}",
                f"{len(runs)} of {len(self.of(name, counting=False))}",
            ])  # fmt: skip
        header = (
            "lie", "liars", "AUROC", "of the published trust", f"accused at {100 * self.rate:.3g} %",
            "honest ones accused", "victim accused", "delay s", "trusted less than .5",
            "GOSPA of no trust, ours / published", "runs that count",
        )  # fmt: skip
        return Table(header, rows)

    def area(self, runs: Sequence[Run], questions: Sequence[str] = QUESTIONS) -> float:
        """Return the AUROC of the scores: liars against the agents of honest scenes."""
        honest = np.concatenate([self._scores(run, questions) for run in self.of(HONEST)])
        liars = np.concatenate([self._scores(run, questions)[run.liars] for run in runs])
        return auroc(honest, liars)

    def _scores(self, run: Run, questions: Sequence[str]) -> F64:
        """Return the score (A,) of each agent by some questions, on the scale of agents of its kind."""
        answers = np.where(np.isin(QUESTIONS, questions), np.max(run.answers, axis=0), -np.inf)
        return self.limits.scores(answers, self.elevated)

    def questions_table(self) -> Table:
        """Return the table of AUROC by group of lies with all questions, with each one left out, and with one alone."""
        groups = {name: runs for name, lies in GROUPS.items() if (runs := self.of(*lies))}
        subsets: dict[str, tuple[str, ...]] = {"all": QUESTIONS}
        subsets |= {f"without {name}": tuple(other for other in QUESTIONS if other != name) for name in QUESTIONS}
        subsets |= {f"{name} alone": (name,) for name in QUESTIONS}
        rows = [
            [label, *(format_rate(self.area(runs, subset)) for runs in groups.values())]
            for label, subset in subsets.items()
        ]
        return Table(("questions", *groups), rows)

    def witnesses_table(self) -> Table:
        """Return the table of AUROC of removed and moved objects, by the number of honest agents that report them."""
        rows = []
        for name in WITNESSED:
            runs = self.of(*GROUPS[name])
            if not runs:
                continue
            max_witnesses = np.array([max(run.witnesses, default=0.0) for run in runs])
            witnesses = np.concatenate([run.witnesses for run in runs])
            for low, high in pairwise(WITNESS_BINS):
                in_bin = [run for run, count in zip(runs, max_witnesses, strict=True) if low <= count < high]
                share = float(((witnesses >= low) & (witnesses < high)).mean())
                words = f"{low:g} or more" if np.isinf(high) else f"{low:g} to {high:g}"
                area = self.area(in_bin) if in_bin else float("nan")
                rows.append([name, words, format_rate(share), str(len(in_bin)), format_rate(area)])
        header = ("lie", "honest agents that report the object", "share of the objects", "runs by their best", "AUROC")
        return Table(header, rows)

    def picture(self, folder: Path, case: str) -> Picture:
        """Return the picture of the first test scene: before the onset, at the first accusation, at the end."""
        honest = HonestModel.from_json((folder / HONEST_MODEL).read_text("utf-8"))
        scene = Scene.load(scene_path(folder, "test", 0))
        liars, said = SceneCases(scene, (self.plan.seed, "test", 0), honest, compared=False).said(case)
        center, rounds = CommandCenter(scene.agents, honest=honest), list[Round]()
        for t_s, reports in zip(scene.times_s.tolist(), said, strict=True):
            begun_ns = thread_time_ns()
            now = center.add(t_s, reports)
            self.round_ms.append((thread_time_ns() - begun_ns) / 1e6)
            accused = self.limits.accused(now.verdicts.answers, now.elevated, self.rate)
            rounds.append(Round(now, accused, self.limits.disputed(now.verdicts, accused, self.rate)))
        onset = int(np.searchsorted(scene.times_s, ONSET_S))
        middle = (onset + len(rounds)) // 2
        first = next((number for number, done in enumerate(rounds) if done.accused.any()), middle)
        shown = [rounds[number] for number in sorted({max(onset - 1, 0), first, len(rounds) - 1})]
        who = ", ".join(scene.agents[number] for number in liars.numbers) if liars else "nobody"
        times = ", ".join(f"{done.picture.t_s:.2f}" for done in shown)
        alt = f"{self.plan.test_worlds[0]} at {times} s, {who} lies: agents by trust, objects by belief"
        return Picture(f"agents_{case}.png", fused_strip(shown), alt)

    def delay_s(self, run: Run) -> float:
        """Return the seconds from the onset until a liar is accused; infinite if none ever is."""
        for time in range(len(run.answers)):
            t_s = (time + 0.5) / self.plan.hz
            if t_s >= ONSET_S and self.accused(run, time + 1)[run.liars].any():
                return t_s - ONSET_S
        return float("inf")

    def reliability_table(self) -> Table:
        """Return the table of the share of honest agents, by the trust in them at the end of all test runs."""
        trust, honest = list[float](), list[bool]()
        for run in self.test:
            trust += run.trust[-1]
            honest += [number not in run.liars for number in range(len(run.trust[-1]))]
        bins, flags = np.digitize(trust, TRUST_BINS[1:-1]), np.array(honest)
        rows = [
            [f"{low:g} to {high:g}", str(int((bins == k).sum())), format_rate(float(flags[bins == k].mean()))]
            for k, (low, high) in enumerate(pairwise(TRUST_BINS)) if (bins == k).any()
        ]  # fmt: skip
        return Table(("trust at the end", "agents", "honest"), rows)

    def target_table(self) -> Table:
        """Return the table of targets and reached figures; cases without runs are left out."""
        lied = self.of(*LIES)
        alone = [run for run in lied if LIES[run.case].about == "objects" and "stealthy" not in run.case]
        benign, stated, unstated = (
            mean(float(self.accused(run).any()) for run in self.of(case)) for case in (HONEST, STATED, UNSTATED)
        )
        rows: list[tuple[str, float, bool, float]] = [
            ("scenes with somebody accused, nobody lies", 0.01, True, benign),
            ("the same, poses off by .2 m and .5°, stated", 0.01, True, stated),
            ("the same, not stated", 0.05, True, unstated),
            *((f"AUROC, {name}", TARGETS[name], False, self.area(runs))
              for name, lies in GROUPS.items() if (runs := self.of(*lies))),
        ]  # fmt: skip
        if alone:
            delays = np.array([self.delay_s(run) for run in alone])
            caught = mean(float(self.accused(run)[run.liars].mean()) for run in alone)
            others = mean(float(np.delete(self.accused(run), run.liars).any()) for run in lied)
            rows += [
                (f"one of five lies about objects, accused at {100 * self.rate:.3g} %", 0.85, False, caught),
                ("seconds until then, median", 2.0, True, float(np.median(delays))),
                ("runs with an honest agent accused, others lie", 0.01, True, others),
            ]
        lines = []
        for what, bound, below, figure in rows:
            met = figure <= bound if below else figure >= bound
            word = "met" if met else "missed"
            lines.append([what, f"{'≤' if below else '≥'} {bound:g}", format_rate(figure, 3), word])
        scenes, target = self.plan.test, AgentsPlan.load("full").test
        lines.append(["scenes reported on", f"≥ {target}", str(scenes), "met" if scenes >= target else "missed"])
        if over := self.of("over_claim"):
            trust = np.concatenate([np.array(run.trust)[-1][run.liars] for run in over])
            lines.append(["over-claimers trusted less than .5", "–", format_rate(float((trust < 0.5).mean())), ""])
        return Table(("what", "target", "reached", ""), lines)

    def times_table(self) -> Table:
        """Return the table of the time of a round and its target, from the rounds of the pictures."""
        median_ms, agents = float(np.median(self.round_ms)), self.plan.moving + self.plan.roadside
        word = "met" if median_ms <= ROUND_MS else "missed"
        row = [f"a round of {agents} agents", f"≤ {ROUND_MS:g}", f"{median_ms:.0f}, {word}", str(len(self.round_ms))]
        return Table(("on one core", "target, ms", "median, ms", "rounds"), [row])


def _counts(run: Run, plan: AgentsPlan) -> bool:
    """Return whether the liars changed an object, or 5 % of the area, for at least a second."""
    minimum = 0.05 if LIES[run.case].about == "view" else 1.0
    return sum(value >= minimum for value in run.touched) / plan.hz >= 1.0


def _published_area(runs: Sequence[Run], results: AgentsResults) -> float:
    """Return the AUROC of the lowest published trust after the onset."""
    onset = round(ONSET_S * results.plan.hz)
    honest = np.concatenate([-np.min(run.published_trust[onset:], axis=0) for run in results.of(HONEST)])
    liars = np.concatenate([-np.min(run.published_trust[onset:], axis=0)[run.liars] for run in runs])
    return auroc(honest, liars)


def _gospa(run: Run, center: str) -> float:
    values: NDArray[Any] = np.array(run.gospa[center])
    return float(values[len(values) // 4 :].mean())


def files_of(store: ResultStore[AgentsPlan]) -> dict[str, bytes]:
    """Return the page and its pictures by file name.

    Raises:
        ValueError: there are no runs.
    """
    plan, results = store.plan, store.results("run")
    if not results.facts:
        raise ValueError(f"{store.folder} must hold runs, got none; run the steps scenes and runs")
    found = AgentsResults(plan, results)
    values: dict[str, Any] = {
        "agents": plan.moving + plan.roadside, "moving": plan.moving, "roadside": plan.roadside,
        "rate": f"{100 * found.rate:.3g}", "seconds": f"{plan.seconds:g}", "hz": f"{plan.hz:g}",
        "onset": f"{ONSET_S:g}", "tall": plan.tall_masts, "mast": f"{MAST_M:g}", "pitch": f"{PITCH_DEG:g}",
        "heights": ", ".join(f"{height:g}" for height in plan.heights_m),
        "worlds": ", ".join(dict.fromkeys(plan.worlds)), "test_worlds": ", ".join(plan.test_worlds),
    }  # fmt: skip
    pictures = [found.picture(store.folder, case) for case in (HONEST, SHOWN)]
    page = fill_template("agents/page.md", results=found, pictures=pictures, **values)
    scenes = f"{plan.learning} learning, {plan.calibration} calibration, {plan.test} test"
    about = facts(
        plan=f"{plan.name}: {plan.about}", seed=str(plan.seed),
        sensors=f"{', '.join(plan.sensors)}; tested with {', '.join(plan.test_sensors)}", scenes=scenes,
        commits=commits(results),
    )  # fmt: skip
    return page.files("agents.md", about)
