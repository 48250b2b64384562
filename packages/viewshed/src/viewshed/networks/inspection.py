"""What a network's file may hold, checked before any engine sees it. Needs numpy alone.

A checksum inside a file is no signature: anybody can compute it. So a file is read here as data first: only the
operators that our exports write, no control flow, nothing outside of the file, constants that are in the file with all
their bytes, and no tensor larger than the card's own network has. Whatever passes takes the memory and the time of a
network of ours, whoever wrote it; what it *says* can still be wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.networks.card import NetworkCard
from viewshed.networks.protobuf import as_ints, as_message, as_text, fields, signed
from viewshed.networks.weights import CARD_KEY

MOST_NODES = 1024
"""Nodes of a graph; the deepest network that a card may have needs fewer than 500."""

MOST_NUMBERS = 1 << 28
"""Numbers of the largest tensor in one pass: a GiB in float32."""

_OUTPUTS = (["probability"], ["probability", "deviation"])
"""Outputs of a graph; the second one of older files, which they compute with Shape and Slice, is never computed."""

Shape = tuple[int, ...]

_DTYPES: dict[int, type[np.generic]] = {1: np.float32, 2: np.uint8, 3: np.int8, 6: np.int32, 7: np.int64}
"""Types of constants by their number in onnx.TensorProto: those that our exports write."""


@dataclass(frozen=True, slots=True)
class _Node:
    """A node of the graph (onnx.NodeProto)."""

    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    settings: Mapping[str, int | tuple[int, ...] | str]

    def number(self, name: str, default: int) -> int:
        value = self.settings.get(name, default)
        return value if isinstance(value, int) else default

    def numbers(self, name: str, default: tuple[int, ...]) -> tuple[int, ...]:
        value = self.settings.get(name, default)
        return value if isinstance(value, tuple) else default


@dataclass(slots=True)
class _Graph:
    """A graph as data (onnx.GraphProto)."""

    nodes: list[_Node] = field(default_factory=list)
    constants: dict[str, NDArray[np.generic]] = field(default_factory=dict)
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)


def inspect_network(content: bytes, name: str) -> NetworkCard:
    """Return the card of a network's file whose graph an engine may run.

    Args:
        content: of the file.
        name: stands for it in messages.

    Raises:
        ValueError: it is no ONNX file, has no valid card, or needs more than a network of ours does.
    """
    try:
        graph, metadata = _read_model(content)
    except (ValueError, IndexError, OverflowError) as error:
        if isinstance(error, _RefusedError):
            raise ValueError(f"{name} must hold only what viewshed exports, got {_printable(error)}") from error
        raise ValueError(f"{name} must be a network in ONNX, got another file ({_printable(error)})") from error
    try:
        card = NetworkCard.from_json(metadata.get(CARD_KEY, ""))
    except ValueError as error:
        raise ValueError(f"{name}: {_printable(error)}") from error
    try:
        _check_graph(graph, card)
    except (ValueError, IndexError, KeyError) as error:
        text = _printable(error)
        problem = text if isinstance(error, _RefusedError) else f"a graph that cannot run ({text})"
        raise ValueError(f"{name} must hold only what viewshed exports, got {problem}") from error
    return card


def _printable(error: Exception) -> str:
    """Return the message of an error in one line: names in a file may hold line breaks and control characters."""
    text = "".join(character if character.isprintable() else "?" for character in str(error))
    return text if len(text) <= 300 else f"{text[:299]}…"


class _RefusedError(ValueError):
    """A file that is sound ONNX and not of ours."""


def _read_model(content: bytes) -> tuple[_Graph, dict[str, str]]:
    """Return graph and metadata of an onnx.ModelProto."""
    graphs: list[_Graph] = []
    metadata: dict[str, str] = {}
    for number, value in fields(memoryview(content)):
        if number == 7:
            graphs.append(_read_graph(as_message(value)))
        elif number == 14:
            entry = dict(fields(as_message(value)))
            metadata[as_text(entry.get(1, memoryview(b"")))] = as_text(entry.get(2, memoryview(b"")))
        elif number in (20, 25):  # training_info, functions
            raise _RefusedError("functions or training of its own")
    if len(graphs) != 1:
        raise ValueError(f"{len(graphs)} graphs")
    return graphs[0], metadata


def _read_graph(message: memoryview) -> _Graph:
    graph = _Graph()
    for number, value in fields(message):
        if number == 1:
            graph.nodes.append(_read_node(as_message(value)))
            if len(graph.nodes) > MOST_NODES:
                raise _RefusedError(f"more than {MOST_NODES} nodes")
        elif number == 5:
            name, constant = _read_constant(as_message(value))
            if name in graph.constants:
                raise _RefusedError(f"the constant {name!r} twice")
            graph.constants[name] = constant
        elif number in (11, 12):
            names = graph.inputs if number == 11 else graph.outputs
            names.append(next((as_text(item) for key, item in fields(as_message(value)) if key == 1), ""))
        elif number == 15:
            raise _RefusedError("sparse constants")
    return graph


def _read_node(message: memoryview) -> _Node:
    inputs: list[str] = []
    outputs: list[str] = []
    messages: list[memoryview] = []
    kind, domain = "", ""
    for number, value in fields(message):
        if number == 1:
            inputs.append(as_text(value))
        elif number == 2:
            outputs.append(as_text(value))
        elif number == 4:
            kind = as_text(value)
        elif number == 5:
            messages.append(as_message(value))
        elif number == 7:
            domain = as_text(value)
    if domain or kind not in _SHAPES:
        raise _RefusedError(f"the operator {f'{domain}.{kind}' if domain else kind}")
    settings: dict[str, int | tuple[int, ...] | str] = {}
    for key, setting in map(_read_setting, messages):
        if key in settings:
            raise _RefusedError(f"a setting {key!r} twice")
        settings[key] = setting
    return _Node(kind, tuple(inputs), tuple(outputs), settings)


def _read_setting(message: memoryview) -> tuple[str, int | tuple[int, ...] | str]:
    """Return name and value of an onnx.AttributeProto: an integer, integers or a text; nothing else is ours."""
    name, many = "", tuple[int, ...]()
    one: list[int | str] = []
    for number, value in fields(message):
        if number == 1:
            name = as_text(value)
        elif number == 3 and isinstance(value, int):
            one.append(signed(value))
        elif number == 4:
            one.append(as_text(value))
        elif number == 8:
            many = (*many, *as_ints(value))
        elif number != 20:  # the type, which says it again
            raise _RefusedError(f"a setting {name!r} that is a tensor, a graph or a fraction")
    if len(one) + bool(many) != 1:  # an engine would choose by the type
        raise _RefusedError(f"a setting {name!r} with several values")
    return name, one[0] if one else many


def _read_constant(message: memoryview) -> tuple[str, NDArray[np.generic]]:
    """Return name and values of an onnx.TensorProto, which must hold all its bytes itself."""
    shape: Shape = ()
    kind, name, raw = 0, "", memoryview(b"")
    for number, value in fields(message):
        if number == 1:
            shape = (*shape, *as_ints(value))
        elif number == 2 and isinstance(value, int):
            kind = value
        elif number == 8:
            name = as_text(value)
        elif number == 9:
            raw = as_message(value)
        elif number != 12:  # a comment
            raise _RefusedError(f"the constant {name!r} with data outside of the file, or not as raw bytes")
    dtype = _DTYPES.get(kind)
    if dtype is None:
        raise _RefusedError(f"the constant {name!r} of type {kind}")
    # The shape is only believed if the file holds every one of its numbers: 100 bytes cannot claim 16 GB.
    wanted = math.prod(shape) * np.dtype(dtype).itemsize
    if min(shape, default=1) < 0 or wanted != len(raw):
        raise _RefusedError(
            f"the constant {name!r} of shape {list(shape)}, {wanted} bytes, with {len(raw)} in the file"
        )
    return name, np.frombuffer(raw, dtype).reshape(shape)


def _check_graph(graph: _Graph, card: NetworkCard) -> None:
    """Compute the shape of every tensor of the graph, for one pass and for many, and compare it with the card's."""
    if not graph.constants.keys().isdisjoint(graph.inputs):
        raise _RefusedError("constants that are called as the inputs")
    if graph.inputs != ["inputs", "masks"] or graph.outputs not in _OUTPUTS:
        raise _RefusedError(
            f"inputs {graph.inputs} and outputs {graph.outputs}; they must be inputs, masks and {_OUTPUTS[0]}"
        )
    most = _most_numbers(card)
    # Sums of products are two operations each, and on blocks of cells (networks in bytes) four times as many.
    work = 2 * card.shape.flops(card.grid.cells)
    if most > MOST_NUMBERS:
        raise _RefusedError(f"a card whose network has {most:,} numbers in one layer; the most is {MOST_NUMBERS:,}")
    # Two sizes of batch: a tensor that grows with the square of the batch is small for one of them alone.
    for frames, passes in ((1, 1), (1, 32), (32, 32)):
        shapes = _Shapes(graph.constants, {
            "inputs": (frames, *card.input_shape), "masks": (passes, sum(card.shape.masked_channels)),
        })  # fmt: skip
        for node in graph.nodes:
            for output, shape in zip(node.outputs, _SHAPES[node.kind](node, shapes), strict=True):
                if output in shapes.known or output in graph.constants:
                    raise _RefusedError(f"two tensors called {output!r}")
                if min(shape, default=1) < 0 or math.prod(shape) > passes * most:
                    raise _RefusedError(f"a tensor of shape {list(shape)}, more than {passes * most:,} numbers")
                shapes.known[output] = shape
        if shapes.products > passes * work:
            raise _RefusedError(f"{shapes.products:,} products, more than {passes * work:,}")
        for name, count in zip(graph.outputs, (passes, frames), strict=False):
            if shapes.known.get(name) != (count, *card.grid.shape):
                raise _RefusedError(f"{name} of shape {shapes.known.get(name)}; it must be {(count, *card.grid.shape)}")


def _most_numbers(card: NetworkCard) -> int:
    """Return the numbers of the largest tensor in one pass of the card's network: input, weights or a stage's maps."""
    shape, side = card.shape, card.grid.cells // card.shape.fold
    maps = [2 * width * (side >> level) ** 2 for level, width in enumerate(shape.widths)]
    return max(*maps, shape.channels * card.grid.cells**2, shape.parameters, 2 * card.grid.cells**2)


@dataclass(slots=True)
class _Shapes:
    """The shapes of all tensors so far, the constants, and how many products the convolutions sum up."""

    constants: Mapping[str, NDArray[np.generic]]
    known: dict[str, Shape]
    values: dict[str, tuple[int, ...]] = field(default_factory=dict)
    products: int = 0

    def of(self, name: str) -> Shape:
        """Return the shape of a tensor that is there already."""
        return self.known[name] if name in self.known else self.constants[name].shape

    def ints(self, name: str) -> tuple[int, ...]:
        """Return the values of a small tensor of integers: a constant, or a batch size that the graph reads off."""
        if name in self.values:
            return self.values[name]
        constant = self.constants[name]
        if constant.dtype != np.int64 or constant.size > 16:
            raise _RefusedError(f"{name!r}, which is no short list of sizes")
        return tuple(int(value) for value in constant.reshape(-1))


def _same(node: _Node, shapes: _Shapes) -> list[Shape]:
    return [shapes.of(node.inputs[0])]


def _broadcast(node: _Node, shapes: _Shapes) -> list[Shape]:
    return [np.broadcast_shapes(*(shapes.of(name) for name in node.inputs))]


def _conv(node: _Node, shapes: _Shapes) -> list[Shape]:
    batch, inner, *size = shapes.of(node.inputs[0])
    outer, fitting, *kernel = shapes.of(node.inputs[1])
    pads, strides = node.numbers("pads", (0,) * 4), node.numbers("strides", (1, 1))
    plain = set(node.settings) <= {"kernel_shape", "pads", "strides"}
    if not plain or fitting != inner or kernel not in ([1, 1], [3, 3]) or pads not in ((0,) * 4, (1,) * 4):
        raise _RefusedError(f"a convolution of {inner} channels by {fitting}, kernel {kernel}, pads {list(pads)}")
    if strides != (1, 1):
        raise _RefusedError(f"a convolution with strides {list(strides)}")
    after = [cells + 2 * pads[0] - k + 1 for cells, k in zip(size, kernel, strict=True)]
    shapes.products += batch * outer * inner * math.prod(after) * math.prod(kernel)
    return [(batch, outer, *after)]


def _conv_transpose(node: _Node, shapes: _Shapes) -> list[Shape]:
    batch, inner, *size = shapes.of(node.inputs[0])
    fitting, outer, *kernel = shapes.of(node.inputs[1])
    plain = set(node.settings) == {"kernel_shape", "strides"}
    if not plain or fitting != inner or kernel != [2, 2] or node.numbers("strides", ()) != (2, 2):
        raise _RefusedError(f"a transposed convolution other than 2x2 with stride 2, kernel {kernel}")
    shapes.products += batch * outer * inner * math.prod(size) * math.prod(kernel)
    return [(batch, outer, *(2 * cells for cells in size))]


def _max_pool(node: _Node, shapes: _Shapes) -> list[Shape]:
    plain = set(node.settings) == {"kernel_shape", "strides"}
    if not plain or node.numbers("kernel_shape", ()) != (2, 2) or node.numbers("strides", ()) != (2, 2):
        raise _RefusedError("pooling other than 2x2")
    batch, channels, *size = shapes.of(node.inputs[0])
    return [(batch, channels, *(cells // 2 for cells in size))]


def _concat(node: _Node, shapes: _Shapes) -> list[Shape]:
    first, *rest = (shapes.of(name) for name in node.inputs)
    if any(shape[:1] + shape[2:] != first[:1] + first[2:] for shape in rest) or node.number("axis", -1) != 1:
        raise _RefusedError("a concatenation of other than channels")
    return [(first[0], first[1] + sum(shape[1] for shape in rest), *first[2:])]


def _split(node: _Node, shapes: _Shapes) -> list[Shape]:
    first, channels = shapes.of(node.inputs[0]), shapes.ints(node.inputs[1])
    if min(channels) < 1 or sum(channels) != first[1] or node.number("axis", 0) != 1:
        raise _RefusedError(f"a split of {first[1]} channels into {list(channels)}")
    return [(first[0], count, *first[2:]) for count in channels]


def _unsqueeze(node: _Node, shapes: _Shapes) -> list[Shape]:
    shape, axes = list(shapes.of(node.inputs[0])), sorted(shapes.ints(node.inputs[1]))
    if min(axes) < 0 or len(set(axes)) != len(axes) or max(axes) >= len(shape) + len(axes):
        raise _RefusedError(f"new axes {axes} of {shape}")
    for axis in axes:
        shape.insert(axis, 1)
    return [tuple(shape)]


def _squeeze(node: _Node, shapes: _Shapes) -> list[Shape]:
    shape, axes = shapes.of(node.inputs[0]), shapes.ints(node.inputs[1])
    if min(axes) < 0 or any(shape[axis] != 1 for axis in axes):
        raise _RefusedError(f"axes {list(axes)} of {list(shape)} that are not 1")
    return [tuple(size for axis, size in enumerate(shape) if axis not in axes)]


def _space_to_depth(node: _Node, shapes: _Shapes) -> list[Shape]:
    batch, channels, *size = shapes.of(node.inputs[0])
    block = node.number("blocksize", 0)
    if block < 1 or any(cells % block for cells in size):
        raise _RefusedError(f"blocks of {block} cells")
    return [(batch, channels * block**2, *(cells // block for cells in size))]


def _depth_to_space(node: _Node, shapes: _Shapes) -> list[Shape]:
    batch, channels, *size = shapes.of(node.inputs[0])
    block = node.number("blocksize", 0)
    if block < 1 or channels % block**2:
        raise _RefusedError(f"blocks of {block} cells")
    return [(batch, channels // block**2, *(cells * block for cells in size))]


def _shape(node: _Node, shapes: _Shapes) -> list[Shape]:
    first = shapes.of(node.inputs[0])
    found = first[node.number("start", 0) : node.number("end", len(first))]
    shapes.values[node.outputs[0]] = found
    return [(len(found),)]


def _slice(node: _Node, shapes: _Shapes) -> list[Shape]:
    first = shapes.of(node.inputs[0])
    (start,), (end,), (axis,) = (shapes.ints(name) for name in node.inputs[1:])
    if len(node.inputs) != 4 or not 0 <= start <= end or not 0 <= axis < len(first):
        raise _RefusedError(f"a slice from {start} to {end} of axis {axis}")
    return [(*first[:axis], max(min(end, first[axis]) - start, 0), *first[axis + 1 :])]


def _transpose(node: _Node, shapes: _Shapes) -> list[Shape]:
    first, order = shapes.of(node.inputs[0]), node.numbers("perm", ())
    if sorted(order) != list(range(len(first))):
        raise _RefusedError(f"axes of {list(first)} in the order {list(order)}")
    return [tuple(first[axis] for axis in order)]


def _reshape(node: _Node, shapes: _Shapes) -> list[Shape]:
    first, wanted = shapes.of(node.inputs[0]), list(shapes.ints(node.inputs[1]))
    if wanted.count(-1) == 1 and min(wanted) == -1 and 0 not in wanted:
        wanted[wanted.index(-1)] = math.prod(first) // -math.prod(wanted)
    if math.prod(wanted) != math.prod(first):
        raise _RefusedError(f"{list(first)} in the shape {wanted}")
    return [tuple(wanted)]


def _matmul(node: _Node, shapes: _Shapes) -> list[Shape]:
    (*rows, inner), (fitting, outer) = (shapes.of(name) for name in node.inputs)
    if inner != fitting:
        raise _RefusedError(f"a product of {inner} columns and {fitting} rows")
    shapes.products += math.prod(rows) * inner * outer
    return [(*rows, outer)]


_SHAPES: dict[str, Callable[[_Node, _Shapes], list[Shape]]] = {
    "Add": _broadcast, "Concat": _concat, "Conv": _conv, "ConvTranspose": _conv_transpose,
    "DepthToSpace": _depth_to_space, "DequantizeLinear": _same, "MatMul": _matmul, "MaxPool": _max_pool,
    "Mul": _broadcast, "QuantizeLinear": _same, "Relu": _same, "Reshape": _reshape, "Shape": _shape,
    "Sigmoid": _same, "Slice": _slice, "SpaceToDepth": _space_to_depth, "Split": _split, "Squeeze": _squeeze,
    "Transpose": _transpose, "Unsqueeze": _unsqueeze,
}  # fmt: skip
"""The operators of our exports, and from a node to the shapes that it gives. No loop, no branch."""
