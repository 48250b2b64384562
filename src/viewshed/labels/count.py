"""Counting: from the beams of one revolution to the label, by the definitions themselves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.bev import BevGrid, polar_of_cells
from viewshed.labels.image import BeamImage
from viewshed.sim.truth_kernels import MANY, beam_lines, count_cells, slope_bounds, sorted_tiles, tile_reaches
from viewshed.visible import Target

BELOW_GROUND_M = 0.02
"""As in the exact truth: a beam may cross the target this far below the ground of its cell's centre."""
Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """The beams of one revolution as lines that end, ready to be counted.

    Attributes:
        lines: (6, C·R) see ``viewshed.sim.truth_kernels``.
        azimuth: (C·R,) of the beams.
        sorted: the same by azimuth, in tiles.
        offsets_m: largest horizontal offset of a beam's start, its lowest and its highest vertical one.
        max_range_m: how far the sensor sees.
    """

    lines: Floats
    azimuth: Floats
    sorted: tuple[Any, ...]
    offsets_m: tuple[np.float32, np.float32, np.float32]
    max_range_m: np.float32


def lines_of(image: BeamImage, depth_m: Floats) -> Lines:
    """Return the beams of ``image``, which ended at depths (C, R)."""
    rings, origin, reach = image.pixels.shape[1], image.origin_m, np.float32(image.max_range_m)
    lines, azimuth = beam_lines(origin, image.direction, depth_m, (np.float32(1), np.float32(0)), reach)
    tiles, starts = sorted_tiles(lines, azimuth, rings)
    beams = (tiles, tile_reaches(tiles), starts, slope_bounds(lines[4], azimuth, rings))
    aside = np.float32(np.sqrt((origin[..., 0] ** 2 + origin[..., 1] ** 2).max()))
    return Lines(lines, azimuth, beams, (aside, origin[..., 2].min(), origin[..., 2].max()), reach)


def count_targets(
    lines: Lines, cells: Floats, cell_m: float, targets: tuple[Target, Target]
) -> dict[str, tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """Return by target how many beams aim at it in each cell and how many reach it, (N,) uint8 up to 255.

    The definition itself, in whole beams, with the loops of the exact truth.

    Args:
        lines: the beams.
        cells: (5, N) unit vector, range, azimuth and ground (z from the sensor) of the cells' centres.
        cell_m: side of a cell.
        targets: what would have to be seen.
    """
    a, b = sorted(targets, key=lambda target: -target.width_m)
    sizes = (np.float32(size) for size in (a.width_m / 2, b.width_m / 2, a.height_m, b.height_m))
    limits = (np.float32(cell_m), np.float32(BELOW_GROUND_M), *lines.offsets_m, lines.max_range_m)
    out = np.empty((4, cells.shape[1]), np.uint8)
    count_cells(lines.sorted, cells, (*sizes, min(a.min_returns, MANY), min(b.min_returns, MANY)), limits, out)
    return {a.name: (out[0], out[1]), b.name: (out[2], out[3])}


def cells_of(grid: BevGrid, ground_m: Floats) -> Floats:
    """Return (5, cells²) float32 the cells' centres as :func:`count_targets` takes them, on a ground (cells²,)."""
    cells = _flat_cells(grid).copy()
    cells[4] = ground_m
    return cells


@lru_cache(maxsize=8)
def _flat_cells(grid: BevGrid) -> Floats:
    range_m, azimuth = polar_of_cells(grid)
    some = np.maximum(range_m, 1e-6)
    unit = (grid.centers[..., 0] / some, grid.centers[..., 1] / some)
    return np.stack([*unit, range_m, azimuth, range_m]).astype(np.float32).reshape(5, -1)
