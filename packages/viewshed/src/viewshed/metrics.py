"""Metrics of the probability of visible against truth: confusion counts, ranking, calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viewshed.arrays import Mask


@dataclass(frozen=True, slots=True)
class ConfusionCounts:
    """Confusion counts of the cells of two masks, over any number of samples.

    >>> counts = ConfusionCounts(6, 2, 2, 10, area_m2=5.0)
    >>> counts.precision, counts.recall, counts.f1, counts.iou, counts.over_m2
    (0.75, 0.75, 0.75, 0.6, 0.5)
    """

    both: int = 0  # cells visible in estimate and truth (true positives)
    over: int = 0  # cells visible in the estimate only (false positives)
    under: int = 0  # cells visible in the truth only (false negatives)
    neither: int = 0  # cells visible in neither (true negatives)
    area_m2: float = 0.0  # total area of these cells
    samples: int = 1  # number of samples

    @classmethod
    def of(cls, claimed: Mask, true: Mask, mask: Mask, cell_area_m2: float) -> ConfusionCounts:
        """Return the counts of the masks ``claimed`` and ``true`` over the cells of ``mask``."""
        cells, claims, trues = int(mask.sum()), int((claimed & mask).sum()), int((true & mask).sum())
        both = int((claimed & true & mask).sum())
        return cls(both, claims - both, trues - both, cells - claims - trues + both, cells * cell_area_m2)

    def __add__(self, other: ConfusionCounts) -> ConfusionCounts:
        """Return the sums of the counts."""
        return ConfusionCounts(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.both + self.over + self.under + self.neither

    @property
    def precision(self) -> float:
        """Share of the claimed cells that are visible; NaN where none is claimed."""
        return _rate(self.both, self.both + self.over)

    @property
    def recall(self) -> float:
        """Share of the visible cells that are claimed; NaN where none is visible."""
        return _rate(self.both, self.both + self.under)

    @property
    def accuracy(self) -> float:
        """Share of the cells on which both agree; NaN without cells."""
        return _rate(self.both + self.neither, self.cells)

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; NaN where nothing is claimed and nothing visible."""
        return _rate(2 * self.both, 2 * self.both + self.over + self.under)

    @property
    def iou(self) -> float:
        """Intersection over union of the claimed and the visible cells; NaN if both are empty."""
        return _rate(self.both, self.both + self.over + self.under)

    @property
    def over_m2(self) -> float:
        """Mean area per sample that is claimed but not visible, in square meters."""
        return self.over * _rate(self.area_m2, self.cells) / self.samples

    @property
    def under_m2(self) -> float:
        """Mean area per sample that is visible but not claimed, in square meters."""
        return self.under * _rate(self.area_m2, self.cells) / self.samples


def _rate(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")


STEPS = 1000
"""Steps of the histogram of probabilities, 0.001 each; thresholds are multiples of a step."""

BINS = 15
"""Number of bins of the calibration error, of equal width."""

FORMAT_VERSION = 1

_PROB_UNITS = 2**24

_SQUARE_UNITS = 2**28

_MAX_STD = 0.5

_CHUNK = 2**24

_EDGES = (np.arange(STEPS + 2) / STEPS).astype(np.float32)

_EULER = 0.5772156649015329

_SMALL = 64

_HARMONIC = np.concatenate([[0.0], np.cumsum(1.0 / np.arange(1, _SMALL))])

Counts = NDArray[np.int64]


def _no_cells() -> Counts:
    return np.zeros((STEPS + 1, 2), np.int64)


def _no_bins() -> Counts:
    return np.zeros((BINS, 3), np.int64)


@dataclass(slots=True, eq=False)
class Scores:
    """Histograms of probabilities against truth, from which all metrics follow; fill by ``add``, merge by ``+``.

    All counts are integers: the order and grouping of sweeps do not change the result.
    Pass only cells whose truth is known.

    >>> scores = Scores()
    >>> scores.add([0.9, 0.8, 0.6, 0.1], [True, True, False, False])
    >>> scores.precision(), scores.recall(), scores.f1(), scores.accuracy()
    (0.6666666666666666, 1.0, 0.8, 0.75)
    >>> round(scores.brier(), 6), scores.auprc()
    (0.105, 1.0)
    """

    # (1001, 2) int64 counts of not visible and of visible cells, by step of probability: k holds [k, k + 1) thousandths
    steps: Counts = field(default_factory=_no_cells)
    # (15, 3) int64 by calibration bin: cells, visible cells, sum of the cells' probabilities in units of 2⁻²⁴
    bins: Counts = field(default_factory=_no_bins)
    squares: int = 0  # sum of squared errors of the probabilities in units of 2⁻²⁸
    # (1001, 2) int64 counts of cells classified right and wrong at threshold 0.5, by standard deviation in steps of
    # 0.0005 up to 0.5; cells without a standard deviation are not counted
    doubts: Counts = field(default_factory=_no_cells)

    def add(self, prob: ArrayLike, visible: ArrayLike, std: ArrayLike | None = None) -> None:
        """Add cells.

        Args:
            prob: (…) probability of visible in [0, 1].
            visible: (…) bool, truth.
            std: (…) standard deviation of the probability, or None.

        Raises:
            ValueError: shapes differ, or a value is out of range or NaN.
        """
        probs, truth = np.asarray(prob, np.float32), np.asarray(visible)
        if truth.dtype != np.bool_ or truth.shape != probs.shape:
            raise ValueError(f"visible must be bool {probs.shape} as prob is, got {truth.dtype} {truth.shape}")
        if not ((probs >= 0) & (probs <= 1)).all():
            raise ValueError("prob must lie in [0, 1] and not be NaN")
        if std is not None:
            self._count_std(probs, truth, np.asarray(std, np.float32))
        probs, truth = probs.reshape(-1), truth.reshape(-1)
        for start in range(0, probs.size, _CHUNK):
            self._count(probs[start : start + _CHUNK], truth[start : start + _CHUNK])

    def _count(self, prob: NDArray[np.float32], visible: NDArray[np.bool_]) -> None:
        """Count at most 2²⁴ cells, so that a double holds the sums of integers exactly."""
        self.steps += _histogram(_step_of(prob), visible)
        exact = prob.astype(np.float64)
        bins = np.minimum((exact * BINS).astype(np.intp), BINS - 1)
        units = np.bincount(bins, np.rint(exact * _PROB_UNITS), BINS)
        cells, visible_cells = np.bincount(bins, None, BINS), np.bincount(bins[visible], None, BINS)
        self.bins += np.stack([cells, visible_cells, units], 1).astype(int)
        self.squares += int(np.rint((exact - visible) ** 2 * _SQUARE_UNITS).sum())

    def _count_std(self, prob: NDArray[np.float32], visible: NDArray[np.bool_], std: NDArray[np.float32]) -> None:
        if std.shape != prob.shape or not (std >= 0).all():
            raise ValueError(f"std must be {prob.shape} as prob is, not negative and not NaN, got {std.shape}")
        level = np.rint(np.minimum(std, _MAX_STD) * (STEPS / _MAX_STD)).astype(np.intp)
        self.doubts += _histogram(level.reshape(-1), ((prob >= _MAX_STD) != visible).reshape(-1))

    def __add__(self, other: Scores) -> Scores:
        """Return the sums of the counts."""
        return Scores(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))

    @property
    def cells(self) -> int:
        """Number of cells."""
        return int(self.steps.sum())

    def counts(self, threshold: float = 0.5) -> tuple[int, int, int, int]:
        """Return the numbers of cells visible in both, in the estimate only, in the truth only, and in neither.

        Raises:
            ValueError: the threshold is not a multiple of 0.001 in (0, 1].
        """
        step = round(threshold * STEPS)
        if not 0 < step <= STEPS or abs(threshold * STEPS - step) > 1e-6:
            raise ValueError(f"threshold must be a multiple of 0.001 in (0, 1], got {threshold}")
        (over, both), (neither, under) = self.steps[step:].sum(axis=0), self.steps[:step].sum(axis=0)
        return int(both), int(over), int(under), int(neither)

    def confusion(self, threshold: float = 0.5) -> ConfusionCounts:
        """Return the confusion counts at a threshold, without an area."""
        return ConfusionCounts(*self.counts(threshold))

    def precision(self, threshold: float = 0.5) -> float:
        """Return the share of the claimed cells that are visible; NaN where none is claimed."""
        return self.confusion(threshold).precision

    def recall(self, threshold: float = 0.5) -> float:
        """Return the share of the visible cells that are claimed; NaN where none is visible."""
        return self.confusion(threshold).recall

    def accuracy(self, threshold: float = 0.5) -> float:
        """Return the share of the cells on which estimate and truth agree; NaN without cells."""
        return self.confusion(threshold).accuracy

    def f1(self, threshold: float = 0.5) -> float:
        """Return the harmonic mean of precision and recall; NaN where nothing is claimed and nothing visible."""
        return self.confusion(threshold).f1

    def iou(self, threshold: float = 0.5) -> float:
        """Return the intersection over union of the claimed and the visible cells; NaN if both are empty."""
        return self.confusion(threshold).iou

    def auprc(self) -> float:
        """Return average precision, Σ (Rₙ - Rₙ₋₁) Pₙ over thresholds in steps of 0.001; NaN where no cell is visible.

        As scikit-learn's ``average_precision_score``, without interpolation between thresholds.
        """
        return _average_precision(self.steps)

    def reliability(self) -> NDArray[np.float64]:
        """Return (15, 3) by calibration bin: mean probability, share of visible cells, cells; NaN in empty bins."""
        cells = self.bins[:, 0].astype(np.float64)
        divisor = np.where(cells > 0, cells, np.nan)
        return np.stack([self.bins[:, 2] / (_PROB_UNITS * divisor), self.bins[:, 1] / divisor, cells], axis=1)

    def ece(self) -> float:
        """Return the expected calibration error, Σ (n_b / n) |mean probability - share visible|; NaN without cells.

        The probability of visible has 15 bins b of equal width (Naeini et al., AAAI 2015; Guo et al., ICML 2017).
        """
        gaps = np.abs(self.bins[:, 2] / _PROB_UNITS - self.bins[:, 1])
        return _rate(float(gaps.sum()), self.cells)

    def brier(self) -> float:
        """Return the mean squared error of the probability (Brier, 1950); NaN without cells."""
        return _rate(self.squares / _SQUARE_UNITS, self.cells)

    def aurc(self) -> float:
        """Return the area under the risk-coverage curve with uncertainty 1 - max(p, 1 - p); NaN without cells.

        The risk at coverage k / n is the share of wrong cells (at threshold 0.5) among the k least uncertain; the area
        is its mean over k (Geifman, Uziel and El-Yaniv, ICLR 2019). Ties are in random order: this is the expectation.
        """
        half = STEPS // 2
        low, high = self.steps[:half], self.steps[half:STEPS, ::-1][::-1].copy()
        high[0] += self.steps[STEPS, ::-1]
        return _area(low + high)

    def aurc_std(self) -> float:
        """Return the area under the risk-coverage curve with the standard deviation as uncertainty; NaN without any."""
        return _area(self.doubts)

    def summary(self, threshold: float = 0.5) -> dict[str, float]:
        """Return every metric by name; those of a mask are at the threshold."""
        of_mask = {name: getattr(self, name)(threshold) for name in ("precision", "recall", "accuracy", "f1", "iou")}
        of_prob = {name: getattr(self, name)() for name in ("auprc", "ece", "brier", "aurc", "aurc_std")}
        return of_mask | of_prob

    def to_json(self) -> dict[str, Any]:
        """Return all counts as JSON values; rows of zeros are left out."""
        return {
            "version": FORMAT_VERSION, "steps": _rows(self.steps), "bins": _rows(self.bins),
            "squares": self.squares, "doubts": _rows(self.doubts),
        }  # fmt: skip

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Scores:
        """Return the scores from the output of ``to_json``.

        Raises:
            ValueError: ``content`` is of another version or damaged.
        """
        if content.get("version") != FORMAT_VERSION:
            raise ValueError(f"scores must be of version {FORMAT_VERSION}, got {content.get('version')}; score again")
        try:
            steps, doubts = (_table(content[name], STEPS + 1, 2) for name in ("steps", "doubts"))
            return cls(steps, _table(content["bins"], BINS, 3), int(content["squares"]), doubts)
        except (KeyError, TypeError, IndexError, OverflowError, ValueError) as error:
            raise ValueError(f"scores must have steps, bins, squares and doubts, got damaged ones: {error}") from error


def average_precision(prob: NDArray[np.float32], visible: Mask) -> float:
    """Return :meth:`Scores.auprc` of K cells, without computing the other counts.

    >>> average_precision(np.array([1, 1, 0, 0], np.float32), np.array([True, False, True, False]))
    0.5
    """
    return _average_precision(_histogram(_step_of(prob), visible))


def _average_precision(steps: Counts) -> float:
    true, claimed = steps[::-1, 1].cumsum(), steps[::-1].sum(axis=1).cumsum()
    rises = np.diff(true, prepend=0)
    return _rate(float((rises * (true / np.maximum(claimed, 1))).sum()), int(true[-1]))


def _step_of(prob: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the largest step k with ``prob >= float32(k / 1000)`` for each probability, corrected for rounding."""
    step = (prob * np.float32(STEPS)).astype(np.intp)
    step -= prob < _EDGES[step]
    step += prob >= _EDGES[step + 1]
    return np.minimum(step, STEPS)


def _histogram(row: NDArray[np.intp], column: NDArray[np.bool_]) -> Counts:
    counts: Counts = np.bincount(2 * row + column, minlength=2 * (STEPS + 1)).reshape(-1, 2)
    return counts


def _area(counts: Counts) -> float:
    """Return the mean selective risk of counts (levels, 2) of right and wrong cells, in ascending uncertainty."""
    counts = counts[counts.any(axis=1)]
    cells, wrong = counts.sum(axis=1), counts[:, 1]
    before, wrong_before = cells.cumsum() - cells, wrong.cumsum() - wrong
    harmonic = _harmonic(before + cells) - _harmonic(before)
    areas = wrong + (wrong_before - wrong * (before / cells)) * harmonic
    return _rate(float(areas.sum()), int(cells.sum()))


def _harmonic(n: Counts) -> NDArray[np.float64]:
    """Return 1 + 1/2 + … + 1/n; above 63 by the asymptotic series, to a relative 1e-15."""
    large = np.maximum(n, _SMALL).astype(np.float64)
    series = np.log(large) + _EULER + 1 / (2 * large) - 1 / (12 * large**2) + 1 / (120 * large**4)
    return np.where(n < _SMALL, _HARMONIC[np.minimum(n, _SMALL - 1)], series)


def _rows(counts: Counts) -> list[list[int]]:
    return [[int(row), *map(int, counts[row])] for row in np.flatnonzero(counts.any(axis=1))]


def _table(rows: list[list[int]], count: int, columns: int) -> Counts:
    table = np.zeros((count, columns), np.int64)
    for row, *values in rows:
        if not 0 <= row < count or len(values) != columns or min(values) < 0:
            raise ValueError(f"a row must be a number below {count} and {columns} counts, got {[row, *values]}")
        table[row] = values
    return table
