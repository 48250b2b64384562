"""Removal of the dropout masks from the graph of a network's file. Imports neither onnx nor numpy.

A file contains one graph, with masks as an input. Without dropout all masks are 1 and x · 1 = x, so the products with
masks, and the nodes that compute their factors, are removed at load time. The weights stay unchanged.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from viewshed.networks.protobuf import as_message, as_text, encode, fields

# Field numbers of onnx.ModelProto, onnx.GraphProto, onnx.NodeProto and onnx.ValueInfoProto.
_GRAPH = 7
_NODE, _INPUT, _OUTPUT = 1, 11, 12
_NODE_INPUT, _NODE_OUTPUT, _NODE_KIND = 1, 2, 4
_VALUE_NAME = 1

_MASK_OPERATORS = ("Split", "Concat", "Unsqueeze", "QuantizeLinear", "DequantizeLinear")
"""Operators between the input ``masks`` and the products with masks."""


@dataclass(frozen=True, slots=True)
class _Node:
    """A node of the graph: operator, inputs, outputs, and its unparsed message."""

    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    message: memoryview


def without_masks(content: bytes) -> bytes:
    """Return a model from ``inputs`` to ``probability``, equivalent to ``content`` with masks of ones.

    Args:
        content: bytes of a network's file, checked by :func:`viewshed.networks.inspection.inspect_network`.
    """
    model = fields(memoryview(content))
    return b"".join(encode(key, _graph(as_message(value)) if key == _GRAPH else value) for key, value in model)


def _graph(message: memoryview) -> bytes:
    graph_fields = list(fields(message))
    nodes = [_read_node(as_message(value)) for key, value in graph_fields if key == _NODE]
    encoded = [encode(_NODE, _encode_node(node)) for node in _ancestors_of_probability(_without_products(nodes))]
    for key, value in graph_fields:
        if key in (_INPUT, _OUTPUT):
            names = [as_text(text) for name, text in fields(as_message(value)) if name == _VALUE_NAME]
            if names not in (["inputs"], ["probability"]):
                continue
        if key != _NODE:
            encoded.append(encode(key, value))
    return b"".join(encoded)


def _read_node(message: memoryview) -> _Node:
    texts = [(key, as_text(value)) for key, value in fields(message) if key in (_NODE_INPUT, _NODE_OUTPUT, _NODE_KIND)]
    kind, inputs, outputs = (
        tuple(text for key, text in texts if key == number) for number in (_NODE_KIND, _NODE_INPUT, _NODE_OUTPUT)
    )
    return _Node(kind[-1], inputs, outputs, message)


def _encode_node(node: _Node) -> bytes:
    """Return the message of a node with its inputs, which may be renamed, replaced."""
    inputs = [encode(_NODE_INPUT, name.encode()) for name in node.inputs]
    return b"".join(inputs + [encode(key, value) for key, value in fields(node.message) if key != _NODE_INPUT])


def _without_products(nodes: Iterable[_Node]) -> list[_Node]:
    """Return the nodes without products with masks; consumers of a product take its other factor instead."""
    masks, renamed, kept = {"masks"}, dict[str, str](), list[_Node]()
    for node in nodes:
        inputs = tuple(renamed.get(name, name) for name in node.inputs)
        factors = [name for name in inputs if name not in masks]
        if node.kind == "Mul" and len(factors) == len(inputs) - 1 == 1:
            renamed[node.outputs[0]] = factors[0]
        elif node.kind in _MASK_OPERATORS and inputs[0] in masks:
            masks.update(node.outputs)
        else:
            kept.append(replace(node, inputs=inputs))
    return kept


def _ancestors_of_probability(nodes: Sequence[_Node]) -> list[_Node]:
    """Return the nodes that the output ``probability`` depends on; this drops the second head of older files."""
    needed, kept = {"probability"}, list[_Node]()
    for node in reversed(nodes):
        if not needed.isdisjoint(node.outputs):
            needed.update(node.inputs)
            kept.append(node)
    return kept[::-1]
