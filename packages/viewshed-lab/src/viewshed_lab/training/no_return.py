"""Fit a network that estimates how far beams without a return went: samples and model.

Samples are no-return beams of simulated sweeps, with the exact range at which each was stopped. The network is a
mixture of explanations: each stop that the core proposes
(:func:`viewshed.preprocess.no_return.no_return_groups`), an unseen object at a range of its own, and free space. It is
fitted by maximum likelihood of the exact ranges.
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
"""Logarithm (base 2) of the range that stands for no stop."""

MAX_DEVIATIONS = 6.0
"""Standardized features are clipped to ± this."""

ARRAYS = ("mean", "scale", "first", "first_bias", "second", "second_bias", "third", "third_bias")
"""Names of the network's arrays in the core."""

_MAX_ANGLE = np.deg2rad(1.0)
"""Groups whose nearest exact beam differs in direction by more than this are left out."""


class Samples(NamedTuple):
    """G groups of no-return beams.

    Attributes:
        feature: (G, F) float32 features of the core.
        stop: (G, S) float32 log2 of the stops' ranges; ``LOG_NONE`` for no stop.
        end: (G,) float32 log2 of the exact range; ``LOG_NONE`` where nothing stopped the beam.
        beams: (G,) int32 number of beams of each group.
    """

    feature: F32
    stop: F32
    end: F32
    beams: NDArray[np.int32]


def samples_of(
    seen: WildObservation, leveled: LeveledSweep, windows: NDArray[np.float64], cover_m: float | None
) -> Samples | None:
    """Return the groups of a sweep with their exact ends, or None if pixels of its range image are not beams.

    Args:
        seen: the sweep and the simulator's truth.
        leveled: the sweep, with some returns removed.
        windows: (W, 4) directions in which the sensor was blinded, see :func:`within_windows`.
        cover_m: range of a cover in these windows; None blinds the sensor, and its beams there count as ended at once.
    """
    groups = no_return_groups(leveled, CAR.height_m)
    if groups is None:
        return None
    azimuth, slope, beams, feature, stop = groups.azimuth, groups.slope, groups.beams, groups.feature, groups.stop
    scan = seen.scan
    fired = np.ones(scan.depth_m.shape, np.bool_) if scan.model.fired is None else scan.model.fired
    turn = (leveled.level_from_sensor.rotation @ scan.world_from_sensor.rotation.T).astype(np.float32)
    direction = scan.direction[fired] @ turn.T
    # Find the nearest exact beam of each group, and where it was stopped.
    group_direction = np.stack([np.cos(azimuth), np.sin(azimuth), slope], axis=1)
    group_direction /= np.linalg.norm(group_direction, axis=1, keepdims=True)
    difference, at = cKDTree(direction).query(group_direction)
    depth_m = scan.depth_m[fired][at]
    stopped = np.isfinite(depth_m)
    stop_m = scan.origin_m[fired][at] @ turn.T + direction[at] * np.where(stopped, depth_m, 0.0)[:, None]
    log_m = np.log2(np.maximum(np.hypot(stop_m[:, 0], stop_m[:, 1]), 0.5))
    end = np.where(stopped, np.minimum(log_m, LOG_NONE - 0.01), LOG_NONE).astype(np.float32)
    # In windows: where the sensor was blinded, beams that would have returned end at once; at a cover all beams end.
    raw = group_direction @ leveled.level_from_sensor.rotation
    inside = within_windows(np.arctan2(raw[:, 1], raw[:, 0]), np.arcsin(np.clip(raw[:, 2], -1, 1)), windows)
    if cover_m is None:
        end[inside & stopped] = -1.0
    else:
        end[inside] = np.minimum(end[inside], np.float32(np.log2(cover_m)))
    keep = (beams > 0) & (difference < _MAX_ANGLE)
    return Samples(feature[keep], stop[keep], end[keep], beams[keep])


def within_windows(azimuth: NDArray[np.float64], elevation: NDArray[np.float64], windows: NDArray[np.float64]) -> Mask:
    """Return which directions (N,) lie in a window; windows (W, 4) are center azimuth and elevation, and half sizes."""
    inside = np.zeros(len(azimuth), np.bool_)
    for center_azimuth, center_elevation, half_width, half_height in windows:
        difference = np.abs((azimuth - center_azimuth + np.pi) % (2 * np.pi) - np.pi)
        inside |= (difference <= half_width) & (np.abs(elevation - center_elevation) <= half_height)
    return inside


class NoReturnNet(nn.Module):
    """Three layers on standardized features (B, F); outputs (B, S + 4) in the order of the core.

    Args:
        mean: (F,) mean of the features.
        scale: (F,) inverse of their standard deviation.
        stops: S, the number of stops that the core proposes.
        units: number of units of each hidden layer.
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
        inputs = ((feature - self.mean) * self.scale).clamp(-MAX_DEVIATIONS, MAX_DEVIATIONS)
        outputs: Tensor = self.layers(inputs)
        return outputs

    def arrays(self) -> dict[str, F32]:
        """Return the weights as the arrays of the core's network, by name."""
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
    """Laplace mixture over the log2 ranges at which B beams ended: S stops and one unseen object, or free space."""

    log_share: Tensor  # (B, S + 1) log probability of each component
    center: Tensor  # (B, S + 1) log2 of its range
    spread: Tensor  # (B, S + 1) mean absolute deviation
    log_free: Tensor  # (B,) log probability that nothing stopped the beam

    @classmethod
    def of(cls, net: NoReturnNet, feature: Tensor, stop: Tensor) -> Mixture:
        """Return the mixture that ``net`` gives for features (B, F) and stops (B, S)."""
        outputs, count = net(feature), net.stops
        exists = stop < LOG_NONE
        logits = torch.cat([outputs[:, :count].masked_fill(~exists, -30.0), outputs[:, count : count + 2]], 1)
        log_share = functional.log_softmax(logits, 1)
        center = torch.cat([stop, outputs[:, count + 2 : count + 3]], 1)
        unseen = torch.exp(outputs[:, count + 3 :].clamp(-3.0, 1.5))
        spread = torch.cat([torch.exp(net.log_spread.clamp(-5.0, 0.0)).expand_as(stop), unseen], 1)
        # The core's order is stops, free, unseen.
        share = torch.cat([log_share[:, :count], log_share[:, count + 1 :]], 1)
        return cls(share, center, spread, log_share[:, count])

    def log_likelihood(self, end: Tensor) -> Tensor:
        """Return the log density (B,) of ends (B,), or the log probability of free space where there is no end."""
        deviation = (end[:, None] - self.center).abs() / self.spread
        density = torch.logsumexp(self.log_share - torch.log(2 * self.spread) - deviation, 1)
        return torch.where(end >= LOG_NONE, self.log_free, density)

    def survival(self, log_m: Tensor) -> Tensor:
        """Return the probability (B, K) that beams went beyond log2 ranges (K,)."""
        u = (log_m[None, :, None] - self.center[:, None]) / self.spread[:, None]
        tail = 0.5 * torch.exp(-u.abs())
        beyond = torch.where(u < 0, 1 - tail, tail)
        return (torch.exp(self.log_share)[:, None] * beyond).sum(2) + torch.exp(self.log_free)[:, None]


def source_of(arrays: Mapping[str, F32]) -> str:
    """Return the arrays of a network as C++ source, which is compiled into the core."""
    rows = []
    for name, array in arrays.items():
        numbers = [f"{value:.9g}" for value in array.ravel().tolist()]
        numbers = [literal if set(literal) & set(".en") else f"{literal}.0" for literal in numbers]
        lines = [", ".join(f"{literal}f" for literal in numbers[k : k + 12]) for k in range(0, len(numbers), 12)]
        rows.append(f"static const float {name.upper()}[] = {{\n" + ",\n".join(lines) + "};\n")
    return "".join(rows)


def arrays_of(source: str) -> dict[str, F32]:
    """Return the arrays that :func:`source_of` wrote."""
    matches = re.findall(r"float (\w+)\[\] = \{([^}]*)\}", source)
    arrays = {name.lower(): np.array(numbers.replace("f", "").split(","), np.float32) for name, numbers in matches}
    for layer in ("first", "second", "third")[: len(arrays) // 2 - 1]:
        arrays[layer] = arrays[layer].reshape(-1, len(arrays[f"{layer}_bias"]))
    return arrays
