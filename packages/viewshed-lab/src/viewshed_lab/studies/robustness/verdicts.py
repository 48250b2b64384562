"""Losses of estimators under attack against the same sweeps unattacked, and the verdict whether they withstand it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import isnan

from viewshed_lab.studies.records import BENIGN, PAPER, VIEW, WEDGE, Case, Domain, Results
from viewshed_lab.studies.robustness.plan import RobustnessPlan
from viewshed_lab.studies.suite import TESTED
from viewshed_lab.threats.attacks import ATTACKS

MODEST = 200
"""Budget of early spoofers and of the paper's attacker, in returns."""

MAX_F1_LOSS = 0.02
"""Maximum loss of F1 of the whole view, at any budget, of an estimator that withstands an attack."""

MAX_WEDGE_LOSS = 0.05
"""Its maximum loss of precision and of recall in the attacker's wedge; in the whole view without a wedge."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The worst losses of one estimator under one attack, over its budgets."""

    f1: float  # loss of F1 in the whole view
    precision: float  # loss of precision in the wedge, by false claims
    recall: float  # loss of recall in the wedge, by missing claims

    @property
    def withstands(self) -> bool:
        """Whether all losses are within the limits."""
        return self.f1 <= MAX_F1_LOSS and max(self.precision, self.recall) <= MAX_WEDGE_LOSS


@dataclass(frozen=True, eq=False)
class AttackedDomain(Domain[RobustnessPlan]):
    """Results of one domain, with the losses of each estimator under each attack."""

    @cached_property
    def methods(self) -> list[str]:
        """Estimators with results: the paper's first, then ours in the order of ``TESTED``."""
        order = list(TESTED)
        return sorted(super().methods, key=lambda name: order.index(name) if name in order else -1)

    @cached_property
    def paper(self) -> AttackedDomain:
        """Results of the same domain in the paper's protocol."""
        return AttackedDomain(self.results, self.name, PAPER)

    @cached_property
    def attacks(self) -> list[str]:
        """Attacks with results, in the order of ``ATTACKS``."""
        return [name for name in ATTACKS if name in self.plan.attacks and self.cases_of(name)]

    @cached_property
    def strongest(self) -> dict[str, Case]:
        """Each attack with its largest budget."""
        return {name: self.plan.strongest(name) for name in self.attacks}

    @property
    def corrupted(self) -> dict[str, Case]:
        """Each corruption with the severity on which defenses are evaluated."""
        severity = str(self.plan.defended_severity)
        return {name: Case("corruption", name, severity) for name in self.plan.corruptions}

    def cases_of(self, attack: str) -> list[Case]:
        """Return the cases with results of an attack with a budget above 0, or without any its strengths."""
        named = [case for case in self.cases if case.name == attack and not case.defense and case.level != "0"]
        return [case for case in named if case.kind == "attack"] or [case for case in named if case.kind == "strength"]

    def met(self, kind: str) -> AttackedDomain:
        """Return the results of only those sweeps that have a kind of case."""
        return AttackedDomain(self.results.met(self.name, kind), self.name)

    def adaptive(self, attack: str) -> Case:
        """Return the case of an adaptive attack, with the plan's budget."""
        return Case("adaptive", attack, str(self.plan.adaptive_budget))

    def withstands_adaptive(self, method: str, attack: str) -> bool:
        """Return whether an estimator has results under an adaptive attack, within the limits."""
        case = self.adaptive(attack)
        return self.counts(method, case).cells > 0 and self.losses(method, case).withstands

    def before(self, method: str, case: Case) -> tuple[Case, str]:
        """Return the case and region to compare an attacked score with: its untouched wedge, else the benign view."""
        kinds = {"attack": "attack", "adaptive": "adaptive", "unaware": "adaptive"}
        unarmed = replace(case, kind=kinds.get(case.kind, ""), level="0")
        if self.counts(method, case, WEDGE).cells and self.counts(method, unarmed, WEDGE).cells:
            return unarmed, WEDGE
        return BENIGN, VIEW

    def losses(self, method: str, case: Case) -> Verdict:
        """Return the losses in one case: F1 of the view, precision and recall in the wedge (without one: the view)."""
        before, region = self.before(method, case)
        clean = BENIGN if case.kind in ("attack", "strength") else before
        was, now = self.counts(method, before, region), self.counts(method, case, region)
        precision = _loss(was.precision, now.precision)  # NaN without claims: no false claim, so no loss
        recall = _loss(was.recall, 0.0 if isnan(now.recall) else now.recall)
        return Verdict(_loss(self.counts(method, clean).f1, self.counts(method, case).f1), precision, recall)

    def verdict(self, method: str, attack: str, max_budget: int | None = None) -> Verdict:
        """Return the worst losses of an estimator under an attack, over its budgets up to ``max_budget`` returns."""
        cases = [case for case in self.cases_of(attack) if max_budget is None or _returns(case) <= max_budget]
        losses = [self.losses(method, case) for case in cases]
        worst = (
            max((getattr(one, name) for one in losses), default=float("nan")) for name in ("f1", "precision", "recall")
        )
        return Verdict(*worst)

    def more_m2(self, method: str, case: Case, *, over: bool) -> float:
        """Return the over-claimed (or under-claimed) area per sweep in m² that an attack adds."""
        before = self.before(method, case)[0] if case.kind == "adaptive" else BENIGN
        was, now = self.counts(method, before), self.counts(method, case)
        return now.over_m2 - was.over_m2 if over else now.under_m2 - was.under_m2


def domains_of(results: Results[RobustnessPlan]) -> list[AttackedDomain]:
    """Return the domains with results, in the order of the plan."""
    names = {series.domain for series in results.series()}
    return [AttackedDomain(results, name) for name in results.plan.domains if name in names]


def _returns(case: Case) -> float:
    """Return the budget of a case: 0 for strengths, infinite for a full wedge."""
    return 0.0 if case.kind == "strength" else float(case.level) if case.level.isdecimal() else float("inf")


def _loss(was: float, now: float) -> float:
    return 0.0 if isnan(was) or isnan(now) else was - now
