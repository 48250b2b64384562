"""What a reader found in a file, before it is a Sweep; and the step from one to the other.

From named columns (PCD fields, PLY properties, feather columns) to Columns.

Rows of numbers in text, as ascii PCD and PLY hold them.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viewshed.geometry import Rigid
from viewshed.io._ring_numbers import matched_azimuth, matched_time_s, move_points, rings_by_elevation
from viewshed.io._source import IDENTITY, Source, is_identity
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep


@dataclass(slots=True, eq=False)
class Columns:
    """Columns of one revolution (not frozen, which costs as much as opening a file).

    Attributes:
        points: (N, 3) float32, meters, writable, in ``frame``.
        intensity: (N,) float32, or None.
        ring: (N,) beam index, 0 the lowest, or None.
        laser: (N,) beam number in the file's own order, turned into ``ring`` by elevation, or None.
        azimuth: (N,) float32 radians, counter-clockwise from x of ``frame``, or None.
        time_s: (N,) float32 seconds since the start of the sweep, or None.
        t_ns: time of the sweep in nanoseconds, or None.
        model: beams as the file describes them, or None.
        frame: what is still to be done: ``sensor_from_columns``.
        saved: the other attributes of a Sweep that this package wrote, or None.
    """

    points: NDArray[np.float32]
    intensity: NDArray[np.float32] | None = None
    ring: NDArray[np.int16] | None = None
    laser: NDArray[np.int64] | None = None
    azimuth: NDArray[np.float32] | None = None
    time_s: NDArray[np.float32] | None = None
    t_ns: int | None = None
    model: LidarModel | None = None
    frame: Rigid = IDENTITY
    saved: Saved | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Saved:
    """Attributes of a Sweep that only this package's NPZ keeps."""

    attitude: NDArray[np.float64] | None = None
    sensor_height_m: float | None = None
    world_from_sensor: Rigid | None = None
    agent: str = "ego"
    dropped_points: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """What the caller knows about a sweep; it goes before what the file says.

    Attributes:
        model: beams of the sensor, or None.
        frame: ``sensor_from_file``, or None for the format's own.
        sensor_height_m: mounting height, or None.
        attitude: quaternion (w, x, y, z) of ``level_from_sensor``, or None.
        world_from_sensor: pose, or None.
    """

    model: LidarModel | None = None
    frame: Rigid | None = None
    sensor_height_m: float | None = None
    attitude: ArrayLike | None = None
    world_from_sensor: Rigid | None = None


_NOTHING_SAVED = Saved()


def sweep_of(columns: Columns, source: Source, given: Given) -> Sweep:
    """Return the Sweep of a file's columns, in the sensor's frame.

    Raises:
        ValueError: a column is not as a Sweep needs it, or no point is finite; one line with the file's name.
    """
    points, azimuth = columns.points, columns.azimuth
    if columns.frame is not IDENTITY and not is_identity(columns.frame):
        move_points(points, columns.frame.rotation, columns.frame.translation)
        azimuth = None if azimuth is None else _turned(azimuth, columns.frame)
    model = given.model if given.model is not None else columns.model
    saved = columns.saved or _NOTHING_SAVED
    ring: NDArray[np.int16] | None = columns.ring
    try:
        if columns.laser is not None:
            ring = rings_by_elevation(columns.laser, points, model)
        sweep = Sweep(
            points, columns.intensity, ring, azimuth, columns.time_s, columns.t_ns,
            attitude=saved.attitude if given.attitude is None else np.asarray(given.attitude),
            sensor_height_m=saved.sensor_height_m if given.sensor_height_m is None else given.sensor_height_m,
            world_from_sensor=given.world_from_sensor or saved.world_from_sensor,
            model=model, agent=saved.agent, dropped_points=saved.dropped_points,
        )  # fmt: skip
    except ValueError as error:
        raise source.error(error) from error
    if len(sweep) == 0 and len(points) > 0:
        raise source.error(f"none of the {len(points)} points is finite")
    return sweep


def _turned(azimuth: NDArray[np.float32], frame: Rigid) -> NDArray[np.float32]:
    x, y = np.cos(azimuth, dtype=np.float64), np.sin(azimuth, dtype=np.float64)
    r = frame.rotation
    turned = np.arctan2(r[1, 0] * x + r[1, 1] * y, r[0, 0] * x + r[0, 1] * y)
    return np.asarray(turned, dtype=np.float32)


MARK = "viewshed sweep"
"""A comment in files that this package wrote: ring counts from the lowest beam, azimuth and time are ours."""

_INTENSITY = ("intensity", "i", "reflectivity", "reflectance", "scalar_intensity", "remission")

_RING = ("ring", "channel", "laser", "laser_id", "laser_number", "ring_id", "scalar_ring", "line")

_AZIMUTH = ("azimuth",)

_TIME = ("time", "time_s", "timestamp", "time_stamp", "t", "offset_time", "offset_ns")

WANTED = frozenset(("x", "y", "z", *_INTENSITY, *_RING, *_AZIMUTH, *_TIME))
"""Lower-case names of columns that are read; the others are skipped."""


def columns_of_table(table: Mapping[str, NDArray[Any]], frame: Rigid | None, *, ours: bool) -> Columns:
    """Return Columns from lower-case names → (N,) numbers; ``ours`` tells that this package wrote the file.

    Raises:
        ValueError: x, y or z is missing, or rings are not whole numbers.
    """
    missing = [name for name in "xyz" if name not in table]
    if missing:
        raise ValueError(f"must have columns x, y and z, {', '.join(missing)} not found among {', '.join(table)}")
    points = np.empty((len(table["x"]), 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for axis, name in enumerate("xyz"):
            points[:, axis] = table[name]
        intensity = _first(table, _INTENSITY)
        intensity = None if intensity is None else intensity.astype(np.float32)
    laser = _whole(_first(table, _RING))
    time, azimuth = _first(table, _TIME), _first(table, _AZIMUTH)
    if not ours:
        azimuth = None if azimuth is None else matched_azimuth(azimuth, points)
        time = None if time is None else matched_time_s(time)
    return Columns(
        points, intensity,
        ring=laser.astype(np.int16) if ours and laser is not None else None,
        laser=None if ours else laser,
        azimuth=azimuth, time_s=time, frame=IDENTITY if frame is None else frame,
    )  # fmt: skip


def _first(table: Mapping[str, NDArray[Any]], names: tuple[str, ...]) -> NDArray[Any] | None:
    return next((table[name] for name in names if name in table), None)


def _whole(laser: NDArray[Any] | None) -> NDArray[np.int64] | None:
    if laser is None:
        return None
    number = laser.astype(np.float64)
    if number.size and not ((number >= 0) & (number < 4096) & (number == np.floor(number))).all():
        raise ValueError("ring must be whole numbers in [0, 4096)")
    return number.astype(np.int64)


def table_of_sweep(sweep: Sweep) -> NDArray[Any]:
    """Return the sweep's columns as one little-endian structured array (N,); columns it lacks are left out."""
    columns: dict[str, tuple[str, NDArray[Any] | None]] = {
        "x": ("<f4", sweep.points[:, 0]), "y": ("<f4", sweep.points[:, 1]), "z": ("<f4", sweep.points[:, 2]),
        "intensity": ("<f4", sweep.intensity), "ring": ("<i2", sweep.ring),
        "azimuth": ("<f4", sweep.azimuth), "time": ("<f4", sweep.time_s),
    }  # fmt: skip
    present = {name: (kind, values) for name, (kind, values) in columns.items() if values is not None}
    table = np.empty(len(sweep), np.dtype([(name, kind) for name, (kind, _) in present.items()]))
    for name, (_, values) in present.items():
        table[name] = values
    return table


def number_rows(content: bytes, start: int, rows: int, width: int) -> NDArray[np.float64]:
    r"""Return (rows, width) float64 numbers from the text at ``start``.

    Raises:
        ValueError: there are fewer rows, a row has another width, or a word is not a number.

    >>> number_rows(b"1 2 nan\n", 0, 1, 3).tolist()
    [[1.0, 2.0, nan]]
    """
    if rows == 0:
        return np.empty((0, width))
    if rows * max(1, 2 * width - 1) > len(content) - start:
        raise ValueError(f"text is cut off: {rows} rows of {width} numbers need more than {len(content) - start} bytes")
    if not content[start:].strip():
        raise ValueError(f"text is cut off: {rows} rows were promised, got none")
    stream = io.TextIOWrapper(io.BytesIO(memoryview(content)[start:]), encoding="latin-1")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about empty lines, which the shape shows
        table = np.loadtxt(stream, dtype=np.float64, comments=None, max_rows=rows, ndmin=2)
    if table.shape != (rows, width):
        raise ValueError(f"text must hold {rows} rows of {width} numbers, got {table.shape[0]} of {table.shape[1]}")
    return table
