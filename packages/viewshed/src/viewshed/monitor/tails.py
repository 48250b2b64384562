"""Fit the tail of benign numbers: peaks over a threshold, a generalized Pareto distribution (Pickands, 1975).

Peaks are counted, not sweeps, because consecutive sweeps of a stream are nearly equal. With few peaks shape and scale
are uncertain: a grid of both is weighted by likelihood and prior, and the tail is the weighted mean.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32, F64

CALM_SWEEPS = 10
"""An alarm ends after this many sweeps in a row below the limit."""

TAIL_PEAKS = 30
"""A tail is fitted to this many of the highest peaks, or to half of them if that is fewer."""

_SHAPES, _SCALES = np.linspace(-0.475, 0.975, 30), np.geomspace(0.1, 10.0, 40)
"""Grid of generalized Pareto parameters: shapes from a bounded tail to infinite variance; scales in mean heights."""

_SHAPE_SPREAD = 0.3
"""Standard deviation of the normal prior of the shape, centered at 0 (an exponential tail)."""


def peaks_of(numbers: F32) -> F32:
    """Return the heights of a stream's peaks (T,), highest first, at least ``CALM_SWEEPS`` sweeps apart.

    >>> peaks_of(np.array([0, 3, 2, *[0] * 12, 1], np.float32)).tolist()
    [3.0, 1.0]
    """
    peaks, remaining = [], np.nan_to_num(np.array(numbers, np.float32))
    while remaining.size and (top := int(np.argmax(remaining))) >= 0 and remaining[top] > 0.0:
        peaks.append(float(remaining[top]))
        remaining[max(top - CALM_SWEEPS, 0) : top + CALM_SWEEPS + 1] = 0.0
    return np.array(peaks, np.float32)


def heights_of(peaks: F64) -> tuple[float, F64]:
    """Return the threshold at which the tail of ascending peaks (P,) begins, and their excesses (n,) above it."""
    count = min(TAIL_PEAKS, len(peaks) // 2)
    begin = float(peaks[-count - 1]) if len(peaks) else 0.0
    return begin, peaks[len(peaks) - count :] - begin


def shape_of(heights: F64) -> float:
    """Return the shape of the tail of heights (n,): the median of its posterior."""
    by_shape = _weights_of(heights).sum(axis=1)
    return float(_SHAPES[np.searchsorted(np.cumsum(by_shape), 0.5)])


def share_above(heights: F64, height: NDArray[np.float64]) -> F64:
    """Return the expected share of further peaks above each ``height`` (m,), given the heights (n,) of past peaks."""
    weights = _weights_of(heights)
    shape = _SHAPES[:, None, None]
    within = np.maximum(1.0 + shape * height / (_SCALES[None, :, None] * heights.mean()), 0.0)
    with np.errstate(divide="ignore"):
        shares = within ** (-1.0 / shape)
    return np.asarray((weights[..., None] * shares).sum(axis=(0, 1)), np.float64)


def exceedance_probability(
    heights: F64, shape: float, prior_scale: float, cut: float, above: float, count: int
) -> float:
    """Return the probability of ``count`` or more peaks above ``above``, given the heights (n,) of those below ``cut``.

    The shape of the tail is fixed. The prior of its scale is log-normal about ``prior_scale`` with a factor of 2; the
    heights update it. Given the scale, the number of peaks above is negative binomial. ``above`` is at least ``cut``.
    """
    scale = _SCALES * prior_scale

    def share(height: float) -> F64:
        return np.asarray(np.maximum(1.0 + shape * height / scale, 0.0) ** (-1.0 / shape), np.float64)

    # 1. Posterior of the scale: likelihood of the heights under a tail truncated at ``cut``.
    below = np.maximum(1.0 - share(cut), 1e-9)
    with np.errstate(divide="ignore"):
        logs = -(1.0 + 1.0 / shape) * np.log(np.maximum(1.0 + shape * heights[:, None] / scale, 0.0)).sum(axis=0)
    logs -= len(heights) * np.log(scale * below) + 0.5 * (np.log(_SCALES) / np.log(2.0)) ** 2
    weights = np.exp(logs - logs.max())
    # 2. Probability of fewer than ``count`` peaks above, term by term.
    beyond = share(above) / (share(above) + below)
    fewer, term = np.zeros_like(scale), (1.0 - beyond) ** max(len(heights), 1)
    for number in range(count):
        fewer, term = fewer + term, term * beyond * (max(len(heights), 1) + number) / (number + 1)
    return max(float(((1.0 - fewer) * weights).sum() / weights.sum()), 0.0)


def _weights_of(heights: F64) -> F64:
    """Return the posterior weights (shapes, scales) given heights (n,); they sum to 1."""
    shape, scale = _SHAPES[:, None, None], _SCALES[None, :, None] * max(float(heights.mean()), 1e-6)
    # A tail that ends below the highest peak has likelihood 0.
    within = np.maximum(1.0 + shape * np.maximum(heights, 1e-6) / scale, 1e-300)
    logs = -len(heights) * np.log(scale[..., 0]) - ((1.0 + 1.0 / shape) * np.log(within)).sum(axis=2)
    logs -= 0.5 * (shape[..., 0] / _SHAPE_SPREAD) ** 2
    logs[(within <= 1e-300).any(axis=2)] = -np.inf
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum(), np.float64)
