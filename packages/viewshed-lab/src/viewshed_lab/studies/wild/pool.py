"""Pools result rows of the wild study (one per sweep and method) and computes figures over them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from viewshed.arrays import F64, Mask
from viewshed.metrics import BINS, ConfusionCounts
from viewshed_lab.studies.records import cells_of, counts_of
from viewshed_lab.studies.statistics import NO_INTERVAL, Measure, bootstrap, f1

FINE_BINS = 10 * BINS
"""Number of stored bins of probability: ten per bin of the calibration error."""


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """Rows of :func:`viewshed_lab.studies.wild.evaluate.row_of`."""

    rows: pd.DataFrame

    def where(self, keep: Mask | pd.Series[bool]) -> Pool:
        """Return the pool of the rows in a mask."""
        return Pool(self.rows[keep])

    def of(self, **values: str | Sequence[str]) -> Pool:
        """Return the pool of the rows whose columns have the given values, or one of several."""
        keep = [self.rows[key].isin([value] if isinstance(value, str) else value) for key, value in values.items()]
        return self.where(np.logical_and.reduce(keep))

    def names(self, key: str) -> list[str]:
        """Return the unique values of a column, in order of appearance."""
        return list(dict.fromkeys(self.rows[key]))

    @property
    def counts(self) -> ConfusionCounts:
        """The pooled counts."""
        return counts_of(self.rows)

    def interval(self, measure: Measure) -> tuple[float, float]:
        """Return the 95 % interval of a measure of pooled counts, by a bootstrap over scenes."""
        return NO_INTERVAL if self.rows.empty else bootstrap([(cells_of(self.rows), list(self.rows["scene"]))], measure)

    def bins(self) -> F64:
        """Return a table (150, 3) by bin of probability: cells, visible cells and sum of probabilities."""
        return np.asarray(sum(map(np.asarray, self.rows["bins"]), np.zeros(3 * FINE_BINS))).reshape(FINE_BINS, 3)

    def ece(self) -> float:
        """Return the expected calibration error over all cells, in 15 bins; NaN without cells."""
        bins = self.bins().reshape(BINS, -1, 3).sum(axis=1)
        cells = bins[:, 0].sum()
        return float(np.abs(bins[:, 2] - bins[:, 1]).sum() / cells) if cells else float("nan")

    def recall_at(self, precision: float) -> float:
        """Return the largest recall over thresholds (steps of 1/150) that reach the precision; 0 if none does."""
        cells, visible, _ = self.bins()[::-1].cumsum(axis=0).T
        reached = visible >= precision * np.maximum(cells, 1)
        return float((visible[reached] / visible[-1]).max(initial=0.0)) if visible[-1] else float("nan")

    def clear_f1(self) -> float:
        """Return the F1 of the cells whose true number of returns is not near ``min_returns``; NaN without any."""
        clear = self.rows[["clear_both", "clear_over", "clear_under"]].sum().to_numpy(np.float64)
        return float(f1(np.append(clear, 0.0)))

    def mean(self, name: str) -> float:
        """Return the mean of a figure over the scenes that have it; NaN if none has."""
        return float(self.rows.groupby("scene")[name].mean().mean())

    def mean_f1(self) -> float:
        """Return the mean over scenes of the F1 of their cells; NaN if no scene has any."""
        rates = f1(cells_of(self.rows.groupby("scene")[["both", "over", "under", "neither"]].sum()))
        return float("nan") if np.isnan(rates).all() else float(np.nanmean(rates))

    def share(self, part: str, whole: str) -> float:
        """Return the sum of one figure divided by that of another; NaN if the latter is 0."""
        numerator, denominator = self.rows[part].sum(), self.rows[whole].sum()
        return float(numerator / denominator) if denominator else float("nan")
