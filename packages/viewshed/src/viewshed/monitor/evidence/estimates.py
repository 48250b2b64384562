"""What the estimates say: a network that contradicts the shadow map, and the deviation of a Bayesian one.

The shadow map is geometry of the beams; a network has also learned what scenes look like. Where they differ the
returns do not look like a scene, or there is little evidence. The deviation of Monte Carlo dropout is the published
detector's (arXiv 2503.07375).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep, sector_of

GEOMETRY = "shadow_map"
"""The estimate that follows from the beams alone."""

NETWORKS = ("viewnet", "mc_dropout", "unet")
"""Estimates of networks; the first of them that was made is compared."""


def measure_disagreement(monitored: MonitoredSweep) -> F32:
    """Return the share of cells (SECTORS,) that network and shadow map call differently; abstains without both."""
    geometry = monitored.estimates.get(GEOMETRY)
    network = next((monitored.estimates[name] for name in NETWORKS if name in monitored.estimates), None)
    if geometry is None or network is None or geometry.grid != network.grid:
        return ABSTAINS
    differs = geometry.visible() != network.visible()
    return _mean_by_sector(geometry.grid, differs.astype(np.float32))


def measure_deviation(monitored: MonitoredSweep) -> F32:
    """Return the mean standard deviation (SECTORS,) of the first estimate that has one; abstains without any."""
    for estimate in monitored.estimates.values():
        std = np.asarray(estimate.std, np.float32)
        known = np.isfinite(std)
        if known.any():
            return _mean_by_sector(estimate.grid, np.where(known, std, np.float32(0.0)))
    return ABSTAINS


@lru_cache(maxsize=4)
def _sectors_of_cells(grid: BevGrid) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the sector of each cell (cells²,) and how many cells each sector (SECTORS,) has."""
    sector = sector_of(polar_of_cells(grid)[1]).ravel()
    return sector, np.bincount(sector, minlength=SECTORS)


def _mean_by_sector(grid: BevGrid, values: NDArray[np.floating[Any]]) -> F32:
    """Return the mean (SECTORS,) of values of cells (cells, cells); NaN in sectors without a cell."""
    sector, cells = _sectors_of_cells(grid)
    total = np.bincount(sector, values.ravel(), SECTORS)
    return np.where(cells > 0, total / np.maximum(cells, 1), np.nan).astype(np.float32)
