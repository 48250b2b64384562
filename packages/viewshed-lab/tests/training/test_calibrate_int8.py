"""From a config and a network to a network in bytes, as the command does it."""

import contextlib
import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.networks.made import nearby

from viewshed.cli import main
from viewshed.networks.card import INT8
from viewshed.networks.runtime import OnnxRunner
from viewshed_lab.training import TrainConfig
from viewshed_lab.training import calibrate_int8 as module
from viewshed_lab.training.calibrate_int8 import quantize
from viewshed_lab.training.data import archived_samples
from viewshed_lab.training.onnx_export import export_onnx
from viewshed_lab.training.samples import TrainingSample, paper_label

pytestmark = pytest.mark.slow


@pytest.fixture
def fresh(config: TrainConfig, tmp_path: Path) -> tuple[TrainConfig, Path]:
    """A config of simulated sweeps, and a network that says what lies near returns."""
    made = replace(config, data=("nuscenes-small",), attacks=("ghost_wall",), counts="log")
    export_onnx(tmp_path / "net.onnx", made.card(seed="1"), nearby(made.card().shape))
    return made, tmp_path / "net.onnx"


def test_a_network_is_quantized_and_compared(fresh: tuple[TrainConfig, Path], tmp_path: Path) -> None:
    config, network = fresh
    costs = quantize(config, network, tmp_path / "bytes.onnx", 3)
    assert [each.passes for each in costs] == [1, 10]
    for found in costs:
        assert 0.2 < found.f1 < 1.0
        assert found.f1 - found.f1_int8 <= module.MAX_F1_LOSS
        assert 0.0 < found.mean_difference < 0.1
        assert 0.0 <= found.flipped_share < 0.1
    assert costs[0].deviation == costs[0].deviation_int8 == 0.0
    # All doubt of this network is one weight, a thousandth of its neighbor: bytes lose it, and the cost says so.
    assert costs[1].deviation > 0.005
    assert costs[1].deviation_int8 == 0.0
    card = OnnxRunner(tmp_path / "bytes.onnx", 1).card
    assert card.precision == INT8
    assert card.trained["calibration"] == "3 sweeps of nuscenes-small, 50% attacked"
    assert card.trained["seed"] == "1"
    assert quantize(config, network, tmp_path / "again.onnx", 3) == costs
    assert (tmp_path / "again.onnx").read_bytes() == (tmp_path / "bytes.onnx").read_bytes()


def test_counting_stops_early_where_few_cells_with_many_returns_set_the_step_of_all(
    fresh: tuple[TrainConfig, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This network asks whether there are returns, not how many; beside the sensor are hundreds a cell."""
    config = replace(fresh[0], counts="linear")
    export_onnx(tmp_path / "net.onnx", config.card(), nearby(config.card().shape))
    early, *_ = quantize(config, tmp_path / "net.onnx", tmp_path / "early.onnx", 3)
    assert OnnxRunner(tmp_path / "early.onnx", 1).card.clip < config.card().clip == 255
    monkeypatch.setattr(module, "_CLIPS", ())
    late, *_ = quantize(config, tmp_path / "net.onnx", tmp_path / "late.onnx", 3)
    assert early.mean_difference < 0.5 * late.mean_difference


@pytest.mark.parametrize("variant", ["mle", "mcd"])
def test_a_network_of_the_papers_label_is_checked_by_that_label_on_its_own_grid(
    config: TrainConfig, tmp_path: Path, variant: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The archive has exact truth on ±32 m, the network looks ±40 m far."""
    made = replace(config, truth="paper_label", half_extent_m=40.0, attacks=("paper",), variant=variant)
    export_onnx(tmp_path / "net.onnx", made.card(), nearby(made.card().shape))
    checked: list[TrainingSample] = []
    draw = module._samples

    def drawn(config: TrainConfig, count: int) -> Iterator[TrainingSample]:
        checked.extend(draw(config, count))
        return iter(checked)

    monkeypatch.setattr(module, "_samples", drawn)
    costs = quantize(made, tmp_path / "net.onnx", tmp_path / "bytes.onnx", 3)
    assert [each.passes for each in costs] == ([1, 10] if variant == "mcd" else [1])
    sweeps = archived_samples(replace(made, truth="probe", half_extent_m=32.0))
    labels = [paper_label(sweeps.clean(k).sweep, made.grid, indoor=False) for k in range(len(sweeps))]
    assert all(any(np.array_equal(each.visible, label) for label in labels) for each in checked)
    assert all(each.known.all() for each in checked)


def test_what_loses_too_much_is_not_written(
    fresh: tuple[TrainConfig, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, network = fresh
    monkeypatch.setattr(module, "MAX_F1_LOSS", -1.0)
    with pytest.raises(ValueError, match=r"F1 in int8 must be within -1.0 of float32, got 0\.\d{4} and 0\.\d{4};"):
        quantize(config, network, tmp_path / "bytes.onnx", 1)
    assert not (tmp_path / "bytes.onnx").exists()


def test_another_config_and_too_few_sweeps_are_refused(config: TrainConfig, tmp_path: Path) -> None:
    export_onnx(tmp_path / "net.onnx", config.card(), nearby(config.card().shape))
    for other, frames, message in (
        (replace(config, max_range_m=30.0), 1, "with max_range_m 30.0, got 100.0"),
        (config, 13, "frames must be at most 12, half of the sweeps in the data, got 13"),
    ):
        with pytest.raises(ValueError, match=message):
            quantize(other, tmp_path / "net.onnx", tmp_path / "bytes.onnx", frames)


def test_the_command_tells_what_it_costs(fresh: tuple[TrainConfig, Path], tmp_path: Path) -> None:
    config, network = fresh
    lines = [f"{key} = {json.dumps(value)}" for key, value in config.to_json().items() if key != "name"]
    (tmp_path / "tiny.toml").write_text("\n".join(lines), "utf-8")
    out, path = io.StringIO(), tmp_path / "bytes.onnx"
    with contextlib.redirect_stdout(out), pytest.raises(SystemExit) as end:
        main(["quantize", str(tmp_path / "tiny.toml"), str(network), "--out", str(path), "--frames", "2"])
    assert end.value.code in (0, None)
    assert out.getvalue().startswith(f"{path}: F1 0.")
    assert "in float32; probabilities 0.0" in out.getvalue()
    shown = np.zeros((1, 1, *config.grid.shape), np.uint8)
    runner = OnnxRunner(path, 1)
    assert runner.run(runner.card.shown(shown[0])[None], runner.card.shape.no_masks(1)).max() <= 1.0
