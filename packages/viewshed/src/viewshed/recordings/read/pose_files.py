"""Read files of poses: in KITTI's format, in TUM's, or tables of positions by latitude and longitude."""

from __future__ import annotations

import os
import re
from codecs import BOM_UTF8
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io._input import open_input
from viewshed.io.formats import is_recording
from viewshed.recordings.read._kitti_files import rigid_named, world_from_imu
from viewshed.recordings.read.source import error_prefix
from viewshed.recordings.read.tf_tree import MAX_GAP_NS, between, nearest
from viewshed.sweep import LATEST_S, Sweep

_KITTI_NUMBERS, _TUM_NUMBERS = 12, 8

_POSITION_COLUMNS = ("timestamp", "latitude", "longitude", "height")
"""Required columns of a table of positions, named in its first line."""

_DEVIATION_COLUMNS = ("longitude_std_dev", "latitude_std_dev", "height_std_dev")
"""Optional columns: standard deviations in meters, east, north, up. Other columns are ignored."""

_MIN_STEP_M = 0.5
"""Minimum distance of two positions to compute a heading; nearer ones are noise."""

_MAX_BYTES = 64_000_000

_MAX_EXTRAPOLATION_NS = 50_000_000
"""Maximum time of a sweep before the first pose, after the last one, or from a pose next to a gap."""

_DEFAULT_PERIOD_NS = 100_000_000

_UNIT_NS = {10: 1_000_000_000, 13: 1_000_000, 16: 1000, 19: 1}
"""Number of digits of a time since 1970 in a file name → nanoseconds of its unit."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseFile:
    """The poses ``world_from_sensor`` in a file."""

    place: Path  # the file
    poses: tuple[Rigid, ...]  # in file order
    # (N,) int64 time of each pose, ascending; None if neither the file nor a ``times.txt`` beside it has times
    times_ns: NDArray[np.int64] | None
    by_time: bool  # whether poses are looked up by time (TUM), else by number
    notes: tuple[str, ...] = ()  # assumptions, one line each
    # (N, 3) float64 standard deviations of the positions in meters, NaN if unknown; None if all are unknown
    deviations_m: NDArray[np.float64] | None = None

    @classmethod
    def read(cls, place: str | os.PathLike[str]) -> PoseFile:
        """Read the poses in a file.

        Lines of 12 numbers are the first three rows of a pose (KITTI). They are poses of the left camera if a
        ``calib.txt`` with ``Tr`` is beside the file, as in KITTI, else of the sensor. Lines of 8 numbers are time in
        seconds, position, and quaternion x, y, z, w (TUM). Lines that begin with # are ignored. A table whose first
        line names timestamp (s), latitude, longitude (degrees) and height (m) has positions; the sensor is assumed to
        be level and to face along the path. Standard deviations of positions (m) are kept. In a folder, each ``.pose``
        file is such a table.

        Raises:
            ValueError: a line has another format or no valid pose, or times do not ascend; the message names the line.
            OSError: it cannot be read.
        """
        path = Path(place)
        if path.is_dir():
            return cls._of_positions_in(path)
        with open_input(path) as source:
            content = source.content(_MAX_BYTES).removeprefix(BOM_UTF8)
            if _POSITION_COLUMNS[0] in _words(content.decode("utf-8", "replace").lstrip().partition("\n")[0]):
                return cls._of_positions(path, content)
            rows, lines = _numbers(content)
            if len(rows[0]) == _TUM_NUMBERS:
                times_ns = _nanoseconds(rows[:, 0])
                late = np.flatnonzero(np.diff(times_ns) <= 0)
                if late.size:
                    raise ValueError(f"line {lines[late[0] + 1]}: times must ascend, got {rows[late[0] + 1, 0]:f} s")
                poses = tuple(_tum_pose(row, f"line {line}") for row, line in zip(rows, lines, strict=True))
                return cls(path, poses, times_ns, by_time=True)
            poses = tuple(_kitti_pose(row, f"line {line}") for row, line in zip(rows, lines, strict=True))
        return cls._of_kitti(path, poses)

    @classmethod
    def _of_positions_in(cls, folder: Path) -> PoseFile:
        """Read the tables of positions in a folder and its subfolders."""
        tables = []
        for path in sorted(folder.rglob("*.pose")):
            with open_input(path) as source:
                tables.append(source.content(_MAX_BYTES).removeprefix(BOM_UTF8))
        if not tables:
            raise ValueError(
                f"{folder} is a folder without .pose files; give a table of poses, or a folder of such files"
            )
        with error_prefix(str(folder)):
            return cls._of_positions(folder, b"\n".join(tables))

    @classmethod
    def _of_positions(cls, path: Path, content: bytes) -> PoseFile:
        """Convert tables of positions to poses: x east, y north from the first position, facing along the path."""
        # 1. Read the rows by the columns of the last header, and sort them by time.
        columns, deviation_columns = list[int](), list[int]()
        positions, deviations = list[list[float]](), list[list[float]]()
        for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), start=1):
            words = _words(line)
            if _POSITION_COLUMNS[0] in words or (any(words) and not columns):
                missing = [name for name in _POSITION_COLUMNS if name not in words]
                if missing:
                    raise ValueError(f"line {number} must name a column {missing[0]}, got {line[:60]!r}")
                columns = [words.index(name) for name in _POSITION_COLUMNS]
                has_all = set(_DEVIATION_COLUMNS) <= set(words)
                deviation_columns = [words.index(name) for name in _DEVIATION_COLUMNS] if has_all else []
            elif any(words):
                position = _floats_in(words, columns, f"line {number}")
                deviation_m = _floats_in(words, deviation_columns, f"line {number}")
                if not np.isfinite(position).all() or abs(position[1]) >= 89.0:
                    raise ValueError(
                        f"line {number}: latitude must lie in (-89, 89) degrees and all be finite, got {position}"
                    )
                if not all(0.0 <= value < np.inf for value in deviation_m):
                    raise ValueError(
                        f"line {number}: standard deviations must be finite and not negative, got {deviation_m}"
                    )
                positions.append(position)
                deviations.append(deviation_m or [np.nan] * 3)
        if not positions:
            raise ValueError("must have positions, got no line with numbers")
        order = np.argsort([row[0] for row in positions], kind="stable")
        rows, deviations_m = np.array(positions)[order], np.array(deviations)[order]
        times_ns = _nanoseconds(rows[:, 0])
        if (np.diff(times_ns) <= 0).any():
            raise ValueError(f"times must differ, got {rows[1:][np.diff(times_ns) <= 0][0, 0]:f} s twice")
        # 2. Convert positions to meters, and compute headings along the path.
        records = np.column_stack([rows[:, 1:], np.zeros((len(rows), 3))])
        positions_m = np.array([world_from_imu(record, records[0]).translation for record in records])
        records[:, 5] = _headings(positions_m)
        poses = tuple(world_from_imu(record, records[0]) for record in records)
        note = "positions have no rotation: the sensor is taken to be level and to face along its path"
        known_m = deviations_m if np.isfinite(deviations_m).any() else None
        return cls(path, poses, times_ns, by_time=True, notes=(note,), deviations_m=known_m)

    @classmethod
    def _of_kitti(cls, path: Path, poses: tuple[Rigid, ...]) -> PoseFile:
        notes = []
        calibration = path.with_name("calib.txt")
        if calibration.is_file():
            camera_from_sensor = rigid_named(path.parent, calibration, "Tr")
            poses = tuple(camera_from_sensor.inverse() @ pose @ camera_from_sensor for pose in poses)
            notes.append(f"poses are those of KITTI's camera, moved to the sensor by {calibration.name} beside them")
        else:
            notes.append("poses are taken as those of the sensor, since no calib.txt of KITTI lies beside them")
        times = path.with_name("times.txt")
        times_ns = None
        if times.is_file():
            with open_input(times) as source:
                seconds = np.array(source.content(_MAX_BYTES).split(), np.float64)
                if len(seconds) != len(poses) or not np.isfinite(seconds).all() or (np.diff(seconds) <= 0).any():
                    raise ValueError(
                        f"must have one time for each of {len(poses)} poses, ascending, got {len(seconds)}"
                    )
                times_ns = _nanoseconds(seconds)
        else:
            notes.append("sweeps without a time are taken to be 0.1 s apart, since no times.txt lies beside the poses")
        return cls(path, poses, times_ns, by_time=False, notes=tuple(notes))

    def place_sweep(self, sweep: Sweep, file: Path, number: int, files: Sequence[Path]) -> Sweep:
        """Return a sweep with its pose, and with the time of the pose if the sweep has none.

        By time: interpolate the poses at the time of the sweep, or that in its file name. By number: use the numbers in
        the file names if all are valid line numbers, else the order of the files.

        Args:
            sweep: the sweep.
            file: the file of the sweep.
            number: index of the sweep in its file.
            files: all files that are read.

        Raises:
            ValueError: the file has no pose for it.
        """
        if self.by_time and self.times_ns is not None:
            t_ns = sweep.t_ns if sweep.t_ns is not None else time_in_name(file.name)
            pose = self._at(t_ns, file, self.times_ns)
            covariance = None if t_ns is None else self._covariance_at(t_ns, self.times_ns)
        else:
            row, covariance = self._row(file, number, files), None
            pose = self.poses[row]
            pose_t_ns = row * _DEFAULT_PERIOD_NS if self.times_ns is None else int(self.times_ns[row])
            t_ns = sweep.t_ns if sweep.t_ns is not None else pose_t_ns
        return sweep.replace(world_from_sensor=pose, t_ns=t_ns, pose_covariance=covariance)

    def check(self, files: Sequence[Path]) -> None:
        """Check, before files are read, that each file can have a pose.

        Raises:
            ValueError: there are several files; their number differs from that of the poses, and their names are no
                line numbers.
        """
        if not self.by_time and len(files) > 1 and len(files) != len(self.poses) and not self._numbers_of(files):
            raise ValueError(
                f"{self.place}: must have one pose for each of {len(files)} files, got {len(self.poses)} lines; or name"
                " the files by the numbers of their lines, from 0"
            )

    def _numbers_of(self, files: Sequence[Path]) -> list[int]:
        """Return the numbers in the names of all files; an empty list if one is missing or beyond the poses."""
        matches = [re.match(r"\d+(?=\.)", file.name) for file in files]
        numbers = [int(match[0]) for match in matches if match is not None]
        return numbers if len(numbers) == len(files) and max(numbers, default=0) < len(self.poses) else []

    def _row(self, file: Path, number: int, files: Sequence[Path]) -> int:
        numbers = self._numbers_of(files)
        if len(files) > 1:
            if number:
                raise ValueError(f"{file.name} holds several sweeps, {self.place} must have one line for each file")
            number = (numbers or range(len(files)))[list(files).index(file)]
        elif numbers and not (file.suffix == ".pcap" or is_recording(file)):  # these hold several sweeps
            number = numbers[0]
        if number >= len(self.poses):
            raise ValueError(f"{self.place}: has {len(self.poses)} lines, none for sweep {number}")
        return number

    def _at(self, t_ns: int | None, file: Path, times_ns: NDArray[np.int64]) -> Rigid:
        if t_ns is None:
            raise ValueError(
                f"{file.name} has no time by which its pose could be found in {self.place.name}; name the file by its"
                " time since 1970, or give one pose a sweep in KITTI's format"
            )
        first_ns, last_ns = int(times_ns[0]), int(times_ns[-1])
        if not first_ns - _MAX_EXTRAPOLATION_NS <= t_ns <= last_ns + _MAX_EXTRAPOLATION_NS:
            raise ValueError(
                f"the sweep at {t_ns / 1e9:.3f} s has no pose: {self.place.name} reaches from {first_ns / 1e9:.3f} to"
                f" {last_ns / 1e9:.3f} s"
            )
        within_ns = min(max(t_ns, first_ns), last_ns)
        after = int(np.searchsorted(times_ns, within_ns))
        if times_ns[after] == within_ns:
            return self.poses[after]
        if times_ns[after] - times_ns[after - 1] > MAX_GAP_NS:
            near = nearest(times_ns, within_ns)
            if abs(times_ns[near] - within_ns) <= _MAX_EXTRAPOLATION_NS:
                return self.poses[near]
            gap_s = (times_ns[after] - times_ns[after - 1]) / 1e9
            raise ValueError(f"the sweep at {t_ns / 1e9:.3f} s lies in a gap of {gap_s:.1f} s of {self.place.name}")
        share = (within_ns - times_ns[after - 1]) / (times_ns[after] - times_ns[after - 1])
        return between(self.poses[after - 1], self.poses[after], float(share))

    def _covariance_at(self, t_ns: int, times_ns: NDArray[np.int64]) -> NDArray[np.float64] | None:
        """Return the covariance (6, 6) of the pose nearest in time (position only); None if unknown."""
        if self.deviations_m is None:
            return None
        deviation_m = self.deviations_m[nearest(times_ns, t_ns)]
        return np.diag([*deviation_m**2, 0.0, 0.0, 0.0]) if np.isfinite(deviation_m).all() else None


def _words(line: str) -> list[str]:
    return [word.strip() for word in line.split(",")]


def _nanoseconds(seconds: NDArray[np.float64]) -> NDArray[np.int64]:
    if np.abs(seconds).max(initial=0.0) >= LATEST_S:  # e.g. another unit since 1970
        raise ValueError(f"times must be seconds, got {seconds[np.abs(seconds).argmax()]:.0f}")
    return np.round(seconds * 1e9).astype(np.int64)


def _floats_in(words: Sequence[str], columns: Sequence[int], where: str) -> list[float]:
    """Parse the numbers in some columns of a line of positions."""
    try:
        return [float(words[column]) for column in columns]
    except (ValueError, IndexError) as error:
        raise ValueError(f"{where} must have a number for each of its columns, got {','.join(words)[:60]!r}") from error


def _headings(positions_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the heading (N,) along a path of positions (N, 3), radians from x; 0 if it never moves."""
    # Select waypoints at a minimum distance; each position gets the heading of the segment between its waypoints.
    waypoints = [0]
    for row, position_m in enumerate(positions_m):
        if np.hypot(*(position_m - positions_m[waypoints[-1]])[:2]) > _MIN_STEP_M:
            waypoints.append(row)
    if len(waypoints) == 1:
        return np.zeros(len(positions_m))
    segments = np.diff(positions_m[waypoints], axis=0)
    index = np.clip(np.searchsorted(waypoints, np.arange(len(positions_m))), 1, len(segments)) - 1
    return np.asarray(np.arctan2(segments[index, 1], segments[index, 0]))


def time_in_name(name: str) -> int | None:
    """Return the time in a file name in nanoseconds since 1970, or None.

    >>> time_in_name("n015__LIDAR_TOP__1532402927647951.pcd.bin"), time_in_name("1700000000.250000000.pcd")
    (1532402927647951000, 1700000000250000000)
    >>> time_in_name("000123.bin")
    """
    parts = re.findall(r"(?<!\d)(\d{10})[._-](\d{1,9})(?!\d)", name)
    if parts:
        seconds, fraction = parts[-1]
        return int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0"))
    numbers = [number for number in re.findall(r"\d+", name) if len(number) in _UNIT_NS]
    return int(numbers[-1]) * _UNIT_NS[len(numbers[-1])] if numbers else None


def _numbers(content: bytes) -> tuple[NDArray[np.float64], list[int]]:
    """Parse the lines to an array (N, 12 or 8); return it and the number of each line, from 1."""
    rows, lines = list[list[float]](), list[int]()
    for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            row = [float(word) for word in words]
        except ValueError as error:
            raise ValueError(f"line {number} must be numbers, got {line[:60]!r}") from error
        expected = len(rows[0]) if rows else len(row)
        if len(row) not in (_KITTI_NUMBERS, _TUM_NUMBERS) or len(row) != expected:
            raise ValueError(
                f"line {number} must have 12 numbers (KITTI) or 8 (TUM: time, x, y, z, qx, qy, qz, qw), got {len(row)}"
            )
        if not np.isfinite(row).all():
            raise ValueError(f"line {number} must be finite numbers, got {line[:60]!r}")
        rows.append(row)
        lines.append(number)
    if not rows:
        raise ValueError("must have poses, got no line with numbers")
    return np.array(rows), lines


def _kitti_pose(row: NDArray[np.float64], where: str) -> Rigid:
    with error_prefix(where):
        return Rigid(row.reshape(3, 4)[:, :3], row.reshape(3, 4)[:, 3])


def _tum_pose(row: NDArray[np.float64], where: str) -> Rigid:
    x, y, z, w = row[4:].tolist()
    length = float(np.linalg.norm(row[4:]))
    if not 0.99 < length < 1.01:
        raise ValueError(f"{where}: the quaternion must have norm 1, got norm {length:g}")
    return Rigid.from_quaternion(np.array([w, x, y, z]) / length, row[1:4])
