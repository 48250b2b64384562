"""nav2: a map for its map server and a mask for its KeepoutFilter, each a YAML file and a PGM image.

Format: https://docs.nav2.org/configuration/packages/configuring-map-server.html and ``map_io.cpp`` there. Image rows go
from the largest y to the smallest; ``origin`` is the lower left corner. Cells are aligned with the axes of the map,
because costmaps ignore the yaw of ``origin``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import CellState, FovEstimate, is_visible
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid, polar_of_cells

MAP_STATES = "trinary: FREE is free, SURFACE occupied, HIDDEN and UNKNOWN unknown"

MASK_STATES = "keep-out: 0 where FREE or SURFACE, 100 where HIDDEN or UNKNOWN, unknown beyond the reach"

NOTHING_KNOWN = -1
"""Cell value of a map or a mask: unknown."""

_TRINARY = "mode: trinary\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.1\n"
"""Thresholds of occupancy: pixel 0 is occupied, 254 free, and 205 (the usual gray) unknown."""

_RAW = "mode: raw\nnegate: 0\noccupied_thresh: 1.0\nfree_thresh: 0.0\n"
"""Pixels 0 to 100 are values, others unknown; nav2 requires the thresholds in every mode."""

_TRINARY_PIXELS = np.array([205, 254, 0, 205], np.uint8)
"""Pixel by :class:`CellState`."""

_UNKNOWN_PIXEL = 255


def to_map(estimate: FovEstimate) -> tuple[bytes, bytes]:
    """Return a map as YAML without its ``image`` line, and the image.

    The image is a PGM: 254 where FREE, 0 where SURFACE, 205 where HIDDEN or UNKNOWN.
    """
    grid, state = _in_map_axes(estimate, estimate.state.astype(np.int8))
    pixels = _TRINARY_PIXELS[np.where(state == NOTHING_KNOWN, np.int8(CellState.UNKNOWN), state)]
    return _yaml(grid, _TRINARY), _pgm(pixels)


def to_mask(estimate: FovEstimate) -> tuple[bytes, bytes]:
    """Return a mask for the KeepoutFilter as YAML without its ``image`` line, and the image.

    The image is a PGM of :func:`keepout_values`, 255 where unknown.
    """
    grid, values = _in_map_axes(estimate, keepout_values(estimate))
    return _yaml(grid, _RAW), _pgm(np.where(values == NOTHING_KNOWN, _UNKNOWN_PIXEL, values).astype(np.uint8))


def keepout_values(estimate: FovEstimate) -> NDArray[np.int8]:
    """Return the keep-out mask (cells, cells) int8: 0 where FREE or SURFACE, else 100, unknown beyond the reach."""
    values = np.where(is_visible(estimate.state), np.int8(0), np.int8(100))
    if estimate.basis is not None:
        values[polar_of_cells(estimate.grid)[0] > estimate.basis.reach_m] = NOTHING_KNOWN
    return values


def in_the_map(
    values: NDArray[np.int8], grid: BevGrid, world_from_level: Rigid
) -> tuple[BevGrid, NDArray[np.int8]]:  # fmt: skip
    """Resample values to a grid aligned with the map's axes and raster, as costmap filters support no rotation.

    Args:
        values: (cells, cells) on ``grid``.
        grid: in the ``level`` frame.
        world_from_level: pose of the ``level`` frame.
    """
    map_grid = grid_in_the_map(grid, world_from_level)
    # Nearest-neighbor at each cell center, at the height of the ground, so that a slope does not shift cells.
    x_m, y_m = map_grid.centers[..., 0], map_grid.centers[..., 1]
    ground_m = (world_from_level @ np.array([*grid.offset_m, 0.0]))[2]
    world = np.stack([x_m, y_m, np.full(grid.shape, ground_m)], axis=-1)
    cells, inside = grid.index((world_from_level.inverse() @ world)[..., :2])
    return map_grid, np.where(inside, values[cells[..., 0], cells[..., 1]], np.int8(NOTHING_KNOWN))


def grid_in_the_map(grid: BevGrid, world_from_level: Rigid) -> BevGrid:
    """Return the grid aligned with the map's axes and raster that is centered at a grid of the ``level`` frame."""
    center = world_from_level @ np.array([*grid.offset_m, 0.0])
    on_raster = (np.round(center[:2] / grid.cell_m) * grid.cell_m).tolist()
    return BevGrid(grid.cells, grid.half_extent_m, (on_raster[0], on_raster[1]))


def _in_map_axes(estimate: FovEstimate, values: NDArray[np.int8]) -> tuple[BevGrid, NDArray[np.int8]]:
    """Return grid and values (cells, cells) aligned with the map, or with ``level`` if there is no pose."""
    pose = estimate.world_from_level
    return (estimate.grid, values) if pose is None else in_the_map(values, estimate.grid, pose)


def _yaml(grid: BevGrid, mode: str) -> bytes:
    x_m, y_m = grid.origin_m
    return f"resolution: {grid.cell_m:.9g}\norigin: [{x_m:.9g}, {y_m:.9g}, 0.0]\n{mode}".encode()


def _pgm(pixels: NDArray[np.uint8]) -> bytes:
    """Encode an image of cells (x, y) as PGM: x to the right, y upward."""
    rows = np.ascontiguousarray(pixels.T[::-1])
    return b"P5\n%d %d\n255\n" % (rows.shape[1], rows.shape[0]) + rows.tobytes()
