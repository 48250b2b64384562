"""What a study counts: one record for each sweep, method, case and region, and all of them pooled."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import astuple, dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np

from viewshed.arrays import F64
from viewshed.metrics import ConfusionCounts, Scores
from viewshed_lab.studies.statistics import NO_INTERVAL, Measure, bootstrap

VIEW, WEDGE, UNTOUCHED = "view", "wedge", "untouched wedge"
"""Regions: all cells whose truth is known; those whose azimuth the attacker reaches; the same with nothing attacked."""

STRICT, PAPER = "strict", "paper"
"""Protocols: exact truth on our grids; the paper's label on its own."""

SEVERAL = -1
"""Number of the sweep in a record of several sweeps together."""


@dataclass(frozen=True, slots=True, order=True)
class Case:
    """What is done to a sweep before it is estimated.

    Attributes:
        kind: of ``cases.KINDS``.
        name: of the attack or corruption.
        level: budget, severity or ``attribute value``.
        defense: that the result goes through; empty for none.
    """

    kind: str
    name: str = ""
    level: str = ""
    defense: str = ""


BENIGN = Case("benign")


@dataclass(frozen=True, slots=True)
class Series:
    """What records have in common that are pooled.

    Attributes:
        domain: where the sweeps are from.
        method: an estimator by name; empty where the case alone decides.
        case: what was done to the sweeps.
        region: of the grid.
        protocol: ``STRICT`` or ``PAPER``.
    """

    domain: str
    method: str
    case: Case = BENIGN
    region: str = VIEW
    protocol: str = STRICT

    def of(self, region: str) -> Series:
        """Return the same of another region."""
        return replace(self, region=region)

    def under(self, case: Case) -> Series:
        """Return the same in another case."""
        return replace(self, case=case)


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """What was counted of one sweep, or of several together.

    Attributes:
        series: what it is of.
        scene: of the sweep.
        sweep: its number in the domain, or ``SEVERAL``.
        counts: agreement with the truth at the threshold of the study, or None.
        scores: cells by probability, or None.
        numbers: other figures by name: ``auprc``, or what a defense dropped.
        refused: why the case could not be made of this sweep; then there is nothing else.
    """

    series: Series
    scene: str
    sweep: int
    counts: ConfusionCounts | None = None
    scores: Scores | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)
    refused: str = ""


_COLUMNS = ("domain", "scene", "sweep", "method", "kind", "name", "level", "defense", "region", "protocol", "counts",
            "scores", "numbers", "refused")  # fmt: skip


def to_table(records: Iterable[Record]) -> dict[str, Any]:
    """Return records as a table of plain values: columns that are the same in all rows once, the others by row."""
    rows = [_row(record) for record in records]
    same = {
        name: rows[0][k] for k, name in enumerate(_COLUMNS) if rows and all(row[k] == rows[0][k] for row in rows)
    }  # fmt: skip
    varying = [k for k, name in enumerate(_COLUMNS) if name not in same]
    columns = [_COLUMNS[k] for k in varying]
    return {"same": same, "columns": columns, "rows": [[row[k] for k in varying] for row in rows]}


def _row(record: Record) -> list[Any]:
    of, case = record.series, record.series.case
    counts = None if record.counts is None else list(astuple(record.counts))
    scores = None if record.scores is None else record.scores.to_json()
    return [of.domain, record.scene, record.sweep, of.method, case.kind, case.name, case.level, case.defense,
            of.region, of.protocol, counts, scores, dict(record.numbers), record.refused]  # fmt: skip


def from_table(table: Mapping[str, Any]) -> Iterator[Record]:
    """Yield the records that :func:`to_table` returned.

    Raises:
        ValueError, TypeError, KeyError: the table is damaged.
    """
    for values in table["rows"]:
        row = table["same"] | dict(zip(table["columns"], values, strict=True))
        domain, scene, sweep, method, kind, name, level, defense, region, protocol, counts, scores, numbers, refused = (
            row[column] for column in _COLUMNS
        )
        series = Series(domain, method, Case(kind, name, level, defense), region, protocol)
        yield Record(
            series, scene, int(sweep), None if counts is None else ConfusionCounts(*counts),
            None if scores is None else Scores.from_json(scores), dict(numbers), refused,
        )  # fmt: skip


def pool(records: Iterable[Record]) -> list[Record]:
    """Return one record for each series, of all its sweeps together; other figures than counts are left out."""
    pooled: dict[Series, Record] = {}
    for record in records:
        before = pooled.get(record.series, Record(record.series, "", SEVERAL))
        pooled[record.series] = replace(
            before, counts=_sum(before.counts, record.counts), scores=_sum(before.scores, record.scores),
            refused=record.refused,
        )  # fmt: skip
    return list(pooled.values())


N = TypeVar("N", ConfusionCounts, Scores)


def _sum(one: N | None, other: N | None) -> N | None:
    return other if one is None else one if other is None else one + other


@dataclass(slots=True, eq=False)
class _Rows:
    """The records of one series, column by column."""

    sweeps: list[int] = field(default_factory=list)
    scenes: list[str] = field(default_factory=list)
    counts: list[ConfusionCounts] = field(default_factory=list)
    numbers: list[Mapping[str, float]] = field(default_factory=list)
    scores: Scores | None = None

    def add(self, record: Record) -> None:
        self.scores = _sum(self.scores, record.scores)
        if record.counts is not None or record.numbers:
            self.sweeps.append(record.sweep)
            self.scenes.append(record.scene)
            self.numbers.append(record.numbers)
        if record.counts is not None:
            self.counts.append(record.counts)

    def cells(self) -> F64:
        """Return the cells (S, 4) of each sweep: both, over, under, neither."""
        return np.array([[c.both, c.over, c.under, c.neither] for c in self.counts], np.float64).reshape(-1, 4)


P = TypeVar("P")


@dataclass(frozen=True, slots=True, eq=False)
class Results(Generic[P]):
    """All that a study has found so far.

    Attributes:
        plan: of the study.
        facts: of each finished job by its key: what is no record.
        refused: domain, case, and why it could not be made, with how many sweeps that was.
        commits: of the code that did the jobs, as far as they are known.
    """

    plan: P
    facts: dict[tuple[str, ...], dict[str, Any]] = field(default_factory=dict)
    refused: dict[tuple[str, Case, str], int] = field(default_factory=dict)
    commits: set[str] = field(default_factory=set)
    _rows: dict[Series, _Rows] = field(default_factory=dict)

    def add(self, records: Iterable[Record]) -> None:
        """Take records; their order changes no figure."""
        for record in records:
            if record.refused:
                reason = (record.series.domain, record.series.case, record.refused)
                self.refused[reason] = self.refused.get(reason, 0) + 1
            else:
                self._rows.setdefault(record.series, _Rows()).add(record)

    def __contains__(self, series: Series) -> bool:
        return series in self._rows

    def series(self, domain: str = "", protocol: str = "") -> list[Series]:
        """Return of what there are records, of a domain and a protocol if they are given."""
        return [s for s in self._rows if domain in ("", s.domain) and protocol in ("", s.protocol)]

    def methods(self, domain: str, protocol: str = STRICT) -> list[str]:
        """Return the methods that there are records of, in the order in which they came."""
        return list(dict.fromkeys(s.method for s in self.series(domain, protocol) if s.method))

    def cases(self, domain: str, protocol: str = STRICT) -> list[Case]:
        """Return the cases that there are records of, in the order in which they came."""
        return list(dict.fromkeys(s.case for s in self.series(domain, protocol)))

    def sweeps(self, domain: str, protocol: str = STRICT) -> int:
        """Return how many sweeps of a domain there are records of."""
        return max((len(self._rows[s].counts) for s in self.series(domain, protocol)), default=0)

    def scenes(self, series: Series) -> set[str]:
        """Return the scenes of the sweeps that there are records of."""
        return set(self._rows[series].scenes) if series in self._rows else set()

    def met(self, domain: str, kind: str) -> Results[P]:
        """Return the records of only those sweeps of a domain that met a kind of case, to compare like with like."""
        of_kind = [s for s in self.series(domain) if s.case.kind == kind]
        numbers = {number for s in of_kind for number in self._rows[s].sweeps}
        found = Results(self.plan)
        for series in self.series(domain):
            rows = self._rows[series]
            kept = [k for k, number in enumerate(rows.sweeps) if number in numbers]
            if kept and len(rows.counts) == len(rows.sweeps):
                found._rows[series] = _Rows(
                    [rows.sweeps[k] for k in kept], [rows.scenes[k] for k in kept],
                    [rows.counts[k] for k in kept], [rows.numbers[k] for k in kept],
                )  # fmt: skip
        return found

    def counts(self, series: Series) -> ConfusionCounts:
        """Return the cells of all sweeps together; of none where there are none."""
        rows = self._rows.get(series)
        if rows is None or not rows.counts:
            return ConfusionCounts()
        return sum(rows.counts[1:], rows.counts[0])

    def scores(self, series: Iterable[Series]) -> Scores:
        """Return the cells of several series together by probability."""
        found = (self._rows[s].scores for s in series if s in self._rows)
        return sum((scores for scores in found if scores is not None), Scores())

    def array(self, series: Series) -> F64:
        """Return the cells (S, 4) of each sweep in the order of their numbers: both, over, under, neither."""
        rows = self._rows.get(series, _Rows())
        return rows.cells()[np.argsort(rows.sweeps[: len(rows.counts)], kind="stable")]

    def each(self, series: Series, measure: Measure) -> F64:
        """Return a measure of each sweep (S,), NaN where it has none."""
        return measure(self.array(series))

    def by_sweep(self, series: Series, name: str) -> dict[int, float]:
        """Return another figure of each sweep that has it, by the number of the sweep in ascending order."""
        rows = self._rows.get(series, _Rows())
        return dict(sorted((sweep, n[name]) for sweep, n in zip(rows.sweeps, rows.numbers, strict=True) if name in n))

    def numbers(self, series: Series, name: str) -> F64:
        """Return another figure of each sweep that has it (S,), in the order of their numbers."""
        return np.array(list(self.by_sweep(series, name).values()), np.float64)

    def interval(self, series: Iterable[Series], measure: Measure) -> tuple[float, float]:
        """Return the 95 % interval of the mean of a pooled measure over series, by a bootstrap over scenes."""
        found = [self._rows[s] for s in series if s in self._rows]
        cases = [(rows.cells(), rows.scenes) for rows in found if rows.counts]
        return bootstrap(cases, measure) if cases else NO_INTERVAL


@dataclass(frozen=True, eq=False)
class Domain(Generic[P]):
    """What a study has found in one domain by one protocol, by method, case and region.

    Attributes:
        results: of the study.
        name: of the domain.
        protocol: ``STRICT`` or ``PAPER``.
    """

    results: Results[P]
    name: str
    protocol: str = STRICT

    @property
    def plan(self) -> P:
        """Plan of the study."""
        return self.results.plan

    @cached_property
    def methods(self) -> list[str]:
        """Methods that there are records of, in the order in which they came."""
        return self.results.methods(self.name, self.protocol)

    @cached_property
    def cases(self) -> list[Case]:
        """Cases that there are records of, in the order in which they came."""
        return self.results.cases(self.name, self.protocol)

    def series(self, method: str, case: Case = BENIGN, region: str = VIEW) -> Series:
        """Return what records of this domain have in common."""
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

    def scores(self, method: str, cases: Iterable[Case], region: str = VIEW) -> Scores:
        """Return the cells of several cases together by probability."""
        return self.results.scores(self.series(method, case, region) for case in cases)

    def best(self, methods: Iterable[str], case: Case, region: str = VIEW) -> str:
        """Return which of the methods has the largest F1; empty where none has any."""
        scored = {name: self.counts(name, case, region).f1 for name in methods}
        return max((name for name, rate in scored.items() if rate >= 0), key=scored.__getitem__, default="")

    def interval(self, method: str, cases: Iterable[Case], measure: Measure, region: str = VIEW) -> tuple[float, float]:
        """Return the 95 % interval of the mean of a measure over cases."""
        return self.results.interval([self.series(method, case, region) for case in cases], measure)
