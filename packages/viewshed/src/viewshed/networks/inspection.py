"""Validation of a network's file before an inference engine loads it. Imports only numpy.

The checksum inside a file is no signature: anybody can compute it. So the file is first parsed as data and must
contain only operators that our exports use, no control flow, no external data, constants whose bytes are all in the
file, and nothing large that the engine would compute while loading. The runtime limits the memory of a run
(:mod:`viewshed.networks.runtime`). Run time is not limited, and the output of a network can be wrong.
"""

from __future__ import annotations

import math

from viewshed.networks.card import NetworkCard
from viewshed.networks.protobuf import as_ints, as_message, as_text, fields
from viewshed.networks.weights import CARD_KEY

MAX_NODES = 1024
"""Maximum number of nodes of a graph; the deepest network that a card allows has fewer than 500."""

_OPERATORS = frozenset({
    "Add", "Concat", "Conv", "ConvTranspose", "DequantizeLinear", "MatMul", "MaxPool", "Mul", "QuantizeLinear", "Relu",
    "Reshape", "Shape", "Sigmoid", "Slice", "Split", "Squeeze", "Transpose", "Unsqueeze",
})  # fmt: skip
"""Operators of our exports: no loop, no branch, no operator that allocates a tensor of a given shape."""

_OUTPUTS = (["probability"], ["probability", "deviation"])
"""Allowed outputs of a graph. Older files compute ``deviation`` with Shape and Slice; it is never requested."""

_BYTES_OF_TYPE = {1: 4, 2: 1, 3: 1, 6: 4, 7: 8}
"""Data type in onnx.TensorProto → bytes per number: float32, uint8, int8, int32, int64, the types of our exports."""


def inspect_network(content: bytes, name: str) -> NetworkCard:
    """Validate a network's file and return its card.

    Args:
        content: bytes of the file.
        name: name of the file in messages.

    Raises:
        ValueError: it is no ONNX file, has no valid card, or contains anything that our exports do not.
    """
    try:
        graph, text = _read_model(content)
        card = _card_of(text)
        _check_graph(graph)
    except _CardError as error:
        raise ValueError(f"{name}: {_printable(error)}") from error
    except _RefusedError as error:
        raise ValueError(f"{name} must hold only what viewshed exports, got {_printable(error)}") from error
    except (ValueError, IndexError, OverflowError) as error:
        raise ValueError(f"{name} must be a network in ONNX, got another file ({_printable(error)})") from error
    return card


def _printable(error: Exception) -> str:
    """Return an error's message in one printable line; names in a file may contain control characters."""
    text = "".join(character if character.isprintable() else "?" for character in str(error))
    return text if len(text) <= 300 else f"{text[:299]}…"


class _CardError(ValueError):
    """The card is invalid, or of a network that this version does not run."""


class _RefusedError(ValueError):
    """The file is valid ONNX, but not one of our exports."""


def _card_of(text: str) -> NetworkCard:
    try:
        return NetworkCard.from_json(text)
    except ValueError as error:
        raise _CardError(str(error)) from error


def _read_model(content: bytes) -> tuple[memoryview, str]:
    """Return the graph and the card's text of an onnx.ModelProto."""
    graphs, metadata = list[memoryview](), dict[str, str]()
    for number, value in fields(memoryview(content)):
        if number == 7:
            graphs.append(as_message(value))
        elif number == 14:
            entry = dict(fields(as_message(value)))
            metadata[as_text(entry.get(1, memoryview(b"")))] = as_text(entry.get(2, memoryview(b"")))
        elif number in (20, 25):  # training_info, functions
            raise _RefusedError("functions or training of its own")
    if len(graphs) != 1:
        raise ValueError(f"{len(graphs)} graphs")
    return graphs[0], metadata.get(CARD_KEY, "")


def _check_graph(message: memoryview) -> None:
    """Raise _RefusedError unless an onnx.GraphProto has only the operators, constants, inputs and outputs of ours."""
    nodes, constants, names = list[memoryview](), set[str](), {11: list[str](), 12: list[str]()}
    for number, value in fields(message):
        if number == 1:
            nodes.append(as_message(value))
        elif number == 5:
            constants.add(_check_constant(as_message(value)))
        elif number in names:
            names[number].append(next((as_text(item) for key, item in fields(as_message(value)) if key == 1), ""))
        elif number == 15:
            raise _RefusedError("sparse constants")
    if len(nodes) > MAX_NODES:
        raise _RefusedError(f"more than {MAX_NODES} nodes")
    if names[11] != ["inputs", "masks"] or names[12] not in _OUTPUTS:
        raise _RefusedError(f"inputs {names[11]} and outputs {names[12]}; they must be inputs, masks and {_OUTPUTS[0]}")
    known = set(names[11])
    for node in nodes:
        _check_node(node, constants, known)


def _check_node(message: memoryview, constants: set[str], known: set[str]) -> None:
    """Raise _RefusedError unless an onnx.NodeProto is one of ours.

    Its outputs are added to ``constants`` if an engine folds them while loading, else to ``known``, the values that
    depend on the inputs of the graph.
    """
    inputs, outputs, kind, domain = list[str](), list[str](), "", ""
    for number, value in fields(message):
        if number == 1:
            inputs.append(as_text(value))
        elif number == 2:
            outputs.append(as_text(value))
        elif number == 4:
            kind = as_text(value)
        elif number == 5:
            if not {key for key, _ in fields(as_message(value))} <= {1, 3, 4, 8, 20}:  # name, i, s, ints, type
                raise _RefusedError("a setting that is a tensor, a graph or a fraction")
        elif number == 7:
            domain = as_text(value)
    if domain or kind not in _OPERATORS:
        raise _RefusedError(f"the operator {f'{domain}.{kind}' if domain else kind}")
    # An engine folds nodes that depend only on constants and shapes while loading, before the memory limit of a run
    # applies. Our exports only dequantize weights there.
    if kind == "Shape" or (kind == "DequantizeLinear" and constants.issuperset(inputs)):
        constants.update(outputs)
    elif known.isdisjoint(inputs):
        raise _RefusedError(f"the operator {kind} on constants alone, or before what it needs")
    else:
        known.update(outputs)


def _check_constant(message: memoryview) -> str:
    """Return the name of an onnx.TensorProto; raise _RefusedError unless it contains all its bytes."""
    shape, kind, name, actual = tuple[int, ...](), 0, "", 0
    for number, value in fields(message):
        if number == 1:
            shape = (*shape, *as_ints(value))
        elif number == 2 and isinstance(value, int):
            kind = value
        elif number == 8:
            name = as_text(value)
        elif number == 9:
            actual = len(as_message(value))
        elif number != 12:  # doc_string
            raise _RefusedError(f"the constant {name!r} with data outside of the file, or not as raw bytes")
    if kind not in _BYTES_OF_TYPE:
        raise _RefusedError(f"the constant {name!r} of type {kind}")
    # The size by shape must equal the bytes in the file, so that 100 bytes cannot claim 16 GB.
    expected = math.prod(shape) * _BYTES_OF_TYPE[kind]
    if min(shape, default=1) < 0 or expected != actual:
        raise _RefusedError(
            f"the constant {name!r} of shape {list(shape)}, {expected} bytes, with {actual} in the file"
        )
    return name
