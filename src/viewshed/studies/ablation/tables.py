"""The tables of the ablation's page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isnan

from viewshed._page import Table
from viewshed.metrics import Scores
from viewshed.studies.ablation.evaluate import CASES, UNTOUCHED
from viewshed.studies.ablation.plan import WHOLE, AblationPlan
from viewshed.studies.ablation.results import JAMMING, OURS, SettingResults, Sure, Target, label
from viewshed.studies.formatting import best_of_rates, format_pair, format_rate
from viewshed.studies.records import BENIGN, WEDGE, Case

SURE = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""How sure a network must be before it decides a cell."""


def targets_table(targets: list[Target]) -> Table:
    """Return targets beside what was found."""
    rows = [[one.what, one.wanted, one.found, "met" if one.met else "**missed**"] for one in targets]
    return Table(["what", "target", "here", ""], rows)


def ablation_table(results: SettingResults) -> Table:
    """Return one line of figures for each method of the ablation."""
    columns = list(results.figures(WHOLE))
    names = results.methods
    rows = []
    for name in names:
        size = results.plan.config_of(name).shape if name in results.plan.variants else None
        cost = "–" if size is None else f"{size.flops(results.plan.config_of(name).cells) / 1e9:.2f}"
        rows.append([name, cost, *(format_rate(value) for value in results.figures(name).values())])
    return Table(["network", "GFLOP", *columns], rows)


def changes_table(plan: AblationPlan) -> Table:
    """Return what the line of each variant changes."""
    rows = [[name, ", ".join(f"{key} = {value}" for key, value in changes.items()) or "–"]
            for name, changes in plan.variants.items()]  # fmt: skip
    return Table(["network", "what its line changes"], rows)


def views_table(results: SettingResults, names: Sequence[str]) -> Table:
    """Return the F1 of the view, case by case."""
    rows = [[_kind(results, case), *best_of_rates([results.f1(name, [case]) for name in names])] for case in CASES]
    return Table(["case", *names], rows)


def wedges_table(results: SettingResults, names: Sequence[str]) -> Table:
    """Return precision / recall in the wedge, case by case."""
    rows = []
    for case in CASES:
        wedges = [results.wedge(name, [case]) for name in names]
        if wedges[0].cells:
            rows.append([_kind(results, case), *map(_both, wedges)])
    return Table(["case", *names], rows)


def parts_table(results: SettingResults) -> Table:
    """Return the F1 of parts of the untouched view."""
    names = results.alone
    rows = []
    for part, sweeps in results.parts.items():
        scores = [results.f1_of_part(name, part) for name in names]
        rows.append([part, str(sweeps), *best_of_rates(scores)])
    return Table(["part", "sweeps", *names], rows)


def chosen_table(chosen: SettingResults) -> Table:
    """Return precision / recall of each victim, untouched and with points chosen against it."""
    rows = []
    for name in chosen.methods:
        for case in chosen.cases(name):
            counts, asked = chosen.results.counts(chosen.series(name, case, WEDGE)), case.level
            scores = chosen.view(name, [case]), chosen.wedge(name, [case])
            questions = "–" if case == UNTOUCHED else asked
            rows.append([name, questions, str(counts.samples), *map(_both, scores), f"{counts.over_m2:.0f}"])
    heads = ["victim", "questions", "sweeps", "view", "wedge", "claimed and not visible in the wedge, m² a sweep"]
    return Table(heads, rows)


def abstention_table(validation: SettingResults, test: SettingResults) -> Table:
    """Return precision / recall in opened wedges of those claims of our network that are sure."""
    step = validation.sure
    row = [OURS, f"{step:g}", *(_both(test.wedge(OURS, cases), step) for cases in test.opening)]
    return Table(["network", "claimed from", "attacks trained on", "unseen attacks"], [row])


def sure_table(results: SettingResults, *, wedge: bool) -> Table:
    """Return the share of cells decided / precision of claims / of denials of our network, by how sure it must be."""
    groups: dict[str, Iterable[Case]] = {
        "trained": results.trained, "unseen": results.unseen, "jamming": (JAMMING,),
    }  # fmt: skip
    groups = groups | dict(zip(_OPENED, results.opening, strict=True)) if wedge else {"benign": (BENIGN,)} | groups
    scores = {group: (results.wedge if wedge else results.view)(OURS, cases) for group, cases in groups.items()}
    rows = [[f"{sure:g}", *(_decided(Sure.of(one, sure)) for one in scores.values())] for sure in SURE]
    return Table(["sure", *scores], rows)


_OPENED = ("trained, opening a view", "unseen, opening a view")


def _decided(sure: Sure) -> str:
    return " / ".join(map(format_rate, (sure.share, sure.claims, sure.denials)))


def doubts_table(results: SettingResults) -> Table:
    """Return how good probabilities and doubts are."""
    groups = {"benign": (BENIGN,), "trained": results.trained, "unseen": results.unseen}
    rows = []
    for name in results.alone:
        cells = []
        for cases in groups.values():
            scores = results.view(name, cases)
            cells += [_four(value) for value in (scores.ece(), scores.brier(), scores.aurc(), scores.aurc_std())]
        rows.append([name, *cells])
    heads = [f"{what}, {group}" for group in groups for what in ("ECE", "Brier", "AURC", "AURC by deviation")]
    return Table(["", *heads], rows)


def _kind(results: SettingResults, case: Case) -> str:
    return f"{label(case)} \\*" if case.name in results.attacks else label(case)


def _both(scores: Scores, threshold: float = 0.5) -> str:
    return format_pair(scores.precision(threshold), scores.recall(threshold))


def _four(value: float) -> str:
    return "–" if isnan(value) else f"{value:.4f}"
