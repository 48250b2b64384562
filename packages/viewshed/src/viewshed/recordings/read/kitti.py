"""Read KITTI: raw drives, odometry sequences and the object set, with their annotated objects."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io import read_sweep
from viewshed.io._input import InputFile, inside, one_line, open_input
from viewshed.recordings.read._kitti_files import (
    PoseTrack,
    camera_track,
    inertial_track,
    named_texts,
    numbers_of,
    rigid_named,
    text_lines,
    times_of,
)
from viewshed.recordings.read.source import ObjectBox, RecordingSource, SweepRef, error_prefix, note_damage, numbered
from viewshed.sweep import Sweep

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

SENSOR = "hdl64e"
"""Beam table of KITTI's LiDAR."""

SENSOR_HEIGHT_M = 1.73
"""Height of the LiDAR above the ground (https://www.cvlibs.net/datasets/kitti/setup.php)."""


class _Kitti(RecordingSource):
    """Base of the three layouts: numbered sweeps with KITTI's beam table and sensor height, and optional poses."""

    def __init__(self, place: Path, root: Path | None = None) -> None:
        self.place, self.root = place, place if root is None else root
        self.sweeps: dict[str, tuple[SweepRef, ...]] = {}
        self.problems: list[str] = []
        self._tracks: dict[str, PoseTrack] = {}

    def _read(self, ref: SweepRef) -> Sweep:
        """Read a sweep with beam table and sensor height, and with time and pose if the scene has them."""
        sweep = read_sweep(
            inside(self.root, ref.file), format="kitti", sensor=SENSOR, sensor_height_m=SENSOR_HEIGHT_M,
            world_from_sensor=self._pose(ref),
        )  # fmt: skip
        return sweep if ref.t_ns is None else sweep.replace(t_ns=ref.t_ns)

    def _add_scene(self, name: str, folder: Path, stamps: Path | None = None, *, seconds: bool = False) -> None:
        """Add the sweeps of a folder, sorted by time if all have one, else by number."""
        files = numbered(folder.glob("*.bin"), self.problems)
        times: Sequence[int | None] = [None] * len(files)
        if stamps is not None:
            times = times_of(self.root, stamps, files, self.problems, seconds=seconds)
        refs = [SweepRef(name, 0, str(file), t_ns, sensor="velodyne", key=file.stem)
                for file, t_ns in zip(files, times, strict=True)]  # fmt: skip
        if None not in times:
            refs.sort(key=lambda ref: ref.t_ns or 0)
        self.sweeps[name] = tuple(replace(ref, index=index) for index, ref in enumerate(refs))

    def _add_poses(self, name: str, what: str, read: Callable[[], PoseTrack]) -> None:
        try:
            self._tracks[name] = read()
        except (ValueError, OSError) as error:
            note_damage(self.problems, f"{error}; the sweeps of {what} have no poses")

    def _pose(self, ref: SweepRef) -> Rigid | None:
        if ref.scene not in self._tracks:
            return None
        with error_prefix(f"{ref.file}: has no pose"):
            return self._tracks[ref.scene](ref.key)


class KittiRaw(_Kitti):
    """Drives of KITTI raw (synchronized and rectified): a drive, a date with its drives, or a folder of dates.

    The world of a drive is east, north, up with its origin at the first pose. Tracklets of a drive are read, and their
    damage reported, when its boxes are first requested.
    """

    def __init__(self, place: Path) -> None:
        drives = drives_in(place)
        super().__init__(place, place.parent if place in drives else place)  # its calibration is in the parent folder
        self._tracklets: dict[str, Tracklets | None] = {}
        for drive in drives:
            points = drive / "velodyne_points"
            self._add_scene(drive.name, points / "data", points / "timestamps.txt")
            self._add_poses(drive.name, drive.name, partial(inertial_track, self.root, drive))

    def _boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the objects of the drive's tracklets; None if it has no such file."""
        if ref.scene not in self._tracklets:
            file = Path(ref.file).parents[2] / TRACKLETS_FILE
            tracklets = Tracklets.read(inside(self.root, file)) if file.is_file() else None
            self._tracklets[ref.scene] = tracklets
            for problem in () if tracklets is None else tracklets.damage:
                note_damage(self.problems, problem)
        tracklets = self._tracklets[ref.scene]
        return None if tracklets is None else tracklets.of(int(ref.key), self._pose(ref) or Rigid.identity())


class KittiOdometry(_Kitti):
    """Sequences of KITTI odometry, in the folder that holds ``sequences`` and ``poses``.

    The world of a sequence is the LiDAR's frame at its first sweep, so its z is only nearly vertical. Times count from
    the first sweep. Sequences without a file of poses (11 to 21) are read without poses.
    """

    def __init__(self, place: Path) -> None:
        super().__init__(place)
        for folder in sequences_in(place):
            sequence = folder.parent
            self._add_scene(sequence.name, folder, sequence / "times.txt", seconds=True)
            # KITTI's file of poses, else that of SemanticKITTI, which is in the folder of the sequence.
            candidates = (place / "poses" / f"{sequence.name}.txt", sequence / "poses.txt")
            for poses in [file for file in candidates if file.is_file()][:1]:
                what, calibration = f"sequence {sequence.name}", sequence / "calib.txt"
                self._add_poses(sequence.name, what, partial(camera_track, place, poses, calibration))


class KittiObject(_Kitti):
    """KITTI's object set: scenes ``training`` and ``testing``, if present.

    Its sweeps are unrelated: they have no time and no pose, and boxes are in the frame of the sensor.
    """

    def __init__(self, place: Path) -> None:
        super().__init__(place)
        for folder in parts_in(place):
            self._add_scene(folder.parent.name, folder)

    def _boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the labeled objects in front of the car, in the sensor's frame; None if there are no labels."""
        scene = self.root / ref.scene
        if not (scene / "label_2").is_dir():
            return None
        return read_labels(self.root, scene / "label_2" / f"{ref.key}.txt", scene / "calib" / f"{ref.key}.txt")


def drives_in(place: Path) -> list[Path]:
    """Return the drives of KITTI raw at a place: itself, or folders up to two levels below."""
    depths = ("", "*/", "*/*/")
    return sorted({data.parents[1] for depth in depths for data in place.glob(f"{depth}velodyne_points/data")})


def sequences_in(place: Path) -> list[Path]:
    """Return the folders of sweeps of KITTI odometry."""
    return sorted(place.glob("sequences/*/velodyne"))


def parts_in(place: Path) -> list[Path]:
    """Return the folders of sweeps of KITTI's object set."""
    folders = (place / name / "velodyne" for name in ("training", "testing"))
    return [folder for folder in folders if folder.is_dir()]


TRACKLETS_FILE = "tracklet_labels.xml"
"""Name of the tracklets file, in the folder of the drive."""

_IGNORED = "DontCare"
_LABEL_NUMBERS = 14
_MAX_BYTES = 64_000_000
_MAX_ELEMENTS = 500_000  # 1000 sweeps with 30 objects each have 400,000
_MAX_DEPTH = 16
_SIZE = ("l", "w", "h")
_POSE = ("tx", "ty", "tz", "rz")


def velodyne_from_camera(root: Path, calibration: Path) -> Rigid:
    """Return the transform from the rectified camera (x right, y down, z forward) to the LiDAR.

    It is the inverse of ``R0_rect * Tr_velo_to_cam``, as in the readme of KITTI's development kit.
    """
    texts = named_texts(root, calibration)
    where = f"{calibration}, R0_rect"
    with error_prefix(where):
        rectification = Rigid(numbers_of(texts.get("R0_rect", ""), 9, where).reshape(3, 3), np.zeros(3))
    return (rectification @ rigid_named(root, calibration, "Tr_velo_to_cam")).inverse()


def read_labels(root: Path, labels: Path, calibration: Path) -> tuple[ObjectBox, ...]:
    """Return the labeled objects in the LiDAR's frame; regions marked ``DontCare`` are left out."""
    if labels.is_file() and labels.stat().st_size == 0:  # a frame without objects
        return ()
    frame = velodyne_from_camera(root, calibration)
    lines = ((f"{labels}, line {number + 1}", line) for number, line in enumerate(text_lines(root, labels)))
    return tuple(_box(line, where, frame) for where, line in lines if line.strip() and not line.startswith(_IGNORED))


def _box(line: str, where: str, velodyne_from_camera: Rigid) -> ObjectBox:
    """Parse a label: type, truncated, occluded, alpha, 4 image coordinates, height, width, length, x, y, z, ry.

    (x, y, z) is the center of the bottom in the camera's frame, ry the rotation about its y axis, which points down.
    """
    category, _, rest = line.partition(" ")
    *_, height, width, length, x, y, z, ry = numbers_of(rest, _LABEL_NUMBERS, where)
    c, s = np.cos(ry), np.sin(ry)
    camera_from_box = Rigid(np.array([[c, s, 0.0], [0.0, 0.0, -1.0], [-s, c, 0.0]]), np.array([x, y - height / 2.0, z]))
    with error_prefix(where):
        return ObjectBox(velodyne_from_camera @ camera_from_box, (length, width, height), category)


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """One object over time."""

    name: str  # number in the file
    category: str  # object type
    size_m: tuple[float, float, float]  # length, width, height
    first: int  # frame of its first pose
    # (F, 4) float64: center of the bottom in the LiDAR's frame, meters, and heading; NaN if damaged
    poses: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Tracklets:
    """The objects of one drive, read by :meth:`read`."""

    place: Path  # the file
    tracks: tuple[_Track, ...]  # its objects
    damage: tuple[str, ...]  # one line for each dropped object, and for each with another number of poses than stated

    @classmethod
    def read(cls, place: Path) -> Tracklets:
        """Read the objects in an XML file of tracklets."""
        tracks: list[_Track] = []
        damage: list[str] = []
        with open_input(place) as source:
            for number, item in enumerate(_items(source)):
                where = f"{place}, tracklet {number}"
                try:
                    tracks.append(_track(item, str(number), where))
                except ValueError as error:
                    note_damage(damage, f"{error}; it is left out")
                    continue
                claimed, count = item.findtext("poses/count", "").strip(), len(tracks[-1].poses)
                if claimed != str(count):
                    note_damage(damage, f"{where}: must have as many poses as its count, {claimed!r}, got {count}")
        return cls(place, tuple(tracks), tuple(damage))

    def of(self, frame: int, world_from_velodyne: Rigid) -> tuple[ObjectBox, ...]:
        """Return the objects of sweep number ``frame``, in the world."""
        return tuple(
            self._box(track, frame, world_from_velodyne)
            for track in self.tracks
            if 0 <= frame - track.first < len(track.poses)
        )

    def _box(self, track: _Track, frame: int, world_from_velodyne: Rigid) -> ObjectBox:
        """Return one object; z is at the bottom, as in ``run_demoTracklets.m`` of the development kit."""
        x, y, z, yaw = track.poses[frame - track.first].tolist()
        with error_prefix(f"{self.place}, tracklet {track.name}, frame {frame}"):
            velodyne_from_box = Rigid.from_yaw(yaw, (x, y, z + track.size_m[2] / 2))
            return ObjectBox(world_from_velodyne @ velodyne_from_box, track.size_m, track.category, track.name)


def _items(source: InputFile) -> Iterator[Element]:
    """Yield the tracklets of a file one by one, to limit memory."""
    from xml.etree import ElementTree

    content = source.content(_MAX_BYTES)
    if b"<!ENTITY" in content or b"\0" in content:  # entities can expand without limit; UTF-16 could hide them
        raise ValueError("must be XML without entities of its own")
    path: list[Element] = []
    elements = 0
    any_tracklets = False
    try:
        for event, element in ElementTree.iterparse(io.BytesIO(content), ("start", "end")):
            if event == "start":
                path.append(element)
                elements += 1
                if len(path) > _MAX_DEPTH or elements > _MAX_ELEMENTS:
                    raise ValueError(f"must have at most {_MAX_ELEMENTS} elements, {_MAX_DEPTH} deep")
                continue
            path.pop()
            tags = [parent.tag for parent in path[1:]]
            any_tracklets |= tags == [] and element.tag == "tracklets"
            if tags == ["tracklets"] and element.tag == "item":
                yield element
            if path and tags in ([], ["tracklets"]):
                path[-1].remove(element)
    except (ElementTree.ParseError, LookupError) as error:
        raise ValueError(f"must be XML: {error}") from error
    if not any_tracklets:
        raise ValueError("must hold tracklets, got none")


def _track(item: Element, name: str, where: str) -> _Track:
    length, width, height = numbers_of(_texts(item, _SIZE), len(_SIZE), f"{where}, l w h").tolist()
    if min(length, width, height) <= 0:
        raise ValueError(f"{where}: l, w and h must be positive, got {length:g}, {width:g}, {height:g}")
    first = item.findtext("first_frame", "").strip()
    if not (first.isascii() and first.isdecimal()) or len(first) > len("4294967295"):
        raise ValueError(one_line(f"{where}: first_frame must be the number of a frame, got {first[:40]!r}"))
    poses = [_pose(pose) for pose in item.findall("poses/item")]
    if not poses:
        raise ValueError(f"{where}: must have at least one pose, got none")
    category = item.findtext("objectType", "").strip()
    return _Track(name, category, (length, width, height), int(first), np.array(poses, np.float64))


def _pose(item: Element) -> NDArray[np.float64]:
    """Return x, y, z and heading (4,); all NaN if one is damaged."""
    try:
        return numbers_of(_texts(item, _POSE), len(_POSE), "")
    except ValueError:
        return np.full(len(_POSE), np.nan)


def _texts(item: Element, names: tuple[str, ...]) -> str:
    """Return the texts of some child elements, joined by blanks; ``?`` if a text is not a single word."""
    texts = (item.findtext(name, "").split() for name in names)
    return " ".join(words[0] if len(words) == 1 else "?" for words in texts)
