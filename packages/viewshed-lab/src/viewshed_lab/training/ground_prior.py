"""A network that guesses the ground which no return shows, and how sure it is of that: one guess for each lattice node.

It is given what the returns of a sweep show on the lattice of the ground, the ground as it was found from them with its
deviation, and the lowest beam that passes over each node: the ground lies below that. It answers with three quantiles
of the height above the found ground, so that it need not know what rules know already. What goes in, the network and
what is made of its answer are native (``core/ground_guess.cpp``); :func:`source_of` writes its numbers.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from viewshed import _core
from viewshed.arrays import F32, Mask
from viewshed.fov.height_map import HeightMap
from viewshed.geometry import Rigid
from viewshed.networks.onnx_export import with_norm
from viewshed.preprocess.ground import lattice_nodes
from viewshed.preprocess.leveling import LeveledSweep
from viewshed_lab.sim.terrain import Terrain

CHANNELS, FOLD = 13, 4
"""Maps of the inputs, and nodes a side that the network sees as one position."""

HEIGHTS, PASSED, SEEN, GROUND, GROUND_UNIT_M = [1, 2, 3, 5, 8, 10, 12], 6, 7, 8, 4.0
"""Channels of the inputs: heights; whether a beam passes over the node; whether returns show the ground; its z, and the
unit of that."""

PROBABILITIES = (0.15, 0.5, 0.85)
"""Of the quantiles: the middles of the weights by which visibility is averaged over the ground (.3, .4, .3)."""

UNIT_M = 0.3
"""Heights are learned as asinh(height / UNIT_M): 10 cm more count near 0, and hardly at 5 m."""

_LEVELS_OF_WEIGHT = 44
"""Weights are whole multiples, at most this, of a scale for each output."""

_LETTERS = "".join(chr(code) for code in range(35, 127) if chr(code) not in "?\\")


class _Block(nn.Sequential):
    def __init__(self, given: int, width: int) -> None:
        super().__init__(
            nn.Conv2d(given, width, 3, padding=1, bias=False), nn.BatchNorm2d(width), nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=1, bias=False), nn.BatchNorm2d(width), nn.ReLU(),
        )  # fmt: skip


class GroundNet(nn.Module):
    """A U-Net on the lattice, folded ``FOLD`` × ``FOLD`` first, that answers with three numbers a node (B, 3, n, n).

    Args:
        widths: channels of each level, the finest first.
    """

    def __init__(self, widths: tuple[int, ...] = (16, 24, 32, 48)) -> None:
        super().__init__()
        self.widths = widths
        self.fold = nn.Sequential(
            nn.PixelUnshuffle(FOLD), nn.Conv2d(CHANNELS * FOLD**2, widths[0], 1, bias=False),
            nn.BatchNorm2d(widths[0]), nn.ReLU(),
        )  # fmt: skip
        self.down = nn.ModuleList(_Block(a, b) for a, b in zip((widths[0], *widths[:-1]), widths, strict=True))
        self.up = nn.ModuleList(_Block(a + b, b) for a, b in zip(widths[:0:-1], widths[-2::-1], strict=True))
        last = nn.Conv2d(widths[0], len(PROBABILITIES) * FOLD**2, 1)
        nn.init.normal_(last.weight, std=0.01)  # begins with the found ground
        self.unfold = nn.Sequential(last, nn.PixelShuffle(FOLD))

    def forward(self, given: Tensor) -> Tensor:
        """Return outputs (B, 3, n, n) for inputs (B, CHANNELS, n, n)."""
        x, beside = self.fold(given), []
        for level, block in enumerate(self.down):
            x = block(functional.max_pool2d(x, 2) if level else x)
            beside.append(x)
        for block, skipped in zip(self.up, beside[-2::-1], strict=True):
            x = block(torch.cat([functional.interpolate(x, scale_factor=2.0, mode="nearest"), skipped], 1))
        outputs: Tensor = self.unfold(x)
        return outputs


def quantiles_of(outputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the quantiles (B, n, n) of outputs (B, 3, n, n): asinh(meters above the found ground / UNIT_M)."""
    below, median, above = outputs.unbind(1)
    return median - functional.softplus(below), median, median + functional.softplus(above)


def loss_of(outputs: Tensor, inputs: Tensor, ground_m: Tensor, half_extent_m: Tensor) -> Tensor:
    """Return the mean quantile loss of heights (B, n, n) above the found ground; NaN does not count.

    Near nodes count more, and those that a beam passes over; those that returns show hardly.
    """
    line = (torch.arange(ground_m.shape[-1]) + 0.5) / ground_m.shape[-1] * 2 - 1
    weight = 1.0 / (1.0 + torch.hypot(line[:, None], line[None]) * half_extent_m[:, None, None] / 20.0)
    weight = weight * torch.where(inputs[:, SEEN] > 0, 0.05, 1.0) * torch.where(inputs[:, PASSED] > 0, 1.0, 0.3)
    known = torch.isfinite(ground_m)
    exact = torch.asinh(torch.where(known, ground_m, 0.0) / UNIT_M)
    loss = torch.zeros_like(exact)
    for probability, quantile in zip(PROBABILITIES, quantiles_of(outputs), strict=True):
        off = exact - quantile
        loss = loss + torch.maximum(probability * off, (probability - 1.0) * off)
    counted = weight * known
    return (counted * torch.where(known, loss, 0.0)).sum() / counted.sum()


def network_inputs(leveled: LeveledSweep) -> F32:
    """Return the inputs (CHANNELS, n, n) of the network for a sweep on its found ground.

    They are maps of the lattice, z of them above the found ground (``core/ground_guess.cpp``): any return; z of the
    second-lowest, lowest and highest one; how many; z of the lowest beam that passes over a node, and whether one does;
    whether the ground is seen; its z; range, height of the sensor, side of a node; the deviation of the ground.
    """
    heights_m, std_m, seen = on_lattice(leveled.ground)
    n = len(seen)
    folded = _core.guess_inputs(
        leveled.points, leveled.azimuth, leveled.range_m, heights_m, std_m, seen, leveled.ground.half_extent_m,
        leveled.sensor_height_m,
    )  # fmt: skip
    return np.ascontiguousarray(
        folded.reshape(n // FOLD, n // FOLD, FOLD, FOLD, CHANNELS).transpose(4, 0, 2, 1, 3).reshape(CHANNELS, n, n)
    )


def on_lattice(ground: HeightMap) -> tuple[F32, F32, Mask]:
    """Return heights and deviations (n, n), and where returns show the ground; the fewer nodes of none are repeated."""
    times = lattice_nodes(ground.half_extent_m) // len(ground.seen)
    heights_m, std_m, seen = (
        array.repeat(times, 0).repeat(times, 1) for array in (ground.heights_m, ground.std_m, ground.seen)
    )
    return heights_m, std_m, seen


def source_of(net: GroundNet) -> str:
    """Return a network's numbers as C++, which is compiled into the core; batch normalization becomes part of them."""
    scales, biases, letters = [], [], []
    for weight, bias in _layers(net):
        scale = np.abs(weight).max(axis=(0, 1)).clip(1e-9) / _LEVELS_OF_WEIGHT
        numbers = np.rint(weight / scale).astype(int) + _LEVELS_OF_WEIGHT
        letters += [_LETTERS[number] for number in numbers.ravel()]
        scales.append(scale)
        biases.append(bias)
    lines = [f"static const std::size_t WIDTHS[] = {{{', '.join(map(str, net.widths))}}};"]
    for name, values in (("SCALES", np.concatenate(scales)), ("BIASES", np.concatenate(biases))):
        words = [f"{value:.9e}f" for value in values.tolist()]
        rows = [", ".join(words[k : k + 8]) for k in range(0, len(words), 8)]
        lines.append(f"static const float {name}[] = {{\n" + ",\n".join(rows) + "};")
    text = "".join(letters)
    lines.append("static const char WEIGHTS[] =")
    lines += [f'"{text[k : k + 120]}"' for k in range(0, len(text), 120)]
    return "\n".join(lines) + ";\n"


def _layers(net: GroundNet) -> Iterator[tuple[F32, F32]]:
    """Yield weights (taps, inputs, outputs) and bias (outputs,) of each layer; folded nodes before their values."""
    nodes = FOLD**2
    for module in (net.fold, *net.down, *net.up):
        for convolution, norm in itertools.pairwise(module.children()):
            if isinstance(convolution, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                weight, bias = (tensor.detach().numpy() for tensor in with_norm(convolution, norm))
                if module is net.fold:
                    weight = weight.reshape(-1, CHANNELS, nodes, 1).transpose(0, 2, 1, 3).reshape(weight.shape)
                yield weight.reshape(*weight.shape[:2], -1).transpose(2, 1, 0), bias
    last = net.unfold[0]
    assert isinstance(last, nn.Conv2d)
    assert last.bias is not None
    weight, bias = (tensor.detach().numpy() for tensor in (last.weight, last.bias))
    weight = weight.reshape(len(PROBABILITIES), nodes, -1).transpose(1, 0, 2).reshape(-1, weight.shape[1], 1)
    yield weight.transpose(2, 1, 0), bias.reshape(len(PROBABILITIES), nodes).T.ravel()


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
