"""What a monitor found, one row for each case, and the page of its study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isnan
from typing import Any

from viewshed.monitor.roc import auroc, auroc_interval, tpr_at_fpr
from viewshed_lab._page import facts
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.deviation.jobs import METHOD
from viewshed_lab.studies.deviation.plan import DeviationPlan
from viewshed_lab.studies.formatting import by_name, commits, format_interval, format_rate, pivot
from viewshed_lab.studies.pages import Table, fill_template
from viewshed_lab.studies.records import BENIGN, Results, Series
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.threats.attacks import FAMILY

REGIONS = ("touched", "wedge", "changed")
"""Where suspect cells should lie: cells with a return that was added or removed; cells whose azimuth the attacker
reaches; cells that the estimate calls visible on only one of the clean and the spoilt sweep."""

FALSE_ALARM_RATE = 0.01

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Located:
    """How well suspect cells fit a region, counted over all sweeps that have one."""

    cells: int  # watched cells of the region
    suspects: int  # suspect cells
    both: int  # suspect cells of the region
    watched: int  # watched cells

    @property
    def precision(self) -> float:
        """Share of the suspect cells that lie in the region; NaN without suspects."""
        return self.both / self.suspects if self.suspects else _NAN

    @property
    def recall(self) -> float:
        """Share of the region that is suspect; NaN without a region."""
        return self.both / self.cells if self.cells else _NAN

    @property
    def chance(self) -> float:
        """Share of the watched cells that lie in the region: the precision of guessing; NaN without cells."""
        return self.cells / self.watched if self.watched else _NAN


@dataclass(frozen=True, slots=True)
class CaseRow:
    """One case over all sweeps; ``dataclasses.asdict`` makes it plain."""

    kind: str  # benign, attack or corruption
    name: str  # of the attack or corruption
    frames: int  # sweeps that it was done to
    refused: int  # sweeps that it could not be done to
    idle: int  # frames on which the attack added and removed no return: nothing to see, yet counted as missed
    alarms: float  # share of the frames that alarm at the calibrated limit
    auroc: float  # P(score > that of a benign sweep), ties half; NaN for benign sweeps themselves
    auroc_interval: tuple[float, float]  # its 95 % interval over samples
    # share of the frames above a limit that at most 1 % of these benign frames pass (with fewer than 100
    # frames: that none of them passes); NaN for benign sweeps themselves
    caught: float
    auroc_mean: float  # AUROC of the plain mean deviation over the watched cells, for comparison; NaN likewise
    located: dict[str, Located]  # by region of ``REGIONS``, where the case has one


def rows_of(results: Results[Any], domain: str, method: str, seed: int = 0) -> list[CaseRow]:
    """Return one row for each case of a method in a domain.

    Args:
        results: rows of ``jobs.watch``; their order changes nothing.
        domain: of the rows.
        method: of the rows.
        seed: of the intervals.
    """
    found = [s.case for s in results.series(domain) if s.method == method]
    refused = {case: n for (of, case, _), n in results.refused.items() if of == domain}
    return [
        _row(results, Series(domain, method, case), refused.get(case, 0), seed)
        for case in dict.fromkeys([*found, *refused])
    ]


def _row(results: Results[Any], series: Series, refused: int, seed: int) -> CaseRow:
    scores, alarms = results.numbers(series, "score"), results.numbers(series, "alarm")
    compared = (_NAN, (_NAN, _NAN), _NAN, _NAN)
    if series.case != BENIGN and not scores.empty:
        compared = _compared(results, series, list(scores.index), seed)
    idle = int((results.numbers(series, "returns") == 0).sum())
    located = {region: found for region in REGIONS if (found := _located(results, series, region)) is not None}
    mean = float(alarms.mean()) if len(alarms) else _NAN
    return CaseRow(series.case.kind, series.case.name, len(scores), refused, idle, mean, *compared, located)


def _compared(
    results: Results[Any], series: Series, sweeps: list[int], seed: int
) -> tuple[float, tuple[float, float], float, float]:
    """Return AUROC, its interval, the share caught, and the AUROC of the mean deviation, sweep beside sweep."""

    def both(name: str) -> list[list[float]]:
        return [results.numbers(one, name).reindex(sweeps).tolist() for one in (series.under(BENIGN), series)]

    benign, spoilt = both("score")
    bounds = auroc_interval(benign, spoilt, generator(seed, series.case.name), paired=True)
    return auroc(benign, spoilt), bounds, tpr_at_fpr(benign, spoilt, FALSE_ALARM_RATE), auroc(*both("mean_std"))


def _located(results: Results[Any], series: Series, region: str) -> Located | None:
    cells, both = (results.numbers(series, f"{region} {name}") for name in ("cells", "suspects"))
    if cells.empty:
        return None
    suspects, watched = (results.numbers(series, name) for name in ("suspects", "watched"))
    return Located(
        int(cells.sum()), int(suspects[cells.index].sum()), int(both.sum()), int(watched[cells.index].sum())
    )  # fmt: skip


def monitor_table(rows: Mapping[str, list[CaseRow]], kind: str) -> Table:
    """Return AUROC, its interval, detections at 1 % and alarms for every attack or corruption.

    Args:
        rows: by what is said of them behind a comma in the header; nothing is said of one without a name.
        kind: ``attack`` or ``corruption``.
    """
    words = ["AUROC [95 %]", "caught at 1 %", "alarms", "AUROC of the mean"]
    header = [kind, *(f"{word}, {name}" if name else word for name in rows for word in words)]
    cells: dict[str, list[str]] = {}
    for several in rows.values():
        for row in several:
            if row.kind in ("benign", kind):
                family = f" ({FAMILY[row.name]})" if row.name in FAMILY else ""
                area = "–" if isnan(row.auroc) else format_interval(row.auroc, row.auroc_interval)
                rates = map(format_rate, (row.caught, row.alarms, row.auroc_mean))
                cells.setdefault(f"{row.name}{family}" if row.name else "*benign*", []).extend([area, *rates])
    return Table(header, [[name, *line] for name, line in cells.items()])


def located_table(rows: list[CaseRow]) -> Table:
    """Return how well suspect cells fit what was touched, the wedge and what changed: precision (chance) / recall."""

    def words(row: CaseRow, region: str) -> str:
        found = row.located.get(region)
        if found is None:
            return "–"
        return f"{format_rate(found.precision)} ({format_rate(found.chance)}) / {format_rate(found.recall)}"

    return pivot("", {row.name: row for row in rows if row.located}, by_name(REGIONS), words)


def page_of(store: ResultStore[DeviationPlan]) -> str:
    """Return the page as Markdown.

    Raises:
        ValueError: there are no results.
    """
    plan, results = store.plan, store.results("watch")
    store.require(results)
    rows = rows_of(results, plan.domain, METHOD, plan.seed)
    page = fill_template("deviation/page.md", severity=plan.severity, rows=rows, monitor_table=monitor_table,
                         located_table=located_table)  # fmt: skip
    about = facts(
        plan=f"{plan.name}: {plan.about}", seed=str(plan.seed), domain=f"{plan.domain}, {plan.target}",
        sweeps=f"{plan.frames} to fit, {plan.frames} to calibrate, {rows[0].frames} of {plan.frames} to report",
        passes=str(plan.passes), false_alarm_rate=f"{plan.false_alarm_rate:g}", commits=commits(results),
    )  # fmt: skip
    return page.markdown(about)
