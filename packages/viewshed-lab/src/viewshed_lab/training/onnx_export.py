"""Export a trained U-Net to one ONNX file that runs without torch; dropout masks stay an input of the graph."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn

from viewshed._files import write_atomic
from viewshed.networks.card import NetworkCard
from viewshed.networks.weights import CARD_KEY, with_checksum
from viewshed_lab.training.unet_torch import Stage, UNet

_OPSET, _IR = 17, 9


def export_onnx(path: str | Path, card: NetworkCard, module: UNet) -> None:
    """Write ``module`` and its card to a new ONNX file with inputs ``inputs`` and ``masks``, output ``probability``.

    ``inputs`` (1 or N, 1, cells, cells) and ``masks`` (N, M) give (N, cells, cells). Batch normalization is
    folded into the convolutions. With one input and N masks, the layers before the first mask (encoder stages 1 and 2)
    and the half of the last decoder stage that reads stage 1 run only once; by linearity the result is exact.
    """
    if module.shape != card.shape:
        raise ValueError(f"module must have the card's shape {card.shape}, got {module.shape}")
    write_atomic(path, with_checksum(onnx_model(card, module).SerializeToString()))


def onnx_model(card: NetworkCard, module: UNet) -> onnx.ModelProto:
    """Return the ONNX model of ``module``, without a checksum; see :func:`export_onnx`."""
    graph = _Graph()
    graph.unet(module)
    cells, total = card.grid.cells, sum(card.shape.masked_channels)
    inputs = [
        helper.make_tensor_value_info("inputs", TensorProto.FLOAT, ["frames", 1, cells, cells]),
        helper.make_tensor_value_info("masks", TensorProto.FLOAT, ["passes", total]),
    ]
    output = helper.make_tensor_value_info("probability", TensorProto.FLOAT, ["passes", cells, cells])
    onnx_graph = helper.make_graph(graph.nodes, "unet", inputs, [output], graph.constants)
    model = helper.make_model(
        onnx_graph, producer_name="viewshed", ir_version=_IR, opset_imports=[helper.make_opsetid("", _OPSET)]
    )
    helper.set_model_props(model, {CARD_KEY: card.to_json()})
    onnx.checker.check_model(model)
    return model


@dataclass(slots=True)
class _Graph:
    """Nodes and constants so far; every method adds nodes and returns the name of their output."""

    nodes: list[onnx.NodeProto] = field(default_factory=list)
    constants: list[onnx.TensorProto] = field(default_factory=list)

    def unet(self, module: UNet) -> None:
        shape = module.shape
        parts = self.parts(shape.masked_channels)
        skips: list[str] = []
        x = "inputs"
        for i, stage in enumerate(module.encoder):
            x = x if i == 0 else self.node("MaxPool", [x], kernel_shape=[2, 2], strides=[2, 2])
            x = self.stage(_stage(stage), x)
            x = x if i == 0 else self.node("Mul", [x, parts[i - 1]])
            skips.append(x)
        skips.pop()
        for i, (up, stage) in enumerate(zip(module.up, module.decoder, strict=True)):
            assert isinstance(up, nn.ConvTranspose2d)
            x = self.node("ConvTranspose", [x, *self.weights(up.weight, up.bias)], kernel_shape=[2, 2], strides=[2, 2])
            last = i == shape.depth - 1
            x = self.split_stage(_stage(stage), x, skips.pop()) if last else self.joined(_stage(stage), x, skips.pop())
            x = x if last else self.node("Mul", [x, parts[shape.depth + i]])
        x = self.node("Conv", [x, *self.weights(module.head.weight, module.head.bias)], kernel_shape=[1, 1])
        x = self.node("Sigmoid", [x])
        self.nodes.append(helper.make_node("Squeeze", [x, self.constant(np.array([1]))], ["probability"]))

    def parts(self, channels: tuple[int, ...]) -> list[str]:
        names = [f"part{i}" for i in range(len(channels))]
        self.nodes.append(helper.make_node("Split", ["masks", self.constant(np.array(channels))], names, axis=1))
        axes = self.constant(np.array([2, 3]))
        return [self.node("Unsqueeze", [name, axes]) for name in names]

    def stage(self, stage: Stage, x: str) -> str:
        return self.second(stage, self.node("Relu", [self.conv(x, *with_norm(stage.conv1, stage.norm1))]))

    def joined(self, stage: Stage, x: str, skip: str) -> str:
        return self.stage(stage, self.node("Concat", [x, skip], axis=1))

    def split_stage(self, stage: Stage, x: str, skip: str) -> str:
        """As ``joined``, but convolve the unmasked skip separately from ``x``, so that it runs only once."""
        weight, bias = with_norm(stage.conv1, stage.norm1)
        half = weight.shape[1] // 2
        shared = self.conv(skip, weight[:, half:], bias)
        own = self.conv(x, weight[:, :half], None)
        return self.second(stage, self.node("Relu", [self.node("Add", [own, shared])]))

    def second(self, stage: Stage, x: str) -> str:
        return self.node("Relu", [self.conv(x, *with_norm(stage.conv2, stage.norm2))])

    def conv(self, x: str, weight: Tensor, bias: Tensor | None) -> str:
        return self.node("Conv", [x, *self.weights(weight, bias)], kernel_shape=[3, 3], pads=[1, 1, 1, 1])

    def weights(self, weight: Tensor, bias: Tensor | None) -> list[str]:
        return [self.constant(tensor.detach().cpu().numpy()) for tensor in (weight, bias) if tensor is not None]

    def constant(self, array: NDArray[np.float32] | NDArray[np.int64]) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def node(self, kind: str, inputs: list[str], **settings: Any) -> str:
        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [name], name, **settings))
        return name


def _stage(module: nn.Module) -> Stage:
    assert isinstance(module, Stage)
    return module


def with_norm(conv: nn.Conv2d, norm: nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """Fold batch normalization into the convolution before it; return the new weight and bias."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    return conv.weight * scale[:, None, None, None], norm.bias - norm.running_mean * scale
