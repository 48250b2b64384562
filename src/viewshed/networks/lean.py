"""The graph of an exported network rewritten so that eight-bit engines run it well; it says what it said before."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import helper, numpy_helper

from viewshed.networks.spec import NetworkCard


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
    """Return the graph of a model that :func:`viewshed.networks.onnx_file.export_onnx` wrote, rewritten."""
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
