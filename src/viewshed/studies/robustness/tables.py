"""The tables of the report: pooled figures of one domain each, as words.

The short tables at the head of the report: one line an estimator, and one line an attack over all domains.

The tables about attackers who ask their victim, beside attacks that do the same to everybody.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isnan

import numpy as np

from viewshed._page import Table
from viewshed.metrics import ConfusionCounts
from viewshed.studies.cases import BENIGN, Case, strongest_case
from viewshed.studies.robustness.results import (
    MODEST,
    Block,
    Key,
    Results,
    Where,
    adaptive_verdict,
    attacks_of,
    cases_against,
    f1,
    has_wedge,
    losses_of,
    reference_of,
    verdict_of,
)
from viewshed.studies.suite import ENTRANTS
from viewshed.threats.attacks import FAMILY

PAPERS_FARTHEST = ("paper_quantized", "paper_continuous", "paper_concave_hull")
"""The paper's methods that the farthest return decides."""


def estimators_of(results: Results, domain: str, block: Block = "strict") -> list[str]:
    """Return the estimators of which there are results, the paper's first, then as in the table."""
    there = dict.fromkeys(key.estimator for key in results.scores if key.domain == domain and key.block == block)
    ours = list(ENTRANTS)
    return sorted(there, key=lambda name: (name in ours, ours.index(name) if name in ours else 0))


def three(rate: float) -> str:
    """Return a rate in thousandths; a dash for none.

    >>> three(0.12349), three(float("nan"))
    ('.123', '–')
    """
    return "–" if isnan(rate) else f"{rate:.3f}".removeprefix("0")


def benign_table(results: Results, domain: str) -> Table:
    """Return what each estimator scores on clean sweeps, with the interval of its F1."""
    header = ["", "precision", "recall", "F1 [95 %]", "IoU", "over m²", "under m²", "AUPRC"]
    rows = []
    for name in estimators_of(results, domain):
        key = Key(domain, "strict", BENIGN, name)
        low, high = results.interval([key], f1)
        areas = results.areas(key)
        rates = _rates(results.tally(key))
        rates[2] += f" [{three(low)}, {three(high)}]"
        rows.append([name, *rates, three(float(areas.mean())) if len(areas) else "–"])
    return Table(header, rows)


def _rates(tally: ConfusionCounts) -> list[str]:
    rates = [three(rate) for rate in (tally.precision, tally.recall, tally.f1, tally.iou)]
    return [*rates, f"{tally.over_m2:.0f}", f"{tally.under_m2:.0f}"]


def budget_table(results: Results, domain: str) -> Table:
    """Return the mean F1 over the budgets of each attack, with half of the 95 % interval."""
    names = estimators_of(results, domain)
    rows = [["*benign*", *(_mean(results, [Key(domain, "strict", BENIGN, name)]) for name in names)]]
    for attack in attacks_of(results, domain):
        cases = cases_against(results, domain, attack)
        row = [_mean(results, [Key(domain, "strict", case, name) for case in cases]) for name in names]
        rows.append([f"{attack} ({FAMILY[attack]})", *row])
    return Table(["attack (family)", *names], [_best(row) for row in rows])


def _mean(results: Results, keys: Sequence[Key]) -> str:
    low, high = results.interval(keys, f1)
    mean = float(np.mean([results.tally(key).f1 for key in keys])) if keys else float("nan")
    return three(mean) if isnan(low) else f"{three(mean)} ±{three((high - low) / 2)}"


def _best(row: list[str]) -> list[str]:
    """Return a row with its largest figure in bold."""
    figures = [float(cell.split()[0]) if cell[:1] == "." or cell[:2] == "1." else -1.0 for cell in row[1:]]
    best = max(figures)
    return [row[0], *(f"**{c}**" if f == best >= 0 else c for c, f in zip(row[1:], figures, strict=True))]


def wedge_table(results: Results, domain: str) -> Table:
    """Return precision / recall in the wedge at the largest budget, above the same in the wedge left alone."""
    names, rows = estimators_of(results, domain), []
    for attack in attacks_of(results, domain):
        keys = [Key(domain, "strict", strongest_case(results.study, attack), name) for name in names]
        if not has_wedge(results, keys[0]):
            continue
        befores = [reference_of(results, key)[0] for key in keys]
        rows.append([attack, *(_pair(results.tally(key, "wedge")) for key in keys)])
        rows.append(["*untouched*", *(_pair(results.tally(key, "wedge")) for key in befores)])
    return Table(["", *names], rows)


def _pair(tally: ConfusionCounts) -> str:
    return f"{three(tally.precision)} / {three(tally.recall)}"


def area_table(results: Results, domain: str) -> Table:
    """Return how many m² more than on clean sweeps are over-claimed / under-claimed at the largest budget."""
    names = estimators_of(results, domain)
    clean = [results.tally(Key(domain, "strict", BENIGN, name)) for name in names]
    rows = [["*benign, in all*", *(f"{tally.over_m2:.0f} / {tally.under_m2:.0f}" for tally in clean)]]
    for attack in attacks_of(results, domain):
        found = [results.tally(Key(domain, "strict", strongest_case(results.study, attack), name)) for name in names]
        rows.append([attack, *(_more(now, was) for now, was in zip(found, clean, strict=True))])
    return Table(["", *names], rows)


def _more(now: ConfusionCounts, was: ConfusionCounts) -> str:
    return f"{now.over_m2 - was.over_m2:+.0f} / {now.under_m2 - was.under_m2:+.0f}"


def strength_table(results: Results, domain: str) -> Table:
    """Return precision / recall in the wedge (of the view where there is none) for sectors, shares and offsets."""
    names = estimators_of(results, domain)
    cases = {key.case: None for key in results.scores if key.domain == domain and key.case.kind == "strength"}
    rows = []
    for case in (case for case in cases if not case.defense):
        keys = [Key(domain, "strict", case, name) for name in names]
        where: Where = "wedge" if has_wedge(results, keys[0]) else "view"
        rows.append([f"{case.name}, {case.level}", *(_pair(results.tally(key, where)) for key in keys)])
    return Table(["", *names], rows)


def verdict_table(results: Results, domain: str, most: int | None = None) -> Table:
    """Return who withstands which attack at every budget (up to ``most`` returns), and what the others lose."""
    names = estimators_of(results, domain)
    rows = [
        [attack, *(verdict_of(results, domain, attack, name, most).words() for name in names)]
        for attack in attacks_of(results, domain)
    ]
    return Table(["", *names], rows)


def corruption_table(results: Results, domain: str) -> Table:
    """Return F1 at each severity of each corruption."""
    names = estimators_of(results, domain)
    rows = [["*benign*", "", *(three(results.tally(Key(domain, "strict", BENIGN, name)).f1) for name in names)]]
    for corruption in results.study.corruptions:
        for severity in map(str, results.study.severities):
            case = Case("corruption", corruption, severity)
            found = [results.tally(Key(domain, "strict", case, name)).f1 for name in names]
            rows.append([corruption if severity == "1" else "", severity, *map(three, found)])
    return Table(["corruption", "severity", *names], rows)


def defense_table(results: Results, domain: str, estimator: str) -> Table:
    """Return F1 of an estimator behind each defense, at the largest budget; in brackets in the wedge."""
    faced = [BENIGN, *(strongest_case(results.study, name) for name in attacks_of(results, domain))]
    faced += [Case("corruption", name, str(results.study.defended_severity)) for name in results.study.corruptions]
    rows = []
    for case in faced:
        behind = [case, *(replace(case, defense=defense) for defense in results.study.defenses)]
        rows.append(
            [_named(case), *(_view_and_wedge(results, Key(domain, "strict", one, estimator)) for one in behind)]
        )
    return Table(["", "none", *results.study.defenses], rows)


def _named(case: Case) -> str:
    return {"benign": "*benign*", "corruption": f"{case.name}, {case.level}"}.get(case.kind, case.name)


def _view_and_wedge(results: Results, key: Key) -> str:
    inside = results.tally(key, "wedge").f1
    return three(results.tally(key).f1) + ("" if isnan(inside) else f" ({three(inside)})")


def gain_table(results: Results, domain: str) -> Table:
    """Return what each defense adds to F1: on clean sweeps / on average over the attacks at their largest budget."""
    attacked = [strongest_case(results.study, name) for name in attacks_of(results, domain)]
    rows = []
    for defense in results.study.defenses:
        row = [defense]
        for name in results.study.defended:
            gains = [_gain(results, Key(domain, "strict", case, name), defense) for case in (BENIGN, *attacked)]
            row.append(f"{_signed(gains[0])} / {_signed(float(np.mean(gains[1:])))}")
        rows.append(row)
    return Table(["", *results.study.defended], rows)


def _gain(results: Results, key: Key, defense: str) -> float:
    behind = replace(key, case=replace(key.case, defense=defense))
    return results.tally(behind).f1 - results.tally(key).f1


def _signed(gain: float) -> str:
    return "–" if isnan(gain) else f"{gain:+.3f}".replace("0.", ".", 1)


def caught_table(results: Results, domain: str) -> Table:
    """Return the share of the attacker's returns that each defense drops, of the others, and how often it alarms."""
    rows = [["*benign*", *(_lost(results, domain, replace(BENIGN, defense=d)) for d in results.study.defenses)]]
    for attack in attacks_of(results, domain):
        case = strongest_case(results.study, attack)
        rows.append([attack, *(_lost(results, domain, replace(case, defense=d)) for d in results.study.defenses)])
    for corruption in results.study.corruptions:
        case = Case("corruption", corruption, str(results.study.defended_severity))
        cells = (_lost(results, domain, replace(case, defense=d)) for d in results.study.defenses)
        rows.append([_named(case), *cells])
    return Table(["", *results.study.defenses], rows)


def _lost(results: Results, domain: str, case: Case) -> str:
    """Return ``caught / lost``, or ``alarm`` with its rate where the defense raises one."""
    values = results.judged.get((domain, case))
    if values is None:
        return "–"
    alarms = values[~np.isnan(values[:, 0]), 0]
    if len(alarms):
        return f"alarm {alarms.mean():.2f}"
    _, caught, added, lost, others = np.nansum(values, axis=0)
    shares = [f"{part / whole:.3f}".removeprefix("0") if whole else "–" for part, whole in
              ((caught, added), (lost, others))]  # fmt: skip
    return " / ".join(shares)


def paper_table(results: Results, domain: str) -> Table:
    """Return precision against the paper's label: benign, and under its attacks with the relative change."""
    cases = paper_cases(results, domain)
    rows = []
    for name in estimators_of(results, domain, "paper"):
        was = results.tally(Key(domain, "paper", BENIGN, name)).precision
        found = [results.tally(Key(domain, "paper", case, name)).precision for case in cases]
        rows.append([name, three(was), *(f"{three(now)} ({100 * (now - was) / was:+.0f} %)" for now in found)])
    return Table(["", "benign", *(f"{case.name} {case.level}".strip() for case in cases)], rows)


def paper_cases(results: Results, domain: str) -> list[Case]:
    """Return the cases of the paper's block but the benign one."""
    cases = {key.case: None for key in results.scores if key.domain == domain and key.block == "paper"}
    return [case for case in cases if case != BENIGN]


def fall_of(results: Results, domain: str, estimator: str, case: Case) -> float:
    """Return the relative fall of pooled precision against the benign one of its block; NaN without results."""
    block: Block = "paper" if case.kind == "paper" else "strict"
    was = results.tally(Key(domain, block, BENIGN, estimator)).precision
    return 1.0 - results.tally(Key(domain, block, case, estimator)).precision / was


def adaptive_table(results: Results, domain: str) -> Table:
    """Return what each attacker who asks adds to the false area of a sweep, beside the worst attack that does not ask.

    All columns are of the same samples and the same budget.
    """
    few, study = results.met(domain, "adaptive"), results.study
    header = ["", "over, worst of the others", "under, worst of the others", *study.adaptive]
    rows = []
    for name in estimators_of(few, domain):
        others = [_worst(few, domain, name, over) for over in (True, False)]
        rows.append([name, *others, *(_asked(few, domain, attack, name) for attack in study.adaptive)])
    return Table(header, rows)


def _asked(results: Results, domain: str, attack: str, estimator: str) -> str:
    key = Key(domain, "strict", Case("adaptive", attack, str(results.study.adaptive_budget)), estimator)
    over = wants_over(attack)
    return _words(results, key, over) if _there(results, key) else "–"


def wants_over(attack: str) -> bool:
    """Return whether an attacker wants cells claimed that are not visible; else that visible ones are not claimed.

    >>> wants_over("adaptive_over_claim_free"), wants_over("adaptive_under_claim")
    (True, False)
    """
    return "over_claim" in attack


def _worst(results: Results, domain: str, estimator: str, over: bool) -> str:
    """Return the attack with the same budget that adds most area, and what it does."""
    budget = str(results.study.adaptive_budget)
    keys = [Key(domain, "strict", Case("attack", name, budget), estimator) for name in attacks_of(results, domain)]
    keys = [key for key in keys if _there(results, key)]
    if not keys:
        return "–"
    worst = max(keys, key=lambda key: more_m2(results, key, over))
    return f"{worst.case.name} {_words(results, worst, over)}"


def _there(results: Results, key: Key) -> bool:
    return results.tally(key).cells > 0


def more_m2(results: Results, key: Key, over: bool) -> float:
    """Return how many m² more are over-claimed (or under-claimed) in a sweep than where no return is touched."""
    kind = key.case.kind
    was = reference_of(results, key)[0] if kind == "adaptive" else replace(key, case=BENIGN)
    before, now = results.tally(was), results.tally(key)
    return now.over_m2 - before.over_m2 if over else now.under_m2 - before.under_m2


def _words(results: Results, key: Key, over: bool) -> str:
    loss = losses_of(results, key)[1 if over else 2]
    where = "" if has_wedge(results, key) else " of the view"
    return f"{more_m2(results, key, over):+.0f} m² ({three(loss) if loss >= 0 else three(0.0)}{where})"


def duel_table(results: Results, domain: str, attack: str) -> Table:
    """Return precision / recall in the wedge behind each defense: nobody attacks; the attacker asked; knew of both."""
    study = results.study
    header = [""] + [f"{name}, {words}" for name in study.adaptive_defended for words in _KNOWING]
    rows = [["*no defense*", *_row(results, domain, attack, "")]]
    rows += [[defense, *_row(results, domain, attack, defense)] for defense in study.defenses]
    return Table(header, rows)


_KNOWING = ("untouched", "defense not known", "defense known")


def _row(results: Results, domain: str, attack: str, defense: str) -> Sequence[str]:
    budget, cells = str(results.study.adaptive_budget), []
    kinds = (("adaptive", "0"), ("unaware", budget), ("adaptive", budget))
    for name in results.study.adaptive_defended:
        cells += [_wedge_pair(results, Key(domain, "strict", Case(k, attack, n, defense), name)) for k, n in kinds]
    return cells


def _wedge_pair(results: Results, key: Key) -> str:
    tally = results.tally(key, "wedge")
    return f"{three(tally.precision)} / {three(tally.recall)}" if tally.cells and not isnan(tally.recall) else "–"


def summary_table(results: Results, domain: str) -> Table:
    """Return one line an estimator: its scores clean, attacked and corrupted, and how much it withstands.

    The best of each column is bold: the bar.
    """
    header = [
        "", "F1 clean [95 %]", "F1 attacked", "precision in the wedge", "recall in the wedge", "F1 corrupted",
        f"withstands, {MODEST} returns", "withstands, full wedge", "withstands, asked",
    ]  # fmt: skip
    return Table(header, _bold([[name, *_line(results, domain, name)] for name in estimators_of(results, domain)]))


def _line(results: Results, domain: str, name: str) -> list[str]:
    attacked = [Key(domain, "strict", strongest_case(results.study, a), name) for a in attacks_of(results, domain)]
    wedged = [results.tally(key, "wedge") for key in attacked if has_wedge(results, key)]
    clean, severity = Key(domain, "strict", BENIGN, name), str(results.study.defended_severity)
    spoilt = [Key(domain, "strict", Case("corruption", c, severity), name) for c in results.study.corruptions]
    low, high = results.interval([clean], f1)
    return [
        f"{three(results.tally(clean).f1)} [{three(low)}, {three(high)}]",
        three(_mean_rate([results.tally(key).f1 for key in attacked])),
        three(_mean_rate([tally.precision for tally in wedged])),
        three(_mean_rate([tally.recall for tally in wedged])),
        three(_mean_rate([results.tally(key).f1 for key in spoilt])),
        *(_withstood(results, domain, name, most) for most in (MODEST, None)),
        _withstood_asked(results, domain, name),
    ]


def _mean_rate(rates: Sequence[float]) -> float:
    there = [rate for rate in rates if not isnan(rate)]
    return float(np.mean(there)) if there else float("nan")


def _withstood(results: Results, domain: str, name: str, most: int | None) -> str:
    attacks = attacks_of(results, domain)
    return f"{sum(verdict_of(results, domain, a, name, most).withstands for a in attacks)} of {len(attacks)}"


def _withstood_asked(results: Results, domain: str, name: str) -> str:
    attacks = [a for a in results.study.adaptive if met_by(results, domain, a, name)]
    held = sum(adaptive_verdict(results, domain, a, name).withstands for a in attacks)
    return f"{held} of {len(attacks)}" if attacks else "–"


def met_by(results: Results, domain: str, attack: str, estimator: str) -> bool:
    """Return whether there are results of an attacker who asked this estimator."""
    case = Case("adaptive", attack, str(results.study.adaptive_budget))
    return results.tally(Key(domain, "strict", case, estimator)).cells > 0


def _bold(rows: list[list[str]]) -> list[list[str]]:
    """Return the rows with the largest figure of each column in bold, unless all are equal."""
    columns = list(zip(*rows, strict=True))
    figures = [[_figure(cell) for cell in column] for column in columns]
    best = [max(column, default=-1.0) if len(set(column)) > 1 else np.inf for column in figures]
    return [
        [row[0], *(f"**{cell}**" if _figure(cell) == best[k] else cell for k, cell in enumerate(row[1:], 1))]
        for row in rows
    ]


def _figure(cell: str) -> float:
    word = cell.partition(" ")[0]
    return float(word) if word.replace(".", "", 1).isdecimal() else -1.0


def bar_overview(results: Results, where: Where) -> Table:
    """Return the best score under each attack at its largest budget and whose it is, for every domain."""
    attacks = list(dict.fromkeys(name for domain in results.domains for name in attacks_of(results, domain)))
    rows = [["*benign*", *(leader(results, domain, BENIGN, where) for domain in results.domains)]]
    for name in attacks:
        case = strongest_case(results.study, name)
        rows.append([name, *(leader(results, domain, case, where) for domain in results.domains)])
    return Table(["attack", *results.domains], [row for row in rows if set(row[1:]) != {"–"}])


def leader(results: Results, domain: str, case: Case, where: Where) -> str:
    """Return the best F1 of a case with its interval, and whose it is; a dash where nobody has any."""
    keys = [Key(domain, "strict", case, name) for name in estimators_of(results, domain)]
    scored = {key: results.tally(key, where).f1 for key in keys if not isnan(results.tally(key, where).f1)}
    if not scored:
        return "–"
    best = max(scored, key=lambda key: scored[key])
    low, high = results.interval([best], f1, where)
    return f"{three(scored[best])} [{three(low)}, {three(high)}] {best.estimator}"
