import json
import runpy
from pathlib import Path

import pytest
from tests.networks.made import GRID, card, drawn

from viewshed.grid import BevGrid
from viewshed.networks.runtime import OnnxRunner
from viewshed.networks.weights import WEIGHTS, default_name, manifest, shipped_content, shipped_names
from viewshed_lab.training.onnx_export import export_onnx

main = runpy.run_path(str(Path(__file__).resolve().parents[4] / "tools" / "ship_weights.py"))["main"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    export_onnx(tmp_path / "net.onnx", card(), drawn())
    main(
        [str(tmp_path / "net.onnx"), "--name", "yard", "--methods", "mc_dropout", "--folder", str(tmp_path / "weights")]
    )
    return tmp_path / "weights"


def test_weights_are_found_by_name_grid_target_and_method(folder: Path) -> None:
    assert shipped_names(folder) == ("yard",)
    assert default_name("mc_dropout", GRID, "car", folder) == "yard"
    assert OnnxRunner.of_content(shipped_content("yard", folder), "yard", 1).card == card()
    for method, grid, target in (
        ("unet", GRID, "car"), ("mc_dropout", BevGrid(32, 8.0), "car"), ("mc_dropout", GRID, "pedestrian"),
        ("mc_dropout", BevGrid(32, 16.0, (1.0, 0.0)), "car"),
    ):  # fmt: skip
        with pytest.raises(
            ValueError, match=f"method {method} needs weights, and this version ships none for a {target}"
        ):
            default_name(method, grid, target, folder)


def test_shipping_a_name_again_replaces_it(folder: Path) -> None:
    export_onnx(folder.parent / "net.onnx", card(), drawn(seed=9))
    before = shipped_content("yard", folder)
    main([str(folder.parent / "net.onnx"), "--name", "yard", "--folder", str(folder)])
    assert shipped_names(folder) == ("yard",)
    assert manifest(folder)["yard"].methods == ("unet", "mc_dropout")
    assert shipped_content("yard", folder) != before


def test_a_damaged_file_is_refused(folder: Path) -> None:
    path = folder / manifest(folder)["yard"].file
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ValueError, match=r"yard.onnx must have the checksum .*: it is damaged; install viewshed again"):
        shipped_content("yard", folder)


def test_what_does_not_run_is_not_shipped(tmp_path: Path) -> None:
    (tmp_path / "net.onnx").write_bytes(b"words")
    with pytest.raises(ValueError, match="must be a network that viewshed exported"):
        main([str(tmp_path / "net.onnx"), "--name", "yard", "--folder", str(tmp_path / "weights")])
    assert not (tmp_path / "weights").exists()


def test_everything_that_is_shipped_is_whole_and_fits_its_line() -> None:
    lines = manifest()
    assert sorted(path.name for path in WEIGHTS.glob("*.onnx")) == sorted(line.file for line in lines.values())
    for name, line in lines.items():
        found = OnnxRunner.of_content(shipped_content(name), name, 1).card
        assert (found.grid, found.target) == (BevGrid(line.cells, line.half_extent_m), line.target)
        assert found.trained, f"{name} does not say how it was trained"
        assert json.loads(found.to_json())["threshold"] > 0
        # Every network in bytes is there in float32 too.
        assert (name.endswith("_int8")) != (found.precision == "f32")
        other = lines[name.removesuffix("_int8")]
        assert (other.cells, other.half_extent_m, other.target) == (line.cells, line.half_extent_m, line.target)
