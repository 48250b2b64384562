"""Conversion of masks to polygons and back: exact outlines, or simpler polygons within the mask.

Polygons are in meters of the ``level`` frame; cell (i, j) spans x (forward) by i and y (left) by j.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import GeometryType, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from viewshed import _core
from viewshed.arrays import F64, Mask
from viewshed.geometry import FloatArray
from viewshed.grid import BevGrid

BINS = 720
"""Number of candidate directions of the vertices of an inner polygon, 0.5° apart."""

SECTOR_BINS = 1800
"""Number of directions for up to 64 sectors, 0.2° apart: multiples of the 0.1° of ETSI messages. More than 64 sectors
use half as many."""

MAX_SECTORS = 256
"""Maximum number of sectors of a mask."""

_MAX_PIECES = 8

_PRICE_STEPS, _PRICE_SPAN = 7, 500.0


def checked_mask(mask: Mask, grid: BevGrid) -> Mask:
    """Return ``mask`` as a contiguous bool array; raise ValueError if its shape or dtype is wrong."""
    array = np.asarray(mask)
    if array.shape != grid.shape or array.dtype != np.bool_:
        raise ValueError(f"mask must be bool of the grid's shape {grid.shape}, got {array.dtype} {array.shape}")
    return np.ascontiguousarray(array)


def local_crs(frame: str) -> dict[str, Any]:
    """Return the member ``crs`` of a GeoJSON in meters; without it programs assume longitude and latitude.

    >>> local_crs("level")["properties"]["name"].partition("[")[0]
    'LOCAL_CS'
    """
    name = f'LOCAL_CS["{frame} frame of viewshed",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'
    return {"type": "name", "properties": {"name": name}}


def polygon_of_mask(mask: Mask, grid: BevGrid) -> MultiPolygon:
    """Return the true cells of ``mask`` (cells, cells) as a valid polygon with holes, in meters.

    The outline follows the cells' edges; vertices are at its corners only. Cells that share only a corner are separate.

    >>> polygon_of_mask(np.eye(2, dtype=bool), BevGrid(2, 1.0)).area
    2.0
    """
    array = checked_mask(mask, grid)
    if not array.any():
        return MultiPolygon()
    vertices, starts, ring_labels = _core.rings_of_mask(array, _core.label_regions(array, False))
    vertices, rings, owners = _group_rings(vertices, starts, ring_labels)
    coords = np.asarray(grid.origin_m) + vertices * grid.cell_m
    return MultiPolygon(
        shapely.from_ragged_array(GeometryType.MULTIPOLYGON, coords, (rings, owners, np.array([0, len(owners) - 1])))[0]
    )


def _group_rings(
    vertices: NDArray[np.int16], starts: NDArray[np.int64], labels: NDArray[np.int32]
) -> tuple[NDArray[np.int16], NDArray[np.int64], NDArray[np.int64]]:
    """Return closed rings ordered by component, each shell before its holes: vertices, ring and polygon offsets."""
    counts = np.diff(starts)
    order = np.lexsort((labels < 0, np.abs(labels)))
    rings = np.concatenate([[0], np.cumsum(counts[order] + 1)])
    within = np.arange(rings[-1]) - np.repeat(rings[:-1], counts[order] + 1)
    rows = np.repeat(starts[:-1][order], counts[order] + 1) + within % np.repeat(counts[order], counts[order] + 1)
    owners = np.concatenate([np.flatnonzero(labels[order] > 0), [len(order)]])
    return vertices[rows], rings, owners


def mask_of_polygon(polygon: BaseGeometry, grid: BevGrid) -> Mask:
    """Return the mask (cells, cells) of cells whose center lies inside ``polygon`` (in meters, holes excluded).

    A center exactly on the outline counts if that edge is a lower x or lower y side of the shape.

    >>> int(mask_of_polygon(shapely.box(-1, -1, 1, 0), BevGrid(4, 2.0)).sum())
    2
    """
    if polygon.geom_type not in ("Polygon", "MultiPolygon"):
        raise ValueError(f"polygon must be a Polygon or MultiPolygon, got {polygon.geom_type}")
    return _core.cells_inside(*_rings_in_cells(polygon, grid), grid.cells)


def _rings_in_cells(polygon: BaseGeometry, grid: BevGrid) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the points (V, 2) of all closed rings of a polygon in units of cells, and the ring offsets (R + 1,)."""
    rings = shapely.get_rings(shapely.get_parts(polygon))
    offsets = np.concatenate([[0], np.cumsum(shapely.get_num_coordinates(rings), dtype=np.int64)])
    return (shapely.get_coordinates(rings) - grid.origin_m) / grid.cell_m, offsets


def vertices_of(polygon: BaseGeometry) -> int:
    """Return the number of vertices of all rings, without the repeated closing vertices.

    >>> vertices_of(shapely.box(0, 0, 1, 1))
    4
    """
    rings = shapely.get_rings(shapely.get_parts(polygon))
    return int(shapely.get_num_coordinates(rings).sum()) - len(rings)


def inner_polygon_of_mask(mask: Mask, grid: BevGrid, max_vertices: int) -> MultiPolygon:
    """Return a polygon of at most ``max_vertices`` vertices that lies within the true cells of ``mask``.

    If the exact outline has more vertices, the result is a set of disjoint star polygons: the first about the sensor,
    with a hole for its blind spot, the others in the remaining cells. Each maximizes area minus price · vertices. The
    price per vertex is found by bisection from above: at area / ``max_vertices`` no result can have more than
    ``max_vertices`` vertices. A heuristic, not the optimum.

    Raises:
        ValueError: ``max_vertices`` is below 3, or the shape or dtype of the mask is wrong.
    """
    if max_vertices < 3:
        raise ValueError(f"max_vertices must be at least 3, got {max_vertices}")
    array = checked_mask(mask, grid)
    exact = polygon_of_mask(array, grid)
    if vertices_of(exact) <= max_vertices:
        return exact
    best, high = MultiPolygon(), exact.area / max_vertices
    low = high / _PRICE_SPAN
    for _ in range(_PRICE_STEPS):
        price = float(np.sqrt(low * high))
        polygon = _inner_pieces(array, grid, price)
        if vertices_of(polygon) > max_vertices:
            low = price
            continue
        high = price
        best = max(best, polygon, key=lambda shape: shape.area)
    return best


def free_ranges(
    mask: Mask,
    grid: BevGrid,
    apex_m: tuple[float, float],
    bins: int,
    *,
    margin_m: float = 0.0,
    whole_cells: bool = True,
) -> F64:
    """Return (bins,) float64 meters: the free range of each wedge about ``apex_m`` within the true cells of ``mask``.

    With ``whole_cells`` the wedges stay ``margin_m`` away from every part of a false cell; without, they contain no
    center of a false cell and do not leave the grid. 0 if the apex is not on a true cell. ``bins`` must be a multiple
    of 4.
    """
    if bins % 4 or bins <= 0:
        raise ValueError(f"bins must be a positive multiple of 4, got {bins}")
    mask = checked_mask(mask, grid)
    lattice = (*grid.origin_m, grid.cell_m, *apex_m)
    if whole_cells:
        return _core.free_ranges(mask, *lattice, 0.5 * grid.cell_m + margin_m, bins, True)
    edge = _core.free_ranges(np.ones_like(mask), *lattice, 0.5 * grid.cell_m + margin_m, bins, True)
    return np.minimum(edge, _core.free_ranges(mask, *lattice, max(margin_m, 1e-6), bins, False))


def star_ring(mask: Mask, grid: BevGrid, bins: int = 360) -> NDArray[np.float64]:
    """Return one ring (V, 2) of corners in meters around the sensor that lies within the true cells of ``mask``.

    Each of ``bins`` wedges ends at the first false cell. A blind spot around the sensor is cut out by a circle, which
    the same ring traverses in the opposite direction, so no second ring is needed. At least 100 times as fast as
    :func:`inner_polygon_of_mask`, with more vertices. Empty (0, 2) if the sensor is neither on a true cell nor in a
    hole surrounded by true cells.

    Args:
        mask: (cells, cells) bool.
        grid: grid of the mask.
        bins: number of wedges, a multiple of 4.

    >>> box = BevGrid(8, 4.0)
    >>> ring = star_ring(np.ones((8, 8), bool), box)
    >>> 48.0 < Polygon(ring).area <= 64.0
    True
    """
    array = checked_mask(mask, grid)
    hole = blind_spot(array, grid)
    if hole is None:
        return np.zeros((0, 2))
    # 1. Circle around the blind spot; the polygon circumscribes it, touching it in the middle of each wedge.
    inner_m = 0.0
    if hole.any():
        farthest_m = np.hypot(*grid.centers[hole].T).max() + grid.cell_m / np.sqrt(2)
        inner_m = float(farthest_m / np.cos(np.pi / bins))
    # 2. Two corners per wedge, at its free range; the chord between them lies inside the free circle sector.
    reach_m = np.maximum(free_ranges(array | hole, grid, (0.0, 0.0), bins), inner_m)
    border = np.arange(bins + 1) * (2 * np.pi / bins)
    angle, range_m = np.repeat(border, 2)[1:-1], np.repeat(reach_m, 2)
    if hole.any():
        angle, range_m = np.append(angle, border[::-1]), np.append(range_m, np.full(bins + 1, inner_m))
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) * range_m[:, None]
    return ring if reach_m.max() > inner_m else np.zeros((0, 2))


def _inner_pieces(mask: Mask, grid: BevGrid, price_m2: float) -> MultiPolygon:
    """Return up to 8 disjoint star polygons inside ``mask``, while area exceeds price · vertices."""
    remaining, pieces = mask.copy(), list[Polygon]()
    for _ in range(_MAX_PIECES):
        piece, covered = _best_star(remaining, grid, price_m2, about_sensor=not pieces)
        if piece.area - price_m2 * vertices_of(piece) <= 0.0:
            break
        pieces.extend(part for part in shapely.get_parts(piece) if isinstance(part, Polygon))
        remaining &= ~covered
    return MultiPolygon(pieces)


def _best_star(mask: Mask, grid: BevGrid, price_m2: float, about_sensor: bool) -> tuple[BaseGeometry, Mask]:
    """Return the star polygon, about the sensor or the deepest cell, of largest net value, and the cells it touches."""
    deepest = deepest_point(mask, grid)
    candidates = [_star_about(mask, grid, (float(deepest[0]), float(deepest[1])), price_m2, None)]
    hole = blind_spot(mask, grid) if about_sensor else None
    if hole is not None:
        candidates.append(_star_about(mask | hole, grid, (0.0, 0.0), price_m2, hole))
    star = max(candidates, key=lambda shape: shape.area - price_m2 * vertices_of(shape))
    covered = mask_of_polygon(star, grid) if not star.is_empty else np.zeros_like(mask)
    covered |= _core.cells_met(*_rings_in_cells(star, grid), grid.cells)
    return star, covered


def _star_about(
    mask: Mask, grid: BevGrid, apex_m: tuple[float, float], price_m2: float, hole: Mask | None
) -> BaseGeometry:
    bins = min(BINS, 48 + 3 * grid.cells // 16 * 16)
    bins = bins if hole is not None else bins // 4
    vertices = _core.star_vertices(free_ranges(mask, grid, apex_m, bins), price_m2)
    if len(vertices) < 3:
        return MultiPolygon()
    angle, radius = vertices.T
    star = Polygon(np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius[:, None] + apex_m)
    return star if hole is None or not hole.any() else shapely.difference(star, bounding_box(hole, grid))


def deepest_point(mask: Mask, grid: BevGrid) -> NDArray[np.float64]:
    """Return (2,) meters: the center of the true cell of ``mask`` that is farthest from all false cells."""
    deepest = np.unravel_index(int(np.argmax(_core.squared_depth(np.ascontiguousarray(mask)))), mask.shape)
    center: NDArray[np.float64] = grid.centers[deepest]
    return center


def bounding_box(hole: Mask, grid: BevGrid) -> Polygon:
    """Return the smallest axis-aligned rectangle in meters around the true cells of ``hole``, at least one."""
    low, high = np.argwhere(hole).min(axis=0), np.argwhere(hole).max(axis=0) + 1
    corners = np.asarray(grid.origin_m) + np.stack([low, high]) * grid.cell_m
    box: Polygon = shapely.box(*corners[0], *corners[1])
    return box


def blind_spot(mask: Mask, grid: BevGrid) -> Mask | None:
    """Return the mask (cells, cells) of the hole in ``mask`` around the sensor, all False if the sensor's cell is true.

    None if the sensor is not surrounded by true cells, or not on the grid.
    """
    nudges = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) * grid.cell_m * 1e-6
    cells, inside = grid.index(nudges)
    if not inside.all():
        return None
    # The hole is 8-connected; the padding represents everything outside the grid.
    padded = _core.label_regions(np.pad(~mask, 1, constant_values=True), True)
    labels = padded[1:-1, 1:-1]
    sensor_labels = np.unique(labels[cells[:, 0], cells[:, 1]])
    if padded[0, 0] in sensor_labels:
        return None
    hole: Mask = np.isin(labels, sensor_labels[sensor_labels > 0])
    return hole


@dataclass(frozen=True, slots=True, eq=False)
class Sectors:
    """Union of K annular sectors about one point, which may overlap."""

    apex_m: tuple[float, float]  # (x, y) of the point in ``level``, in meters
    start: NDArray[np.float64]  # (K,) radians in [0, 2π), counter-clockwise from x, ascending
    end: NDArray[np.float64]  # (K,) radians, larger than ``start``
    range_m: NDArray[np.float64]  # (K,) outer range in meters
    inner_m: float = 0.0  # inner range of all sectors in meters; 0 if they begin at the point

    @property
    def area_m2(self) -> float:
        """Area of the union of the sectors in square meters."""
        borders, reach = self._union()
        return float(0.5 * ((reach**2 - self.inner_m**2) * np.diff(borders)).sum())

    def covers(self, xy: FloatArray) -> Mask:
        """Return the mask (…,) of the points (…, 2) that lie in a sector."""
        x, y = np.asarray(xy)[..., 0] - self.apex_m[0], np.asarray(xy)[..., 1] - self.apex_m[1]
        borders, reach = self._union()
        piece = np.searchsorted(borders, np.arctan2(y, x) % (2 * np.pi), side="right") - 1
        radius = np.hypot(x, y)
        covered: Mask = (radius >= self.inner_m) & (radius < reach[piece.clip(max=len(reach) - 1)])
        return covered

    def _union(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ascending angles (B,) from 0 to 2π, and the range (B - 1,) of the union between adjacent angles."""
        turn = 2 * np.pi
        borders = np.unique(np.concatenate([[0.0, turn], self.start % turn, self.end % turn]))
        middle = 0.5 * (borders[1:, None] + borders[:-1, None])
        within = (middle - self.start) % turn < self.end - self.start
        return borders, np.where(within, self.range_m, self.inner_m).max(axis=1, initial=self.inner_m)


def sectors_of_mask(
    mask: Mask,
    grid: BevGrid,
    sectors: int,
    *,
    apex_m: tuple[float, float] = (0.0, 0.0),
    whole_cells: bool = True,
    range_step_m: float = 0.0,
) -> Sectors:
    """Return at most ``sectors`` sectors about ``apex_m`` with the largest union within the true cells of ``mask``.

    With ``whole_cells`` they cover no part of a false cell; without, no center of a false cell. Ranges are rounded down
    to ``range_step_m``. If the sensor is in a blind spot, they begin beyond it (``inner_m``).

    Raises:
        ValueError: ``sectors`` is out of range, or the shape or dtype of the mask is wrong.
    """
    if not 1 <= sectors <= MAX_SECTORS:
        raise ValueError(f"sectors must lie in [1, {MAX_SECTORS}], got {sectors}")
    array, inner = checked_mask(mask, grid), 0.0
    hole = blind_spot(array, grid) if apex_m == (0.0, 0.0) else None
    if hole is not None and hole.any():
        array, inner = array | hole, float(np.hypot(*np.abs(grid.centers[hole]).T).max() + grid.cell_m * 0.7072)
    bins = SECTOR_BINS if sectors <= 64 else SECTOR_BINS // 2
    ranges = free_ranges(array, grid, apex_m, bins, whole_cells=whole_cells)
    if range_step_m > 0.0:
        ranges = np.floor(ranges / range_step_m + 1e-9) * range_step_m * (1 - 1e-12)
    first, end, reach = _core.best_sectors(ranges, sectors, inner)
    step = np.float64(2 * np.pi / bins)
    return Sectors(apex_m, np.asarray(first * step), np.asarray(end * step), reach, inner)
