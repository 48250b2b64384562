"""Loops that tell where things are over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def place_things(t_s: Any, which: Any, resting: Any, knots: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Fill x, y and yaw (n, k, 3) of k things at n times, from where they rest or from their knots."""
    (at_rest, spans), (times, values) = resting, knots
    for k in range(which.shape[0]):
        thing = which[k]
        if spans[thing, 0] < spans[thing, 1]:
            follow(t_s, times, values, (spans[thing, 0], spans[thing, 1]), out[:, k])
        else:
            out[:, k] = at_rest[thing]


@njit(cache=True, nogil=True, error_model="numpy")
def follow(t_s: Any, times: Any, values: Any, span: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Fill x, y and yaw (n, 3) at n times, straight between the knots of a span, still outside."""
    begin, end = span
    for n in range(t_s.shape[0]):
        t = t_s[n]
        j = begin + np.searchsorted(times[begin:end], t, side="right") - 1
        for k in range(3):
            if j < begin:
                out[n, k] = values[begin, k]
            elif j == end - 1 or times[j] == t:
                out[n, k] = values[j, k]
            else:
                slope = (values[j + 1, k] - values[j, k]) / (times[j + 1] - times[j])
                out[n, k] = slope * (t - times[j]) + values[j, k]
