"""With dropout off the masks leave the graph, and nothing else changes."""

from dataclasses import replace
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.networks.made import GRID, card, drawn, inputs
from tests.networks.older import with_second_head

from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import NetworkCard
from viewshed.networks.deterministic import without_masks
from viewshed.networks.onnx_export import onnx_model
from viewshed.networks.protobuf import encode, fields
from viewshed.networks.quantize import quantize_network
from viewshed.networks.runtime import OnnxRunner, load_runner
from viewshed.networks.weights import WEIGHTS, shipped_content, with_checksum

SHAPES = [UNetShape(4, 2, 0.3), UNetShape(2, 1, 0.5, 3), UNetShape(3, 3, 0.2, 3, 2), UNetShape(4, 3, 0.0, 2, 4)]
SHIPPED = sorted(path.stem for path in WEIGHTS.glob("*.onnx"))


def content_of(shape: UNetShape, *, older: bool = False) -> bytes:
    model = onnx_model(card(shape), drawn(shape))
    return with_checksum((with_second_head(model) if older else model).SerializeToString())


def in_bytes(shape: UNetShape) -> bytes:
    module = drawn(shape)
    module.encoder[0].get_parameter("conv1.weight").data /= 150.0  # drawn for counts / 1000, not for 0 to 1
    maps = np.random.default_rng(2).integers(0, 256, (4, shape.channels, 8, 8)).astype(np.uint8)
    content = with_checksum(onnx_model(card(shape), module).SerializeToString())
    return quantize_network(content, "made", list(maps.repeat(4, axis=2).repeat(4, axis=3)))


def drawn_input(told: NetworkCard, count: int = 1) -> np.ndarray[Any, np.dtype[Any]]:
    maps = np.random.default_rng(3).integers(0, 200, (count, told.shape.channels, *told.grid.shape)).astype(np.uint8)
    return np.stack([told.shown(each) for each in maps])


def evaluated(content: bytes, **given: Any) -> np.ndarray[Any, np.dtype[Any]]:
    """What the operators of a graph compute one by one: an engine that optimizes it may add up in another order."""
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    found: np.ndarray[Any, np.dtype[Any]] = session.run(["probability"], given)[0]
    return found


@pytest.mark.parametrize("older", [False, True], ids=["", "older"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_graph_without_masks_says_the_same_to_the_bit(shape: UNetShape, older: bool) -> None:
    content = content_of(shape, older=older)
    x = inputs(2, shape)
    found = evaluated(without_masks(content), inputs=x)
    assert np.array_equal(found, evaluated(content, inputs=x, masks=shape.no_masks(2)))
    assert found.std() > 0.005


def test_a_network_in_bytes_without_dropout_says_the_same_to_the_bit() -> None:
    shape = SHAPES[-1]
    content = in_bytes(shape)
    x = drawn_input(replace(card(shape), trained={"precision": "int8"}))
    found = evaluated(without_masks(content), inputs=x)
    assert np.array_equal(found, evaluated(content, inputs=x, masks=shape.no_masks(1)))
    assert found.std() > 0.005


@pytest.mark.parametrize("older", [False, True], ids=["", "older"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_only_masks_and_products_with_them_leave(shape: UNetShape, older: bool) -> None:
    before, after = (
        onnx.load_from_string(each) for each in (content_of(shape), without_masks(content_of(shape, older=older)))
    )
    onnx.checker.check_model(after, full_check=True)
    left = [node.op_type for node in before.graph.node if node.op_type not in ("Mul", "Split", "Unsqueeze")]
    assert [node.op_type for node in after.graph.node] == left
    assert [each.name for each in after.graph.input] == ["inputs"]
    assert list(after.graph.output) == list(before.graph.output)
    constants = {each.name: each for each in after.graph.initializer}
    assert all(constants[each.name] == each for each in before.graph.initializer)
    assert (after.ir_version, list(after.opset_import)) == (before.ir_version, list(before.opset_import))


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_a_run_without_masks_is_a_run_with_dropout_off(shape: UNetShape) -> None:
    for content in (content_of(shape), content_of(shape, older=True), in_bytes(shape)):
        runner = OnnxRunner.of_content(content, "made", 1)
        x = drawn_input(runner.card, 3)
        # Without dropout bytes are equal; with it the products with masks had rounded them once more.
        atol = 0.03 if runner.card.precision == "int8" and shape.dropout else 5e-6
        np.testing.assert_allclose(runner.run(x), runner.run(x, shape.no_masks(3)), atol=atol)
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


def test_many_sweeps_in_parts_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    runner = OnnxRunner.of_content(content_of(SHAPES[0]), "made", 1)
    whole = runner.run(inputs(7))
    monkeypatch.setattr("viewshed.networks.runtime._CELLS_AT_ONCE", 3 * GRID.cells**2)
    np.testing.assert_allclose(runner.run(inputs(7)), whole, atol=1e-6)
    with pytest.raises(ValueError, match="inputs must be at least one, got none"):
        runner.run(inputs(7)[:0])


@given(st.lists(st.tuples(st.integers(1, 1 << 20), st.one_of(st.integers(0, (1 << 64) - 1), st.binary()))))
def test_fields_are_read_as_they_were_written(written: list[tuple[int, int | bytes]]) -> None:
    message = b"".join(encode(number, value) for number, value in written)
    read = [
        (number, value if isinstance(value, int) else bytes(value)) for number, value in fields(memoryview(message))
    ]
    assert read == written
