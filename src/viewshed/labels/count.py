"""Counting: from the beams of one revolution to the label, by the definitions themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.bev import BevGrid
from viewshed.labels.image import BeamImage
from viewshed.sim.truth_cells import patches_of
from viewshed.sim.truth_counts import MANY, count_cells
from viewshed.sim.truth_kernels import beam_lines, slope_bounds, sorted_tiles
from viewshed.visible import Target

BELOW_GROUND_M = 0.02
"""As in the exact truth: a beam may cross the target this far below the ground of its cell's centre."""
Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]


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
    beams = (tiles, starts, slope_bounds(lines[4], azimuth, rings))
    aside = np.float32(np.sqrt((origin[..., 0] ** 2 + origin[..., 1] ** 2).max()))
    return Lines(lines, azimuth, beams, (aside, origin[..., 2].min(), origin[..., 2].max()), reach)


def count_targets(
    lines: Lines, grid: BevGrid, ground_m: Floats, targets: tuple[Target, Target], some: Mask | None = None
) -> dict[str, tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """Return by target how many beams aim at it in each cell and how many reach it, (cells²,) uint8 up to 255.

    The definition itself, in whole beams, with the loops of the exact truth.

    Args:
        lines: the beams.
        grid: where the cells are.
        ground_m: z from the sensor (cells²,) of the ground at the cells' centres.
        targets: what would have to be seen.
        some: cells (cells²,) that are asked for; others may stay 0.
    """
    a, b = sorted(targets, key=lambda target: -target.width_m)
    sizes = (np.float32(size) for size in (a.width_m / 2, b.width_m / 2, a.height_m, b.height_m))
    plates = (*sizes, min(a.min_returns, MANY), min(b.min_returns, MANY))
    limits = (np.float32(grid.cell_m), np.float32(BELOW_GROUND_M), *lines.offsets_m, lines.max_range_m)
    patches = patches_of(grid)
    if some is not None:
        rows = some[patches[1]].any(axis=1)
        patches = (patches[0][rows], patches[1][rows], patches[2][rows])
    counts = np.zeros(ground_m.size, np.int32)
    count_cells(lines.sorted, patches, np.asarray(ground_m, np.float32), plates, limits, counts)
    bytes_of = [(counts >> shift).astype(np.uint8) for shift in (0, 8, 16, 24)]
    return {a.name: (bytes_of[0], bytes_of[2]), b.name: (bytes_of[1], bytes_of[3])}
