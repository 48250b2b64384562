"""Monte Carlo dropout (Gal and Ghahramani 2016): mean and standard deviation of a network over random masks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.networks.card import Runner

Floats = NDArray[np.float32]


def mean_and_std(runner: Runner, inputs: Floats, passes: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return mean and standard deviation (cells, cells) of the probability of one input over ``passes`` masks.

    The deviation is that of the passes themselves (divided by their number, as numpy's).
    """
    return mean_and_deviation(runner.run(inputs[None], runner.card.shape.masks(passes, rng)))


def mean_and_deviation(probability: Floats) -> tuple[Floats, Floats]:
    """Return mean and standard deviation (…) of probabilities (passes, …) over the first axis.

    >>> mean, std = mean_and_deviation(np.array([[0.25], [0.75]], np.float32))
    >>> mean.tolist(), std.tolist()
    ([0.5], [0.25])
    """
    flat = np.ascontiguousarray(probability, np.float32).reshape(len(probability), -1)
    mean, std = np.empty(flat.shape[1], np.float32), np.empty(flat.shape[1], np.float32)
    _moments(flat, mean, std)
    return mean.reshape(probability.shape[1:]), std.reshape(probability.shape[1:])


@njit(cache=True, nogil=True, error_model="numpy")
def _moments(values: Any, mean: Any, std: Any) -> None:  # pragma: no cover - compiled
    """Write mean and deviation (count,) of values (passes, count).

    Sums are of the differences to the first pass, which are small: squares of the values would cancel in float32.
    Blocks of 2,048 cells keep both sums in the first-level cache while the passes stream by.
    """
    passes, count = values.shape
    block = 2048
    total, squares = np.empty(block, np.float32), np.empty(block, np.float32)
    for start in range(0, count, block):
        width = min(block, count - start)
        total[:], squares[:] = 0.0, 0.0
        for k in range(1, passes):
            for n in range(width):
                difference = values[k, start + n] - values[0, start + n]
                total[n] += difference
                squares[n] += difference * difference
        for n in range(width):
            shift = total[n] / np.float32(passes)
            mean[start + n] = values[0, start + n] + shift
            std[start + n] = np.sqrt(max(squares[n] / np.float32(passes) - shift * shift, np.float32(0.0)))
