"""A network that guesses the ground which no beam met, and how sure it is of that: one guess for each lattice node.

It is given what the returns of a sweep show on the lattice of the ground, a plane and averages through the ground that
is seen (the base), and the lowest beam that passes over each node: the ground lies below that. It answers with two
modes a node, counted from the base, for beyond an edge the ground goes on or falls away. What goes in and what is made
of the answer is native (``core/ground_guess.cpp``); the estimators count beams over the heights that it gives.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn
from torch.nn import functional

from viewshed import _core
from viewshed.arrays import F32, Mask
from viewshed.fov.height_map import HeightMap
from viewshed.geometry import Rigid
from viewshed.networks.onnx_export import with_norm
from viewshed.networks.runtime import Call
from viewshed.preprocess.ground import lattice_nodes
from viewshed.preprocess.leveling import LeveledSweep
from viewshed_lab.sim.terrain import Terrain

CHANNELS, FOLD = 12, 4
"""Maps of the inputs, and nodes a side that the native pass folds into one position."""

HEIGHTS, BASE, BASE_UNIT_M = [1, 2, 3, 5, 8, 10], 8, 4.0
"""Channels of the inputs that are heights, whatever their unit; that of the base, and its unit."""

_LEAST_LOG_M, _MOST_LOG_M = -3.0, 3.0
"""Bounds of the logarithm of a mode's mean deviation."""

_HALVINGS = 24


class Modes(NamedTuple):
    """Two Laplace distributions a node, the second one's mean not above the first one's; (…, n, n) meters each.

    Attributes:
        first_m: mean of the first.
        second_m: mean of the second.
        first_spread_m: mean absolute deviation of the first.
        second_spread_m: of the second.
        first_share: probability of the first.
    """

    first_m: Tensor
    second_m: Tensor
    first_spread_m: Tensor
    second_spread_m: Tensor
    first_share: Tensor

    @classmethod
    def of(cls, outputs: Tensor) -> Modes:
        """Return the modes that outputs (B, 5, n, n) of the network stand for."""
        mean, below, *spreads, odds = outputs.unbind(1)
        first, second = (torch.exp(spread.clamp(_LEAST_LOG_M, _MOST_LOG_M)) for spread in spreads)
        return cls(mean, mean - functional.softplus(below), first, second, torch.sigmoid(odds))

    def log_likelihood(self, ground_m: Tensor) -> Tensor:
        """Return the logarithm of the density (…, n, n) of heights (…, n, n)."""
        pairs = (
            (self.first_share, self.first_m, self.first_spread_m),
            (1.0 - self.first_share, self.second_m, self.second_spread_m),
        )
        first, second = (
            torch.log(share.clamp_min(1e-7) / (2 * spread)) - (ground_m - mean).abs() / spread
            for share, mean, spread in pairs
        )
        return torch.logaddexp(first, second)

    def quantile(self, share: float) -> Tensor:
        """Return the height (…, n, n) below which the ground lies with a probability."""
        low = torch.minimum(self.first_m - 16 * self.first_spread_m, self.second_m - 16 * self.second_spread_m)
        high = torch.maximum(self.first_m + 16 * self.first_spread_m, self.second_m + 16 * self.second_spread_m)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            is_low = self._below(middle) < share
            low, high = torch.where(is_low, middle, low), torch.where(is_low, high, middle)
        return (low + high) / 2

    def std(self) -> Tensor:
        """Return the standard deviation (…, n, n)."""
        mean = self.first_share * self.first_m + (1 - self.first_share) * self.second_m
        first = 2 * self.first_spread_m**2 + (self.first_m - mean) ** 2
        second = 2 * self.second_spread_m**2 + (self.second_m - mean) ** 2
        return torch.sqrt(self.first_share * first + (1 - self.first_share) * second)

    def _below(self, height_m: Tensor) -> Tensor:
        def laplace(mean: Tensor, spread: Tensor) -> Tensor:
            u = (height_m - mean) / spread
            tail = 0.5 * torch.exp(-u.abs())
            return torch.where(u < 0, tail, 1 - tail)

        first, second = laplace(self.first_m, self.first_spread_m), laplace(self.second_m, self.second_spread_m)
        return self.first_share * first + (1 - self.first_share) * second


class _Block(nn.Sequential):
    def __init__(self, given: int, width: int) -> None:
        super().__init__(
            nn.Conv2d(given, width, 3, padding=1, bias=False), nn.BatchNorm2d(width), nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=1, bias=False), nn.BatchNorm2d(width), nn.ReLU(),
        )  # fmt: skip


class GroundNet(nn.Module):
    """A U-Net on the lattice, folded ``fold`` × ``fold`` first; its outputs (B, 5, n, n) are :class:`Modes`.

    Args:
        fold: nodes along a side of what one position of the first layer sees.
        widths: channels of each level, the finest first.
    """

    def __init__(self, fold: int = FOLD, widths: tuple[int, ...] = (32, 48, 64, 96)) -> None:
        super().__init__()
        self.shape = {"fold": fold, "widths": widths}
        self.fold = nn.Sequential(
            nn.PixelUnshuffle(fold), nn.Conv2d(CHANNELS * fold**2, widths[0], 1, bias=False),
            nn.BatchNorm2d(widths[0]), nn.ReLU(),
        )  # fmt: skip
        self.down = nn.ModuleList(_Block(a, b) for a, b in zip((widths[0], *widths[:-1]), widths, strict=True))
        self.up = nn.ModuleList(_Block(a + b, b) for a, b in zip(widths[:0:-1], widths[-2::-1], strict=True))
        last = nn.Conv2d(widths[0], 5 * fold**2, 1)
        nn.init.normal_(last.weight, std=0.01)  # begins with the base
        self.unfold = nn.Sequential(last, nn.PixelShuffle(fold))

    def forward(self, given: Tensor) -> Tensor:
        """Return outputs (B, 5, n, n) for inputs (B, CHANNELS, n, n) that are not folded."""
        x, beside = self.fold(given), []
        for level, block in enumerate(self.down):
            x = block(functional.max_pool2d(x, 2) if level else x)
            beside.append(x)
        for block, skipped in zip(self.up, beside[-2::-1], strict=True):
            x = block(torch.cat([functional.interpolate(x, scale_factor=2.0, mode="nearest"), skipped], 1))
        outputs: Tensor = self.unfold(x)
        return outputs


def network_inputs(leveled: LeveledSweep) -> F32:
    """Return the inputs (1, CHANNELS · FOLD², n / FOLD, n / FOLD) of the network for a leveled sweep, folded.

    They are maps of the lattice, z of them above the base, a plane and averages through the ground that returns show
    (``core/ground_guess.cpp``): any return; z of the second-lowest, lowest and highest one; how many; z of the lowest
    beam that passes over a node, and whether one does; whether the ground is seen; the base; range, height of the
    sensor, side of a node.
    """
    heights_m, seen = _shown(leveled)
    return _core.guess_inputs(
        leveled.points, leveled.azimuth, leveled.range_m, heights_m, seen, leveled.ground.half_extent_m,
        leveled.sensor_height_m,
    )  # fmt: skip


def guessed(leveled: LeveledSweep, run: Call) -> LeveledSweep:
    """Return a leveled sweep on the ground that a network guesses, as seen where returns show it.

    Args:
        leveled: the sweep.
        run: what runs the network of :func:`exported` (:func:`viewshed.networks.runtime.values_of`).
    """
    inputs, (heights_m, seen) = network_inputs(leveled), _shown(leveled)
    outputs = run({"inputs": inputs}, ["outputs"])[0]
    return on_ground(leveled, *_core.guessed_ground(outputs, inputs, heights_m, seen, leveled.ground.half_extent_m))


def exported(net: GroundNet) -> bytes:
    """Return the network between folding and unfolding in ONNX, batch normalization folded into the convolutions."""
    nodes: list[onnx.NodeProto] = []
    constants: list[onnx.TensorProto] = []

    def constant(values: NDArray[Any]) -> str:
        constants.append(numpy_helper.from_array(np.ascontiguousarray(values, np.float32), f"c{len(constants)}"))
        return str(constants[-1].name)

    def node(kind: str, inputs: list[str], name: str = "", **settings: Any) -> str:
        name = name or f"n{len(nodes)}"
        nodes.append(helper.make_node(kind, inputs, [name], name, **settings))
        return name

    def conv(x: str, weight: Tensor, bias: Tensor | None, name: str = "") -> str:
        assert bias is not None
        values = [constant(each.detach().numpy()) for each in (weight, bias)]
        return node("Conv", [x, *values], name, pads=[weight.shape[-1] // 2] * 4)

    def convs(x: str, layers: nn.Module) -> str:
        modules = list(layers.children())
        for convolution, norm in itertools.pairwise(modules):
            if isinstance(convolution, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                x = node("Relu", [conv(x, *with_norm(convolution, norm))])
        return x

    x, beside = convs("inputs", net.fold), []
    for level, layers in enumerate(net.down):
        x = convs(node("MaxPool", [x], kernel_shape=[2, 2], strides=[2, 2]) if level else x, layers)
        beside.append(x)
    twice = constant(np.array([1, 1, 2, 2]))
    as_torch = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
    for layers, skipped in zip(net.up, beside[-2::-1], strict=True):
        x = convs(node("Concat", [node("Resize", [x, "", twice], **as_torch), skipped], axis=1), layers)
    last = net.unfold[0]
    assert isinstance(last, nn.Conv2d)
    conv(x, last.weight, last.bias, "outputs")
    maps = {"inputs": CHANNELS * FOLD**2, "outputs": last.out_channels}
    given, answer = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, count, "rows", "columns"])
        for name, count in maps.items()
    )
    graph = helper.make_graph(nodes, "ground", [given], [answer], constants)
    model = helper.make_model(
        graph, producer_name="viewshed", ir_version=9, opset_imports=[helper.make_opsetid("", 17)]
    )
    onnx.checker.check_model(model)
    content: bytes = model.SerializeToString()
    return content


def _shown(leveled: LeveledSweep) -> tuple[F32, Mask]:
    """Return heights (n, n) of the estimated ground, and where returns show it."""
    ground = leveled.ground  # of fewer nodes where it is not seen at all
    times = lattice_nodes(ground.half_extent_m) // len(ground.seen)
    return ground.heights_m.repeat(times, 0).repeat(times, 1), ground.seen.repeat(times, 0).repeat(times, 1)


def loss_of(outputs: Tensor, ground_m: Tensor, half_extent_m: Tensor) -> Tensor:
    """Return the mean negative log-likelihood of heights (B, n, n) above the base, near nodes weighted more.

    Nodes whose height is NaN do not count.
    """
    line = (torch.arange(ground_m.shape[-1]) + 0.5) / ground_m.shape[-1] * 2 - 1
    weight = 1.0 / (1.0 + torch.hypot(line[:, None], line[None]) * half_extent_m[:, None, None] / 20.0)
    known = torch.isfinite(ground_m)
    likelihood = Modes.of(outputs).log_likelihood(torch.where(known, ground_m, 0.0))
    counted = (weight * known).expand_as(ground_m)
    return -(counted * torch.where(known, likelihood, 0.0)).sum() / counted.sum()


def exact_ground(leveled: LeveledSweep, world_from_sensor: Rigid, terrain: Terrain) -> tuple[F32, Mask]:
    """Return z (n, n) of the exact ground at the nodes, in the level frame as it was estimated, and where it is known.

    What is off in the estimated attitude is off in both: ground that follows the returns is right.
    """
    nodes, half_m = lattice_nodes(leveled.ground.half_extent_m), leveled.ground.half_extent_m
    line = (np.arange(nodes) + 0.5) * 2 * half_m / nodes - half_m
    world_from_level = world_from_sensor @ leveled.level_from_sensor.inverse()
    points = np.stack([*np.meshgrid(line, line, indexing="ij"), np.zeros((nodes, nodes))], axis=-1)
    # Newton's method along z of the level frame, which is not quite upright.
    for _ in range(6):
        there = world_from_level @ points
        points[..., 2] += (terrain.at(there) - there[..., 2]) / world_from_level.rotation[2, 2]
    known = (np.abs(there[..., 0]) < terrain.x_m[-1]) & (np.abs(there[..., 1]) < terrain.y_m[-1])
    return points[..., 2].astype(np.float32), known


def on_ground(
    leveled: LeveledSweep, heights_m: NDArray[np.floating[Any]], std_m: NDArray[np.floating[Any]]
) -> LeveledSweep:
    """Return a leveled sweep on another ground, heights and standard deviations (n, n) in meters."""
    arrays = (np.ascontiguousarray(array, np.float32) for array in (heights_m, std_m))
    old = leveled.ground
    seen = np.kron(old.seen, np.ones((len(heights_m) // len(old.seen),) * 2, np.bool_))
    heights, std = arrays
    ground = HeightMap(heights, old.half_extent_m, seen, old.plane, old.support, std)
    return replace(leveled, ground=ground, height_m=leveled.points[:, 2] - ground.at(leveled.points))
