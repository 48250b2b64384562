"""The same steps with commonly used tools."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from concave_hull import concave_hull_indexes
from contourpy import FillType, contour_generator
from numpy.typing import NDArray
from rasterio.features import rasterize, shapes
from rasterio.transform import Affine
from shapely import MultiPolygon

from viewshed.estimators.concave_hull import ConcaveHull
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.sweep import Sweep

Span = tuple[float, float]


def _kept(points: NDArray[np.float32], transform: Rigid, max_range_m: float, height_m: Span) -> NDArray[np.float32]:
    rotation, shift = transform.rotation.astype(np.float32), transform.translation.astype(np.float32)
    level = points @ rotation.T + shift
    z = level[:, 2]
    near = level[:, 0] ** 2 + level[:, 1] ** 2 <= max_range_m**2
    kept: NDArray[np.float32] = level[near & (z >= height_m[0]) & (z <= height_m[1])]
    return kept


def count_by_histogram2d(
    points: NDArray[np.float32], transform: Rigid, grid: BevGrid, max_range_m: float, height_m: Span
) -> NDArray[Any]:
    """Return counts (cells, cells) by ``np.histogram2d``."""
    level = _kept(points, transform, max_range_m, height_m)
    half = grid.half_extent_m
    return np.histogram2d(level[:, 0], level[:, 1], bins=grid.cells, range=[[-half, half], [-half, half]])[0]


def count_by_bincount(
    points: NDArray[np.float32], transform: Rigid, grid: BevGrid, max_range_m: float, height_m: Span
) -> NDArray[Any]:
    """Return counts (cells, cells) by ``np.bincount`` of flat cell numbers."""
    level = _kept(points, transform, max_range_m, height_m)
    cells = np.floor((level[:, :2] - np.float32(grid.origin_m[0])) / np.float32(grid.cell_m)).astype(np.int64)
    cells = cells[((cells >= 0) & (cells < grid.cells)).all(axis=1)]
    flat = cells[:, 0] * grid.cells + cells[:, 1]
    return np.bincount(flat, minlength=grid.cells**2).reshape(grid.shape)


def hulls(sweep: Sweep, grid: BevGrid) -> dict[str, Callable[[], object]]:
    """Return concave hulls of the raw points, filled into a mask, by library; concave_hull with our parameters."""
    xy = np.ascontiguousarray(sweep.points[:, :2], np.float64)
    ours = ConcaveHull(grid)

    def by_concave_hull() -> NDArray[np.uint8]:
        hull = concave_hull_indexes(xy, concavity=ours.concavity, length_threshold=ours.length_threshold_m)
        return _fill(shapely.Polygon(xy[hull]), grid)

    def by_shapely() -> NDArray[np.uint8]:
        return _fill(shapely.concave_hull(shapely.MultiPoint(xy), ratio=0.05), grid)

    return {"concave_hull, raw points": by_concave_hull, "shapely.concave_hull, raw points": by_shapely}


def _fill(polygon: Any, grid: BevGrid) -> NDArray[np.uint8]:
    mask: NDArray[np.uint8] = rasterize([polygon], grid.shape, transform=_affine(grid), dtype=np.uint8)
    return mask


def _affine(grid: BevGrid) -> Affine:
    """Return the transform of a grid's arrays, whose rows are x and columns y."""
    return Affine(0.0, grid.cell_m, grid.origin_m[0], grid.cell_m, 0.0, grid.origin_m[1])


def polygon_by_rasterio(mask: NDArray[np.bool_], grid: BevGrid) -> MultiPolygon:
    """Return the mask's cells as polygons with holes by ``rasterio.features.shapes``."""
    outlines = shapes(mask.astype(np.uint8), mask=mask, connectivity=4, transform=_affine(grid))
    rings = (outline["coordinates"] for outline, _ in outlines)
    return MultiPolygon([shapely.Polygon(outer, holes) for outer, *holes in rings])


def polygon_by_contourpy(mask: NDArray[np.bool_], grid: BevGrid) -> MultiPolygon:
    """Return the 0.5 contour of the mask as polygons with holes; corners of cells are cut."""
    steps = grid.origin_m[0] + (np.arange(-1, grid.cells + 1) + 0.5) * grid.cell_m
    padded = np.pad(mask.astype(np.float64), 1)
    filled: Any = contour_generator(steps, steps, padded.T, fill_type=FillType.OuterOffset).filled(0.5, np.inf)
    rings = ([part[a:b] for a, b in pairwise(ends)] for part, ends in zip(*filled, strict=True))
    return MultiPolygon([shapely.Polygon(outer, holes) for outer, *holes in rings])
