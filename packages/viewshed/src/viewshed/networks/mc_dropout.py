"""Monte Carlo dropout (Gal and Ghahramani 2016): mean and standard deviation of a network over masks."""

from __future__ import annotations

import numpy as np

from viewshed import _core
from viewshed.arrays import F32
from viewshed.networks.card import Runner


def mean_and_std(runner: Runner, inputs: F32, passes: int, rng: np.random.Generator) -> tuple[F32, F32]:
    """Return mean and standard deviation (cells, cells) of the probability of one input over ``passes`` masks.

    The standard deviation divides by ``passes``, as ``np.std``.
    """
    return mean_and_deviation(runner.run(inputs[None], runner.card.shape.masks(passes, rng)))


def mean_and_deviation(probability: F32) -> tuple[F32, F32]:
    """Return mean and standard deviation (…) of probabilities (passes, …) over the first axis.

    >>> mean, std = mean_and_deviation(np.array([[0.25], [0.75]], np.float32))
    >>> mean.tolist(), std.tolist()
    ([0.5], [0.25])
    """
    flat = np.ascontiguousarray(probability, np.float32).reshape(len(probability), -1)
    mean, std = _core.mean_and_deviation(flat)
    return mean.reshape(probability.shape[1:]), std.reshape(probability.shape[1:])
