"""Parts of a view that are told apart: cells clear of the threshold, bands of range, and whose sensor it was."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from viewshed.attacks.table import ROAD_EXTENT_M
from viewshed.bev import polar_of_cells
from viewshed.visible import Target
from viewshed.vulnerability.subjects import Subject

CLEAR = "clear of the threshold"
"""Cells whose true number of returns is more than ``MARGIN`` from that from which on a target is visible."""
MARGIN = 2
EDGES_M = (0.0, 20.0, 40.0, 64.0)
"""Between bands of range, on a grid of ``ROAD_EXTENT_M``; in proportion on others. Beyond the last are the corners."""
SENSOR = "sensor "
"""Begins the name of a part that is all of a sensor's sweeps."""
Mask = NDArray[np.bool_]


def parts_of(subject: Subject, target: Target) -> Iterator[tuple[str, Mask]]:
    """Yield the parts that a subject has, by name: masks (cells, cells) of the truth's grid."""
    truth, model = subject.sample.truth, subject.sample.sweep.model
    returns = truth.expected_returns[target.name].astype(np.int64)
    yield CLEAR, np.abs(returns - target.min_returns) > MARGIN
    range_m, _ = polar_of_cells(truth.grid)
    edges_m = [edge * truth.grid.half_extent_m / ROAD_EXTENT_M for edge in EDGES_M]
    for low_m, high_m in pairwise(edges_m):
        yield f"{low_m:g} to {high_m:g} m", (range_m >= low_m) & (range_m < high_m)
    yield f"from {edges_m[-1]:g} m on", range_m >= edges_m[-1]
    if model is not None:
        yield SENSOR + model.name, np.ones(truth.grid.shape, np.bool_)
