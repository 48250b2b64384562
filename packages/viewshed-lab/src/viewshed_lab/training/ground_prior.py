"""A network that guesses the ground which no return shows, and how sure it is of that: one guess for each lattice node.

It is given what the returns of a sweep show on the lattice of the ground, the ground as it was found from them with its
deviation, and the lowest beam that passes over each node: the ground lies below that. It answers with three quantiles
of the height above the found ground, so that it need not know what rules know already. What goes in is native
(``core/ground_guess.cpp``). It is an experiment: ``tools/fit_ground.py`` says what it reaches.
"""

from __future__ import annotations

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
from viewshed.preprocess.ground import lattice_nodes
from viewshed.preprocess.leveling import LeveledSweep
from viewshed_lab.sim.terrain import Terrain

CHANNELS, FOLD = 13, 4
"""Maps of the inputs, and nodes a side that the network sees as one position."""

HEIGHTS, BEAM, PASSED, SEEN, GROUND, GROUND_UNIT_M = [1, 2, 3, 5, 8, 10, 12], 5, 6, 7, 8, 4.0
"""Channels of the inputs: heights; the lowest beam over the node, and whether there is one; whether returns show the
ground; its z, and the unit of that."""

PROBABILITIES = (0.15, 0.5, 0.85)
"""Of the quantiles: the middles of the weights by which visibility is averaged over the ground (.3, .4, .3)."""

UNIT_M = 0.3
"""Heights are learned as asinh(height / UNIT_M): 10 cm more count near 0, and hardly at 5 m."""

_OUTER_STDS = 1.0364
"""Standard deviations between the median of a normal distribution and its outer quantiles."""

_MOST, _MOST_ABOVE_M, _OVER_BEAM_M = 5.0, 15.0, 0.1
"""Quantiles are cut off; beams are as high as inputs say at most; the ground may lie this far above a beam."""


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
    """Return the inputs (CHANNELS, n, n) of the network for a leveled sweep.

    They are maps of the lattice, z of them above the found ground: any return; z of the second-lowest, lowest and
    highest one; how many; z of the lowest beam that passes over a node, and whether one does; whether the ground is
    seen; its z; range, height of the sensor, side of a node; the deviation of the ground.
    """
    return _core.guess_inputs(
        leveled.points, leveled.azimuth, leveled.range_m, *on_lattice(leveled.ground), leveled.ground.half_extent_m,
        leveled.sensor_height_m,
    )  # fmt: skip


def guessed(leveled: LeveledSweep, net: GroundNet) -> LeveledSweep:
    """Return a leveled sweep on the ground that a network guesses; as it was found where returns show it.

    It lies nowhere above the lowest beam that passes over it.
    """
    maps, (heights_m, std_m, seen) = network_inputs(leveled), on_lattice(leveled.ground)
    with torch.no_grad():
        quantiles = quantiles_of(net(torch.tensor(maps)[None]))
    low_m, median_m, high_m = (UNIT_M * np.sinh(each[0].clamp(-_MOST, _MOST).numpy()) for each in quantiles)
    passes = (maps[PASSED] > 0) & (maps[BEAM] < _MOST_ABOVE_M)
    above_m = np.minimum(median_m, np.where(passes, maps[BEAM] + _OVER_BEAM_M, np.inf))
    guessed_std_m = (high_m - low_m) / (2 * _OUTER_STDS)
    return on_ground(leveled, heights_m + np.where(seen, 0.0, above_m), np.where(seen, std_m, guessed_std_m))


def on_lattice(ground: HeightMap) -> tuple[F32, F32, Mask]:
    """Return heights and deviations (n, n), and where returns show the ground; the fewer nodes of none are repeated."""
    times = lattice_nodes(ground.half_extent_m) // len(ground.seen)
    heights_m, std_m = (array.repeat(times, 0).repeat(times, 1) for array in (ground.heights_m, ground.std_m))
    return heights_m, std_m, ground.seen.repeat(times, 0).repeat(times, 1)


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
