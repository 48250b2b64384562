"""What KITTI's three layouts share: sweeps named by numbers, their times, and their poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.recordings.source import (
    SweepRef,
    named_texts,
    note_damage,
    numbers_of,
    rigid_named,
    rigid_of,
    rigid_of_line,
    text_lines,
)
from viewshed.geometry import Rigid
from viewshed.io import read_sweep
from viewshed.io._input import inside, one_line
from viewshed.sweep import Sweep

SENSOR = "hdl64e"
"""Beam table of KITTI's LiDAR."""

SENSOR_HEIGHT_M = 1.73
"""Height of the LiDAR above the ground (https://www.cvlibs.net/datasets/kitti/setup.php)."""


def sweep_files(folder: Path, damage: list[str]) -> list[Path]:
    """Return the ``.bin`` files of a folder by their numbers; others are named in ``damage``."""
    files = sorted(folder.glob("*.bin"))
    numbered = [file for file in files if file.stem.isascii() and file.stem.isdecimal() and len(file.stem) <= 18]
    for file in sorted(set(files) - set(numbered)):
        note_damage(damage, f"{file}: must be named by a number; it is left out")
    return sorted(numbered, key=lambda file: int(file.stem))


def timed_refs(scene: str, files: Sequence[Path], times: Sequence[int | None]) -> tuple[SweepRef, ...]:
    """Return the refs of a scene; in the order of their times where all have one, else of their numbers."""
    refs = [SweepRef(scene, 0, str(file), t_ns, sensor="velodyne", key=file.stem)
            for file, t_ns in zip(files, times, strict=True)]  # fmt: skip
    if None not in times:
        refs.sort(key=lambda ref: ref.t_ns or 0)
    return tuple(replace(ref, index=index) for index, ref in enumerate(refs))


def times_of(root: Path, place: Path, files: Sequence[Path], damage: list[str], *, seconds: bool) -> list[int | None]:
    """Return the time of each file, nanoseconds: the line of its number, or its own where there is one a file.

    Args:
        root: the recording, which links must not leave.
        place: the text file; what is missing or wrong in it is named in ``damage``, and that time is None.
        files: the sweeps.
        damage: lines are added to it.
        seconds: whether the lines are seconds; else they are dates, taken as UTC.
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
            text = line_of(lines, number, place)
            times.append(_seconds_ns(text, f"{place}, line {number + 1}") if seconds else _date_ns(text, place))
        except ValueError as error:
            note_damage(damage, f"{error}; that sweep has no time")
            times.append(None)
    known = [t_ns for t_ns in times if t_ns is not None]
    back = next((late for late, early in zip(known[1:], known, strict=False) if late <= early), None)
    if back is not None:
        problem = f"times must ascend, {back} ns is not after the one before; sweeps are sorted by time"
        note_damage(damage, f"{place}: {problem}")
    return times


def line_of(lines: Sequence[str], number: int, place: Path) -> str:
    """Return one line of a file.

    Raises:
        ValueError: it has no such line.
    """
    if number >= len(lines):
        raise ValueError(f"{place}: has {len(lines)} lines, none for sweep {number}")
    return lines[number]


def _seconds_ns(text: str, where: str) -> int:
    return round(float(numbers_of(text, 1, where)[0]) * 1e9)


def _date_ns(text: str, place: Path) -> int:
    """Return nanoseconds since 1970 of ``2011-09-26 13:02:25.964389445``."""
    date, _, fraction = text.strip().partition(".")
    try:
        seconds = int(datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp())
        return seconds * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))
    except ValueError as error:
        raise ValueError(f"{place}: must be dates and times, got {text[:40]!r}") from error


def read_frame(root: Path, ref: SweepRef, pose: Rigid | None) -> Sweep:
    """Return the sweep of a ref with KITTI's beams and height.

    Raises:
        ValueError: it is damaged.
        OSError: its file cannot be read.
    """
    file = inside(root, ref.file)
    sweep = read_sweep(file, format="kitti", sensor=SENSOR, sensor_height_m=SENSOR_HEIGHT_M, world_from_sensor=pose)
    return sweep if ref.t_ns is None else sweep.replace(t_ns=ref.t_ns)


def refs_of(scenes: dict[str, tuple[SweepRef, ...]], scene: str) -> tuple[SweepRef, ...]:
    """Return the refs of a scene.

    Raises:
        ValueError: there is no such scene.
    """
    if scene not in scenes:
        raise ValueError(f"scene must be one of {', '.join(scenes)[:200]}, got {scene!r}")
    return scenes[scene]


EARTH_RADIUS_M = 6378137.0
"""Radius that KITTI's development kit uses."""

_COLUMNS = 6


def read_oxts(root: Path, place: Path) -> NDArray[np.float64]:
    """Return latitude and longitude in degrees, altitude in meters, roll, pitch and yaw in radians, (6,) float64.

    Raises:
        OSError: the file cannot be read.
        ValueError: its first line is not as above, or the latitude is that of a pole.
    """
    record = numbers_of(text_lines(root, place)[0], _COLUMNS, str(place))
    if abs(record[0]) >= 89.0:
        raise ValueError(f"{place}: latitude must lie in (-89, 89) degrees, got {record[0]}")
    return record


def world_from_imu(record: NDArray[np.float64], first: NDArray[np.float64]) -> Rigid:
    """Return the pose of a record (6,) in the map: x east, y north, z up, meters from where ``first`` (6,) was taken.

    Mercator projection with the scale at the first latitude, and rotation Rz(yaw) Ry(pitch) Rx(roll), as in
    ``convertOxtsToPose.m`` of KITTI's development kit; unlike there the first pose keeps its rotation, so z is up.

    >>> record = np.array([49.0, 8.4, 110.0, 0.0, 0.0, np.pi / 2])
    >>> pose = world_from_imu(record + [0.0, 0.001, 2.0, 0.0, 0.0, 0.0], record)
    >>> pose.translation.round(2).tolist(), (pose.rotation @ [1.0, 0.0, 0.0]).round(6).tolist()
    ([73.03, 0.0, 2.0], [0.0, 1.0, 0.0])
    """
    scale = np.cos(np.deg2rad(first[0]))
    translation = _mercator(record, scale) - _mercator(first, scale)
    roll, pitch, yaw = record[3:6]
    return Rigid(_about(2, yaw) @ _about(1, pitch) @ _about(0, roll), translation)


def _mercator(record: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    latitude, longitude = np.deg2rad(record[:2])
    north = EARTH_RADIUS_M * np.log(np.tan(np.pi / 4 + latitude / 2))
    return np.array([scale * EARTH_RADIUS_M * longitude, scale * north, record[2]])


def _about(axis: int, angle: float) -> NDArray[np.float64]:
    """Return the (3, 3) rotation about one axis."""
    rotation = np.eye(3)
    one, other = (axis + 1) % 3, (axis + 2) % 3
    rotation[[one, other], [one, other]] = np.cos(angle)
    rotation[one, other], rotation[other, one] = -np.sin(angle), np.sin(angle)
    return rotation


@dataclass(frozen=True, slots=True, eq=False)
class InertialTrack:
    """Poses of one drive of KITTI raw.

    Attributes:
        root: the recording.
        folder: the records, named by the numbers of the sweeps.
        first: the record (6,) where the world has its origin.
        imu_from_velodyne: calibration.
    """

    root: Path
    folder: Path
    first: NDArray[np.float64]
    imu_from_velodyne: Rigid

    @classmethod
    def read(cls, root: Path, drive: Path) -> InertialTrack:
        """Return the track of a drive; the world has its origin where the first readable record was taken.

        Raises:
            OSError: there are no records, or the calibration cannot be read.
            ValueError: the calibration or every record is damaged.
        """
        calibration = drive.parent / "calib_imu_to_velo.txt"
        texts = named_texts(root, calibration)
        rotation = numbers_of(texts.get("R", ""), 9, f"{calibration}, R").reshape(3, 3)
        translation = numbers_of(texts.get("T", ""), 3, f"{calibration}, T")
        folder = drive / "oxts" / "data"
        first = _first_readable(root, folder)
        return cls(root, folder, first, rigid_of(rotation, translation, str(calibration)).inverse())

    def world_from_velodyne(self, key: str) -> Rigid:
        """Return the pose of the sweep with this number.

        Raises:
            OSError: its record cannot be read.
            ValueError: its record is damaged.
        """
        return world_from_imu(read_oxts(self.root, self.folder / f"{key}.txt"), self.first) @ self.imu_from_velodyne


def _first_readable(root: Path, folder: Path) -> NDArray[np.float64]:
    problem: Exception = FileNotFoundError(f"{folder}: must hold the records of the inertial unit, got none")
    for file in sorted(folder.glob("*.txt")):
        try:
            return read_oxts(root, file)
        except (ValueError, OSError) as error:
            problem = error
    raise problem


@dataclass(frozen=True, slots=True, eq=False)
class CameraTrack:
    """Poses of one sequence of KITTI odometry.

    Attributes:
        place: the file of poses.
        lines: its lines, each the pose of the left camera in the camera's frame at the first sweep.
        camera_from_velodyne: calibration.
    """

    place: Path
    lines: Sequence[str]
    camera_from_velodyne: Rigid

    @classmethod
    def read(cls, root: Path, place: Path, calibration: Path) -> CameraTrack:
        """Return the track in a file of poses.

        Raises:
            OSError: a file cannot be read.
            ValueError: the calibration is damaged.
        """
        return cls(place, text_lines(root, place), rigid_named(root, calibration, "Tr"))

    def world_from_velodyne(self, key: str) -> Rigid:
        """Return the pose of the sweep with this number, in the LiDAR's frame at the first sweep.

        Raises:
            ValueError: it has no line, or that is damaged.
        """
        number = int(key)
        text = line_of(self.lines, number, self.place)
        first_from_camera = rigid_of_line(text, f"{self.place}, line {number + 1}")
        return self.camera_from_velodyne.inverse() @ first_from_camera @ self.camera_from_velodyne


def pose_of(ref: SweepRef, pose: Callable[[str], Rigid]) -> Rigid:
    """Return the pose of a ref; errors name the sweep's file too.

    Raises:
        ValueError: it has no pose, or that is damaged.
    """
    try:
        return pose(ref.key)
    except (ValueError, OSError) as error:
        raise ValueError(one_line(f"{ref.file}: has no pose: {error}")) from error
