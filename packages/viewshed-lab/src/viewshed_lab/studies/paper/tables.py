"""The tables of both protocols' pages: the 72 pairs, single attacks, trainings, trade study, monitor."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan

import numpy as np

from viewshed.metrics import ConfusionCounts
from viewshed_lab.data.drive import OBJECT_KINDS
from viewshed_lab.data.simulated import ScenePlan, scan_frame, world_of
from viewshed_lab.studies.cases import DEFAULT
from viewshed_lab.studies.formatting import (
    CALIBRATION,
    best_of_row,
    by_name,
    calibration_of,
    format_interval,
    format_rate,
    format_rates,
    format_spread,
    lines,
    pivot,
)
from viewshed_lab.studies.pages import Table
from viewshed_lab.studies.paper.data import preset_of
from viewshed_lab.studies.paper.jobs import TRADE
from viewshed_lab.studies.paper.models import chosen_of, fold_scores
from viewshed_lab.studies.paper.monitor import rows_of
from viewshed_lab.studies.paper.plan import MIXTURES, VARIANTS, PaperPlan
from viewshed_lab.studies.paper.protocols import setting_of
from viewshed_lab.studies.paper.published import TESTED_ON, PaperResults, SubTable, targets_of
from viewshed_lab.studies.records import BENIGN, PAPER, UNTOUCHED, VIEW, WEDGE, Case, Domain, Series
from viewshed_lab.studies.statistics import f1
from viewshed_lab.threats.attacks import ATTACKS, FAMILY

NETWORKS = tuple(f"{variant}-{mixture}" for variant in VARIANTS for mixture in MIXTURES)

OBJECT_SCENES, MIN_BEAMS = 10, 5

StrictDomain = Domain[PaperPlan]
"""Results of the step ``strict`` in one domain."""


def training_table(results: PaperResults, protocol: str) -> Table:
    """Return the table of the trainings of a protocol."""
    models = {name: facts for (of, name), facts in results.models.items() if of == protocol}
    best = {name: facts["history"][facts["best"] - 1] for name, facts in models.items()}
    return lines("model", by_name(models), {
        "epochs": lambda name: str(len(models[name]["history"])),
        "best": lambda name: str(models[name]["best"]),
        "validation loss": lambda name: f"{best[name]['validation_loss']:.4f}",
        "validation F1": lambda name: format_rate(best[name]["f1"]),
        "frames/s": lambda name: f"{models[name]['frames_per_s']:.0f}",
        "in the network": lambda name: f"{100 * models[name]['network_share']:.0f} %",
        "seconds": lambda name: f"{models[name]['seconds']:.0f}",
    })  # fmt: skip


def fold_table(results: PaperResults) -> Table | None:
    """Return the table of the folds' F1 by setting of cross-validation, the chosen one bold; None without any."""
    scores = fold_scores(results.plan, results.store.folder)
    chosen, rows = chosen_of(results.plan, results.store.folder), []
    for setting in sorted(scores):
        f1s = np.array([score.f1 for score in scores[setting]])
        name = f"**{setting.name}**" if setting == chosen else setting.name
        rows.append([name, str(len(f1s)), *(format_rate(float(of(f1s))) for of in (np.mean, np.min, np.max))])
    return Table(["setting", "folds", "mean F1", "lowest", "highest"], rows) if rows else None


def object_table(results: PaperResults) -> Table:
    """Return the table of the mean number of vehicles and people: those that an agent's beams hit, and in a scene."""
    rows = []
    for domain in results.domains:
        preset = preset_of(results.plan, domain, "test")
        seen, present = list[int](), list[int]()
        for number in range(min(preset.scenes[0], OBJECT_SCENES)):
            plan = ScenePlan(preset, 0, number)
            things = world_of(plan).things
            objects = [index for index, thing in enumerate(things) if thing.kind in OBJECT_KINDS]
            present.append(len(objects))
            for agent in range(preset.agents):
                beams = np.bincount(np.maximum(scan_frame(plan, agent)[0].thing, -1).ravel() + 1, minlength=2)[1:]
                seen.append(sum(int(index < len(beams) and beams[index] >= MIN_BEAMS) for index in objects))
        rows.append([domain, f"{np.mean(seen):.1f}", f"{np.mean(present):.1f}", str(len(present))])
    return Table(["domain", f"met by {MIN_BEAMS} beams or more, an agent", "in a scene", "scenes"], rows)


def trade_counts(results: PaperResults) -> dict[tuple[int, int, int], ConfusionCounts]:
    """Return the counts of the networks of the trade study by (cells, depth, width), in ascending order."""
    domain = Domain(results.trade, results.plan.trade_domain, TRADE)
    shapes = {(int(key[3]), int(key[2]), int(key[1])): facts["name"] for key, facts in results.trade.facts.items()}
    return {shape: domain.counts(shapes[shape]) for shape in sorted(shapes)}


def trade_facts(results: PaperResults, shape: tuple[int, int, int]) -> dict[str, float]:
    """Return latency in milliseconds and size of a trade study network of shape (cells, depth, width), by label."""
    facts = results.trade.facts["trade", *map(str, shape[::-1])]
    ms = facts["latency_ms"]
    return {
        "ms, 2 threads": ms["2"],
        "ms, 1 thread": ms["1"],
        "M": facts["parameters"] / 1e6,
        "G": facts["flops"] / 1e9,
    }


def trade_table(results: PaperResults) -> Table | None:
    """Return the table of scores, latency and size of the trade study's networks; None without any."""
    rows = []
    for shape, counts in trade_counts(results).items():
        facts, rates = trade_facts(results, shape), (counts.precision, counts.accuracy, counts.f1)
        times, sizes = (f"{facts['ms, 2 threads']:.2f}", f"{facts['ms, 1 thread']:.2f}"), (facts["M"], facts["G"])
        rows.append([*map(str, shape[::-1]), *map(format_rate, rates), *times, *(f"{size:.3f}" for size in sizes)])
    header = ["width", "depth", "cells", "precision", "accuracy", "F1", "ms, 2 threads", "ms, 1 thread"]
    return Table([*header, "parameters, M", "GFLOP"], rows) if rows else None


def monitor_table(results: PaperResults, kind: str) -> Table | None:
    """Return the table of the monitor's figures for every attack or corruption; None without any.

    AUROC with its interval, detections at 1 %, alarms and AUROC of the mean, by training mixture of the network.
    """
    domain = Domain(results.monitor, results.plan.monitor_domain)
    trained = [name for name in MIXTURES if name in domain.methods]
    words = ("AUROC [95 %]", "caught at 1 %", "alarms", "AUROC of the mean")
    cells: dict[str, list[str]] = {}
    for name in trained:
        rows = rows_of(results.monitor, domain.name, name, results.plan.test_seed)
        for row in rows[rows["kind"].isin(["benign", kind])].itertuples():
            family = f" ({FAMILY[row.name]})" if row.name in FAMILY else ""
            area = "–" if isnan(row.auroc) else format_interval(row.auroc, (row.low, row.high))
            rates = map(format_rate, (row.caught, row.alarms, row.auroc_mean))
            cells.setdefault(f"{row.name}{family}" if row.name else "*benign*", []).extend([area, *rates])
    header = [kind, *(f"{word}, {name}-trained" for name in trained for word in words)]
    return Table(header, [[name, *line] for name, line in cells.items()]) if results.monitor.facts else None


def pair_table(results: PaperResults, protocol: str, table: SubTable) -> Table:
    """Return the table of precision, recall, accuracy and F1 in the paper's layout, its figures below ours."""
    domains, rows = results.domains, []
    for test in domains:
        keys = [table.key(protocol, test, train) for train in domains]
        rows.append([test, *(_four(results.pairs.counts(key)) for key in keys)])
        rows.append(["*95 % of F1*", *(_bounds(results, key) for key in keys)])
        published = [table.published(test, train) for train in domains] if protocol == PAPER else []
        if any(published):
            rows.append(["*the paper*", *(" ".join(format_rate(rate, 2) for rate in four or []) for four in published)])
    return Table(["tested on \\ trained on", *domains], rows)


def _four(counts: ConfusionCounts) -> str:
    """Return precision, recall and accuracy with two digits, and F1 with three, as text."""
    if isnan(counts.precision) and isnan(counts.accuracy):
        return "–"
    rates = (counts.precision, counts.recall, counts.accuracy)
    return " ".join([*(format_rate(rate, 2) for rate in rates), format_rate(counts.f1)])


def _bounds(results: PaperResults, key: Series) -> str:
    low, high = results.pairs.interval([key], f1)
    return "–" if isnan(low) else f"{format_rate(low)} to {format_rate(high)}"


def area_table(results: PaperResults, protocol: str, table: SubTable) -> Table:
    """Return the table of AUPRC in the paper's layout."""

    def area(test: str, train: str) -> str:
        return format_rate(results.pairs.scores([table.key(protocol, test, train)]).auprc())

    names = by_name(results.domains)
    return pivot("AUPRC, tested on \\ trained on", names, names, area)


def target_table(results: PaperResults) -> Table:
    """Return the table of the targets of the paper's protocol, met or missed, with the paper's figures."""
    rows = [
        [target.what, format_rate(target.published, 2), f"≥ {format_rate(target.least, 2)}", format_rate(target.found),
         target.verdict, format_rate(target.at_half)]
        for target in targets_of(results)
    ]  # fmt: skip
    return Table(["what", "the paper", "target", "here", "", "here, threshold .5"], rows)


def pair_methods(results: PaperResults, protocol: str, domain: str) -> dict[str, str]:
    """Return the methods with results in a domain: the networks trained there by short name, then classical ones."""
    networks = {name: f"{name}-{domain}" for name in NETWORKS}
    methods = networks | by_name(setting_of(results.plan, protocol, domain).classical())
    pairs = results.pairs_in(protocol, domain)
    return {short: name for short, name in methods.items() if pairs.has(name, BENIGN)}


def mixture_table(results: PaperResults, protocol: str, domain: str) -> Table:
    """Return the table of all methods on benign and attacked sweeps of a domain, with the networks trained there."""
    pairs = results.pairs_in(protocol, domain)

    def value(method: str, column: tuple[Case, str]) -> str:
        case, word = column
        counts = pairs.counts(method, case)
        if word == "AUPRC":
            return format_rate(pairs.scores(method, [case]).auprc())
        if word == "F1 [95 %]":
            return format_interval(counts.f1, pairs.interval(method, [case], f1))
        return format_rate(counts.precision if word == "precision" else counts.recall)

    words = ("precision", "recall", "F1 [95 %]", "AUPRC")
    columns = {f"{word}, {mixture}": (case, word) for mixture, case in TESTED_ON.items() for word in words}
    return pivot("", pair_methods(results, protocol, domain), columns, value, "column")


def calibration_table(results: PaperResults, protocol: str, domain: str) -> Table:
    """Return the table of ECE, Brier score and AURC (of MCD also by its deviation) on benign and attacked sweeps."""
    pairs = results.pairs_in(protocol, domain)
    rows = [
        [short, *(word for case in TESTED_ON.values() for word in calibration_of(pairs.scores(name, [case])))]
        for short, name in pair_methods(results, protocol, domain).items()
    ]
    return Table(["", *(f"{word}, {mixture}" for mixture in TESTED_ON for word in CALIBRATION)], rows)


def attacked_cases(domain: StrictDomain) -> list[Case]:
    """Return the cases of attacks with default budgets that have results, in the order of ``ATTACKS``."""
    return [case for name in ATTACKS if (case := Case("attack", name, DEFAULT)) in domain.cases]


def view_table(domain: StrictDomain) -> Table:
    """Return the table of F1 of the whole view under every attack, with half of its 95 % interval; the best bold."""

    def spread(case: Case, method: str) -> str:
        return format_spread(domain.counts(method, case).f1, domain.interval(method, [case], f1))

    rows = {_labeled(domain, case): case for case in (BENIGN, *attacked_cases(domain))}
    return pivot("attack (family)", rows, by_name(domain.methods), spread, "row")


def wedge_table(domain: StrictDomain) -> Table:
    """Return the table of precision / recall / F1 in the wedge of every attack that has one, attacked and untouched."""
    rows = []
    for case in attacked_cases(domain):
        if domain.has_wedge(case):
            for label, region in ((_labeled(domain, case), WEDGE), ("*untouched*", UNTOUCHED)):
                rows.append([label, *_best_f1([domain.counts(name, case, region) for name in domain.methods])])
    return Table(["attack (family)", *domain.methods], rows)


def _best_f1(counts: Sequence[ConfusionCounts]) -> list[str]:
    """Return precision / recall / F1 of each as text, the best F1 in bold."""
    best = max((one.f1 for one in counts if not isnan(one.f1)), default=float("nan"))
    words = [format_rates(one.precision, one.recall, one.f1) for one in counts]
    return [f"**{cell}**" if one.f1 == best else cell for cell, one in zip(words, counts, strict=True)]


def _labeled(domain: StrictDomain, case: Case) -> str:
    """Return an attack's name and family, with a star if the adversarial models were trained on it."""
    star = " \\*" if case.name in domain.plan.trained_attacks else ""
    return "*benign*" if case == BENIGN else f"{case.name} ({FAMILY[case.name]}){star}"


def winner_table(domain: StrictDomain) -> Table:
    """Return the table of the best network and the best classical estimator by F1 under each attack."""
    networks = [name for name in domain.methods if name in NETWORKS]
    classical = [name for name in domain.methods if name not in NETWORKS]
    rows = []
    for case in [BENIGN, *attacked_cases(domain)]:
        for region in (VIEW, WEDGE):
            if region == VIEW or domain.has_wedge(case):
                first = [domain.best(names, case, region) for names in (networks, classical)]
                rates = [format_rate(domain.counts(name, case, region).f1) for name in (*first, "majority_vote")]
                label, *best = best_of_row([_labeled(domain, case), *rates[:2]])
                rows.append([label, region, *best, *(name or "–" for name in first), rates[2]])
    header = ["attack (family)", "where", "best network's F1", "best classical F1", "which network", "which classical",
              "majority_vote"]  # fmt: skip
    return Table(header, rows)


def seen_table(domain: StrictDomain) -> Table:
    """Return the table of mean F1 over the attacks used in training and over the unseen ones."""
    rows: dict[str, tuple[list[Case], str]] = {}
    for words, seen in (("trained on", True), ("never seen", False)):
        cases = [case for case in attacked_cases(domain) if (case.name in domain.plan.trained_attacks) == seen]
        for region in (VIEW, WEDGE):
            chosen = [case for case in cases if region == VIEW or domain.has_wedge(case)]
            rows[f"{words}, {region} (attacks: {len(chosen)})"] = chosen, region

    def mean(row: tuple[list[Case], str], method: str) -> str:
        rates = [domain.counts(method, case, row[1]).f1 for case in row[0]]
        return format_rate(float(np.mean(rates)) if rates else float("nan"))

    return pivot("mean F1 over attacks", rows, by_name(domain.methods), mean, "row")
