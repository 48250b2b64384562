"""The commands as a stranger types them: exit codes, messages, files."""

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.commands import run

import viewshed
from viewshed import BevGrid, read_sweep, write_sweep
from viewshed.cli import main
from viewshed.cli._outputs import Run, Summary, _remarks, output_names
from viewshed.fov.estimate import Basis, FovEstimate, HeightSource
from viewshed.geometry import Rigid
from viewshed.io.export import read_npz
from viewshed.io.messages.cpm import decode_cpm
from viewshed.io.samples import junction_path
from viewshed.preprocess.leveling import LeveledSweep, level


@contextlib.contextmanager
def start(*arguments: object, stderr: int = subprocess.PIPE) -> Iterator[subprocess.Popen[str]]:
    """Run a command in a process of its own, which heeds Ctrl-C even where the tests run in the background."""
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\nfrom viewshed.cli import main; main()"
    )
    words = [sys.executable, "-c", code, *map(str, arguments)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=stderr, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


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


def test_the_demo_names_its_picture(tmp_path: Path) -> None:
    done = run("demo", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    picture = Path(done.stdout.splitlines()[-1].removeprefix("Look at "))
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert picture.parent == tmp_path / "demo"


def test_info_tells_points_rings_sensor_and_ground(tmp_path: Path) -> None:
    done = run("info", junction_path())
    assert done.returncode == 0, done.stderr
    told = dict(line.split(":", 1) for line in done.stdout.splitlines())
    assert told["points"].split(",")[0].strip() == str(len(read_sweep(junction_path())))
    assert "HDL-32E (inferred" in told["sensor"]
    assert told["rings"].strip().startswith("32, from file; 100.0%")
    assert abs(float(told["height"].split()[1]) - 1.84) < 0.05
    files: Any = import_module("sweep_files")  # metadata say what the sensor is
    capture = files.pcap([files.ip_packet(files.udp_packet(one)) for one in files.ouster_payloads()])
    (tmp_path / "o.pcap").write_bytes(capture)
    (tmp_path / "o.json").write_bytes(files.ouster_metadata())
    assert "sensor:      OS-1-32 (given)" in run("info", tmp_path / "o.pcap").stdout


def test_compare_prints_a_row_for_each_method(tmp_path: Path) -> None:
    done = run("compare", junction_path(), "--methods", "shadow_map,first_blocker", "--out", tmp_path / "c.png")
    assert done.returncode == 0, done.stderr
    rows = [line for line in done.stdout.splitlines() if line.startswith("| ")]
    assert [row.split("|")[1].strip() for row in rows] == ["method", "shadow_map", "first_blocker"]
    columns = [cell.strip() for cell in rows[0].split("|")]
    assert rows[1].split("|")[columns.index("IoU with the first")].strip() == "1.000"
    for name in ("ground unsure by 0.5 m", "by inferred beams"):
        assert 0 <= float(rows[1].split("|")[columns.index(name)].strip().removesuffix("%")) <= 100
    assert done.stdout.splitlines()[-2].startswith("sensor 1.85 m above the ground (estimated, 9")
    assert (tmp_path / "c.png").stat().st_size > 10_000


def test_an_export_replaces_none_of_another_format(tmp_path: Path) -> None:
    out = tmp_path / "view.one"
    for earlier, name in (("geojson", "npz"), ("npz", "geojson")):
        for _ in range(2):  # the same format is replaced
            assert run("export", junction_path(), "--grid", "64x32", "--to", earlier, "--out", out).returncode == 0
        before = out.read_bytes()
        code, said, err = run("export", junction_path(), "--grid", "64x32", "--to", name, "--out", out)
        assert (code, said) == (2, "")
        assert err == (
            f"viewshed: --out must not replace an export of another format, got {out}, which is {earlier}; choose"
            f" another name for {name}, or remove it\n"
        )
        assert out.read_bytes() == before
        out.unlink()


@pytest.mark.parametrize("name", ["geojson", "cpm"])
def test_export_from_a_sweep_and_from_an_estimate_agree(name: str, tmp_path: Path) -> None:
    first = run("export", junction_path(), "--to", "npz", "--out", tmp_path / "e.npz")
    assert first.returncode == 0, first.stderr
    for source, out in ((junction_path(), "a.out"), (tmp_path / "e.npz", "b.out")):
        done = run("export", source, "--to", name, "--out", tmp_path / out)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "a.out").read_bytes() == (tmp_path / "b.out").read_bytes()
    for word, value in (("--method", "unet"), ("--poses", "poses.txt"), ("--number", "1")):
        done = run("export", tmp_path / "e.npz", word, value, "--to", name, "--out", tmp_path / "c.out")
        assert (done.returncode, "e.npz is an estimate: leave out all but --to" in done.stderr) == (2, True)


def test_export_writes_a_message_in_the_standards_bytes(tmp_path: Path) -> None:
    pytest.importorskip("rasterio", reason="rasterio is not installed: no place on earth")
    pose = Rigid.from_yaw(0.4, (566_000.0, 5_930_000.0, 12.0))
    sweep = read_sweep(junction_path()).replace(t_ns=1_167_609_600_000_000_000, world_from_sensor=pose)
    write_sweep(sweep, tmp_path / "placed.npz")
    words = ("--to", "cpm_uper", "--crs", "EPSG:25832", "--out", tmp_path / "sent.cpm.uper")
    done = run("export", tmp_path / "placed.npz", *words)
    assert (done.returncode, done.stderr) == (0, "")
    message = decode_cpm((tmp_path / "sent.cpm.uper").read_bytes())
    assert message["payload"]["managementContainer"]["referencePosition"]["latitude"] == pytest.approx(
        535148e3, rel=1e-5
    )
    assert message["payload"]["cpmContainers"][1]["perceptionRegionContainer"]


def _write(path: Path, points: list[list[float]]) -> Path:
    np.array(points, np.float32).reshape(-1, 4).tofile(path)
    return path


@pytest.mark.parametrize(
    ("points", "told"),
    [
        ([[0.1, 0.0, 0.0, 0.0]] * 20, "no usable return among 20 points: nothing is known"),
        ([[5.0, 1.0, -1.0, 0.0], [np.nan, 0.0, 0.0, 0.0]], "visible 0 m²"),
    ],
)
def test_sweeps_that_say_little_claim_nothing(points: list[list[float]], told: str, tmp_path: Path) -> None:
    done = run("estimate", _write(tmp_path / "x.bin", points), "--format", "kitti", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert told in done.stdout
    assert not read_npz(tmp_path / "out" / "x.npz").visible().any()


@pytest.mark.parametrize(
    ("source", "unsure", "inferred", "said"),
    [
        ("estimated", 0.3, 0.41, ("sensor 1.80 m high", "30% of the view over unsure ground",
                                  "41% of the view by inferred beams")),
        ("assumed", 0.5, 0.1, ("ground not seen, sensor taken to be 1.80 m above it",
                               "50% of the view over unsure ground")),
        ("given", 0.2, 0.2, ("sensor 1.80 m high",)),
    ],
)  # fmt: skip
def test_the_line_says_what_the_view_rests_on_where_that_is_much(
    source: HeightSource, unsure: float, inferred: float, said: tuple[str, ...]
) -> None:
    sweep = viewshed.read_sweep(junction_path()).replace(model=None)
    estimate = replace(viewshed.estimate(sweep), basis=Basis(1.8, source, 0.9, unsure, inferred, 80.0))
    assert _remarks(level(sweep, estimate.grid), estimate) == said


def test_without_a_command_the_help_is_shown_and_version_is_told() -> None:
    done = run()
    assert done.returncode == 0
    assert "Usage" in done.stdout
    assert "demo" in done.stdout
    assert run("--version").stdout == f"viewshed {viewshed.__version__}\n"


def test_output_names_never_meet() -> None:
    files = [Path("a/x.bin"), Path("b/x.bin"), Path("b/X.pcd"), Path("a_x.bin"), Path("a/x.bin"), Path("a_x_1.bin")]
    names = output_names(files)
    assert names[:2] == ["a_x", "b_x"]
    assert len({name.casefold() for name in names}) == len(files)


@pytest.mark.slow
def test_a_file_of_several_sweeps_gives_each_its_results(real_data: Path, tmp_path: Path) -> None:
    [capture] = real_data.rglob("OS-1-128_v2.3.0_1024x10.pcap*")
    done = run("estimate", capture, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("visible") == 3
    assert {file.stem[-4:] for file in tmp_path.iterdir()} == {"_000", "_001", "_002"}


@pytest.mark.slow
def test_interruption_is_130_without_a_trace_and_without_half_files(kitti_like: Path, tmp_path: Path) -> None:
    with start("estimate", *[kitti_like] * 300, "--out", tmp_path) as process:
        assert "visible" in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (130, "")
    assert {file.suffix for file in tmp_path.iterdir()} <= {".png", ".geojson", ".npz"}


class _InterruptedLookup(type):
    """As that of an Enum, its attributes are looked up in Python, where a signal is heeded."""

    def __getattr__(cls, name: str) -> None:
        signal.raise_signal(signal.SIGINT)
        raise AttributeError(name)


@pytest.mark.parametrize("error", [None, ValueError("half"), SystemError("half")], ids=["dropped", "value", "system"])
def test_an_interrupt_that_compiled_code_drops_or_changes_ends_the_command(
    error: Exception | None, kitti_like: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written, whole = [], Run.write

    def write(self: Run, sweep: LeveledSweep, name: str, estimate: FovEstimate, elapsed_ms: float) -> Summary:
        written.append(name)
        with contextlib.suppress(KeyboardInterrupt):  # other versions of NumPy may not drop it
            np.zeros(3) == _InterruptedLookup("Kind", (), {})()  # noqa: B015
        if error is not None:
            raise error
        return whole(self, sweep, name, estimate, elapsed_ms)

    monkeypatch.setattr(Run, "write", write)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(SystemExit) as ended:
            main(["estimate", *[str(kitti_like)] * 3, "--out", str(tmp_path)])
    finally:
        assert signal.signal(signal.SIGINT, before) is signal.default_int_handler
    assert (ended.value.code, len(written)) == (130, 1)


@pytest.mark.slow
def test_progress_goes_to_the_terminal_and_lines_to_the_pipe(kitti_like: Path, tmp_path: Path) -> None:
    master, slave = pty.openpty()
    with start("estimate", kitti_like, kitti_like, "--out", tmp_path, stderr=slave) as process:
        out, _ = process.communicate(timeout=300)
    os.close(slave)
    shown = os.read(master, 100_000).decode(errors="replace")
    os.close(master)
    assert process.returncode == 0
    assert [line.split()[0] for line in out.splitlines()[2:]] == ["2"]  # the total, after a line for each
    assert "sweeps" in shown
    assert "visible" not in shown


def test_the_paper_profile_has_its_own_method_and_threshold(kitti_like: Path, tmp_path: Path) -> None:
    for grid in ("paper", "paper_indoor"):
        done = run("estimate", kitti_like, "--parameters", "paper", "--grid", grid, "--out", tmp_path)
        assert done.returncode == 0, done.stderr
        assert "paper_label" in done.stdout
    thresholds = {
        feature["properties"]["threshold"]
        for feature in json.loads((tmp_path / "000001_paper_label.geojson").read_text())["features"]
    }
    assert thresholds == {0.7, None}


def test_an_index_names_files_frames_heights_and_poses(kitti_like: Path, tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(kitti_like.read_bytes())
    pose = [[0.0, -1.0, 0.0, 50.0], [1.0, 0.0, 0.0, 7.0], [0.0, 0.0, 1.0, 1.84], [0.0, 0.0, 0.0, 1.0]]
    entry = {
        "file": "a.bin",
        "sensor": "HDL-32E",
        "sensor_height_m": 1.84,
        "world_from_sensor": pose,
        "stats": {"points": 5},
    }
    (tmp_path / "index.json").write_text(json.dumps([entry, {"file": "notes.txt", "sensor": "none"}]))
    done = run("estimate", "--index", tmp_path / "index.json", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    found = read_npz(tmp_path / "out" / "a.npz")
    assert found.world_from_level.translation == pytest.approx([50.0, 7.0, 0.0])
    features = json.loads((tmp_path / "out" / "a.geojson").read_text())
    assert features["viewshed:frame"]["name"] == "world"
