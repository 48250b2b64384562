"""The first hour of a user: point it at anything, one default everywhere, results where they were asked for."""

import inspect
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run

import viewshed
from viewshed import BevGrid, Rigid, Sweep, write_sweep
from viewshed.cli._profile import PipelineOptions
from viewshed.cli.estimate import estimate as estimate_command
from viewshed.cli.export import export as export_command
from viewshed.cli.view import view
from viewshed.estimators import DEFAULT_ESTIMATOR
from viewshed.io.export import read_npz
from viewshed.pipeline.profiles import PROFILES
from viewshed.sensors import lidar_model
from viewshed_lab.sim import cast, junction

STREET = cast(lidar_model("vlp16"), junction(), 1.8, rng=np.random.default_rng(0))
FAST = ("--results", "npz", "--grid", "64x32")
DOCS = Path(__file__).parents[4] / "docs"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of three sweeps, 9.npz before 10.npz, with poses in TUM's and KITTI's format in another folder."""
    folder = tmp_path_factory.mktemp("drive")
    for name in ("9", "10", "11"):
        write_sweep(Sweep(STREET.points), folder / f"{name}.npz")
    (folder / "notes.txt").write_text("not a sweep")
    return folder


@pytest.mark.parametrize(("place", "names"), [("", ["9", "10", "11"]), ("1*.npz", ["10", "11"])])
def test_a_folder_and_a_pattern_are_their_sweeps_in_the_order_of_their_numbers(
    place: str, names: list[str], drive: Path, tmp_path: Path
) -> None:
    done = run("estimate", drive / place, *FAST, "--out", tmp_path / "out")
    assert (done.returncode, done.stderr) == (0, "")
    *lines, total = done.stdout.splitlines()
    assert [line.partition(":")[0] for line in lines] == names
    assert total.startswith(f"{len(names)} sweeps: ")


@pytest.mark.parametrize("command", ["info", "compare", "export"])
def test_a_command_for_one_sweep_says_which_of_a_folder_it_takes(command: str, drive: Path, tmp_path: Path) -> None:
    out = () if command == "info" else ("--out", f"{tmp_path}/new/")
    done = run(command, drive, "--number", 1, *out)
    assert done.returncode == 0, done.stderr
    assert "note: " in done.stderr
    assert "holds more sweeps; number 1, counted from 0, is used" in done.stderr
    if command != "info":  # a name that ends in a slash is a folder, which is made
        assert len(list((tmp_path / "new").iterdir())) == 1
    beyond = run(command, drive, "--number", 3, *out)
    assert beyond.returncode == 2
    assert "number must be below 3, the number of sweeps in" in beyond.stderr


def test_poses_place_the_sweeps_of_a_folder(drive: Path, tmp_path: Path) -> None:
    poses = tmp_path / "poses.txt"
    poses.write_text("".join(f"1 0 0 {x} 0 1 0 0 0 0 1 1.8\n" for x in range(3)))
    done = run("estimate", drive, *FAST, "--poses", poses, "--history", 2, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "note: " in done.stderr
    found = [read_npz(tmp_path / "out" / f"{name}.npz") for name in ("9", "10", "11")]
    poses_m = [each.world_from_level.translation[0] for each in found if each.world_from_level is not None]
    assert poses_m == pytest.approx([0.0, 1.0, 2.0])
    checked = run("monitor", "check", drive, "--poses", poses)
    assert checked.returncode == 0, checked.stderr
    assert checked.stdout.splitlines()[-1].startswith("3 sweeps")


def test_an_origin_in_a_reference_system_places_points_of_a_map(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio", reason="needs the extra geo")
    origin = np.array([66_000.0, 30_000.0, 12.0])
    write_sweep(Sweep((STREET.points + origin).astype(np.float32)), tmp_path / "map.npz")
    words = ("--to", "geotiff", "--crs", "EPSG:25832", "--origin", "66000,30000,12", "--out", tmp_path / "a.tif")
    done = run("export", tmp_path / "map.npz", *words)
    assert done.returncode == 0, done.stderr
    with rasterio.open(tmp_path / "a.tif") as raster:
        assert raster.crs.to_epsg() == 25832
        center = raster.transform @ (128, 128)
    assert center == pytest.approx((66_000.0, 30_000.0))


def test_each_method_has_a_file_name_of_its_own(drive: Path, tmp_path: Path) -> None:
    for method in ("shadow_map", "first_blocker"):
        words = ("--method", method, *FAST, "--out", tmp_path)
        assert run("estimate", drive / "9.npz", *words).returncode == 0
        exported = run("export", drive / "9.npz", "--method", method, "--grid", "64x32", "--out", tmp_path)
        assert exported.returncode == 0
    names = {"9.npz", "9_first_blocker.npz", "9.geojson", "9_first_blocker.geojson"}
    assert {file.name for file in tmp_path.iterdir()} == names
    assert read_npz(tmp_path / "9_first_blocker.npz").method == "first_blocker"


def test_one_default_everywhere(drive: Path, tmp_path: Path) -> None:
    # 1. No command has a default of its own.
    for command in (estimate_command, export_command, view):
        assert inspect.signature(command).parameters["method"].default is None
    assert PipelineOptions().method is None  # of replay and record
    # 2. What the command line and Python give is the same method, and the line names it.
    done = run("estimate", drive / "9.npz", *FAST, "--out", tmp_path)
    assert f"({DEFAULT_ESTIMATOR}, " in done.stdout
    by_command = read_npz(tmp_path / "9.npz")
    by_python = viewshed.estimate(STREET.points, grid=BevGrid(64, 32.0))
    assert by_command.method == by_python.method == viewshed.load_estimator().name == DEFAULT_ESTIMATOR
    assert (by_command.state == by_python.state).all()
    # 3. Profiles of the pipeline take it; so do the pages.
    assert {profile.method for profile in PROFILES.values()} == {DEFAULT_ESTIMATOR}
    for page in ("which_method.md", "architecture.md"):
        assert f"`{DEFAULT_ESTIMATOR}`" in (DOCS / page).read_text(encoding="utf-8")


def test_points_of_any_width_are_estimated() -> None:
    rows = np.column_stack([STREET.points, np.ones(len(STREET)), np.zeros(len(STREET))])
    plain = viewshed.estimate(STREET.points, grid="indoor")
    assert (viewshed.estimate(rows, grid="indoor").state == plain.state).all()
    fields = np.zeros(len(STREET), [("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2")])
    for axis, name in enumerate("xyz"):
        fields[name] = STREET.points[:, axis]
    fields["ring"] = STREET.ring
    pose = Rigid.from_yaw(0.0, (5.0, 6.0, 1.8))
    named = viewshed.estimate(fields, grid="indoor", sensor="vlp16", sensor_height_m=1.8, world_from_sensor=pose)
    assert named.basis.height_source == "given"
    assert named.world_from_level.translation[:2].tolist() == [5.0, 6.0]


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros(12), r"points must have shape \(N, 3\+\), got \(12,\)"),
        (np.zeros((5, 3), complex), "points must be real numbers, got dtype complex128"),
        (np.zeros(5, [("x", "f4"), ("y", "f4")]), "points must have fields x, y and z, got x, y"),
        ([["a", "b", "c"]], "points must be real numbers"),
        (np.ones((64, 1024)), "is it a range image"),
    ],
)
def test_an_array_that_is_no_cloud_is_named(points: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        viewshed.estimate(points)  # type: ignore[arg-type]


def test_what_a_sweep_says_itself_is_not_said_again() -> None:
    with pytest.raises(ValueError, match="are for points, got a Sweep"):
        viewshed.estimate(STREET, sensor="vlp16")


def test_json_says_what_the_arrays_hold_and_quiet_says_nothing(drive: Path, tmp_path: Path) -> None:
    done = run("estimate", drive, *FAST, "--out", tmp_path, "--json")
    known = [json.loads(line) for line in done.stdout.splitlines()]
    assert [each["name"] for each in known] == ["9", "10", "11"]
    found = read_npz(known[0]["results"][0])
    assert known[0]["visible_m2"] == pytest.approx(found.area_m2())
    assert known[0]["hidden_share"] == pytest.approx((found.state == 3).mean(), abs=1e-6)
    assert known[0]["basis"]["height_source"] == "estimated"
    assert run("estimate", drive, *FAST, "--out", tmp_path, "--quiet") == (0, "", "")


@pytest.mark.parametrize(("command", "name"), [("export", "one.result"), ("compare", "one.png")])
def test_out_is_a_folder_for_every_command_unless_it_is_named_like_a_file(
    command: str, name: str, drive: Path, tmp_path: Path
) -> None:
    assert run(command, drive / "9.npz", "--out", tmp_path / "new").returncode == 0
    assert [file.is_file() for file in (tmp_path / "new").iterdir()] == [True]
    assert run(command, drive / "9.npz", "--out", tmp_path / name).returncode == 0
    assert (tmp_path / name).is_file()
    assert run("estimate", drive / "9.npz", *FAST, "--out", tmp_path / "more").returncode == 0
    assert (tmp_path / "more").is_dir()


def test_the_module_is_the_program(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "viewshed", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"viewshed {viewshed.__version__}\n"


def test_python_takes_a_file_and_shows_what_it_found(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fov = viewshed.estimate(drive / "9.npz", grid="indoor")
    assert (fov.state == viewshed.estimate(str(drive / "9.npz"), grid="indoor").state).all()
    line = str(fov)
    assert "\n" not in line
    assert f"visible on {fov.area_m2():.0f} m² of 32 × 32 m" in line
    assert fov._repr_png_()[:8] == b"\x89PNG\r\n\x1a\n"
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    path = fov.show()
    assert opened == [path.as_uri()]
    assert path.read_bytes() == fov.plot()
    with pytest.raises(FileNotFoundError, match=r"no\.bin"):
        viewshed.estimate("no.bin")
