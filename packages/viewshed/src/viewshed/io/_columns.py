"""Build a Sweep from the columns of a file: column names, frames, and parsing of numeric text."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.geometry import Rigid
from viewshed.io._input import InputFile
from viewshed.io._rings import (
    instant_ns,
    matched_azimuth,
    matched_time_s,
    problem_of_rings,
    rings_by_elevation,
    valid_rings,
)
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

FILE_FRAMES: dict[str, Rigid] = {
    "sensor": Rigid.identity(),
    "nuscenes": Rigid(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3)),
    "carla": Rigid(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.zeros(3)),
    "argoverse2": Rigid(np.eye(3), np.array([-1.35018, 0.0, -1.64042])),
    "pandaset": Rigid(np.eye(3), np.array([0.0, 0.0, -1.8])),
}
"""Name → ``sensor_from_file``, the transform from the frame of a file to the sensor's (x forward, y left, z up).

sensor: identity. nuscenes: x right, y forward. carla: raw files of CARLA ≤ 0.9.9, x right, y backward, z down.
argoverse2: the car's frame (rear axle) → its ``up_lidar``. pandaset: the car's frame → a sensor 1.8 m above its origin
(inferred from the innermost ring, not documented by the data set).
"""


class Assumption(UserWarning):
    """Warns of an assumption that the reader made because the file does not state the value; not an error."""


def file_frame_named(frame: str | Rigid) -> Rigid:
    """Return the ``sensor_from_file`` of a name in :data:`FILE_FRAMES`; a Rigid is returned unchanged.

    >>> (file_frame_named("nuscenes") @ np.array([0.0, 5.0, 0.0])).tolist()
    [5.0, 0.0, 0.0]
    """
    if isinstance(frame, Rigid):
        return frame
    if frame not in FILE_FRAMES:
        raise ValueError(f"file_frame must be one of {', '.join(FILE_FRAMES)} or a Rigid, got {frame!r}")
    return FILE_FRAMES[frame]


def is_identity(frame: Rigid) -> bool:
    """Return whether a transform is exactly the identity."""
    return bool((frame.rotation == np.eye(3)).all() and not frame.translation.any())


IDENTITY = FILE_FRAMES["sensor"]


@dataclass(slots=True, eq=False)
class Columns:
    """Columns of one revolution; not frozen because that would cost as much time as opening a file."""

    points: NDArray[np.float32]  # (N, 3) float32, meters, writable, in ``frame``
    intensity: NDArray[np.float32] | None = None  # (N,) float32, or None
    ring: NDArray[Any] | None = None  # (N,) beam index, 0 the lowest, or None
    # (N,) beam number in the file's own order, converted to ``ring`` by elevation, or None
    laser: NDArray[np.int64] | None = None
    azimuth: NDArray[np.float32] | None = None  # (N,) float32 radians, counter-clockwise from x of ``frame``, or None
    time_s: NDArray[np.float32] | None = None  # (N,) float32 seconds since the start of the sweep, or None
    t_ns: int | None = None  # time of the sweep in nanoseconds, or None
    model: LidarModel | None = None  # beam table stated by the file, or None
    frame: Rigid = IDENTITY  # ``sensor_from_columns``, still to be applied
    saved: Mapping[str, Any] | None = None  # other Sweep attributes, in files written by this package, or None
    left_out: tuple[str, ...] = ()  # one warning for each column that was dropped as invalid


def sweep_of(columns: Columns, source: InputFile, model: LidarModel | None, given: Mapping[str, Any]) -> Sweep:
    """Build the Sweep of a file's columns in the sensor's frame; warn of each dropped column.

    Args:
        columns: the columns of the file.
        source: the file.
        model: beam table of the sensor, if the caller knows it.
        given: other sweep attributes from the caller; they override those in the file.
    """
    points, azimuth, known = columns.points, columns.azimuth, {**(columns.saved or {}), **given}
    if columns.frame is not IDENTITY and not is_identity(columns.frame):
        if known.get("planar") is not None:
            raise ValueError(
                "file_frame must be left out for a scan in one plane, which lies in the sensor's own frame"
            )
        _core.move_points(points, columns.frame.rotation, columns.frame.translation)
        azimuth = None if azimuth is None else _rotated(azimuth, columns.frame)
    model = columns.model if model is None else model
    left_out = columns.left_out
    ring = columns.ring if columns.laser is None else rings_by_elevation(columns.laser, points, model)
    # Rings decoded from packets are trusted; a ring column of a file may hold anything, so it is checked.
    is_column = ring is not None and columns.model is None and ring.dtype.kind in "iu"
    problem = problem_of_rings(ring, points) if is_column and ring is not None else None
    if problem is not None:
        ring, left_out = None, (*left_out, f"ring is left out: {problem}")
    if "world_from_sensor" in given:
        known.pop("pose_covariance", None)
    sweep = Sweep(points, columns.intensity, ring, azimuth, columns.time_s, columns.t_ns, model=model, **known)
    if len(sweep) == 0 and len(points) > 0:
        raise ValueError(f"none of the {len(points)} points is finite")
    for line in left_out:
        warnings.warn(f"{source.path}: {line}", stacklevel=2)
    return sweep


def _rotated(azimuth: NDArray[np.float32], frame: Rigid) -> NDArray[np.float32]:
    x, y = np.cos(azimuth, dtype=np.float64), np.sin(azimuth, dtype=np.float64)
    r = frame.rotation
    turned = np.arctan2(r[1, 0] * x + r[1, 1] * y, r[0, 0] * x + r[0, 1] * y)
    return np.asarray(turned, dtype=np.float32)


MARK = "viewshed sweep"
"""Comment in files written by this package: ring 0 is the lowest beam, azimuth and time use our conventions."""

_INTENSITY = ("intensity", "i", "reflectivity", "reflectance", "scalar_intensity", "remission")

_RING = ("ring", "channel", "laser", "laser_id", "laser_number", "ring_id", "scalar_ring", "line")

_AZIMUTH = ("azimuth",)

_TIME = ("time", "time_s", "timestamp", "time_stamp", "t", "offset_time", "offset_ns")

KNOWN_COLUMNS = frozenset(("x", "y", "z", *_INTENSITY, *_RING, *_AZIMUTH, *_TIME))
"""Lower-case names of columns that are read; others are skipped."""

_FLOAT32_LIMIT_M = 10_000.0
"""Beyond this distance the spacing of float32 is about a millimeter or more."""


def near_points(axes: Sequence[NDArray[Any]], frame: Rigid) -> tuple[NDArray[np.float32], Rigid]:
    """Stack x, y, z (N,) to float32 points (N, 3); return them and the ``sensor_from_file`` still to apply.

    A frame that is only a large translation (map coordinates) is applied in float64, before rounding to float32.

    >>> place = Rigid(np.eye(3), np.array([0.0, -5_930_000.0, 0.0]))
    >>> near_points([np.array([1.0]), np.array([5_930_000.125]), np.array([0.0])], place)[0].tolist()
    [[1.0, 0.125, 0.0]]
    """
    points = np.empty((len(axes[0]), 3), np.float32)
    is_far = bool(np.abs(frame.translation).max() > _FLOAT32_LIMIT_M and (frame.rotation == np.eye(3)).all())
    with np.errstate(over="ignore", invalid="ignore"):
        for axis, values in enumerate(axes):
            points[:, axis] = values + frame.translation[axis] if is_far else values
    return points, IDENTITY if is_far else frame


def columns_of_table(table: Mapping[str, NDArray[Any]], frame: Rigid | None, *, ours: bool) -> Columns:
    """Build Columns from a table of lower-case name → (N,) numbers; ``ours``: this package wrote the file.

    Ring, azimuth and time have many meanings in files of other programs: columns with invalid values are dropped.
    """
    missing = [name for name in "xyz" if name not in table]
    if missing:
        known = ", ".join(table) or "no known column"
        raise ValueError(f"must have columns x, y and z, {', '.join(missing)} not found among {known}")
    points, remaining = near_points([table[name] for name in "xyz"], IDENTITY if frame is None else frame)
    with np.errstate(over="ignore", invalid="ignore"):
        intensity = _first(table, _INTENSITY)
        intensity = None if intensity is None else intensity.astype(np.float32)
    ring, azimuth, time = (_first(table, names) for names in (_RING, _AZIMUTH, _TIME))
    if ours:
        return Columns(points, intensity, ring, azimuth=azimuth, time_s=time, frame=remaining)
    laser = None if ring is None else valid_rings(ring)
    angle = None if azimuth is None else matched_azimuth(azimuth, points)
    time_s = None if time is None else matched_time_s(time)
    t_ns = None if time is None or time_s is None else instant_ns(time)
    rules = (
        (ring, laser, "ring is left out: it must be whole numbers in [0, 4096)"),
        (azimuth, angle, "azimuth is left out: no choice of unit, sign and zero makes it agree with the points"),
        (time, time_s, "time is left out: it must be finite and within one revolution (2 s)"),
    )
    left_out = tuple(problem for column, usable, problem in rules if column is not None and usable is None)
    return Columns(
        points, intensity, laser=laser, azimuth=angle, time_s=time_s, t_ns=t_ns, frame=remaining, left_out=left_out
    )  # fmt: skip


def _first(table: Mapping[str, NDArray[Any]], names: tuple[str, ...]) -> NDArray[Any] | None:
    return next((table[name] for name in names if name in table), None)


def table_of_sweep(sweep: Sweep) -> NDArray[Any]:
    """Return the sweep's columns as one little-endian structured array (N,); missing columns are left out."""
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


def number_columns(
    content: bytes, start: int, rows: int, width: int, positions: Mapping[str, int]
) -> dict[str, NDArray[np.float64]]:
    r"""Parse text with ``width`` numbers a line; return the float64 columns (rows,) of ``positions`` (name → position).

    A number can take two bytes of text but eight in numpy, so text is parsed in blocks and only these columns are kept.

    >>> number_columns(b"1 2 nan\n", 0, 1, 3, {"y": 1})["y"].tolist()
    [2.0]
    """
    available = len(content) - start
    if rows * max(1, 2 * width - 1) > available:
        raise ValueError(f"text is cut off: {rows} rows of {width} numbers need more than {available} bytes")
    columns = {name: np.empty(rows) for name in positions}
    done = 0
    for part in _text_blocks(content, start, width):
        lines = part[: rows - done]
        if lines:
            table = np.loadtxt(lines, dtype=np.float64, comments=None, ndmin=2)
            if table.shape != (len(lines), width):
                got = f"{done + len(table)} of {table.shape[1]}"
                raise ValueError(f"text must hold {rows} rows of {width} numbers, got {got}")
            for name, position in positions.items():
                columns[name][done : done + len(lines)] = table[:, position]
            done += len(lines)
        if done == rows:
            return columns
    if done < rows:
        raise ValueError(f"text must hold {rows} rows of {width} numbers, got {done} of {width}; it is cut off")
    return columns


_TEXT_BLOCK_BYTES = 1 << 18

_MAX_BYTES_A_NUMBER = 64


def _text_blocks(content: bytes, start: int, width: int) -> Iterator[list[str]]:
    """Yield the non-empty lines, block by block; raise if a line is far too long for ``width`` numbers."""
    max_bytes = 256 + _MAX_BYTES_A_NUMBER * width
    block = max(_TEXT_BLOCK_BYTES, max_bytes)
    while start < len(content):
        end = content.rfind(b"\n", start, start + block) + 1 or min(len(content), start + block)
        lines = content[start:end].decode("latin-1").split("\n")
        if max(map(len, lines)) >= max_bytes:
            raise ValueError(f"text must hold {width} numbers a line, got a line of more than {max_bytes} bytes")
        yield [line for line in lines if line and not line.isspace()]
        start = end
