"""The figures of both pages: from results, and for the maps from the networks themselves, to PNGs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from viewshed.attacks import ATTACKS, SEVERITIES
from viewshed.plot_reproduce import Dot, Map, map_figure, trade_figure
from viewshed.plot_study import Curves, Violins, curve_figure, violin_figure
from viewshed.reproduce.contestants import load_runner, network, passes_of, weights_of
from viewshed.reproduce.data import TestSweep, test_sweep
from viewshed.reproduce.other_tables import trade_rows
from viewshed.reproduce.protocols import MIXTURES, TOUCHING, Model, Setting, setting_of
from viewshed.reproduce.results import VIEW, WEDGE, Floats, PairKey, Results, StrictKey, accuracy
from viewshed.reproduce.scoring import Said
from viewshed.reproduce.strict_tables import who
from viewshed.reproduce.tables import contestants_of, domains_of, own_name
from viewshed.vulnerability.cases import BENIGN, Case
from viewshed.vulnerability.page import Picture
from viewshed.vulnerability.results import f1, precision

SHOWN = "far_wall"
"""Attack of the strict protocol's maps: a corridor that is not there."""
CURVED = 9
"""Contestants that the severity curves show at most, the best on benign sweeps beside all networks."""


def violin_picture(results: Results, protocol: str) -> Picture:
    """Return violins of precision and AUPRC of each sweep, for every domain: benign against attacked."""
    panels = []
    for domain in domains_of(results.store.plan):
        names = contestants_of(results, protocol, domain)
        for word in ("precision", "AUPRC"):
            pairs = {
                own_name(name, domain).replace("paper_", "paper: "): _both(results, protocol, (name, domain), word)
                for name in names
            }
            panels.append(Violins(f"{domain}: {word}", pairs))
    attacked = "the paper's attacks" if protocol == "paper" else "one attack each, all in turn"
    return Picture(
        f"reproduce_{protocol}_violins.png", violin_figure(panels, 2, attacked),
        f"Precision and AUPRC of single sweeps, benign and under {attacked}, networks and classical estimators",
    )  # fmt: skip


def _both(results: Results, protocol: str, who_where: tuple[str, str], word: str) -> tuple[Floats, Floats]:
    name, domain = who_where
    one, other = (results.pairs[PairKey(protocol, name, mixture, domain)] for mixture in MIXTURES)
    if word == "AUPRC":
        return one.areas, other.areas
    return precision(one.counts), precision(other.counts)


def mcd_picture(results: Results, protocol: str) -> Picture | None:
    """Return mean and deviation on one sweep, benign and attacked, by networks trained without and with attacks.

    None if the networks are not there.
    """
    plan, folder = results.store.plan, results.store.folder
    domain = "nuscenes" if "nuscenes" in plan.domains else plan.domains[0]
    models = {mixture: Model(protocol, "mcd", mixture, domain) for mixture in MIXTURES}
    if any((model.protocol, model.name) not in results.models for model in models.values()):
        return None
    setting, test = _shown_sweep(results, protocol, domain)
    predict = {
        mixture: network(load_runner(weights_of(folder, model)), setting, passes_of(plan, model), plan.test_seed)
        for mixture, model in models.items()
    }
    rows = {
        f"{name} sweep": [
            Map("returns", "returns", np.minimum(setting.grid.count(sweep.points), 1)),
            Map("truth, clean sweep", "truth", test.visible),
            *(each for mixture in MIXTURES for each in _mean_and_std(f"{mixture}-trained", predict[mixture](sweep))),
        ]
        for name, sweep in zip(MIXTURES, (test.benign, test.attacked), strict=True)
    }
    alt = f"Monte Carlo dropout on one sweep of {domain}, benign and under {test.attack}: mean and deviation"
    return Picture(f"reproduce_{protocol}_mcd.png", map_figure(rows), alt)


def _shown_sweep(results: Results, protocol: str, domain: str) -> tuple[Setting, TestSweep]:
    """Return the first held-out sweep that the paper's mixture attacks, or the first under ``SHOWN``."""
    plan, folder = results.store.plan, results.store.folder
    setting = setting_of(plan, protocol, domain)
    if protocol == "strict":
        return setting, test_sweep(plan, folder, setting, TOUCHING.index(SHOWN))
    tests = [test_sweep(plan, folder, setting, number) for number in range(plan.pair_frames)]
    return setting, next((test for test in tests if test.attacked is not test.benign), tests[0])


def _mean_and_std(title: str, said: Said) -> list[Map]:
    mean, std = said
    return [
        Map(f"{title}: mean", "probability", mean),
        Map("deviation", "deviation", np.zeros_like(mean) if std is None else std),
    ]


def trade_picture(results: Results) -> Picture | None:
    """Return precision, accuracy and F1 of the trade study over latency; None if there are no results."""
    dots = []
    for line in trade_rows(results):
        pooled, (width, depth, cells) = line["measured"].counts.sum(axis=0), line["shape"]
        rates = {"precision": precision, "accuracy": accuracy, "F1": f1}
        values = {name: float(measure(pooled)) for name, measure in rates.items()}
        dots.append(Dot(cells, depth, width, values | {"latency, ms, 2 threads": line["latency_ms"]["2"]}))
    if not dots:
        return None
    png = trade_figure(dots, "latency, ms, 2 threads", ("precision", "accuracy", "F1"))
    alt = "Precision, accuracy and F1 over the latency of one pass, by resolution, depth and width"
    return Picture("reproduce_paper_trade.png", png, alt)


def severity_pictures(results: Results, domain: str) -> Iterator[Picture]:
    """Yield curves of F1 in the view and in the wedge over the strengths of the attacks that have some."""
    names = _shown(results, domain)
    for where, columns in (("view", VIEW), ("wedge", WEDGE)):
        panels = list(_severities(results, domain, names, columns))
        if panels:
            png = curve_figure(panels, 4, f"F1 in the {where}")
            alt = f"{domain}: F1 in the {where} over the strength of each attack"
            yield Picture(f"reproduce_strict_{where}_{domain}.png", png, alt)


def _shown(results: Results, domain: str) -> list[str]:
    """Return all networks and, of the classical estimators, the best on benign sweeps."""
    names = who(results, domain)
    classical = [name for name in names if not name.startswith(("mle-", "mcd-"))]
    scored = {name: results.under(StrictKey(domain, BENIGN, name), f1) for name in classical}
    chosen = sorted(classical, key=lambda name: -scored[name])[: CURVED - (len(names) - len(classical))]
    return [name for name in names if name not in classical or name in chosen]


def _severities(results: Results, domain: str, names: Sequence[str], columns: slice) -> Iterator[Curves]:
    there = {key.case for key in results.strict if key.domain == domain}
    for name in ATTACKS:
        for attribute in dict.fromkeys(attribute for attribute, _ in SEVERITIES.get(name, ())):
            levels = [f"{a} {value:g}" for a, value in SEVERITIES[name] if a == attribute]
            cases = [case for level in levels if (case := Case("strength", name, level)) in there]
            if not cases or (columns == WEDGE and not results.has_wedge(domain, cases[0])):
                continue
            steps = [case.level.removeprefix(f"{attribute} ") for case in cases]
            first = BENIGN if columns == VIEW else None
            curves = {
                who_: [*([results.under(StrictKey(domain, first, who_), f1)] if first else []),
                       *(results.under(StrictKey(domain, case, who_), f1, columns) for case in cases)]
                for who_ in names
            }  # fmt: skip
            yield Curves(f"{name}, {attribute}", [*(["benign"] if first else []), *steps], curves)
