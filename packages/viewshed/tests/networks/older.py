"""Network files of older versions: they have a second head, whose output is no longer used."""

import json
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def older_card(text: str) -> str:
    """Return the JSON of a card with the keys of older versions, in it and in its shape."""
    content = json.loads(text)
    shape = {**content["shape"], "channels": 1, "fold": 1, "doubt": True}
    return json.dumps({**content, "shape": shape, "inputs": ["counts"]})


def with_second_head(model: onnx.ModelProto) -> onnx.ModelProto:
    """Return a model with an output ``deviation`` per input, computed from the last stage, and an older card."""
    older, rng = onnx.ModelProto(), np.random.default_rng(7)
    older.CopyFrom(model)
    nodes = {name: node for node in older.graph.node for name in node.output}
    first_head = nodes[nodes[nodes["probability"].input[0]].input[0]]
    bias = next(tensor for tensor in older.graph.initializer if tensor.name == first_head.input[2])
    width = next(tensor for tensor in older.graph.initializer if tensor.name == first_head.input[1]).dims[1]
    values = {
        "begin": np.array([0]), "channels": np.array([1]), "most": np.array(0.5, np.float32),
        "weight1": rng.normal(0, 0.1, (width, width, 3, 3)).astype(np.float32), "bias1": np.zeros(width, np.float32),
        "weight2": rng.normal(0, 0.1, (*bias.dims, width, 1, 1)).astype(np.float32),
        "bias2": np.zeros(bias.dims, np.float32),
    }  # fmt: skip
    older.graph.initializer.extend(numpy_helper.from_array(value, f"old_{name}") for name, value in values.items())

    def add(kind: str, inputs: list[str], output: str, **settings: Any) -> str:
        older.graph.node.append(helper.make_node(kind, inputs, [output], output, **settings))
        return output

    frames = add("Shape", ["inputs"], "old_frames", start=0, end=1)
    x = add("Slice", [first_head.input[0], "old_begin", frames, "old_begin"], "old_once")
    x = add("Conv", [x, "old_weight1", "old_bias1"], "old_first", kernel_shape=[3, 3], pads=[1, 1, 1, 1])
    x = add("Relu", [x], "old_relu")
    x = add("Conv", [x, "old_weight2", "old_bias2"], "old_last", kernel_shape=[1, 1])
    x = add("Mul", [add("Sigmoid", [x], "old_share"), "old_most"], "old_std")
    add("Squeeze", [x, "old_channels"], "deviation")
    cells = [each.dim_value for each in older.graph.output[0].type.tensor_type.shape.dim][1:]
    older.graph.output.append(helper.make_tensor_value_info("deviation", TensorProto.FLOAT, ["frames", *cells]))
    older.metadata_props[0].value = older_card(older.metadata_props[0].value)
    onnx.checker.check_model(older, full_check=True)
    return older
