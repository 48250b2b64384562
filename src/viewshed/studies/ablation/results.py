"""What the ablation found, as figures of methods, and the figures that were aimed at, each met or missed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from viewshed.fov.visibility import PEDESTRIAN
from viewshed.metrics import STEPS, Scores
from viewshed.studies.ablation.evaluate import (
    ALONE,
    ATTACKED,
    ATTACKS,
    CLEAR,
    CONFIRMED,
    HONEST,
    POINTS,
    SENSOR,
    UNTOUCHED,
)
from viewshed.studies.ablation.plan import WHOLE, AblationPlan
from viewshed.studies.cases import BARE, DEFAULT
from viewshed.studies.records import BENIGN, VIEW, WEDGE, Case, Results, Series
from viewshed.studies.statistics import f1
from viewshed.studies.store import ResultStore

JAMMING = Case("attack", "jamming", DEFAULT)

_HISTORIES = (f", {ALONE}", f", {HONEST}", f", {ATTACKED}")

OVER_CLAIM = tuple(
    Case("attack", name, DEFAULT)
    for name in ("ghost_wall", "far_wall", "removal", "high_frequency_removal", "relay", "removal_and_far_wall")
)


@dataclass(frozen=True, slots=True, eq=False)
class SettingResults:
    """Everything that was found on one split of one setting, all sweeps together.

    Attributes:
        plan: of the ablation.
        setting: of the plan's.
        results: of the split.
    """

    plan: AblationPlan
    setting: str
    results: Results[AblationPlan]

    @classmethod
    def read(cls, store: ResultStore[AblationPlan], split: str, setting: str) -> SettingResults:
        """Return what the finished jobs of a split found in a setting.

        Raises:
            ValueError: a line is damaged.
        """
        return cls(store.plan, setting, store.results(split, setting))

    @property
    def methods(self) -> list[str]:
        """Networks and classical estimators, with histories and without."""
        return self.results.methods(self.setting)

    @property
    def alone(self) -> list[str]:
        """Methods that see one sweep alone."""
        return [name for name in self.methods if not name.endswith(_HISTORIES)]

    def with_history(self, name: str) -> list[str]:
        """Return a method on sweeps that have a history: alone, with it, and confirmed by it."""
        return [one for one in self.methods if one.startswith(f"{name}, ") and one.endswith(_HISTORIES)]

    @property
    def attacks(self) -> tuple[str, ...]:
        """Attacks that our network is trained on."""
        return self.plan.config_in(self.setting).attacks

    @property
    def trained(self) -> tuple[Case, ...]:
        """Those of the attacks that our network is trained on, jamming apart."""
        return tuple(case for case in ATTACKS if case.name in self.attacks and case != JAMMING)

    @property
    def unseen(self) -> tuple[Case, ...]:
        """Attacks that it never met."""
        return tuple(case for case in ATTACKS if case.name not in self.attacks)

    @property
    def opening(self) -> tuple[list[Case], list[Case]]:
        """Attacks that open a view: those that our network is trained on, and those it never met."""
        seen, unseen = ([case for case in OVER_CLAIM if case in group] for group in (self.trained, self.unseen))
        return seen, unseen

    @property
    def sure(self) -> float:
        """Probability from which the whole network's claims in opened wedges have the plan's precision."""
        return sure_from(self.wedge(WHOLE, self.opening[0]), self.plan.claim_precision)

    def series(self, name: str, case: Case, region: str = VIEW) -> Series:
        """Return what records of this setting have in common."""
        return Series(self.setting, name, case, region)

    def has(self, name: str, case: Case) -> bool:
        """Return whether a method was tried in a case."""
        return self.series(name, case) in self.results

    def cases(self, name: str) -> list[Case]:
        """Return the cases in which a method was tried, in the order in which they came."""
        return list(dict.fromkeys(s.case for s in self.results.series(self.setting) if s.method == name))

    def each(self, name: str, cases: Iterable[Case]) -> list[Scores]:
        """Return the scores of the whole view in those of the cases that there are."""
        return [self.view(name, [case]) for case in cases if self.has(name, case)]

    def view(self, name: str, cases: Iterable[Case]) -> Scores:
        """Return the scores of the whole view in several cases together."""
        return self.results.scores(self.series(name, case) for case in cases)

    def wedge(self, name: str, cases: Iterable[Case]) -> Scores:
        """Return the scores in the wedges of several cases together."""
        return self.results.scores(self.series(name, case, WEDGE) for case in cases)

    def f1(self, name: str, cases: Iterable[Case]) -> float:
        """Return the mean F1 of the view over cases; NaN for none."""
        scores = self.each(name, cases)
        return float(np.mean([one.f1() for one in scores])) if scores else float("nan")

    @property
    def parts(self) -> dict[str, int]:
        """Parts of the untouched view, sensors last and in alphabetical order, with the sweeps that have them."""
        alone = self.alone
        parts = {
            series.region: self.results.counts(series).samples
            for series in self.results.series(self.setting)
            if series.case == BENIGN and series.method in alone and series.region not in (VIEW, WEDGE)
        }
        return dict(sorted(parts.items(), key=lambda part: part[0] if part[0].startswith(SENSOR) else ""))

    def f1_of_part(self, name: str, part: str) -> float:
        """Return the F1 of a part of the untouched view; NaN where nothing of it is visible or claimed."""
        return self.results.rate(self.series(name, BENIGN, part), f1)

    def ece(self, name: str, cases: Iterable[Case]) -> float:
        """Return the expected calibration error of the view over cases together."""
        return self.view(name, cases).ece()

    def figures(self, name: str) -> dict[str, float]:
        """Return what one line of the ablation says of a method."""
        seen, unseen = (self.wedge(name, cases) for cases in self.opening)
        return {
            "benign": self.f1(name, [BENIGN]), "no rings": self.f1(name, [BARE]),
            "trained": self.f1(name, self.trained), "unseen": self.f1(name, self.unseen),
            "jamming": self.f1(name, [JAMMING]), "worst": min(s.f1() for s in self.each(name, ATTACKS)),
            "wedge precision": seen.precision(), "wedge recall": seen.recall(),
            "unseen wedge precision": unseen.precision(), "unseen wedge recall": unseen.recall(),
            "ECE benign": self.ece(name, [BENIGN]), "ECE unseen": self.ece(name, self.unseen),
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class Sure:
    """What is claimed where only sure cells are: claimed from a probability on, denied below 1 less it.

    Attributes:
        share: of the cells of which anything is said.
        claims: share of the claimed cells that are visible; NaN where none is claimed.
        denials: share of the denied cells that are not visible; NaN where none is denied.
    """

    share: float
    claims: float
    denials: float

    @classmethod
    def of(cls, scores: Scores, sure: float) -> Sure:
        """Return what is said of the cells of some scores from ``sure`` on, a multiple of .001 in [.5, 1).

        >>> scores = Scores()
        >>> scores.add([0.95, 0.9, 0.5, 0.05], [True, False, True, False])
        >>> Sure.of(scores, 0.9)
        Sure(share=0.75, claims=0.5, denials=1.0)
        """
        step = round(sure * STEPS)
        claimed, denied = scores.steps[step:].sum(axis=0), scores.steps[: STEPS - step].sum(axis=0)
        decided, nan = int(claimed.sum() + denied.sum()), float("nan")
        return cls(
            decided / scores.cells if scores.cells else nan,
            float(claimed[1] / claimed.sum()) if claimed.any() else nan,
            float(denied[0] / denied.sum()) if denied.any() else nan,
        )


def sure_from(scores: Scores, precision: float) -> float:
    """Return the lowest probability from which claims have a precision, in whole steps; 1 if none does.

    >>> scores = Scores()
    >>> scores.add([0.4, 0.7, 0.9], [False, False, True])
    >>> sure_from(scores, 0.8)
    0.701
    """
    for step in range(1, STEPS + 1):
        if scores.precision(step / STEPS) >= precision:
            return step / STEPS
    return 1.0


OURS, FLOAT, SEVERAL, RIVAL = "viewnet", "viewnet, float32", "viewnet, 20 passes", "majority_vote"
"""Our network in bytes, in float32 and with dropout passes, and the classical estimator that it must beat."""

SHADOW_MAP = "shadow_map"
"""The classical estimator that earlier sweeps help."""


@dataclass(frozen=True, slots=True)
class Target:
    """One figure.

    Attributes:
        what: it is of.
        wanted: in words.
        found: in words.
        met: whether.
    """

    what: str
    wanted: str
    found: str
    met: bool


def targets_of(validation: SettingResults, test: SettingResults, chosen: SettingResults) -> list[Target]:
    """Return the targets with what was found on the reported scenes; none where our network was not tried."""
    if OURS not in test.methods:
        return []
    return [
        *_agreement(test),
        *_parts(test),
        *_wedges(validation, test),
        *_with_history(test),
        *_chosen(chosen),
        *_calibration(test),
        *_doubt(test),
    ]


def targets_elsewhere(test: SettingResults) -> list[Target]:
    """Return the targets of another setting; none where our network was not tried."""
    return list(_elsewhere(test)) if OURS in test.methods else []


def _elsewhere(test: SettingResults) -> Iterator[Target]:
    families = [case for case in ATTACKS if case != JAMMING]
    benign, mean = test.f1(OURS, [BENIGN]), test.f1(OURS, families)
    pedestrian = test.plan.config_in(test.setting).target == PEDESTRIAN.name
    yield _at_least("F1, benign", benign, 0.94 if pedestrian else 0.96)
    if not pedestrian:
        yield from _clear(test)
    yield _at_least("mean F1 over the attacks, jamming apart", mean, 0.93)
    yield _lead(test, (BENIGN, *ATTACKS), "least lead over the vote, benign and under any attack")


def label(case: Case) -> str:
    """Return what a case is called in tables."""
    return case.name or case.kind


def _agreement(test: SettingResults) -> Iterator[Target]:
    families = [case for case in ATTACKS if case != JAMMING]
    benign, bare = (test.f1(OURS, [case]) for case in (BENIGN, BARE))
    mean, rival = (test.f1(name, families) for name in (OURS, RIVAL))
    jammed = test.f1(OURS, [JAMMING])
    yield _at_least("F1, benign", benign, 0.96)
    yield _at_least("mean F1 over the attacks, jamming apart", mean, 0.93)
    yield Target("the same less that of the vote", "≥ .020", f"{mean - rival:+.3f}", mean - rival >= 0.02)
    yield _lead(test, ATTACKS, "least lead over the vote under any attack")
    yield _at_least("F1, jamming", jammed, 0.88)
    yield Target("F1 without rings, less that with rings", "≥ -.020", f"{bare - benign:+.3f}", bare - benign >= -0.02)
    if FLOAT in test.methods:
        for words, cases in (("benign", [BENIGN]), ("mean over the attacks", list(ATTACKS))):
            less = test.f1(OURS, cases) - test.f1(FLOAT, cases)
            yield Target(f"F1 in bytes, less that in float32, {words}", "≥ -.002", f"{less:+.4f}", less >= -0.002)
    seen, unseen = test.f1(OURS, test.trained), test.f1(OURS, test.unseen)
    found = f"{unseen - seen:+.3f}"
    yield Target("mean F1, unseen attacks less those trained on", "≥ -.020", found, unseen - seen >= -0.02)


def _lead(test: SettingResults, cases: Iterable[Case], what: str) -> Target:
    leads = {case: test.f1(OURS, [case]) - test.f1(RIVAL, [case]) for case in cases if test.has(OURS, case)}
    worst = min(leads, key=lambda case: leads[case])
    return Target(what, "≥ 0", f"{leads[worst]:+.3f} ({label(worst)})", leads[worst] >= 0)


def _parts(test: SettingResults) -> Iterator[Target]:
    sensors = {part: test.f1_of_part(OURS, part) for part in test.parts if part.startswith(SENSOR)}
    yield from _clear(test)
    if sensors:
        worst = min(sensors, key=lambda part: sensors[part])
        found = f"{sensors[worst]:.3f} ({worst.removeprefix(SENSOR)})"
        yield Target("least F1 of any sensor, benign", "≥ 0.93", found, sensors[worst] >= 0.93)


def _clear(test: SettingResults) -> Iterator[Target]:
    if CLEAR in test.parts:
        yield _at_least(f"F1, benign, cells {CLEAR}", test.f1_of_part(OURS, CLEAR), 0.98)


def _wedges(validation: SettingResults, test: SettingResults) -> Iterator[Target]:
    if WHOLE not in validation.methods:
        return
    step, (seen, unseen) = validation.sure, test.opening
    for words, cases, wanted in (("trained on", seen, 0.8), ("unseen", unseen, 0.5)):
        scores = test.wedge(OURS, cases)
        precision, recall = scores.precision(step), scores.recall(step)
        found = f"{precision:.3f} / {recall:.3f} from {step:g}" if scores.counts(step)[0] else "no such probability"
        met = precision >= wanted and recall >= 0.5
        what = f"precision / recall in opened wedges after abstention, {words}"
        yield Target(what, f"≥ {wanted:.2f} / .50", found, met)


def _with_history(test: SettingResults) -> Iterator[Target]:
    for kind, honest in ((HONEST, True), (ATTACKED, False)):
        name = f"{OURS}, {CONFIRMED}{kind}"
        for words, cases in zip(("trained on", "unseen"), test.opening, strict=True):
            if name in test.methods:
                scores = test.wedge(name, cases)
                precision, recall = scores.precision(), scores.recall()
                what = f"precision / recall in opened wedges, wary of earlier sweeps{'' if honest else ', attacked'}"
                met = precision >= 0.9 and recall >= 0.5
                yield Target(f"{what}, {words}", "≥ 0.90 / .50", f"{precision:.3f} / {recall:.3f}", met)


def _chosen(chosen: SettingResults) -> Iterator[Target]:
    for case in chosen.cases(OURS):
        if case != UNTOUCHED:
            precision, wedge = chosen.view(OURS, [case]).precision(), chosen.wedge(OURS, [case]).precision()
            what = f"precision against {POINTS} points chosen with {case.level} questions"
            yield Target(what, "≥ 0.90", f"{precision:.3f} (wedge {wedge:.3f})", precision >= 0.9)


def _calibration(test: SettingResults) -> Iterator[Target]:
    for words, cases, most in (("benign", (BENIGN,), 0.02), ("unseen attacks", test.unseen, 0.05)):
        ece = test.ece(OURS, cases)
        yield Target(f"ECE, {words}", f"≤ {most}", f"{ece:.4f}", ece <= most)


def _doubt(test: SettingResults) -> Iterator[Target]:
    if SEVERAL not in test.methods:
        return
    for words, cases in (("benign", (BENIGN,)), ("attacked", ATTACKS)):
        one, several = (test.view(name, cases) for name in (OURS, SEVERAL))
        for name in ("brier", "aurc", "aurc_std"):
            ours, theirs = getattr(one, name)(), getattr(several, name)()
            what = f"{_NAMES[name]} of one pass beside that of 20, {words}"
            yield Target(what, f"≤ {theirs:.4f}", f"{ours:.4f}", ours <= theirs)


_NAMES = {"brier": "Brier score", "aurc": "AURC", "aurc_std": "AURC by deviation"}


def _at_least(what: str, found: float, wanted: float) -> Target:
    return Target(what, f"≥ {wanted:.2f}", f"{found:.3f}", found >= wanted)
