"""Fit a network that predicts the ground without returns: samples, model and loss.

A sample is what a simulated sweep shows in polar bins around the sensor (``core/unseen_ground.hpp``), with the exact
height of the ground in each. The network is a U-Net on these bins, azimuths wrapping around, and states three quantiles
of the height. Heights are relative to a base surface, averages of the seen heights, in units that grow with range; the
core computes base and units in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from viewshed import _core
from viewshed.arrays import F32
from viewshed.geometry import Rigid
from viewshed.preprocess.leveling import LeveledSweep
from viewshed_lab.sim.terrain import Terrain

AZIMUTHS, RANGES, BINS_OF_OCTAVE, NEAREST_M = 128, 96, 16, 1.5
RETURNS, LOWEST, SECOND_LOWEST, HIGHEST, SEEN, SEEN_HEIGHT, PASSING, AIMED = range(8)
"""Maps of a sweep, as the core orders them."""

HEIGHTS = (LOWEST, SECOND_LOWEST, HIGHEST, SEEN_HEIGHT, PASSING)
CHANNELS, FOLD, MAX_UNITS = 13, 2, 6.0

PROBABILITIES = (0.15, 0.5, 0.85)
"""Of the quantiles: the middles of the shares .3, .4 and .3, over which visibility is averaged."""

MODES = 5
"""Outputs that describe two modes, followed by the quantiles."""

MAX_TARGET = 12.0
"""Limit of the exact height in units: what lies farther off weighs no more."""

HELD_STD_M = 0.05
"""Standard deviation of the heights that earlier sweeps saw, of all together and of each."""

RANGE_M = NEAREST_M * 2.0 ** ((np.arange(RANGES, dtype=np.float32) + 0.5) / BINS_OF_OCTAVE)
AZIMUTH = ((np.arange(AZIMUTHS) + 0.5) * 2 * np.pi / AZIMUTHS - np.pi).astype(np.float32)
_UNIT_M = torch.tensor(0.25 + 0.04 * RANGE_M)


class Samples(NamedTuple):
    """B sweeps.

    Attributes:
        maps: (B, 8, azimuths, ranges) what they show, heights in meters.
        ground_m: (B, azimuths, ranges) exact height of the ground; NaN where unknown.
        height_m: (B,) height of the sensor.
    """

    maps: Tensor
    ground_m: Tensor
    height_m: Tensor


def maps_of(leveled: LeveledSweep) -> F32:
    """Return the maps (8, azimuths, ranges) of a sweep."""
    ground = leveled.ground
    return _core.map_returns(
        leveled.points, leveled.azimuth, leveled.range_m, leveled.sensor_height_m, ground.heights_m, ground.seen,
        ground.half_extent_m,
    )  # fmt: skip


def exact_ground(leveled: LeveledSweep, world_from_sensor: Rigid, terrain: Terrain) -> F32:
    """Return z (azimuths, ranges) of the exact ground in the estimated level frame; NaN where it is unknown.

    An error of the estimated attitude turns both alike: ground that follows the returns is right.
    """
    world_from_level = world_from_sensor @ leveled.level_from_sensor.inverse()
    points = np.zeros((AZIMUTHS, RANGES, 3))
    points[..., 0], points[..., 1] = np.cos(AZIMUTH)[:, None] * RANGE_M, np.sin(AZIMUTH)[:, None] * RANGE_M
    # Newton's method along z of the level frame, which is not quite upright.
    for _ in range(5):
        there = world_from_level @ points
        points[..., 2] += (terrain.at(there) - there[..., 2]) / world_from_level.rotation[2, 2]
    z = points[..., 2].astype(np.float32)
    for axis, lines in ((0, terrain.x_m), (1, terrain.y_m)):
        z[(there[..., axis] < lines[0]) | (there[..., axis] > lines[-1])] = np.nan
    z[np.abs(z) > 40.0] = np.nan
    return z


def augmented(samples: Samples, rng: np.random.Generator) -> Samples:
    """Return samples turned, mirrored, scaled and sloped at random, each in its own way; in some, more ground is seen.

    Turns, scales and slopes keep lines straight, so that the beams remain beams. What earlier sweeps of a stream saw is
    seen ground without returns.
    """
    rows = [_augmented(*row, rng) for row in zip(*samples, strict=True)]
    return Samples(*(torch.stack(column) for column in zip(*rows, strict=True)))


def _augmented(
    maps: Tensor, ground_m: Tensor, height_m: Tensor, rng: np.random.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    turn = int(rng.integers(AZIMUTHS))
    maps, ground_m = maps.roll(turn, 1), ground_m.roll(turn, 0)
    if rng.random() < 0.5:
        maps, ground_m = maps.flip(1), ground_m.flip(0)
    heights = list(HEIGHTS)
    if rng.random() < 0.6:  # everything is larger or smaller: bins of range move
        bins = int(np.clip(np.round(rng.normal(0, 5)), -14, 14))
        scale = 2.0 ** (bins / BINS_OF_OCTAVE)
        kept, moved = slice(max(-bins, 0), RANGES - max(bins, 0)), slice(max(bins, 0), RANGES - max(-bins, 0))
        wide, exact = torch.zeros_like(maps), torch.full_like(ground_m, torch.nan)
        wide[PASSING] = torch.inf
        wide[..., moved], exact[..., moved] = maps[..., kept], ground_m[..., kept] * scale
        maps, ground_m, height_m = wide, exact, height_m * scale
        maps[heights] *= scale
    if rng.random() < 0.5:  # heights alone
        scale = float(np.exp(rng.normal(0, 0.2)))
        maps, ground_m, height_m = maps.clone(), ground_m * scale, height_m * scale
        maps[heights] *= scale
    if rng.random() < 0.5:  # a slope
        along, across = rng.normal(0, 0.03, 2)
        rise_m = torch.tensor(np.outer(along * np.cos(AZIMUTH) + across * np.sin(AZIMUTH), RANGE_M).astype(np.float32))
        maps, ground_m = maps.clone(), ground_m + rise_m
        maps[[LOWEST, SECOND_LOWEST, HIGHEST]] += rise_m * (maps[RETURNS] > 0)
        maps[SEEN_HEIGHT] += rise_m * maps[SEEN]
        maps[PASSING] += rise_m
    if rng.random() < 0.4:  # earlier sweeps saw some of the ground
        maps, shown = maps.clone(), _patches(rng) & torch.isfinite(ground_m) & (maps[SEEN] == 0)
        off_m = rng.normal(0, HELD_STD_M) + rng.normal(0, HELD_STD_M, (AZIMUTHS, RANGES))
        maps[SEEN_HEIGHT] = torch.where(shown, ground_m + torch.tensor(off_m.astype(np.float32)), maps[SEEN_HEIGHT])
        maps[SEEN] += shown
    return maps, ground_m, height_m


def _patches(rng: np.random.Generator) -> Tensor:
    """Return random patches (azimuths, ranges), bool, which cover any share of the bins."""
    coarse = torch.tensor(rng.normal(size=(1, 1, 2 ** rng.integers(2, 6), 2 ** rng.integers(1, 6))).astype(np.float32))
    smooth = functional.interpolate(coarse, (AZIMUTHS, RANGES), mode="bilinear")[0, 0]
    return smooth > float(np.quantile(coarse.numpy(), rng.random()))


def base_of(seen: Tensor, height_m: Tensor) -> Tensor:
    """Return the base surface (B, azimuths, ranges): seen heights, and averages over ever coarser bins between them."""
    levels = [((seen * height_m)[:, None], seen[:, None])]
    while levels[-1][0].shape[2:] != (1, 1):
        z, weight = levels[-1]
        rows, columns = z.shape[2:]
        cells = (2 if rows % 2 == 0 else 1, 2 if columns % 2 == 0 else (3 if columns % 3 == 0 else 1))
        count = cells[0] * cells[1]
        total = functional.avg_pool2d(weight, cells) * count
        mean = functional.avg_pool2d(z * weight, cells) * count / total.clamp_min(1e-6)
        levels.append((torch.where(total > 0, mean, 0.0), total.clamp_max(1.0)))
    coarse = levels[-1][0]
    for z, weight in levels[-2::-1]:
        rows, columns = z.shape[2:]
        finer = rows // coarse.shape[2]
        # Bilinear; azimuths wrap around.
        wide = functional.pad(coarse, (0, 0, 1, 1), mode="circular")
        size = [wide.shape[2] * finer, columns]
        between = functional.interpolate(wide, size=size, mode="bilinear", align_corners=False)[:, :, finer:-finer]
        coarse = weight * z + (1 - weight) * between
    return coarse[:, 0]


def inputs_of(samples: Samples) -> tuple[Tensor, Tensor]:
    """Return the inputs of the network (B, CHANNELS, azimuths, ranges) and the base (B, azimuths, ranges) in meters."""
    count, lowest, second, highest, seen, seen_m, passing, aimed = samples.maps.unbind(1)
    base = base_of(seen, seen_m)
    has, passes = (count > 0).float(), torch.isfinite(passing).float()
    height_m = samples.height_m[:, None, None].expand_as(base)

    def units(z_m: Tensor) -> Tensor:
        return ((z_m - base) / _UNIT_M).clamp(-MAX_UNITS, MAX_UNITS)

    log_range = torch.tensor(np.log(RANGE_M)).expand_as(base)
    inputs = [
        has, torch.log1p(count) / 3, has * units(lowest), has * units(second), has * units(highest), seen,
        units(passing), passes, torch.log1p(aimed) / 2, (base / _UNIT_M).clamp(-MAX_UNITS, MAX_UNITS), units(height_m),
        torch.log(height_m / 1.8), 0.5 * log_range - 1.2,
    ]  # fmt: skip
    return torch.stack(inputs, 1), base


class _Convolution(nn.Module):
    """A convolution of 3 × 3 pixels, azimuths wrapping around and edge ranges repeated, normalization, max(0, x)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.convolution, self.norm = nn.Conv2d(inputs, outputs, 3, bias=False), nn.BatchNorm2d(outputs)

    def forward(self, image: Tensor) -> Tensor:
        wide = functional.pad(functional.pad(image, (0, 0, 1, 1), mode="circular"), (1, 1, 0, 0), mode="replicate")
        return torch.relu(self.norm(self.convolution(wide)))


class GroundNet(nn.Module):
    """The network of the core: inputs (B, CHANNELS, azimuths, ranges), outputs (B, MODES + 3, azimuths, ranges).

    The modes are for the fit alone: the core has the quantiles.

    Args:
        widths: channels of each level, the finest first.
    """

    def __init__(self, widths: Sequence[int] = (16, 24, 32, 48)) -> None:
        super().__init__()
        self.fold, self.first = nn.PixelUnshuffle(FOLD), nn.Conv2d(CHANNELS * FOLD**2, widths[0], 1, bias=False)
        self.norm = nn.BatchNorm2d(widths[0])
        self.down = nn.ModuleList(
            nn.Sequential(_Convolution(a, b), _Convolution(b, b))
            for a, b in zip((widths[0], *widths[:-1]), widths, strict=True)
        )
        self.up = nn.ModuleList(
            nn.Sequential(_Convolution(a + b, b), _Convolution(b, b))
            for a, b in zip(widths[:0:-1], widths[-2::-1], strict=True)
        )
        self.last = nn.Conv2d(widths[0], (MODES + len(PROBABILITIES)) * FOLD**2, 1)
        nn.init.normal_(self.last.weight, std=0.01)  # begins with the base

    def forward(self, inputs: Tensor) -> Tensor:
        """Return outputs for inputs."""
        image, beside = torch.relu(self.norm(self.first(self.fold(inputs)))), []
        for level, block in enumerate(self.down):
            image = block(functional.max_pool2d(image, 2) if level else image)
            beside.append(image)
        for block, skipped in zip(self.up, beside[-2::-1], strict=True):
            image = block(torch.cat([functional.interpolate(image, scale_factor=2.0, mode="nearest"), skipped], 1))
        outputs: Tensor = functional.pixel_shuffle(self.last(image), FOLD)
        return outputs

    def convolutions(self) -> list[tuple[Tensor, Tensor]]:
        """Return weights (outputs, inputs, size, size) and biases (outputs,) of the core's layers, in order."""
        layers = [_normalized(self.first, self.norm)]
        layers += [_normalized(layer.convolution, layer.norm) for block in (*self.down, *self.up) for layer in block]
        assert self.last.bias is not None
        kept = slice(MODES * FOLD**2, None)
        return [*layers, (self.last.weight.detach()[kept], self.last.bias.detach()[kept])]


def _normalized(convolution: nn.Conv2d, norm: nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """Return weights and bias of a convolution followed by its normalization."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    weight = convolution.weight * scale[:, None, None, None]
    return weight.detach(), (norm.bias - norm.running_mean * scale).detach()


def quantiles_of(outputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the quantiles (B, azimuths, ranges) of outputs (B, MODES + 3, …), in units above the base."""
    median, below, above = outputs[:, MODES:].unbind(1)
    return median - functional.softplus(below - 1.0), median, median + functional.softplus(above - 1.0)


def log_density(outputs: Tensor, units: Tensor) -> Tensor:
    """Return the log density of heights (B, azimuths, ranges): a mixture of two Laplace distributions, one lower.

    The ground goes on, or falls away.
    """
    upper, apart, log_upper, log_lower, logit = outputs[:, :MODES].unbind(1)
    lower = upper - functional.softplus(apart + 0.5)
    log_upper, log_lower, logit = log_upper.clamp(-6, 3) - 1.5, log_lower.clamp(-6, 3) - 0.5, logit - 1.0
    goes_on = functional.logsigmoid(-logit) - log_upper - (units - upper).abs() * torch.exp(-log_upper)
    falls = functional.logsigmoid(logit) - log_lower - (units - lower).abs() * torch.exp(-log_lower)
    density: Tensor = torch.logaddexp(goes_on, falls) - np.log(2.0)
    return density


def loss_of(outputs: Tensor, samples: Samples, base: Tensor) -> Tensor:
    """Return the weighted mean of the quantile loss minus the log density of the two modes.

    The density makes small errors count where the ground is nearly certain; without it, F1 on unseen roads was lower.
    Bins weigh as their width times 1 / (1 + range / 30 m), those over which no beam passes a fifth, seen ones hardly:
    their heights are kept.
    """
    known = torch.isfinite(samples.ground_m)
    units = torch.where(known, (samples.ground_m - base) / _UNIT_M, 0.0).clamp(-MAX_TARGET, MAX_TARGET)
    range_m = torch.tensor(RANGE_M)
    weight = known * (range_m / (1 + range_m / 30.0))
    weight = weight * torch.where(samples.maps[:, SEEN] > 0, 0.05, 1.0)
    weight = weight * torch.where(torch.isfinite(samples.maps[:, PASSING]), 1.0, 0.2)
    loss = -log_density(outputs, units)
    for probability, quantile in zip(PROBABILITIES, quantiles_of(outputs), strict=True):
        off = units - quantile
        loss = loss + torch.maximum(probability * off, (probability - 1.0) * off)
    return (weight * loss).sum() / weight.sum()


def source_of_network(layers: Sequence[tuple[Tensor, Tensor]]) -> str:
    """Return the convolutions of a network as C++ source: weights as bytes, with a scale for each output."""
    source, table = [], []
    for number, (weight, bias) in enumerate(layers):
        outputs, inputs, size, _ = weight.shape
        scale = weight.abs().amax((1, 2, 3)).clamp_min(1e-12) / 127
        rounded = torch.round(weight / scale[:, None, None, None]).to(torch.int32).permute(2, 3, 1, 0).reshape(-1)
        literals = [str(value) for value in rounded.tolist()]
        rows = ",\n".join(", ".join(literals[k : k + 32]) for k in range(0, len(literals), 32))
        source.append(f"static const std::int8_t WEIGHT_{number}[] = {{\n{rows}}};\n")
        for name, values in (("SCALE", scale), ("BIAS", bias)):
            numbers = ", ".join(f"{value:.7e}f" for value in values.tolist())
            source.append(f"static const float {name}_{number}[] = {{{numbers}}};\n")
        table.append(f"    {{{size}, {inputs}, {outputs}, WEIGHT_{number}, SCALE_{number}, BIAS_{number}}},\n")
    return "".join([*source, "static const std::vector<Convolution> GROUND_NETWORK = {\n", *table, "};\n"])
