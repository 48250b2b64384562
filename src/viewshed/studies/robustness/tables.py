"""The tables of the page: pooled figures of one domain each, as words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import isnan

import numpy as np

from viewshed._page import Table
from viewshed.metrics import ConfusionCounts
from viewshed.studies.formatting import (
    best_of_columns,
    format_interval,
    format_pair,
    format_rate,
    format_spread,
    pivot,
)
from viewshed.studies.records import BENIGN, PAPER, STRICT, VIEW, WEDGE, Case, Series
from viewshed.studies.robustness.verdicts import MODEST, Domain
from viewshed.studies.statistics import f1
from viewshed.threats.attacks import FAMILY

PAPERS_FARTHEST = ("paper_quantized", "paper_continuous", "paper_concave_hull")
"""The paper's methods that the farthest return decides."""


def _by_name(names: Iterable[str]) -> dict[str, str]:
    return {name: name for name in names}


def _pair(counts: ConfusionCounts) -> str:
    return format_pair(counts.precision, counts.recall)


def benign_table(domain: Domain) -> Table:
    """Return what each estimator scores on clean sweeps, with the interval of its F1."""
    header = ["", "precision", "recall", "F1 [95 %]", "IoU", "over m²", "under m²", "AUPRC"]
    rows = []
    for name in domain.methods:
        series, counts = domain.series(name, BENIGN), domain.counts(name, BENIGN)
        areas = domain.results.numbers(series, "auprc")
        rows.append([
            name, format_rate(counts.precision), format_rate(counts.recall),
            format_interval(counts.f1, domain.results.interval(series, f1)), format_rate(counts.iou),
            f"{counts.over_m2:.0f}", f"{counts.under_m2:.0f}", format_rate(_mean(areas)),
        ])  # fmt: skip
    return Table(header, rows)


def budget_table(domain: Domain) -> Table:
    """Return the mean F1 over the budgets of each attack, with half of the 95 % interval."""

    def mean(cases: Sequence[Case], method: str) -> str:
        series = [domain.series(method, case) for case in cases]
        rates = [domain.results.counts(one).f1 for one in series]
        return format_spread(float(np.mean(rates)) if rates else float("nan"), domain.results.interval(series, f1))

    rows = {"*benign*": [BENIGN]} | {f"{name} ({FAMILY[name]})": domain.cases_of(name) for name in domain.attacks}
    return pivot("attack (family)", rows, _by_name(domain.methods), mean, "row")


def wedge_table(domain: Domain) -> Table:
    """Return precision / recall in the wedge at the largest budget, above the same with no return touched."""
    rows = []
    for attack, case in domain.strongest.items():
        if domain.has_wedge(case):
            befores = [domain.before(name, case)[0] for name in domain.methods]
            rows.append([attack, *(_pair(domain.counts(name, case, WEDGE)) for name in domain.methods)])
            untouched = zip(domain.methods, befores, strict=True)
            rows.append(["*untouched*", *(_pair(domain.counts(name, was, WEDGE)) for name, was in untouched)])
    return Table(["", *domain.methods], rows)


def area_table(domain: Domain) -> Table:
    """Return how many m² more than on clean sweeps are over-claimed / under-claimed at the largest budget."""

    def more(case: Case, method: str) -> str:
        counts, was = domain.counts(method, case), domain.counts(method, BENIGN)
        if case == BENIGN:
            return f"{counts.over_m2:.0f} / {counts.under_m2:.0f}"
        return f"{counts.over_m2 - was.over_m2:+.0f} / {counts.under_m2 - was.under_m2:+.0f}"

    return pivot("", {"*benign, in all*": BENIGN} | domain.strongest, _by_name(domain.methods), more)


def strength_table(domain: Domain) -> Table:
    """Return precision / recall in the wedge (of the view where there is none) for sectors, shares and offsets."""

    def rates(case: Case, method: str) -> str:
        return _pair(domain.counts(method, case, WEDGE if domain.has_wedge(case) else VIEW))

    cases = [case for case in domain.cases if case.kind == "strength" and not case.defense]
    return pivot("", {f"{case.name}, {case.level}": case for case in cases}, _by_name(domain.methods), rates)


def verdict_table(domain: Domain, most: int | None = None) -> Table:
    """Return who withstands which attack at every budget (up to ``most`` returns), and what the others lose."""

    def words(attack: str, method: str) -> str:
        return domain.verdict(method, attack, most).words()

    return pivot("", _by_name(domain.attacks), _by_name(domain.methods), words)


def corruption_table(domain: Domain) -> Table:
    """Return F1 at each severity of each corruption."""
    rows = [["*benign*", "", *(format_rate(domain.counts(name, BENIGN).f1) for name in domain.methods)]]
    for corruption in domain.plan.corruptions:
        for severity in map(str, domain.plan.severities):
            case = Case("corruption", corruption, severity)
            rates = [format_rate(domain.counts(name, case).f1) for name in domain.methods]
            rows.append([corruption if severity == "1" else "", severity, *rates])
    return Table(["corruption", "severity", *domain.methods], rows)


def _faced(domain: Domain) -> dict[str, Case]:
    """Return what the defenses face by name: nothing, every attack at its largest budget, every corruption."""
    spoilt = {f"{name}, {case.level}": case for name, case in domain.corrupted.items()}
    return {"*benign*": BENIGN} | domain.strongest | spoilt


def defense_table(domain: Domain, method: str) -> Table:
    """Return F1 of an estimator behind each defense, at the largest budget; in brackets in the wedge."""

    def rates(case: Case, defense: str) -> str:
        behind = replace(case, defense=defense)
        inside = domain.counts(method, behind, WEDGE).f1
        return format_rate(domain.counts(method, behind).f1) + ("" if isnan(inside) else f" ({format_rate(inside)})")

    return pivot("", _faced(domain), {"none": ""} | _by_name(domain.plan.defenses), rates)


def gain_table(domain: Domain) -> Table:
    """Return what each defense adds to F1: on clean sweeps / on average over the attacks at their largest budget."""

    def gains(defense: str, method: str) -> str:
        added = [
            domain.counts(method, replace(case, defense=defense)).f1 - domain.counts(method, case).f1
            for case in (BENIGN, *domain.strongest.values())
        ]
        return f"{_signed(added[0])} / {_signed(float(np.mean(added[1:])))}"

    return pivot("", _by_name(domain.plan.defenses), _by_name(domain.plan.defended), gains)


def _signed(gain: float) -> str:
    return "–" if isnan(gain) else f"{gain:+.3f}".replace("0.", ".", 1)


def caught_table(domain: Domain) -> Table:
    """Return the share of the attacker's returns that each defense drops, of the others, and how often it alarms."""

    def dropped(case: Case, defense: str) -> str:
        series = domain.series("", replace(case, defense=defense))
        if series not in domain.results:
            return "–"
        alarms = domain.results.numbers(series, "alarm")
        if len(alarms):
            return f"alarm {alarms.mean():.2f}"
        caught, added, lost, others = (
            domain.results.numbers(series, name).sum() for name in ("caught", "added", "lost", "others")
        )
        return " / ".join(format_rate(part / whole if whole else float("nan")) for part, whole in
                          ((caught, added), (lost, others)))  # fmt: skip

    return pivot("", _faced(domain), _by_name(domain.plan.defenses), dropped)


def paper_table(domain: Domain) -> Table:
    """Return precision against the paper's label: benign, and under its attacks with the relative change."""

    def precision(method: str, case: Case) -> str:
        was, now = (domain.counts(method, one, protocol=PAPER).precision for one in (BENIGN, case))
        return format_rate(was) if case == BENIGN else f"{format_rate(now)} ({100 * (now - was) / was:+.0f} %)"

    cases = {"benign": BENIGN} | {f"{case.name} {case.level}".strip(): case for case in domain.paper_cases}
    return pivot("", _by_name(domain.paper_methods), cases, precision)


def fall_of(domain: Domain, method: str, case: Case) -> float:
    """Return the relative fall of pooled precision against the benign one of its protocol; NaN without results."""
    protocol = PAPER if case.kind == "paper" else STRICT
    was = domain.counts(method, BENIGN, protocol=protocol).precision
    return 1.0 - domain.counts(method, case, protocol=protocol).precision / was


def adaptive_table(domain: Domain) -> Table:
    """Return what each attacker who asks adds to the false area of a sweep, beside the worst attack that does not ask.

    All columns are of the same samples and the same budget.
    """
    met = domain.met("adaptive")

    def words(method: str, attack: str) -> str:
        case = met.asked(attack)
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
    """Return whether an attacker wants cells claimed that are not visible; else that visible ones are not claimed.

    >>> wants_over("adaptive_over_claim_free"), wants_over("adaptive_under_claim")
    (True, False)
    """
    return "over_claim" in attack


def _more(domain: Domain, method: str, case: Case, over: bool) -> str:
    losses = domain.losses(method, case)
    loss = max(losses.precision if over else losses.recall, 0.0)
    region = "" if domain.counts(method, case, WEDGE).cells else " of the view"
    return f"{domain.more_m2(method, case, over=over):+.0f} m² ({format_rate(loss)}{region})"


def known_defense_table(domain: Domain, attack: str) -> Table:
    """Return precision / recall in the wedge behind each defense: nobody attacks; the attacker asked; knew of both."""
    budget = str(domain.plan.adaptive_budget)
    kinds = {"untouched": ("adaptive", "0"), "defense not known": ("unaware", budget),
             "defense known": ("adaptive", budget)}  # fmt: skip

    def rates(defense: str, column: tuple[str, tuple[str, str]]) -> str:
        method, (kind, level) = column
        counts = domain.counts(method, Case(kind, attack, level, defense), WEDGE)
        return _pair(counts) if counts.cells and not isnan(counts.recall) else "–"

    defended = domain.plan.adaptive_defended
    columns = {f"{name}, {words}": (name, kind) for name in defended for words, kind in kinds.items()}
    return pivot("", {"*no defense*": ""} | _by_name(domain.plan.defenses), columns, rates)


def summary_table(domain: Domain) -> Table:
    """Return one line an estimator: its scores clean, attacked and corrupted, and how much it withstands.

    The best of each column is bold: the bar.
    """
    header = [
        "", "F1 clean [95 %]", "F1 attacked", "precision in the wedge", "recall in the wedge", "F1 corrupted",
        f"withstands, {MODEST} returns", "withstands, full wedge", "withstands, asked",
    ]  # fmt: skip
    rows = []
    for name in domain.methods:
        clean = domain.series(name, BENIGN)
        attacked = [domain.counts(name, case).f1 for case in domain.strongest.values()]
        wedges = [domain.counts(name, case, WEDGE) for case in domain.strongest.values()]
        spoilt = [domain.counts(name, case).f1 for case in domain.corrupted.values()]
        rows.append([
            name, format_interval(domain.results.counts(clean).f1, domain.results.interval(clean, f1)),
            format_rate(_mean(attacked)),
            format_rate(_mean([counts.precision for counts in wedges if counts.cells])),
            format_rate(_mean([counts.recall for counts in wedges if counts.cells])),
            format_rate(_mean(spoilt)),
            *(_withstood([domain.verdict(name, attack, most).withstands for attack in domain.attacks])
              for most in (MODEST, None)),
            _withstood([domain.losses(name, domain.asked(attack)).withstands for attack in domain.plan.adaptive
                        if domain.met_attacker(name, attack)]) if domain.plan.adaptive else "–",
        ])  # fmt: skip
    return Table(header, best_of_columns(rows, ties=False))


def _mean(rates: Iterable[float]) -> float:
    known = [rate for rate in rates if not isnan(rate)]
    return float(np.mean(known)) if known else float("nan")


def _withstood(verdicts: Sequence[bool]) -> str:
    return f"{sum(verdicts)} of {len(verdicts)}" if verdicts else "–"


def bar_overview(domains: Sequence[Domain], region: str) -> Table:
    """Return the best score under each attack at its largest budget and whose it is, for every domain."""
    attacks = list(dict.fromkeys(name for domain in domains for name in domain.attacks))
    rows = {"*benign*": BENIGN} | {name: domains[0].plan.strongest(name) for name in attacks}
    table = pivot("attack", rows, {domain.name: domain for domain in domains}, lambda c, d: leader(d, c, region))
    return Table(table.header, [row for row in table.rows if set(row[1:]) != {"–"}])


def leader(domain: Domain, case: Case, region: str) -> str:
    """Return the best F1 of a case with its interval, and whose it is; a dash where nobody has any."""
    every = [domain.series(name, case, region) for name in domain.methods]
    scored: dict[Series, float] = {one: domain.results.counts(one).f1 for one in every}
    scored = {series: rate for series, rate in scored.items() if not isnan(rate)}
    if not scored:
        return "–"
    best = max(scored, key=lambda series: scored[series])
    return f"{format_interval(scored[best], domain.results.interval(best, f1))} {best.method}"
