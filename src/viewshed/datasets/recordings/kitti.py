"""KITTI: raw drives, odometry sequences and the object set, as they are unpacked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from viewshed.datasets.recordings._kitti_boxes import FILE, Tracklets, read_labels
from viewshed.datasets.recordings._kitti_files import (
    CameraTrack,
    InertialTrack,
    pose_of,
    read_frame,
    refs_of,
    sweep_files,
    timed_refs,
    times_of,
)
from viewshed.datasets.recordings.source import ObjectBox, SweepRef, note_damage
from viewshed.geometry import Rigid
from viewshed.io._input import inside
from viewshed.sweep import Sweep

RAW_LAYOUT = "KITTI's drives with velodyne_points/data/"

ODOMETRY_LAYOUT = "KITTI's sequences/*/velodyne/"

OBJECT_LAYOUT = "KITTI's training/velodyne/ or testing/velodyne/"


class KittiRaw:
    """Drives of KITTI raw (synchronized and rectified); see :class:`~viewshed.datasets.recordings.source.SweepSource`.

    The world of a drive is east, north, up from where its first pose was recorded.

    Args:
        place: a drive, a date with its drives, or the folder of the dates.

    Raises:
        ValueError: there is no drive.
    """

    def __init__(self, place: Path) -> None:
        self._damage: list[str] = []
        self._scenes: dict[str, tuple[SweepRef, ...]] = {}
        self._tracks: dict[str, InertialTrack] = {}
        self._tracklets: dict[str, Tracklets | None] = {}
        drives = _drives(place)
        self._root = place.parent if place in drives else place  # calibration lies beside a drive
        for drive in drives:
            files = sweep_files(drive / "velodyne_points" / "data", self._damage)
            stamps = drive / "velodyne_points" / "timestamps.txt"
            times = times_of(self._root, stamps, files, self._damage, seconds=False)
            self._scenes[drive.name] = timed_refs(drive.name, files, times)
            try:
                self._tracks[drive.name] = InertialTrack.read(self._root, drive)
            except (ValueError, OSError) as error:
                note_damage(self._damage, f"{error}; the sweeps of {drive.name} have no poses")
        _check_any(self._scenes, place, RAW_LAYOUT)

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the drives, sorted."""
        return tuple(self._scenes)

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the sweeps of a drive in time order.

        Raises:
            ValueError: there is no such drive.
        """
        return refs_of(self._scenes, scene)

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep with time, beams and height, and its pose unless the whole drive has none.

        Raises:
            ValueError: it or the record of its pose is damaged.
            OSError: one of these files cannot be read.
        """
        return read_frame(self._root, ref, self._pose(ref))

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the objects of the drive's tracklets; None where it has no such file.

        Raises:
            ValueError: the tracklets, or one of this sweep, or its pose are damaged.
            OSError: one of these files cannot be read.
        """
        drive = Path(ref.file).parents[2]
        if ref.scene not in self._tracklets:
            file = drive / FILE
            tracklets = Tracklets.read(inside(self._root, file)) if file.is_file() else None
            self._tracklets[ref.scene] = tracklets
            for problem in () if tracklets is None else tracklets.damage:
                note_damage(self._damage, problem)
        tracklets = self._tracklets[ref.scene]
        return None if tracklets is None else tracklets.of(int(ref.key), self._pose(ref) or Rigid.identity())

    def damage(self) -> tuple[str, ...]:
        """Return one line for each file that is missing or damaged for a whole drive, and for times that are.

        Those of tracklets join them when boxes of their drive are asked for.
        """
        return tuple(self._damage)

    def _pose(self, ref: SweepRef) -> Rigid | None:
        track = self._tracks.get(ref.scene)
        return None if track is None else pose_of(ref, track.world_from_velodyne)


class KittiOdometry:
    """Sequences of KITTI odometry; see :class:`~viewshed.datasets.recordings.source.SweepSource`.

    The world of a sequence is the LiDAR's frame at its first sweep, so its z is only nearly vertical. Times are those
    since the first sweep. Sequences without a file of poses (11 to 21) are read without poses.

    Args:
        place: the folder that holds ``sequences`` and ``poses``.

    Raises:
        ValueError: there is no sequence.
    """

    def __init__(self, place: Path) -> None:
        self._root = place
        self._damage: list[str] = []
        self._scenes: dict[str, tuple[SweepRef, ...]] = {}
        self._tracks: dict[str, CameraTrack] = {}
        for folder in sorted(place.glob("sequences/*/velodyne")):
            sequence = folder.parent
            files = sweep_files(folder, self._damage)
            times = times_of(place, sequence / "times.txt", files, self._damage, seconds=True)
            self._scenes[sequence.name] = timed_refs(sequence.name, files, times)
            poses = _poses_of(place, sequence.name)
            try:
                if poses is not None:
                    self._tracks[sequence.name] = CameraTrack.read(place, poses, sequence / "calib.txt")
            except (ValueError, OSError) as error:
                note_damage(self._damage, f"{error}; the sweeps of sequence {sequence.name} have no poses")
        _check_any(self._scenes, place, ODOMETRY_LAYOUT)

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the sequences, sorted."""
        return tuple(self._scenes)

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the sweeps of a sequence in time order.

        Raises:
            ValueError: there is no such sequence.
        """
        return refs_of(self._scenes, scene)

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep with time, beams and height, and its pose unless the whole sequence has none.

        Raises:
            ValueError: it or its pose is damaged, or the file of poses is too short.
            OSError: its file cannot be read.
        """
        track = self._tracks.get(ref.scene)
        return read_frame(self._root, ref, None if track is None else pose_of(ref, track.world_from_velodyne))

    def boxes(self, ref: SweepRef) -> None:
        """Return None: the set has no annotated objects."""

    def damage(self) -> tuple[str, ...]:
        """Return one line for each file that is missing or damaged for a whole sequence, and for times that are."""
        return tuple(self._damage)


class KittiObject:
    """KITTI's object set, scenes ``training`` and ``testing``; a ``SweepSource``.

    The sweeps of a scene do not belong together: they have neither time nor pose, and the boxes of each are in the
    frame of its sensor.

    Args:
        place: the folder that holds ``training`` or ``testing``.

    Raises:
        ValueError: it holds neither.
    """

    def __init__(self, place: Path) -> None:
        self._place = place
        self._damage: list[str] = []
        self._scenes: dict[str, tuple[SweepRef, ...]] = {}
        for folder in _object_folders(place):
            files = sweep_files(folder, self._damage)
            self._scenes[folder.parent.name] = timed_refs(folder.parent.name, files, [None] * len(files))
        _check_any(self._scenes, place, OBJECT_LAYOUT)

    def scenes(self) -> tuple[str, ...]:
        """Return ``training`` and ``testing``, as far as they are there."""
        return tuple(self._scenes)

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the sweeps of a scene in the order of their numbers.

        Raises:
            ValueError: there is no such scene.
        """
        return refs_of(self._scenes, scene)

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep with beams and height.

        Raises:
            ValueError: it is damaged.
            OSError: its file cannot be read.
        """
        return read_frame(self._place, ref, None)

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the labeled objects in front of the car, in the sensor's frame; None where there are no labels.

        Raises:
            ValueError: the labels or the calibration are damaged.
            OSError: one of these files cannot be read.
        """
        scene = self._place / ref.scene
        if not (scene / "label_2").is_dir():
            return None
        return read_labels(self._place, scene / "label_2" / f"{ref.key}.txt", scene / "calib" / f"{ref.key}.txt")

    def damage(self) -> tuple[str, ...]:
        """Return one line for each file that is no sweep."""
        return tuple(self._damage)


def is_raw(place: Path) -> bool:
    """Return whether a folder holds drives of KITTI raw, or is one."""
    return bool(_drives(place))


def is_odometry(place: Path) -> bool:
    """Return whether a folder holds sequences of KITTI odometry."""
    return any(place.glob("sequences/*/velodyne"))


def is_object(place: Path) -> bool:
    """Return whether a folder holds a part of KITTI's object set."""
    return bool(_object_folders(place))


def _drives(place: Path) -> list[Path]:
    depths = ("", "*/", "*/*/")
    return sorted({data.parents[1] for depth in depths for data in place.glob(f"{depth}velodyne_points/data")})


def _object_folders(place: Path) -> list[Path]:
    folders = (place / name / "velodyne" for name in ("training", "testing"))
    return [folder for folder in folders if folder.is_dir()]


def _poses_of(place: Path, sequence: str) -> Path | None:
    """Return the file of poses: KITTI's, else the one that SemanticKITTI puts into the sequence."""
    candidates = (place / "poses" / f"{sequence}.txt", place / "sequences" / sequence / "poses.txt")
    return next((file for file in candidates if file.is_file()), None)


def _check_any(scenes: dict[str, tuple[SweepRef, ...]], place: Path, layout: str) -> None:
    if not scenes:
        raise ValueError(f"{place}: must hold {layout}, got none")
