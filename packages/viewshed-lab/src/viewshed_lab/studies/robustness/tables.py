"""The tables of the page of the robustness study, with pooled figures by domain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isnan

import numpy as np

from viewshed.metrics import ConfusionCounts
from viewshed_lab.studies.formatting import (
    best_of_columns,
    by_name,
    format_interval,
    format_rate,
    format_rates,
    lines,
    mean,
    pivot,
)
from viewshed_lab.studies.pages import Table
from viewshed_lab.studies.records import BENIGN, VIEW, WEDGE, Case
from viewshed_lab.studies.robustness.verdicts import MODEST, AttackedDomain
from viewshed_lab.studies.statistics import f1


def _pair(counts: ConfusionCounts) -> str:
    return format_rates(counts.precision, counts.recall)


def _f1_with_interval(domain: AttackedDomain, method: str, case: Case = BENIGN, region: str = VIEW) -> str:
    return format_interval(domain.counts(method, case, region).f1, domain.interval(method, [case], f1, region))


def benign_table(domain: AttackedDomain) -> Table:
    """Return the table of each estimator's figures on clean sweeps, with the interval of its F1."""
    clean = domain.counts
    return lines("", by_name(domain.methods), {
        "precision": lambda name: format_rate(clean(name).precision),
        "recall": lambda name: format_rate(clean(name).recall),
        "F1 [95 %]": lambda name: _f1_with_interval(domain, name),
        "IoU": lambda name: format_rate(clean(name).iou),
        "over m²": lambda name: f"{clean(name).over_m2:.0f}",
        "under m²": lambda name: f"{clean(name).under_m2:.0f}",
        "AUPRC": lambda name: format_rate(mean(domain.results.numbers(domain.series(name), "auprc"))),
    })  # fmt: skip


def _defense_cases(domain: AttackedDomain) -> dict[str, Case]:
    """Return the cases of the defenses by name: benign, every attack at its largest budget, every corruption."""
    corrupted = {f"{name}, {case.level}": case for name, case in domain.corrupted.items()}
    return {"*benign*": BENIGN} | domain.strongest | corrupted


def gain_table(domain: AttackedDomain) -> Table:
    """Return the table of F1 gained by each defense: on clean sweeps / mean over the strongest attacks."""

    def gain(case: Case, defense: str, method: str) -> float:
        return domain.counts(method, replace(case, defense=defense)).f1 - domain.counts(method, case).f1

    def gains(defense: str, method: str) -> str:
        attacked = [gain(case, defense, method) for case in domain.strongest.values()]
        return f"{_signed(gain(BENIGN, defense, method))} / {_signed(float(np.mean(attacked)))}"

    return pivot("", by_name(domain.plan.defenses), by_name(domain.plan.defended), gains)


def _signed(gain: float) -> str:
    return "–" if isnan(gain) else f"{gain:+.3f}".replace("0.", ".", 1)


def caught_table(domain: AttackedDomain) -> Table:
    """Return the table of the shares of forged and other returns that each defense drops, or of its alarms."""

    def dropped(case: Case, defense: str) -> str:
        series = domain.series("", replace(case, defense=defense))
        if series not in domain.results:
            return "–"
        alarms = domain.results.numbers(series, "alarm")
        if len(alarms):
            return f"alarm {alarms.mean():.2f}"
        names = ("caught", "added", "lost", "others")
        caught, added, lost, others = (domain.results.numbers(series, name).sum() for name in names)
        return format_rates(
            *(part / whole if whole else float("nan") for part, whole in ((caught, added), (lost, others)))
        )

    return pivot("", _defense_cases(domain), by_name(domain.plan.defenses), dropped)


def paper_table(domain: AttackedDomain) -> Table:
    """Return the table of precision against the paper's label: benign, and under its attacks with relative change."""
    paper = domain.paper

    def precision(method: str, case: Case) -> str:
        now = format_rate(paper.counts(method, case).precision)
        return now if case == BENIGN else f"{now} ({100 * (0.0 - fall_of(domain, method, case)):+.0f} %)"

    cases = {"benign": BENIGN} | {f"{case.name} {case.level}".strip(): case for case in paper.cases if case != BENIGN}
    return pivot("", by_name(paper.methods), cases, precision)


def fall_of(domain: AttackedDomain, method: str, case: Case) -> float:
    """Return the relative loss of pooled precision against the benign one of its protocol; NaN without results."""
    results = domain.paper if case.kind == "paper" else domain
    return 1.0 - results.counts(method, case).precision / results.counts(method).precision


def adaptive_table(domain: AttackedDomain) -> Table:
    """Return the table of false area per sweep added by each adaptive attack, and by the worst other attack.

    All columns have the same samples and the same budget.
    """
    met = domain.met("adaptive")

    def words(method: str, attack: str) -> str:
        case = met.adaptive(attack)
        return _more(met, method, case, wants_over(attack)) if met.counts(method, case).cells else "–"

    def worst(method: str, over: bool) -> str:
        cases = [Case("attack", name, str(met.plan.adaptive_budget)) for name in met.attacks]
        cases = [case for case in cases if met.counts(method, case).cells]
        if not cases:
            return "–"
        case = max(cases, key=lambda case: met.more_m2(method, case, over=over))
        return f"{case.name} {_more(met, method, case, over)}"

    rows = [[name, worst(name, True), worst(name, False), *(words(name, attack) for attack in met.plan.adaptive)]
            for name in met.methods]  # fmt: skip
    return Table(["", "over, worst of the others", "under, worst of the others", *met.plan.adaptive], rows)


def wants_over(attack: str) -> bool:
    """Return whether an adaptive attack aims at over-claim; otherwise it aims at under-claim.

    >>> wants_over("adaptive_over_claim_free"), wants_over("adaptive_under_claim")
    (True, False)
    """
    return "over_claim" in attack


def _more(domain: AttackedDomain, method: str, case: Case, over: bool) -> str:
    losses = domain.losses(method, case)
    loss = max(losses.precision if over else losses.recall, 0.0)
    region = "" if domain.counts(method, case, WEDGE).cells else " of the view"
    return f"{domain.more_m2(method, case, over=over):+.0f} m² ({format_rate(loss)}{region})"


def known_defense_table(attack: str, domain: AttackedDomain) -> Table:
    """Return the table of precision / recall in the wedge by defense: untouched, defense unknown, defense known."""
    budget = str(domain.plan.adaptive_budget)
    kinds = {"untouched": ("adaptive", "0"), "defense not known": ("unaware", budget),
             "defense known": ("adaptive", budget)}  # fmt: skip

    def rates(defense: str, column: tuple[str, tuple[str, str]]) -> str:
        method, (kind, level) = column
        counts = domain.counts(method, Case(kind, attack, level, defense), WEDGE)
        return _pair(counts) if counts.cells and not isnan(counts.recall) else "–"

    defended = domain.plan.adaptive_defended
    columns = {f"{name}, {words}": (name, kind) for name in defended for words, kind in kinds.items()}
    return pivot("", {"*no defense*": ""} | by_name(domain.plan.defenses), columns, rates)


def summary_table(domain: AttackedDomain) -> Table:
    """Return the table of each estimator's scores, clean, attacked and corrupted, and of the attacks it withstands.

    The best of each column, the baseline to beat, is bold.
    """
    attacked, corrupted = domain.strongest.values(), domain.corrupted.values()

    def withstood(method: str, max_budget: int | None) -> str:
        return _share([domain.verdict(method, attack, max_budget).withstands for attack in domain.attacks])

    def queried(method: str) -> str:
        met = [attack for attack in domain.plan.adaptive if domain.counts(method, domain.adaptive(attack)).cells]
        return _share([domain.withstands_adaptive(method, attack) for attack in met])

    table = lines("", by_name(domain.methods), {
        "F1 clean [95 %]": lambda name: _f1_with_interval(domain, name),
        "F1 attacked": lambda name: format_rate(mean(domain.counts(name, case).f1 for case in attacked)),
        "precision in the wedge": lambda name: format_rate(
            mean(domain.counts(name, case, WEDGE).precision for case in attacked)),
        "recall in the wedge": lambda name: format_rate(
            mean(domain.counts(name, case, WEDGE).recall for case in attacked)),
        "F1 corrupted": lambda name: format_rate(mean(domain.counts(name, case).f1 for case in corrupted)),
        f"withstands, {MODEST} returns": lambda name: withstood(name, MODEST),
        "withstands, full wedge": lambda name: withstood(name, None),
        "withstands, adaptive": queried,
    })  # fmt: skip
    return Table(table.header, best_of_columns(table.rows, ties=False))


def _share(verdicts: Sequence[bool]) -> str:
    return f"{sum(verdicts)} of {len(verdicts)}" if verdicts else "–"


def bar_overview(domains: Sequence[AttackedDomain], region: str) -> Table:
    """Return the table of the best F1 and its estimator, by attack at its largest budget and by domain."""
    attacks = dict.fromkeys(name for domain in domains for name in domain.attacks)
    rows = {"*benign*": BENIGN} | {name: domains[0].plan.strongest(name) for name in attacks}
    table = pivot("attack", rows, {domain.name: domain for domain in domains}, lambda c, d: leader(d, c, region))
    return Table(table.header, [row for row in table.rows if set(row[1:]) != {"–"}])


def leader(domain: AttackedDomain, case: Case, region: str) -> str:
    """Return the best F1 of a case with its interval and its estimator; a dash without any."""
    best = domain.best(domain.methods, case, region)
    return f"{_f1_with_interval(domain, best, case, region)} {best}" if best else "–"
