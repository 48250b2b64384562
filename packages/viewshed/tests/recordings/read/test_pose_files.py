"""Poses in a file of their own: KITTI's and TUM's text, by number and by time, and what is said of wrong ones."""

from pathlib import Path

import numpy as np
import pytest

from viewshed.geometry import Rigid
from viewshed.recordings.read.pose_files import PoseFile, time_in_name
from viewshed.sweep import Sweep

SWEEP = Sweep(np.array([[5.0, 1.0, -1.0]]))
S = 1_000_000_000


def kitti(*poses: Rigid) -> str:
    return "\n".join(" ".join(f"{value:.9e}" for value in pose.as_matrix()[:3].ravel()) for pose in poses)


def at(x_m: float) -> Rigid:
    return Rigid.from_yaw(0.1 * x_m, (x_m, 2.0, 0.5))


def written(folder: Path, text: str, name: str = "poses.txt") -> Path:
    place = folder / name
    place.write_text(text)
    return place


def test_kitti_poses_are_taken_by_the_numbers_of_the_files(tmp_path: Path) -> None:
    poses = PoseFile.read(written(tmp_path, "# mine\n" + kitti(*map(at, range(8)))))
    files = [tmp_path / f"{number:06}.bin" for number in (2, 7)]
    placed = [poses.place_sweep(SWEEP, file, 0, files) for file in files]
    placed += [poses.place_sweep(SWEEP, file, 0, [file]) for file in files]  # alone as well
    for sweep, number in zip(placed, (2, 7, 2, 7), strict=True):
        np.testing.assert_allclose(sweep.world_from_sensor.as_matrix(), at(number).as_matrix(), atol=1e-8)
        assert sweep.t_ns == number * S // 10
    assert any("0.1 s apart" in line for line in poses.notes)


def test_kitti_poses_are_taken_by_order_where_names_are_no_numbers(tmp_path: Path) -> None:
    written(tmp_path, "0.0\n0.5\n", "times.txt")
    poses = PoseFile.read(written(tmp_path, kitti(at(0), at(1))))
    files = [tmp_path / "a.pcd", tmp_path / "b.pcd"]
    second = poses.place_sweep(SWEEP, files[1], 0, files)  # whether the first could be read or not
    assert second.world_from_sensor.translation.tolist() == pytest.approx([1.0, 2.0, 0.5])
    assert second.t_ns == S // 2
    with pytest.raises(ValueError, match=r"b\.pcd holds several sweeps, .* must have one line for each file"):
        poses.place_sweep(SWEEP, files[1], 1, files)
    assert poses.place_sweep(SWEEP, Path("0.pcap"), 1, [Path("0.pcap")]).t_ns == S // 2, "a capture's second sweep"


def test_the_calibration_of_kitti_moves_camera_poses_to_the_sensor(tmp_path: Path) -> None:
    # The camera looks along z with y down: a drive of 3 m ahead is 3 m of z there, and 3 m of x of the sensor.
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    camera_from_sensor = Rigid(turn, np.array([0.1, -0.2, -0.3]))
    written(tmp_path, "P0: 1\nTr: " + kitti(camera_from_sensor), "calib.txt")
    poses = PoseFile.read(written(tmp_path, kitti(Rigid.identity(), Rigid(np.eye(3), np.array([0.0, 0.0, 3.0])))))
    np.testing.assert_allclose(poses.poses[1].translation, [3.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(poses.poses[1].rotation, np.eye(3), atol=1e-6)


def test_tum_poses_are_matched_by_time_and_interpolated(tmp_path: Path) -> None:
    half = np.sqrt(0.5)
    text = f"1000000000.0 0 0 0 0 0 0 1\n1000000001.0 4 2 0 0 0 {half} {half}\n"
    poses = PoseFile.read(written(tmp_path, text))
    files = [tmp_path / "x.pcd"]
    placed = poses.place_sweep(SWEEP.replace(t_ns=1_000_000_000 * S + S // 4), files[0], 0, files)
    np.testing.assert_allclose(placed.world_from_sensor.translation, [1.0, 0.5, 0.0], atol=1e-6)
    assert placed.world_from_sensor.yaw == pytest.approx(np.pi / 8)
    # A file's own name tells the time where the sweep does not.
    named = poses.place_sweep(SWEEP, tmp_path / "lidar_1000000001000000.pcd", 0, files)
    assert named.t_ns == 1_000_000_001 * S
    assert named.world_from_sensor.translation.tolist() == pytest.approx([4.0, 2.0, 0.0])


@pytest.mark.parametrize(
    ("name", "t_ns"),
    [
        ("1532402927647951.bin", 1_532_402_927_647_951_000), ("1532402927.bin", 1_532_402_927 * S),
        ("315966265259836000.feather", None), ("1614315746471294674_0.pcd", 1_614_315_746_471_294_674),
        ("1700000000_5.pcd", 1_700_000_000 * S + S // 2), ("000042.bin", None), ("a.pcd", None),
    ],
)  # fmt: skip
def test_times_in_names(name: str, t_ns: int | None) -> None:
    assert time_in_name(name) == t_ns


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("# only words\n", "must have poses, got no line with numbers"),
        ("1 2 3\n", r"line 1 must have 12 numbers \(KITTI\) or 8 \(TUM: .*\), got 3"),
        (kitti(at(0)) + "\n1 0 0 0 0 0 0 1\n", "line 2 must have 12 numbers .*, got 8"),
        ("timestamp x y\n0 1 2\n", "line 1 must be numbers, got 'timestamp x y'"),
        ("1532402927647951 0 0 0 0 0 0 1\n", "times must be seconds, got 1532402927647951"),
        ("nan 0 0 0 0 0 0 1\n", "line 1 must be finite numbers"),
        ("0 0 0 0 0 0 0 0.5\n", "line 1: the quaternion must have norm 1, got norm 0.5"),
        ("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "line 2: times must ascend, got 1.0"),
        ("1 0 0 0 0 1 0 0 0 0 2 0\n", "line 1: rotation"),
    ],
)
def test_a_wrong_file_is_named_with_its_line(text: str, message: str, tmp_path: Path) -> None:
    place = written(tmp_path, text)
    with pytest.raises(ValueError, match=message) as caught:
        PoseFile.read(place)
    assert str(caught.value).startswith(str(place))


@pytest.mark.parametrize(
    ("text", "count", "name", "t_ns", "message"),
    [
        (kitti(at(0), at(1)), 3, "a.pcd", None, "must have one pose for each of 3 files, got 2 lines; or"),
        (kitti(at(0)), 1, "a.pcd", None, "has 1 lines, none for sweep 2"),
        ("5 0 0 0 0 0 0 1\n6 0 0 0 0 0 0 1\n", 1, "a.pcd", None, "a.pcd has no time by which its pose could be found"),
        ("5 0 0 0 0 0 0 1\n6 0 0 0 0 0 0 1\n", 1, "a.pcd", 9 * S,
         r"the sweep at 9.000 s has no pose: poses.txt reaches from 5.000 to 6.000 s"),
        ("5 0 0 0 0 0 0 1\n50 0 0 0 0 0 0 1\n", 1, "a.pcd", 9 * S, "lies in a gap of 45.0 s of poses.txt"),
    ],
)  # fmt: skip
def test_a_sweep_without_a_pose_is_named(
    text: str, count: int, name: str, t_ns: int | None, message: str, tmp_path: Path
) -> None:
    poses = PoseFile.read(written(tmp_path, text))
    files = [Path(f"{name}{k}") for k in range(count)]

    def place() -> Sweep:
        poses.check(files)
        return poses.place_sweep(SWEEP.replace(t_ns=t_ns), Path(name), 2, files)

    with pytest.raises(ValueError, match=message):
        place()


def _places(*rows: tuple[float, float, float]) -> str:
    lines = [f"{time_s:.2f},{latitude:.9f},{longitude:.9f},15.8,0.05" for time_s, latitude, longitude in rows]
    return "\n".join(["timestamp,latitude,longitude,height,latitude_std_dev", *lines])


def test_places_by_latitude_and_longitude_look_along_their_way(tmp_path: Path) -> None:
    # North by one meter each half second, then a stop, then east: 1 m is 1 / 111,319 of a degree of latitude.
    north, east = 1.0 / 111319.49, 1.0 / (111319.49 * np.cos(np.deg2rad(37.0)))
    rows = [(1e9, 37.0, -122.0), (1e9 + 0.5, 37.0 + north, -122.0), (1e9 + 1.0, 37.0 + north, -122.0),
            (1e9 + 1.5, 37.0 + north, -122.0 + east)]  # fmt: skip
    table = PoseFile.read(written(tmp_path, "\ufeff" + _places(*rows)))  # as spreadsheets begin a file
    found = [(*pose.translation.round(3), round(pose.yaw, 3)) for pose in table.poses]
    half = round(np.pi / 2, 3)
    assert found == [(0, 0, 0, half), (0, 1, 0, half), (0, 1, 0, 0), (1, 1, 0, 0)]
    assert table.notes == ("positions have no rotation: the sensor is taken to be level and to face along its path",)
    # A folder with a file for each sweep says the same, in the order of time whatever the names are.
    folder = tmp_path / "drive"
    folder.mkdir()
    for number, row in enumerate(reversed(rows)):
        (folder / f"{number}.pose").write_text(_places(row))
    again = PoseFile.read(folder)
    assert [pose.translation.round(3).tolist() for pose in again.poses] == [[x, y, z] for x, y, z, _ in found]
    placed = again.place_sweep(SWEEP.replace(t_ns=int((1e9 + 0.25) * S)), folder / "a.pcd", 0, [folder / "a.pcd"])
    assert placed.world_from_sensor.translation.tolist() == pytest.approx([0.0, 0.5, 0.0], abs=1e-3)
    assert placed.pose_covariance is None, "one deviation of three is none"


def test_beside_a_gap_the_nearest_pose_within_50_ms_is_taken(tmp_path: Path) -> None:
    poses = PoseFile.read(written(tmp_path, "5 1 0 0 0 0 0 1\n50 2 0 0 0 0 0 1\n"))
    for t_ns, x_m in ((5 * S + 40_000_000, 1.0), (50 * S - 50_000_000, 2.0)):
        placed = poses.place_sweep(SWEEP.replace(t_ns=t_ns), Path("a.pcd"), 0, [Path("a.pcd")])
        assert placed.world_from_sensor.translation[0] == x_m
    with pytest.raises(ValueError, match="lies in a gap of 45"):
        poses.place_sweep(SWEEP.replace(t_ns=5 * S + 51_000_000), Path("a.pcd"), 0, [Path("a.pcd")])


def test_standard_deviations_of_places_become_the_covariance_of_the_pose(tmp_path: Path) -> None:
    header = "timestamp,latitude,longitude,height,latitude_std_dev,longitude_std_dev,height_std_dev"
    rows = ["1000000000,37.0,-122.0,15.8,0.05,0.04,0.2", "1000000001,37.00001,-122.0,15.8,0.5,0.4,2"]
    table = PoseFile.read(written(tmp_path, "\n".join([header, *rows])))
    placed = table.place_sweep(SWEEP.replace(t_ns=int((1e9 + 0.1) * S)), Path("a.pcd"), 0, [Path("a.pcd")])
    # x is east, y north: of the place nearest in time.
    assert np.sqrt(np.diag(placed.pose_covariance)).tolist() == pytest.approx([0.04, 0.05, 0.2, 0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="line 2: standard deviations must be finite and not negative"):
        PoseFile.read(written(tmp_path, "\n".join([header, "1e9,37.0,-122.0,15.8,-0.05,0.04,0.2"])))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("timestamp,latitude,height\n1,2,3", "must name a column longitude"),
        ("timestamp,latitude,longitude,height\n1,2", "line 2 must have a number for each of its columns"),
        (_places((1.0, 90.0, 0.0)), "latitude must lie in"),
        (_places((1.0, 9.0, 0.0), (1.0, 9.0, 0.1)), "times must differ, got 1.000000 s twice"),
        ("timestamp,latitude,longitude,height", "must have positions, got no line with numbers"),
    ],
)
def test_wrong_tables_of_places_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PoseFile.read(written(tmp_path, text))
