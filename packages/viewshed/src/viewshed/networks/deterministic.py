"""The graph that runs with dropout off: that of a network's file without its masks. Needs neither onnx nor numpy.

A file holds one graph, whose masks are an input. With dropout off every mask is one, and x · 1 = x: these products are
left out when the file is loaded, and with them all that prepares their masks. The weights are the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from viewshed.networks.protobuf import as_message, as_text, encode, fields

# Numbers of fields: of onnx.ModelProto, onnx.GraphProto, onnx.NodeProto and onnx.ValueInfoProto.
_GRAPH = 7
_NODE, _INPUT, _OUTPUT = 1, 11, 12
_NODE_INPUT, _NODE_OUTPUT, _NODE_KIND = 1, 2, 4
_VALUE_NAME = 1

_PREPARES_MASKS = ("Split", "Concat", "Unsqueeze", "QuantizeLinear", "DequantizeLinear")
"""Operators between the masks and the products with them."""


@dataclass(frozen=True, slots=True)
class _Node:
    """A node of the graph: what is looked at, and all of it as in the file."""

    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    message: memoryview


def without_masks(content: bytes) -> bytes:
    """Return the model from ``inputs`` to ``probability`` that computes what ``content`` does with masks of ones.

    Args:
        content: of a network's file that :func:`viewshed.networks.inspection.inspect_network` has passed.
    """
    model = fields(memoryview(content))
    return b"".join(encode(key, _graph(as_message(value)) if key == _GRAPH else value) for key, value in model)


def _graph(message: memoryview) -> bytes:
    parts = list(fields(message))
    nodes = [_read_node(as_message(value)) for key, value in parts if key == _NODE]
    written = [encode(_NODE, _written(node)) for node in _needed(_without_products(nodes))]
    for key, value in parts:
        if key in (_INPUT, _OUTPUT):
            names = [as_text(each) for name, each in fields(as_message(value)) if name == _VALUE_NAME]
            if names not in (["inputs"], ["probability"]):
                continue
        if key != _NODE:
            written.append(encode(key, value))
    return b"".join(written)


def _read_node(message: memoryview) -> _Node:
    texts = [(key, as_text(value)) for key, value in fields(message) if key in (_NODE_INPUT, _NODE_OUTPUT, _NODE_KIND)]
    kind, inputs, outputs = (
        tuple(text for key, text in texts if key == wanted) for wanted in (_NODE_KIND, _NODE_INPUT, _NODE_OUTPUT)
    )
    return _Node(kind[-1], inputs, outputs, message)


def _written(node: _Node) -> bytes:
    """Return the message of a node whose inputs may be called otherwise than in the file."""
    inputs = [encode(_NODE_INPUT, name.encode()) for name in node.inputs]
    return b"".join(inputs + [encode(key, value) for key, value in fields(node.message) if key != _NODE_INPUT])


def _without_products(nodes: Iterable[_Node]) -> list[_Node]:
    """Return the nodes less the products with masks; who read a product reads its other factor."""
    masks, same, found = {"masks"}, dict[str, str](), list[_Node]()
    for node in nodes:
        inputs = tuple(same.get(name, name) for name in node.inputs)
        factors = [name for name in inputs if name not in masks]
        if node.kind == "Mul" and len(factors) == len(inputs) - 1 == 1:
            same[node.outputs[0]] = factors[0]
        elif node.kind in _PREPARES_MASKS and inputs[0] in masks:
            masks.update(node.outputs)
        else:
            found.append(replace(node, inputs=inputs))
    return found


def _needed(nodes: Sequence[_Node]) -> list[_Node]:
    """Return the nodes that the probability is computed by: older files have a second head, which is left out."""
    needed, found = {"probability"}, list[_Node]()
    for node in reversed(nodes):
        if not needed.isdisjoint(node.outputs):
            needed.update(node.inputs)
            found.append(node)
    return found[::-1]
