"""What a stranger reads when a file is not what it was taken for: units, heights, sensors, origins, rings."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cli.commands import run

import viewshed
from viewshed import BevGrid, Rigid, Sweep, write_sweep
from viewshed.io.export import read_npz
from viewshed.io.samples import junction_path
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


NOT_METERS = [
    (STREET.points * np.float32(1000.0), "is the file in millimeters or centimeters?"),
    (STREET.points * np.float32(100.0), "is the file in millimeters or centimeters?"),
    (STREET.points * np.float32(0.001), "is the file in kilometers?"),
    (STREET.points * np.float32(0.0), "nearly all points lie at the origin: are they returns at all?"),
    (STREET.points + np.array([566_000.0, 5_930_000.0, 12.0], np.float32),
     r"the points lie around \((565999|566000|566001), 5930000, .*Subtract the sensor's position before you"),
]  # fmt: skip


@pytest.mark.parametrize(("points", "words"), NOT_METERS)
def test_points_that_cannot_be_meters_about_the_sensor_end_in_no_picture(
    points: NDArray[np.float32], words: str, tmp_path: Path
) -> None:
    code, [line] = lines(written(points, tmp_path))
    assert code == 2
    assert re.search(words, line)
    assert list((tmp_path / "out").iterdir()) == []
    told = run("info", tmp_path / "a.npz")  # says what it holds all the same
    assert (told.returncode, told.stdout.splitlines()[1].partition(":")[0]) == (0, "range")
    assert re.search(words, told.stderr)
    for source in (points, tmp_path / "a.npz"):  # nor in an estimate by Python
        with pytest.raises(ValueError, match=words):
            viewshed.estimate(source)


AXLE = np.array([1.3, 0.1, 1.5], np.float32)
DENSE = cast(lidar_model("hdl32e"), junction(), 1.8).points
NEAR = STREET.points * np.float32(0.1)
BOX = NEAR[(np.abs(NEAR[:, 0]) < 2.6) & (np.abs(NEAR[:, 1]) < 1.0)]
DOUBTED = [
    (STREET.points + np.array([0.0, 0.0, 1.8], np.float32), (),
     "no point lies below the origin: are the points relative to the road\\? Give the sensor's position with --origin"),
    (STREET.points + AXLE, (), r"relative to the axle or the road\? Give the sensor's position with --origin X,Y,Z"),
    (STREET.points, ("--height", "50"), "the sensor's height is given as 50.00 m, outside of 0.1 to 10 m"),
    (STREET.points, ("--height", "0.04"), "the sensor's height is given as 0.04 m, outside of 0.1 to 10 m"),
    (STREET.points, ("--sensor", "pandar40p"),
     "the returns do not lie at the beams of Pandar40P: name another --sensor, or none"),
    (np.concatenate([DENSE, (Rigid.from_yaw(0.4, (1.2, 0.8, -0.3)) @ DENSE).astype(np.float32)]), (),
     rf"the beams of the {2 * len(DENSE)} points cannot be identified, .* give one file for each, with --together"),
    (BOX, (),
     r"all \d+ returns lie within 2.7 m ahead or behind and 1.1 m aside, .* taken to be 1.80 m high"),
]  # fmt: skip


@pytest.mark.parametrize(("points", "options", "words"), DOUBTED)
def test_what_a_file_may_not_be_is_doubted(
    points: NDArray[np.float32], options: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    code, [line] = lines(written(points, tmp_path), *options)
    assert code == 0
    assert re.search(rf"^viewshed: a: warning: .*{words}", line)
    if not options:
        for source in (points, tmp_path / "a.npz"):
            with pytest.warns(UserWarning, match=words):
                viewshed.estimate(source, grid="indoor")


@pytest.mark.parametrize("options", [("--sensor", "vlp16"), ("--vehicle-yaw", "90"), ()])
def test_what_fits_is_not_doubted(options: tuple[str, ...], tmp_path: Path) -> None:
    assert lines(written(STREET.points, tmp_path), *options) == (0, [])


def test_an_origin_mends_points_counted_from_the_axle(tmp_path: Path) -> None:
    assert lines(written(STREET.points + AXLE, tmp_path), "--origin", "1.3,0.1,1.5") == (0, [])
    mended = read_npz(tmp_path / "out" / "a_first_blocker.npz").visible()
    assert lines(written(STREET.points, tmp_path)) == (0, [])
    assert (mended == read_npz(tmp_path / "out" / "a_first_blocker.npz").visible()).mean() > 0.999


@pytest.mark.parametrize("command", ["estimate", "info", "compare", "export"])
def test_a_cloud_upside_down_is_doubted_by_every_command(command: str, tmp_path: Path) -> None:
    path = written(STREET.points * np.array([1.0, 1.0, -1.0], np.float32), tmp_path)
    out = () if command == "info" else ("--out", tmp_path / "result")
    done = run(command, path, *out)
    assert done.returncode == 0
    [line] = done.stderr.splitlines()
    assert ": warning: the ground seems to lie 1.8 m above the sensor: does z point down? " in line
    assert ("; ground not seen, sensor taken to be" in done.stdout) == (command == "estimate")


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


def test_a_low_robot_is_no_axle() -> None:
    robot = cast(lidar_model("vlp16"), junction(), 0.4, rng=np.random.default_rng(0))
    assert doubts(level(Sweep(robot.points), BevGrid(64, 32.0))) == ()


def test_rings_can_be_ignored(tmp_path: Path) -> None:
    path = written(STREET.points, tmp_path, STREET.ring)
    assert "from file" in run("info", path).stdout
    assert "from file;" not in run("info", path, "--ring", "none").stdout


def test_returns_beyond_the_sensors_maximum_are_counted_in_the_line(tmp_path: Path) -> None:
    points = np.concatenate(
        [STREET.points, STREET.points[:7] * (150.0 / np.linalg.norm(STREET.points[:7], axis=1))[:, None]]
    )
    done = run("estimate", written(points, tmp_path), *FAST, "--sensor", "vlp16", "--out", tmp_path / "out")
    assert "; 7 returns beyond the 100 m of VLP-16 left out" in done.stdout


def test_each_drive_of_an_index_is_a_stream_of_its_own(tmp_path: Path) -> None:
    """Each drive has its own world: the first sweep of the second is not confirmed by one of the first."""
    same = {"sensor": "", "world_from_sensor": np.eye(4).tolist(), "stats": {"points": 1}}
    rows = [{"file": f"{t}.npz", "seq": seq, "t": t, **same} for t, seq in enumerate("aabb")]
    for row in rows:
        write_sweep(viewshed.read_sweep(junction_path()), tmp_path / str(row["file"]))
    (tmp_path / "index.json").write_text(json.dumps(rows))
    code, out, _ = run(
        "estimate", "--index", tmp_path / "index.json", "--history", 5, "--require-confirmation", "--results", "npz",
        "--out", tmp_path / "out",
    )  # fmt: skip
    assert code == 0
    assert ["visible 0 m²" in line for line in out.splitlines()[:4]] == [True, False, True, False]
