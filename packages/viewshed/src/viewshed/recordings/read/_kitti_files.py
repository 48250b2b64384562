"""Read the text files of KITTI: times, calibration and poses, by number of the sweep."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io._input import inside, open_input
from viewshed.recordings.read.source import error_prefix, note_damage, numbers_in

EARTH_RADIUS_M = 6378137.0
"""Earth radius of KITTI's development kit."""

_MAX_TEXT_BYTES = 64_000_000
_MAX_CALIBRATION_BYTES = 1_000_000
_OXTS_COLUMNS = 6


def text_lines(root: Path, path: Path, limit_bytes: int = _MAX_TEXT_BYTES) -> list[str]:
    """Return the lines of a text file of a recording; raise ValueError if links lead out of ``root``."""
    with open_input(inside(root, path)) as source:
        return source.content(limit_bytes).decode("utf-8").splitlines()


def numbers_of(text: str, count: int, where: str) -> NDArray[np.float64]:
    """Parse the first ``count`` numbers of a line, (count,) float64."""
    return np.array(numbers_in(text.split(None, count)[:count], count, f"{where}:"))


def named_texts(root: Path, path: Path) -> dict[str, str]:
    """Return name → text of the lines ``name: text`` of a calibration file."""
    parts = (line.partition(":") for line in text_lines(root, path, _MAX_CALIBRATION_BYTES))
    return {name.strip(): rest for name, colon, rest in parts if colon}


def rigid_of_line(text: str, where: str) -> Rigid:
    """Parse a transform from a line of 12 numbers, the first three rows of its matrix."""
    matrix = numbers_of(text, 12, where).reshape(3, 4)
    with error_prefix(where):
        return Rigid(matrix[:, :3], matrix[:, 3])


def rigid_named(root: Path, path: Path, name: str) -> Rigid:
    """Read the transform of the line ``name: 12 numbers`` of a calibration file."""
    texts = named_texts(root, path)
    if name not in texts:
        raise ValueError(f"{path}: must have a line {name}: …, got {', '.join(texts)[:80] or 'none'}")
    return rigid_of_line(texts[name], f"{path}, {name}")


def times_of(root: Path, place: Path, files: Sequence[Path], damage: list[str], *, seconds: bool) -> list[int | None]:
    """Read the time of each file in nanoseconds, from the line of its number.

    If there are as many lines as files but numbers go beyond them, line i is that of file i.

    Args:
        root: the recording; links must not lead out of it.
        place: the text file.
        files: the sweeps.
        damage: one line is appended for each problem; a missing or invalid time is None.
        seconds: whether the lines are in seconds; else they are dates in UTC.
    """
    try:
        lines = text_lines(root, place)
    except (ValueError, OSError) as error:
        note_damage(damage, f"{error}; the sweeps have no times")
        return [None] * len(files)
    numbers = [int(file.stem) for file in files]
    if numbers and numbers[-1] >= len(lines) == len(files):
        numbers = list(range(len(files)))
    times: list[int | None] = []
    for number in numbers:
        try:
            text, where = _line_of(lines, number, place), f"{place}, line {number + 1}"
            times.append(round(float(numbers_of(text, 1, where)[0]) * 1e9) if seconds else _date_ns(text, place))
        except ValueError as error:
            note_damage(damage, f"{error}; that sweep has no time")
            times.append(None)
    known = [t_ns for t_ns in times if t_ns is not None]
    late = next((after for after, before in zip(known[1:], known, strict=False) if after <= before), None)
    if late is not None:
        problem = f"times must ascend, {late} ns is not after the one before; sweeps are sorted by time"
        note_damage(damage, f"{place}: {problem}")
    return times


def _line_of(lines: Sequence[str], number: int, place: Path) -> str:
    if number >= len(lines):
        raise ValueError(f"{place}: has {len(lines)} lines, none for sweep {number}")
    return lines[number]


def _date_ns(text: str, place: Path) -> int:
    """Convert a date such as ``2011-09-26 13:02:25.964389445`` to nanoseconds since 1970."""
    date, _, fraction = text.strip().partition(".")
    try:
        seconds = int(datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp())
        return seconds * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))
    except ValueError as error:
        raise ValueError(f"{place}: must be dates and times, got {text[:40]!r}") from error


PoseTrack = Callable[[str], Rigid]
"""Function: number of a sweep → ``world_from_velodyne``; raises if the pose is missing or damaged."""


def camera_track(root: Path, place: Path, calibration: Path) -> PoseTrack:
    """Return the poses of one KITTI odometry sequence; the world is the LiDAR's frame at the first sweep.

    The lines of the file ``place`` are poses of the left camera in the camera's frame at the first sweep.
    """
    return partial(_pose_by_camera, place, text_lines(root, place), rigid_named(root, calibration, "Tr"))


def _pose_by_camera(place: Path, lines: Sequence[str], camera_from_velodyne: Rigid, key: str) -> Rigid:
    first_from_camera = rigid_of_line(_line_of(lines, int(key), place), f"{place}, line {int(key) + 1}")
    return camera_from_velodyne.inverse() @ first_from_camera @ camera_from_velodyne


def inertial_track(root: Path, drive: Path) -> PoseTrack:
    """Return the poses of one KITTI raw drive; the world has its origin at the first readable record."""
    calibration = drive.parent / "calib_imu_to_velo.txt"
    texts = named_texts(root, calibration)
    rotation = numbers_of(texts.get("R", ""), 9, f"{calibration}, R").reshape(3, 3)
    translation = numbers_of(texts.get("T", ""), 3, f"{calibration}, T")
    folder = drive / "oxts" / "data"
    with error_prefix(str(calibration)):
        imu_from_velodyne = Rigid(rotation, translation).inverse()
    return partial(_pose_by_imu, root, folder, _first_readable(root, folder), imu_from_velodyne)


def _pose_by_imu(root: Path, folder: Path, first: NDArray[np.float64], imu_from_velodyne: Rigid, key: str) -> Rigid:
    return world_from_imu(_read_oxts(root, folder / f"{key}.txt"), first) @ imu_from_velodyne


def _first_readable(root: Path, folder: Path) -> NDArray[np.float64]:
    problem: Exception = FileNotFoundError(f"{folder}: must hold the records of the inertial unit, got none")
    for file in sorted(folder.glob("*.txt")):
        try:
            return _read_oxts(root, file)
        except (ValueError, OSError) as error:
            problem = error
    raise problem


def _read_oxts(root: Path, place: Path) -> NDArray[np.float64]:
    """Read latitude and longitude in degrees, altitude in meters, roll, pitch and yaw in radians, (6,) float64."""
    record = numbers_of(text_lines(root, place)[0], _OXTS_COLUMNS, str(place))
    if abs(record[0]) >= 89.0:
        raise ValueError(f"{place}: latitude must lie in (-89, 89) degrees, got {record[0]}")
    return record


def world_from_imu(record: NDArray[np.float64], first: NDArray[np.float64]) -> Rigid:
    """Convert a record (6,) to a pose in the map: x east, y north, z up, meters from the position of ``first`` (6,).

    Mercator projection with the scale at the first latitude, and rotation Rz(yaw) Ry(pitch) Rx(roll), as in
    ``convertOxtsToPose.m`` of KITTI's development kit. Unlike there, the first pose keeps its rotation, so z is up.

    >>> record = np.array([49.0, 8.4, 110.0, 0.0, 0.0, np.pi / 2])
    >>> pose = world_from_imu(record + [0.0, 0.001, 2.0, 0.0, 0.0, 0.0], record)
    >>> pose.translation.round(2).tolist(), (pose.rotation @ [1.0, 0.0, 0.0]).round(6).tolist()
    ([73.03, 0.0, 2.0], [0.0, 1.0, 0.0])
    """
    scale = np.cos(np.deg2rad(first[0]))
    translation = _mercator(record, scale) - _mercator(first, scale)
    roll, pitch, yaw = record[3:6]
    return Rigid(_axis_rotation(2, yaw) @ _axis_rotation(1, pitch) @ _axis_rotation(0, roll), translation)


def _mercator(record: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    latitude, longitude = np.deg2rad(record[:2])
    north = EARTH_RADIUS_M * np.log(np.tan(np.pi / 4 + latitude / 2))
    return np.array([scale * EARTH_RADIUS_M * longitude, scale * north, record[2]])


def _axis_rotation(axis: int, angle: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) about one axis."""
    rotation = np.eye(3)
    one, other = (axis + 1) % 3, (axis + 2) % 3
    rotation[[one, other], [one, other]] = np.cos(angle)
    rotation[one, other], rotation[other, one] = -np.sin(angle), np.sin(angle)
    return rotation
