"""What a stranger reads when a file is not what it was taken for: units, heights, sensors, origins, rings."""

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cli.commands import run

from viewshed import BevGrid, Sweep, write_sweep
from viewshed.io import read_sweep
from viewshed.io.export import read_npz
from viewshed.preprocess.leveling import level
from viewshed.preprocess.plausibility import doubts
from viewshed.sensors import lidar_model
from viewshed_lab.sim import cast, junction

STREET = cast(lidar_model("vlp16"), junction(), 1.8, rng=np.random.default_rng(0))
FAST = ("--method", "first_blocker", "--results", "npz", "--grid", "64x32")


def written(points: NDArray[np.floating], folder: Path, ring: NDArray[np.int16] | None = None) -> Path:
    path = folder / "a.npz"
    write_sweep(Sweep(points, ring=ring), path)
    return path


def lines(path: Path, *options: str) -> tuple[int, list[str]]:
    done = run("estimate", path, *FAST, "--out", path.parent / "out", *options)
    return done.returncode, done.stderr.splitlines()


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1000.0, "is the file in millimeters or centimeters?"),
        (100.0, "is the file in millimeters or centimeters?"),
        (0.001, "is the file in kilometers?"),
        (0.0, "nearly all points lie at the origin: are they returns at all?"),
    ],
)
def test_units_are_doubted(factor: float, words: str, tmp_path: Path) -> None:
    code, [line] = lines(written(STREET.points * np.float32(factor), tmp_path))
    assert code == 0
    assert line.startswith("viewshed: a: warning: ")
    assert words in line


def test_coordinates_of_a_map_are_doubted(tmp_path: Path) -> None:
    code, [line] = lines(written(STREET.points + np.array([566_000.0, 5_930_000.0, 12.0], np.float32), tmp_path))
    assert code == 0
    assert re.search(r"the points lie around \((565999|566000|566001), 5930000, ", line)
    assert line.endswith("Subtract the sensor's position before they are written")


def test_points_counted_from_the_road_are_noticed(tmp_path: Path) -> None:
    code, [line] = lines(written(STREET.points + np.array([0.0, 0.0, 1.8], np.float32), tmp_path))
    assert code == 0
    assert "no point lies below the origin: are the points counted from the road? Say with --origin X,Y,Z" in line


@pytest.mark.parametrize("command", ["estimate", "info", "compare", "export"])
def test_a_cloud_upside_down_is_doubted_by_every_command(command: str, tmp_path: Path) -> None:
    path = written(STREET.points * np.array([1.0, 1.0, -1.0], np.float32), tmp_path)
    out = () if command == "info" else ("--out", tmp_path / "result")
    done = run(command, path, *out)
    assert done.returncode == 0
    [line] = done.stderr.splitlines()
    assert ": warning: no ground is seen, and the sensor is taken to be " in line
    assert line.endswith("give --height if it is known, or --file-frame if the file's z points down")


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("ring", [500.0, -1.0, np.nan, 0.5])
def test_a_junk_ring_column_costs_one_line_and_not_the_cloud(ring: float, tmp_path: Path) -> None:
    count = len(STREET)
    header = (
        "VERSION .7\nFIELDS x y z ring\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        f"WIDTH {count}\nHEIGHT 1\nPOINTS {count}\nDATA binary\n"
    )
    rows = np.column_stack([STREET.points, np.full(count, ring)]).astype(np.float32)
    path = tmp_path / "a.pcd"
    path.write_bytes(header.encode() + rows.tobytes())
    code, [line] = lines(path)
    assert code == 0
    assert re.fullmatch(r"viewshed: warning: .*a\.pcd: ring is left out: .*", line)


@pytest.mark.parametrize("command", ["info", "compare", "export"])
def test_every_command_that_reads_a_sweep_says_its_doubts(command: str, tmp_path: Path) -> None:
    path = written(STREET.points, tmp_path)
    out = () if command == "info" else ("--out", tmp_path / "result")
    done = run(command, path, "--height", "50", *out)
    assert done.returncode == 0
    [line] = done.stderr.splitlines()
    assert line.startswith("viewshed: a.npz: warning: the sensor's height is said to be 50.00 m, outside of 0.1 to 10")


@pytest.mark.parametrize("height", ["50", "0.04"])
def test_a_height_that_nobody_mounts_at_is_doubted(height: str, tmp_path: Path) -> None:
    code, [line] = lines(written(STREET.points, tmp_path), "--height", height)
    assert code == 0
    assert f"the sensor's height is said to be {float(height):.2f} m, outside of 0.1 to 10 m" in line


def test_a_height_of_500_m_is_refused(tmp_path: Path) -> None:
    code, [line] = lines(written(STREET.points, tmp_path), "--height", "500")
    assert code == 2
    assert line.endswith("sensor_height_m must lie in (0, 100), got 500; give it in meters")


def test_another_sensor_than_the_one_named_is_doubted(tmp_path: Path) -> None:
    path = written(STREET.points, tmp_path)
    code, [line] = lines(path, "--sensor", "pandar40p")
    assert code == 0
    assert "the returns do not lie at the beams of Pandar40P: name another --sensor, or none" in line
    assert lines(path, "--sensor", "vlp16") == (0, [])


def test_points_counted_from_the_axle_are_noticed_and_an_origin_mends_it(tmp_path: Path) -> None:
    origin = np.array([1.3, 0.1, 1.5], np.float32)
    path = written(STREET.points + origin, tmp_path)
    code, [line] = lines(path)
    assert code == 0
    assert "are the points counted from the axle or the road? Say with --origin X,Y,Z where the sensor is" in line
    code, none = lines(path, "--origin", "1.3,0.1,1.5")
    assert (code, none) == (0, [])
    mended = read_npz(tmp_path / "out" / "a_first_blocker.npz").visible()
    assert lines(written(STREET.points, tmp_path)) == (0, [])
    assert (mended == read_npz(tmp_path / "out" / "a_first_blocker.npz").visible()).mean() > 0.999


def test_an_origin_must_be_three_numbers(tmp_path: Path) -> None:
    code, [line] = lines(written(STREET.points, tmp_path), "--origin", "1,2")
    assert code == 2
    assert "origin must be 3 numbers with commas, got 2 in '1,2'" in line


def test_a_low_robot_is_no_axle() -> None:
    robot = cast(lidar_model("vlp16"), junction(), 0.4, rng=np.random.default_rng(0))
    assert doubts(level(Sweep(robot.points), BevGrid(64, 32.0))) == ()


def test_rings_can_be_ignored(tmp_path: Path) -> None:
    path = written(STREET.points, tmp_path, STREET.ring)
    assert "from file" in run("info", path).stdout
    assert "from file;" not in run("info", path, "--ring", "none").stdout
    code, [line] = lines(path, "--ring", "all")
    assert code == 2
    assert "ring must be one of file, none, got 'all'" in line


def test_a_column_of_something_else_is_left_out_in_one_line(tmp_path: Path) -> None:
    junk = np.random.default_rng(0).integers(0, 64, len(STREET)).astype(np.int16)
    path = written(STREET.points, tmp_path, junk)
    with pytest.warns(UserWarning, match="ring is left out"):
        assert read_sweep(path).ring is None


def test_the_heading_of_the_vehicle_can_be_told(tmp_path: Path) -> None:
    code, none = lines(written(STREET.points, tmp_path), "--vehicle-yaw", "90")
    assert (code, none) == (0, [])


def test_returns_beyond_the_sensors_maximum_are_counted_in_the_line(tmp_path: Path) -> None:
    points = np.concatenate(
        [STREET.points, STREET.points[:7] * (150.0 / np.linalg.norm(STREET.points[:7], axis=1))[:, None]]
    )
    done = run("estimate", written(points, tmp_path), *FAST, "--sensor", "vlp16", "--out", tmp_path / "out")
    assert "; 7 returns beyond the 100 m of VLP-16 left out" in done.stdout


def test_transposed_arrays_name_the_remedy(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", STREET.points.T)
    code, [line] = lines(tmp_path / "a.npy")
    assert code == 2
    assert line.endswith("; transpose it (points.T)")
