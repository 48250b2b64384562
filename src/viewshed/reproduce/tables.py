"""The tables of both protocols' pages: figures of the 72 pairs as words."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan

from viewshed.reproduce.plan import StudyPlan
from viewshed.reproduce.protocols import MIXTURES, VARIANTS, setting_of
from viewshed.reproduce.published import ORDER, SubTable, targets_of
from viewshed.reproduce.results import MEASURES, PairKey, Results
from viewshed.vulnerability.page import Table
from viewshed.vulnerability.results import f1
from viewshed.vulnerability.tables import three


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

    >>> own_name("mle-benign-ugv", "ugv"), own_name("vote", "ugv")
    ('mle-benign', 'vote')
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
