"""The tables of both protocols' pages as words: the 72 pairs, attacks one by one, trainings, trade study, monitor."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan

import numpy as np

from viewshed._page import Table
from viewshed.studies.cases import DEFAULT
from viewshed.studies.formatting import (
    best_of_row,
    format_interval,
    format_rate,
    format_spread,
    pivot,
)
from viewshed.studies.monitor.page import monitor_table as table_of_monitor
from viewshed.studies.monitor.page import rows_of
from viewshed.studies.paper.jobs import TRADE
from viewshed.studies.paper.plan import MIXTURES, VARIANTS
from viewshed.studies.paper.protocols import setting_of
from viewshed.studies.paper.published import PaperResults, SubTable, pair, targets_of
from viewshed.studies.records import BENIGN, PAPER, UNTOUCHED, VIEW, WEDGE, Case, Series
from viewshed.studies.statistics import MEASURES, accuracy, f1, precision, recall
from viewshed.threats.attacks import ATTACKS, FAMILY

NETWORKS = tuple(f"{variant}-{mixture}" for variant in VARIANTS for mixture in MIXTURES)


def training_table(results: PaperResults, protocol: str) -> Table:
    """Return how each training of a protocol went."""
    rows = []
    for (of, name), facts in results.models.items():
        epoch, share = facts["history"][facts["best"] - 1], 100 * facts["network_share"]
        rows.append([
            name, str(len(facts["history"])), str(facts["best"]), f"{epoch['validation_loss']:.4f}",
            format_rate(epoch["f1"]), f"{facts['frames_per_s']:.0f}", f"{share:.0f} %", f"{facts['seconds']:.0f}",
        ] if of == protocol else [])  # fmt: skip
    header = ["model", "epochs", "best", "validation loss", "validation F1", "frames/s", "in the network", "seconds"]
    return Table(header, [row for row in rows if row])


def trade_shapes(results: PaperResults) -> list[tuple[int, int, int]]:
    """Return width, depth and cells of the networks of the trade study that are done, by cells, depth and width."""
    shapes = [(int(key[1]), int(key[2]), int(key[3])) for key in results.trade.facts]
    return sorted(shapes, key=lambda shape: shape[::-1])


def trade_rates(results: PaperResults, shape: tuple[int, int, int]) -> tuple[dict[str, float], dict[str, float]]:
    """Return precision, accuracy and F1 of a network of the trade study, and its latency by threads in milliseconds."""
    facts = results.trade.facts["trade", *map(str, shape)]
    series = Series(results.plan.trade_domain, facts["name"], protocol=TRADE)
    measures = {"precision": precision, "accuracy": accuracy, "F1": f1}
    return {name: results.trade.rate(series, measure) for name, measure in measures.items()}, facts["latency_ms"]


def trade_table(results: PaperResults) -> Table:
    """Return what each network of the trade study scores, how long a pass takes, and its size."""
    rows = []
    for shape in trade_shapes(results):
        facts, (rates, latency) = results.trade.facts["trade", *map(str, shape)], trade_rates(results, shape)
        sizes = [f"{facts['parameters'] / 1e6:.3f}", f"{facts['flops'] / 1e9:.3f}"]
        times = [f"{latency['2']:.2f}", f"{latency['1']:.2f}"]
        rows.append([*map(str, shape), *map(format_rate, rates.values()), *times, *sizes])
    header = ["width", "depth", "cells", "precision", "accuracy", "F1", "ms, 2 threads", "ms, 1 thread"]
    return Table([*header, "parameters, M", "GFLOP"], rows)


def monitor_table(results: PaperResults, kind: str) -> Table:
    """Return what the monitor does in each attack or corruption, by what its network was trained on."""
    domain, seed = results.plan.monitor_domain, results.plan.test_seed
    methods = results.monitor.methods(domain)
    rows = {f"{name}-trained": rows_of(results.monitor, domain, name, seed) for name in MIXTURES if name in methods}
    return table_of_monitor(rows, kind)


def pair_table(results: PaperResults, protocol: str, table: SubTable) -> Table:
    """Return precision, recall, accuracy, F1 of nine pairs in the paper's layout, its figures below ours."""
    domains, rows = results.domains, []
    for test in domains:
        keys = [table.key(protocol, test, train) for train in domains]
        rows.append([test, *(_four(results, key) for key in keys)])
        rows.append(["*95 % of F1*", *(_bounds(results, key) for key in keys)])
        if table.published and protocol == PAPER:
            published = (table.published.get((test, train), (float("nan"),) * 4) for train in domains)
            rows.append(["*the paper*", *(" ".join(format_rate(rate, 2) for rate in rates) for rates in published)])
    return Table(["tested on \\ trained on", *domains], rows)


def _four(results: PaperResults, key: Series) -> str:
    """Return precision, recall, accuracy in hundredths and F1 in thousandths."""
    *rates, last = [results.pairs.rate(key, measure) for measure in MEASURES.values()]
    if isnan(rates[0]) and isnan(rates[2]):
        return "–"
    return " ".join([*(format_rate(rate, 2) for rate in rates), format_rate(last)])


def _bounds(results: PaperResults, key: Series) -> str:
    low, high = results.pairs.interval(key, f1)
    return "–" if isnan(low) else f"{format_rate(low)} to {format_rate(high)}"


def area_table(results: PaperResults, protocol: str, table: SubTable) -> Table:
    """Return AUPRC of nine pairs in the paper's layout."""
    names = {name: name for name in results.domains}
    return pivot("AUPRC, tested on \\ trained on", names, names,
                 lambda test, train: _area(results, table.key(protocol, test, train)))  # fmt: skip


def _area(results: PaperResults, key: Series) -> str:
    return format_rate(results.pairs.scores([key]).auprc())


def target_table(results: PaperResults) -> Table:
    """Return the targets of the paper's protocol, met or missed, beside the paper's figures."""
    rows = [
        [target.what, format_rate(target.published, 2), f"≥ {format_rate(target.least, 2)}", format_rate(target.found),
         target.verdict, format_rate(target.at_half)]
        for target in targets_of(results)
    ]  # fmt: skip
    return Table(["what", "the paper", "target", "here", "", "here, threshold .5"], rows)


def pair_methods(results: PaperResults, protocol: str, domain: str) -> dict[str, str]:
    """Return who was tried on a domain's sweeps: the networks trained there, by short name, then the classical ones."""
    networks = {name: f"{name}-{domain}" for name in NETWORKS}
    classical = {name: name for name in setting_of(results.plan, protocol, domain).classical()}
    return {
        short: name for short, name in (networks | classical).items()
        if pair(protocol, name, "benign", domain) in results.pairs
    }  # fmt: skip


def mixture_table(results: PaperResults, protocol: str, domain: str) -> Table:
    """Return everything about benign and attacked sweeps of a domain, networks trained there beside the classical."""
    words = ("precision", "recall", "F1 [95 %]", "AUPRC")

    def value(method: str, column: tuple[str, str]) -> str:
        mixture, word = column
        key = pair(protocol, method, mixture, domain)
        if word == "AUPRC":
            return _area(results, key)
        if word.startswith("F1"):
            return format_interval(results.pairs.rate(key, f1), results.pairs.interval(key, f1))
        return format_rate(results.pairs.rate(key, MEASURES[word]))

    columns = {f"{word}, {mixture}": (mixture, word) for mixture in MIXTURES for word in words}
    return pivot("", pair_methods(results, protocol, domain), columns, value, "column")


def calibration_table(results: PaperResults, protocol: str, domain: str) -> Table:
    """Return ECE, Brier score and AURC on benign and attacked sweeps; less is better; of MCD also by its deviation."""
    rows = []
    for short, name in pair_methods(results, protocol, domain).items():
        row = [short]
        for mixture in MIXTURES:
            scores = results.pairs.scores([pair(protocol, name, mixture, domain)])
            row += [f"{value:.4f}" if not isnan(value) else "–"
                    for value in (scores.ece(), scores.brier(), scores.aurc(), scores.aurc_std())]  # fmt: skip
        rows.append(row)
    words = ("ECE", "Brier", "AURC", "AURC by deviation")
    return Table(["", *(f"{word}, {mixture}" for mixture in MIXTURES for word in words)], rows)


def strict_methods(results: PaperResults, domain: str) -> list[str]:
    """Return who faced the attacks in a domain: networks first, then the classical estimators."""
    return results.strict.methods(domain)


def attacked_cases(results: PaperResults, domain: str) -> list[Case]:
    """Return the attacks with their default budgets of which there are results, in the order of their table."""
    found = results.strict.cases(domain)
    return [case for name in ATTACKS if (case := Case("attack", name, DEFAULT)) in found]


def has_wedge(results: PaperResults, domain: str, case: Case) -> bool:
    """Return whether any sweep of a case has cells in a wedge."""
    method = strict_methods(results, domain)[0]
    return results.strict.counts(Series(domain, method, case, WEDGE)).cells > 0


def view_table(results: PaperResults, domain: str) -> Table:
    """Return F1 of the whole view under every attack, with half of its 95 % interval; the best in bold."""

    def spread(case: Case, method: str) -> str:
        series = Series(domain, method, case)
        return format_spread(results.strict.rate(series, f1), results.strict.interval(series, f1))

    rows = {"*benign*": BENIGN} | {_labeled(results, case): case for case in attacked_cases(results, domain)}
    return pivot("attack (family)", rows, {name: name for name in strict_methods(results, domain)}, spread, "row")


def wedge_table(results: PaperResults, domain: str) -> Table:
    """Return precision / recall / F1 in the wedge under every attack that has one, above the same left untouched."""
    methods, rows = strict_methods(results, domain), []
    for case in attacked_cases(results, domain):
        if has_wedge(results, domain, case):
            for label, region in ((_labeled(results, case), WEDGE), ("*untouched*", UNTOUCHED)):
                rows.append([label, *_best_f1(results, [Series(domain, name, case, region) for name in methods])])
    return Table(["attack (family)", *methods], rows)


def _best_f1(results: PaperResults, series: Sequence[Series]) -> list[str]:
    """Return precision / recall / F1 of each, the best F1 in bold."""
    every = [[results.strict.rate(one, measure) for measure in (precision, recall, f1)] for one in series]
    most = max((rates[2] for rates in every if not isnan(rates[2])), default=float("nan"))
    words = [" / ".join(map(format_rate, rates)) for rates in every]
    return [f"**{cell}**" if rates[2] == most else cell for cell, rates in zip(words, every, strict=True)]


def _labeled(results: PaperResults, case: Case) -> str:
    """Return an attack's name and family, with a star if the adversarial models were trained on it."""
    star = " \\*" if case.name in results.plan.trained_attacks else ""
    return "*benign*" if case == BENIGN else f"{case.name} ({FAMILY[case.name]}){star}"


def winner_table(results: PaperResults, domain: str) -> Table:
    """Return who has the largest F1 under each attack, and the best network beside the best classical estimator."""
    names = strict_methods(results, domain)
    groups = [name for name in names if name in NETWORKS], [name for name in names if name not in NETWORKS]
    rows = []
    for case in [BENIGN, *attacked_cases(results, domain)]:
        for region in (VIEW, WEDGE):
            if region == VIEW or has_wedge(results, domain, case):
                one, other = (_leader(results, [Series(domain, name, case, region) for name in group])
                              for group in groups)  # fmt: skip
                vote = format_rate(results.strict.rate(Series(domain, "majority_vote", case, region), f1))
                best = best_of_row(["", one[1], other[1]])[1:]
                rows.append([_labeled(results, case), region, *best, one[0], other[0], vote])
    header = ["attack (family)", "where", "best network's F1", "best classical F1", "which network", "which classical",
              "majority_vote"]  # fmt: skip
    return Table(header, rows)


def _leader(results: PaperResults, series: Sequence[Series]) -> tuple[str, str]:
    scored = {one.method: results.strict.rate(one, f1) for one in series}
    scored = {name: rate for name, rate in scored.items() if not isnan(rate)}
    if not scored:
        return "–", "–"
    first = max(scored, key=lambda name: scored[name])
    return first, format_rate(scored[first])


def seen_table(results: PaperResults, domain: str) -> Table:
    """Return mean F1 over the attacks that models were trained on and over those that they were not."""
    names, rows = strict_methods(results, domain), []
    for words, seen in (("trained on", True), ("never seen", False)):
        trained = results.plan.trained_attacks
        cases = [case for case in attacked_cases(results, domain) if (case.name in trained) == seen]
        for region in (VIEW, WEDGE):
            chosen = [case for case in cases if region == VIEW or has_wedge(results, domain, case)]
            rates = [[results.strict.rate(Series(domain, name, case, region), f1) for case in chosen] for name in names]
            means = [format_rate(float(np.mean(each)) if each else float("nan")) for each in rates]
            rows.append(best_of_row([f"{words}, {region} (attacks: {len(chosen)})", *means]))
    return Table(["mean F1 over attacks", *names], rows)
