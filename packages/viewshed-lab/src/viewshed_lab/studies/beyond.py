"""Measures claims beyond every return in their direction; behind a wall that all beams hit they are wrong.

In a room such a claim is right only through an open door or window. Outdoors it is also right along an open street.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from viewshed.arrays import Mask
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.visibility import CAR, PEDESTRIAN
from viewshed.grid import GRIDS, BevGrid, polar_of_cells
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab._page import facts, page, table
from viewshed_lab.studies.formatting import format_rate

WITHIN_DEG = 3.0
"""A claim is beyond the returns if it is beyond all returns whose azimuths differ by at most this."""

WORDS = f"""Share of the claimed cells that lie a cell or more beyond every return within {WITHIN_DEG:g}° of azimuth: of
the default, and of the same where measured beams alone count. Height: of the sensor, with the share of the near ground
that supports it. Indoors only doors and windows make such a claim right; on roads it may be right."""


def beyond_returns(leveled: LeveledSweep, grid: BevGrid) -> Mask:
    """Return the mask (cells, cells) of cells at least a cell beyond every return within 3° of their azimuth."""
    range_m, azimuth = (map_.ravel().astype(np.float64) for map_ in polar_of_cells(grid))
    order = np.argsort(leveled.azimuth, kind="stable")
    # Sorted returns, repeated at both ends so that windows can cross the seam.
    around = np.concatenate([leveled.azimuth[order].astype(np.float64) + turn for turn in (-2 * np.pi, 0, 2 * np.pi)])
    far_m = np.append(np.tile(leveled.range_m[order], 3), -np.inf)
    window = np.deg2rad(WITHIN_DEG)
    first, last = np.searchsorted(around, azimuth - window), np.searchsorted(around, azimuth + window, side="right")
    farthest_m = np.maximum.reduceat(far_m, np.column_stack([first, last]).ravel())[::2]
    farthest_m[first == last] = -np.inf
    return np.asarray(range_m > farthest_m + grid.cell_m).reshape(grid.shape)


def beyond_page(sweeps: Iterable[tuple[str, Sweep]]) -> str:
    """Return the page of named sweeps: the share of their claims beyond the returns, on both grids."""
    rows = []
    cases = ((name, sweep, *case) for name, sweep in sweeps for case in (("road", CAR), ("indoor", PEDESTRIAN)))
    for name, sweep, grid_name, target in cases:
        grid = GRIDS[grid_name]
        leveled = level(sweep, grid)
        beyond, default = beyond_returns(leveled, grid), ShadowMap(grid, target).estimate(leveled)
        measured_only = ShadowMap(grid, target, no_return="unknown").estimate(leveled)
        height = f"{leveled.sensor_height_m:.2f} m, {min(leveled.ground.support, 1.0):.0%}"
        shares = [_share(beyond, estimate) for estimate in (default, measured_only)]
        rows.append([name, f"{grid_name}, {target.name}", height, f"{default.area_m2():.0f}", *shares])
    header = ("sweep", "grid, target", "height", "claimed, m²", "beyond the returns", "measured beams alone")
    return page("Claims beyond the returns", facts(), WORDS, table(header, rows))


def _share(beyond: Mask, estimate: FovEstimate) -> str:
    claimed = estimate.visible()
    return format_rate(float(beyond[claimed].mean()), 2) if claimed.any() else "–"
