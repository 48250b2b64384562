"""Post-training static quantization (Jacob et al. 2018, Krishnamoorthi 2018) of an exported network to int8.

1. Rewrite the graph channels last, without operators that int8 engines run slowly: :func:`to_channels_last`.
2. Calibrate: minimum and maximum of every activation over sweeps, with dropout off and on (min-max).
3. Quantize: activations per tensor, asymmetric uint8; weights per output channel, symmetric int8; biases int32 in units
   of input scale times weight scale. The first layer reads the uint8 counts directly; the head's last layer
   and the sigmoid stay in float32.
4. Correct the biases, layer by layer, by the mean rounding error of each channel (Nagel et al. 2019, section 4.2).
   Most cells have no returns and equal activations, so without it the errors of all layers would add up there.
5. Write the graph in QDQ format: every operator is in float32 between DequantizeLinear and QuantizeLinear. All ONNX
   engines compute the same result; an engine that knows the pattern fuses it and multiplies int8.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from viewshed.arrays import F32
from viewshed.networks.card import INT8, Bytes, NetworkCard
from viewshed.networks.inspection import inspect_network
from viewshed.networks.runtime import values_of
from viewshed.networks.weights import CARD_KEY, verify_checksum, with_checksum


@dataclass(slots=True, eq=False)
class ChannelsLastGraph:
    """Nodes and constants of a network with input ``inputs`` (N, cells, cells, 1), channels last.

    A 2 × 2 transposed convolution becomes a 1 × 1 convolution; whole rows of its channels then move to new cells.
    """

    card: NetworkCard  # of the network
    nodes: list[onnx.NodeProto] = field(default_factory=list)  # in topological order
    constants: dict[str, NDArray[Any]] = field(default_factory=dict)  # by name

    def constant(self, name: str, value: NDArray[np.generic]) -> str:
        """Add a constant and return its name."""
        self.constants[name] = np.ascontiguousarray(value)
        return name

    def add(self, kind: str, inputs: list[str], output: str, **settings: Any) -> str:
        """Add a node with the name of its output, and return that name."""
        self.nodes.append(helper.make_node(kind, inputs, [output], output, **settings))
        return output


def to_channels_last(model: onnx.ModelProto, card: NetworkCard) -> ChannelsLastGraph:
    """Rewrite a model that :func:`viewshed_lab.training.onnx_export.export_onnx` wrote; return the new graph.

    The first encoder stage and the last decoder stage run on blocks of 2 × 2 cells: with their few channels, four times
    the products in longer rows take half the time.
    """
    graph = ChannelsLastGraph(card)
    graph.constants = {tensor.name: numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
    first = graph.add("Transpose", ["inputs"], "straight", perm=[0, 3, 1, 2])
    side, in_blocks = card.grid.cells, True
    blocks = _fold(graph, first, "blocks", side // 2, 1)
    channels, masks = dict[str, int](), dict[str, str]()
    for node in _needed_nodes(model):
        x, output = blocks if node.input[0] == "inputs" else node.input[0], node.output[0]
        if node.op_type == "Split":
            channels = dict(zip(node.output, card.shape.masked_channels, strict=True))
            _copy_node(graph, node)
        elif node.op_type == "Unsqueeze":
            masks[output] = x
        elif node.op_type == "Mul":
            mask = masks[node.input[1]]
            _rewrite_product(graph, node, side, mask, channels[mask])
        elif node.op_type == "ConvTranspose":
            side *= 2
            in_blocks = side == card.grid.cells
            _rewrite_transposed_conv(graph, node, side, in_blocks)
        elif node.op_type == "Conv" and graph.constants[node.input[1]].shape[2:] == (1, 1):
            _rewrite_head(graph, node)
        elif node.op_type == "Conv":
            _rewrite_conv(graph, node, x, in_blocks)
        elif node.op_type == "Sigmoid":
            graph.add("Sigmoid", [x], "probability")
        elif node.op_type == "MaxPool":
            side //= 2
            x = _unfold(graph, x, f"{x}_unfolded", side, card.shape.width) if in_blocks else x
            in_blocks = False
            graph.add("MaxPool", [x], output, kernel_shape=[2, 2], strides=[2, 2])
        elif node.op_type != "Squeeze":
            _copy_node(graph, node)
    return graph


def _needed_nodes(model: onnx.ModelProto) -> list[onnx.NodeProto]:
    """Return the nodes that compute the probability; older files may have a second head, which is dropped."""
    needed, nodes = {"probability"}, list[onnx.NodeProto]()
    for node in reversed(model.graph.node):
        if not needed.isdisjoint(node.output):
            needed.update(node.input)
            nodes.append(node)
    return nodes[::-1]


def _copy_node(graph: ChannelsLastGraph, node: onnx.NodeProto) -> None:
    copy = onnx.NodeProto()
    copy.CopyFrom(node)
    copy.name = node.name or node.output[0]
    graph.nodes.append(copy)


def _rewrite_conv(graph: ChannelsLastGraph, node: onnx.NodeProto, x: str, in_blocks: bool) -> None:
    """Add a 3 × 3 convolution of ``x``, on cells or on blocks of 2 × 2 cells."""
    output, (weight, *biases) = node.output[0], [graph.constants[name] for name in node.input[1:]]
    if x == "blocks":  # of uint8 / 255
        weight = weight * graph.card.max_input
    if in_blocks:
        weight, biases = weight_in_blocks(weight), [np.tile(bias, 4) for bias in biases]
    constants = [graph.constant(f"{output}_weight", weight), *(graph.constant(f"{output}_bias", b) for b in biases)]
    graph.add("Conv", [x, *constants], output, kernel_shape=[3, 3], pads=[1, 1, 1, 1])


def _rewrite_product(graph: ChannelsLastGraph, node: onnx.NodeProto, side: int, mask: str, channels: int) -> None:
    """Add the product of maps (N, channels, side, side) and a mask (N, channels).

    It multiplies whole rows of cells, with the mask repeated along them: products of a few channels are ten times
    slower.
    """
    name = node.output[0]
    row = graph.add("Concat", [mask] * side, f"{name}_repeated", axis=1)
    row = graph.add("Unsqueeze", [row, graph.constant("axis_1", np.array([1]))], f"{name}_mask")
    x = graph.add("Transpose", [node.input[0]], f"{name}_last", perm=[0, 2, 3, 1])
    shape = graph.constant(f"{name}_rows", np.array([-1, side, side * channels]))
    x = graph.add("Reshape", [x, shape], f"{name}_whole")
    x = graph.add("Mul", [x, row], f"{name}_masked")
    shape = graph.constant(f"{name}_apart", np.array([-1, side, side, channels]))
    x = graph.add("Reshape", [x, shape], f"{name}_cells")
    graph.add("Transpose", [x], name, perm=[0, 3, 1, 2])


def _rewrite_transposed_conv(graph: ChannelsLastGraph, node: onnx.NodeProto, side: int, in_blocks: bool) -> None:
    """Add a 2 × 2 transposed convolution with stride 2 to (side, side); its output may stay in blocks."""
    name, (weight, bias) = node.output[0], (graph.constants[name] for name in node.input[1:])
    inner, outer = weight.shape[:2]
    spread = weight.transpose(2, 3, 1, 0).reshape(4 * outer, inner, 1, 1)
    own = graph.constant(f"{name}_weight", spread), graph.constant(f"{name}_bias", np.tile(bias, 4))
    x = graph.add("Conv", [node.input[0], *own], name if in_blocks else f"{name}_four", kernel_shape=[1, 1])
    if not in_blocks:
        _unfold(graph, x, name, side // 2, outer)


def _unfold(graph: ChannelsLastGraph, x: str, name: str, half: int, channels: int) -> str:
    """Add nodes that split blocks of 2 × 2 cells (N, 4 · channels, half, half) into cells; return the output name."""
    return _swap_rows(graph, x, name, [half, half, 2, 2 * channels], [2 * half, 2 * half, channels])


def _fold(graph: ChannelsLastGraph, x: str, name: str, half: int, channels: int) -> str:
    """Add nodes that join cells (N, channels, 2 · half, 2 · half) to blocks of 2 × 2; return the output name."""
    return _swap_rows(graph, x, name, [half, 2, half, 2 * channels], [half, half, 4 * channels])


def _swap_rows(graph: ChannelsLastGraph, x: str, name: str, before: list[int], after: list[int]) -> str:
    x = graph.add("Transpose", [x], f"{name}_last", perm=[0, 2, 3, 1])
    x = graph.add("Reshape", [x, graph.constant(f"{name}_apart", np.array([-1, *before]))], f"{name}_rows")
    x = graph.add("Transpose", [x], f"{name}_moved", perm=[0, 1, 3, 2, 4])
    x = graph.add("Reshape", [x, graph.constant(f"{name}_together", np.array([-1, *after]))], f"{name}_cells")
    return graph.add("Transpose", [x], name, perm=[0, 3, 1, 2])


def weight_in_blocks(weight: NDArray[Any]) -> NDArray[Any]:
    """Return the weight (4 · outer, 4 · inner, k, k) of the same convolution on blocks of 2 × 2 cells.

    Args:
        weight: (outer, inner, k, k) with k 1 or 3; channels of a block are ordered (row, column, channel).
    """
    outer, inner, kernel, _ = weight.shape
    reach = kernel // 2
    block_weight = np.zeros((2, 2, outer, 2, 2, inner, kernel, kernel), weight.dtype)
    for row, column, dy, dx in np.ndindex(2, 2, kernel, kernel):
        # The cell that a tap of the kernel reads: which block, and where in it.
        (block_y, y), (block_x, x) = divmod(row + dy - reach, 2), divmod(column + dx - reach, 2)
        block_weight[row, column, :, y, x, :, block_y + reach, block_x + reach] = weight[:, :, dy, dx]
    return block_weight.reshape(4 * outer, 4 * inner, kernel, kernel)


def _rewrite_head(graph: ChannelsLastGraph, node: onnx.NodeProto) -> None:
    """Add the last 1 × 1 convolution on blocks of 2 × 2 cells, and split the blocks into cells (N, cells, cells).

    One product per row of a block gives whole rows of cells: joining rows is faster than moving single cells.
    """
    name, (weight, bias) = node.output[0], (graph.constants[name] for name in node.input[1:])
    cells = graph.card.grid.cells
    last = graph.add("Transpose", [node.input[0]], f"{name}_last", perm=[0, 2, 3, 1])
    one_row = graph.constant(f"{name}_one_row", np.array([-1, 1, cells]))
    rows = []
    for row, part in enumerate(weight_in_blocks(weight)[:, :, 0, 0].reshape(2, 2, -1)):
        x = graph.add("MatMul", [last, graph.constant(f"{name}_weight{row}", part.T)], f"{name}_sums{row}")
        rows.append(graph.add("Reshape", [x, one_row], f"{name}_row{row}"))
    x = graph.add("Concat", rows, f"{name}_blocks", axis=1)
    x = graph.add("Add", [x, graph.constant(f"{name}_bias", np.tile(bias, (2, cells)))], f"{name}_all")
    shape = graph.constant(f"{name}_together", np.array([-1, cells, cells]))
    graph.add("Reshape", [x, shape], name)


_OPSET, _IR = 19, 9
_SEED = 0x6D61736B

_BIAS_FRAMES = 8
"""Number of calibration frames, the first ones, over which biases are corrected."""

_SCALE_PRESERVING = ("Transpose", "Reshape", "MaxPool")
"""Operators that only move values: their outputs keep the scale of their inputs."""

_QUANTIZED_OPERATORS = (*_SCALE_PRESERVING, "Conv", "Add", "Concat", "Mul")
Range = tuple[float, float]
Constants = Mapping[str, NDArray[np.generic]]


@dataclass(frozen=True, slots=True)
class _QuantParams:
    """Scale and zero point of a tensor: value = scale · (byte - zero)."""

    scale: float
    zero: int = 0

    @classmethod
    def of(cls, low: float, high: float) -> _QuantParams:
        low, high = min(low, 0.0), max(high, 0.0)
        scale = max(high - low, 1e-6) / 255.0
        return cls(scale, round(-low / scale))


def quantize_network(
    content: bytes,
    name: str,
    frames: Iterable[Bytes],
    training_facts: Mapping[str, str] | None = None,
    clip: int | None = None,
) -> bytes:
    """Quantize a float32 network to int8 and return the content of the new ONNX file.

    Activations and masks are uint8, weights int8 with one scale per output channel; the last convolution and the
    sigmoid stay in float32. The card's training facts record the precision.

    Args:
        content: of a file that :func:`viewshed_lab.training.onnx_export.export_onnx` wrote.
        name: of the file, for messages.
        frames: maps (1, cells, cells) of :meth:`NetworkCard.maps_of`, at least one; they should resemble the
            sweeps that the network will see.
        training_facts: added to those of the card.
        clip: count of returns at which a cell saturates; None keeps the card's. Smaller values give the first layers
            finer steps.

    Raises:
        ValueError: the file is damaged or already int8, there is no frame, or ``clip`` does not lie in [1, 255].
    """
    verify_checksum(content, name)
    card = inspect_network(content, name)
    model = onnx.load_from_string(content)
    if card.precision == INT8:
        raise ValueError(f"{name} must be a float32 network, got an int8 one; give the file that it was quantized from")
    card = replace(
        card,
        trained={**card.trained, **(training_facts or {}), "precision": INT8},
        clip=card.clip if clip is None else clip,
    )
    graph, maps = to_channels_last(model, card), list(frames)
    if not maps:
        raise ValueError("frames must be at least one, got none")
    return with_checksum(_quantize_graph(graph, maps).SerializeToString())


def _calibrate(graph: ChannelsLastGraph, frames: Sequence[Bytes]) -> dict[str, Range]:
    """Return the minimum and maximum of each tensor over all frames, with dropout off and on."""
    names = [node.output[0] for node in graph.nodes if node.op_type in ("Conv", "Relu", "Add", "Concat")]
    model = _model(graph, graph.nodes, graph.constants, names, TensorProto.FLOAT)
    ranges: dict[str, Range] = dict.fromkeys(names, (0.0, 0.0))
    for outputs in _outputs(graph, model, frames):
        for name, values in outputs.items():
            low, high = ranges[name]
            ranges[name] = min(low, float(values.min())), max(high, float(values.max()))
    return ranges


def _outputs(graph: ChannelsLastGraph, model: onnx.ModelProto, frames: Sequence[Bytes]) -> Iterator[dict[str, F32]]:
    """Yield the outputs of a model by name, per frame, with dropout off and on (the same masks in each call)."""
    run, names = values_of(model.SerializeToString()), [output.name for output in model.graph.output]
    rng, shape = np.random.default_rng(_SEED), graph.card.shape
    in_bytes = model.graph.input[0].type.tensor_type.elem_type == TensorProto.UINT8
    for maps in frames:
        inputs: NDArray[Any] = graph.card.shown(maps)[None]
        inputs = inputs if in_bytes else inputs.astype(np.float32) / np.float32(255.0)
        masks = np.concatenate([shape.no_masks(1), shape.masks(1, rng)])
        yield dict(zip(names, run({"inputs": inputs, "masks": masks}, names), strict=True))


def _correct_biases(quantized: _QdqGraph, frames: Sequence[Bytes]) -> None:
    """Subtract the mean rounding error of each convolution's outputs from its biases, in the order of the layers."""
    graph = quantized.graph
    names = [node.output[0] for node in graph.nodes if f"{node.output[0]}_bias_scale" in quantized.constants]

    def means(nodes: list[onnx.NodeProto], constants: Constants, outputs: list[str], kind: int) -> dict[str, F32]:
        model = _model(graph, nodes, constants, outputs, kind)
        per_frame = [{name: x.mean((0, 2, 3)) for name, x in run.items()} for run in _outputs(graph, model, frames)]
        return {name: np.mean([frame[name] for frame in per_frame], axis=0) for name in outputs}

    expected = means(graph.nodes, graph.constants, names, TensorProto.FLOAT)
    places = {node.output[0]: place for place, node in enumerate(quantized.nodes)}
    for name, mean in expected.items():
        up_to_here = quantized.nodes[: places[f"{name}_wide"] + 1]
        error = means(up_to_here, quantized.constants, [f"{name}_wide"], TensorProto.UINT8)[f"{name}_wide"] - mean
        bias, scale = (np.asarray(quantized.constants[f"{name}_bias{end}"], np.float64) for end in ("", "_scale"))
        quantized.constants[f"{name}_bias"] = np.round(bias - error / scale).astype(np.int32)


def _quantize_graph(graph: ChannelsLastGraph, frames: Sequence[Bytes]) -> onnx.ModelProto:
    quantized = _QdqGraph(graph, _calibrate(graph, frames))
    for node in graph.nodes:
        quantized.add(node)
    _correct_biases(quantized, frames[:_BIAS_FRAMES])
    model = _model(graph, quantized.nodes, quantized.constants, ["probability"], TensorProto.UINT8)
    helper.set_model_props(model, {CARD_KEY: graph.card.to_json()})
    onnx.checker.check_model(model)
    return model


def _model(
    graph: ChannelsLastGraph,
    nodes: list[onnx.NodeProto],
    constants: Constants,
    outputs: list[str],
    kind: int,
) -> onnx.ModelProto:
    card = graph.card
    inputs = [
        helper.make_tensor_value_info("inputs", kind, ["frames", *card.input_shape]),
        helper.make_tensor_value_info("masks", TensorProto.FLOAT, ["passes", sum(card.shape.masked_channels)]),
    ]
    shape: list[Any] | None = ["passes", *card.grid.shape] if outputs == ["probability"] else None
    outputs_info = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in outputs]
    used = {name for node in nodes for name in node.input}
    initializers = [numpy_helper.from_array(value, name) for name, value in constants.items() if name in used]
    graph = helper.make_graph(nodes, "unet", inputs, outputs_info, initializers)
    sets = [helper.make_opsetid("", _OPSET)]
    return helper.make_model(graph, producer_name="viewshed", ir_version=_IR, opset_imports=sets)


@dataclass(slots=True, eq=False)
class _QdqGraph:
    """A graph in QDQ format, built node by node."""

    graph: ChannelsLastGraph  # in float32
    ranges: Mapping[str, Range]  # minimum and maximum of its activations
    nodes: list[onnx.NodeProto] = field(default_factory=list)  # so far
    constants: dict[str, NDArray[np.generic]] = field(default_factory=dict)  # so far
    scales: dict[str, _QuantParams] = field(default_factory=dict)  # of the quantized tensors, by name in ``graph``
    names: dict[str, str] = field(default_factory=dict)  # name of the dequantized tensor that replaces each of them

    def __post_init__(self) -> None:
        self.scales["inputs"] = _QuantParams(1.0 / 255.0)
        self.names["inputs"] = self._dequantize("inputs", "inputs")

    def add(self, node: onnx.NodeProto) -> None:
        """Add a node of the float32 graph; quantize its output if its input is quantized and the operator allows it."""
        kind, output = node.op_type, node.output[0]
        x, scale = node.input[0], None
        if kind == "Unsqueeze":
            scale = mask_scale(self.graph.card.shape.dropout)
        elif x in self.scales and kind in _SCALE_PRESERVING:
            scale = self.scales[x]
        elif x in self.scales and kind == "Mul":
            before = self.scales[x]
            scale = _QuantParams(before.scale / (1.0 - self.graph.card.shape.dropout), before.zero)
        elif x in self.scales and kind in _QUANTIZED_OPERATORS:
            scale = _QuantParams.of(*self.ranges[self._fused_output(output)])
        elif kind == "Relu" and x in self.scales:
            self.names[output], self.scales[output] = self.names[x], self.scales[x]
            return
        self._put(node, scale)

    def _put(self, node: onnx.NodeProto, scale: _QuantParams | None) -> None:
        """Add a node; given a scale, quantize its output, and the weights of a convolution."""
        copy, output = onnx.NodeProto(), node.output[0]
        copy.CopyFrom(node)
        for i, name in enumerate(node.input):
            copy.input[i] = self.names.get(name, name)
            if name in self.graph.constants:
                self.constants[name] = self.graph.constants[name]
        if scale is not None and node.op_type == "Conv":
            self._quantize_weights(copy, node)
        self.nodes.append(copy)
        if scale is not None:
            copy.output[0] = f"{output}_wide"
            self.scales[output] = scale
            quantized = self._node("QuantizeLinear", [copy.output[0], *self._scale(output)], f"{output}_bytes")
            self.names[output] = self._dequantize(output, quantized)

    def _dequantize(self, name: str, quantized: str) -> str:
        return self._node("DequantizeLinear", [quantized, *self._scale(name)], f"{name}_float")

    def _scale(self, name: str) -> tuple[str, str]:
        scale = self.scales[name]
        self.constants[f"{name}_scale"] = np.array(scale.scale, np.float32)
        self.constants[f"{name}_zero"] = np.array(scale.zero, np.uint8)
        return f"{name}_scale", f"{name}_zero"

    def _quantize_weights(self, copy: onnx.NodeProto, node: onnx.NodeProto) -> None:
        """Quantize the weights of a convolution to int8 per output channel, its biases to int32."""
        weight = self.constants.pop(node.input[1]).astype(np.float64)
        step = np.maximum(np.abs(weight).max(axis=(1, 2, 3)), 1e-12) / 127.0
        name = f"{node.name}_weight"
        quantized = np.round(weight / step[:, None, None, None]).astype(np.int8)
        copy.input[1] = self._dequantized_constant(name, quantized, step)
        if len(node.input) > 2:
            unit = step * self.scales[node.input[0]].scale
            bias = np.round(self.constants.pop(node.input[2]) / unit).clip(-(2**31) + 1, 2**31 - 1)
            copy.input[2] = self._dequantized_constant(f"{node.name}_bias", bias.astype(np.int32), unit)

    def _dequantized_constant(self, name: str, quantized: NDArray[np.generic], step: NDArray[np.float64]) -> str:
        values: dict[str, NDArray[np.generic]] = {name: quantized, f"{name}_scale": step.astype(np.float32)}
        values[f"{name}_zero"] = np.zeros(len(step), quantized.dtype)
        self.constants |= values
        return self._node("DequantizeLinear", list(values), f"{name}_float", axis=0)

    def _node(self, kind: str, inputs: list[str], output: str, **settings: Any) -> str:
        self.nodes.append(helper.make_node(kind, inputs, [output], output, **settings))
        return output

    def _fused_output(self, output: str) -> str:
        """Return the tensor whose range applies: the ReLU's output if only a ReLU reads ``output``, else ``output``."""
        readers = [node for node in self.graph.nodes if output in node.input]
        return readers[0].output[0] if len(readers) == 1 and readers[0].op_type == "Relu" else output


def mask_scale(dropout: float) -> _QuantParams:
    """Return the mask scale for which 1 and 1 / (1 - dropout) are closest to integer multiples of at most 255.

    >>> [round(1 / mask_scale(dropout).scale) for dropout in (0.1, 0.8)]
    [225, 50]
    """
    max_one = max(int(255 * (1.0 - dropout)), 1)
    ones = np.arange(min(64, max_one), max_one + 1)
    scaled = ones / (1.0 - dropout)
    error = np.abs(scaled - np.round(scaled)) / ones
    return _QuantParams(1.0 / float(ones[::-1][np.argmin(error[::-1])]))
