"""Convert sensor_msgs/PointCloud2 to a Sweep and back: any field layout, byte order, padding and organization."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.io._rings import matched_azimuth, matched_time_s, rings_by_elevation, valid_rings
from viewshed.sensors import LidarModel
from viewshed.sweep import MAX_POINTS, Sweep

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}

_INTENSITY = ("intensity", "i", "reflectivity", "reflectance", "signal", "remission")

_RING = ("ring", "channel", "laser_id", "ring_id", "line", "row")

_TIME = ("time", "t", "timestamp", "time_stamp", "time_offset", "offset_time")

_COLUMNS = (
    ("intensity", "f4", "intensity"),
    ("ring", "u2", "ring"),
    ("azimuth", "f4", "azimuth"),
    ("time_s", "f4", "time"),
)
"""Column of a sweep, its dtype, and its field name in a cloud."""

_NEAR_M = 3.0

_MAX_POINT_BYTES = 1 << 20


class PointField(Protocol):
    """One field of a cloud, as in the message."""

    name: str
    offset: int
    datatype: int
    count: int


class PointCloud2(Protocol):
    """The fields of the message that are read."""

    height: int
    width: int
    fields: Iterable[PointField]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: NDArray[np.uint8]


def sweep_of_cloud(cloud: PointCloud2, model: LidarModel | None = None) -> Sweep:
    """Convert a message to a sweep (N points, meters), row by row; points that are not finite are dropped.

    Intensity, ring, azimuth and time are read from fields with their usual names. Ring 0 becomes the lowest beam.
    Times become seconds since the earliest point; integers are read as nanoseconds, floats as seconds.

    Args:
        cloud: the message.
        model: beam table of the sensor if known: rings numbered from the top stay right where the lowest beam has no
            return.

    Raises:
        ValueError: x, y or z is missing, or the sizes in the message do not match its data.
    """
    table = _table(cloud)
    names = table.dtype.names or ()
    points = np.empty((table.size, 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for axis, name in enumerate("xyz"):
            points[:, axis] = table[name].reshape(-1)
    columns = {
        part: table[name].reshape(-1)
        for part, known in (("intensity", _INTENSITY), ("ring", _RING), ("time", _TIME), ("azimuth", ("azimuth",)))
        for name in known if name in names
    }  # fmt: skip
    keep = _finite_rows(points)
    dropped = table.size - keep.size
    if dropped:
        points, columns = points.take(keep, 0), {part: column.take(keep) for part, column in columns.items()}
    return _sweep(points, columns, dropped, model)


def _finite_rows(points: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the indices of finite points; 0 times inf or NaN is NaN, so one comparison tests all three coordinates."""
    with np.errstate(invalid="ignore"):
        x, y, z = points.T * np.float32(0)
        return np.flatnonzero(x + y + z == 0)


def _sweep(
    points: NDArray[np.float32], columns: Mapping[str, NDArray[Any]], dropped: int, model: LidarModel | None
) -> Sweep:
    intensity, azimuth, time = columns.get("intensity"), columns.get("azimuth"), columns.get("time")
    with np.errstate(over="ignore", invalid="ignore"):
        return Sweep(
            points,
            None if intensity is None else intensity.astype(np.float32),
            _ring(columns.get("ring"), points, model),
            None if azimuth is None else matched_azimuth(azimuth, points),
            None if time is None else matched_time_s(time),
            dropped_points=dropped,
        )


def _table(cloud: PointCloud2) -> NDArray[Any]:
    """Return the points as a structured array (height, width), a view of the message's data."""
    order = ">" if cloud.is_bigendian else "<"
    fields = {field.name.lower(): field for field in cloud.fields if field.count <= 1 and field.datatype in _TYPES}
    missing = [name for name in "xyz" if name not in fields]
    if missing:
        raise ValueError(f"a cloud must have fields x, y and z, {', '.join(missing)} not found among {list(fields)}")
    if not 0 < cloud.point_step <= _MAX_POINT_BYTES or cloud.width * cloud.height > MAX_POINTS:
        size = f"{cloud.height} × {cloud.width} points of {cloud.point_step} bytes"
        raise ValueError(f"a cloud must have at most {MAX_POINTS} points of 1 to {_MAX_POINT_BYTES} bytes, got {size}")
    for name, field in fields.items():
        if field.offset + np.dtype(_TYPES[field.datatype]).itemsize > cloud.point_step:
            raise ValueError(f"field {name!r} at byte {field.offset} leaves a point of {cloud.point_step} bytes")
    kind = np.dtype({
        "names": list(fields),
        "formats": [order + _TYPES[field.datatype] for field in fields.values()],
        "offsets": [field.offset for field in fields.values()],
        "itemsize": cloud.point_step,
    })  # fmt: skip
    data = np.ascontiguousarray(cloud.data, np.uint8)
    row_step = cloud.row_step if cloud.height > 1 else cloud.width * cloud.point_step
    needed = 0 if cloud.width * cloud.height == 0 else (cloud.height - 1) * row_step + cloud.width * cloud.point_step
    if row_step < cloud.width * cloud.point_step or data.size < needed:
        rows = f"{cloud.height} rows of {cloud.width} points of {cloud.point_step} bytes every {row_step}"
        raise ValueError(f"a cloud is cut off: {rows} need {needed} bytes, the message holds {data.size}")
    return np.ndarray((cloud.height, cloud.width), kind, data, strides=(row_step, cloud.point_step))


def _ring(
    laser: NDArray[Any] | None, points: NDArray[np.float32], model: LidarModel | None
) -> NDArray[np.int16] | None:
    """Return the ring (N,), 0 the lowest, of a field with beams in any order; None if its values are invalid."""
    if laser is None:
        return None
    number = valid_rings(laser)
    if number is None:
        return None
    if number.size == 0:
        return number.astype(np.int16)
    order = _order(number, points)
    if order == 0:
        return rings_by_elevation(number, points, model)
    highest = max(number.max(), 0 if model is None else model.rings - 1)
    return (number if order > 0 else highest - number).astype(np.int16)


def _order(laser: NDArray[np.int64], points: NDArray[np.float32]) -> int:
    """Return +1 if the mean slope of the beams ascends with their number, -1 if it descends, 0 if neither.

    Nearly every driver uses one of these orders. Near returns (of the own vehicle, or noise) are ignored.
    """
    x, y, z = points.T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        range_m = np.sqrt(x * x + y * y)
        slope = z / range_m
    usable = np.flatnonzero((range_m > _NEAR_M) & np.isfinite(slope))
    laser, slope = laser.take(usable), slope.take(usable)
    count = np.bincount(laser)
    rising = np.diff(np.bincount(laser, slope)[count > 0] / count[count > 0])
    return int((rising > 0).all()) - int((rising < 0).all())


def cloud_table(sweep: Sweep) -> NDArray[Any]:
    """Return the points and columns of a sweep as a packed structured array (N,)."""
    columns = [(field, form, getattr(sweep, name)) for name, form, field in _COLUMNS]
    columns = [(field, form, column) for field, form, column in columns if column is not None]
    kinds = [*((axis, "<f4") for axis in "xyz"), *((field, f"<{form}") for field, form, _ in columns)]
    table = np.empty(len(sweep), kinds)
    for axis, name in enumerate("xyz"):
        table[name] = sweep.points[:, axis]
    for field, _, column in columns:
        table[field] = column
    return table
