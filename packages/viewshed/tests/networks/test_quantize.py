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
from tests.networks.older import with_second_head

from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import INT8, NetworkCard
from viewshed.networks.onnx_export import export_onnx, onnx_model
from viewshed.networks.quantize import _model, mask_scale, quantize_network, to_channels_last
from viewshed.networks.runtime import OnnxRunner, values_of
from viewshed.networks.weights import with_checksum

SHAPES = [
    UNetShape(8, 2, 0.3, 3, 2), UNetShape(4, 3, 0.1), UNetShape(4, 1, 0.0, 2, 4), UNetShape(8, 3, 0.2, 4),
]  # fmt: skip
Maps = NDArray[np.uint8]


def maps(count: int, shape: UNetShape, seed: int = 1) -> list[Maps]:
    """Blocky maps: what lies side by side is alike, as in a sweep."""
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 256, (count, shape.channels, 8, 8)).astype(np.uint8)
    return list(small.repeat(4, axis=2).repeat(4, axis=3))


def made(shape: UNetShape, tmp_path: Path, counts: str = "log") -> tuple[OnnxRunner, OnnxRunner]:
    """A drawn network in float32 and in bytes."""
    told = replace(card(shape), counts=counts, clip=100, divisor=200.0)
    module = drawn(shape)
    module.encoder[0].get_parameter("conv1.weight").data /= 150.0  # drawn for counts / 1000, not for 0 to 1
    path = tmp_path / f"{counts}.onnx"
    export_onnx(path, told, module)
    content = quantize_network(path.read_bytes(), "made", maps(12, shape, 2), {"calibration": "blocks"})
    return OnnxRunner(path, 1), OnnxRunner.of_content(content, "bytes", 1)


@pytest.mark.parametrize("counts", ["log", "linear"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_a_network_in_bytes_says_nearly_what_it_said(shape: UNetShape, counts: str, tmp_path: Path) -> None:
    whole, small = made(shape, tmp_path, counts)
    frames = [np.minimum(each, 100) if counts == "log" else each for each in maps(4, shape)]
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


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_a_second_head_of_older_files_is_left_out(shape: UNetShape) -> None:
    """The nodes are copied with their names, so that the files in bytes are the same to the bit."""
    model = onnx_model(card(shape), drawn(shape))
    contents = [with_checksum(each.SerializeToString()) for each in (model, with_second_head(model))]
    found, older = (quantize_network(content, "made", maps(2, shape)) for content in contents)
    assert older == found


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_lean_graph_says_what_the_file_says(shape: UNetShape, tmp_path: Path) -> None:
    """Another order of the input and of the work, but the same numbers."""
    told = replace(card(shape), divisor=255.0)
    model = onnx_model(told, drawn(shape))
    lean = to_channels_last(model, told)
    run = values_of(
        _model(lean, lean.nodes, lean.constants, ["probability"], onnx.TensorProto.FLOAT).SerializeToString()
    )
    in_bytes = replace(told, trained={"precision": INT8})
    export_onnx(tmp_path / "a.onnx", told, drawn(shape))
    whole, frame = OnnxRunner(tmp_path / "a.onnx", 1), maps(1, shape)[0] // 40
    masks = shape.masks(3, np.random.default_rng(4))
    folded = in_bytes.shown(frame)[None].astype(np.float32) / np.float32(255.0)
    [found] = run({"inputs": folded, "masks": masks}, ["probability"])
    np.testing.assert_allclose(found, whole.run(told.shown(frame)[None], masks), atol=2e-5)
    assert found.std() > 0.01


def test_the_engine_computes_what_the_graph_says(tmp_path: Path) -> None:
    """The operators' own reference, without any optimization, rounds now and then the other way, no more."""
    shape = SHAPES[0]
    made(shape, tmp_path)
    content = quantize_network((tmp_path / "log.onnx").read_bytes(), "made", maps(6, shape, 2))
    small, masks = OnnxRunner.of_content(content, "bytes", 1), shape.masks(3, np.random.default_rng(4))
    x = small.card.shown(np.minimum(maps(1, shape)[0], 100))[None]
    reference: Any = ReferenceEvaluator(onnx.load_from_string(content))
    plain = reference.run(["probability"], {"inputs": x, "masks": masks})
    found = small.run(x, masks)
    assert found.std(axis=0).mean() > 0.01
    assert np.abs(found - plain[0]).mean() < 0.1 * found.std(axis=0).mean()


def test_bytes_are_folded_channel_by_channel_and_row_by_row() -> None:
    shape = UNetShape(4, 2, channels=2, fold=2)
    told = replace(card(shape), counts="log", clip=255, trained={"precision": INT8})
    frame = np.arange(2 * 32 * 32).reshape(2, 32, 32).astype(np.uint8)
    found = told.shown(frame)
    assert found.shape == told.input_shape == (16, 16, 8)
    counts = np.round(255 * np.log1p(frame[0].astype(float)) / np.log(256.0))
    assert found[3, 5, :4].tolist() == counts[6:8, 10:12].reshape(-1).tolist()
    assert found[3, 5, 4:].tolist() == frame[1, 6:8, 10:12].reshape(-1).tolist()


def test_the_card_tells_and_weights_are_bytes(tmp_path: Path) -> None:
    whole, small = made(SHAPES[0], tmp_path)
    assert whole.card.precision == "f32"
    assert small.card.precision == INT8
    assert small.card.trained == {**whole.card.trained, "calibration": "blocks", "precision": INT8}
    assert replace(small.card, trained=whole.card.trained) == whole.card
    content = quantize_network((tmp_path / "log.onnx").read_bytes(), "made", maps(1, SHAPES[0]))
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
    again = quantize_network(content, "made", maps(1, SHAPES[0]))
    with pytest.raises(ValueError, match="again must be a network in float32, got one in bytes; give the file that it"):
        quantize_network(again, "again", maps(1, SHAPES[0]))
    frame = maps(1, SHAPES[0])[0]
    with pytest.raises(ValueError, match=r"inputs must be uint8 of shape \(N, 16, 16, 12\), got float32 of shape"):
        small.run(whole.card.shown(frame)[None], whole.card.shape.no_masks(1))
    with pytest.raises(ValueError, match=r"inputs must be float32 of shape \(N, 3, 32, 32\), got uint8 of shape"):
        whole.run(small.card.shown(frame)[None], whole.card.shape.no_masks(1))


def test_what_a_mask_makes_larger_still_fits_its_bytes(tmp_path: Path) -> None:
    made(SHAPES[0], tmp_path)
    graph = onnx.load_from_string(
        quantize_network((tmp_path / "log.onnx").read_bytes(), "made", maps(1, SHAPES[0]))
    ).graph
    scales = {each.name: float(onnx.numpy_helper.to_array(each)) for each in graph.initializer if not each.dims}
    of = {name: scales.get(node.input[1]) for node in graph.node if "Linear" in node.op_type for name in node.output}
    told = {node.input[0]: scales.get(node.input[1]) for node in graph.node if node.op_type == "QuantizeLinear"}
    pairs = [
        (of[node.input[0]], told[node.output[0]])
        for node in graph.node
        if node.op_type == "Mul" and node.input[0] in of
    ]
    assert len(pairs) == len(SHAPES[0].masked_channels)
    for before, after in pairs:
        assert after == pytest.approx(before / (1.0 - SHAPES[0].dropout))


def test_engines_that_run_no_bytes_are_refused(tmp_path: Path) -> None:
    made(SHAPES[0], tmp_path)
    content = quantize_network((tmp_path / "log.onnx").read_bytes(), "made", maps(1, SHAPES[0]))
    line = "engine must be onnxruntime for bytes, a network in bytes, got cuda, which is for networks in float32"
    with pytest.raises(ValueError, match=line):
        OnnxRunner.of_content(content, "bytes", 1, "cuda")


@pytest.mark.parametrize("dropout", [0.0, 0.05, 0.1, 0.3, 0.5])
def test_masks_lose_almost_nothing_in_bytes(dropout: float) -> None:
    scale = mask_scale(dropout).scale
    for value in (1.0, 1.0 / (1.0 - dropout)):
        told = round(value / scale)
        assert told <= 255
        assert abs(told * scale / value - 1.0) < 0.001


def test_a_training_in_another_precision_is_no_network_in_bytes() -> None:
    assert NetworkCard("made", trained={"precision": "bf16"}).precision == "f32"
