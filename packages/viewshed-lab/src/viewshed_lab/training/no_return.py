"""A network that guesses how far beams without a return went: samples and the fit.

The samples are beams of simulated sweeps that did not return, with the exact range at which each was stopped. The
network mixes explanations: each stop that the core proposes
(:func:`viewshed.preprocess.no_return.no_return_groups`), something unseen at its own range, and nothing. It is fitted
by the likelihood of the exact ranges.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn import functional

from viewshed.arrays import F32, Mask
from viewshed.fov.visibility import CAR
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.preprocess.no_return import no_return_groups
from viewshed_lab.data.wild import WildObservation

LOG_NONE = 8.0
"""Logarithm (base 2) of the range of a stop that is not there."""

MOST_DEVIATIONS = 6.0

ARRAYS = ("mean", "scale", "first", "first_bias", "second", "second_bias", "third", "third_bias")
"""Of the network as the core has it."""

_MOST_ANGLE = np.deg2rad(1.0)
"""Groups whose next exact beam points elsewhere by more than this are left out."""


class Samples(NamedTuple):
    """G groups of beams without a return.

    Attributes:
        feature: (G, F) float32 of the core.
        stop: (G, S) float32 logarithms (base 2) of the ranges of stops; ``LOG_NONE`` for none.
        end: (G,) float32 logarithm of the exact range, ``LOG_NONE`` where nothing stopped the beam.
        beams: (G,) beams of each group.
    """

    feature: F32
    stop: F32
    end: F32
    beams: NDArray[np.int32]


def samples_of(
    seen: WildObservation, leveled: LeveledSweep, windows: NDArray[np.float64], cover_m: float | None
) -> Samples | None:
    """Return the groups of a sweep with their exact ends; None where its pixels are no beams.

    Args:
        seen: the sweep and all that the simulator knows of it.
        leveled: the sweep, less some returns.
        windows: (W, 4) in which the sensor was made blind, see :func:`within_windows`.
        cover_m: range at which something covers it there; None where its beams say nothing, and count as ended at once.
    """
    groups = no_return_groups(leveled, CAR.height_m)
    if groups is None:
        return None
    azimuth, slope, beams, feature, stop = groups.azimuth, groups.slope, groups.beams, groups.feature, groups.stop
    scan = seen.scan
    fired = np.ones(scan.depth_m.shape, np.bool_) if scan.model.fired is None else scan.model.fired
    turn = (leveled.level_from_sensor.rotation @ scan.world_from_sensor.rotation.T).astype(np.float32)
    direction = scan.direction[fired] @ turn.T
    # The next exact beam, and where that was stopped.
    own = np.stack([np.cos(azimuth), np.sin(azimuth), slope], axis=1)
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    apart, at = cKDTree(direction).query(own)
    depth_m = scan.depth_m[fired][at]
    stopped = np.isfinite(depth_m)
    place = scan.origin_m[fired][at] @ turn.T + direction[at] * np.where(stopped, depth_m, 0.0)[:, None]
    log_m = np.log2(np.maximum(np.hypot(place[:, 0], place[:, 1]), 0.5))
    end = np.where(stopped, np.minimum(log_m, LOG_NONE - 0.01), LOG_NONE).astype(np.float32)
    # Where the sensor was made blind, beams that would have returned end at once; where it is covered, all end there.
    back = own @ leveled.level_from_sensor.rotation
    inside = within_windows(np.arctan2(back[:, 1], back[:, 0]), np.arcsin(np.clip(back[:, 2], -1, 1)), windows)
    if cover_m is None:
        end[inside & stopped] = -1.0
    else:
        end[inside] = np.minimum(end[inside], np.float32(np.log2(cover_m)))
    keep = (beams > 0) & (apart < _MOST_ANGLE)
    return Samples(feature[keep], stop[keep], end[keep], beams[keep])


def within_windows(azimuth: NDArray[np.float64], elevation: NDArray[np.float64], windows: NDArray[np.float64]) -> Mask:
    """Return which directions (N,) lie in one of the windows (W, 4): azimuth, elevation, half of its size in both."""
    inside = np.zeros(len(azimuth), np.bool_)
    for middle, high, wide, tall in windows:
        off = np.abs((azimuth - middle + np.pi) % (2 * np.pi) - np.pi)
        inside |= (off <= wide) & (np.abs(elevation - high) <= tall)
    return inside


class NoReturnNet(nn.Module):
    """Three layers on standardized features (B, F); outputs (B, S + 4) are those of the core.

    Args:
        mean: (F,) of the features.
        scale: (F,) one over their deviation.
        stops: how many the core proposes.
        units: of the hidden layers.
    """

    mean: Tensor
    scale: Tensor

    def __init__(self, mean: Tensor, scale: Tensor, stops: int, units: int = 48) -> None:
        super().__init__()
        self.register_buffer("mean", mean)
        self.register_buffer("scale", scale)
        self.stops = stops
        self.layers = nn.Sequential(
            nn.Linear(len(mean), units), nn.ReLU(), nn.Linear(units, units), nn.ReLU(), nn.Linear(units, stops + 4)
        )
        self.log_spread = nn.Parameter(torch.full((stops,), -2.0))

    def forward(self, feature: Tensor) -> Tensor:
        """Return outputs (B, S + 4) for features (B, F)."""
        inputs = ((feature - self.mean) * self.scale).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)
        outputs: Tensor = self.layers(inputs)
        return outputs

    def arrays(self) -> dict[str, F32]:
        """Return the arrays of the core's network."""
        linear = [layer for layer in self.layers if isinstance(layer, nn.Linear)]
        flat: list[Tensor] = [self.mean, self.scale]
        for layer in linear:
            flat += [layer.weight.T, layer.bias]
        return {
            name: np.ascontiguousarray(value.detach().numpy(), np.float32)
            for name, value in zip(ARRAYS, flat, strict=True)
        }


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """Where beams may have ended, (B, S + 1) log probabilities, centers and mean deviations; and of no end (B,)."""

    log_share: Tensor
    center: Tensor
    spread: Tensor
    log_free: Tensor

    @classmethod
    def of(cls, net: NoReturnNet, feature: Tensor, stop: Tensor) -> Mixture:
        """Return the mixture of features (B, F) and stops (B, S)."""
        outputs, count = net(feature), net.stops
        there = stop < LOG_NONE
        logits = torch.cat([outputs[:, :count].masked_fill(~there, -30.0), outputs[:, count : count + 2]], 1)
        log_share = functional.log_softmax(logits, 1)
        center = torch.cat([stop, outputs[:, count + 2 : count + 3]], 1)
        unseen = torch.exp(outputs[:, count + 3 :].clamp(-3.0, 1.5))
        spread = torch.cat([torch.exp(net.log_spread.clamp(-5.0, 0.0)).expand_as(stop), unseen], 1)
        # The order of the core: stops, free, unseen.
        share = torch.cat([log_share[:, :count], log_share[:, count + 1 :]], 1)
        return cls(share, center, spread, log_share[:, count])

    def log_likelihood(self, end: Tensor) -> Tensor:
        """Return the logarithm (B,) of the density of ends (B,), or of the probability of none."""
        deviation = (end[:, None] - self.center).abs() / self.spread
        density = torch.logsumexp(self.log_share - torch.log(2 * self.spread) - deviation, 1)
        return torch.where(end >= LOG_NONE, self.log_free, density)

    def survival(self, log_m: Tensor) -> Tensor:
        """Return the probability (B, K) that beams went beyond ranges (K,)."""
        u = (log_m[None, :, None] - self.center[:, None]) / self.spread[:, None]
        tail = 0.5 * torch.exp(-u.abs())
        beyond = torch.where(u < 0, 1 - tail, tail)
        return (torch.exp(self.log_share)[:, None] * beyond).sum(2) + torch.exp(self.log_free)[:, None]


def source_of(arrays: Mapping[str, F32]) -> str:
    """Return the numbers of a network as C++, which is compiled into the core."""
    rows = []
    for name, array in arrays.items():
        numbers = [f"{value:.9g}" for value in array.ravel().tolist()]
        numbers = [word if set(word) & set(".en") else f"{word}.0" for word in numbers]
        lines = [", ".join(f"{word}f" for word in numbers[k : k + 12]) for k in range(0, len(numbers), 12)]
        rows.append(f"static const float {name.upper()}[] = {{\n" + ",\n".join(lines) + "};\n")
    return "".join(rows)


def arrays_of(source: str) -> dict[str, F32]:
    """Return the network that :func:`source_of` wrote."""
    found = re.findall(r"float (\w+)\[\] = \{([^}]*)\}", source)
    arrays = {name.lower(): np.array(numbers.replace("f", "").split(","), np.float32) for name, numbers in found}
    for layer in ("first", "second", "third")[: len(arrays) // 2 - 1]:
        arrays[layer] = arrays[layer].reshape(-1, len(arrays[f"{layer}_bias"]))
    return arrays
