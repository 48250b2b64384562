"""From an exported network to one that multiplies bytes: the ranges of what flows in it are measured on sweeps.

The graph of an exported network rewritten so that eight-bit engines run it well; it says what it said before.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from viewshed.networks.card import INT8, NetworkCard
from viewshed.networks.features import Bytes
from viewshed.networks.inspection import inspect_network
from viewshed.networks.runtime import values_of
from viewshed.networks.weights import CARD_KEY, verify_checksum, with_checksum


@dataclass(slots=True, eq=False)
class Lean:
    """Nodes and constants of a network that takes ``inputs`` (N, side, side, channels · fold²), channels last.

    The order of the last axis is (channel, row in the block, column in the block), as :meth:`NetworkCard.shown` gives
    it to a network of bytes. Transposed convolutions 2 × 2 are convolutions 1 × 1 whose channels become cells by moving
    whole rows.

    Attributes:
        card: of the network.
        nodes: in an order in which they can run.
        constants: by name.
    """

    card: NetworkCard
    nodes: list[onnx.NodeProto] = field(default_factory=list)
    constants: dict[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def side(self) -> int:
        """Cells a side after folding."""
        return self.card.grid.cells // self.card.shape.fold

    @property
    def inner(self) -> int:
        """Numbers of a folded cell."""
        return self.card.shape.channels * self.card.shape.fold**2

    def constant(self, name: str, value: NDArray[np.generic]) -> str:
        """Add a constant and return its name."""
        self.constants[name] = np.ascontiguousarray(value)
        return name

    def add(self, kind: str, inputs: list[str], output: str, **settings: Any) -> str:
        """Add a node that is called as what it gives, and return that name."""
        self.nodes.append(helper.make_node(kind, inputs, [output], output, **settings))
        return output


def lean_of(model: onnx.ModelProto, card: NetworkCard) -> Lean:
    """Return the graph of a model that :func:`viewshed.networks.onnx_export.export_onnx` wrote, rewritten."""
    lean = Lean(card)
    lean.constants = {each.name: numpy_helper.to_array(each) for each in model.graph.initializer}
    first = lean.add("Transpose", ["inputs"], "straight", perm=[0, 3, 1, 2])
    same, side = {"inputs": first}, lean.side
    for node in model.graph.node:
        x, output = same.get(node.input[0], node.input[0]), node.output[0]
        if node.op_type in ("SpaceToDepth", "DepthToSpace"):
            same[output] = x
        elif node.op_type == "Shape":
            _copy(lean, node, "inputs")
        elif node.op_type == "ConvTranspose":
            _unfold(lean, node, side)
            side *= 2
        elif node.op_type == "Conv" and lean.constants[node.input[1]].shape[2:] == (1, 1):
            _head(lean, node)
        else:
            side = side // 2 if node.op_type == "MaxPool" else side
            _copy(lean, node, x)
    used = {name for node in lean.nodes for name in node.input}
    lean.constants = {name: value for name, value in lean.constants.items() if name in used}
    return lean


def _copy(lean: Lean, node: onnx.NodeProto, x: str) -> None:
    """Add a node as it is but for its first input; the weights of the first convolution in the order of the input."""
    copy = onnx.NodeProto()
    copy.CopyFrom(node)
    copy.name, copy.input[0] = node.name or node.output[0], x
    if x == "straight":
        copy.input[1] = lean.constant("first_weight", _by_channel(lean, lean.constants[copy.input[1]]))
    lean.nodes.append(copy)


def _by_channel(lean: Lean, weight: NDArray[Any]) -> NDArray[np.generic]:
    """Return a weight for bytes (channel, place in the block) / 255 of one for values (place in the block, channel)."""
    outer, inner = weight.shape[:2]
    most = lean.card.most_shown
    parts = weight.reshape(outer, inner // len(most), len(most), *weight.shape[2:]) * most[:, None, None]
    return parts.swapaxes(1, 2).reshape(weight.shape)


def _unfold(lean: Lean, node: onnx.NodeProto, side: int) -> None:
    """Add what a transposed convolution 2 × 2 with stride 2 does."""
    name, (weight, bias) = node.output[0], (lean.constants[each] for each in node.input[1:])
    inner, outer = weight.shape[:2]
    spread = weight.transpose(2, 3, 1, 0).reshape(4 * outer, inner, 1, 1)
    own = lean.constant(f"{name}_weight", spread), lean.constant(f"{name}_bias", np.tile(bias, 4))
    x = lean.add("Conv", [node.input[0], *own], f"{name}_four", kernel_shape=[1, 1])
    x = lean.add("Transpose", [x], f"{name}_last", perm=[0, 2, 3, 1])
    shape = lean.constant(f"{name}_apart", np.array([-1, side, side, 2, 2 * outer]))
    x = lean.add("Reshape", [x, shape], f"{name}_rows")
    x = lean.add("Transpose", [x], f"{name}_moved", perm=[0, 1, 3, 2, 4])
    shape = lean.constant(f"{name}_together", np.array([-1, 2 * side, 2 * side, outer]))
    x = lean.add("Reshape", [x, shape], f"{name}_cells")
    lean.add("Transpose", [x], name, perm=[0, 3, 1, 2])


def _head(lean: Lean, node: onnx.NodeProto) -> None:
    """Add what the last convolution 1 × 1 of a head does, and what unfolds its channels to cells."""
    name, (weight, bias) = node.output[0], (lean.constants[each] for each in node.input[1:])
    fold, side = lean.card.shape.fold, lean.side
    x = lean.add("Transpose", [node.input[0]], f"{name}_last", perm=[0, 2, 3, 1])
    x = lean.add("MatMul", [x, lean.constant(f"{name}_weight", weight[:, :, 0, 0].T)], f"{name}_sums")
    shape = lean.constant(f"{name}_rows", np.array([-1, side, side * fold**2]))
    x = lean.add("Reshape", [x, shape], f"{name}_long")  # to add a bias to long rows is several times as fast
    x = lean.add("Add", [x, lean.constant(f"{name}_bias", np.tile(bias, side))], f"{name}_all")
    shape = lean.constant(f"{name}_apart", np.array([-1, side, side, fold, fold]))
    x = lean.add("Reshape", [x, shape], f"{name}_blocks")
    x = lean.add("Transpose", [x], f"{name}_moved", perm=[0, 1, 3, 2, 4])
    shape = lean.constant(f"{name}_together", np.array([-1, 1, side * fold, side * fold]))
    lean.add("Reshape", [x, shape], name)


_OPSET, _IR = 19, 9

_SEED = 0x6D61736B

_SAME = ("Transpose", "Reshape", "MaxPool", "Slice")
"""What moves numbers and leaves them as they are."""

_BYTES = (*_SAME, "Conv", "Add", "Concat", "Mul")

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class _Scale:
    """How a tensor is told in bytes: value = scale · (byte - zero)."""

    scale: float
    zero: int = 0

    @classmethod
    def of(cls, low: float, high: float) -> _Scale:
        low, high = min(low, 0.0), max(high, 0.0)
        scale = max(high - low, 1e-6) / 255.0
        return cls(scale, round(-low / scale))


def quantized(content: bytes, name: str, frames: Iterable[Bytes], told: Mapping[str, str] | None = None) -> bytes:
    """Return the file of a network in bytes, of that of one in float32.

    Activations and masks are bytes, weights signed bytes with a scale for each channel they give; the last convolutions
    of the heads, and what follows them, stay in float32. The card says so among the facts of the training.

    Args:
        content: of a file that :func:`viewshed.networks.onnx_export.export_onnx` wrote.
        name: stands for it in messages.
        frames: maps (channels, cells, cells) as :meth:`NetworkCard.maps_of` returns them, at least one; the more they
            are like what the network will see, the better.
        told: facts to be added to those of the training.

    Raises:
        ValueError: the file is damaged, or a network in bytes already; or there is no frame.
    """
    verify_checksum(content, name)
    card = inspect_network(content, name)
    model = onnx.load_from_string(content)
    if card.precision == INT8:
        raise ValueError(f"{name} must be a network in float32, got one in bytes; give the file that it was made of")
    card = replace(card, trained={**card.trained, **(told or {}), "precision": INT8})
    lean = lean_of(model, card)
    return with_checksum(_in_bytes(lean, _ranges(lean, frames)).SerializeToString())


def _ranges(lean: Lean, frames: Iterable[Bytes]) -> dict[str, Range]:
    """Return the smallest and the largest value of each tensor over all frames, with dropout off and on."""
    names = [node.output[0] for node in lean.nodes if node.op_type in ("Conv", "Relu", "Add", "Concat")]
    content = _model(lean, lean.nodes, lean.constants, names, TensorProto.FLOAT).SerializeToString()
    run, found = values_of(content), dict.fromkeys(names, (0.0, 0.0))
    shown, rng, shape = 0, np.random.default_rng(_SEED), lean.card.shape
    for maps in frames:
        shown += 1
        inputs = lean.card.shown(maps)[None].astype(np.float32) / np.float32(255.0)
        masks = np.concatenate([shape.no_masks(1), shape.masks(1, rng)])
        for name, values in zip(names, run(inputs, masks, names), strict=True):
            low, high = found[name]
            found[name] = min(low, float(values.min())), max(high, float(values.max()))
    if shown == 0:
        raise ValueError("frames must be at least one, got none")
    return found


def _in_bytes(lean: Lean, ranges: Mapping[str, Range]) -> onnx.ModelProto:
    made = _Bytes(lean, ranges)
    for node in lean.nodes:
        made.take(node)
    outputs = ["probability", "deviation"] if lean.card.shape.doubt else ["probability"]
    model = _model(lean, made.nodes, made.constants, outputs, TensorProto.UINT8)
    helper.set_model_props(model, {CARD_KEY: lean.card.to_json()})
    onnx.checker.check_model(model)
    return model


def _model(
    lean: Lean,
    nodes: list[onnx.NodeProto],
    constants: Mapping[str, NDArray[np.generic]],
    outputs: list[str],
    kind: int,
) -> onnx.ModelProto:
    card = lean.card
    inputs = [
        helper.make_tensor_value_info("inputs", kind, ["frames", lean.side, lean.side, lean.inner]),
        helper.make_tensor_value_info("masks", TensorProto.FLOAT, ["passes", sum(card.shape.masked_channels)]),
    ]
    counts, bare = {"probability": "passes", "deviation": "frames"}, kind == TensorProto.FLOAT
    shapes: list[Any] = [None if bare else [counts[each], *card.grid.shape] for each in outputs]
    told = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, shape in zip(outputs, shapes, strict=True)
    ]
    held = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    graph = helper.make_graph(nodes, "unet", inputs, told, held)
    sets = [helper.make_opsetid("", _OPSET)]
    return helper.make_model(graph, producer_name="viewshed", ir_version=_IR, opset_imports=sets)


@dataclass(slots=True, eq=False)
class _Bytes:
    """Nodes of a network in bytes in the making: each is told in float32, between numbers that were bytes and will be.

    So any engine computes the same; one that knows the pattern computes with the bytes themselves.
    """

    lean: Lean
    ranges: Mapping[str, Range]
    nodes: list[onnx.NodeProto] = field(default_factory=list)
    constants: dict[str, NDArray[np.generic]] = field(default_factory=dict)
    scales: dict[str, _Scale] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.scales["inputs"] = _Scale(1.0 / 255.0)
        self.names["inputs"] = self._float("inputs", "inputs")

    def take(self, node: onnx.NodeProto) -> None:
        """Add a node of the lean graph."""
        kind, output = node.op_type, node.output[0]
        x, scale = node.input[0], None
        if kind == "Unsqueeze":
            scale = mask_scale(self.lean.card.shape.dropout)
        elif x in self.scales and kind in _SAME:
            scale = self.scales[x]
        elif x in self.scales and kind == "Mul":
            before = self.scales[x]
            scale = _Scale(before.scale / (1.0 - self.lean.card.shape.dropout), before.zero)
        elif x in self.scales and kind in _BYTES:
            scale = _Scale.of(*self.ranges[self._after(output)])
        elif kind == "Relu" and x in self.scales:
            self.names[output], self.scales[output] = self.names[x], self.scales[x]
            return
        self._put(node, scale)

    def _put(self, node: onnx.NodeProto, scale: _Scale | None) -> None:
        """Add a node; with a scale what it gives is told in bytes, and its weights are."""
        copy, output = onnx.NodeProto(), node.output[0]
        copy.CopyFrom(node)
        for i, name in enumerate(node.input):
            copy.input[i] = name if node.op_type == "Shape" else self.names.get(name, name)
            if name in self.lean.constants:
                self.constants[name] = self.lean.constants[name]
        if scale is not None and node.op_type == "Conv":
            self._weigh(copy, node)
        self.nodes.append(copy)
        if scale is not None:
            copy.output[0] = f"{output}_wide"
            self.scales[output] = scale
            told = self._node("QuantizeLinear", [copy.output[0], *self._scale(output)], f"{output}_bytes")
            self.names[output] = self._float(output, told)

    def _float(self, name: str, told: str) -> str:
        return self._node("DequantizeLinear", [told, *self._scale(name)], f"{name}_float")

    def _scale(self, name: str) -> tuple[str, str]:
        scale = self.scales[name]
        self.constants[f"{name}_scale"] = np.array(scale.scale, np.float32)
        self.constants[f"{name}_zero"] = np.array(scale.zero, np.uint8)
        return f"{name}_scale", f"{name}_zero"

    def _weigh(self, copy: onnx.NodeProto, node: onnx.NodeProto) -> None:
        """Tell the weights of a convolution in signed bytes, and its biases in the units of what it sums up."""
        weight = self.constants.pop(node.input[1]).astype(np.float64)
        step = np.maximum(np.abs(weight).max(axis=(1, 2, 3)), 1e-12) / 127.0
        name = f"{node.name}_weight"
        told = np.round(weight / step[:, None, None, None]).astype(np.int8)
        copy.input[1] = self._held(name, told, step)
        if len(node.input) > 2:
            unit = step * self.scales[node.input[0]].scale
            bias = np.round(self.constants.pop(node.input[2]) / unit).clip(-(2**31) + 1, 2**31 - 1)
            copy.input[2] = self._held(f"{node.name}_bias", bias.astype(np.int32), unit)

    def _held(self, name: str, told: NDArray[np.generic], step: NDArray[np.float64]) -> str:
        values = {name: told, f"{name}_scale": step.astype(np.float32), f"{name}_zero": np.zeros(len(step), told.dtype)}
        self.constants |= values
        return self._node("DequantizeLinear", list(values), f"{name}_float", axis=0)

    def _node(self, kind: str, inputs: list[str], output: str, **settings: Any) -> str:
        self.nodes.append(helper.make_node(kind, inputs, [output], output, **settings))
        return output

    def _after(self, output: str) -> str:
        """Return what follows: the rectified values where only these are used."""
        readers = [node for node in self.lean.nodes if output in node.input]
        return readers[0].output[0] if len(readers) == 1 and readers[0].op_type == "Relu" else output


def mask_scale(dropout: float) -> _Scale:
    """Return the scale of masks for which both 1 and 1 / (1 - dropout) are nearest to whole numbers of at most 255.

    >>> round(1 / mask_scale(0.1).scale)
    225
    """
    ones = np.arange(64, int(255 * (1.0 - dropout)) + 1)
    kept = ones / (1.0 - dropout)
    away = np.abs(kept - np.round(kept)) / ones
    return _Scale(1.0 / float(ones[::-1][np.argmin(away[::-1])]))
