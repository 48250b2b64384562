"""The tables of the ablation's page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from viewshed.metrics import Scores
from viewshed_lab.studies.ablation.evaluate import CASES, UNTOUCHED
from viewshed_lab.studies.ablation.plan import WHOLE, AblationPlan
from viewshed_lab.studies.ablation.results import JAMMING, OURS, AblationTarget, SettingResults, Sure, label
from viewshed_lab.studies.formatting import (
    CALIBRATION,
    best_of_rates,
    by_name,
    calibration_of,
    format_rate,
    format_rates,
    pivot,
)
from viewshed_lab.studies.pages import Table
from viewshed_lab.studies.records import BENIGN, VIEW, WEDGE, Case

SURE = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""How sure a network must be before it decides a cell."""


def targets_table(targets: list[AblationTarget]) -> Table:
    """Return targets beside what was found."""
    rows = [[one.what, one.wanted, one.found, "met" if one.met else "**missed**"] for one in targets]
    return Table(["what", "target", "here", ""], rows)


def ablation_table(results: SettingResults) -> Table:
    """Return one line of figures for each method of the ablation."""
    rows = []
    for name in results.methods:
        config = results.plan.config_of(name) if name in results.plan.variants else None
        cost = "–" if config is None else f"{config.shape.flops(config.cells) / 1e9:.2f}"
        rows.append([name, cost, *map(format_rate, results.figures(name).values())])
    return Table(["network", "GFLOP", *results.figures(WHOLE)], rows)


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
    rows = {_kind(results, case): [case] for case in CASES if results.wedge(names[0], [case]).cells}
    return pivot("case", rows, by_name(names), lambda cases, name: _both(results.wedge(name, cases)))


def parts_table(results: SettingResults) -> Table:
    """Return the F1 of parts of the untouched view."""
    rows = [[part, str(sweeps), *best_of_rates([results.counts(name, BENIGN, part).f1 for name in results.alone])]
            for part, sweeps in results.parts.items()]  # fmt: skip
    return Table(["part", "sweeps", *results.alone], rows)


def chosen_table(chosen: SettingResults) -> Table:
    """Return precision / recall of each victim, untouched and with points chosen against it."""
    rows = []
    for name in chosen.methods:
        for case in chosen.cases_of(name):
            counts = chosen.counts(name, case, WEDGE)
            both = [_both(chosen.scores(name, [case], region)) for region in (VIEW, WEDGE)]
            queries = "–" if case == UNTOUCHED else case.level
            rows.append([name, queries, str(counts.samples), *both, f"{counts.over_m2:.0f}"])
    heads = ["victim", "queries", "sweeps", "view", "wedge", "claimed and not visible in the wedge, m² a sweep"]
    return Table(heads, rows)


def abstention_table(validation: SettingResults, test: SettingResults) -> Table:
    """Return precision / recall in opened wedges of those claims of our network that are sure."""
    step = validation.sure
    row = [OURS, f"{step:g}", *(_both(test.wedge(OURS, cases), step) for cases in test.opening)]
    return Table(["network", "claimed from", "attacks trained on", "unseen attacks"], [row])


def sure_table(results: SettingResults, *, wedge: bool) -> Table:
    """Return the share of cells decided / precision of claims / of denials of our network, by how sure it must be."""
    groups: dict[str, Iterable[Case]] = {"trained": results.trained, "unseen": results.unseen, "jamming": (JAMMING,)}
    if wedge:
        groups |= dict(zip(("trained, opening a view", "unseen, opening a view"), results.opening, strict=True))
    else:
        groups = {"benign": (BENIGN,)} | groups
    columns = {group: results.scores(OURS, cases, WEDGE if wedge else VIEW) for group, cases in groups.items()}

    def decided(sure: float, scores: Scores) -> str:
        found = Sure.of(scores, sure)
        return format_rates(found.share, found.claims, found.denials)

    return pivot("sure", {f"{sure:g}": sure for sure in SURE}, columns, decided)


def doubts_table(results: SettingResults) -> Table:
    """Return how good probabilities and doubts are."""
    groups: Mapping[str, Iterable[Case]] = {"benign": (BENIGN,), "trained": results.trained, "unseen": results.unseen}
    rows = [
        [name, *(word for cases in groups.values() for word in calibration_of(results.scores(name, cases)))]
        for name in results.alone
    ]
    return Table(["", *(f"{what}, {group}" for group in groups for what in CALIBRATION)], rows)


def _kind(results: SettingResults, case: Case) -> str:
    return f"{label(case)} \\*" if case.name in results.attacks else label(case)


def _both(scores: Scores, threshold: float = 0.5) -> str:
    return format_rates(scores.precision(threshold), scores.recall(threshold))
