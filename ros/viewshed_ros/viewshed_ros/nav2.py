"""What nav2's costmaps take, as arrays: masks of speed and keep-out in the map, and ends of beams that may clear.

numpy alone; :mod:`viewshed_ros.layers` makes messages of it.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.io.export.nav2 import NOTHING_KNOWN, grid_in_the_map, in_the_map, keepout_values

__all__ = [
    "NOTHING_KNOWN", "NO_LIMIT", "SpeedLimits", "blind_m", "clearing_ends", "grid_in_the_map", "in_the_map",
    "keepout_values", "speed_values",
]  # fmt: skip

NO_LIMIT = 0
"""Of a speed mask."""

_RAYS_A_CELL, _STEPS_A_CELL = 2.0, 4.0
"""Rays for each cell at the grid's nearest edge, and samples along a ray for each cell's side."""


@dataclass(frozen=True, slots=True)
class SpeedLimits:
    """What 100 % of a speed mask mean, and how fast one may drive where nothing is seen."""

    most_mps: float = 10.0  # 100 %
    unseen_mps: float = 1.0  # in cells that are not visible
    here_m: float = 3.0  # radius around the sensor where the speed from which the vehicle stops in what it sees holds

    def __post_init__(self) -> None:
        if not (0.0 < self.unseen_mps <= self.most_mps < math.inf and self.here_m >= 0.0):
            raise ValueError(f"speeds must satisfy 0 < unseen ≤ most and here_m must not be negative, got {self}")

    def percent(self, speed_mps: float) -> int:
        """Return a speed in percent of the greatest, rounded down; 1 at least, as 0 would be no limit.

        >>> SpeedLimits(10.0).percent(2.59), SpeedLimits(10.0).percent(0.0), SpeedLimits(10.0).percent(99.0)
        (25, 1, 100)
        """
        return min(max(math.floor(100.0 * speed_mps / self.most_mps), 1), 100)


def speed_values(estimate: FovEstimate, speed_mps: float, limits: SpeedLimits) -> NDArray[np.int8]:
    """Return the speed (cells, cells) in percent: no limit where visible, ``unseen_mps`` elsewhere.

    nav2 looks up the cell that the robot is in; there the speed holds from which it stops in what it sees.
    """
    values = np.where(estimate.visible(), np.int8(NO_LIMIT), np.int8(limits.percent(limits.unseen_mps)))
    values[polar_of_cells(estimate.grid)[0] <= limits.here_m] = limits.percent(speed_mps)
    return values


def clearing_ends(estimate: FovEstimate) -> NDArray[np.float64]:
    """Return the ends (K, 2) of virtual beams in ``level``, meters.

    Between the first FREE cell of a ray and its end lie FREE cells alone. A costmap that clears from the sensor to each
    end clears besides what lies before the first FREE cell, which the sensor looks over: its least range of clearing
    (``raytrace_min_range``, see :func:`blind_m`) keeps that.
    """
    ends_m, _, angle = _free_rays(estimate)
    kept = ends_m > 0.0
    ends: NDArray[np.float64] = ends_m[kept, None] * np.column_stack([np.cos(angle[kept]), np.sin(angle[kept])])
    return ends


def blind_m(estimate: FovEstimate) -> float:
    """Return the range in meters below which a clearing beam may pass cells that are not FREE; 0 for none."""
    ends_m, starts_m, _ = _free_rays(estimate)
    return float(starts_m[ends_m > 0.0].max(initial=0.0))


def obstruction_polygons(estimate: FovEstimate) -> str:
    """Return the directions in which the sensor sees nothing from the beginning, as STVL's parameter takes them.

    ``[[azimuth, elevation, …], …]`` in radians: convex polygons, azimuths in [0, 2π], none across 0. A direction is
    obstructed where no cell from 1 m to 5 m is FREE: by the robot itself, or by what stands right before it. Walls
    farther off cannot be written so: the polygons know no range. Empty where nothing is obstructed, or everything: a
    sensor that looks over these cells knows nothing of its robot.
    """
    angle, range_m, number = _rays(estimate.grid)
    near = (range_m >= _BODY_M) & (range_m <= BLIND_MOST_M)
    free = np.append(estimate.state == CellState.FREE, False)[number[:, near]].any(axis=1)
    # 1. Rays by azimuth from 0 on, so that no polygon lies across 0.
    order = np.argsort(angle % (2.0 * math.pi))
    azimuth, is_hidden = (angle % (2.0 * math.pi))[order], ~free[order]
    if is_hidden.all():
        return ""
    half = math.pi / len(azimuth)
    # 2. Where rows of hidden rays begin and end, each cut into quarter turns at most: wider ones are not convex.
    edge = np.flatnonzero(np.diff(np.concatenate([[False], is_hidden, [False]]).astype(np.int8)))
    quads = []
    for begin, end in zip(edge[::2], edge[1::2], strict=True):
        first, last = max(azimuth[begin] - half, 0.0), min(azimuth[end - 1] + half, 2.0 * math.pi)
        if last - first < _LEAST_OBSTRUCTION:
            continue
        parts = np.linspace(first, last, 1 + math.ceil((last - first) / (math.pi / 2.0)))
        quads += [
            f"[{one:.4f},{-_TALL:g}, {other:.4f},{-_TALL:g}, {other:.4f},{_TALL:g}, {one:.4f},{_TALL:g}]"
            for one, other in itertools.pairwise(parts)
        ]
    return f"[{', '.join(quads)}]" if quads else ""


_BODY_M, _LEAST_OBSTRUCTION, _TALL = 1.0, math.radians(2.0), 1.4
"""From here on a view is no obstructed one; narrower obstructions are left out; elevations in radians up to and down to
which a polygon reaches."""

BLIND_MOST_M = 5.0
"""A ray that meets no FREE cell up to here gives no beam: what hides its beginning may hide more."""


def _free_rays(estimate: FovEstimate) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return for each ray where its FREE cells end and begin, and its angle; an end of 0 where it has none."""
    angle, range_m, number = _rays(estimate.grid)
    # 1. Which samples of each ray are FREE; those outside the grid have the number of a cell that is not.
    free = np.append(estimate.state == CellState.FREE, False)[number]
    # 2. The first FREE sample, and the first one after it that is not.
    begin = free.argmax(axis=1)
    ended = ~free & (np.arange(len(range_m)) > begin[:, None])
    end = ended.argmax(axis=1)
    seen = free.any(axis=1) & (range_m[begin] <= BLIND_MOST_M)
    return np.where(seen, range_m[end - 1], 0.0), range_m[begin], angle


@lru_cache(maxsize=4)
def _rays(grid: BevGrid) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.intp]]:
    """Return angles (R,) and ranges (S,) of rays from the sensor to beyond the grid, and the cells (R, S) they cross.

    Cells are numbers of the flattened grid; the one after the last stands for all outside.
    """
    farthest_m = math.hypot(*(grid.half_extent_m + abs(offset_m) for offset_m in grid.offset_m)) + grid.cell_m
    rays = math.ceil(_RAYS_A_CELL * 2.0 * math.pi * grid.half_extent_m / grid.cell_m)
    angle = np.linspace(-np.pi, np.pi, rays, endpoint=False)
    range_m = np.arange(0.0, farthest_m, grid.cell_m / _STEPS_A_CELL)
    cells, inside = grid.index(
        np.stack([np.outer(np.cos(angle), range_m), np.outer(np.sin(angle), range_m)], axis=-1)
    )  # fmt: skip
    number = np.where(inside, cells[..., 0] * grid.cells + cells[..., 1], grid.cells**2)
    return angle, range_m, number
