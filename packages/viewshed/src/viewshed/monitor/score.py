"""Score a sweep: how rarely its evidence changes as much against the stream's own past.

Evidence is a matrix (E, SECTORS), one row per kind. Five steps reduce it to one number:

1. Onset (one-sided kinds only): subtract the largest value that the sector and its neighbors had in the last five
   sweeps. Edges, crowds and fences are odd where they were odd a moment ago.
2. Smoothing: average each sector with the two beside it, as log(1 + mean / grain).
3. Standardization by the stream's own past: robust location and scale of the strongest sector in the last minute.
   What is always odd in a place (a quarry, a fence, a noisy pose) is then no change.
4. Surprise: -log10 of the share of benign calibration sweeps in which any sector changed as much; 2 means one in a
   hundred. This makes the kinds of evidence comparable.
5. Combination: in each sector the excesses of the surprises over 1.5 are combined over the kinds; the score is that of
   the highest sector. One extreme change raises it, and so do several rare changes in one place. Kinds that change
   with the place count as one.

Ranks among the 600 sweeps of a minute cannot express fewer than 60 false alarms an hour; the tail beyond comes from
the calibration streams (:mod:`viewshed.monitor.calibration`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.monitor.evidence import EVIDENCE, Evidence
from viewshed.monitor.tails import heights_of, peaks_of, share_above

MEMORY_SWEEPS = 600
"""Length of the past that standardizes evidence: a minute at 10 Hz."""

SHORT_SWEEPS = 50
"""The scale is at least that of this many last sweeps, because traffic and roads change within a minute."""

PRIOR_SWEEPS = 20
"""Weight of the calibration streams' scale, in sweeps of the stream's own past."""

RARE = 1.5
"""Surprise above which evidence counts and is given as a reason: one benign sweep in thirty."""

NORM_EXPONENT = 1.5
"""Exponent of the norm that combines surprises."""

MIN_SCALE = 0.2
"""Minimum scale, a fifth of a grain: evidence that is 0 in nearly all sweeps has almost no scale of its own."""

ONSET_SWEEPS, NEIGHBOR_SECTORS = 5, 2
"""Onset: a sector counts beyond the maximum over this many earlier sweeps and sectors to either side."""

_SURPRISES = np.concatenate([np.linspace(0.0, 2.0, 21), np.linspace(2.25, 10.0, 32)])
_HEIGHTS = np.concatenate([[0.0], np.geomspace(0.02, 1e6, 100)])
"""Heights, in mean heights, at which the share of higher peaks is tabulated."""


def numbers_of(evidence: NDArray[np.floating[Any]], kinds: Mapping[str, Evidence] = EVIDENCE) -> F32:
    """Return log(1 + mean / grain) (E, SECTORS) of evidence (E, SECTORS), the mean over each sector and its neighbors.

    NaN where none of the three is known.
    """
    known = np.isfinite(evidence)
    numbers = np.stack([np.where(known, evidence, np.float32(0.0)), known.astype(np.float32)])
    # Circular sums of three sectors.
    closed = np.concatenate([numbers[..., -1:], numbers, numbers[..., :1]], axis=-1)
    total, count = closed[..., :-2] + closed[..., 1:-1] + closed[..., 2:]
    mean = np.maximum(total, np.float32(0.0)) / np.maximum(count, np.float32(1.0))
    return np.where(count > 0.0, np.log1p(mean / grains_of(kinds)[:, None]), np.float32(np.nan)).astype(np.float32)


def two_sided(kinds: Mapping[str, Evidence]) -> NDArray[np.bool_]:
    """Return the mask (E,) of kinds for which a decrease is as suspicious as an increase."""
    return np.array([kind.two_sided for kind in kinds.values()])


def of_place(kinds: Mapping[str, Evidence]) -> NDArray[np.bool_]:
    """Return the mask (E,) of kinds that change with the place and count as one."""
    return np.array([kind.of_place for kind in kinds.values()])


def grains_of(kinds: Mapping[str, Evidence]) -> F32:
    """Return the grains (E,) of kinds of evidence."""
    return np.array([kind.grain for kind in kinds.values()], np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Location and scale of a stream's evidence at present.

    Attributes:
        location: (E,) median of the strongest sector over the past; NaN where there is none.
        scale: (E,) robust standard deviation.
        two_sided: (E,) bool, kinds for which a decrease is as suspicious as an increase.
    """

    location: F32
    scale: F32
    two_sided: NDArray[np.bool_]

    def changes(self, numbers: F32) -> F32:
        """Return numbers (E, SECTORS) as changes in standard deviations; NaN where number or location is unknown."""
        change = (numbers - self.location[:, None]) / self.scale[:, None]
        return np.where(self.two_sided[:, None], np.abs(change), change).astype(np.float32)


@dataclass(slots=True, eq=False)
class Past:
    """The last minute of a stream.

    Attributes:
        prior_scale: (E,) scale in the calibration streams.
        kinds: of the evidence.
        sweeps: number of sweeps added so far.
    """

    prior_scale: F32
    kinds: Mapping[str, Evidence]
    sweeps: int = 0
    _numbers: F32 = field(default_factory=lambda: np.zeros((0, 0), np.float32), repr=False)
    _last: deque[F32] = field(default_factory=lambda: deque(maxlen=ONSET_SWEEPS), repr=False)

    def __post_init__(self) -> None:
        if not self._numbers.size:
            self._numbers = np.full((len(self.prior_scale), MEMORY_SWEEPS), np.nan, np.float32)

    def copy(self) -> Past:
        """Return an independent copy."""
        return replace(self, _numbers=self._numbers.copy(), _last=self._last.copy())

    def onset(self, evidence: F32) -> F32:
        """Return the onset (E, SECTORS) of a sweep's evidence over the last sweeps; two-sided kinds are unchanged."""
        if not self._last:
            return evidence
        before = np.nan_to_num(np.fmax.reduce(list(self._last)))
        return np.where(two_sided(self.kinds)[:, None], evidence, np.maximum(evidence - before, np.float32(0.0)))

    def add(self, evidence: F32) -> None:
        """Add the evidence (E, SECTORS) of a sweep."""
        self._numbers[:, self.sweeps % MEMORY_SWEEPS] = np.fmax.reduce(
            numbers_of(self.onset(evidence), self.kinds), axis=1
        )
        # Keep the maximum over each sector and its neighbors.
        closed = np.concatenate([evidence[:, -NEIGHBOR_SECTORS:], evidence, evidence[:, :NEIGHBOR_SECTORS]], axis=1)
        sides = [closed[:, step : step + evidence.shape[1]] for step in range(2 * NEIGHBOR_SECTORS + 1)]
        self._last.append(np.fmax.reduce(sides))
        self.sweeps += 1

    def reference(self) -> Reference:
        """Return location and scale of the past."""
        both = two_sided(self.kinds)
        past = self._numbers[:, : min(self.sweeps, MEMORY_SWEEPS)]
        last = np.arange(max(self.sweeps - SHORT_SWEEPS, 0), self.sweeps) % MEMORY_SWEEPS
        if not past.size:
            return Reference(np.full(len(past), np.nan, np.float32), self.prior_scale, both)
        location, scale, count = _location_and_scale(past, both)
        scale = np.maximum(scale, _location_and_scale(self._numbers[:, last], both)[1])
        squared = (count * scale**2 + PRIOR_SWEEPS * self.prior_scale**2) / (count + PRIOR_SWEEPS)
        min_scale = np.where(both, np.float32(0.0), np.float32(MIN_SCALE))
        return Reference(location, np.maximum(np.sqrt(squared), min_scale).astype(np.float32), both)


def _location_and_scale(numbers: F32, both: NDArray[np.bool_]) -> tuple[F32, F32, NDArray[np.intp]]:
    """Return median, scale and count (E,) of the known numbers (E, n).

    The scale is the standard deviation of the normal distribution with the same interquartile range, or with the same
    98 % quantile if that is wider (two-sided kinds: or the 2 % quantile): most evidence is 0 in most sweeps.
    """
    ordered, count = np.sort(numbers, axis=1), np.isfinite(numbers).sum(axis=1)

    def quantile(share: float) -> F32:
        rank = np.round(share * np.maximum(count - 1, 0)).astype(np.intp)
        return np.asarray(ordered[np.arange(len(ordered)), rank], np.float32)

    low, first, middle, third, high = map(quantile, (0.02, 0.25, 0.5, 0.75, 0.98))
    scale = np.maximum((third - first) / 1.349, (high - middle) / 2.054)
    scale = np.where(both, np.maximum(scale, (middle - low) / 2.054), scale)
    return middle, np.nan_to_num(scale).astype(np.float32), count


@dataclass(frozen=True, slots=True, eq=False)
class SurpriseScale:
    """Maps numbers of each kind to surprises: -log10 of their rarity on benign sweeps.

    Below the threshold of the tail the rarity is the counted share of benign sweeps. Above it, it is the share beyond
    the threshold times the tail probability of a generalized Pareto distribution, averaged over the posterior of its
    parameters. That mean is heavier than the likeliest tail, the more so the fewer minutes there are, so no cap is
    needed.

    Attributes:
        values: (E, K) ascending numbers.
        surprises: (E, K) -log10 of the share of benign numbers that are at least as large.

    Raises:
        ValueError: the shapes differ, or the values do not ascend.
    """

    values: F32
    surprises: F32

    def __post_init__(self) -> None:
        if self.values.shape != self.surprises.shape or self.values.ndim != 2 or self.values.shape[1] < 2:
            raise ValueError(
                f"values and surprises must be (E, K) alike, got {self.values.shape} and {self.surprises.shape}"
            )
        if not (np.diff(self.values) >= 0).all() or not np.isfinite(self.surprises).all():
            raise ValueError("values must ascend and surprises be finite, got others; fit the scale again")

    @classmethod
    def fit(cls, streams: Sequence[NDArray[np.floating[Any]]]) -> Self:
        """Return the scale of the numbers (T, E) of benign streams; a kind that always abstained has surprise 0."""
        kinds = streams[0].shape[1]
        # A kind that always abstained: all numbers lie below the first knot, so none is rare.
        values = np.full((kinds, len(_SURPRISES)), np.finfo(np.float32).max, np.float32)
        surprises = np.zeros_like(values)
        for number in range(kinds):
            by_stream = [np.asarray(stream[:, number], np.float32) for stream in streams]
            known = np.sort(np.concatenate([one[np.isfinite(one)] for one in by_stream]))
            if known.size:
                values[number], surprises[number] = _knots(known, [peaks_of(one) for one in by_stream])
        return cls(values, surprises)

    def __call__(self, numbers: NDArray[np.floating[Any]]) -> F32:
        """Return the surprises (N, E, …) of numbers (N, E, …); NaN stays NaN."""
        numbers = np.asarray(numbers, np.float32)
        surprises = np.empty(numbers.shape, np.float32)
        for number, (values, known) in enumerate(zip(self.values, self.surprises, strict=True)):
            surprises[:, number] = np.interp(numbers[:, number], values, known)
        return surprises


def _knots(known: F32, peaks: Sequence[F32]) -> tuple[F32, F32]:
    """Return numbers and surprises (K,), the knots of a scale, from ascending numbers and each stream's peaks."""
    # 1. Counted share. Equal numbers share the surprise of the first, so that a common value has surprise 0.
    begin, heights = heights_of(np.sort(np.concatenate(peaks)).astype(np.float64))
    begin = max(begin, float(known[0]))
    rank = np.ceil((1.0 - 10.0**-_SURPRISES) * (known.size - 1)).astype(np.intp)
    values = known[rank].astype(np.float64)
    not_below = known.size - np.searchsorted(known, values, "left")
    surprises = -np.log10(not_below / known.size)
    # 2. Tail. One additional peak, a standard deviation high, avoids an empty tail.
    heights = np.append(heights, 1.0)
    above = (known.size - np.searchsorted(known, begin, "right") + 0.5) / (known.size + 0.5)
    tail = begin + _HEIGHTS * heights.mean()
    rare = -np.log10(np.maximum(above * share_above(heights, tail - begin), 1e-12))
    beyond = rare[0] < _SURPRISES
    values[beyond], surprises[beyond] = np.interp(_SURPRISES[beyond], rare, tail), _SURPRISES[beyond]
    # 3. Counted values end where the tail begins.
    values[~beyond] = np.minimum(values[~beyond], begin)
    return np.maximum.accumulate(values).astype(np.float32), np.maximum.accumulate(surprises).astype(np.float32)


def sector_scores(surprises: NDArray[np.floating[Any]], of_place: NDArray[np.bool_]) -> F32:
    """Return the scores (…, SECTORS) of surprises (…, E, SECTORS): the norm of their excesses over ``RARE``.

    NaN counts as 0. Of the kinds ``of_place`` (E,) bool only the strongest counts. The norm (``NORM_EXPONENT``) lies
    between the largest excess and their sum.

    >>> surprises = np.array([[[2.5, 1.0], [2.5, 9.5]], [[np.nan, 1.0], [3.5, np.nan]]])
    >>> sector_scores(surprises, np.array([False, False])).astype(float).round(3).tolist()
    [[1.587, 8.0], [2.0, 0.0]]
    >>> sector_scores(surprises, np.array([True, True])).tolist()
    [[1.0, 8.0], [2.0, 0.0]]
    """
    beyond = np.maximum(np.nan_to_num(surprises) - RARE, 0.0)
    powers = (beyond[..., ~of_place, :] ** NORM_EXPONENT).sum(axis=-2)
    powers = powers + beyond[..., of_place, :].max(axis=-2, initial=0.0) ** NORM_EXPONENT
    return np.asarray(powers ** (1.0 / NORM_EXPONENT), np.float32)
