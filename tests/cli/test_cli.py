"""The commands as a stranger types them: exit codes, messages, files."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from viewshed import BevGrid, read_sweep
from viewshed.cli.options import make_estimator, parse_grid
from viewshed.export import read_npz
from viewshed.samples import junction_path


def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    code = "from viewshed.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], check=False, capture_output=True, text=True, cwd=cwd
    )


@pytest.fixture(scope="module")
def kitti_like(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sweep = read_sweep(junction_path())
    path = tmp_path_factory.mktemp("data") / "000001.bin"
    np.column_stack([sweep.points, np.zeros(len(sweep))]).astype(np.float32).tofile(path)
    return path


def test_estimate_writes_three_files_and_one_line(kitti_like: Path, tmp_path: Path) -> None:
    done = run("estimate", kitti_like, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert done.stdout.count("\n") == 1
    assert "visible" in done.stdout
    assert sorted(file.name for file in tmp_path.iterdir()) == ["000001.geojson", "000001.npz", "000001.png"]
    found = read_npz(tmp_path / "000001.npz")
    assert found.grid == BevGrid(256, 64.0)
    assert f"visible {found.area_m2():.0f} m²" in done.stdout
    features = json.loads((tmp_path / "000001.geojson").read_text())["features"]
    assert {feature["geometry"]["type"] for feature in features} <= {"Polygon", "MultiPolygon"}


def test_one_bad_file_does_not_stop_the_rest(kitti_like: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.bin"
    bad.write_bytes(b"\x00" * 17)
    done = run("estimate", bad, tmp_path / "missing.bin", kitti_like, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 2
    assert all(line.startswith("viewshed: ") for line in done.stderr.splitlines())
    assert {file.stem for file in (tmp_path / "out").iterdir()} == {"000001"}


def test_files_of_one_name_do_not_overwrite_each_other(kitti_like: Path, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "x.bin").write_bytes(kitti_like.read_bytes())
    done = run("estimate", tmp_path / "a/x.bin", tmp_path / "b/x.bin", "--out", tmp_path / "out")
    assert done.returncode == 0
    assert {file.name for file in (tmp_path / "out").glob("*.png")} == {"a_x.png", "b_x.png"}


def test_the_demo_names_its_picture(tmp_path: Path) -> None:
    done = run("demo", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    picture = Path(done.stdout.splitlines()[-1].removeprefix("Look at "))
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert picture.parent == tmp_path / "demo"


def test_info_tells_points_rings_sensor_and_ground() -> None:
    done = run("info", junction_path())
    assert done.returncode == 0, done.stderr
    told = dict(line.split(":", 1) for line in done.stdout.splitlines())
    assert told["points"].split(",")[0].strip() == str(len(read_sweep(junction_path())))
    assert "HDL-32E (inferred" in told["sensor"]
    assert told["rings"].strip().startswith("32, from file; 100.0%")
    assert abs(float(told["height"].split()[1]) - 1.84) < 0.05


def test_compare_prints_a_row_for_each_method(tmp_path: Path) -> None:
    done = run("compare", junction_path(), "--methods", "shadow_map,first_blocker", "--out", tmp_path / "c.png")
    assert done.returncode == 0, done.stderr
    rows = [line for line in done.stdout.splitlines() if line.startswith("| ")]
    assert [row.split("|")[1].strip() for row in rows] == ["method", "shadow_map", "first_blocker"]
    assert rows[1].split("|")[5].strip() == "1.000"
    assert (tmp_path / "c.png").stat().st_size > 10_000


@pytest.mark.parametrize("name", ["geojson", "occupancy_grid", "grid_map", "osi", "cpm", "npz"])
def test_export_from_a_sweep_and_from_an_estimate_agree(name: str, tmp_path: Path) -> None:
    first = run("export", junction_path(), "--to", "npz", "--out", tmp_path / "e.npz")
    assert first.returncode == 0, first.stderr
    for source, out in ((junction_path(), "a"), (tmp_path / "e.npz", "b")):
        done = run("export", source, "--to", name, "--out", tmp_path / out)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--method", "magic"], "method must be one of"),
        (["--grid", "0x64"], r"cells must lie in [1, 4096], got 0"),
        (["--grid", "street"], "grid must be one of road"),
        (["--grid", "4xnan"], "half_extent_m must be positive"),
        (["--sensor", "HDL-65E"], "sensor must be one of"),
        (["--target", "tank"], "target must be one of car, pedestrian"),
        (["--attitude", "1,1,0,0"], "norm 1"),
        (["--attitude", "0,0,0,0"], "norm 1, got norm 0"),
        (["--attitude", "1,0,0"], "attitude must be 4 numbers"),
        (["--height", "-2"], "sensor_height_m must lie in"),
        (["--threshold", "0"], "threshold must lie in (0, 1]"),
        (["--profile", "loud"], "profile must be sound or paper"),
        (["--format", "jpeg"], "format must be auto or one of"),
        (["--file-frame", "upside"], "upside"),
        (["--index", "nowhere.json"], "nowhere.json"),
        (["--sensor", "vlp16"], "ring must lie in [0, 16) of VLP-16, got 0…31"),
    ],
)
def test_bad_options_are_one_line_and_write_nothing(arguments: list[str], message: str, tmp_path: Path) -> None:
    done = run("estimate", junction_path(), *arguments, "--out", tmp_path / "out", cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""
    assert not list((tmp_path / "out").glob("*"))


def _write(path: Path, points: list[list[float]]) -> Path:
    np.array(points, np.float32).reshape(-1, 4).tofile(path)
    return path


@pytest.mark.parametrize(
    ("points", "told"),
    [
        ([[5.0, 1.0, -1.0, 0.0]], "visible 0 m²"),
        ([[0.1, 0.0, 0.0, 0.0]] * 20, "no usable return among 20 points: nothing is known"),
        ([[900.0, 0.0, 0.0, 0.0]] * 20, "no usable return among 20 points: nothing is known"),
        ([[5.0, 1.0, -1.0, 0.0], [np.nan, 0.0, 0.0, 0.0]], "visible 0 m²"),
    ],
)
def test_sweeps_that_say_little_claim_nothing(points: list[list[float]], told: str, tmp_path: Path) -> None:
    done = run("estimate", _write(tmp_path / "x.bin", points), "--format", "kitti", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert told in done.stdout
    assert not read_npz(tmp_path / "out" / "x.npz").visible().any()


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "empty"), (b"\x01" * 30, "x.bin"), (b"\xff" * 1600, "x.bin")],
)
def test_bad_files_are_one_line(content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "x.bin").write_bytes(content)
    done = run("estimate", tmp_path / "x.bin", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list((tmp_path / "out").glob("*"))


def test_every_command_has_help_with_an_example() -> None:
    for command in ("estimate", "info", "compare", "export", "demo"):
        done = run(command, "--help")
        assert done.returncode == 0
        assert f"Example: viewshed {command}" in " ".join(done.stdout.split())


def test_no_command_and_a_wrong_command_say_how() -> None:
    assert "Usage" in run().stdout + run().stderr
    wrong = run("estimat")
    assert wrong.returncode == 2
    assert "No such command" in wrong.stderr


def test_grids_and_targets_reach_the_estimator() -> None:
    estimator = make_estimator("first_blocker", parse_grid("64x8"), "pedestrian")
    assert estimator.grid == BevGrid(64, 8.0)
    assert make_estimator("quantized", parse_grid("road"), "car", "paper").grid.cells == 256
