"""Polygons in few bytes: whole steps from corner to corner, as numbers of seven bits a byte.

A code is a row of whole numbers: the step in millimeters, how many polygons there are, how many rings each has (the
shell first), how many corners each ring has, and then x and y of each corner as the difference to the corner before.
The first corner of a ring follows the first of the ring before. Differences are zigzag coded (0, -1, 1, -2 …). Each
number takes seven bits a byte, the lowest first; the top bit of a byte says that more follow.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import GeometryType, MultiPolygon

from viewshed.arrays import Mask
from viewshed.fov.polygons import claims_only, inner_polygon_of_mask
from viewshed.grid import BevGrid

MAX_BYTES = 1100
"""The most bytes of the code of an inner polygon."""

MAX_POLYGONS = 64
MAX_RINGS = 256

_FARTHEST_M = 10_000.0

# A cell has this number of steps, and corners stay this number of steps inside.
_STEPS_PER_CELL, _MARGIN_STEPS = 8, 1.5

# Bytes a corner at first, by which the number of corners is chosen; then by what they took.
_BYTES_PER_CORNER = 2.5
_TRIES = 4


def encode_inner_polygon(mask: Mask, grid: BevGrid, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the code of a polygon that lies within the true cells of ``mask`` (cells, cells), also when decoded.

    The polygon is that of :func:`viewshed.fov.polygons.inner_polygon_of_mask` with as many corners as fit, drawn in by
    a margin, so that rounding to steps of an eighth of a cell claims no other cell. A mask without a place wide enough
    gives a code of no polygon. Takes about a second.

    Raises:
        ValueError: fewer than 64 bytes, or a mask that is not the grid's.
    """
    if max_bytes < 64:
        raise ValueError(f"max_bytes must be at least 64, got {max_bytes}")
    step_m = max(1, int(1000 * grid.cell_m / _STEPS_PER_CELL)) / 1000
    corners = int(max_bytes / _BYTES_PER_CORNER)
    for _ in range(_TRIES):
        inner = inner_polygon_of_mask(mask, grid, max(corners, 3))
        drawn_in = inner.buffer(-_MARGIN_STEPS * step_m, join_style="mitre")
        code = encode_polygon(_polygons_of(shapely.set_precision(drawn_in, step_m)), step_m)
        if len(code) <= max_bytes and claims_only(decode_polygon(code), mask, grid):
            return code
        corners = int(0.95 * corners * min(1.0, max_bytes / len(code)))
    return encode_polygon(MultiPolygon(), step_m)


def _polygons_of(shape: shapely.Geometry) -> MultiPolygon:
    """Return the polygons of what is left of a shape, at most :data:`MAX_POLYGONS`, the largest."""
    parts = [part for part in shapely.get_parts(shape) if part.geom_type == "Polygon" and part.area > 0.0]
    return MultiPolygon(sorted(parts, key=lambda part: -part.area)[:MAX_POLYGONS])


def encode_polygon(polygon: MultiPolygon, step_m: float) -> bytes:
    """Return the code of polygons, corners rounded to whole steps of ``step_m``, which is rounded to millimeters."""
    step_mm = max(1, round(1000 * step_m))
    parts = shapely.get_parts(polygon)
    rings = [ring for part in parts for ring in (part.exterior, *part.interiors)]
    counts = [1 + len(part.interiors) for part in parts]
    corners = [np.rint(shapely.get_coordinates(ring)[:-1] * (1000 / step_mm)).astype(np.int64) for ring in rings]
    # Each ring begins from where the ring before began.
    from_m = [np.zeros(2, np.int64), *(ring[0] for ring in corners)]
    steps = [np.diff(ring, axis=0, prepend=start[None]) for ring, start in zip(corners, from_m[:-1], strict=True)]
    differences = np.concatenate([np.zeros((0, 2), np.int64), *steps]).ravel()
    zigzag = np.where(differences < 0, -2 * differences - 1, 2 * differences)
    head = [step_mm, len(parts), *counts, *map(len, corners)]
    return _pack(np.concatenate([np.array(head, np.int64), zigzag]))


def decode_polygon(code: bytes) -> MultiPolygon:
    """Return the polygons of a code, in meters.

    Raises:
        ValueError: the bytes are no code, or what they say is no valid polygon within 10 km.
    """
    numbers = _unpack(code)
    head = [int(number) for number in numbers[:2]]
    if len(head) < 2 or head[0] < 1 or head[1] > MAX_POLYGONS:
        raise ValueError("the code of a polygon must begin with a step and at most 64 polygons")
    step_m, polygons = head[0] / 1000, head[1]
    rings = numbers[2 : 2 + polygons]
    if len(rings) < polygons or (rings < 1).any() or (rings > MAX_RINGS).any() or rings.sum() > MAX_RINGS:
        raise ValueError("each polygon of a code must have one ring at least, and all together at most 256")
    corners = numbers[2 + polygons : 2 + polygons + int(rings.sum())]
    zigzag = numbers[2 + polygons + int(rings.sum()) :]
    if (
        len(corners) < rings.sum()
        or (corners < 3).any()
        or (corners > len(numbers)).any()
        or 2 * int(corners.sum()) != len(zigzag)
    ):
        raise ValueError("the rings of a code must have three corners at least, and as many as follow")
    if polygons == 0:
        return MultiPolygon()
    steps = np.where(zigzag % 2 == 1, -(zigzag + 1) // 2, zigzag // 2).reshape(-1, 2)
    begin = np.concatenate([[0], np.cumsum(corners)])
    firsts = np.cumsum(steps[begin[:-1]], axis=0)
    along = np.cumsum(steps, axis=0)
    points = along - np.repeat(along[begin[:-1]] - firsts, corners, axis=0)
    points_m = points * step_m
    if not (np.abs(points_m) <= _FARTHEST_M).all():
        raise ValueError("the corners of a polygon must lie within 10 km")
    # Close the rings: the first corner follows the last.
    order = np.concatenate([np.append(np.arange(a, b), a) for a, b in pairwise(begin)])
    offsets = np.concatenate([[0], np.cumsum(corners + 1)])
    owners = np.concatenate([[0], np.cumsum(rings)])
    shape: MultiPolygon = shapely.from_ragged_array(
        GeometryType.MULTIPOLYGON, points_m[order], (offsets, owners, np.array([0, polygons]))
    )[0]
    if not shape.is_valid:
        raise ValueError("the polygons of a code must be valid")
    return shape


def _pack(numbers: NDArray[np.int64]) -> bytes:
    """Return whole numbers that are not negative as seven bits a byte, the lowest first."""
    digits = (numbers[:, None] >> (7 * np.arange(5))) & 127
    more = (numbers[:, None] >> (7 * np.arange(1, 6))) > 0
    kept = np.concatenate([np.ones((len(numbers), 1), np.bool_), more[:, :-1]], axis=1)
    packed: bytes = (digits | (more << 7)).astype(np.uint8)[kept].tobytes()
    return packed


def _unpack(code: bytes) -> NDArray[np.int64]:
    data = np.frombuffer(code, np.uint8).astype(np.int64)
    ends = np.flatnonzero(data < 128)
    if len(data) == 0 or data[-1] >= 128:
        raise ValueError("the code of a polygon must end with a whole number")
    begins = np.concatenate([[0], ends[:-1] + 1])
    lengths = ends - begins + 1
    if lengths.max() > 5:
        raise ValueError("numbers in the code of a polygon must have at most 5 bytes")
    within = np.arange(len(data)) - np.repeat(begins, lengths)
    unpacked: NDArray[np.int64] = np.add.reduceat((data & 127) << (7 * within), begins)
    return unpacked
