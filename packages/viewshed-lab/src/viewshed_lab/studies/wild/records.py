"""What is counted of one sweep by one method, as a row of plain values, and rows pooled."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from typing import Any

import numpy as np

from viewshed.arrays import F64
from viewshed.metrics import BINS, ConfusionCounts
from viewshed_lab.studies.statistics import NO_INTERVAL, Measure, bootstrap

FINE_BINS = 10 * BINS
"""Bins of probability that are kept: ten in each bin of the calibration error."""


@dataclass(frozen=True, slots=True, eq=False)
class WildRecord:
    """One sweep, one method, one target, and what the method was given.

    Attributes:
        set_name: of ``datasets.wild.SETS``.
        domain: ``road`` or ``indoor``.
        scene: its name.
        sweep: number in the scene.
        style: kind of world.
        sensor: family, or beam table.
        mounting: family.
        told: of ``datasets.wild.TOLD``.
        target: name.
        method: an estimator, or a step of the ladder.
        counts: agreement of the claims with the truth over the cells whose truth is known.
        bins: (150, 3) float64 by bin of probability: cells, visible cells, sum of probabilities.
        numbers: other figures by name, see :mod:`viewshed_lab.studies.wild.evaluate`.
    """

    set_name: str
    domain: str
    scene: str
    sweep: int
    style: str
    sensor: str
    mounting: str
    told: str
    target: str
    method: str
    counts: ConfusionCounts
    bins: F64
    numbers: Mapping[str, float]


_COLUMNS = tuple(one.name for one in fields(WildRecord))


def to_table(records: Iterable[WildRecord]) -> dict[str, Any]:
    """Return records as a table of plain values, one row each."""
    return {"columns": list(_COLUMNS), "rows": [_row(record) for record in records]}


def _row(record: WildRecord) -> list[Any]:
    plain = [getattr(record, name) for name in _COLUMNS[:-3]]
    numbers = {name: None if np.isnan(value) else value for name, value in record.numbers.items()}
    bins = [[int(k), *(round(float(one), 3) for one in record.bins[k])] for k in np.flatnonzero(record.bins[:, 0])]
    return [*plain, list(astuple(record.counts)), bins, numbers]


def from_table(table: Mapping[str, Any]) -> Iterator[WildRecord]:
    """Yield the records that :func:`to_table` returned.

    Raises:
        ValueError: the table has other columns.
    """
    if table["columns"] != list(_COLUMNS):
        raise ValueError(f"columns must be {', '.join(_COLUMNS)}, got {table['columns']}; run the study again")
    for row in table["rows"]:
        given = dict(zip(_COLUMNS, row, strict=True))
        numbers = {key: float("nan") if one is None else float(one) for key, one in given["numbers"].items()}
        bins = np.zeros((FINE_BINS, 3))
        for k, *sums in given["bins"]:
            bins[k] = sums
        parts = {"counts": ConfusionCounts(*given["counts"]), "bins": bins, "numbers": numbers}
        yield WildRecord(**given | parts)


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """Records that are looked at together."""

    records: Sequence[WildRecord]

    def where(self, keep: Callable[[WildRecord], bool]) -> Pool:
        """Return those that a condition keeps."""
        return Pool([record for record in self.records if keep(record)])

    def of(self, **values: str | tuple[str, ...]) -> Pool:
        """Return those whose fields have these values, or one of several."""
        wanted = {key: (value,) if isinstance(value, str) else value for key, value in values.items()}
        return self.where(lambda record: all(getattr(record, key) in some for key, some in wanted.items()))

    def names(self, key: str) -> list[str]:
        """Return the values of a field, each once, in the order in which they came."""
        return list(dict.fromkeys(getattr(record, key) for record in self.records))

    @property
    def counts(self) -> ConfusionCounts:
        """The cells of all together."""
        return sum((record.counts for record in self.records), ConfusionCounts(samples=0))

    def interval(self, measure: Measure) -> tuple[float, float]:
        """Return the 95 % interval of a measure of pooled counts, by a bootstrap over scenes."""
        if not self.records:
            return NO_INTERVAL
        counts = np.array([[c.both, c.over, c.under, c.neither] for c in (one.counts for one in self.records)], float)
        return bootstrap([(counts, [record.scene for record in self.records])], measure)

    def bins(self) -> F64:
        """Return (150, 3) the bins of all together."""
        return np.asarray(sum((record.bins for record in self.records), np.zeros((FINE_BINS, 3))), np.float64)

    def ece(self) -> float:
        """Return the expected calibration error over all cells, in 15 bins; NaN without cells."""
        bins = self.bins().reshape(BINS, -1, 3).sum(axis=1)
        cells = bins[:, 0].sum()
        return float(np.abs(bins[:, 2] - bins[:, 1]).sum() / cells) if cells else float("nan")

    def recall_at(self, precision: float) -> float:
        """Return the largest recall of a threshold (steps of 1/150) that reaches the precision; 0 where none does."""
        cells, visible, _ = self.bins()[::-1].cumsum(axis=0).T
        reached = visible >= precision * np.maximum(cells, 1)
        return float((visible[reached] / visible[-1]).max(initial=0.0)) if visible[-1] else float("nan")

    def clear_f1(self) -> float:
        """Return the F1 of the cells whose true number of returns is clear of ``min_returns``; NaN without any."""
        both, over, under = (
            sum(record.numbers[f"clear_{name}"] for record in self.records) for name in ("both", "over", "under")
        )
        return 2 * both / (2 * both + over + under) if both + over + under else float("nan")

    def mean(self, name: str) -> float:
        """Return the mean of a figure over the scenes that have it; NaN where none has."""
        by_scene: dict[str, list[float]] = {}
        for record in self.records:
            if not np.isnan(record.numbers.get(name, float("nan"))):
                by_scene.setdefault(record.scene, []).append(record.numbers[name])
        return float(np.mean([np.mean(values) for values in by_scene.values()])) if by_scene else float("nan")

    def mean_f1(self) -> float:
        """Return the mean over scenes of the F1 of their cells; NaN where no scene has any."""
        scenes = [self.of(scene=name).counts.f1 for name in self.names("scene")]
        return float(np.nanmean(scenes)) if not np.isnan(scenes).all() else float("nan")

    def share(self, part: str, whole: str) -> float:
        """Return the sum of one figure over that of another; NaN where that is 0."""
        below = sum(record.numbers[whole] for record in self.records if whole in record.numbers)
        above = sum(record.numbers[part] for record in self.records if part in record.numbers)
        return above / below if below else float("nan")
