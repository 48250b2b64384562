"""Result rows of a study: one row per sweep, method, case and region, and a table that holds all rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, astuple, dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Generic, Self, TypeVar

import numpy as np
import pandas as pd

from viewshed.arrays import F64
from viewshed.metrics import ConfusionCounts, Scores
from viewshed_lab.studies.statistics import NO_INTERVAL, Measure, bootstrap

VIEW, WEDGE, UNTOUCHED = "view", "wedge", "untouched wedge"
"""Regions: all cells with known truth; those in the attacker's wedge; those in the wedge, but of the clean sweep."""

STRICT, PAPER = "strict", "paper"
"""Protocols: exact truth on our grids; the paper's label on its own grid."""

SEVERAL = -1
"""Number of the sweep in a row that pools several sweeps."""

P = TypeVar("P")

Row = dict[str, Any]
"""Keys of the series and sweep, counts and figures, see :func:`row_of`."""


@dataclass(frozen=True, slots=True, order=True)
class Case:
    """The attack or corruption of a sweep, and the defense, before it is estimated."""

    kind: str  # one of ``cases.KINDS``
    name: str = ""  # name of the attack or corruption
    level: str = ""  # budget, severity or ``attribute value``
    defense: str = ""  # name of the defense applied to the result; empty for none


BENIGN = Case("benign")


@dataclass(frozen=True, slots=True)
class Series:
    """The keys that rows share which are pooled."""

    domain: str  # source of the sweeps
    method: str  # name of the estimator; empty if the row is about the case alone
    case: Case = BENIGN  # attack, corruption and defense of the sweeps
    region: str = VIEW  # region of the grid
    protocol: str = STRICT  # ``STRICT`` or ``PAPER``

    def of(self, region: str) -> Series:
        """Return the series of another region."""
        return replace(self, region=region)

    def under(self, case: Case) -> Series:
        """Return the series of another case."""
        return replace(self, case=case)


_KEYS = ["domain", "method", "kind", "name", "level", "defense", "region", "protocol"]
_COUNTS = [one.name for one in fields(ConfusionCounts)]
_COLUMNS = [*_KEYS, "scene", "sweep", "refused", *_COUNTS, "scores"]


def row_of(
    series: Series,
    scene: str,
    sweep: int,
    counts: ConfusionCounts | None = None,
    scores: Scores | None = None,
    refused: str = "",
    **numbers: float,
) -> Row:
    """Return the row of one sweep, or of several pooled sweeps.

    Args:
        series: series of the row.
        scene: scene of the sweep.
        sweep: number of the sweep in the domain, or ``SEVERAL``.
        counts: confusion counts at the threshold of the study.
        scores: cells by probability.
        refused: why the case is impossible on this sweep; then the row has no figures.
        numbers: other figures by name, such as ``auprc`` or counts of dropped returns.
    """
    keys = (series.domain, series.method, *astuple(series.case), series.region, series.protocol)
    row = dict(zip(_KEYS, keys, strict=True)) | {"scene": scene, "sweep": sweep, "refused": refused} | numbers
    return row | ({} if counts is None else asdict(counts)) | ({} if scores is None else {"scores": scores})


def pool(rows: Iterable[Row]) -> list[Row]:
    """Return one row per series with the summed counts and scores of all its sweeps; other figures are dropped."""
    pooled: dict[tuple[str, ...], Row] = {}
    for row in rows:
        keys = {name: row[name] for name in _KEYS}
        total = pooled.setdefault(tuple(keys.values()), keys | {"scene": "", "sweep": SEVERAL, "refused": ""})
        total |= {name: total[name] + row[name] if name in total else row[name]
                  for name in (*_COUNTS, "scores") if name in row}  # fmt: skip
    return list(pooled.values())


def _series(keys: tuple[str, ...]) -> Series:
    domain, method, *case, region, protocol = keys
    return Series(domain, method, Case(*case), region, protocol)


@dataclass(frozen=True, eq=False)
class Results(Generic[P]):
    """All results of a study so far."""

    plan: P  # of the study
    rows: pd.DataFrame  # rows of all jobs, see :func:`row_of`
    # by the keys of finished jobs: plain values that are not rows
    facts: Mapping[tuple[str, ...], dict[str, Any]] = field(default_factory=dict)
    commits: Iterable[str] = ()  # of the code that ran the jobs, as far as known

    @classmethod
    def of(
        cls,
        plan: P,
        rows: Iterable[Row] | pd.DataFrame,
        facts: Mapping[tuple[str, ...], dict[str, Any]] | None = None,
        commits: Iterable[str] = (),
    ) -> Self:
        """Return the results of a plan from rows; figures do not depend on their order."""
        frame = rows if isinstance(rows, pd.DataFrame) else pd.DataFrame(list(rows))
        frame = frame.reindex(columns=[*_COLUMNS, *(name for name in frame.columns if name not in _COLUMNS)])
        return cls(plan, frame.reset_index(drop=True), facts or {}, commits)

    @cached_property
    def refused(self) -> dict[tuple[str, Case, str], int]:
        """Number of sweeps by domain, case and reason why the case was impossible."""
        refused = self.rows[self.rows["refused"] != ""]
        reasons = refused[["domain", "kind", "name", "level", "defense", "refused"]].itertuples(index=False, name=None)
        return dict(Counter((domain, Case(*case), why) for domain, *case, why in reasons))

    @cached_property
    def _groups(self) -> dict[Series, pd.DataFrame]:
        """Rows of each series, in the order of the sweeps."""
        groups = self.rows[self.rows["refused"] == ""].groupby(_KEYS, sort=False)
        return {_series(keys): group.sort_values("sweep", kind="stable") for keys, group in groups}

    @cached_property
    def _counts(self) -> dict[Series, ConfusionCounts]:
        pooled = self.rows.dropna(subset="both").groupby(_KEYS, sort=False)[_COUNTS].sum()
        every = zip(pooled.index, pooled.itertuples(index=False, name=None), strict=True)
        return {_series(keys): _counts_of(n) for keys, n in every}

    def __contains__(self, series: Series) -> bool:
        return series in self._groups

    def series(self, domain: str = "", protocol: str = "") -> list[Series]:
        """Return the series that have rows, optionally those of one domain and protocol."""
        return [s for s in self._groups if domain in ("", s.domain) and protocol in ("", s.protocol)]

    def sweeps(self, domain: str, protocol: str = STRICT) -> int:
        """Return the number of sweeps of a domain that have counts."""
        return max((len(self._counted(s)) for s in self.series(domain, protocol)), default=0)

    def scenes(self, series: Series) -> list[str]:
        """Return the scene of each sweep that has counts."""
        return list(self._counted(series)["scene"])

    def met(self, domain: str, kind: str) -> Results[P]:
        """Return the results of only those sweeps of a domain that have a kind of case, for a fair comparison."""
        here = self.rows[(self.rows["domain"] == domain) & (self.rows["refused"] == "")]
        same = here["sweep"].isin(here["sweep"][here["kind"] == kind])
        return Results.of(self.plan, here[same & here["both"].notna()])

    def counts(self, series: Series) -> ConfusionCounts:
        """Return the pooled counts of all sweeps of a series; zero counts without any."""
        return self._counts.get(series, ConfusionCounts())

    def scores(self, series: Iterable[Series]) -> Scores:
        """Return the pooled scores of several series: their cells by probability."""
        columns = (self._groups[s]["scores"].dropna() for s in series if s in self._groups)
        return sum((scores for column in columns for scores in column), Scores())

    def _counted(self, series: Series) -> pd.DataFrame:
        return self._groups.get(series, self.rows[:0]).dropna(subset="both")

    def each(self, series: Series, measure: Measure) -> F64:
        """Return a measure of each sweep (S,) in the order of their numbers, NaN where it has none."""
        return measure(cells_of(self._counted(series)))

    def numbers(self, series: Series, name: str) -> pd.Series[float]:
        """Return another figure of each sweep that has it, by the number of the sweep in ascending order."""
        rows = self._groups.get(series, self.rows[:0])
        found = rows.set_index("sweep")[name].dropna() if name in rows else pd.Series(dtype=np.float64)
        return found.astype(np.float64)

    def interval(self, series: Iterable[Series], measure: Measure) -> tuple[float, float]:
        """Return the 95 % interval of the mean of a pooled measure over series, by a bootstrap over scenes."""
        parts = [rows for rows in map(self._counted, series) if len(rows)]
        return bootstrap([(cells_of(rows), list(rows["scene"])) for rows in parts], measure) if parts else NO_INTERVAL


def cells_of(rows: pd.DataFrame) -> F64:
    """Return the counts (S, 4) of rows: cells that are both, over, under, neither."""
    return np.asarray(rows[_COUNTS[:4]], np.float64)


def counts_of(rows: pd.DataFrame) -> ConfusionCounts:
    """Return the pooled counts of rows."""
    return _counts_of(rows[_COUNTS].sum())


def _counts_of(sums: Iterable[float]) -> ConfusionCounts:
    both, over, under, neither, area_m2, samples = sums
    return ConfusionCounts(int(both), int(over), int(under), int(neither), float(area_m2), int(samples))


@dataclass(frozen=True, eq=False)
class Domain(Generic[P]):
    """Results of a study in one domain and protocol, by method, case and region."""

    results: Results[P]  # of the study
    name: str  # of the domain
    protocol: str = STRICT  # ``STRICT`` or ``PAPER``

    @property
    def plan(self) -> P:
        """Plan of the study."""
        return self.results.plan

    @cached_property
    def methods(self) -> list[str]:
        """Methods that have rows, in order of appearance."""
        return list(dict.fromkeys(s.method for s in self.results.series(self.name, self.protocol) if s.method))

    @cached_property
    def cases(self) -> list[Case]:
        """Cases that have rows, in order of appearance."""
        return list(dict.fromkeys(s.case for s in self.results.series(self.name, self.protocol)))

    def series(self, method: str, case: Case = BENIGN, region: str = VIEW) -> Series:
        """Return the series of a method, case and region in this domain."""
        return Series(self.name, method, case, region, self.protocol)

    def has(self, method: str, case: Case) -> bool:
        """Return whether a method has rows in a case."""
        return self.series(method, case) in self.results

    def has_wedge(self, case: Case) -> bool:
        """Return whether any method has counts in the wedge of a case."""
        return any(self.counts(method, case, WEDGE).cells for method in self.methods)

    def counts(self, method: str, case: Case = BENIGN, region: str = VIEW) -> ConfusionCounts:
        """Return the pooled counts of all sweeps."""
        return self.results.counts(self.series(method, case, region))

    def scores(self, method: str, cases: Iterable[Case]) -> Scores:
        """Return the pooled scores of several cases: their cells by probability."""
        return self.results.scores(self.series(method, case) for case in cases)

    def best(self, methods: Iterable[str], case: Case, region: str = VIEW) -> str:
        """Return the method with the largest F1; an empty string if none has an F1."""
        scored = {name: self.counts(name, case, region).f1 for name in methods}
        return max((name for name, rate in scored.items() if rate >= 0), key=scored.__getitem__, default="")

    def interval(self, method: str, cases: Iterable[Case], measure: Measure, region: str = VIEW) -> tuple[float, float]:
        """Return the 95 % interval of the mean of a measure over cases."""
        return self.results.interval([self.series(method, case, region) for case in cases], measure)
