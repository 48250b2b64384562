"""Poses of sweeps in a text file of its own: as KITTI writes them, as TUM does, or places by latitude and longitude."""

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
from viewshed.recordings.read.tf_tree import between, nearest
from viewshed.sweep import LATEST_S, Sweep

_KITTI_NUMBERS, _TUM_NUMBERS = 12, 8

_PLACE_COLUMNS = ("timestamp", "latitude", "longitude", "height")
"""Of a table of places, in its first line."""

_DEVIATION_COLUMNS = ("longitude_std_dev", "latitude_std_dev", "height_std_dev")
"""Standard deviations in meters that it may have as well: east, north, up. What else it has is left out."""

_MOVED_M = 0.5
"""A heading is that of the way between two places that are so far apart; nearer ones are noise."""

_BYTES_MAX = 64_000_000

_NEAR_NS = 50_000_000
"""Longest time of a sweep before the first pose or after the last one, or from a pose beside a gap."""

_GAP_NS = 2_000_000_000
"""Between poses farther apart than this nothing is interpolated."""

_USUAL_PERIOD_NS = 100_000_000

_UNIT_NS = {10: 1_000_000_000, 13: 1_000_000, 16: 1000, 19: 1}
"""Nanoseconds of the unit of a time since 1970 in a file's name, by the number of its digits."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseFile:
    """The poses ``world_from_sensor`` in a file."""

    place: Path  # the file
    poses: tuple[Rigid, ...]  # in its order
    # (N,) int64 time of each, ascending; None where neither the file nor a ``times.txt`` beside it has any
    times_ns: NDArray[np.int64] | None
    by_time: bool  # whether sweeps are found by their time (TUM), else by number
    notes: tuple[str, ...] = ()  # what was assumed, a line each
    # (N, 3) float64 standard deviations of the places in meters, NaN of those that say none; None where none does
    deviations_m: NDArray[np.float64] | None = None

    @classmethod
    def read(cls, place: str | os.PathLike[str]) -> PoseFile:
        """Return the poses in a file.

        Lines of 12 numbers are the first three rows of a pose (KITTI). They are those of the left camera where
        ``calib.txt`` with its ``Tr`` lies beside the file, as KITTI has it, and else those of the sensor. Lines of 8
        numbers are time in seconds, place, and quaternion x, y, z, w (TUM). Lines that begin with # are left out. A
        table whose first line names timestamp (s), latitude, longitude (degrees) and height (m) is of places; the
        sensor is taken to look along its way, level. Standard deviations of the places (m) are kept. A folder has a
        such table in each of its ``.pose`` files.

        Raises:
            ValueError: a line is neither, its numbers are no pose, or times do not ascend; the message names the line.
            OSError: it cannot be read.
        """
        path = Path(place)
        if path.is_dir():
            return cls._of_places_in(path)
        with open_input(path) as source:
            content = source.content(_BYTES_MAX).removeprefix(BOM_UTF8)
            if _PLACE_COLUMNS[0] in _words(content.decode("utf-8", "replace").lstrip().partition("\n")[0]):
                return cls._of_places(path, content)
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
    def _of_places_in(cls, folder: Path) -> PoseFile:
        """Return the poses of the tables of places in a folder and those below it."""
        tables = []
        for path in sorted(folder.rglob("*.pose")):
            with open_input(path) as source:
                tables.append(source.content(_BYTES_MAX).removeprefix(BOM_UTF8))
        if not tables:
            raise ValueError(
                f"{folder} is a folder without .pose files; give a table of poses, or a folder of such files"
            )
        with error_prefix(str(folder)):
            return cls._of_places(folder, b"\n".join(tables))

    @classmethod
    def _of_places(cls, path: Path, content: bytes) -> PoseFile:
        """Return the poses of tables of places: x east, y north from the first of them, looking along the way."""
        # 1. The rows, in the order of time, each by the columns of the last header.
        columns, deviations = list[int](), list[int]()
        found, spread = list[list[float]](), list[list[float]]()
        for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), start=1):
            words = _words(line)
            if _PLACE_COLUMNS[0] in words or (any(words) and not columns):
                missing = [name for name in _PLACE_COLUMNS if name not in words]
                if missing:
                    raise ValueError(f"line {number} must name a column {missing[0]}, got {line[:60]!r}")
                columns = [words.index(name) for name in _PLACE_COLUMNS]
                has_all = set(_DEVIATION_COLUMNS) <= set(words)
                deviations = [words.index(name) for name in _DEVIATION_COLUMNS] if has_all else []
            elif any(words):
                place, deviation_m = (_floats_in(words, each, f"line {number}") for each in (columns, deviations))
                if not np.isfinite(place).all() or abs(place[1]) >= 89.0:
                    raise ValueError(
                        f"line {number}: latitude must lie in (-89, 89) degrees and all be finite, got {place}"
                    )
                if not all(0.0 <= each < np.inf for each in deviation_m):
                    raise ValueError(
                        f"line {number}: standard deviations must be finite and not negative, got {deviation_m}"
                    )
                found.append(place)
                spread.append(deviation_m or [np.nan] * 3)
        if not found:
            raise ValueError("must have places, got no line with numbers")
        order = np.argsort([row[0] for row in found], kind="stable")
        rows, deviations_m = np.array(found)[order], np.array(spread)[order]
        times_ns = _nanoseconds(rows[:, 0])
        if (np.diff(times_ns) <= 0).any():
            raise ValueError(f"times must differ, got {rows[1:][np.diff(times_ns) <= 0][0, 0]:f} s twice")
        # 2. Places in meters, and headings of the way from the last to the next place that is apart.
        records = np.column_stack([rows[:, 1:], np.zeros((len(rows), 3))])
        places_m = np.array([world_from_imu(record, records[0]).translation for record in records])
        records[:, 5] = _headings(places_m)
        poses = tuple(world_from_imu(record, records[0]) for record in records)
        note = "places have no rotation: the sensor is taken to look along its way, level"
        stated = deviations_m if np.isfinite(deviations_m).any() else None
        return cls(path, poses, times_ns, by_time=True, notes=(note,), deviations_m=stated)

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
                seconds = np.array(source.content(_BYTES_MAX).split(), np.float64)
                if len(seconds) != len(poses) or not np.isfinite(seconds).all() or (np.diff(seconds) <= 0).any():
                    raise ValueError(
                        f"must have one time for each of {len(poses)} poses, ascending, got {len(seconds)}"
                    )
                times_ns = _nanoseconds(seconds)
        else:
            notes.append("sweeps without a time are taken to be 0.1 s apart, since no times.txt lies beside the poses")
        return cls(path, poses, times_ns, by_time=False, notes=tuple(notes))

    def place_sweep(self, sweep: Sweep, file: Path, number: int, files: Sequence[Path]) -> Sweep:
        """Return a sweep with its pose, and with the time of the pose where it has none of its own.

        By time: that of the sweep, else the one in its file's name, between the poses before and after it. Else by
        number: where all files are named by numbers that the file has a line for, by these; else by their order.

        Args:
            sweep: what was measured.
            file: where it was read.
            number: how many sweeps of the file came before it.
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
            period_ns = row * _USUAL_PERIOD_NS if self.times_ns is None else int(self.times_ns[row])
            t_ns = sweep.t_ns if sweep.t_ns is not None else period_ns
        return sweep.replace(world_from_sensor=pose, t_ns=t_ns, pose_covariance=covariance)

    def check(self, files: Sequence[Path]) -> None:
        """Check that files have a pose each, as far as that is known before they are read.

        Raises:
            ValueError: there are several, and they are neither as many as the poses nor named by their numbers.
        """
        if not self.by_time and len(files) > 1 and len(files) != len(self.poses) and not self._numbers_of(files):
            raise ValueError(
                f"{self.place}: must have one pose for each of {len(files)} files, got {len(self.poses)} lines; or name"
                " the files by the numbers of their lines, from 0"
            )

    def _numbers_of(self, files: Sequence[Path]) -> list[int]:
        """Return the numbers by which all files are named; none where not all lie within the poses."""
        names = [re.match(r"\d+(?=\.)", each.name) for each in files]
        numbers = [int(name[0]) for name in names if name is not None]
        return numbers if len(numbers) == len(files) and max(numbers, default=0) < len(self.poses) else []

    def _row(self, file: Path, number: int, files: Sequence[Path]) -> int:
        numbers = self._numbers_of(files)
        if len(files) > 1:
            if number:
                raise ValueError(f"{file.name} holds several sweeps, {self.place} must have one line for each file")
            number = (numbers or range(len(files)))[list(files).index(file)]
        elif numbers and not (file.suffix == ".pcap" or is_recording(file)):  # those hold several sweeps
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
        if not first_ns - _NEAR_NS <= t_ns <= last_ns + _NEAR_NS:
            raise ValueError(
                f"the sweep at {t_ns / 1e9:.3f} s has no pose: {self.place.name} reaches from {first_ns / 1e9:.3f} to"
                f" {last_ns / 1e9:.3f} s"
            )
        within_ns = min(max(t_ns, first_ns), last_ns)
        after = int(np.searchsorted(times_ns, within_ns))
        if times_ns[after] == within_ns:
            return self.poses[after]
        if times_ns[after] - times_ns[after - 1] > _GAP_NS:
            near = nearest(times_ns, within_ns)
            if abs(times_ns[near] - within_ns) <= _NEAR_NS:
                return self.poses[near]
            gap_s = (times_ns[after] - times_ns[after - 1]) / 1e9
            raise ValueError(f"the sweep at {t_ns / 1e9:.3f} s lies in a gap of {gap_s:.1f} s of {self.place.name}")
        share = (within_ns - times_ns[after - 1]) / (times_ns[after] - times_ns[after - 1])
        return between(self.poses[after - 1], self.poses[after], float(share))

    def _covariance_at(self, t_ns: int, times_ns: NDArray[np.int64]) -> NDArray[np.float64] | None:
        """Return the covariance (6, 6) of the pose nearest to a time, of its place alone; None where none is stated."""
        if self.deviations_m is None:
            return None
        deviation_m = self.deviations_m[nearest(times_ns, t_ns)]
        return np.diag([*deviation_m**2, 0.0, 0.0, 0.0]) if np.isfinite(deviation_m).all() else None


def _words(line: str) -> list[str]:
    return [word.strip() for word in line.split(",")]


def _nanoseconds(seconds: NDArray[np.float64]) -> NDArray[np.int64]:
    if np.abs(seconds).max(initial=0.0) >= LATEST_S:  # as in other units since 1970
        raise ValueError(f"times must be seconds, got {seconds[np.abs(seconds).argmax()]:.0f}")
    return np.round(seconds * 1e9).astype(np.int64)


def _floats_in(words: Sequence[str], columns: Sequence[int], where: str) -> list[float]:
    """Return the numbers of some columns of a line of places."""
    try:
        return [float(words[column]) for column in columns]
    except (ValueError, IndexError) as error:
        raise ValueError(f"{where} must have a number for each of its columns, got {','.join(words)[:60]!r}") from error


def _headings(places_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the heading (N,) of a way through places (N, 3), radians from x; 0 where it never moves."""
    # Places along the way that are apart, and of each place the step from the last to the next of them.
    apart = [0]
    for row, place_m in enumerate(places_m):
        if np.hypot(*(place_m - places_m[apart[-1]])[:2]) > _MOVED_M:
            apart.append(row)
    if len(apart) == 1:
        return np.zeros(len(places_m))
    steps = np.diff(places_m[apart], axis=0)
    step = np.clip(np.searchsorted(apart, np.arange(len(places_m))), 1, len(steps)) - 1
    return np.asarray(np.arctan2(steps[step, 1], steps[step, 0]))


def time_in_name(name: str) -> int | None:
    """Return the time since 1970 in nanoseconds that a file is named by, or None.

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
    """Return the numbers (N, 12 or 8) of the lines, and the number of each line, from 1."""
    rows, lines = list[list[float]](), list[int]()
    for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            row = [float(word) for word in words]
        except ValueError as error:
            raise ValueError(f"line {number} must be numbers, got {line[:60]!r}") from error
        wanted = len(rows[0]) if rows else len(row)
        if len(row) not in (_KITTI_NUMBERS, _TUM_NUMBERS) or len(row) != wanted:
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
