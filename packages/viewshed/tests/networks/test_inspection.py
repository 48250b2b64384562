"""What a network's file may hold is decided before anything runs it, whoever wrote the file and its checksum."""

import json
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper
from tests.networks.made import GRID, card, drawn, inputs
from tests.networks.older import with_second_head

from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import NetworkCard
from viewshed.networks.inspection import inspect_network
from viewshed.networks.onnx_export import onnx_model
from viewshed.networks.quantize import quantize_network
from viewshed.networks.runtime import OnnxRunner
from viewshed.networks.weights import WEIGHTS, verify_checksum, with_checksum

SHAPES = [UNetShape(4, 2, 0.3), UNetShape(2, 1, 0.5, 3), UNetShape(3, 3, 0.2), UNetShape(4, 2, 0.3, 3, 2)]


def sealed(model: onnx.ModelProto) -> bytes:
    return with_checksum(model.SerializeToString())


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_what_we_export_passes(shape: UNetShape) -> None:
    content = sealed(onnx_model(card(shape), drawn(shape)))
    assert inspect_network(content, "a.onnx") == card(shape)
    maps = np.random.default_rng(1).integers(0, 9, (2, shape.channels, *GRID.shape)).astype(np.uint8)
    small = quantize_network(content, "a.onnx", maps)
    assert inspect_network(small, "a.onnx").precision == "int8"


@pytest.mark.parametrize("path", sorted(WEIGHTS.glob("*.onnx")), ids=lambda path: path.name)
def test_what_we_ship_passes(path: Path) -> None:
    model = onnx.load(path)
    told = {each.key: each.value for each in model.metadata_props}
    assert inspect_network(path.read_bytes(), path.name) == NetworkCard.from_json(told["viewshed.card"])


def _node(kind: str, inputs: list[str], output: str, **settings: Any) -> Callable[[onnx.ModelProto], None]:
    def change(model: onnx.ModelProto) -> None:
        model.graph.node.insert(0, helper.make_node(kind, inputs, [output], **settings))

    return change


def _branch(model: onnx.ModelProto) -> None:
    then = helper.make_graph([helper.make_node("Relu", ["masks"], ["r"])], "then", [], [])
    model.graph.node.append(helper.make_node("If", ["masks"], ["branch"], then_branch=then, else_branch=then))


def _loop(model: onnx.ModelProto) -> None:
    body = helper.make_graph([helper.make_node("Relu", ["masks"], ["r"])], "body", [], [])
    model.graph.node.append(helper.make_node("Loop", ["", "masks"], ["looped"], body=body))


def _graph_in_a_known_operator(model: onnx.ModelProto) -> None:
    body = helper.make_graph([helper.make_node("Relu", ["masks"], ["r"])], "body", [], [])
    model.graph.node.append(helper.make_node("Relu", ["masks"], ["relu"], body=body))


def _external(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"


def _other_output(model: onnx.ModelProto) -> None:
    older = with_second_head(model)
    older.graph.output[1].name = older.graph.node[-1].output[0] = "variance"
    model.CopyFrom(older)


def _sixteen_gigabytes(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer.add()
    tensor.name, tensor.data_type, tensor.raw_data = "huge", TensorProto.FLOAT, b"1234"
    tensor.dims.extend([65536, 65536])


def _doubled(model: onnx.ModelProto) -> None:
    for number in range(30):
        last = f"twice{number - 1}" if number else "inputs"
        model.graph.node.append(helper.make_node("Concat", [last, last], [f"twice{number}"], axis=1))


def _outer_product(model: onnx.ModelProto) -> None:
    for name, shape in (("row", [1, -1]), ("column", [-1, 1])):
        model.graph.initializer.append(numpy_helper.from_array(np.array(shape), f"{name}_shape"))
        model.graph.node.append(helper.make_node("Reshape", ["inputs", f"{name}_shape"], [name]))
    model.graph.node.append(helper.make_node("Mul", ["row", "column"], ["outer"]))


def _batch_by_batch(model: onnx.ModelProto) -> None:
    """A tensor of the size of the card's for one sweep, which grows with the square of the batch."""
    for name, shape in (("row", [1, -1, 32]), ("column", [-1, 1, 32])):
        model.graph.initializer.append(numpy_helper.from_array(np.array(shape), f"{name}_shape"))
        model.graph.node.append(helper.make_node("Reshape", ["masks", f"{name}_shape"], [name]))
    model.graph.node.append(helper.make_node("Mul", ["row", "column"], ["all"]))
    for number in range(6):
        before = "all" if not number else f"more{number - 1}"
        model.graph.node.append(helper.make_node("Concat", [before, before], [f"more{number}"], axis=1))


def _padded(model: onnx.ModelProto) -> None:
    conv = next(node for node in model.graph.node if node.op_type == "Conv")
    [pads] = [each for each in conv.attribute if each.name == "pads"]
    pads.ints[:] = [9999] * 4


def _padded_in_two_ways(model: onnx.ModelProto) -> None:
    _padded(model)
    conv = next(node for node in model.graph.node if node.op_type == "Conv")
    next(each for each in conv.attribute if each.name == "pads").i = 1


def _much_work(model: onnx.ModelProto) -> None:
    conv = [node for node in model.graph.node if node.op_type == "Conv"][1]
    for number in range(200):
        copy = model.graph.node.add()
        copy.CopyFrom(conv)
        copy.output[0] = f"again{number}"


def _other_card(**changes: object) -> Callable[[onnx.ModelProto], None]:
    def change(model: onnx.ModelProto) -> None:
        content = json.loads(model.metadata_props[0].value)
        model.metadata_props[0].value = json.dumps({**content, **changes})

    return change


SMALL = {"width": 4, "depth": 2, "dropout": 0.3, "channels": 1, "fold": 1}
WIDE = {"cells": 4096, "half_extent_m": 16.0, "offset_m": [0.0, 0.0]}


def _functions(model: onnx.ModelProto) -> None:
    model.functions.append(
        helper.make_function("viewshed", "F", ["x"], ["y"], [helper.make_node("Relu", ["x"], ["y"])], [])
    )


@pytest.mark.parametrize(("change", "message"), [
    (_branch, "the operator If"),
    (_loop, "the operator Loop"),
    (_node("Scan", ["inputs"], "scanned", num_scan_inputs=1), "the operator Scan"),
    (_node("ConstantOfShape", ["inputs"], "filled"), "the operator ConstantOfShape"),
    (_node("Expand", ["inputs", "masks"], "wide"), "the operator Expand"),
    (_node("Relu", ["inputs"], "other", domain="com.example"), "the operator com.example.Relu"),
    (_functions, "functions or training of its own"),
    (_graph_in_a_known_operator, "a setting 'body' that is a tensor, a graph or a fraction"),
    (_other_output, "they must be inputs, masks and ..probability.."),
    (_external, "the constant 'c0' with data outside of the file"),
    (_sixteen_gigabytes, r"the constant 'huge' of shape \[65536, 65536\], 17179869184 bytes, with 4 in the file"),
    (_doubled, r"a tensor of shape \[1, \d+, 32, 32\], more than"),
    (_outer_product, r"a tensor of shape \[1024, 1024\], more than"),
    (_batch_by_batch, r"a tensor of shape \[32, \d+, 32\], more than"),
    (_padded, r"a convolution of 1 channels by 1, kernel \[3, 3\], pads \[9999, 9999, 9999, 9999\]"),
    (_padded_in_two_ways, "a setting 'pads' with several values"),
    (_much_work, r"[\d,]+ products, more than"),
    (_other_card(shape=SMALL | {"width": 8}), r"a split of 64 channels into \[8, 16, 8\]"),
    (_other_card(shape=SMALL | {"width": 256}, grid=WIDE), "numbers in one layer"),
    (_node("Loo\np\x1b[31m", ["inputs"], "other"), r"the operator Loo\?p\?\[31m"),
    (_node("Relu", ["nowhere"], "other"), r"a graph that cannot run \('nowhere'\)"),
])  # fmt: skip
def test_what_we_never_export_is_refused(change: Callable[[onnx.ModelProto], None], message: str) -> None:
    model = onnx_model(card(), drawn())
    change(model)
    began = time.perf_counter()
    with pytest.raises(ValueError, match=f"^a.onnx must hold only what viewshed exports, got .*{message}") as caught:
        OnnxRunner.of_content(sealed(model), "a.onnx", 1)
    assert "\n" not in str(caught.value)
    assert time.perf_counter() - began < 5.0


def test_what_fails_while_it_runs_is_one_line() -> None:
    model = onnx_model(card(), drawn())
    model.graph.input[1].type.tensor_type.shape.dim[1].dim_value = 31  # the graph says one thing, its nodes another
    with pytest.raises(
        ValueError, match=r"^a.onnx (cannot be run \(.*\); export it again|must be a network)"
    ) as caught:
        OnnxRunner.of_content(sealed(model), "a.onnx", 1).run(inputs(1), card().shape.no_masks(1))
    assert "\n" not in str(caught.value)


@lru_cache(maxsize=1)
def _model() -> bytes:
    content: bytes = onnx_model(card(), drawn()).SerializeToString()
    return content


@settings(max_examples=60, deadline=None)
@given(at=st.floats(0, 1, exclude_max=True), byte=st.integers(1, 255), structure=st.booleans())
def test_whatever_is_changed_is_refused_or_runs(at: float, byte: int, structure: bool) -> None:
    """Half of the changes hit the graph's structure, which lies before the constants, half any byte."""
    content = bytearray(_model())
    content[int(at * (content.index(b"c0") + 2000 if structure else len(content)))] ^= byte
    try:
        runner = OnnxRunner.of_content(with_checksum(bytes(content)), "a.onnx", 1)
        assert runner.run(inputs(1), runner.card.shape.no_masks(1)).shape == (1, *GRID.shape)
    except ValueError as error:
        assert "\n" not in str(error)  # noqa: PT017 - either is right


def test_a_checksum_that_differs_in_one_digit_is_another() -> None:
    sound = with_checksum(b"model")
    verify_checksum(sound, "a.onnx")
    for digit in range(64):
        at = len(sound) - 64 + digit
        other = b"0" if sound[at : at + 1] != b"0" else b"1"
        with pytest.raises(ValueError, match="must have the checksum"):
            verify_checksum(sound[:at] + other + sound[at + 1 :], "a.onnx")
