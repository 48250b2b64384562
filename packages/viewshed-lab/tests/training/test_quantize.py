"""A network in bytes beside the one in float32 that it was made of."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray
from onnx.reference import ReferenceEvaluator
from tests.networks.made import card, drawn

from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import INT8
from viewshed.networks.runtime import OnnxRunner
from viewshed_lab.training import quantize
from viewshed_lab.training.onnx_export import export_onnx
from viewshed_lab.training.quantize import quantize_network

SHAPES = [UNetShape(8, 2, 0.3), UNetShape(4, 3, 0.1), UNetShape(8, 1, 0.0), UNetShape(8, 3, 0.2)]
Maps = NDArray[np.uint8]


def maps(count: int, seed: int = 1) -> list[Maps]:
    """Blocky maps: what lies side by side is alike, as in a sweep."""
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 256, (count, 1, 8, 8)).astype(np.uint8)
    return list(small.repeat(4, axis=2).repeat(4, axis=3))


def made(shape: UNetShape, tmp_path: Path, counts: str = "log") -> tuple[OnnxRunner, OnnxRunner]:
    """A drawn network in float32 and in bytes."""
    told = replace(card(shape), counts=counts, clip=100, divisor=200.0)
    module = drawn(shape)
    module.encoder[0].get_parameter("conv1.weight").data /= 150.0  # drawn for counts / 1000, not for 0 to 1
    path = tmp_path / f"{counts}.onnx"
    export_onnx(path, told, module)
    content = quantize_network(path.read_bytes(), "made", maps(12, 2), {"calibration": "blocks"})
    return OnnxRunner(path, 1), OnnxRunner.of_content(content, "bytes", 1)


@pytest.mark.parametrize(("shape", "counts"), list(zip(SHAPES, ("log", "linear") * 2, strict=True)), ids=str)
def test_a_network_in_bytes_says_nearly_what_it_said(shape: UNetShape, counts: str, tmp_path: Path) -> None:
    whole, small = made(shape, tmp_path, counts)
    frames = maps(4)
    masks = shape.masks(4, np.random.default_rng(5))
    for m in (shape.no_masks(4), masks):
        expected, found = (r.run(np.stack([r.card.shown(each) for each in frames]), m) for r in (whole, small))
        assert expected.std() > 0.03
        assert np.abs(found - expected).mean() < 0.1 * expected.std()
    one = [r.run(r.card.shown(frames[0])[None], masks) for r in (whole, small)]
    spread = [each.std(axis=0).mean() for each in one]
    assert spread[1] == pytest.approx(spread[0], rel=0.15, abs=1e-6)
    if shape.dropout:
        assert spread[0] > 0.002


def test_corrected_biases_take_back_what_rounding_adds_on_average(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where most cells are empty, they are alike: rounding shifts all of them one way."""
    shape, frames = UNetShape(8, 3, 0.0), [np.where(each < 200, 0, each - 190).astype(np.uint8) for each in maps(12)]
    whole, _ = made(shape, tmp_path, "linear")
    content, off = (tmp_path / "linear.onnx").read_bytes(), list[float]()
    expected = whole.run(np.stack([whole.card.shown(each) for each in frames]))
    for correct in (quantize._correct_biases, lambda *_: None):
        monkeypatch.setattr(quantize, "_correct_biases", correct)
        small = OnnxRunner.of_content(quantize_network(content, "made", frames), "bytes", 1)
        off.append(abs(float((small.run(np.stack([small.card.shown(each) for each in frames])) - expected).mean())))
    assert off[0] < 0.3 * off[1]


def test_the_engine_computes_what_the_graph_says(tmp_path: Path) -> None:
    """The operators' own reference, without any optimization, rounds now and then the other way, no more."""
    shape = SHAPES[0]
    made(shape, tmp_path)
    content = quantize_network((tmp_path / "log.onnx").read_bytes(), "made", maps(6, 2))
    small, masks = OnnxRunner.of_content(content, "bytes", 1), shape.masks(3, np.random.default_rng(4))
    x = small.card.shown(maps(1)[0])[None]
    reference: Any = ReferenceEvaluator(onnx.load_from_string(content))
    plain = reference.run(["probability"], {"inputs": x, "masks": masks})
    found = small.run(x, masks)
    assert found.std(axis=0).mean() > 0.01
    assert np.abs(found - plain[0]).mean() < 0.1 * found.std(axis=0).mean()


def test_the_card_tells_and_weights_are_bytes(tmp_path: Path) -> None:
    whole, small = made(SHAPES[0], tmp_path)
    assert whole.card.precision == "f32"
    assert small.card.precision == INT8
    assert small.card.trained == {**whole.card.trained, "calibration": "blocks", "precision": INT8}
    assert replace(small.card, trained=whole.card.trained) == whole.card
    content = quantize_network((tmp_path / "log.onnx").read_bytes(), "made", maps(1))
    kinds = {node.op_type for node in onnx.load_from_string(content).graph.node}
    assert {"QuantizeLinear", "DequantizeLinear"} < kinds
    weights = [each for each in onnx.load_from_string(content).graph.initializer if len(each.dims) == 4]
    assert len(weights) >= 2 * 5 + 2
    assert {each.data_type for each in weights} == {onnx.TensorProto.INT8}


def test_what_cannot_be_quantized_is_refused(tmp_path: Path) -> None:
    whole, small = made(SHAPES[0], tmp_path)
    content = (tmp_path / "log.onnx").read_bytes()
    with pytest.raises(ValueError, match="frames must be at least one, got none"):
        quantize_network(content, "made", [])
    again = quantize_network(content, "made", maps(1))
    with pytest.raises(ValueError, match="again must be a float32 network, got an int8 one; give the file that it"):
        quantize_network(again, "again", maps(1))
    frame = maps(1)[0]
    with pytest.raises(ValueError, match=r"inputs must be uint8 of shape \(N, 32, 32, 1\), got float32 of shape"):
        small.run(whole.card.shown(frame)[None], whole.card.shape.no_masks(1))
    with pytest.raises(ValueError, match=r"inputs must be float32 of shape \(N, 1, 32, 32\), got uint8 of shape"):
        whole.run(small.card.shown(frame)[None], whole.card.shape.no_masks(1))


def test_engines_that_run_no_bytes_are_refused(tmp_path: Path) -> None:
    made(SHAPES[0], tmp_path)
    content = quantize_network((tmp_path / "log.onnx").read_bytes(), "made", maps(1))
    line = (
        "engine must be onnxruntime for bytes, a network with 8-bit weights, got cuda, which is for networks in float32"
    )
    with pytest.raises(ValueError, match=line):
        OnnxRunner.of_content(content, "bytes", 1, "cuda")
