"""The tables of attacks one by one: the strict protocol, in the view and in the attacker's wedge."""

from __future__ import annotations

from math import isnan

import numpy as np

from viewshed.attacks import ATTACKS, FAMILY
from viewshed.reproduce.protocols import MIXTURES, VARIANTS
from viewshed.reproduce.results import UNTOUCHED, VIEW, WEDGE, Results, StrictKey
from viewshed.reproduce.strict import DEFAULT
from viewshed.reproduce.tables import best
from viewshed.vulnerability.cases import BENIGN, Case
from viewshed.vulnerability.page import Table
from viewshed.vulnerability.results import f1, precision, recall
from viewshed.vulnerability.tables import three

NETWORKS = tuple(f"{variant}-{mixture}" for variant in VARIANTS for mixture in MIXTURES)


def who(results: Results, domain: str) -> list[str]:
    """Return who faced the attacks in a domain: networks first, then the classical estimators."""
    return list(dict.fromkeys(key.contestant for key in results.strict if key.domain == domain))


def attacked_cases(results: Results, domain: str) -> list[Case]:
    """Return the attacks with their default budgets of which there are results, in the order of their table."""
    there = {key.case for key in results.strict if key.domain == domain}
    return [case for name in ATTACKS if (case := Case("attack", name, DEFAULT)) in there]


def view_table(results: Results, domain: str) -> Table:
    """Return F1 of the whole view under every attack, with half of its 95 % interval; the best in bold."""
    names = who(results, domain)
    rows = [best(["*benign*", *(_with_spread(results, StrictKey(domain, BENIGN, name)) for name in names)])]
    for case in attacked_cases(results, domain):
        cells = (_with_spread(results, StrictKey(domain, case, name)) for name in names)
        rows.append(best([_labelled(results, case), *cells]))
    return Table(["attack (family)", *names], rows)


def wedge_table(results: Results, domain: str) -> Table:
    """Return precision / recall / F1 in the wedge under every attack that has one, above the same left untouched."""
    names, rows = who(results, domain), []
    for case in attacked_cases(results, domain):
        if results.has_wedge(domain, case):
            keys = [StrictKey(domain, case, name) for name in names]
            rows.append([_labelled(results, case), *_three_each(results, keys, WEDGE)])
            rows.append(["*untouched*", *_three_each(results, keys, UNTOUCHED)])
    return Table(["attack (family)", *names], rows)


def _three_each(results: Results, keys: list[StrictKey], columns: slice) -> list[str]:
    """Return precision / recall / F1 of each, the best F1 in bold."""
    scores = [results.under(key, f1, columns) for key in keys]
    most = max((score for score in scores if not isnan(score)), default=float("nan"))
    cells = []
    for key, score in zip(keys, scores, strict=True):
        told = " / ".join(three(results.under(key, measure, columns)) for measure in (precision, recall))
        cells.append(f"**{told} / {three(score)}**" if score == most else f"{told} / {three(score)}")
    return cells


def _with_spread(results: Results, key: StrictKey) -> str:
    low, high = results.under_bounds(key, f1)
    return three(results.under(key, f1)) + ("" if isnan(low) else f" ±{three((high - low) / 2)}")


def _labelled(results: Results, case: Case) -> str:
    """Return an attack's name and family, with a star if the adversarial models were trained on it."""
    star = " \\*" if case.name in results.store.plan.trained_attacks else ""
    return f"{case.name} ({FAMILY[case.name]}){star}"


def winner_table(results: Results, domain: str) -> Table:
    """Return who has the largest F1 under each attack, and the best network beside the best classical estimator."""
    names = who(results, domain)
    classical = [name for name in names if name not in NETWORKS]
    networks = [name for name in names if name in NETWORKS]
    rows = []
    for case in [BENIGN, *attacked_cases(results, domain)]:
        for where, columns in (("view", VIEW), ("wedge", WEDGE)):
            if where == "wedge" and not results.has_wedge(domain, case):
                continue
            one, other = (_leader(results, (domain, case), group, columns) for group in (networks, classical))
            vote = results.under(StrictKey(domain, case, "vote"), f1, columns)
            rows.append([_told(results, case), where, *best(["", one[1], other[1]])[1:], one[0], other[0], three(vote)])
    header = ["attack (family)", "where", "best network's F1", "best classical F1", "which network", "which classical",
              "vote"]  # fmt: skip
    return Table(header, rows)


def _told(results: Results, case: Case) -> str:
    return "*benign*" if case == BENIGN else _labelled(results, case)


def _leader(results: Results, where: tuple[str, Case], names: list[str], columns: slice) -> tuple[str, str]:
    scored = {name: results.under(StrictKey(*where, name), f1, columns) for name in names}
    scored = {name: score for name, score in scored.items() if not isnan(score)}
    if not scored:
        return "–", "–"
    first = max(scored, key=lambda name: scored[name])
    return first, three(scored[first])


def seen_table(results: Results, domain: str) -> Table:
    """Return mean F1 over the attacks that models were trained on and over those that they were not."""
    names, rows = who(results, domain), []
    trained = results.store.plan.trained_attacks
    for words, seen in (("trained on", True), ("never seen", False)):
        cases = [case for case in attacked_cases(results, domain) if (case.name in trained) == seen]
        for where, columns in (("view", VIEW), ("wedge", WEDGE)):
            chosen = [case for case in cases if where == "view" or results.has_wedge(domain, case)]
            means = [_mean(results, domain, chosen, name, columns) for name in names]
            rows.append(best([f"{words}, {where} (attacks: {len(chosen)})", *map(three, means)]))
    return Table(["mean F1 over attacks", *names], rows)


def _mean(results: Results, domain: str, cases: list[Case], name: str, columns: slice) -> float:
    values = [results.under(StrictKey(domain, case, name), f1, columns) for case in cases]
    return float(np.mean(values)) if values else float("nan")
