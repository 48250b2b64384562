"""What the ablation found, as figures of methods, and the figures that were aimed at, each met or missed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from viewshed.fov.visibility import PEDESTRIAN
from viewshed.metrics import STEPS, Scores
from viewshed_lab.studies.ablation.evaluate import (
    ALONE,
    ATTACKED,
    ATTACKS,
    CONFIRMED,
    HONEST,
    POINTS,
    UNTOUCHED,
)
from viewshed_lab.studies.ablation.plan import WHOLE, AblationPlan
from viewshed_lab.studies.cases import BARE, DEFAULT
from viewshed_lab.studies.records import BENIGN, VIEW, WEDGE, Case, Domain
from viewshed_lab.studies.samples import CLEAR, SENSOR
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.training.config import TrainConfig

JAMMING = Case("attack", "jamming", DEFAULT)

FAMILIES = [case for case in ATTACKS if case != JAMMING]
"""The attacks, jamming apart."""

_HISTORIES = (f", {ALONE}", f", {HONEST}", f", {ATTACKED}")

OVER_CLAIM = tuple(
    Case("attack", name, DEFAULT)
    for name in ("ghost_wall", "far_wall", "removal", "high_frequency_removal", "relay", "removal_and_far_wall")
)


@dataclass(frozen=True, eq=False)
class SettingResults(Domain[AblationPlan]):
    """Everything that was found on one split of one setting of the plan, all sweeps together."""

    @classmethod
    def read(cls, store: ResultStore[AblationPlan], split: str, setting: str) -> SettingResults:
        """Return what the finished jobs of a split found in a setting."""
        return cls(store.results(split, setting), setting)

    @cached_property
    def config(self) -> TrainConfig:
        """The training config whose grid, target and attacks count here."""
        return self.plan.config_in(self.name)

    @property
    def title(self) -> str:
        """What the setting is called: its preset and its target."""
        return self.plan.title_of(self.name)

    @property
    def preset(self) -> str:
        """The preset whose scenes the setting has."""
        return self.plan.preset_in(self.name)

    @property
    def alone(self) -> list[str]:
        """Methods that see one sweep alone."""
        return [name for name in self.methods if not name.endswith(_HISTORIES)]

    @property
    def helped(self) -> list[str]:
        """Methods that earlier sweeps help, on sweeps that have some: alone, with them, and confirmed by them."""
        helped = tuple(f"{name}, " for name in (OURS, SHADOW_MAP))
        return [one for one in self.methods if one.startswith(helped) and one.endswith(_HISTORIES)]

    @property
    def attacks(self) -> tuple[str, ...]:
        """Attacks that our network is trained on."""
        return self.config.attacks

    @property
    def trained(self) -> tuple[Case, ...]:
        """Those of the attacks that our network is trained on, jamming apart."""
        return tuple(case for case in FAMILIES if case.name in self.attacks)

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

    def cases_of(self, name: str) -> list[Case]:
        """Return the cases in which a method was tried, in the order in which they came."""
        return [case for case in self.cases if self.has(name, case)]

    def each(self, name: str, cases: Iterable[Case]) -> list[Scores]:
        """Return the scores of the whole view in those of the cases that there are."""
        return [self.scores(name, [case]) for case in cases if self.has(name, case)]

    def wedge(self, name: str, cases: Iterable[Case]) -> Scores:
        """Return the scores in the wedges of several cases together."""
        return self.scores(name, cases, WEDGE)

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
            for series in self.results.series(self.name)
            if series.case == BENIGN and series.method in alone and series.region not in (VIEW, WEDGE)
        }
        return dict(sorted(parts.items(), key=lambda part: part[0] if part[0].startswith(SENSOR) else ""))

    def figures(self, name: str) -> dict[str, float]:
        """Return what one line of the ablation says of a method."""
        seen, unseen = (self.wedge(name, cases) for cases in self.opening)
        return {
            "benign": self.f1(name, [BENIGN]), "no rings": self.f1(name, [BARE]),
            "trained": self.f1(name, self.trained), "unseen": self.f1(name, self.unseen),
            "jamming": self.f1(name, [JAMMING]), "worst": min(s.f1() for s in self.each(name, ATTACKS)),
            "wedge precision": seen.precision(), "wedge recall": seen.recall(),
            "unseen wedge precision": unseen.precision(), "unseen wedge recall": unseen.recall(),
            "ECE benign": self.scores(name, [BENIGN]).ece(), "ECE unseen": self.scores(name, self.unseen).ece(),
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class Sure:
    """What is claimed where only sure cells are: claimed from a probability on, denied below 1 less it."""

    share: float  # of the cells about which anything is claimed
    claims: float  # share of the claimed cells that are visible; NaN where none is claimed
    denials: float  # share of the denied cells that are not visible; NaN where none is denied

    @classmethod
    def of(cls, scores: Scores, sure: float) -> Sure:
        """Return what is claimed of the cells of some scores from ``sure`` on, a multiple of .001 in [.5, 1).

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


class AblationTarget(NamedTuple):
    """What a figure is of, what was wanted and what was found in words, and whether it is met."""

    what: str
    wanted: str
    found: str
    met: bool


def label(case: Case) -> str:
    """Return what a case is called in tables."""
    return case.name or case.kind


def targets_of(validation: SettingResults, test: SettingResults, chosen: SettingResults) -> list[AblationTarget]:
    """Return the targets with what was found on the reported scenes; none where our network was not tried."""
    if OURS not in test.methods:
        return []
    benign, bare, mean = (test.f1(OURS, cases) for cases in ([BENIGN], [BARE], FAMILIES))
    targets = [
        _at_least("F1, benign", benign, 0.96),
        _at_least("mean F1 over the attacks, jamming apart", mean, 0.93),
        _more_by("the same less that of the vote", mean - test.f1(RIVAL, FAMILIES), 0.02),
        _lead(test, ATTACKS, "least lead over the vote under any attack"),
        _at_least("F1, jamming", test.f1(OURS, [JAMMING]), 0.88),
        _more_by("F1 without rings, less that with rings", bare - benign, -0.02),
    ]
    for words, several in (("benign", [BENIGN]), ("mean over the attacks", list(ATTACKS))):
        if FLOAT in test.methods:
            less = test.f1(OURS, several) - test.f1(FLOAT, several)
            what = f"F1 in bytes, less that in float32, {words}"
            targets.append(AblationTarget(what, "≥ -.002", f"{less:+.4f}", less >= -0.002))
    less = test.f1(OURS, test.unseen) - test.f1(OURS, test.trained)
    targets += [_more_by("mean F1, unseen attacks less those trained on", less, -0.02), *_parts(test)]
    # Precision in opened wedges: after abstention, and confirmed by earlier sweeps.
    groups = tuple(zip(("trained on", "unseen"), test.opening, strict=True))
    if WHOLE in validation.methods:
        step = validation.sure
        for (words, cases), wanted in zip(groups, (0.8, 0.5), strict=True):
            scores = test.wedge(OURS, cases)
            one = _opened(f"precision / recall in opened wedges after abstention, {words}", scores, wanted, step)
            found = f"{one.found} from {step:g}" if scores.counts(step)[0] else "no such probability"
            targets.append(one._replace(found=found))
    for kind, attacked in ((HONEST, ""), (ATTACKED, ", attacked")):
        if (name := f"{OURS}, {CONFIRMED}{kind}") in test.methods:
            what = f"precision / recall in opened wedges, confirmed by earlier sweeps{attacked}"
            targets += [_opened(f"{what}, {words}", test.wedge(name, cases), 0.9) for words, cases in groups]
    for case in chosen.cases_of(OURS):
        if case != UNTOUCHED:
            precision, wedge = chosen.scores(OURS, [case]).precision(), chosen.wedge(OURS, [case]).precision()
            what = f"precision against {POINTS} points chosen with {case.level} queries"
            targets.append(AblationTarget(what, "≥ 0.90", f"{precision:.3f} (wedge {wedge:.3f})", precision >= 0.9))
    for words, unseen, most in (("benign", (BENIGN,), 0.02), ("unseen attacks", test.unseen, 0.05)):
        ece = test.scores(OURS, unseen).ece()
        targets.append(AblationTarget(f"ECE, {words}", f"≤ {most}", f"{ece:.4f}", ece <= most))
    return [*targets, *_doubt(test)]


def targets_elsewhere(test: SettingResults) -> list[AblationTarget]:
    """Return the targets of another setting; none where our network was not tried."""
    if OURS not in test.methods:
        return []
    pedestrian = test.config.target == PEDESTRIAN.name
    return [
        _at_least("F1, benign", test.f1(OURS, [BENIGN]), 0.94 if pedestrian else 0.96),
        *([] if pedestrian else _clear(test)),
        _at_least("mean F1 over the attacks, jamming apart", test.f1(OURS, FAMILIES), 0.93),
        _lead(test, (BENIGN, *ATTACKS), "least lead over the vote, benign and under any attack"),
    ]


def _lead(test: SettingResults, cases: Iterable[Case], what: str) -> AblationTarget:
    leads = {case: test.f1(OURS, [case]) - test.f1(RIVAL, [case]) for case in cases if test.has(OURS, case)}
    worst = min(leads, key=lambda case: leads[case])
    return AblationTarget(what, "≥ 0", f"{leads[worst]:+.3f} ({label(worst)})", leads[worst] >= 0)


def _parts(test: SettingResults) -> Iterator[AblationTarget]:
    yield from _clear(test)
    sensors = {part: test.counts(OURS, BENIGN, part).f1 for part in test.parts if part.startswith(SENSOR)}
    if sensors:
        worst = min(sensors, key=lambda part: sensors[part])
        found = f"{sensors[worst]:.3f} ({worst.removeprefix(SENSOR)})"
        yield AblationTarget("least F1 of any sensor, benign", "≥ 0.93", found, sensors[worst] >= 0.93)


def _clear(test: SettingResults) -> list[AblationTarget]:
    found = test.counts(OURS, BENIGN, CLEAR).f1
    return [_at_least(f"F1, benign, cells {CLEAR}", found, 0.98)] if CLEAR in test.parts else []


def _opened(what: str, scores: Scores, wanted: float, threshold: float = 0.5) -> AblationTarget:
    """Return the target of a precision in opened wedges, at a recall of at least one half."""
    precision, recall = scores.precision(threshold), scores.recall(threshold)
    met = precision >= wanted and recall >= 0.5
    return AblationTarget(what, f"≥ {wanted:.2f} / .50", f"{precision:.3f} / {recall:.3f}", met)


def _doubt(test: SettingResults) -> Iterator[AblationTarget]:
    """Yield how good the doubt of one pass is beside that of several."""
    for words, cases in (("benign", (BENIGN,)), ("attacked", ATTACKS)) if SEVERAL in test.methods else ():
        one, several = (test.scores(name, cases) for name in (OURS, SEVERAL))
        for name, figure in (("Brier score", Scores.brier), ("AURC", Scores.aurc)):
            ours, theirs = figure(one), figure(several)
            what = f"{name} of one pass beside that of 20, {words}"
            yield AblationTarget(what, f"≤ {theirs:.4f}", f"{ours:.4f}", ours <= theirs)


def _at_least(what: str, found: float, wanted: float) -> AblationTarget:
    return AblationTarget(what, f"≥ {wanted:.2f}", f"{found:.3f}", found >= wanted)


def _more_by(what: str, found: float, wanted: float) -> AblationTarget:
    return AblationTarget(what, f"≥ {wanted:.3f}".replace("0.", "."), f"{found:+.3f}", found >= wanted)
