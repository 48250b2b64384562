"""KITTI's trees, written here with poses that are known, come back as what was written."""

import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io import read_sweep
from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import SweepSource, each_sweep

DRIVE = "2011_09_26_drive_0001_sync"
EARTH_M = 6378137.0
LATITUDE, LONGITUDE, ALTITUDE_M = 49.015, 8.434, 116.4
IMU_FROM_VELO = Rigid.from_yaw(0.02, (0.81, -0.32, 0.80))
CAMERA_FROM_VELO = Rigid(
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), np.array([-0.01, -0.06, -0.33])
)


def made(seed: int, count: int = 200) -> bytes:
    rng = np.random.default_rng(seed)
    return rng.normal((12, 3, -1, 0.4), (6, 4, 0.5, 0.1), (count, 4)).astype("<f4").tobytes()


def numbers(array: NDArray[np.float64]) -> str:
    return " ".join(map(repr, array.ravel().tolist()))


TR = numbers(CAMERA_FROM_VELO.as_matrix()[:3])


def oxts_line(world_from_imu: Rigid) -> str:
    """The record of a pose (east, north, up; meters from LATITUDE, LONGITUDE), by Mercator's formulas turned over."""
    east, north, up = world_from_imu.translation
    scale = np.cos(np.radians(LATITUDE)) * EARTH_M
    north0 = scale * np.arcsinh(np.tan(np.radians(LATITUDE)))
    latitude = np.degrees(np.arctan(np.sinh((north0 + north) / scale)))
    r = world_from_imu.rotation
    place = latitude, LONGITUDE + np.degrees(east / scale), ALTITUDE_M + up
    turn = np.arctan2(r[2, 1], r[2, 2]), -np.arcsin(r[2, 0]), np.arctan2(r[1, 0], r[0, 0])
    return " ".join(f"{number:.15g}" for number in (*place, *turn, *[0.0] * 24)) + "\n"


def write_raw(root: Path, sweeps: list[tuple[int, bytes, Rigid]], imu_from_velo: Rigid = IMU_FROM_VELO) -> Path:
    """Write a drive: (number, content, world_from_velodyne); the IMU of the first is at the origin of the world."""
    drive = root / "2011_09_26" / DRIVE
    (drive / "velodyne_points" / "data").mkdir(parents=True)
    (drive / "oxts" / "data").mkdir(parents=True)
    for number, content, pose in sweeps:
        (drive / "velodyne_points" / "data" / f"{number:010d}.bin").write_bytes(content)
        (drive / "oxts" / "data" / f"{number:010d}.txt").write_text(oxts_line(pose @ imu_from_velo.inverse()))
    count = max(number for number, _, _ in sweeps) + 1
    times = "".join(f"2011-09-26 13:02:{25 + k // 10}.{k % 10}6438944{k % 7}\n" for k in range(count))
    (drive / "velodyne_points" / "timestamps.txt").write_text(times)
    velo = imu_from_velo.inverse()
    calibration = f"calib_time: 25-May-2012 16:47:16\nR: {numbers(velo.rotation)}\nT: {numbers(velo.translation)}\n"
    (drive.parent / "calib_imu_to_velo.txt").write_text(calibration)
    return drive


def raw_worlds(count: int) -> list[Rigid]:
    """Poses of the LiDAR on a left bend, with a nodding car; the IMU starts at the origin."""

    def imu(k: int) -> Rigid:
        c, s = np.cos(0.02 * k), np.sin(0.02 * k)
        nod = Rigid(np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]), np.zeros(3))
        return Rigid.from_yaw(2.0 + 0.1 * k, (-3.0 * k, 1.5 * k, 0.1 * k)) @ nod

    return [imu(k) @ IMU_FROM_VELO for k in range(count)]


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_raw(tmp_path, [(k, made(k), pose) for k, pose in enumerate(raw_worlds(4))])


def lines_of(source: SweepSource) -> tuple[list[str], list[str]]:
    """Keys of what could be read, and the lines told."""
    told: list[str] = []
    keys = [ref.key for ref, _ in each_sweep(source, on_damage=lambda scene, line: told.append(f"{scene}|{line}"))]
    assert not any("\n" in line for line in told)
    return keys, told


def _same(pose: Rigid | None, expected: Rigid, atol: float) -> None:
    np.testing.assert_allclose(pose.as_matrix(), expected.as_matrix(), atol=atol)


@pytest.mark.parametrize("up", [0, 1, 2])
def test_a_drive_comes_back_with_poses_and_times(up: int, drive: Path) -> None:
    source = open_source([drive, *drive.parents][up])
    assert source.scenes() == (DRIVE,)
    refs = source.refs(DRIVE)
    assert [ref.key for ref in refs] == [f"{k:010d}" for k in range(4)]
    start_ns = 1_317_042_145 * 1_000_000_000  # 2011-09-26 13:02:25 UTC
    assert [ref.t_ns for ref in refs] == [start_ns + k * 100_000_000 + 64_389_440 + k for k in range(4)]
    for ref, pose in zip(refs, raw_worlds(4), strict=True):
        sweep = source.read(ref)
        assert np.array_equal(sweep.points, read_sweep(ref.file).points)
        assert sweep.t_ns == ref.t_ns
        assert sweep.sensor_height_m == 1.73
        assert sweep.model.name == "HDL-64E"
        _same(sweep.world_from_sensor, pose, 1e-6)
        assert source.boxes(ref) is None
    assert source.damage() == ()


def test_times_do_not_depend_on_where_the_computer_is(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    times = [ref.t_ns for ref in open_source(drive).refs(DRIVE)]
    monkeypatch.setenv("TZ", "America/St_Johns")
    time.tzset()
    try:
        assert [ref.t_ns for ref in open_source(drive).refs(DRIVE)] == times
    finally:
        monkeypatch.undo()
        time.tzset()


def test_the_record_of_a_sweep_is_that_of_its_number(tmp_path: Path) -> None:
    """As in drive 0009, sweeps are missing in the middle, records are not."""
    poses = raw_worlds(6)
    drive = write_raw(tmp_path, [(k, made(k), pose) for k, pose in enumerate(poses)])
    for k in (2, 3):
        (drive / "velodyne_points" / "data" / f"{k:010d}.bin").unlink()
    found = list(each_sweep(open_source(tmp_path)))
    for (ref, sweep), k in zip(found, (0, 1, 4, 5), strict=True):
        assert ref.key == f"{k:010d}"
        assert ref.t_ns % 10**9 == k * 100_000_000 + 64_389_440 + k
        _same(sweep.world_from_sensor, poses[k], 1e-6)


def _cut(name: str, keep: int) -> Callable[[Path], object]:
    return lambda drive: (drive / name).write_bytes((drive / name).read_bytes()[:keep])


def _put(name: str, text: str) -> Callable[[Path], object]:
    return lambda drive: (drive / name).write_text(text)


OXTS = "oxts/data/0000000001.txt"


def _drop(name: str) -> Callable[[Path], object]:
    return lambda drive: (drive / name).unlink()


@pytest.mark.parametrize(
    ("damage", "line"),
    [
        (_cut("velodyne_points/data/0000000001.bin", 77), r"0001.bin: must hold rows of 4 float32"),
        (_drop(OXTS), r"0001.bin: has no pose: .*oxts/data/0000000001.txt: No such file"),
        (_put(OXTS, "49.0 8.4 x 0 0 0"), r"0001.bin: has no pose: .*0001.txt: must be 6 finite numbers"),
        (_put(OXTS, "49.0 8.4"), r"0001.bin: has no pose: .*0001.txt: must be 6 finite numbers"),
        (_put(OXTS, "90.0 8 1 0 0 0"), r"0001.bin: has no pose: .*0001.txt: latitude must lie in"),
        (_cut(OXTS, 0), r"0001.bin: has no pose: .*0001.txt: the file is empty"),
    ],
)
def test_a_damaged_file_of_a_drive_costs_one_sweep(damage: Callable[[Path], object], line: str, drive: Path) -> None:
    damage(drive)
    keys, [told] = lines_of(open_source(drive))
    assert [int(key) for key in keys] == [0, 2, 3]
    assert re.search(rf"^{DRIVE}\|.*{line}", told), told


@pytest.mark.parametrize(
    ("damage", "line"),
    [
        (_drop("../calib_imu_to_velo.txt"), r"calib_imu_to_velo.txt: No such file.*; the sweeps of .* have no poses"),
        (_put("../calib_imu_to_velo.txt", "R: 1 0 0"), r"calib_imu_to_velo.txt, R: must be 9 finite numbers"),
        (_put("../calib_imu_to_velo.txt", "R: 2 0 0 0 1 0 0 0 1\nT: 1 2 3"), r"velo.txt: rotation must be orthonormal"),
        (lambda drive: [file.unlink() for file in (drive / "oxts/data").iterdir()], r"oxts/data: must hold the recor"),
    ],
)
def test_a_drive_without_what_all_its_poses_need_is_read_without_poses(
    damage: Callable[[Path], object], line: str, drive: Path
) -> None:
    damage(drive)
    source = open_source(drive)
    assert [sweep.world_from_sensor for _, sweep in each_sweep(source)] == [None] * 4
    [told] = source.damage()
    assert re.search(line, told), told


def test_times_that_are_missing_damaged_or_out_of_order_are_told(drive: Path) -> None:
    place = drive / "velodyne_points" / "timestamps.txt"
    first, second, third, fourth = place.read_text().splitlines()
    place.write_text("\n".join([first, third, second, fourth]))
    source = open_source(drive)
    assert [int(ref.key) for ref in source.refs(DRIVE)] == [0, 2, 1, 3]
    assert re.search(r"timestamps.txt: times must ascend, \d+ ns is not after", source.damage()[0])
    place.write_text("\n".join([first, "noon", third]))
    source = open_source(drive)
    assert [ref.t_ns is None for ref in source.refs(DRIVE)] == [False, True, False, True]
    assert [int(ref.key) for ref in source.refs(DRIVE)] == [0, 1, 2, 3]
    assert "timestamps.txt: must be dates and times, got 'noon'; that sweep has no time" in source.damage()[0]
    assert "timestamps.txt: has 3 lines, none for sweep 3; that sweep has no time" in source.damage()[1]
    place.unlink()
    source = open_source(drive)
    assert {ref.t_ns for ref in source.refs(DRIVE)} == {None}
    assert re.search(r"timestamps.txt: No such file.*; the sweeps have no times", source.damage()[0])


# Odometry


def write_odometry(root: Path, sweeps: list[tuple[int, bytes, Rigid]], lines: int) -> Path:
    """Write sequence 00; a line of poses and times for each number below ``lines``."""
    sequence = root / "sequences" / "00"
    (sequence / "velodyne").mkdir(parents=True)
    (root / "poses").mkdir()
    poses = {number: CAMERA_FROM_VELO @ pose @ CAMERA_FROM_VELO.inverse() for number, _, pose in sweeps}
    for number, content, _ in sweeps:
        (sequence / "velodyne" / f"{number:06d}.bin").write_bytes(content)
    text = [numbers(poses.get(number, Rigid.identity()).as_matrix()[:3]) + "\n" for number in range(lines)]
    (root / "poses" / "00.txt").write_text("".join(text))
    (sequence / "times.txt").write_text("".join(f"{0.1 * number:e}\n" for number in range(lines)))
    (sequence / "calib.txt").write_text(f"P0: 7.1e+02 0 6.0e+02 0 0 7.1e+02 1.8e+02 0 0 0 1 0\nTr: {TR}\n")
    return sequence


ODOMETRY = [Rigid.from_yaw(0.1 * k, (2.0 * k, 0.3 * k, 0.05 * k)) for k in range(4)]


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    return write_odometry(tmp_path, [(k, made(k), pose) for k, pose in enumerate(ODOMETRY)], 4)


def test_a_sequence_comes_back_in_the_frame_of_its_first_sweep(sequence: Path) -> None:
    source = open_source(sequence.parents[1])
    assert source.scenes() == ("00",)
    found = list(each_sweep(source))
    assert [ref.t_ns for ref, _ in found] == [0, 100_000_000, 200_000_000, 300_000_000]
    for (ref, sweep), pose in zip(found, ODOMETRY, strict=True):
        _same(sweep.world_from_sensor, pose, 1e-9)
        assert np.array_equal(sweep.points, read_sweep(ref.file).points)
        assert source.boxes(ref) is None
    assert source.damage() == ()


def test_poses_that_are_missing_or_damaged_are_told(sequence: Path) -> None:
    root = sequence.parents[1]
    place = root / "poses" / "00.txt"
    lines = place.read_text().splitlines()
    place.write_text("\n".join([lines[0], "1 0 0 0 0 1", lines[2]]))
    keys, told = lines_of(open_source(root))
    assert [int(key) for key in keys] == [0, 2]
    assert re.search(r"^00\|.*000001.bin: has no pose: .*poses/00.txt, line 2: must be 12 finite numbers", told[0])
    assert re.search(r"^00\|.*000003.bin: has no pose: .*poses/00.txt: has 3 lines, none for sweep 3", told[1])
    (sequence / "calib.txt").write_text("P0: 1 2 3\n")
    keys, [line] = lines_of(open_source(root))
    assert len(keys) == 4
    assert re.search(r"calib.txt: must have a line Tr: …, got P0; the sweeps of sequence 00 have no poses", line)
    place.unlink()  # as in sequences 11 to 21: nothing is wrong
    assert lines_of(open_source(root)) == (["000000", "000001", "000002", "000003"], [])


def test_a_file_that_is_named_by_no_number_is_told(sequence: Path) -> None:
    (sequence / "velodyne" / "copy.bin").write_bytes(made(0))
    keys, [line] = lines_of(open_source(sequence.parents[1]))
    assert len(keys) == 4
    assert "copy.bin: must be named by a number" in line


# Objects


def write_objects(root: Path, contents: dict[str, bytes]) -> Path:
    """Write the training part: one car and a region without labels in front of each sweep."""
    part = root / "training"
    for name in ("velodyne", "calib", "label_2"):
        (part / name).mkdir(parents=True)
    for key, content in contents.items():
        (part / "velodyne" / f"{key}.bin").write_bytes(content)
        (part / "calib" / f"{key}.txt").write_text(f"P2: 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {TR}\n\n")
        (part / "label_2" / f"{key}.txt").write_text(
            "Car 0.00 0 -1.58 587.01 173.33 614.12 200.12 1.65 1.67 3.64 -0.65 1.71 46.70 -1.2707963267948966\n"
            "DontCare -1 -1 -10 503.89 169.71 590.61 190.13 -1 -1 -1 -1000 -1000 -1000 -10\n"
        )
    return part


def test_a_label_is_a_box_in_the_sensors_frame(tmp_path: Path) -> None:
    """By hand: camera (x right, y down, z ahead) to sensor, with the camera 0.33 m ahead, 0.06 below, 0.01 left."""
    write_objects(tmp_path, {"000007": made(7)})
    source = open_source(tmp_path)
    [ref] = source.refs("training")
    [car] = source.boxes(ref)
    assert (car.category, car.size_m, car.track) == ("Car", (3.64, 1.67, 1.65), None)
    np.testing.assert_allclose(car.center, [46.70 + 0.33, 0.65 - 0.01, -(1.71 - 1.65 / 2 + 0.06)], atol=1e-9)
    assert car.yaw == pytest.approx(-0.3)  # -π/2 is straight ahead; more of ry is further to the right
    np.testing.assert_allclose(car.world_from_box.rotation[:, 2], [0.0, 0.0, 1.0], atol=1e-9)
    sweep = source.read(ref)
    assert sweep.world_from_sensor is None
    assert sweep.t_ns is None


@pytest.mark.parametrize(
    ("damage", "line"),
    [
        (_drop("label_2/000001.txt"), r"label_2/000001.txt: No such file"),
        (_put("label_2/000001.txt", "Car 0 0 0 1 2\n"), r"label_2/000001.txt, line 1: must be 14 finite numbers"),
        (_put("label_2/000001.txt", "Car" + " 0" * 14), r"label_2/000001.txt, line 1: size_m must be three positive"),
        (_put("calib/000001.txt", "R0_rect: 1 0 0 0 1 0 0 0 1\n"), r"000001.txt: must have a line Tr_velo_to_cam"),
        (_put("calib/000001.txt", "Tr_velo_to_cam: 1 0\n"), r"calib/000001.txt, R0_rect: must be 9 finite numbers"),
    ],
)
def test_damaged_labels_are_told_and_others_are_read(
    damage: Callable[[Path], object], line: str, tmp_path: Path
) -> None:
    damage(write_objects(tmp_path, {"000000": made(0), "000001": made(1)}))
    source = open_source(tmp_path)
    good, bad = source.refs("training")
    with pytest.raises((ValueError, OSError), match=line):
        source.boxes(bad)
    assert len(source.boxes(good) or ()) == 1
    assert len(source.read(bad)) == 200


def test_a_frame_without_objects_and_one_without_labels_differ(tmp_path: Path) -> None:
    part = write_objects(tmp_path, {"000000": made(0)})
    (part / "label_2" / "000000.txt").write_text("")
    (tmp_path / "testing" / "velodyne").mkdir(parents=True)
    (tmp_path / "testing" / "velodyne" / "000003.bin").write_bytes(made(3))
    source = open_source(tmp_path)
    assert source.scenes() == ("training", "testing")
    assert source.boxes(source.refs("training")[0]) == ()
    assert source.boxes(source.refs("testing")[0]) is None


# Tracklets


def tracklet(
    first: object, poses: list[str], size: str = "<h>1.5</h><w>1.8</w><l>4.4</l>", count: object = None
) -> str:
    """One object as KITTI writes it; a pose is ``tx ty tz rz``."""
    names = ("tx", "ty", "tz", "rz")
    items = "".join(
        f"<item>{''.join(f'<{n}>{v}</{n}>' for n, v in zip(names, pose.split(), strict=True))}<state>2</state></item>"
        for pose in poses
    )
    told = len(poses) if count is None else count
    return (
        f"<item><objectType>Car</objectType>{size}<first_frame>{first}</first_frame>"
        f"<poses><count>{told}</count><item_version>2</item_version>{items}</poses><finished>1</finished></item>"
    )


def write_tracklets(drive: Path, *tracklets: str) -> Path:
    head = '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
    inside = f"<count>{len(tracklets)}</count><item_version>1</item_version>{''.join(tracklets)}"
    place = drive / "tracklet_labels.xml"
    place.write_text(f"{head}<boost_serialization><tracklets>{inside}</tracklets></boost_serialization>\n")
    return place


def test_tracklets_stand_on_the_ground_of_the_world_in_their_own_frames(drive: Path) -> None:
    """By hand: 10 m ahead of the LiDAR and 2 m left, its bottom 1.7 m below, turned a quarter to the left."""
    write_tracklets(drive, tracklet(1, ["10 2 -1.7 1.5707963", "11 2 -1.7 1.5707963"]), tracklet(2, ["-5 0 -1.6 0"]))
    source = open_source(drive)
    boxes = [source.boxes(ref) for ref in source.refs(DRIVE)]
    assert [[box.track for box in some or ()] for some in boxes] == [[], ["0"], ["0", "1"], []]
    assert boxes[0] == ()
    [box] = boxes[1] or ()
    pose = raw_worlds(2)[1]
    np.testing.assert_allclose(box.center, pose @ np.array([10.0, 2.0, -1.7 + 0.75]), atol=1e-5)
    np.testing.assert_allclose(box.world_from_box.rotation[:, 0], pose.rotation[:, 1], atol=1e-5)  # heads left
    assert (box.size_m, box.category) == ((4.4, 1.8, 1.5), "Car")
    assert source.damage() == ()


def test_tracklets_of_a_drive_without_poses_are_in_the_sensors_frame(drive: Path) -> None:
    (drive.parent / "calib_imu_to_velo.txt").unlink()
    write_tracklets(drive, tracklet(0, ["10 2 -1.7 0.5"]))
    source = open_source(drive)
    [box] = source.boxes(source.refs(DRIVE)[0]) or ()
    np.testing.assert_allclose(box.center, [10.0, 2.0, -0.95])
    assert box.yaw == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("bad", "line"),
    [
        (tracklet("soon", ["1 2 3 0"]), r"tracklet 0: first_frame must be the number .*, got 'soon'; it is left out$"),
        (tracklet(-1, ["1 2 3 0"]), r"tracklet 0: first_frame must be the number of a frame, got '-1'"),
        (tracklet(0, ["1 2 3 0"], "<h>1</h><w>0</w><l>4</l>"), r"tracklet 0: l, w and h must be positive, got 4, 0, 1"),
        (tracklet(0, ["1 2 3 0"], "<h>1.5</h><w>x</w>"), r"tracklet 0, l w h: must be 3 finite numbers"),
        (tracklet(0, []), r"tracklet 0: must have at least one pose, got none; it is left out"),
        ("<item><finished>1</finished></item>", r"tracklet 0, l w h: must be 3 finite numbers"),
    ],
)  # fmt: skip
def test_a_damaged_tracklet_is_told_and_the_others_stay(bad: str, line: str, drive: Path) -> None:
    write_tracklets(drive, bad, tracklet(0, ["10 2 -1.7 0"]))
    source = open_source(drive)
    assert source.damage() == ()
    assert [box.track for box in source.boxes(source.refs(DRIVE)[0]) or ()] == ["1"]
    [told] = source.damage()
    assert re.search(rf"tracklet_labels.xml, {line}", told), told
    assert "\n" not in told


def test_poses_that_are_missing_are_told_and_a_damaged_one_costs_its_frame(drive: Path) -> None:
    write_tracklets(drive, tracklet(0, ["10 2 -1.7 0", "11 2 east 0", "12 2 -1.7 0"], count=5))
    source = open_source(drive)
    first, second, third, fourth = source.refs(DRIVE)
    assert len(source.boxes(first) or ()) == 1
    with pytest.raises(ValueError, match=r"tracklet_labels.xml, tracklet 0, frame 1: [^\n]*finite"):
        source.boxes(second)
    assert len(source.boxes(third) or ()) == 1
    assert source.boxes(fourth) == ()
    [line] = source.damage()
    assert line.endswith("tracklet 0: must have as many poses as its count, '5', got 3")


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", r"the file is empty"),
        (b"<boost_serialization><tracklets><item>", r"must be XML: no element found"),
        (b"\xff\xfe\x00nothing", r"must be XML"),
        (b"<boost_serialization></boost_serialization>", r"must hold tracklets, got none"),
        (b'<!DOCTYPE a [<!ENTITY b "bb">]><a>&b;</a>', r"must be XML without entities of its own"),
    ],
)
def test_a_broken_file_of_tracklets_costs_the_boxes_alone(content: bytes, line: str, drive: Path) -> None:
    (drive / "tracklet_labels.xml").write_bytes(content)
    source = open_source(drive)
    assert len(lines_of(source)[0]) == 4
    with pytest.raises(ValueError, match=rf"^[^\n]*tracklet_labels.xml: {line}[^\n]*$"):
        source.boxes(source.refs(DRIVE)[0])
