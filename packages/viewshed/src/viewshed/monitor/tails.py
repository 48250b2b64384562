"""How heavy the tail of benign numbers is: peaks over a threshold, a generalized Pareto distribution (Pickands, 1975).

Neighbors in a stream are nearly the same sweep, so peaks are counted, not sweeps. Shape and scale of their heights are
known from few peaks: both are weighed by what the peaks say of them, and a tail is the mean over that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32, F64

CALM_SWEEPS = 10
"""An alarm ends after this many sweeps in a row below the limit."""

TAIL_PEAKS = 30
"""Peaks, the highest, to which a tail is fitted; half of all where there are fewer."""

_SHAPES, _SCALES = np.linspace(-0.475, 0.975, 30), np.geomspace(0.1, 10.0, 40)
"""Of generalized Pareto distributions: from a tail that ends to one without a variance, and in mean heights."""

_SHAPE_SPREAD = 0.3
"""Standard deviation of shapes about 0, of an exponential tail, before any peak is seen."""


def peaks_of(numbers: F32) -> F32:
    """Return the heights of the peaks of a stream's numbers (T,): highest ones with ``CALM_SWEEPS`` between them.

    >>> peaks_of(np.array([0, 3, 2, *[0] * 12, 1], np.float32)).tolist()
    [3.0, 1.0]
    """
    peaks, left = [], np.nan_to_num(np.array(numbers, np.float32))
    while left.size and (top := int(np.argmax(left))) >= 0 and left[top] > 0.0:
        peaks.append(float(left[top]))
        left[max(top - CALM_SWEEPS, 0) : top + CALM_SWEEPS + 1] = 0.0
    return np.array(peaks, np.float32)


def heights_of(peaks: F64) -> tuple[float, F64]:
    """Return where the tail of peaks (P,), ascending, begins, and the heights above that."""
    count = min(TAIL_PEAKS, len(peaks) // 2)
    begin = float(peaks[-count - 1]) if len(peaks) else 0.0
    return begin, peaks[len(peaks) - count :] - begin


def shape_of(heights: F64) -> float:
    """Return the shape of the tail of heights (n,): the median of what they say of it."""
    by_shape = _weights_of(heights).sum(axis=1)
    return float(_SHAPES[np.searchsorted(np.cumsum(by_shape), 0.5)])


def share_above(heights: F64, height: NDArray[np.float64]) -> F64:
    """Return the share of further peaks that are higher than each of ``height`` (m,), by those of heights (n,)."""
    weights = _weights_of(heights)
    shape = _SHAPES[:, None, None]
    within = np.maximum(1.0 + shape * height / (_SCALES[None, :, None] * heights.mean()), 0.0)
    with np.errstate(divide="ignore"):
        shares = within ** (-1.0 / shape)
    return np.asarray((weights[..., None] * shares).sum(axis=(0, 1)), np.float64)


def chance_of_more(heights: F64, shape: float, usual: float, cut: float, above: float, count: int) -> float:
    """Return how probable ``count`` or more peaks above ``above`` are, by the heights (n,) of those below ``cut``.

    The tail has this shape; its scale is about the ``usual`` one, by a factor of 2, and what the heights say of it.
    Given the scale, how many peaks lie beyond is negative binomial. ``above`` is at least ``cut``.
    """
    scale = _SCALES * usual

    def share(height: float) -> F64:
        return np.asarray(np.maximum(1.0 + shape * height / scale, 0.0) ** (-1.0 / shape), np.float64)

    # 1. How probable each scale is: by densities of the heights, of a tail that is cut off.
    below = np.maximum(1.0 - share(cut), 1e-9)
    with np.errstate(divide="ignore"):
        logs = -(1.0 + 1.0 / shape) * np.log(np.maximum(1.0 + shape * heights[:, None] / scale, 0.0)).sum(axis=0)
    logs -= len(heights) * np.log(scale * below) + 0.5 * (np.log(_SCALES) / np.log(2.0)) ** 2
    weights = np.exp(logs - logs.max())
    # 2. The probability of fewer than so many, term by term.
    beyond = share(above) / (share(above) + below)
    fewer, term = np.zeros_like(scale), (1.0 - beyond) ** max(len(heights), 1)
    for number in range(count):
        fewer, term = fewer + term, term * beyond * (max(len(heights), 1) + number) / (number + 1)
    return max(float(((1.0 - fewer) * weights).sum() / weights.sum()), 0.0)


def _weights_of(heights: F64) -> F64:
    """Return how likely heights (n,) make each shape and scale; the weights add up to 1."""
    shape, scale = _SHAPES[:, None, None], _SCALES[None, :, None] * max(float(heights.mean()), 1e-6)
    # Where a tail would end before the highest peak its likelihood is 0.
    within = np.maximum(1.0 + shape * np.maximum(heights, 1e-6) / scale, 1e-300)
    logs = -len(heights) * np.log(scale[..., 0]) - ((1.0 + 1.0 / shape) * np.log(within)).sum(axis=2)
    logs -= 0.5 * (shape[..., 0] / _SHAPE_SPREAD) ** 2
    logs[(within <= 1e-300).any(axis=2)] = -np.inf
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum(), np.float64)
