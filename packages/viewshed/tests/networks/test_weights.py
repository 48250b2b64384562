import hashlib
import json
import runpy
import sys
from pathlib import Path

import pytest
from tests.networks.made import GRID, card, drawn

from viewshed.estimators import load_estimator
from viewshed.grid import BevGrid
from viewshed.networks.card import INT8
from viewshed.networks.runtime import OnnxRunner, load_runner
from viewshed.networks.weights import WEIGHTS, default_name, manifest, shipped_content, shipped_names
from viewshed_lab.networks import WEIGHTS as STUDY
from viewshed_lab.training.onnx_export import export_onnx

ADDED = tuple(name for name in shipped_names() if name not in manifest())
"""What installed packages add, such as the laboratory."""

IN_FLOAT32 = ("paper-mle-adversarial-carla", "paper-mcd-adversarial-carla")
"""Networks of the published study that would lose more than .002 F1 in int8."""

main = runpy.run_path(str(Path(__file__).resolve().parents[4] / "tools" / "ship_weights.py"))["main"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Weights that another installed package ships."""
    facts = tmp_path / "yards-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: yards\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text("[viewshed.weights]\nyards = yards:WEIGHTS\n")
    (tmp_path / "yards.py").write_text("from pathlib import Path\nWEIGHTS = Path(__file__).with_name('weights')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "yards", raising=False)
    export_onnx(tmp_path / "net.onnx", card(), drawn())
    main(
        [str(tmp_path / "net.onnx"), "--name", "yard", "--methods", "mc_dropout", "--folder", str(tmp_path / "weights")]
    )
    return tmp_path / "weights"


def test_weights_are_found_by_name_grid_target_and_method(folder: Path) -> None:
    assert shipped_names() == (*manifest(), "yard", *ADDED)
    assert default_name("mc_dropout", GRID, "car", folder) == "yard"
    assert load_runner("yard", 1).card == card()
    for method, grid, target in (
        ("unet", GRID, "car"), ("mc_dropout", BevGrid(32, 8.0), "car"), ("mc_dropout", GRID, "pedestrian"),
        ("mc_dropout", BevGrid(32, 16.0, (1.0, 0.0)), "car"),
    ):  # fmt: skip
        with pytest.raises(
            ValueError, match=f"method {method} needs weights, and this version ships none for a {target}"
        ):
            default_name(method, grid, target, folder)


def test_weights_of_another_package_are_taken_by_name_alone(folder: Path) -> None:
    with pytest.raises(ValueError, match="method mc_dropout needs weights, and this version ships none for a car"):
        load_estimator("mc_dropout", grid=GRID)
    assert load_estimator("mc_dropout", weights="yard").grid == GRID


def test_shipping_a_name_again_replaces_it(folder: Path) -> None:
    export_onnx(folder.parent / "net.onnx", card(), drawn(seed=9))
    before = shipped_content("yard")
    main([str(folder.parent / "net.onnx"), "--name", "yard", "--folder", str(folder)])
    assert list(manifest(folder)) == ["yard"]
    assert manifest(folder)["yard"].methods == ("unet", "mc_dropout")
    assert shipped_content("yard") != before


def test_a_damaged_file_is_refused(folder: Path) -> None:
    path = folder / manifest(folder)["yard"].file
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ValueError, match=r"yard.onnx must have the checksum .*: it is damaged; install yards again"):
        shipped_content("yard")


def test_what_does_not_run_is_not_shipped(tmp_path: Path) -> None:
    (tmp_path / "net.onnx").write_bytes(b"words")
    with pytest.raises(ValueError, match="must be a network that viewshed exported"):
        main([str(tmp_path / "net.onnx"), "--name", "yard", "--folder", str(tmp_path / "weights")])
    assert not (tmp_path / "weights").exists()


@pytest.mark.parametrize("folder", [WEIGHTS, STUDY])
def test_everything_that_is_shipped_is_whole_and_fits_its_line(folder: Path) -> None:
    lines = manifest(folder)
    assert sorted(path.name for path in folder.glob("*.onnx")) == sorted(line.file for line in lines.values())
    for name, line in lines.items():
        content = (folder / line.file).read_bytes()
        assert hashlib.sha256(content).hexdigest() == line.sha256
        found = OnnxRunner.of_content(content, name, 1).card
        assert (found.grid, found.target) == (BevGrid(line.cells, line.half_extent_m), line.target)
        assert found.trained, f"{name} does not say how it was trained"
        assert json.loads(found.to_json())["threshold"] > 0
        if folder == STUDY:
            assert (found.name, found.precision, line.methods) == (name, "f32" if name in IN_FLOAT32 else INT8, ())
            continue
        # Every network in bytes is there in float32 too.
        assert (name.endswith("_int8")) != (found.precision == "f32")
        other = lines[name.removesuffix("_int8")]
        assert (other.cells, other.half_extent_m, other.target) == (line.cells, line.half_extent_m, line.target)
