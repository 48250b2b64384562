"""A network that guesses the ground which no beam met, and how sure it is of that: one guess for each lattice node.

It is given what the returns of a sweep show on the lattice of the ground, the ground as it was estimated, and the
lowest beam that passes over each node: the ground lies below that. It answers with two modes a node, counted from the
estimated ground, for beyond an edge the ground goes on or falls away. The estimators count beams over the heights that
it gives (:func:`on_ground`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from viewshed.arrays import F32, Mask
from viewshed.fov.height_map import HeightMap
from viewshed.geometry import Rigid
from viewshed.preprocess.ground import lattice_nodes
from viewshed.preprocess.leveling import LeveledSweep
from viewshed_lab.sim.terrain import Terrain

FEATURES = ("returns", "second_lowest_m", "lowest_m", "highest_m", "passing_m", "seen", "ground_m")
"""Of each node: how many returns, z of three of them, z of the lowest beam that passes over it (+inf for none), whether
the estimated ground rests on returns there, and its z."""

CHANNELS = 12

_BINS, _REACH_NODES = 1024, 100
"""Azimuths and ranges, in nodes, for which the lowest passing beam is kept."""

_MOST_M = 15.0
"""Heights farther above or below the estimated ground are cut off."""

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

    def __init__(self, fold: int = 4, widths: tuple[int, ...] = (32, 48, 64, 96)) -> None:
        super().__init__()
        self.shape = {"fold": fold, "widths": widths}
        self.fold = nn.Sequential(
            nn.PixelUnshuffle(fold), nn.Conv2d(CHANNELS * fold**2, widths[0], 1, bias=False),
            nn.BatchNorm2d(widths[0]), nn.ReLU(),
        )  # fmt: skip
        self.down = nn.ModuleList(_Block(a, b) for a, b in zip((widths[0], *widths[:-1]), widths, strict=True))
        self.up = nn.ModuleList(_Block(a + b, b) for a, b in zip(widths[:0:-1], widths[-2::-1], strict=True))
        last = nn.Conv2d(widths[0], 5 * fold**2, 1)
        nn.init.normal_(last.weight, std=0.01)  # begins with the estimated ground
        self.unfold = nn.Sequential(last, nn.PixelShuffle(fold))

    def forward(self, given: Tensor) -> Tensor:
        """Return outputs (B, 5, n, n) for inputs (B, CHANNELS, n, n) of :func:`inputs_of`."""
        x, beside = self.fold(given), []
        for level, block in enumerate(self.down):
            x = block(functional.max_pool2d(x, 2) if level else x)
            beside.append(x)
        for block, skipped in zip(self.up, beside[-2::-1], strict=True):
            x = block(torch.cat([functional.interpolate(x, scale_factor=2.0, mode="nearest"), skipped], 1))
        outputs: Tensor = self.unfold(x)
        return outputs


def lattice_features(leveled: LeveledSweep) -> F32:
    """Return ``FEATURES`` (7, n, n) float32 of a leveled sweep on the lattice of its ground, z of its level frame."""
    ground = leveled.ground
    nodes = lattice_nodes(ground.half_extent_m)
    out = np.empty((len(FEATURES), nodes, nodes), np.float32)
    _fill_features(leveled.points, leveled.sensor_height_m, ground.half_extent_m, out[:5])
    repeated = np.ones((nodes // len(ground.seen),) * 2)  # ground that is not seen at all has fewer nodes
    out[5], out[6] = np.kron(ground.seen, repeated), np.kron(ground.heights_m, repeated)
    return out


def inputs_of(features: Tensor, sensor_height_m: Tensor, half_extent_m: Tensor) -> Tensor:
    """Return inputs (B, CHANNELS, n, n) of the network.

    Args:
        features: (B, 7, n, n) of :func:`lattice_features`.
        sensor_height_m: (B,) above the ground below the sensor.
        half_extent_m: (B,) half the side of the lattice.
    """
    count, *heights, passing, shown, ground = features.unbind(1)
    seen, passed = (count > 0).float(), torch.isfinite(passing).float()
    above = [torch.where(seen > 0, z - ground, 0.0).clamp(-_MOST_M, _MOST_M) for z in heights]
    bound = torch.where(passed > 0, passing - ground, 0.0).clamp(-_MOST_M, _MOST_M)
    line = (torch.arange(count.shape[-1]) + 0.5) / count.shape[-1] * 2 - 1
    half_m = half_extent_m[:, None, None]
    range_m, node_m = torch.hypot(line[:, None], line[None]) * half_m, 2 * half_m / count.shape[-1]
    beside = [each.expand_as(count) for each in (range_m / 64.0, sensor_height_m[:, None, None] / 2.0, node_m)]
    return torch.stack([seen, *above, torch.log1p(count) / 3.0, bound, passed, shown, ground / 4.0, *beside], 1)


def loss_of(outputs: Tensor, ground_m: Tensor, half_extent_m: Tensor) -> Tensor:
    """Return the mean negative log-likelihood of heights (B, n, n) above the estimate, near nodes weighted more.

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


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_features(points: Any, sensor_m: Any, half_m: Any, out: Any) -> None:  # pragma: no cover - compiled
    nodes = out.shape[1]
    per_m = nodes / (2 * half_m)
    count, second, lowest, highest, passing = out[0], out[1], out[2], out[3], out[4]
    count[:], second[:], lowest[:], highest[:] = 0.0, np.inf, np.inf, -np.inf
    # 1. Returns by node; and by azimuth the least slope of those that end a node or more beyond a range.
    slopes = np.full((_BINS, _REACH_NODES + 1), np.inf, np.float32)
    for k in range(points.shape[0]):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        i, j = int(np.floor((x + half_m) * per_m)), int(np.floor((y + half_m) * per_m))
        if 0 <= i < nodes and 0 <= j < nodes:
            count[i, j] += 1
            second[i, j] = min(second[i, j], max(lowest[i, j], z))
            lowest[i, j], highest[i, j] = min(lowest[i, j], z), max(highest[i, j], z)
        range_m = np.sqrt(x * x + y * y)
        beyond = min(int(range_m * per_m) - 2, _REACH_NODES)
        if beyond >= 0:
            a = min(int((np.arctan2(y, x) / (2 * np.pi) + 0.5) * _BINS), _BINS - 1)
            slopes[a, beyond] = min(slopes[a, beyond], (z - sensor_m) / range_m)
    for a in range(_BINS):
        for b in range(_REACH_NODES - 1, -1, -1):
            slopes[a, b] = min(slopes[a, b], slopes[a, b + 1])
    # 2. The lowest beam over each node: of the azimuths that its middle spans.
    for i in range(nodes):
        for j in range(nodes):
            if count[i, j] == 1:
                second[i, j] = lowest[i, j]
            x, y = (i + 0.5) / per_m - half_m, (j + 0.5) / per_m - half_m
            range_m, least = np.sqrt(x * x + y * y), np.float32(np.inf)
            b = int(range_m * per_m)
            if b <= _REACH_NODES:
                middle, wide = np.arctan2(y, x), 0.35 / per_m / max(range_m, 0.5 / per_m)
                first = int(np.floor(((middle - wide) / (2 * np.pi) + 0.5) * _BINS))
                last = int(np.floor(((middle + wide) / (2 * np.pi) + 0.5) * _BINS))
                for a in range(first, last + 1):
                    least = min(least, slopes[a % _BINS, b])
            passing[i, j] = sensor_m + least * range_m
