"""``viewshed estimate --batch`` and ``--results`` as a stranger types them."""

import re
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run
from tests.cli.test_networks import SHAPE
from tests.estimators.test_batch import Picky
from tests.networks.made import card, nearby

from viewshed import BevGrid, Sweep, write_sweep
from viewshed.cli._outputs import Failures, Named, Run
from viewshed.io.export import read_npz
from viewshed_lab.training.onnx_export import export_onnx

GRID = BevGrid(16, 8.0)


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Seven sweeps of ground ahead, each a bit longer than the one before."""
    made = []
    for number in range(7):
        x, y = np.meshgrid(np.linspace(2, 6 + number, 60), np.linspace(-9, 9, 60))
        points = np.stack([x.ravel(), y.ravel(), np.full(3600, -1.8)], axis=1)
        made.append(tmp_path / f"sweep{number}.ply")
        write_sweep(Sweep(points.astype(np.float32)), made[-1])
    return made


@pytest.mark.slow
@pytest.mark.parametrize("method", ["unet", "shadow_map"])
def test_a_batch_writes_what_one_by_one_writes_and_tells_no_time(
    files: list[Path], tmp_path: Path, method: str
) -> None:
    export_onnx(tmp_path / "net.onnx", card(SHAPE, BevGrid(64, 16.0)), nearby(SHAPE))
    words = ["estimate", *files[:5], "--method", method, "--grid", "64x16", "--height", 1.8]
    words += ["--weights", tmp_path / "net.onnx"] if method == "unet" else []
    code, out, err = run(*words, "--out", tmp_path / "one")
    assert (code, err, out.count(" ms); sensor 1.80 m high")) == (0, "", 5)
    code, batched, err = run(*words, "--out", tmp_path / "many", "--batch", 3)
    assert (code, err) == (0, "")
    assert batched == re.sub(
        r", \d+ ms\)|; \d+ ms each", lambda ms: ")" * ms[0].count(")"), out.replace("/one/", "/many/")
    )
    names = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert sorted(path.name for path in (tmp_path / "many").iterdir()) == names
    assert len(names) == 15
    for name in (name for name in names if name.endswith(".npz")):
        one, many = (read_npz(tmp_path / folder / name) for folder in ("one", "many"))
        np.testing.assert_allclose(many.visible_prob, one.visible_prob, atol=1e-6)
        assert np.array_equal(many.state, one.state)


@pytest.mark.parametrize(
    ("results", "first", "batch"), [("npz", "npz", 1), ("npz,geojson", "geojson", 4), ("npz,png", "png", 1)]
)
def test_only_the_results_that_are_asked_for_are_written(
    files: list[Path], tmp_path: Path, results: str, first: str, batch: int
) -> None:
    words = ("estimate", files[0], "--grid", "64x16", "--out", tmp_path / "out", "--results", results)
    code, out, err = run(*words, "--batch", batch)
    assert (code, err) == (0, "")
    assert out.endswith(f" → {tmp_path / 'out' / 'sweep0'}.{first}\n")
    assert {path.suffix[1:] for path in (tmp_path / "out").iterdir()} == set(results.split(","))


def test_results_that_are_not_written_cannot_replace_an_input(files: list[Path], tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    write_sweep(Sweep(np.zeros((1, 3), np.float32)), path)
    assert run("estimate", path, "--out", tmp_path, "--results", "geojson", "--grid", "64x16")[0] == 0
    code, _, err = run("estimate", path, "--out", tmp_path, "--results", "npz", "--batch", 2)
    assert (code, "is an input and would be replaced" in err) == (2, True)


@pytest.mark.parametrize("batch", [1, 2, 16])
def test_a_bad_file_costs_a_line_and_the_others_are_estimated(files: list[Path], tmp_path: Path, batch: int) -> None:
    (tmp_path / "bad.bin").write_bytes(b"\x00" * 17)
    places = [files[0], tmp_path / "bad.bin", *files[1:3], tmp_path / "missing.bin", files[3]]
    words = ("--grid", "64x16", "--results", "npz", "--out", tmp_path / "out", "--batch", batch)
    code, out, err = run("estimate", *places, *words)
    assert code == 2
    assert [line.partition(":")[0] for line in out.splitlines()] == ["sweep0", "sweep1", "sweep2", "sweep3", "4 sweeps"]
    assert [line.startswith("viewshed: ") for line in err.splitlines()] == [True, True]
    assert ("bad.bin" in err.splitlines()[0], "missing.bin" in err.splitlines()[1]) == (True, True)


def test_a_recording_is_estimated_in_batches_as_far_as_it_can_be_read(tmp_path: Path) -> None:
    """A KITTI object tree of five sweeps, the last cut off in the middle of a point."""
    folder = tmp_path / "kitti" / "training" / "velodyne"
    folder.mkdir(parents=True)
    for number in range(5):
        x, y = np.meshgrid(np.linspace(2, 6 + number, 60), np.linspace(-9, 9, 60))
        points = np.stack([x.ravel(), y.ravel(), np.full(3600, -1.8), np.zeros(3600)], axis=1).astype(np.float32)
        (folder / f"{number:06}.bin").write_bytes(points.tobytes()[: None if number < 4 else 1001])
    words = ("estimate", tmp_path / "kitti", "--grid", "64x16", "--height", 1.8, "--results", "npz", "--out")
    for place, batch in (("one", 1), ("many", 3)):
        code, out, err = run(*words, tmp_path / place, "--batch", batch)
        # These returns lie on a lattice and not at the beams of KITTI's sensor: a warning for each sweep.
        assert (code, out.count(": visible"), err.count(": warning: "), err.count("\n")) == (2, 4, 4, 6)
        assert "4 sweeps read, 1 problems" in err
        assert err.count("000004.bin: ") == 1
    for number in range(4):
        one, many = (read_npz(tmp_path / place / f"kitti_{number:03}.npz") for place in ("one", "many"))
        assert np.array_equal(one.visible_prob, many.visible_prob)
    assert one.visible().any()
    for number in range(1, 4):
        (folder / f"{number:06}.bin").write_bytes(bytes(1001))
    code, out, err = run(*words, tmp_path / "first")
    assert (code, out.count(": visible"), err.count("000004.bin: ")) == (2, 1, 1)
    assert [path.name for path in (tmp_path / "first").iterdir()] == ["kitti.npz"]
    assert "1 sweeps read, 4 problems" in err


@pytest.mark.parametrize("batch", [1, 2, 16])
def test_a_sweep_that_cannot_be_estimated_is_told_with_its_own_file(
    tmp_path: Path, batch: int, capsys: pytest.CaptureFixture[str]
) -> None:
    times = [2, 4, 1, 6, 3, 5, 8]
    sweeps = [Named(Sweep(np.zeros((0, 3), np.float32), t_ns=t_ns), f"s{t_ns}", Path(f"f{t_ns}.bin")) for t_ns in times]
    failures = Failures()
    summaries = list(Run(Picky((1, 3, 5)), 0.5, tmp_path, ("npz",)).summaries(sweeps, failures, batch))
    assert [summary.name for summary in summaries] == ["s2", "s4", "s6", "s8"]
    assert [read_npz(tmp_path / f"s{t_ns}_picky.npz").t_ns for t_ns in (2, 4, 6, 8)] == [2, 4, 6, 8]
    told = capsys.readouterr().err.splitlines()
    assert told == [f"viewshed: f{t_ns}.bin: no sweep {t_ns}" for t_ns in (1, 3, 5)]
    assert failures.count == 3


@pytest.mark.parametrize("batch", [1, 4])
def test_a_result_that_cannot_be_written_costs_a_line(files: list[Path], tmp_path: Path, batch: int) -> None:
    (tmp_path / "out" / "sweep1.npz").mkdir(parents=True)
    words = ("--grid", "64x16", "--results", "npz", "--out", tmp_path / "out", "--batch", batch)
    code, out, err = run("estimate", *files[:3], *words)
    assert (code, out.count("visible"), err.count("\n")) == (2, 2, 1)
    assert "path must name a file, got the folder" in err
