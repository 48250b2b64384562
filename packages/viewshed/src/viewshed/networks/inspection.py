"""What a network's file may hold, checked before any engine sees it. Needs numpy alone.

A checksum inside a file is no signature: anybody can compute it. So a file is read here as data first: only the
operators that our exports write, no control flow, nothing outside of the file, constants that are in the file with all
their bytes, and nothing large that the engine would compute while it loads. The engine bounds the memory of a run
(:mod:`viewshed.networks.runtime`). Nothing bounds its time, and what a network *says* can be wrong.
"""

from __future__ import annotations

import math

from viewshed.networks.card import NetworkCard
from viewshed.networks.protobuf import as_ints, as_message, as_text, fields
from viewshed.networks.weights import CARD_KEY

MOST_NODES = 1024
"""Nodes of a graph; the deepest network that a card may have needs fewer than 500."""

_OPERATORS = frozenset({
    "Add", "Concat", "Conv", "ConvTranspose", "DequantizeLinear", "MatMul", "MaxPool", "Mul", "QuantizeLinear", "Relu",
    "Reshape", "Shape", "Sigmoid", "Slice", "Split", "Squeeze", "Transpose", "Unsqueeze",
})  # fmt: skip
"""The operators of our exports: no loop, no branch, nothing that fills a shape it is given."""

_OUTPUTS = (["probability"], ["probability", "deviation"])
"""Outputs of a graph; the second one of older files, which they compute with Shape and Slice, is never computed."""

_BYTES_OF_TYPE = {1: 4, 2: 1, 3: 1, 6: 4, 7: 8}
"""Bytes of a number by its type in onnx.TensorProto: float32, uint8, int8, int32, int64; our exports use no other."""


def inspect_network(content: bytes, name: str) -> NetworkCard:
    """Return the card of a network's file whose graph an engine may load.

    Args:
        content: of the file.
        name: stands for it in messages.

    Raises:
        ValueError: it is no ONNX file, has no valid card, or holds what our exports do not.
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
    """Return the message of an error in one line: names in a file may hold line breaks and control characters."""
    text = "".join(character if character.isprintable() else "?" for character in str(error))
    return text if len(text) <= 300 else f"{text[:299]}…"


class _CardError(ValueError):
    """A card that is none, or that of a network that this version does not run."""


class _RefusedError(ValueError):
    """A file that is sound ONNX and not of ours."""


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
    """Refuse an onnx.GraphProto that holds more than operators, constants, inputs and outputs of ours."""
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
    if len(nodes) > MOST_NODES:
        raise _RefusedError(f"more than {MOST_NODES} nodes")
    if names[11] != ["inputs", "masks"] or names[12] not in _OUTPUTS:
        raise _RefusedError(f"inputs {names[11]} and outputs {names[12]}; they must be inputs, masks and {_OUTPUTS[0]}")
    known = set(names[11])
    for node in nodes:
        _check_node(node, constants, known)


def _check_node(message: memoryview, constants: set[str], known: set[str]) -> None:
    """Refuse an onnx.NodeProto that is not ours.

    Its outputs are added to ``constants`` where an engine computes them while it loads the file, else to ``known``,
    what follows from the inputs of the graph.
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
            if not {key for key, _ in fields(as_message(value))} <= {1, 3, 4, 8, 20}:  # integers, a text, their type
                raise _RefusedError("a setting that is a tensor, a graph or a fraction")
        elif number == 7:
            domain = as_text(value)
    if domain or kind not in _OPERATORS:
        raise _RefusedError(f"the operator {f'{domain}.{kind}' if domain else kind}")
    # An engine computes what follows from constants and shapes alone when it loads a file, before the limit of a run
    # holds: ours unpack weights there, and nothing more.
    if kind == "Shape" or (kind == "DequantizeLinear" and constants.issuperset(inputs)):
        constants.update(outputs)
    elif known.isdisjoint(inputs):
        raise _RefusedError(f"the operator {kind} on constants alone, or before what it needs")
    else:
        known.update(outputs)


def _check_constant(message: memoryview) -> str:
    """Return the name of an onnx.TensorProto, which must hold all its bytes itself."""
    shape, kind, name, held = tuple[int, ...](), 0, "", 0
    for number, value in fields(message):
        if number == 1:
            shape = (*shape, *as_ints(value))
        elif number == 2 and isinstance(value, int):
            kind = value
        elif number == 8:
            name = as_text(value)
        elif number == 9:
            held = len(as_message(value))
        elif number != 12:  # a comment
            raise _RefusedError(f"the constant {name!r} with data outside of the file, or not as raw bytes")
    if kind not in _BYTES_OF_TYPE:
        raise _RefusedError(f"the constant {name!r} of type {kind}")
    # The shape is only believed if the file holds every one of its numbers: 100 bytes cannot claim 16 GB.
    wanted = math.prod(shape) * _BYTES_OF_TYPE[kind]
    if min(shape, default=1) < 0 or wanted != held:
        raise _RefusedError(f"the constant {name!r} of shape {list(shape)}, {wanted} bytes, with {held} in the file")
    return name
