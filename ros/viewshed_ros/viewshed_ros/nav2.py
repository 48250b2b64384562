"""Inputs of nav2's costmaps as numpy arrays: speed and keep-out masks in the map, and ends of clearing beams.

:mod:`viewshed_ros.layers` converts them to messages.
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
"""Value of a speed mask without a limit."""

_RAYS_A_CELL, _STEPS_A_CELL = 2.0, 4.0
"""Rays per cell at the grid's nearest edge, and samples along a ray per cell side."""


@dataclass(frozen=True, slots=True)
class SpeedLimits:
    """Speed limits of a speed mask."""

    most_mps: float = 10.0  # speed at 100 %
    unseen_mps: float = 1.0  # speed limit in cells that are not visible
    here_m: float = 3.0  # radius around the sensor in which the limit is the vehicle's safe speed for its view

    def __post_init__(self) -> None:
        if not (0.0 < self.unseen_mps <= self.most_mps < math.inf and self.here_m >= 0.0):
            raise ValueError(f"speeds must satisfy 0 < unseen ≤ most and here_m must not be negative, got {self}")

    def percent(self, speed_mps: float) -> int:
        """Return a speed in percent of the maximum, rounded down; at least 1, because 0 means no limit.

        >>> SpeedLimits(10.0).percent(2.59), SpeedLimits(10.0).percent(0.0), SpeedLimits(10.0).percent(99.0)
        (25, 1, 100)
        """
        return min(max(math.floor(100.0 * speed_mps / self.most_mps), 1), 100)


def speed_values(estimate: FovEstimate, speed_mps: float, limits: SpeedLimits) -> NDArray[np.int8]:
    """Return speed limits (cells, cells) in percent: none in visible cells, ``unseen_mps`` elsewhere.

    nav2 looks up the cell of the robot, so cells within ``here_m`` hold the speed from which it can stop in its view.
    """
    values = np.where(estimate.visible(), np.int8(NO_LIMIT), np.int8(limits.percent(limits.unseen_mps)))
    values[polar_of_cells(estimate.grid)[0] <= limits.here_m] = limits.percent(speed_mps)
    return values


def clearing_ends(estimate: FovEstimate) -> NDArray[np.float64]:
    """Return the ends (K, 2) of virtual beams in ``level``, meters.

    All cells between the first FREE cell of a ray and its end are FREE. A costmap that clears from the sensor to each
    end would also clear the cells before the first FREE one, which the sensor does not see; set its minimum clearing
    range (``raytrace_min_range``, see :func:`blind_m`) to prevent that.
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
    """Return the obstructed directions in the format of STVL's parameter ``obstruction_polygons``.

    ``[[azimuth, elevation, …], …]`` in radians: convex polygons, azimuths in [0, 2π], none across 0. A direction is
    obstructed if no cell from 1 m to 5 m is FREE: by the robot itself, or by something right in front of it. Walls
    farther away cannot be represented, because the polygons have no range. Empty if nothing is obstructed, or all
    directions are: then the sensor looks over these cells and cannot tell what its robot obstructs.
    """
    angle, range_m, number = _rays(estimate.grid)
    near = (range_m >= _BODY_M) & (range_m <= MAX_BLIND_M)
    free = np.append(estimate.state == CellState.FREE, False)[number[:, near]].any(axis=1)
    # 1. Rays by azimuth from 0 on, so that no polygon lies across 0.
    order = np.argsort(angle % (2.0 * math.pi))
    azimuth, is_hidden = (angle % (2.0 * math.pi))[order], ~free[order]
    if is_hidden.all():
        return ""
    half = math.pi / len(azimuth)
    # 2. Runs of hidden rays, split into quarter turns at most, because wider polygons are not convex.
    edge = np.flatnonzero(np.diff(np.concatenate([[False], is_hidden, [False]]).astype(np.int8)))
    quads = []
    for begin, end in zip(edge[::2], edge[1::2], strict=True):
        first, last = max(azimuth[begin] - half, 0.0), min(azimuth[end - 1] + half, 2.0 * math.pi)
        if last - first < _MIN_OBSTRUCTION:
            continue
        parts = np.linspace(first, last, 1 + math.ceil((last - first) / (math.pi / 2.0)))
        quads += [
            f"[{left:.4f},{-_TALL:g}, {right:.4f},{-_TALL:g}, {right:.4f},{_TALL:g}, {left:.4f},{_TALL:g}]"
            for left, right in itertools.pairwise(parts)
        ]
    return f"[{', '.join(quads)}]" if quads else ""


_BODY_M, _MIN_OBSTRUCTION, _TALL = 1.0, math.radians(2.0), 1.4
"""Obstructions: minimum range of the cells that are checked, minimum width, and elevation of the upper and lower edge
(radians)."""

MAX_BLIND_M = 5.0
"""A ray without a FREE cell up to this range gives no clearing beam: what hides its near cells may hide more."""


def _free_rays(estimate: FovEstimate) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return for each ray the ranges at which its FREE cells end and begin, and its angle; end 0 if it has none."""
    angle, range_m, number = _rays(estimate.grid)
    # 1. FREE samples of each ray; samples outside the grid have the index of an additional cell that is not FREE.
    free = np.append(estimate.state == CellState.FREE, False)[number]
    # 2. The first FREE sample, and the first later one that is not FREE.
    begin = free.argmax(axis=1)
    ended = ~free & (np.arange(len(range_m)) > begin[:, None])
    end = ended.argmax(axis=1)
    seen = free.any(axis=1) & (range_m[begin] <= MAX_BLIND_M)
    return np.where(seen, range_m[end - 1], 0.0), range_m[begin], angle


@lru_cache(maxsize=4)
def _rays(grid: BevGrid) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.intp]]:
    """Return angles (R,) and ranges (S,) of rays from the sensor to beyond the grid, and the cells (R, S) of samples.

    Cells are indices into the flattened grid; one index past the end stands for outside.
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
