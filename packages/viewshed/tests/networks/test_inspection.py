"""What a network's file may hold is decided before anything runs it, whoever wrote the file and its checksum."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper
from tests.networks.made import GRID, card, drawn, inputs
from tests.networks.older import with_second_head

from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import NetworkCard
from viewshed.networks.inspection import inspect_network
from viewshed.networks.runtime import OnnxRunner
from viewshed.networks.weights import WEIGHTS, verify_checksum, with_checksum
from viewshed_lab.training.onnx_export import onnx_model
from viewshed_lab.training.quantize import quantize_network

SHAPES = [UNetShape(4, 2, 0.3), UNetShape(2, 1, 0.5), UNetShape(3, 3, 0.2)]


def sealed(model: onnx.ModelProto) -> bytes:
    return with_checksum(model.SerializeToString())


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_what_we_export_passes(shape: UNetShape) -> None:
    content = sealed(onnx_model(card(shape), drawn(shape)))
    assert inspect_network(content, "a.onnx") == card(shape)
    maps = np.random.default_rng(1).integers(0, 9, (2, 1, *GRID.shape)).astype(np.uint8)
    small = quantize_network(content, "a.onnx", maps)
    assert inspect_network(small, "a.onnx").precision == "int8"


@pytest.mark.parametrize("path", sorted(WEIGHTS.glob("*.onnx")), ids=lambda path: path.name)
def test_what_we_ship_passes(path: Path) -> None:
    model = onnx.load(path)
    told = {each.key: each.value for each in model.metadata_props}
    assert inspect_network(path.read_bytes(), path.name) == NetworkCard.from_json(told["viewshed.card"])


def test_what_version_0_3_folded_or_showed_more_is_refused_in_one_line() -> None:
    model = onnx_model(card(), drawn())
    told = json.loads(model.metadata_props[0].value)
    told |= {"inputs": ["shadow_map", "range"], "shape": {**told["shape"], "channels": 2, "fold": 4}}
    model.metadata_props[0].value = json.dumps(told)
    model.graph.node.insert(0, helper.make_node("SpaceToDepth", ["inputs"], ["folded"], blocksize=4))
    line = r"^a.onnx: network must take only counts as input, .*\['shadow_map', 'range'\] and fold 4; use shadow_map$"
    with pytest.raises(ValueError, match=line):
        inspect_network(sealed(model), "a.onnx")


def _node(kind: str, inputs: list[str], output: str, **settings: Any) -> Callable[[onnx.ModelProto], None]:
    def change(model: onnx.ModelProto) -> None:
        model.graph.node.insert(0, helper.make_node(kind, inputs, [output], **settings))

    return change


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


def _doubled_shape(model: onnx.ModelProto) -> None:
    """What the engine would compute while it loads the file: a shape, twice as long at each step."""
    model.graph.node.insert(0, helper.make_node("Shape", ["inputs"], ["shape"], start=1))
    model.graph.node.insert(1, helper.make_node("Concat", ["shape", "shape"], ["twice"], axis=0))


def _functions(model: onnx.ModelProto) -> None:
    model.functions.append(
        helper.make_function("viewshed", "F", ["x"], ["y"], [helper.make_node("Relu", ["x"], ["y"])], [])
    )


@pytest.mark.parametrize(("change", "message"), [
    (_node("Loop", ["", "masks"], "looped"), "the operator Loop"),
    (_node("ConstantOfShape", ["inputs"], "filled"), "the operator ConstantOfShape"),
    (_node("Relu", ["inputs"], "other", domain="com.example"), "the operator com.example.Relu"),
    (_functions, "functions or training of its own"),
    (_graph_in_a_known_operator, "a setting that is a tensor, a graph or a fraction"),
    (_other_output, "they must be inputs, masks and ..probability.."),
    (_external, "the constant 'c0' with data outside of the file"),
    (_sixteen_gigabytes, r"the constant 'huge' of shape \[65536, 65536\], 17179869184 bytes, with 4 in the file"),
    (_node("Concat", ["c0", "c0"], "twice", axis=0), "the operator Concat on constants alone"),
    (_doubled_shape, "the operator Concat on constants alone"),
    (_node("Relu", ["nowhere"], "other"), "the operator Relu on constants alone, or before what it needs"),
    (_node("Loo\np\x1b[31m", ["inputs"], "other"), r"the operator Loo\?p\?\[31m"),
])  # fmt: skip
def test_what_we_never_export_is_refused(change: Callable[[onnx.ModelProto], None], message: str) -> None:
    model = onnx_model(card(), drawn())
    change(model)
    with pytest.raises(ValueError, match=f"^a.onnx must hold only what viewshed exports, got .*{message}") as caught:
        OnnxRunner.of_content(sealed(model), "a.onnx", 1)
    assert "\n" not in str(caught.value)


_RUN = """
import resource, sys
from pathlib import Path
import numpy as np
from viewshed.networks import runtime
runtime.MAX_MEMORY_BYTES = 1 << 27
network = runtime.OnnxRunner.of_content(sys.stdin.buffer.read(), "a.onnx", 1)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    network.run(np.zeros((1, *network.card.input_shape), np.float32), network.card.shape.no_masks(1))
except ValueError as error:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before, error)
"""


def test_a_network_that_asks_for_more_memory_than_all_may_take_is_one_line() -> None:
    """Its maps are doubled thirty times: four terabytes. The limit of this run is 128 MiB."""
    model = onnx_model(card(), drawn())
    for number in range(30):
        last = f"twice{number - 1}" if number else "inputs"
        model.graph.node.append(helper.make_node("Concat", [last, last], [f"twice{number}"], axis=1))
    found = subprocess.run([sys.executable, "-c", _RUN], input=sealed(model), capture_output=True, check=True)
    more, message = found.stdout.decode().split(maxsplit=1)
    assert int(more) < 1 << 18  # KiB
    assert re.match(r"^a.onnx cannot be run \(.*\); export it again.*$", message)


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
