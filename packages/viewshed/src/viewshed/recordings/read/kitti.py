"""KITTI: raw drives, odometry sequences and the object set, as they are unpacked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from viewshed.geometry import Rigid
from viewshed.io import read_sweep
from viewshed.io._input import inside
from viewshed.recordings.read._kitti_boxes import FILE, Tracklets, read_labels
from viewshed.recordings.read._kitti_files import PoseTrack, camera_track, inertial_track, times_of
from viewshed.recordings.read.source import ObjectBox, SweepReader, SweepRef, note_damage, numbered, problems_of
from viewshed.sweep import Sweep

SENSOR = "hdl64e"
"""Beam table of KITTI's LiDAR."""

SENSOR_HEIGHT_M = 1.73
"""Height of the LiDAR above the ground (https://www.cvlibs.net/datasets/kitti/setup.php)."""


class _Kitti(SweepReader):
    """What the three layouts share: sweeps named by numbers, with KITTI's beams and height, and perhaps poses."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.scenes: dict[str, tuple[SweepRef, ...]] = {}
        self.problems: list[str] = []
        self._tracks: dict[str, PoseTrack] = {}

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep with beams and height, its time where there is one, its pose unless the scene has none."""
        sweep = read_sweep(
            inside(self.root, ref.file), format="kitti", sensor=SENSOR, sensor_height_m=SENSOR_HEIGHT_M,
            world_from_sensor=self._pose(ref),
        )  # fmt: skip
        return sweep if ref.t_ns is None else sweep.replace(t_ns=ref.t_ns)

    def _add_scene(self, name: str, folder: Path, stamps: Path | None = None, *, seconds: bool = False) -> None:
        """Add the sweeps of a folder, in the order of their times where all have one, else of their numbers."""
        files = numbered(folder.glob("*.bin"), self.problems)
        times: Sequence[int | None] = [None] * len(files)
        if stamps is not None:
            times = times_of(self.root, stamps, files, self.problems, seconds=seconds)
        refs = [SweepRef(name, 0, str(file), t_ns, sensor="velodyne", key=file.stem)
                for file, t_ns in zip(files, times, strict=True)]  # fmt: skip
        if None not in times:
            refs.sort(key=lambda ref: ref.t_ns or 0)
        self.scenes[name] = tuple(replace(ref, index=index) for index, ref in enumerate(refs))

    def _add_poses(self, name: str, what: str, read: Callable[[], PoseTrack]) -> None:
        try:
            self._tracks[name] = read()
        except (ValueError, OSError) as error:
            note_damage(self.problems, f"{error}; the sweeps of {what} have no poses")

    def _pose(self, ref: SweepRef) -> Rigid | None:
        if ref.scene not in self._tracks:
            return None
        with problems_of(f"{ref.file}: has no pose"):
            return self._tracks[ref.scene](ref.key)


class KittiRaw(_Kitti):
    """Drives of KITTI raw (synchronized and rectified): a drive, a date with its drives, or the folder of the dates.

    The world of a drive is east, north, up from where its first pose was recorded. The damage of tracklets joins that
    of the recording when boxes of their drive are first needed.
    """

    def __init__(self, place: Path) -> None:
        drives = drives_in(place)
        super().__init__(place.parent if place in drives else place)  # calibration lies beside a drive
        self._tracklets: dict[str, Tracklets | None] = {}
        for drive in drives:
            points = drive / "velodyne_points"
            self._add_scene(drive.name, points / "data", points / "timestamps.txt")
            self._add_poses(drive.name, drive.name, partial(inertial_track, self.root, drive))

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the objects of the drive's tracklets; None where it has no such file."""
        if ref.scene not in self._tracklets:
            file = Path(ref.file).parents[2] / FILE
            read = Tracklets.read(inside(self.root, file)) if file.is_file() else None
            self._tracklets[ref.scene] = read
            for problem in () if read is None else read.damage:
                note_damage(self.problems, problem)
        tracklets = self._tracklets[ref.scene]
        return None if tracklets is None else tracklets.of(int(ref.key), self._pose(ref) or Rigid.identity())


class KittiOdometry(_Kitti):
    """Sequences of KITTI odometry, in the folder that holds ``sequences`` and ``poses``.

    The world of a sequence is the LiDAR's frame at its first sweep, so its z is only nearly vertical. Times are those
    since the first sweep. Sequences without a file of poses (11 to 21) are read without poses.
    """

    def __init__(self, place: Path) -> None:
        super().__init__(place)
        for folder in sequences_in(place):
            sequence = folder.parent
            self._add_scene(sequence.name, folder, sequence / "times.txt", seconds=True)
            # KITTI's own file of poses, else the one that SemanticKITTI puts into the sequence.
            candidates = (place / "poses" / f"{sequence.name}.txt", sequence / "poses.txt")
            for poses in [file for file in candidates if file.is_file()][:1]:
                what, calibration = f"sequence {sequence.name}", sequence / "calib.txt"
                self._add_poses(sequence.name, what, partial(camera_track, place, poses, calibration))


class KittiObject(_Kitti):
    """KITTI's object set, scenes ``training`` and ``testing``, as far as they are there.

    The sweeps of a scene do not belong together: they have neither time nor pose, and the boxes of each are in the
    frame of its sensor.
    """

    def __init__(self, place: Path) -> None:
        super().__init__(place)
        for folder in parts_in(place):
            self._add_scene(folder.parent.name, folder)

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the labeled objects in front of the car, in the sensor's frame; None where there are no labels."""
        scene = self.root / ref.scene
        if not (scene / "label_2").is_dir():
            return None
        return read_labels(self.root, scene / "label_2" / f"{ref.key}.txt", scene / "calib" / f"{ref.key}.txt")


def drives_in(place: Path) -> list[Path]:
    """Return the drives of KITTI raw at a place, itself perhaps one."""
    depths = ("", "*/", "*/*/")
    return sorted({data.parents[1] for depth in depths for data in place.glob(f"{depth}velodyne_points/data")})


def sequences_in(place: Path) -> list[Path]:
    """Return the folders of sweeps of KITTI odometry."""
    return sorted(place.glob("sequences/*/velodyne"))


def parts_in(place: Path) -> list[Path]:
    """Return the folders of sweeps of KITTI's object set."""
    folders = (place / name / "velodyne" for name in ("training", "testing"))
    return [folder for folder in folders if folder.is_dir()]
