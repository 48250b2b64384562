"""Latency histogram of fixed size, independent of the length of the stream."""

from __future__ import annotations

import math

import numpy as np

_MIN_S = 1e-5
_STEP = math.log(1.02)
"""Bins are 2 % wide, so quantiles are exact to 1 %."""

_BINS = math.ceil(math.log(1e8) / _STEP)
"""From 10 µs to 1,000 s."""


class Latencies:
    """Histogram of latencies in bins that are 2 % wide, from 10 µs to 1,000 s.

    >>> latencies = Latencies()
    >>> for seconds in (0.010, 0.010, 0.010, 0.500):
    ...     latencies.add(seconds)
    >>> latencies.count, round(latencies.quantile(0.5), 3), round(latencies.worst_s, 3)
    (4, 0.01, 0.5)
    """

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, np.int64)
        self.worst_s = 0.0
        """The longest latency; 0 for none."""

    @property
    def count(self) -> int:
        """Number of latencies."""
        return int(self._counts.sum())

    def add(self, seconds: float) -> None:
        """Add one latency."""
        number = math.log(max(seconds, _MIN_S) / _MIN_S) / _STEP
        self._counts[min(int(number), _BINS - 1)] += 1
        self.worst_s = max(self.worst_s, seconds)

    def quantile(self, share: float) -> float:
        """Return the quantile ``share`` in seconds, exact to 1 %; NaN for none."""
        if not self.count:
            return math.nan
        number = int(np.searchsorted(np.cumsum(self._counts), math.ceil(share * self.count)))
        return min(_MIN_S * math.exp((number + 0.5) * _STEP), self.worst_s)

    def line(self) -> str:
        """Return one line with median, 99 % quantile and maximum in milliseconds."""
        if not self.count:
            return "no answer yet"
        p50, p99 = 1e3 * self.quantile(0.5), 1e3 * self.quantile(0.99)
        return f"p50 {p50:.1f} ms, p99 {p99:.1f} ms, worst {1e3 * self.worst_s:.1f} ms"
