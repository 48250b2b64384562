"""``viewshed estimate --method unet|mcd`` as a stranger types it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run
from tests.networks.made import card, nearby

from viewshed import BevGrid, Sweep, write_sweep
from viewshed.io.export import read_npz
from viewshed.networks.architecture import UNetShape
from viewshed_lab.training.onnx_export import export_onnx

SHAPE = UNetShape(4, 2, 0.3)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """A sweep of ground, ahead and to the left only, and a network for it with threshold 0.7."""
    x, y = np.meshgrid(np.linspace(2, 14, 60), np.linspace(1, 9, 60))
    sweep = Sweep(np.stack([x.ravel(), y.ravel(), np.full(3600, -1.8)], axis=1).astype(np.float32))
    write_sweep(sweep, tmp_path / "sweep.ply")
    export_onnx(tmp_path / "net.onnx", card(SHAPE, BevGrid(64, 16.0), threshold=0.7), nearby(SHAPE))
    return tmp_path / "sweep.ply", tmp_path / "net.onnx"


@pytest.mark.parametrize("method", ["unet", "mc_dropout"])
def test_a_network_estimates(files: tuple[Path, Path], tmp_path: Path, method: str) -> None:
    sweep, net = files
    words = (sweep, "--method", method, "--weights", net, "--grid", "64x16", "--height", 1.8)
    code, out, err = run("estimate", *words, "--out", tmp_path / "out")
    assert (code, err) == (0, "")
    found = read_npz(tmp_path / "out" / f"sweep_{method}.npz")
    assert found.method == method
    assert f"visible {found.area_m2(0.7):.0f} m²" in out
    assert found.at(np.array([[8.0, 5.0]]))[0] > 0.9
    assert found.at(np.array([[8.0, -5.0]]))[0] < 0.1
    assert np.isnan(found.std).all() == (method == "unet")
    assert (tmp_path / "out" / f"sweep_{method}.geojson").stat().st_size > 100
    assert run("export", *words, "--to", "npz", "--out", tmp_path / "a.npz")[0] == 0
    assert read_npz(tmp_path / "a.npz").method == method


@pytest.mark.parametrize("command", ["estimate", "export"])
def test_grid_and_target_are_those_of_the_weights_where_none_are_given(
    files: tuple[Path, Path], tmp_path: Path, command: str
) -> None:
    sweep, net = files
    grid = BevGrid(64, 16.0)
    export_onnx(net, replace(card(SHAPE, grid), target="pedestrian"), nearby(SHAPE))
    out = {"estimate": ("--out", tmp_path), "export": ("--to", "npz", "--out", tmp_path / "sweep_unet.npz")}[command]
    assert run(command, sweep, "--weights", net, *(("--method", "unet") if command == "export" else ()), *out)[0] == 0
    found = read_npz(tmp_path / "sweep_unet.npz")
    assert (found.grid, found.target.name) == (grid, "pedestrian")
    code, _, err = run(command, sweep, "--method", "unet", "--weights", net, "--target", "car", *out)
    assert (code, "target must be pedestrian for the network" in err) == (2, True)
    code, _, err = run(command, sweep, "--method", "unet", "--weights", net, "--grid", "road", *out)
    assert (code, "grid must be 64x16 for the network" in err) == (2, True)


def test_seeds_and_passes_count(files: tuple[Path, Path], tmp_path: Path) -> None:
    sweep, net = files
    found = []
    for number, more in enumerate([(), ("--seed", 0), ("--seed", 1), ("--passes", 5)]):
        words = ("estimate", sweep, "--method", "mc_dropout", "--weights", net, "--grid", "64x16", *more)
        assert run(*words, "--out", tmp_path / str(number))[0] == 0
        std = read_npz(tmp_path / str(number) / "sweep_mc_dropout.npz").std
        assert std is not None
        found.append(std)
    assert np.array_equal(found[0], found[1])
    assert not np.array_equal(found[0], found[2])
    assert not np.array_equal(found[0], found[3])


def test_networks_stand_beside_the_others(files: tuple[Path, Path], tmp_path: Path) -> None:
    sweep, net = files
    words = (sweep, "--grid", "64x16", "--weights", net, "--out", tmp_path / "out.png")
    code, out, err = run("compare", *words, "--methods", "shadow_map,unet,mcd", "--passes", 3)
    assert (code, err) == (0, "")
    assert [line.split("|")[1].strip() for line in out.splitlines() if line.startswith("|")][2:] == [
        "shadow_map", "unet", "mc_dropout",
    ]  # fmt: skip
    code, _, err = run("compare", *words, "--methods", "shadow_map,majority_vote")
    assert (code, err.count("\n")) == (2, 1)
    assert "--device are for unet, mc_dropout, got methods shadow_map,majority_vote" in err


def test_networks_stand_beside_the_others_in_evaluate_truth(tmp_path: Path) -> None:
    words = ("simulate", "nuscenes-small", "--sweeps", 2, "--grid", "64x32", "--workers", 1, "--out", tmp_path / "data")
    assert run(*words)[0] == 0
    export_onnx(tmp_path / "net.onnx", card(SHAPE, BevGrid(64, 32.0)), nearby(SHAPE))
    evaluate = ("evaluate", "truth", tmp_path / "data", "--limit", 1, "--weights", tmp_path / "net.onnx")
    code, out, _ = run(*evaluate, "--methods", "first_blocker,unet")
    assert code == 0
    rows = {line.split("|")[1].strip(): line.split("|")[2:] for line in out.splitlines() if line.startswith("|")}
    assert 0.5 < float(rows["first_blocker"][0]) <= 1.0
    assert 0.1 < float(rows["unet"][0]) <= 1.0
    assert rows["unet"] != rows["first_blocker"]
    code, _, err = run(*evaluate, "--methods", "first_blocker")
    assert (code, "--weights goes with unet, mc_dropout among --methods, got first_blocker" in err) == (
        2,
        True,
    )


def test_where_no_method_is_asked_for_it_is_the_shadow_map_or_the_papers_label(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.linspace(2, 14, 60), np.linspace(-9, 9, 60))
    sweep = Sweep(np.stack([x.ravel(), y.ravel(), np.full(3600, -1.8)], axis=1).astype(np.float32))
    write_sweep(sweep, tmp_path / "sweep.ply")
    for number, (words, method) in enumerate(
        [
            ((), "shadow_map"),
            (("--grid", "indoor", "--target", "pedestrian"), "shadow_map"),
            (("--grid", "64x16"), "shadow_map"),
            (("--weights", "indoor", "--grid", "indoor", "--target", "pedestrian"), "unet"),
            (("--parameters", "paper"), "paper_label"),
        ]
    ):
        out = tmp_path / str(number)
        code, said, err = run("estimate", tmp_path / "sweep.ply", "--height", 1.8, "--out", out, *words)
        assert (code, err) == (0, "")
        assert read_npz(out / ("sweep.npz" if method == "shadow_map" else f"sweep_{method}.npz")).method == method, said


@pytest.mark.filterwarnings("default:method viewnet was removed")
def test_the_network_that_is_gone_is_the_default_with_one_line(files: tuple[Path, Path], tmp_path: Path) -> None:
    words = ("--grid", "64x16", "--height", 1.8, "--abstain-below", 0.9)
    code, out, err = run("estimate", files[0], "--method", "viewnet", *words, "--out", tmp_path)
    assert code == 0
    assert "(shadow_map," in out
    assert err == (
        "viewshed: warning: method viewnet was removed, and shadow_map, whose probability is calibrated, is used;"
        " version 0.5 will refuse the name\n"
    )
    found = read_npz(tmp_path / "sweep.npz")
    assert (found.method, found.threshold) == ("shadow_map", 0.9)
    code, out, err = run("compare", files[0], "--methods", "viewnet,vote", *words[:4], "--out", tmp_path / "a.png")
    assert (code, err.count("\n")) == (0, 1)
    assert "| shadow_map |" in out
