"""Masks to polygons and back: exact to the cells' edges, or simpler and never outside the mask.

Polygons are in meters of the ``level`` frame; cell (i, j) spans x (forward) by i and y (left) by j.

Rings from cells and cells from rings: the compiled part of :mod:`viewshed.fov.polygons`, in units of cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray
from shapely import GeometryType, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from viewshed.fov._mask_regions import label_regions, squared_depth
from viewshed.fov._sector_polygons import best_sectors
from viewshed.fov._star_polygons import free_ranges, star_vertices
from viewshed.geometry import FloatArray
from viewshed.grid import BevGrid


@njit(cache=True, nogil=True)
def trace(padded: Any, labels: Any) -> Any:  # pragma: no cover - compiled
    """Return corners (V, 2), ring starts (R+1,) and each ring's component (R,), negative where it is a hole.

    Walks the cells' edges with the mask on the left and turns left first, so that diagonal cells stay apart;
    a loop is cut off where the walk meets its own corner again. ``padded`` has a border of zeros.
    """
    n = padded.shape[0] - 2
    done = np.zeros((n + 1, n + 1), np.uint8)
    at = np.full((n + 1, n + 1), -1, np.int32)
    size = _corners(padded)
    out, stack = np.empty((size, 2), np.int16), np.empty((size + 1, 3), np.int16)
    starts, ring_labels = np.empty(size // 4 + 1, np.int64), np.empty(size // 4, np.int32)
    used = rings = 0
    for i0 in range(n):
        for j0 in range(n):
            if done[i0, j0] or not _starts(padded, i0, j0):
                continue
            i, j, heading, depth = i0, j0, 0, 0
            while True:
                if at[i, j] >= 0:
                    starts[rings], bottom = used, at[i, j]
                    ring_labels[rings] = _signed_label(stack, bottom, depth, labels)
                    used = _cut_off(stack, bottom, depth, at, out, used)
                    rings, depth = rings + 1, bottom
                    if depth == 0 and i == i0 and j == j0 and heading == 0:
                        break
                at[i, j] = depth
                stack[depth, 0], stack[depth, 1], stack[depth, 2] = i, j, heading
                depth += 1
                if heading == 0:
                    done[i, j] = 1
                i, j, heading = _next_corner(padded, i, j, heading)
    starts[rings] = used
    return out[:used], starts[: rings + 1], ring_labels[:rings]


@njit(cache=True, nogil=True)
def _cut_off(stack: Any, bottom: int, top: int, at: Any, out: Any, used: int) -> int:  # pragma: no cover - compiled
    """Copy a loop to ``out``, forget that its corners were met, and return how much of ``out`` is used."""
    for k in range(bottom, top):
        out[used] = stack[k, :2]
        at[stack[k, 0], stack[k, 1]] = -1
        used += 1
    return used


@njit(cache=True, nogil=True)
def _corners(padded: Any) -> int:  # pragma: no cover - compiled
    """Return how many corners all rings have: one where an odd count of cells meets, two at a diagonal contact."""
    total = 0
    for i in range(padded.shape[0] - 1):
        for j in range(padded.shape[1] - 1):
            a, b, c, d = padded[i, j], padded[i + 1, j], padded[i, j + 1], padded[i + 1, j + 1]
            if (a ^ b ^ c ^ d) == 1:
                total += 1
            elif a == d and b == c and a != b:
                total += 2
    return total


@njit(cache=True, nogil=True)
def _starts(padded: Any, i: int, j: int) -> bool:  # pragma: no cover - compiled
    """Return whether an edge along +i begins, after a turn, at lattice point (i, j)."""
    here = padded[i + 1, j + 1] and not padded[i + 1, j]
    before = padded[i, j + 1] and not padded[i, j]
    return bool(here and not before)


@njit(cache=True, nogil=True)
def _next_corner(padded: Any, i: int, j: int, heading: int) -> Any:  # pragma: no cover - compiled
    """Return the corner (i, j) where the edge that leaves a corner by ``heading`` ends, and the next heading.

    Headings 0…3 are +i, +j, -i, -j; the mask lies on the left.
    """
    di, dj = (1, 0, -1, 0)[heading], (0, 1, 0, -1)[heading]
    ahead_i, ahead_j = (1, 0, 0, 1)[heading], (1, 1, 0, 0)[heading]
    right_i, right_j = (1, 1, 0, 0)[heading], (0, 1, 1, 0)[heading]
    while True:
        i, j = i + di, j + dj
        if not padded[i + ahead_i, j + ahead_j]:
            return i, j, (heading + 1) % 4
        if padded[i + right_i, j + right_j]:
            return i, j, (heading + 3) % 4


@njit(cache=True, nogil=True)
def _signed_label(stack: Any, bottom: int, top: int, labels: Any) -> int:  # pragma: no cover - compiled
    """Return the component of the cell left of a loop's first edge, negative where the loop runs clockwise."""
    doubled_area = 0
    for k in range(bottom, top):
        m = k + 1 if k + 1 < top else bottom
        doubled_area += np.int64(stack[k, 0]) * stack[m, 1] - np.int64(stack[m, 0]) * stack[k, 1]
    i, j, heading = stack[bottom, 0], stack[bottom, 1], stack[bottom, 2]
    left_i, left_j = (0, -1, -1, 0)[heading], (0, 0, -1, -1)[heading]
    label = labels[i + left_i, j + left_j]
    return int(label if doubled_area > 0 else -label)


@njit(cache=True, nogil=True)
def flip(ring: Any, flips: Any) -> None:  # pragma: no cover - compiled
    """Flip, in each row of centers that an edge crosses, the first center at or beyond the crossing (even-odd rule)."""
    cells = flips.shape[0]
    for k in range(len(ring) - 1):
        (x0, y0), (x1, y1) = ring[k], ring[k + 1]
        low, high = min(x0, x1), max(x0, x1)
        for i in range(max(int(np.ceil(low)), 0), min(int(np.ceil(high)), cells)):
            j = max(int(np.ceil(y0 + (i - x0) * (y1 - y0) / (x1 - x0))), 0)
            if j < cells:
                flips[i, j] = not flips[i, j]


@njit(cache=True, nogil=True)
def touch(ring: Any, touched: Any) -> None:  # pragma: no cover - compiled
    """Mark every cell that an edge of ``ring`` (cell (i, j) spans [i, i+1]) passes through or merely meets."""
    cells = touched.shape[0]
    for k in range(len(ring) - 1):
        (x0, y0), (x1, y1) = (ring[k], ring[k + 1]) if ring[k, 0] <= ring[k + 1, 0] else (ring[k + 1], ring[k])
        slope = (y1 - y0) / (x1 - x0) if x1 > x0 else 0.0
        for i in range(max(int(np.floor(x0 - 1e-9)), 0), min(int(np.floor(x1 + 1e-9)) + 1, cells)):
            a = y0 + (max(x0, float(i)) - x0) * slope
            b = y0 + (min(x1, i + 1.0) - x0) * slope if x1 > x0 else y1
            low, high = int(np.floor(min(a, b) - 1e-9)), int(np.floor(max(a, b) + 1e-9))
            touched[i, max(low, 0) : max(high + 1, 0)] = True


BoolMask = NDArray[np.bool_]

BINS = 720
"""Directions that the vertices of inner polygons are chosen from: half a degree each."""

SECTOR_BINS = 1800
"""Directions that up to 64 sectors are made of, 0.2° each: whole numbers of the 0.1° of ETSI messages. More sectors
are made of half as many."""

MAX_SECTORS = 256
"""The most sectors that are chosen together."""

_MAX_PIECES = 8

_PRICE_STEPS, _PRICE_SPAN = 7, 500.0


def checked_mask(mask: BoolMask, grid: BevGrid) -> BoolMask:
    """Return ``mask`` as a contiguous bool array, or raise ValueError where its shape or type is wrong."""
    array = np.asarray(mask)
    if array.shape != grid.shape or array.dtype != np.bool_:
        raise ValueError(f"mask must be bool of the grid's shape {grid.shape}, got {array.dtype} {array.shape}")
    return np.ascontiguousarray(array)


def polygon_of_mask(mask: BoolMask, grid: BevGrid) -> MultiPolygon:
    """Return the true cells of ``mask`` (cells, cells) as a valid polygon with holes, in meters.

    Exact to the cells' edges; vertices stand at corners only. Cells that meet at a corner alone are separate.

    >>> polygon_of_mask(np.eye(2, dtype=bool), BevGrid(2, 1.0)).area
    2.0
    """
    array = checked_mask(mask, grid)
    if not array.any():
        return MultiPolygon()
    vertices, starts, ring_labels = trace(np.pad(array, 1).view(np.uint8), label_regions(array))
    vertices, rings, owners = _grouped(vertices, starts, ring_labels)
    coords = np.asarray(grid.origin_m) + vertices * grid.cell_m
    return MultiPolygon(
        shapely.from_ragged_array(GeometryType.MULTIPOLYGON, coords, (rings, owners, np.array([0, len(owners) - 1])))[0]
    )


def _grouped(
    vertices: NDArray[np.int16], starts: NDArray[np.int64], labels: NDArray[np.int32]
) -> tuple[NDArray[np.int16], NDArray[np.int64], NDArray[np.int64]]:
    """Return closed rings ordered by component, the shell first: vertices, ring offsets, polygon offsets."""
    counts = np.diff(starts)
    order = np.lexsort((labels < 0, np.abs(labels)))
    rings = np.concatenate([[0], np.cumsum(counts[order] + 1)])
    within = np.arange(rings[-1]) - np.repeat(rings[:-1], counts[order] + 1)
    rows = np.repeat(starts[:-1][order], counts[order] + 1) + within % np.repeat(counts[order], counts[order] + 1)
    owners = np.concatenate([np.flatnonzero(labels[order] > 0), [len(order)]])
    return vertices[rows], rings, owners


def mask_of_polygon(polygon: BaseGeometry, grid: BevGrid) -> BoolMask:
    """Return the mask (cells, cells) of cells whose center lies inside ``polygon`` (meters, holes respected).

    A center exactly on the outline counts where the outline is the shape's lower x or lower y side.

    >>> int(mask_of_polygon(shapely.box(-1, -1, 1, 0), BevGrid(4, 2.0)).sum())
    2
    """
    if polygon.geom_type not in ("Polygon", "MultiPolygon"):
        raise ValueError(f"polygon must be a Polygon or MultiPolygon, got {polygon.geom_type}")
    flips = np.zeros(grid.shape, np.bool_)
    for ring in _rings_in_cells(polygon, grid):
        flip(ring - 0.5, flips)
    mask: BoolMask = np.logical_xor.accumulate(flips, axis=1)
    return mask


def _rings_in_cells(polygon: BaseGeometry, grid: BevGrid) -> list[NDArray[np.float64]]:
    rings = shapely.get_rings(shapely.get_parts(polygon))
    coords, owner = shapely.get_coordinates(rings, return_index=True)
    scaled = (coords - grid.origin_m) / grid.cell_m
    return np.split(scaled, np.flatnonzero(np.diff(owner)) + 1) if len(rings) else []


def vertices_of(polygon: BaseGeometry) -> int:
    """Return the number of vertices of all rings; the one that closes a ring is not counted twice.

    >>> vertices_of(shapely.box(0, 0, 1, 1))
    4
    """
    rings = shapely.get_rings(shapely.get_parts(polygon))
    return int(shapely.get_num_coordinates(rings).sum()) - len(rings)


def inner_polygon_of_mask(mask: BoolMask, grid: BevGrid, max_vertices: int) -> MultiPolygon:
    """Return a polygon of at most ``max_vertices`` vertices that lies within the true cells of ``mask``.

    The exact outline where that has few enough vertices. Otherwise star polygons, each with the greatest area for its
    vertices: one about the sensor, with a hole where the sensor's own surroundings are not seen, then others in what
    is left. A price per vertex, found by bisection, shares them out: at area / ``max_vertices`` no more than that many
    can be worth it. A heuristic, not the optimum.

    Raises:
        ValueError: fewer than three vertices, or a mask that is not the grid's.
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
        found = _inner_pieces(array, grid, price)
        if vertices_of(found) > max_vertices:
            low = price
            continue
        high = price
        best = max(best, found, key=lambda shape: shape.area)
    return best


def _inner_pieces(mask: BoolMask, grid: BevGrid, price_m2: float) -> MultiPolygon:
    """Return star polygons inside ``mask``, apart from each other, as long as one is worth its vertices' price."""
    left, pieces = mask.copy(), list[Polygon]()
    for _ in range(_MAX_PIECES):
        piece, spent = _best_star(left, grid, price_m2, about_sensor=not pieces)
        if piece.area - price_m2 * vertices_of(piece) <= 0.0:
            break
        pieces.extend(part for part in shapely.get_parts(piece) if isinstance(part, Polygon))
        left &= ~spent
    return MultiPolygon(pieces)


def _best_star(mask: BoolMask, grid: BevGrid, price_m2: float, about_sensor: bool) -> tuple[BaseGeometry, BoolMask]:
    """Return the star polygon that pays most, about the sensor or the deepest cell, and the cells it uses up."""
    deepest = deepest_point(mask, grid)
    candidates = [_star_about(mask, grid, (float(deepest[0]), float(deepest[1])), price_m2, None)]
    hole = blind_spot(mask, grid) if about_sensor else None
    if hole is not None:
        candidates.append(_star_about(mask | hole, grid, (0.0, 0.0), price_m2, hole))
    star = max(candidates, key=lambda shape: shape.area - price_m2 * vertices_of(shape))
    spent = mask_of_polygon(star, grid) if not star.is_empty else np.zeros_like(mask)
    for ring in _rings_in_cells(star, grid):
        touch(ring, spent)
    return star, spent


def _star_about(
    mask: BoolMask, grid: BevGrid, apex_m: tuple[float, float], price_m2: float, hole: BoolMask | None
) -> BaseGeometry:
    bins = min(BINS, 48 + 3 * grid.cells // 16 * 16)
    bins = bins if hole is not None else bins // 4
    vertices = star_vertices(free_ranges(mask, grid, apex_m, bins), price_m2)
    if len(vertices) < 3:
        return MultiPolygon()
    angle, radius = vertices.T
    star = Polygon(np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius[:, None] + apex_m)
    return star if hole is None or not hole.any() else shapely.difference(star, bounding_box(hole, grid))


def deepest_point(mask: BoolMask, grid: BevGrid) -> NDArray[np.float64]:
    """Return (2,) meters: the center of the true cell of ``mask`` that lies farthest from any other."""
    deepest = np.unravel_index(int(np.argmax(squared_depth(mask))), mask.shape)
    center: NDArray[np.float64] = grid.centers[deepest]
    return center


def bounding_box(hole: BoolMask, grid: BevGrid) -> Polygon:
    """Return the smallest upright rectangle around the true cells of ``hole``, at least one, in meters."""
    low, high = np.argwhere(hole).min(axis=0), np.argwhere(hole).max(axis=0) + 1
    corners = np.asarray(grid.origin_m) + np.stack([low, high]) * grid.cell_m
    box: Polygon = shapely.box(*corners[0], *corners[1])
    return box


def blind_spot(mask: BoolMask, grid: BevGrid) -> BoolMask | None:
    """Return the cells (cells, cells) of the hole in ``mask`` that the sensor stands in, all False where there is none.

    None where the sensor is not surrounded by true cells, or not on the grid.
    """
    nudges = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) * grid.cell_m * 1e-6
    cells, inside = grid.index(nudges)
    if not inside.all():
        return None
    labels = label_regions(np.pad(~mask, 1, constant_values=True), diagonal=True)
    around = labels[1:-1, 1:-1]
    own = np.unique(around[cells[:, 0], cells[:, 1]])
    if labels[0, 0] in own:
        return None
    hole: BoolMask = np.isin(around, own[own > 0])
    return hole


@dataclass(frozen=True, slots=True, eq=False)
class Sectors:
    """Sectors of rings about one point: K angles and ranges. They may lie upon one another; what counts is their union.

    Attributes:
        apex_m: (x, y) of the point in ``level``, in meters.
        start: (K,) radians in [0, 2π), counter-clockwise from x, ascending.
        end: (K,) radians, larger than ``start``.
        range_m: (K,) outer range in meters.
        inner_m: inner range of all sectors in meters; 0 where they reach the point.
    """

    apex_m: tuple[float, float]
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    range_m: NDArray[np.float64]
    inner_m: float = 0.0

    @property
    def area_m2(self) -> float:
        """Area of the union of the sectors in square meters."""
        turn = 2 * np.pi
        borders = np.unique(np.concatenate([[0.0, turn], self.start % turn, self.end % turn]))
        middle = 0.5 * (borders[1:, None] + borders[:-1, None])
        within = (middle - self.start) % turn < self.end - self.start
        reach = np.where(within, self.range_m, self.inner_m).max(axis=1, initial=self.inner_m)
        return float(0.5 * ((reach**2 - self.inner_m**2) * np.diff(borders)).sum())

    def covers(self, xy: FloatArray) -> BoolMask:
        """Return whether each of the points (…, 2) lies in a sector (…,)."""
        x, y = np.asarray(xy)[..., 0] - self.apex_m[0], np.asarray(xy)[..., 1] - self.apex_m[1]
        radius, angle = np.hypot(x, y)[..., None], np.arctan2(y, x)[..., None]
        within = (angle - self.start) % (2 * np.pi) < self.end - self.start
        covered: BoolMask = (within & (radius >= self.inner_m) & (radius < self.range_m)).any(axis=-1)
        return covered


def sectors_of_mask(
    mask: BoolMask,
    grid: BevGrid,
    sectors: int,
    *,
    apex_m: tuple[float, float] = (0.0, 0.0),
    whole_cells: bool = True,
    range_step_m: float = 0.0,
) -> Sectors:
    """Return at most ``sectors`` sectors about ``apex_m``, whose union is the largest that stays in ``mask``.

    With ``whole_cells`` they cover no part of another cell; without, no other cell's center. Ranges are rounded down
    to ``range_step_m``. About a sensor that stands in a blind spot they begin beyond it (``inner_m``).

    Raises:
        ValueError: no sector is allowed, or the mask is not the grid's.
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
    first, end, reach = best_sectors(ranges, sectors, inner)
    step = np.float64(2 * np.pi / bins)
    return Sectors(apex_m, np.asarray(first * step), np.asarray(end * step), reach, inner)
