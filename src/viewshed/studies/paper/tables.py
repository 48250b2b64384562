"""The tables of both protocols' pages: figures of the 72 pairs as words.

The tables of attacks one by one: the strict protocol, in the view and in the attacker's wedge.

The tables beside the 72 pairs: trainings, trade study, monitor.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from typing import Any

import numpy as np

from viewshed._page import Table
from viewshed.studies.cases import BENIGN, Case
from viewshed.studies.monitor.study import Row, rows_of
from viewshed.studies.paper.data import Measured
from viewshed.studies.paper.jobs import DEFAULT
from viewshed.studies.paper.plan import StudyPlan
from viewshed.studies.paper.protocols import MIXTURES, VARIANTS, setting_of
from viewshed.studies.paper.results import (
    MEASURES,
    ORDER,
    UNTOUCHED,
    VIEW,
    WEDGE,
    PairKey,
    Results,
    StrictKey,
    SubTable,
    accuracy,
    targets_of,
)
from viewshed.studies.robustness.results import f1, precision, recall
from viewshed.studies.robustness.tables import three
from viewshed.threats.attacks import ATTACKS, FAMILY


def training_table(results: Results, protocol: str) -> Table:
    """Return how each training of a protocol went."""
    rows = [[name, *_trained(line)] for (of, name), line in results.models.items() if of == protocol]
    header = ["model", "epochs", "best", "validation loss", "validation F1", "frames/s", "in the network", "seconds"]
    return Table(header, rows)


def _trained(line: dict[str, Any]) -> list[str]:
    epoch = line["history"][line["best"] - 1]
    scores = [f"{epoch['validation_loss']:.4f}", three(epoch["f1"])]
    speed = [f"{line['frames_per_s']:.0f}", f"{100 * line['network_share']:.0f} %", f"{line['seconds']:.0f}"]
    return [str(len(line["history"])), str(line["best"]), *scores, *speed]


def trade_rows(results: Results) -> list[dict[str, Any]]:
    """Return the networks of the trade study by cells, depth and width, with what each scores as ``measured``."""
    lines = [
        line | {"shape": _shape(line), "measured": Measured.from_json(line["scores"]["network"]["benign"])}
        for line in results.others.get("trade", {}).values()
    ]
    return sorted(lines, key=lambda line: line["shape"][::-1])


def _shape(line: dict[str, Any]) -> tuple[int, ...]:
    """Return width, depth and cells."""
    return tuple(map(int, line["job"][1:]))


def trade_table(results: Results) -> Table:
    """Return what each network of the trade study scores, how long a pass takes, and its size."""
    rows = []
    for line in trade_rows(results):
        pooled, latency = line["measured"].counts.sum(axis=0), line["latency_ms"]
        rates = [three(float(measure(pooled))) for measure in (precision, accuracy, f1)]
        sizes = [f"{line['parameters'] / 1e6:.3f}", f"{line['flops'] / 1e9:.3f}"]
        rows.append([*map(str, line["shape"]), *rates, f"{latency['2']:.2f}", f"{latency['1']:.2f}", *sizes])
    header = ["width", "depth", "cells", "precision", "accuracy", "F1", "ms, 2 threads", "ms, 1 thread"]
    return Table([*header, "parameters, M", "GFLOP"], rows)


def monitor_rows(results: Results) -> dict[str, list[Row]]:
    """Return what the monitor does in each case, by what its network was trained on."""
    seed, found = results.store.plan.test_seed, results.others.get("monitor", {})
    return {mixture: rows_of(found[mixture]["lines"], seed) for mixture in MIXTURES if mixture in found}


def monitor_table(results: Results, kind: str) -> Table:
    """Return AUROC, its interval, detections at 1 % and alarms for every attack or corruption.

    Args:
        results: of the study.
        kind: ``attack`` or ``corruption``.
    """
    found = monitor_rows(results)
    words = ["AUROC [95 %]", "caught at 1 %", "alarms", "AUROC of the mean"]
    header = [kind, *(f"{word}, {mixture}-trained" for mixture in found for word in words)]
    rows: dict[str, list[str]] = {}
    for each in found.values():
        for row in each:
            if row.kind in ("benign", kind):
                rows.setdefault(_called(row), []).extend(_monitor_row(row))
    return Table(header, [[name, *cells] for name, cells in rows.items()])


def _called(row: Row) -> str:
    return (
        "*benign*" if row.kind == "benign" else f"{row.name} ({FAMILY[row.name]})" if row.name in FAMILY else row.name
    )


def _monitor_row(row: Row) -> list[str]:
    area = "–" if isnan(row.auroc) else f"{three(row.auroc)} [{three(row.auroc_low)}, {three(row.auroc_high)}]"
    return [area, three(row.caught), three(row.alarms), three(row.auroc_mean)]


def two(rate: float) -> str:
    """Return a rate in hundredths, as the paper does; a dash for none.

    >>> two(0.954), two(float("nan")), two(1.0)
    ('.95', '–', '1.00')
    """
    return "–" if isnan(rate) else f"{rate:.2f}".removeprefix("0")


def best(row: Sequence[str], first: int = 1) -> list[str]:
    """Return a row with its largest figure from cell ``first`` on in bold; cells begin with their figure.

    >>> best(["a", ".912 ±.004", ".930 ±.010", "–"])
    ['a', '.912 ±.004', '**.930 ±.010**', '–']
    """
    figures = [float(cell.split()[0]) if cell[:1] == "." or cell[:2] == "1." else -1.0 for cell in row[first:]]
    most = max(figures, default=-1.0)
    told = (f"**{cell}**" if figure == most >= 0 else cell for cell, figure in zip(row[first:], figures, strict=True))
    return [*row[:first], *told]


def domains_of(plan: StudyPlan) -> list[str]:
    """Return the domains of a plan in the paper's order."""
    return [*(name for name in ORDER if name in plan.domains), *(name for name in plan.domains if name not in ORDER)]


def pair_table(results: Results, protocol: str, table: SubTable) -> Table:
    """Return precision, recall, accuracy, F1 of nine pairs in the paper's layout, its figures below ours."""
    domains, rows = domains_of(results.store.plan), []
    for test in domains:
        keys = [table.key(protocol, test, train) for train in domains]
        rows.append([test, *(_four([results.pooled(key, measure) for measure in MEASURES.values()]) for key in keys)])
        rows.append(["*95 % of F1*", *(_bounds(results, key) for key in keys)])
        if table.published and protocol == "paper":
            told = (table.published.get((test, train), (float("nan"),) * 4) for train in domains)
            rows.append(["*the paper*", *(" ".join(map(two, figures)) for figures in told)])
    return Table(["tested on \\ trained on", *domains], rows)


def _four(figures: Sequence[float]) -> str:
    """Return precision, recall, accuracy in hundredths and F1 in thousandths."""
    return "–" if isnan(figures[0]) and isnan(figures[2]) else " ".join([*map(two, figures[:3]), three(figures[3])])


def _bounds(results: Results, key: PairKey) -> str:
    low, high = results.bounds(key, f1)
    return "–" if isnan(low) else f"{three(low)} to {three(high)}"


def area_table(results: Results, protocol: str, table: SubTable) -> Table:
    """Return AUPRC of nine pairs in the paper's layout."""
    domains = domains_of(results.store.plan)
    rows = [
        [test, *(_area(results, table.key(protocol, test, train)) for train in domains)] for test in domains
    ]  # fmt: skip
    return Table(["AUPRC, tested on \\ trained on", *domains], rows)


def _area(results: Results, key: PairKey) -> str:
    return three(results.pairs[key].scores.auprc()) if key in results.pairs else "–"


def target_table(results: Results) -> Table:
    """Return the targets of the paper's protocol, met or missed, beside the paper's figures."""
    rows = [
        [
            target.what,
            two(target.published),
            f"≥ {two(target.least)}",
            three(target.found),
            target.verdict,
            three(target.at_half),
        ]
        for target in targets_of(results)
    ]
    return Table(["what", "the paper", "target", "here", "", "here, threshold .5"], rows)


def contestants_of(results: Results, protocol: str, domain: str) -> list[str]:
    """Return who was tried on a domain's sweeps: the networks trained there, then the classical estimators."""
    networks = [f"{variant}-{mixture}-{domain}" for variant in VARIANTS for mixture in MIXTURES]
    names = [*networks, *setting_of(results.store.plan, protocol, domain).classical()]
    return [name for name in names if PairKey(protocol, name, "benign", domain) in results.pairs]


def own_name(contestant: str, domain: str) -> str:
    """Return a contestant's name on the sweeps of its own domain.

    >>> own_name("mle-benign-ugv", "ugv"), own_name("majority_vote", "ugv")
    ('mle-benign', 'majority_vote')
    """
    return contestant.removesuffix(f"-{domain}")


def mixture_table(results: Results, protocol: str, domain: str) -> Table:
    """Return everything about benign and attacked sweeps of a domain, networks trained there beside the classical."""
    header = [
        "",
        *(f"{word}, {mixture}" for mixture in MIXTURES for word in ("precision", "recall", "F1 [95 %]", "AUPRC")),
    ]
    rows = []
    for name in contestants_of(results, protocol, domain):
        row = [own_name(name, domain)]
        for mixture in MIXTURES:
            key = PairKey(protocol, name, mixture, domain)
            low, high = results.bounds(key, f1)
            rates = [three(results.pooled(key, MEASURES[word])) for word in ("precision", "recall", "F1")]
            row += [*rates[:2], f"{rates[2]} [{three(low)}, {three(high)}]", _area(results, key)]
        rows.append(row)
    return Table(header, best_of_columns(rows))


def best_of_columns(rows: Sequence[Sequence[str]], columns: Sequence[int] | None = None) -> list[list[str]]:
    """Return rows with the largest figure of each column (or of some) in bold.

    >>> best_of_columns([["a", ".1", ".7"], ["b", ".2", ".3"]])
    [['a', '.1', '**.7**'], ['b', '**.2**', '.3']]
    """
    if not rows:
        return []
    turned = [list(column) for column in zip(*rows, strict=True)]
    chosen = range(1, len(turned)) if columns is None else columns
    for place in chosen:
        turned[place] = best(["", *turned[place]])[1:]
    return [list(row) for row in zip(*turned, strict=True)]


def calibration_table(results: Results, protocol: str, domain: str) -> Table:
    """Return ECE, Brier score and AURC on benign and attacked sweeps; less is better; of MCD also by its deviation."""
    words = ("ECE", "Brier", "AURC", "AURC by deviation")
    rows = []
    for name in contestants_of(results, protocol, domain):
        row = [own_name(name, domain)]
        for mixture in MIXTURES:
            scores = results.pairs[PairKey(protocol, name, mixture, domain)].scores
            row += [f"{value:.4f}" if not isnan(value) else "–"
                    for value in (scores.ece(), scores.brier(), scores.aurc(), scores.aurc_std())]  # fmt: skip
        rows.append(row)
    return Table(["", *(f"{word}, {mixture}" for mixture in MIXTURES for word in words)], rows)


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
        rows.append(best([_labeled(results, case), *cells]))
    return Table(["attack (family)", *names], rows)


def wedge_table(results: Results, domain: str) -> Table:
    """Return precision / recall / F1 in the wedge under every attack that has one, above the same left untouched."""
    names, rows = who(results, domain), []
    for case in attacked_cases(results, domain):
        if results.has_wedge(domain, case):
            keys = [StrictKey(domain, case, name) for name in names]
            rows.append([_labeled(results, case), *_three_each(results, keys, WEDGE)])
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


def _labeled(results: Results, case: Case) -> str:
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
            vote = results.under(StrictKey(domain, case, "majority_vote"), f1, columns)
            rows.append(
                [_case_label(results, case), where, *best(["", one[1], other[1]])[1:], one[0], other[0], three(vote)]
            )
    header = ["attack (family)", "where", "best network's F1", "best classical F1", "which network", "which classical",
              "majority_vote"]  # fmt: skip
    return Table(header, rows)


def _case_label(results: Results, case: Case) -> str:
    return "*benign*" if case == BENIGN else _labeled(results, case)


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
