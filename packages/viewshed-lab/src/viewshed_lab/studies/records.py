"""What a study counts: one row for each sweep, method, case and region, and all of them together as a table."""

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
"""Regions: all cells whose truth is known; those whose azimuth the attacker reaches; the same with nothing attacked."""

STRICT, PAPER = "strict", "paper"
"""Protocols: exact truth on our grids; the paper's label on its own."""

SEVERAL = -1
"""Number of the sweep in a row of several sweeps together."""

P = TypeVar("P")

Row = dict[str, Any]
"""Whose it is and what was counted, see :func:`row_of`."""


@dataclass(frozen=True, slots=True, order=True)
class Case:
    """What is done to a sweep before it is estimated."""

    kind: str  # of ``cases.KINDS``
    name: str = ""  # of the attack or corruption
    level: str = ""  # budget, severity or ``attribute value``
    defense: str = ""  # that the result goes through; empty for none


BENIGN = Case("benign")


@dataclass(frozen=True, slots=True)
class Series:
    """What rows have in common that are pooled."""

    domain: str  # where the sweeps are from
    method: str  # an estimator by name; empty where the case alone decides
    case: Case = BENIGN  # what was done to the sweeps
    region: str = VIEW  # of the grid
    protocol: str = STRICT  # ``STRICT`` or ``PAPER``

    def of(self, region: str) -> Series:
        """Return the same of another region."""
        return replace(self, region=region)

    def under(self, case: Case) -> Series:
        """Return the same in another case."""
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
    """Return the row of one sweep, or of several together.

    Args:
        series: what it is of.
        scene: of the sweep.
        sweep: its number in the domain, or ``SEVERAL``.
        counts: agreement with the truth at the threshold of the study.
        scores: cells by probability.
        refused: why the case could not be made of this sweep; then there is nothing else.
        numbers: other figures by name: ``auprc``, or what a defense dropped.
    """
    keys = (series.domain, series.method, *astuple(series.case), series.region, series.protocol)
    row = dict(zip(_KEYS, keys, strict=True)) | {"scene": scene, "sweep": sweep, "refused": refused} | numbers
    return row | ({} if counts is None else asdict(counts)) | ({} if scores is None else {"scores": scores})


def pool(rows: Iterable[Row]) -> list[Row]:
    """Return one row for each series, of all its sweeps together; other figures than counts are left out."""
    pooled: dict[tuple[str, ...], Row] = {}
    for row in rows:
        keys = {name: row[name] for name in _KEYS}
        both = pooled.setdefault(tuple(keys.values()), keys | {"scene": "", "sweep": SEVERAL, "refused": ""})
        both |= {name: both[name] + row[name] if name in both else row[name]
                 for name in (*_COUNTS, "scores") if name in row}  # fmt: skip
    return list(pooled.values())


def _series(keys: tuple[str, ...]) -> Series:
    domain, method, *case, region, protocol = keys
    return Series(domain, method, Case(*case), region, protocol)


@dataclass(frozen=True, eq=False)
class Results(Generic[P]):
    """All that a study has found so far."""

    plan: P  # of the study
    rows: pd.DataFrame  # what its jobs counted, one row as of :func:`row_of` each
    # of each finished job by its key: what is no row
    facts: Mapping[tuple[str, ...], dict[str, Any]] = field(default_factory=dict)
    commits: Iterable[str] = ()  # of the code that did the jobs, as far as they are known

    @classmethod
    def of(
        cls,
        plan: P,
        rows: Iterable[Row] | pd.DataFrame,
        facts: Mapping[tuple[str, ...], dict[str, Any]] | None = None,
        commits: Iterable[str] = (),
    ) -> Self:
        """Return the results of a plan from rows; their order changes no figure."""
        frame = rows if isinstance(rows, pd.DataFrame) else pd.DataFrame(list(rows))
        frame = frame.reindex(columns=[*_COLUMNS, *(name for name in frame.columns if name not in _COLUMNS)])
        return cls(plan, frame.reset_index(drop=True), facts or {}, commits)

    @cached_property
    def refused(self) -> dict[tuple[str, Case, str], int]:
        """Domain, case, and why it could not be made, with how many sweeps that was."""
        refused = self.rows[self.rows["refused"] != ""]
        reasons = refused[["domain", "kind", "name", "level", "defense", "refused"]].itertuples(index=False, name=None)
        return dict(Counter((domain, Case(*case), why) for domain, *case, why in reasons))

    @cached_property
    def _groups(self) -> dict[Series, pd.DataFrame]:
        """The rows of each series in the order of the sweeps."""
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
        """Return of what there are rows, of a domain and a protocol if they are given."""
        return [s for s in self._groups if domain in ("", s.domain) and protocol in ("", s.protocol)]

    def sweeps(self, domain: str, protocol: str = STRICT) -> int:
        """Return how many sweeps of a domain there are counts of."""
        return max((len(self._counted(s)) for s in self.series(domain, protocol)), default=0)

    def scenes(self, series: Series) -> list[str]:
        """Return the scene of each sweep that there are counts of."""
        return list(self._counted(series)["scene"])

    def met(self, domain: str, kind: str) -> Results[P]:
        """Return the counts of only those sweeps of a domain that met a kind of case, to compare like with like."""
        here = self.rows[(self.rows["domain"] == domain) & (self.rows["refused"] == "")]
        same = here["sweep"].isin(here["sweep"][here["kind"] == kind])
        return Results.of(self.plan, here[same & here["both"].notna()])

    def counts(self, series: Series) -> ConfusionCounts:
        """Return the cells of all sweeps together; of none where there are none."""
        return self._counts.get(series, ConfusionCounts())

    def scores(self, series: Iterable[Series]) -> Scores:
        """Return the cells of several series together by probability."""
        every = (self._groups[s]["scores"].dropna() for s in series if s in self._groups)
        return sum((one for scores in every for one in scores), Scores())

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
        found = [rows for rows in map(self._counted, series) if len(rows)]
        return bootstrap([(cells_of(rows), list(rows["scene"])) for rows in found], measure) if found else NO_INTERVAL


def cells_of(rows: pd.DataFrame) -> F64:
    """Return the cells (S, 4) of some rows: both, over, under, neither."""
    return np.asarray(rows[_COUNTS[:4]], np.float64)


def counts_of(rows: pd.DataFrame) -> ConfusionCounts:
    """Return the cells of some rows together."""
    return _counts_of(rows[_COUNTS].sum())


def _counts_of(sums: Iterable[float]) -> ConfusionCounts:
    both, over, under, neither, area_m2, samples = sums
    return ConfusionCounts(int(both), int(over), int(under), int(neither), float(area_m2), int(samples))


@dataclass(frozen=True, eq=False)
class Domain(Generic[P]):
    """What a study has found in one domain by one protocol, by method, case and region."""

    results: Results[P]  # of the study
    name: str  # of the domain
    protocol: str = STRICT  # ``STRICT`` or ``PAPER``

    @property
    def plan(self) -> P:
        """Plan of the study."""
        return self.results.plan

    @cached_property
    def methods(self) -> list[str]:
        """Methods that there are rows of, in the order in which they came."""
        return list(dict.fromkeys(s.method for s in self.results.series(self.name, self.protocol) if s.method))

    @cached_property
    def cases(self) -> list[Case]:
        """Cases that there are rows of, in the order in which they came."""
        return list(dict.fromkeys(s.case for s in self.results.series(self.name, self.protocol)))

    def series(self, method: str, case: Case = BENIGN, region: str = VIEW) -> Series:
        """Return what rows of this domain have in common."""
        return Series(self.name, method, case, region, self.protocol)

    def has(self, method: str, case: Case) -> bool:
        """Return whether a method was tried in a case."""
        return self.series(method, case) in self.results

    def has_wedge(self, case: Case) -> bool:
        """Return whether there are cells in a wedge of the case."""
        return any(self.counts(method, case, WEDGE).cells for method in self.methods)

    def counts(self, method: str, case: Case = BENIGN, region: str = VIEW) -> ConfusionCounts:
        """Return the cells of all sweeps together."""
        return self.results.counts(self.series(method, case, region))

    def scores(self, method: str, cases: Iterable[Case]) -> Scores:
        """Return the cells of several cases together by probability."""
        return self.results.scores(self.series(method, case) for case in cases)

    def best(self, methods: Iterable[str], case: Case, region: str = VIEW) -> str:
        """Return which of the methods has the largest F1; empty where none has any."""
        scored = {name: self.counts(name, case, region).f1 for name in methods}
        return max((name for name, rate in scored.items() if rate >= 0), key=scored.__getitem__, default="")

    def interval(self, method: str, cases: Iterable[Case], measure: Measure, region: str = VIEW) -> tuple[float, float]:
        """Return the 95 % interval of the mean of a measure over cases."""
        return self.results.interval([self.series(method, case, region) for case in cases], measure)
