"""Poses of KITTI's LiDAR: from inertial records, and from the odometry set's poses of the camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.kitti_frames import line_of
from viewshed.datasets.number_text import named_texts, numbers_of, rigid_named, rigid_of, rigid_of_line, text_lines
from viewshed.datasets.oxts import read_oxts, world_from_imu
from viewshed.datasets.source import SweepRef
from viewshed.geometry import Rigid
from viewshed.io.source import one_line


@dataclass(frozen=True, slots=True, eq=False)
class InertialTrack:
    """Poses of one drive of KITTI raw.

    Attributes:
        folder: the records, named by the numbers of the sweeps.
        first: the record (6,) where the world has its origin.
        imu_from_velodyne: calibration.
    """

    folder: Path
    first: NDArray[np.float64]
    imu_from_velodyne: Rigid

    @classmethod
    def read(cls, drive: Path) -> InertialTrack:
        """Return the track of a drive; the world has its origin where the first readable record was taken.

        Raises:
            OSError: there are no records, or the calibration cannot be read.
            ValueError: the calibration or every record is damaged.
        """
        calibration = drive.parent / "calib_imu_to_velo.txt"
        texts = named_texts(calibration)
        rotation = numbers_of(texts.get("R", ""), 9, f"{calibration}, R").reshape(3, 3)
        translation = numbers_of(texts.get("T", ""), 3, f"{calibration}, T")
        folder = drive / "oxts" / "data"
        first = _first_readable(folder)
        return cls(folder, first, rigid_of(rotation, translation, str(calibration)).inverse())

    def world_from_velodyne(self, key: str) -> Rigid:
        """Return the pose of the sweep with this number.

        Raises:
            OSError: its record cannot be read.
            ValueError: its record is damaged.
        """
        return world_from_imu(read_oxts(self.folder / f"{key}.txt"), self.first) @ self.imu_from_velodyne


def _first_readable(folder: Path) -> NDArray[np.float64]:
    problem: Exception = FileNotFoundError(f"{folder}: must hold the records of the inertial unit, got none")
    for file in sorted(folder.glob("*.txt")):
        try:
            return read_oxts(file)
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
    def read(cls, place: Path, calibration: Path) -> CameraTrack:
        """Return the track in a file of poses.

        Raises:
            OSError: a file cannot be read.
            ValueError: the calibration is damaged.
        """
        return cls(place, text_lines(place), rigid_named(calibration, "Tr"))

    def world_from_velodyne(self, key: str) -> Rigid:
        """Return the pose of the sweep with this number, in the LiDAR's frame at the first sweep.

        Raises:
            ValueError: it has no line, or that is damaged.
        """
        number = int(key)
        text = line_of(self.lines, number, self.place)
        first_from_camera = rigid_of_line(text, f"{self.place}, line {number + 1}")
        return self.camera_from_velodyne.inverse() @ first_from_camera @ self.camera_from_velodyne


def posed(ref: SweepRef, pose: Callable[[str], Rigid]) -> Rigid:
    """Return the pose of a ref; errors name the sweep's file too.

    Raises:
        ValueError: it has no pose, or that is damaged.
    """
    try:
        return pose(ref.key)
    except (ValueError, OSError) as error:
        raise ValueError(one_line(f"{ref.file}: has no pose: {error}")) from error
