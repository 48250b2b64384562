"""ETSI collective perception (TS 103 324): perception regions within the visible cells of an estimate.

Field names, units and limits are those of the ASN.1 modules CPM-PerceptionRegionContainer and ETSI-ITS-CDD
(TS 102 894-2): at most 16 radial shapes or polygon nodes in a region, at most 256 regions; 0.1 m for ranges, 0.1° for
angles, 0.01 m for coordinates. Larger requests are split into several regions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon

from viewshed import _core
from viewshed.arrays import Mask
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.polygons import (
    BINS,
    MAX_SECTORS,
    Sectors,
    blind_spot,
    bounding_box,
    deepest_point,
    free_ranges,
    mask_of_polygon,
    sectors_of_mask,
    vertices_of,
)
from viewshed.geometry import FloatArray
from viewshed.grid import BevGrid
from viewshed.io.export.crs import degrees_at
from viewshed.io.messages.cpm import MAX_BYTES, Station, encode_cpm

STATES = (
    "claimed: visible cells by the threshold (FREE, SURFACE), as far as the shapes reach; "
    "HIDDEN and UNKNOWN are never claimed and not distinguished"
)

UPER_SUFFIX = ".cpm.uper"
"""File suffix of a complete encoded message."""

MAX_IN_REGION = 16

_MAX_RANGE = 4095

_MARGIN_M = 0.0075

_PRICE_STEPS = 8

_MAX_ISLANDS = 8


def to_cpm_uper(estimate: FovEstimate, crs: str | None = None, *, sectors: int = 16, station_id: int = 0) -> bytes:
    """Encode the perception regions as one complete CPM in UPER, the encoding of the standard.

    Args:
        estimate: the estimate, with a pose and a time.
        crs: reference system of the world frame, such as ``EPSG:25832``.
        sectors: number of radial shapes in all regions together.
        station_id: id of the sender, up to 2³² - 1.

    Raises:
        ValueError: the estimate has no time or no position in a reference system, or one message is too small.
        ImportError: rasterio is not installed.
    """
    pose = estimate.world_from_level
    if crs is None or pose is None or estimate.t_ns is None:
        missing = "crs" if crs is None else "pose" if pose is None else "time"
        raise ValueError(f"a CPM must have a time, a pose and its crs, got no {missing}; give --poses and --crs")
    (longitude_deg, latitude_deg), ahead = degrees_at(crs, np.array([[0.0, 0.0], [100.0, 0.0]]), pose)
    # Headings of messages refer to true north, which differs from the north of a projected system.
    east = (ahead[0] - longitude_deg) * np.cos(np.radians(latitude_deg))
    yaw = float(np.arctan2(ahead[1] - latitude_deg, east))
    station = Station(station_id, float(latitude_deg), float(longitude_deg), yaw=yaw)
    messages = encode_cpm(station, estimate.t_ns, to_cpm(estimate, sectors)["perceptionRegionContainer"])
    if len(messages) > 1:
        raise ValueError(
            f"the regions must fit into one CPM of {MAX_BYTES} bytes, got {len(messages)}; give fewer sectors"
        )
    return messages[0]


def to_cpm(
    estimate: FovEstimate,
    sectors: int = 16,
    shape: str = "sectors",
    *,
    threshold: float | None = None,
    footprint_m: float = 0.0,
    whole_cells: bool = True,
) -> dict[str, Any]:
    """Return the perception regions (dict) of a CPM: an inner approximation of the visible area.

    Coordinates are in ``level``; the sender's reference point is its origin. A radial shape begins at its reference
    point; if the surroundings of the sensor are not visible, the shapes therefore begin at points beside them. Radial
    shapes may overlap; the region is their union. ``viewshed:share_kept`` is the fraction of the visible cells whose
    center is claimed. If nothing is visible, the list is empty; omit the container then.

    Args:
        estimate: the estimate.
        sectors: number of radial shapes or polygon nodes in all regions together.
        shape: ``sectors`` (radialShapes) or ``polygon`` (polygonal).
        threshold: minimum probability of a visible cell; None is the threshold of the estimate.
        footprint_m: cells with their center nearer to the sensor than this count as visible (own vehicle).
        whole_cells: cover no part of a cell that is not visible; False: do not cover its center, which keeps more area.

    Raises:
        ValueError: ``sectors`` is outside 4…4096, the shape is unknown, or the grid extends beyond ±327 m.
    """
    threshold = estimate.threshold if threshold is None else threshold
    if not 4 <= sectors <= 4096:
        raise ValueError(f"sectors must lie in [4, 4096], got {sectors}")
    if shape not in ("sectors", "polygon"):
        raise ValueError(f"shape must be sectors or polygon, got {shape!r}")
    grid = estimate.grid
    if max(abs(value) for value in grid.offset_m) + grid.half_extent_m > 327.0:
        raise ValueError(f"grid must lie within ±327 m, the limit of CartesianCoordinate, got {grid}")
    mask = estimate.visible(threshold) | (np.hypot(*np.moveaxis(grid.centers, -1, 0)) < footprint_m)
    if shape == "sectors":
        shapes = _radial_shapes(_fans(mask, grid, min(sectors, MAX_SECTORS), whole_cells))
    else:
        shapes = [_polygonal(polygon) for polygon in _polygons(mask, grid, sectors, whole_cells)]
    message: dict[str, Any] = {"perceptionRegionContainer": [_region(region, threshold) for region in shapes]}
    kept = claimed_by_cpm(message, grid.centers[mask]).sum() / max(1, mask.sum())
    return message | {"viewshed:share_kept": float(kept)}


def _region(shape: dict[str, Any], threshold: float) -> dict[str, Any]:
    """Return a PerceptionRegion; its shape already excludes shadows."""
    return {
        "measurementDeltaTime": 0,
        "perceptionRegionConfidence": int(np.clip(100 * threshold + 1e-6, 1, 100)),
        "perceptionRegionShape": shape,
        "shadowingApplies": False,
    }


def _fans(mask: Mask, grid: BevGrid, sectors: int, whole_cells: bool) -> list[Sectors]:
    """Return fans (``sectors`` sectors in total) that start at their apex: at the sensor, or beside its blind spot."""
    centered = sectors_of_mask(mask, grid, sectors, whole_cells=whole_cells, range_step_m=0.1)
    at_sensor = [centered] if centered.inner_m == 0.0 else []
    if _area(at_sensor) > 0.5 * mask.sum() * grid.cell_area_m2:
        return at_sensor
    x, y = grid.centers[..., 0], grid.centers[..., 1]
    splits = [[mask], [mask & (x > 0), mask & (x < 0)], [mask & (y > 0), mask & (y < 0)]]
    apex_distance_m = centered.inner_m + grid.cell_m
    # Choose the split by the area visible from its apexes at full angular resolution.
    apexes = [[_apex(part, grid, apex_distance_m, whole_cells) for part in parts] for parts in splits]
    parts, chosen = max(zip(splits, apexes, strict=True), key=lambda split: sum(score for _, score in split[1]))
    count = sectors // len(parts)
    beside_sensor = [
        sectors_of_mask(part, grid, count, apex_m=apex, whole_cells=whole_cells, range_step_m=0.1)
        for part, (apex, _) in zip(parts, chosen, strict=True)
    ]
    return max(at_sensor, beside_sensor, _fans_at_deepest_points(mask, grid, sectors, whole_cells), key=_area)


def _area(fans: list[Sectors]) -> float:
    return sum(fan.area_m2 for fan in fans)


def _fans_at_deepest_points(mask: Mask, grid: BevGrid, sectors: int, whole_cells: bool) -> list[Sectors]:
    """Return up to four fans, each at the deepest still uncovered point that the format can reference."""
    near = (np.abs(grid.centers + 10.4) < 20.4).all(axis=-1)
    uncovered, fans = mask.copy(), list[Sectors]()
    for _ in range(4):
        if (uncovered & near).any():
            apex = _rounded_cm(deepest_point(uncovered & near, grid))
            fan = sectors_of_mask(uncovered, grid, sectors // 4, apex_m=apex, whole_cells=whole_cells, range_step_m=0.1)
            fans.append(fan)
            uncovered[uncovered] = ~fan.covers(grid.centers[uncovered])
    return fans


def _apex(part: Mask, grid: BevGrid, distance_m: float, whole_cells: bool) -> tuple[tuple[float, float], float]:
    """Return the apex that sees most of ``part``, of eight around the sensor and the deepest point, and its score."""
    angles = np.arange(8) * (np.pi / 4)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1) * distance_m
    points = [_rounded_cm(point) for point in (*ring, deepest_point(part, grid)) if np.abs(point + 10.4).max() < 20.4]
    scores = [(free_ranges(part, grid, point, BINS, whole_cells=whole_cells) ** 2).sum() for point in points]
    best = int(np.argmax(scores))
    return points[best], float(scores[best])


def _rounded_cm(point: FloatArray) -> tuple[float, float]:
    x, y = np.round(np.asarray(point) * 100) / 100 + 0.0
    return float(x), float(y)


def _radial_shapes(fans: list[Sectors]) -> list[dict[str, Any]]:
    shapes = []
    for fan in fans:
        details = _details(fan)
        x, y = (round(100 * value) for value in fan.apex_m)
        for k in range(0, len(details), MAX_IN_REGION):
            radial = {"refPointId": 0, "xCoordinate": x, "yCoordinate": y}
            shapes.append({"radialShapes": radial | {"radialShapesList": details[k : k + MAX_IN_REGION]}})
    return shapes


def _details(fan: Sectors) -> list[dict[str, int]]:
    """Return RadialShapeDetails: range rounded down to 0.1 m, angles in 0.1°, counter-clockwise from x."""
    details = []
    for start, end, range_m in zip(fan.start, fan.end, fan.range_m, strict=True):
        first, last = round(np.degrees(start) * 10), round(np.degrees(end) * 10)
        if last - first >= 3600:
            last -= 1
        details.append(
            {
                "range": min(int(range_m * 10 + 1e-6), _MAX_RANGE),
                "horizontalOpeningAngleStart": first % 3600,
                "horizontalOpeningAngleEnd": last % 3600,
            }
        )
    return details


def _polygons(mask: Mask, grid: BevGrid, vertices: int, whole_cells: bool) -> list[Polygon]:
    """Return polygons without holes, of at most 16 vertices each and ``vertices`` in total, rounded to centimeters."""
    hole = blind_spot(mask, grid)
    apex = (0.0, 0.0) if hole is not None else _rounded_cm(deepest_point(mask, grid))
    filled = mask if hole is None else mask | hole
    ranges = free_ranges(filled, grid, apex, BINS, margin_m=_MARGIN_M, whole_cells=whole_cells)
    blind = bounding_box(hole, grid).buffer(_MARGIN_M, join_style="mitre") if hole is not None and hole.any() else None
    largest = max(float(mask.sum()), 1.0) * grid.cell_area_m2
    star = _largest_polygons(lambda price: _pieces(_core.star_vertices(ranges, price), apex, blind), vertices, largest)
    islands = _largest_polygons(lambda price: _islands(mask, grid, price, whole_cells), vertices, largest)
    return max(star, islands, key=_total_area)


def _largest_polygons(make: Callable[[float], list[Polygon]], vertices: int, area_m2: float) -> list[Polygon]:
    """Bisect the price of a vertex (m²); return the largest polygons with at most ``vertices`` vertices in total."""
    best, high = list[Polygon](), 4.0 * area_m2 / vertices
    low = high / 2000.0
    for _ in range(_PRICE_STEPS):
        price = float(np.sqrt(low * high))
        pieces = make(price)
        if sum(vertices_of(piece) for piece in pieces) > vertices:
            low = price
        else:
            best, high = max(best, pieces, key=_total_area), price
    return best


def _total_area(pieces: list[Polygon]) -> float:
    return sum(piece.area for piece in pieces)


def _islands(mask: Mask, grid: BevGrid, price_m2: float, whole_cells: bool) -> list[Polygon]:
    """Return star polygons, each at the deepest uncovered point, while their area exceeds their price of vertices."""
    uncovered, pieces = mask.copy(), list[Polygon]()
    for _ in range(_MAX_ISLANDS):
        apex = _rounded_cm(deepest_point(uncovered, grid))
        ranges = free_ranges(uncovered, grid, apex, BINS // 4, margin_m=_MARGIN_M, whole_cells=whole_cells)
        star = _pieces(_core.star_vertices(ranges, price_m2), apex, None)
        if sum(piece.area - price_m2 * vertices_of(piece) for piece in star) <= 0.0:
            break
        for piece in star:
            pieces.append(piece)
            uncovered &= ~mask_of_polygon(piece, grid)
    return pieces


def _pieces(star: FloatArray, apex: tuple[float, float], blind: Polygon | None) -> list[Polygon]:
    """Cut a star polygon from its apex into pieces of at most 16 vertices, and subtract the blind spot."""
    corners = np.asarray(apex) + star[:, 1:] * np.stack([np.cos(star[:, 0]), np.sin(star[:, 0])], axis=1)
    if len(corners) < 3:
        return []
    if blind is None and len(corners) <= MAX_IN_REGION:
        return [_rounded(Polygon(corners))]
    chain, angles = np.concatenate([corners, corners[:1]]), np.concatenate([star[:, 0], star[:1, 0]])
    pieces, k = list[Polygon](), 0
    while (k := k + int(angles[k] == angles[k + 1])) < len(chain) - 1:
        end = min(k + MAX_IN_REGION - 1, len(chain))
        parts = _fan(chain[k : _edge_end(angles, end)], apex, blind)
        while any(part.interiors or vertices_of(part) > MAX_IN_REGION for part in parts):
            end -= 1
            parts = _fan(chain[k : _edge_end(angles, end)], apex, blind)
        pieces, k = pieces + parts, _edge_end(angles, end) - 1
        if k == len(chain) - 1:
            break
    return pieces


def _edge_end(angles: FloatArray, end: int) -> int:
    """Return ``end``, or one less if the chain ends with an edge along a ray; that edge begins the next piece."""
    return end - int(angles[end - 1] == angles[end - 2])


def _fan(chain: FloatArray, apex: tuple[float, float], blind: Polygon | None) -> list[Polygon]:
    fan = Polygon(np.concatenate([[apex], chain]))
    cut = fan if blind is None else shapely.difference(fan, blind)
    return [_rounded(part) for part in shapely.get_parts(cut) if part.area > 0.01]


def _rounded(polygon: Polygon) -> Polygon:
    """Round a polygon to centimeters; the margin to other cells exceeds the rounding error."""
    rings = [np.round(shapely.get_coordinates(ring), 2) + 0.0 for ring in (polygon.exterior, *polygon.interiors)]
    return Polygon(rings[0], rings[1:])


def _polygonal(polygon: Polygon) -> dict[str, Any]:
    corners = np.rint(shapely.get_coordinates(polygon.exterior)[:-1] * 100).astype(int).tolist()
    return {"polygonal": {"polygon": [{"xCoordinate": x, "yCoordinate": y} for x, y in corners]}}


def claimed_by_cpm(message: dict[str, Any], xy: FloatArray) -> NDArray[np.bool_]:
    """Return the mask (…,) of points (…, 2), meters in ``level``, that lie in a perception region."""
    points = np.asarray(xy, np.float64)
    claimed = np.zeros(points.shape[:-1], np.bool_)
    for region in message["perceptionRegionContainer"]:
        ((kind, shape),) = region["perceptionRegionShape"].items()
        claimed |= _in_radial(shape, points) if kind == "radialShapes" else _in_polygon(shape, points)
    return claimed


def _in_radial(shape: dict[str, Any], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    keys = ("horizontalOpeningAngleStart", "horizontalOpeningAngleEnd", "range")
    start, end, range_dm = np.array([[details[key] for key in keys] for details in shape["radialShapesList"]]).T
    apex = (shape["xCoordinate"] / 100, shape["yCoordinate"] / 100)
    width = (end - start - 1) % 3600 + 1
    return Sectors(apex, np.radians(start / 10), np.radians((start + width) / 10), range_dm / 10).covers(points)


def _in_polygon(shape: dict[str, Any], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    polygon = Polygon([(node["xCoordinate"] / 100, node["yCoordinate"] / 100) for node in shape["polygon"]])
    inside: NDArray[np.bool_] = shapely.contains_xy(polygon, points[..., 0], points[..., 1])
    return inside
