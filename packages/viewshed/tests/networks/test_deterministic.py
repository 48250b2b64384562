"""With dropout off the masks leave the graph, and nothing else changes."""

from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.networks.made import card, drawn, inputs

from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import NetworkCard
from viewshed.networks.deterministic import without_masks
from viewshed.networks.protobuf import encode, fields
from viewshed.networks.runtime import OnnxRunner, load_runner
from viewshed.networks.weights import WEIGHTS, shipped_content, with_checksum
from viewshed_lab.training.onnx_export import onnx_model
from viewshed_lab.training.quantize import quantize_network

SHAPES = [UNetShape(4, 2, 0.3), UNetShape(2, 1, 0.5), UNetShape(3, 3, 0.2), UNetShape(4, 3, 0.0)]
SHIPPED = sorted(path.stem for path in WEIGHTS.glob("*.onnx"))

LOGIT = 17.872940063476562
"""ONNX Runtime's sigmoid of this number is 1.0000001."""


def content_of(shape: UNetShape) -> bytes:
    return with_checksum(onnx_model(card(shape), drawn(shape)).SerializeToString())


def in_bytes(shape: UNetShape) -> bytes:
    module = drawn(shape)
    module.encoder[0].get_parameter("conv1.weight").data /= 150.0  # drawn for counts / 1000, not for 0 to 1
    maps = np.random.default_rng(2).integers(0, 256, (4, 1, 8, 8)).astype(np.uint8)
    content = with_checksum(onnx_model(card(shape), module).SerializeToString())
    return quantize_network(content, "made", list(maps.repeat(4, axis=2).repeat(4, axis=3)))


def drawn_input(told: NetworkCard, count: int = 1) -> np.ndarray[Any, np.dtype[Any]]:
    maps = np.random.default_rng(3).integers(0, 200, (count, 1, *told.grid.shape)).astype(np.uint8)
    return np.stack([told.shown(each) for each in maps])


def evaluated(content: bytes, **given: Any) -> np.ndarray[Any, np.dtype[Any]]:
    """What the operators of a graph compute one by one: an engine that optimizes it may add up in another order."""
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    found: np.ndarray[Any, np.dtype[Any]] = session.run(["probability"], given)[0]
    return found


def test_no_probability_is_above_one_where_the_sigmoid_of_the_engine_is() -> None:
    module = drawn(SHAPES[0])
    module.head.weight.data.zero_()
    module.head.get_parameter("bias").data.fill_(LOGIT)
    runner = OnnxRunner.of_content(with_checksum(onnx_model(card(SHAPES[0]), module).SerializeToString()), "made", 1)
    for masks in (None, SHAPES[0].no_masks(2)):
        assert (runner.run(inputs(2), masks) == 1.0).all()


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_graph_without_masks_says_the_same_to_the_bit(shape: UNetShape) -> None:
    content = content_of(shape)
    x = inputs(2)
    found = evaluated(without_masks(content), inputs=x)
    assert np.array_equal(found, evaluated(content, inputs=x, masks=shape.no_masks(2)))
    assert found.std() > 0.005


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_a_run_without_masks_is_a_run_with_dropout_off(shape: UNetShape) -> None:
    for content in (content_of(shape), in_bytes(shape)):
        runner = OnnxRunner.of_content(content, "made", 1)
        x = drawn_input(runner.card, 3)
        apart = np.abs(runner.run(x) - runner.run(x, shape.no_masks(3)))
        # Without dropout bytes are equal; with it the products with masks had rounded them once more, and how far that
        # goes in a few cells differs between processors.
        if runner.card.precision == "int8" and shape.dropout:
            assert np.quantile(apart, 0.99) < 0.03
            assert apart.max() < 0.1
        else:
            assert apart.max() < 2e-5  # 6e-6 on an Intel Xeon
        dropped = runner.run(x[:1], shape.masks(8, np.random.default_rng(4)))
        assert (dropped.std(axis=0).max() > 1e-3) == (shape.dropout > 0.0)


@pytest.mark.parametrize("name", SHIPPED)
def test_what_we_ship_says_the_same_with_and_without_masks(name: str) -> None:
    runner = load_runner(name, 1)
    x, shape = drawn_input(runner.card, 2), runner.card.shape
    found, masked = runner.run(x), runner.run(x, shape.no_masks(2))
    # As above: the product with a mask of ones rounds bytes once more.
    atol = 0.03 if runner.card.precision == "int8" and shape.dropout else 1e-6
    np.testing.assert_allclose(found, masked, rtol=0.0, atol=atol)
    assert np.array_equal(found, masked) or shape.dropout > 0.0
    graph = onnx.load_from_string(without_masks(shipped_content(name))).graph
    assert "Mul" not in {node.op_type for node in graph.node}


@given(st.lists(st.tuples(st.integers(1, 1 << 20), st.one_of(st.integers(0, (1 << 64) - 1), st.binary()))))
def test_fields_are_read_as_they_were_written(written: list[tuple[int, int | bytes]]) -> None:
    message = b"".join(encode(number, value) for number, value in written)
    read = [
        (number, value if isinstance(value, int) else bytes(value)) for number, value in fields(memoryview(message))
    ]
    assert read == written
