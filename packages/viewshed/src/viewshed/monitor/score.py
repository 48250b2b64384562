"""The score of a sweep in a stream: how much its evidence changed against the stream's own past.

Evidence is a matrix (E, SECTORS), one line for each kind. Five steps make one number of it:

1. Of a kind that accuses by more than before, a sector counts by what is beyond the largest number that it and the
   sectors beside it had in the last five sweeps: edges, crowds and fences are odd where they were odd a moment ago.
2. A sector and the two beside it are one: their mean counts, as log(1 + mean / grain).
3. It is standardized by the past of its own stream: location and scale of the strongest sector in the last minute,
   robust. What is odd in a place (a quarry, a fence, a noisy pose) is odd in all its sweeps, and so is no change.
4. A standardized change becomes its surprise, -log10 of the share of benign sweeps of calibration streams of which any
   sector changed as much: 2 means one in a hundred. So kinds of evidence compare.
5. In each sector what surprises are beyond 1.5 is put together over the kinds; the score is that of the highest sector.
   One kind that is beyond doubt is an attack's, and so are several rare changes at once in one place. Kinds that change
   with the place count as one.

A rank among the 600 sweeps of a minute could not ask for fewer than 60 false alarms an hour; the tail beyond is that of
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
"""Sweeps of the past that evidence is standardized by: a minute at 10 Hz."""

SHORT_SWEEPS = 50
"""The scale is at least that of this number of the last sweeps: traffic and roads change within a minute."""

PRIOR_SWEEPS = 20
"""The scale of the calibration streams counts as much as this number of sweeps of the own past."""

RARE = 1.5
"""Surprise from which evidence counts, and is a reason: one benign sweep in thirty."""

TOGETHER = 1.5
"""Exponent of the norm that puts surprises together."""

LEAST_SCALE = 0.2
"""The scale is at least that: evidence that is 0 in nearly all sweeps differs by less than a fifth of its grain."""

ONSET_SWEEPS, BESIDE = 5, 2
"""Sweeps, and sectors to either side, whose largest number a sector must exceed."""

_SURPRISES = np.concatenate([np.linspace(0.0, 2.0, 21), np.linspace(2.25, 10.0, 32)])
_HEIGHTS = np.concatenate([[0.0], np.geomspace(0.02, 1e6, 100)])
"""In mean heights, at which the share of higher peaks is computed."""


def numbers_of(evidence: NDArray[np.floating[Any]], kinds: Mapping[str, Evidence] = EVIDENCE) -> F32:
    """Return log(1 + mean / grain) (E, SECTORS) of evidence (E, SECTORS): of each sector and the two beside it.

    NaN where none of the three is known.
    """
    known = np.isfinite(evidence)
    numbers = np.stack([np.where(known, evidence, np.float32(0.0)), known.astype(np.float32)])
    # Sums of three in a circle.
    closed = np.concatenate([numbers[..., -1:], numbers, numbers[..., :1]], axis=-1)
    total, count = closed[..., :-2] + closed[..., 1:-1] + closed[..., 2:]
    mean = np.maximum(total, np.float32(0.0)) / np.maximum(count, np.float32(1.0))
    return np.where(count > 0.0, np.log1p(mean / grains_of(kinds)[:, None]), np.float32(np.nan)).astype(np.float32)


def two_sided(kinds: Mapping[str, Evidence]) -> NDArray[np.bool_]:
    """Return for which kinds (E,) less than before is as suspicious as more."""
    return np.array([kind.two_sided for kind in kinds.values()])


def of_place(kinds: Mapping[str, Evidence]) -> NDArray[np.bool_]:
    """Return which kinds (E,) change with the place and count as one."""
    return np.array([kind.of_place for kind in kinds.values()])


def grains_of(kinds: Mapping[str, Evidence]) -> F32:
    """Return the grains (E,) of kinds of evidence."""
    return np.array([kind.grain for kind in kinds.values()], np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What is usual in a stream now.

    Attributes:
        location: (E,) median of the strongest sectors of the past; NaN where there is none.
        scale: (E,) standard deviation, robust.
        two_sided: (E,) bool, whether less is as suspicious as more.
    """

    location: F32
    scale: F32
    two_sided: NDArray[np.bool_]

    def changes(self, numbers: F32) -> F32:
        """Return numbers (E, SECTORS) as changes in standard deviations; NaN where one of both is not known."""
        change = (numbers - self.location[:, None]) / self.scale[:, None]
        return np.where(self.two_sided[:, None], np.abs(change), change).astype(np.float32)


@dataclass(slots=True, eq=False)
class Past:
    """The last minute of a stream.

    Attributes:
        prior_scale: (E,) scale in the calibration streams.
        kinds: of the evidence.
        sweeps: that were added.
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
        """Return the same past, which goes on by itself."""
        return replace(self, _numbers=self._numbers.copy(), _last=self._last.copy())

    def onset(self, evidence: F32) -> F32:
        """Return the evidence (E, SECTORS) of a sweep without what was there before; two-sided kinds as they are."""
        if not self._last:
            return evidence
        before = np.nan_to_num(np.fmax.reduce(list(self._last)))
        return np.where(two_sided(self.kinds)[:, None], evidence, np.maximum(evidence - before, np.float32(0.0)))

    def add(self, evidence: F32) -> None:
        """Add the evidence (E, SECTORS) of a sweep."""
        self._numbers[:, self.sweeps % MEMORY_SWEEPS] = np.fmax.reduce(
            numbers_of(self.onset(evidence), self.kinds), axis=1
        )
        # What the sectors beside had counts as a sector's own.
        closed = np.concatenate([evidence[:, -BESIDE:], evidence, evidence[:, :BESIDE]], axis=1)
        sides = [closed[:, step : step + evidence.shape[1]] for step in range(2 * BESIDE + 1)]
        self._last.append(np.fmax.reduce(sides))
        self.sweeps += 1

    def reference(self) -> Reference:
        """Return what is usual now."""
        both = two_sided(self.kinds)
        every = self._numbers[:, : min(self.sweeps, MEMORY_SWEEPS)]
        last = np.arange(max(self.sweeps - SHORT_SWEEPS, 0), self.sweeps) % MEMORY_SWEEPS
        if not every.size:
            return Reference(np.full(len(every), np.nan, np.float32), self.prior_scale, both)
        location, scale, count = _location_and_scale(every, both)
        scale = np.maximum(scale, _location_and_scale(self._numbers[:, last], both)[1])
        squared = (count * scale**2 + PRIOR_SWEEPS * self.prior_scale**2) / (count + PRIOR_SWEEPS)
        least = np.where(both, np.float32(0.0), np.float32(LEAST_SCALE))
        return Reference(location, np.maximum(np.sqrt(squared), least).astype(np.float32), both)


def _location_and_scale(numbers: F32, both: NDArray[np.bool_]) -> tuple[F32, F32, NDArray[np.intp]]:
    """Return median, scale and count (E,) of numbers (E, n) that are known.

    The scale is that of a normal distribution by the quartiles, or by the upper fiftieth where that is wider (of what
    is suspicious on both sides, by the lower one as well): most evidence is 0 in most sweeps.
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
    """How rare a number is on benign sweeps, for each kind of it.

    Up to where the tail begins it is the share of benign sweeps that were counted; beyond, that share times the share
    of peaks that a generalized Pareto distribution has higher. What few peaks say of that is uncertain, so the tail is
    the mean over all that they leave possible: heavier than the likeliest one, and the fewer minutes the heavier. So no
    cap is needed: a kind counts by as much as its minutes support.

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
        """Return the scale of the numbers (T, E) of benign streams; a kind that always abstained stays at 0."""
        kinds = streams[0].shape[1]
        # Of a kind that never spoke no number is known to be rare: all lie below the first knot.
        values = np.full((kinds, len(_SURPRISES)), np.finfo(np.float32).max, np.float32)
        surprises = np.zeros_like(values)
        for number in range(kinds):
            of_one = [np.asarray(stream[:, number], np.float32) for stream in streams]
            known = np.sort(np.concatenate([one[np.isfinite(one)] for one in of_one]))
            if known.size:
                values[number], surprises[number] = _knots(known, [peaks_of(one) for one in of_one])
        return cls(values, surprises)

    def __call__(self, numbers: NDArray[np.floating[Any]]) -> F32:
        """Return the surprises (N, E, …) of numbers (N, E, …); NaN where they are."""
        numbers = np.asarray(numbers, np.float32)
        surprises = np.empty(numbers.shape, np.float32)
        for number, (values, known) in enumerate(zip(self.values, self.surprises, strict=True)):
            surprises[:, number] = np.interp(numbers[:, number], values, known)
        return surprises


def _knots(known: F32, peaks: Sequence[F32]) -> tuple[F32, F32]:
    """Return numbers (K,), and how rare they are, of ascending benign numbers and of their peaks in each stream."""
    # 1. Counted: equal numbers share the surprise of the first, so that a common value is no surprise at all.
    begin, heights = heights_of(np.sort(np.concatenate(peaks)).astype(np.float64))
    begin = max(begin, float(known[0]))
    rank = np.ceil((1.0 - 10.0**-_SURPRISES) * (known.size - 1)).astype(np.intp)
    values = known[rank].astype(np.float64)
    reached = known.size - np.searchsorted(known, values, "left")
    surprises = -np.log10(reached / known.size)
    # 2. The tail: one peak more, a standard deviation high, keeps it from being none where there were no peaks.
    heights = np.append(heights, 1.0)
    above = (known.size - np.searchsorted(known, begin, "right") + 0.5) / (known.size + 0.5)
    tail = begin + _HEIGHTS * heights.mean()
    rare = -np.log10(np.maximum(above * share_above(heights, tail - begin), 1e-12))
    beyond = rare[0] < _SURPRISES
    values[beyond], surprises[beyond] = np.interp(_SURPRISES[beyond], rare, tail), _SURPRISES[beyond]
    # 3. Where it begins both are as rare.
    values[~beyond] = np.minimum(values[~beyond], begin)
    return np.maximum.accumulate(values).astype(np.float32), np.maximum.accumulate(surprises).astype(np.float32)


def sector_scores(surprises: NDArray[np.floating[Any]], of_place: NDArray[np.bool_]) -> F32:
    """Return the scores (…, SECTORS) of surprises (…, E, SECTORS): the norm of what they are beyond ``RARE``.

    NaN counts as none. Of the kinds ``of_place`` (E,) bool the strongest counts. The norm of the exponent ``TOGETHER``
    is more than the largest and less than the sum.

    >>> surprises = np.array([[[2.5, 1.0], [2.5, 9.5]], [[np.nan, 1.0], [3.5, np.nan]]])
    >>> sector_scores(surprises, np.array([False, False])).astype(float).round(3).tolist()
    [[1.587, 8.0], [2.0, 0.0]]
    >>> sector_scores(surprises, np.array([True, True])).tolist()
    [[1.0, 8.0], [2.0, 0.0]]
    """
    beyond = np.maximum(np.nan_to_num(surprises) - RARE, 0.0)
    together = (beyond[..., ~of_place, :] ** TOGETHER).sum(axis=-2)
    together = together + beyond[..., of_place, :].max(axis=-2, initial=0.0) ** TOGETHER
    return np.asarray(together ** (1.0 / TOGETHER), np.float32)
