"""The page of the study: who is found, who is accused wrongly, and what the common picture gains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from viewshed.agents.suspicion import Suspicion
from viewshed.agents.trust import TrustLimits, Verdicts
from viewshed.agents.view_checks import VIEW_CHECKS
from viewshed.arrays import F64
from viewshed_lab._page import facts
from viewshed_lab.studies.agents.jobs import EXPECTED
from viewshed_lab.studies.agents.lies import LIES
from viewshed_lab.studies.agents.plan import HONEST, ONSET_S, AgentsPlan
from viewshed_lab.studies.agents.runs import Run
from viewshed_lab.studies.agents.scenes import MAST_M, PITCH_DEG
from viewshed_lab.studies.formatting import commits, format_interval, format_rate, mean
from viewshed_lab.studies.pages import Table, fill_template
from viewshed_lab.studies.records import Results
from viewshed_lab.studies.store import ResultStore

RATE = 0.01
"""Share of benign scenes in which somebody may be accused; more where there are too few scenes for it."""

DISTRUSTED = 0.5
"""Whose trust falls below this at some time counts as distrusted."""

OVERLAPS = ((0.0, 0.5), (0.5, 1.5), (1.5, 2.5), (2.5, np.inf))
"""Numbers of other agents that see what was lied about, from and up to."""


@dataclass(frozen=True, slots=True, eq=False)
class ScoredRun:
    """A run with a score for each of A agents; larger is more suspicious."""

    scene: int  # number of the scene
    run: Run  # what it came to
    score: F64  # (A,) how suspicious it is by reports and view (``viewshed.agents.suspicion``), the most over time
    by_time: F64  # (T, A) the same at each time
    views: F64  # (A,) doubt of the view alone, the largest over time
    evidence: F64  # (A,) evidence of the reports alone, the largest over time


@dataclass(frozen=True, eq=False)
class AgentsResults:
    """Runs of a study, and what follows from them."""

    plan: AgentsPlan  # of the study
    results: Results[AgentsPlan]  # of its runs

    def runs(self, split: str) -> Iterator[tuple[int, Run]]:
        """Yield the runs of a split with the numbers of their scenes."""
        for key, found in sorted(self.results.facts.items()):
            if key[:2] == ("run", split):
                for run in found["runs"]:
                    yield int(key[2]), Run(**run)

    @property
    def elevated(self) -> NDArray[np.bool_]:
        """(A,) which agents stand on masts."""
        return np.arange(self.plan.moving + self.plan.roadside) >= self.plan.moving

    @cached_property
    def suspicion(self) -> Suspicion:
        """How rare evidence and checks of views are in the scenes of the first split."""
        runs = [run for _, run in self.runs("claims")]
        evidence, checks = (
            np.array([getattr(run, name) for run in runs], np.float64) for name in ("evidence", "checks")
        )
        return Suspicion.fit(evidence, checks, self.elevated)

    def scored(self, split: str) -> list[ScoredRun]:
        """Return the runs of a split with their scores."""
        out = []
        for scene, run in self.runs(split):
            evidence, checks = np.array(run.evidence), np.array(run.checks, np.float64)
            by_time = self.suspicion(evidence, checks, self.elevated)
            views = self.suspicion.doubt(checks, self.elevated)
            out.append(ScoredRun(scene, run, by_time.max(axis=0), by_time, views.max(axis=0), evidence.max(axis=0)))
        return out

    @cached_property
    def calibration(self) -> list[ScoredRun]:
        """Benign runs that limits are from."""
        return self.scored("calibration")

    @cached_property
    def test(self) -> list[ScoredRun]:
        """Runs that are reported on."""
        return self.scored("test")

    @cached_property
    def limits(self) -> TrustLimits:
        """Who is accused: limits of the most suspicious agent of each kind of each calibration scene."""
        scores = np.array([one.score for one in self.calibration])
        doubt = np.array([max(one.run.doubt) for one in self.calibration])
        return TrustLimits.of(scores[:, ~self.elevated].max(axis=1), scores[:, self.elevated].max(axis=1), doubt)

    @property
    def rate(self) -> float:
        """Share of benign scenes in which somebody may be accused, as far as the calibration scenes support it."""
        return max(RATE, self.limits.least_rate)

    def accused(self, one: ScoredRun) -> NDArray[np.bool_]:
        """Return who is accused (A,) in a run at ``rate``, at any time."""
        return self.limits.accused(one.score, self.elevated, self.rate)

    def disputed(self, one: ScoredRun) -> NDArray[np.bool_]:
        """Return who is disputed (A,) in a run at its end."""
        suspects, nothing = np.array(one.run.suspects[-1], np.bool_), np.zeros(0)
        verdicts = Verdicts(
            one.evidence, max(one.run.doubt), nothing, nothing.astype(np.int64), nothing, suspects, self.elevated
        )
        return self.limits.disputed(verdicts, self.accused(one), self.rate)

    @cached_property
    def benign(self) -> list[ScoredRun]:
        """Test scenes in which nobody lies."""
        return [one for one in self.test if one.run.case == HONEST]

    @cached_property
    def honest(self) -> list[ScoredRun]:
        """These, and the further scenes in which nobody lies."""
        return [*self.benign, *self.scored("benign")]

    def of(self, case: str, *, counting: bool = True) -> list[ScoredRun]:
        """Return the runs of a lie; those in which the liars changed something for a second, unless all are wanted."""
        runs = [one for one in self.test if one.run.case == case]
        return [one for one in runs if _counts(one.run, self.plan)] if counting else runs

    def benign_table(self) -> Table:
        """Return what happens where nobody lies."""
        accused = [bool(self.accused(one).any()) for one in self.honest]
        disputed = [bool(self.disputed(one).any()) for one in self.honest]
        distrusted = np.array([np.min(one.run.trust, axis=0) for one in self.honest]) < DISTRUSTED
        ours, other, every = (
            float(np.mean([_gospa(one, name) for one in self.benign])) for name in ("ours", "no trust", "all tracks")
        )
        rows = (
            ("scenes", str(len(accused))),
            ("of these with an honest agent accused", _share(accused)),
            ("with honest agents disputed", _share(disputed)),
            *(
                (f"{kind} ever trusted less than {DISTRUSTED:g}", format_rate(float(distrusted[:, mask].mean())))
                for kind, mask in (("vehicles", ~self.elevated), ("masts", self.elevated))
                if mask.any()
            ),
            ("GOSPA of the common picture, mean over times, in the scenes that are tried with lies", f"{ours:.2f} m"),
            ("the same where everybody is believed alike", f"{other:.2f} m"),
            ("ratio", f"{ours / other:.3f}"),
            ("where everybody is believed, with tracks that nobody reports now", f"{every:.2f} m"),
            ("ratio", f"{ours / every:.3f}"),
        )
        return Table(("where nobody lies", ""), rows)

    def found_table(self) -> Table:
        """Return for each lie what is found of it."""
        header = (
            "lie", "liars", "AUROC", "by reports", "by views", f"accused at {100 * self.rate:.3g} %", "disputed",
            "honest ones accused", "delay s", "GOSPA, of no trust", "scenes", "do not count",
        )  # fmt: skip
        return Table(header, [self._found(name) for name in self.plan.lies if self.of(name)])

    def _found(self, name: str) -> list[str]:
        runs, lie = self.of(name), LIES[name]
        liars = [[one.run.liars[0]] if not one.run.liars else one.run.liars for one in runs]
        accused = [self.accused(one) for one in runs]
        disputed = [self.disputed(one) for one in runs]
        honest = [
            bool(np.delete(mask, one.run.liars).any()) for mask, one in zip(accused, runs, strict=True)
        ]  # fmt: skip
        caught = [float(mask[who].mean()) for mask, who in zip(accused, liars, strict=True)]
        doubted = [float((mask[who]).mean()) for mask, who in zip(disputed, liars, strict=True)]
        delays = [self._delay_s(one) for one in runs]
        ratio = np.mean([_gospa(one, "ours") for one in runs]) / np.mean([_gospa(one, "no trust") for one in runs])
        total = len(self.of(name, counting=False))
        return [
            name, str(lie.liars), *(format_rate(self._area(runs, part)) for part in ("score", "evidence", "views")),
            format_rate(float(np.mean(caught))), format_rate(float(np.mean(doubted))), _share(honest),
            f"{np.median(delays):g}" if np.isfinite(np.median(delays)) else "–", f"{ratio:.2f}", str(len(runs)),
            str(total - len(runs)),
        ]  # fmt: skip

    def _area(self, runs: Sequence[ScoredRun], part: str) -> float:
        """Return the share of honest agents of benign scenes that score below liars, ties half."""
        benign = np.sort(np.concatenate([getattr(one, part) for one in self.honest]))
        values = np.concatenate([getattr(one, part)[one.run.liars] for one in runs])
        below = np.searchsorted(benign, values, "left") + np.searchsorted(benign, values, "right")
        return float((below / (2.0 * len(benign))).mean())

    def _at_3_percent(self, name: str) -> float:
        """Return the share of the liars of a lie that score above 97 % of the honest agents of the calibration."""
        limit = np.quantile(np.concatenate([one.score for one in self.calibration]), 0.97)
        return mean(float((one.score[one.run.liars] > limit).mean()) for one in self.of(name))

    def _delay_s(self, one: ScoredRun) -> float:
        """Return the seconds from the onset until a liar is accused; infinite where none ever is."""
        for time, score in enumerate(np.maximum.accumulate(one.by_time, axis=0)):
            t_s = (time + 0.5) / self.plan.hz
            if t_s >= ONSET_S and self.limits.accused(score, self.elevated, self.rate)[one.run.liars].any():
                return t_s - ONSET_S
        return float("inf")

    def flip_table(self) -> Table:
        """Return what becomes of the victims of those who want an honest agent expelled."""
        rows = []
        for name in self.plan.lies:
            runs = self.of(name) if LIES[name].flips else []
            if runs:
                victims = [bool(self.accused(one)[one.run.victim]) for one in runs]
                doubted = [bool(self.disputed(one)[one.run.victim]) for one in runs]
                caught = [bool(self.accused(one)[one.run.liars].any()) for one in runs]
                rows.append([name, _share(victims), _share(doubted), _share(caught), str(len(runs))])
        return Table(("lie", "victim accused", "victim disputed", "a liar accused", "scenes"), rows)

    def overlap_table(self) -> Table:
        """Return how lies about objects are found by how many other agents see what was lied about."""
        rows = []
        names = [name for name in self.plan.lies if LIES[name].about == "objects"]
        for low, high in OVERLAPS:
            runs = [one for name in names for one in self.of(name) if low <= one.run.overlap < high]
            if runs:
                caught = [bool(self.accused(one)[one.run.liars].any()) for one in runs]
                honest = [bool(np.delete(self.accused(one), one.run.liars).any()) for one in runs]
                disputed = [bool(self.disputed(one)[one.run.liars].any()) for one in runs]
                word = f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} and more"
                rows.append([
                    word, format_rate(self._area(runs, "score")), _share(caught), _share(disputed), _share(honest),
                    str(len(runs)),
                ])  # fmt: skip
        return Table(("other agents that see it", "AUROC", "accused", "disputed", "honest ones accused", "runs"), rows)

    def published_table(self) -> Table:
        """Return what the published trust makes of the same reports, beside ours."""
        benign = np.concatenate([_lowest_trust(one) for one in self.benign])
        quiet = [_gospa(one, "published") / _gospa(one, "no trust") for one in self.benign]
        rows = [[
            "nobody lies", "–", "–", "–", format_rate(float(np.median(benign))),
            format_rate(float(np.quantile(benign, 0.05))), f"{np.mean(quiet):.2f}",
        ]]  # fmt: skip
        for name in self.plan.lies:
            runs = self.of(name)
            if runs:
                lied = np.concatenate([_lowest_trust(one)[one.run.liars] for one in runs])
                honest = np.concatenate([np.delete(_lowest_trust(one), one.run.liars) for one in runs])
                area = (benign[None] > lied[:, None]).mean() + 0.5 * (benign[None] == lied[:, None]).mean()
                ratios = [
                    np.mean([_gospa(one, center) for one in runs]) / np.mean([_gospa(one, "no trust") for one in runs])
                    for center in ("published", "ours")
                ]
                rows.append([
                    name, format_rate(float(area)), format_rate(self._area(runs, "evidence")),
                    format_rate(float(np.median(lied))), format_rate(float(np.median(honest))),
                    format_rate(float(np.quantile(honest, 0.05))), f"{ratios[0]:.2f} / {ratios[1]:.2f}",
                ])  # fmt: skip
        header = (
            "lie", "AUROC, published", "ours, by reports", "liar's lowest trust", "an honest one's", "its 5 % quantile",
            "GOSPA of no trust, published / ours",
        )  # fmt: skip
        return Table(header, rows)

    def _claimed(self) -> dict[str, NDArray[np.int64]]:
        """Return how many objects were claimed with this probability, and how many of these wrongly."""
        totals: dict[str, NDArray[np.int64]] = {}
        for key, found in self.results.facts.items():
            if key[:2] == ("run", "test"):
                for least, counts in found["coverage"].items():
                    totals[least] = totals.get(least, np.zeros(2, np.int64)) + np.array(counts)
        return totals

    def claims_table(self) -> Table:
        """Return how often agents claim to see a car or a larger object that gave fewer than five returns."""
        totals = self._claimed()
        most = totals["0.5"][0]
        rows = [
            [least, str(claimed), format_rate(claimed / most), format_rate(wrong / max(claimed, 1), 4)]
            for least, (claimed, wrong) in totals.items()
        ]
        return Table(("claimed with at least", "objects", "of those at .5", "with fewer than five returns"), rows)

    def wrongly_expected(self) -> float:
        """Return the share of the objects that agents are expected to see which gave fewer than five returns."""
        claimed, wrong = self._claimed()[EXPECTED]
        return float(wrong / max(claimed, 1))

    def coverage(self) -> float:
        """Return how many objects agents are expected to see, of those that they claim with .5 or more."""
        totals = self._claimed()
        return float(totals[EXPECTED][0] / max(totals["0.5"][0], 1))

    def checks_table(self) -> Table:
        """Return the AUROC of each check alone for the lies about views."""
        names = [name for name in self.plan.lies if LIES[name].about == "view" and self.of(name)]
        benign = np.concatenate([self._surprises(one) for one in self.honest])
        rows = []
        for name in names:
            lied = np.concatenate([self._surprises(one)[one.run.liars] for one in self.of(name)])
            below = (benign[None] < lied[:, None]).mean(axis=(0, 1)) + 0.5 * (benign[None] == lied[:, None]).mean(
                axis=(0, 1)
            )
            rows.append([name, *(format_rate(float(area), 2) for area in below)])
        return Table(("lie", *VIEW_CHECKS), rows)

    def _surprises(self, one: ScoredRun) -> F64:
        """Return how rare each check of each view (A, C) is, at the end."""
        checks, scale = np.array(one.run.checks[-1], np.float64), self.suspicion.views
        rare = [scale(checks, elevated=flag) for flag in (True, False)]
        return np.where(self.elevated[:, None], *rare)

    def target_table(self) -> Table:
        """Return what was aimed at beside what was reached; what was not run is left out."""

        def named(about: str) -> list[str]:
            return [name for name in self.plan.lies if LIES[name].about == about and "stealthy" not in name]

        def area(*names: str) -> float:
            return mean(self._area(self.of(name), "score") for name in names if self.of(name))

        def ratio(runs: Sequence[ScoredRun], center: str = "no trust") -> float:
            return mean(_gospa(one, "ours") for one in runs) / mean(_gospa(one, center) for one in runs)

        alone, together, lied = named("objects"), named("objects together"), [
            one for name in self.plan.lies for one in self.of(name)
        ]  # fmt: skip
        of_alone = [one for name in alone for one in self.of(name)]
        victims = [float(self.accused(one)[one.run.victim]) for one in lied if one.run.victim >= 0]
        others = [float(np.delete(self.accused(one), one.run.liars).any()) for one in lied]
        quiet = [float(self.accused(one).any()) for one in self.honest]
        delays = [delay for delay in map(self._delay_s, of_alone) if np.isfinite(delay)]
        # What, the bound, whether the figure must lie below it, and the figure.
        rows = (
            ("objects wrongly expected of an honest agent", 0.01, True, self.wrongly_expected()),
            ("objects expected, of those claimed at .5", 0.9, False, self.coverage()),
            ("scenes with an honest agent accused, nobody lies", 0.01, True, mean(quiet)),
            ("the same, others lie", 0.01, True, mean(others)),
            ("one of five lies about objects, AUROC", 0.97, False, area(*alone)),
            ("accused at 1 %", 0.85, False, mean(float(self.accused(one)[one.run.liars].mean()) for one in of_alone)),
            ("seconds until then, median", 2.0, True, float(np.median(delays)) if delays else np.nan),
            ("two lie together, AUROC", 0.88, False, area(*together)),
            (
                "fabricated, with a spoofed view, found at 3 % false alarms", 0.95, False,
                self._at_3_percent("fabricate_spoofed"),
            ),
            ("over-claim of 20 % of the area, AUROC", 0.92, False, area("over_claim")),
            ("under-claim of 30 %, AUROC", 0.80, False, area("under_claim")),
            ("pose shifted by 1 m or turned by 2°, AUROC", 0.95, False, area("shifted_pose", "turned_pose")),
            ("victims of others accused", 0.05, True, mean(victims)),
            ("GOSPA under lies about objects, of no trust", 0.70, True, ratio(of_alone)),
            ("the same, of no trust with tracks out of sight", 0.70, True, ratio(of_alone, "all tracks")),
            ("the same, of the published trust", 0.70, True, ratio(of_alone, "published")),
            ("GOSPA where nobody lies, of no trust", 1.02, True, ratio(self.benign)),
        )  # fmt: skip
        lines = []
        for what, bound, below, figure in rows:
            if np.isfinite(figure):
                met = figure <= bound if below else figure >= bound
                sign = "≤" if below else "≥"
                lines.append([what, f"{sign} {bound:g}", format_rate(figure), "met" if met else "missed"])
        return Table(("what", "target", "reached", ""), lines)


def _counts(run: Run, plan: AgentsPlan) -> bool:
    """Return whether the liars changed an object or 5 % of the area for a second at least."""
    least = 0.05 if LIES[run.case].about == "view" else 1.0
    return sum(value >= least for value in run.touched) / plan.hz >= 1.0


def _lowest_trust(one: ScoredRun) -> F64:
    """Return the lowest published trust (A,) in each agent from the onset on."""
    trust = np.array(one.run.published_trust)
    return np.asarray(trust[len(trust) // 4 :].min(axis=0))


def _gospa(one: ScoredRun, center: str) -> float:
    return float(np.mean(one.run.gospa[center][len(one.run.gospa[center]) // 4 :]))


def _share(flags: Sequence[bool]) -> str:
    if not flags:
        return "–"
    low, high = binomtest(sum(flags), len(flags)).proportion_ci(method="wilson")
    return format_interval(sum(flags) / len(flags), (float(low), float(high)))


def _masts(plan: AgentsPlan) -> str:
    """Return how tall masts are, in a sentence."""
    if not plan.tall_masts:
        return "Masts are 4 to 8 m tall."
    return (
        f"One mast in {plan.tall_masts} is {MAST_M:g} m tall and its sensor pitched {PITCH_DEG:g}° down, as published;"
        " the others are of 4 to 8 m."
    )


def files_of(store: ResultStore[AgentsPlan]) -> dict[str, bytes]:
    """Return the page as a file by its name.

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
        "onset": f"{ONSET_S:g}", "masts": _masts(plan),
    }  # fmt: skip
    page = fill_template("agents/page.md", results=found, **values)
    scenes = f"{plan.claims} claims, {plan.calibration} calibration, {plan.test} test, {plan.benign} benign"
    about = facts(
        plan=f"{plan.name}: {plan.about}", seed=str(plan.seed), worlds=", ".join(plan.worlds),
        sensors=", ".join(plan.sensors), scenes=scenes, commits=commits(results),
    )  # fmt: skip
    return page.files("agents.md", about)
