"""Small networks for tests: some with random weights, and one with a known output."""

import numpy as np
import torch

from viewshed.grid import BevGrid
from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import NetworkCard
from viewshed_lab.training.unet_torch import Stage, UNet

SMALL = UNetShape(4, 2, 0.3)
GRID = BevGrid(32, 16.0)


def card(shape: UNetShape = SMALL, grid: BevGrid = GRID, threshold: float = 0.5) -> NetworkCard:
    """Return a card as training writes it."""
    return NetworkCard("made", shape, grid, max_range_m=100.0, threshold=threshold, trained={"seed": "3"})


def drawn(shape: UNetShape = SMALL, seed: int = 3) -> UNet:
    """Return a network with random weights and random, nontrivial batch normalization statistics."""
    generator = torch.Generator().manual_seed(seed)
    module = UNet(shape)
    for name, value in module.state_dict().items():
        if value.is_floating_point():
            noise = torch.randn(value.shape, generator=generator)
            if value.ndim == 4:
                value.copy_(noise * (2.0 / value[0].numel()) ** 0.5)
            else:
                value.copy_(1.0 + 0.3 * noise.abs() if "var" in name or "weight" in name else 0.3 * noise)
    with torch.no_grad():
        module.encoder[0].get_parameter("conv1.weight").mul_(300.0)
        module.head.weight.mul_(0.3)
    return module.eval()


def nearby(shape: UNetShape = SMALL) -> UNet:
    """Return a network that calls visible all cells within four of a return, with a small deviation under dropout."""
    module = drawn(shape)
    first, last = module.encoder[0], module.decoder[-1]
    assert isinstance(first, Stage)
    assert isinstance(last, Stage)
    with torch.no_grad():
        for stage in (first, last):
            for norm in (stage.norm1, stage.norm2):
                norm.reset_running_stats()
                norm.weight.fill_(1.0)
                norm.bias.zero_()
        for conv, inner in ((first.conv1, 0), (first.conv2, 0), (last.conv1, shape.width), (last.conv2, 0)):
            conv.weight[0].zero_()
            conv.weight[0, inner] = 1.0
        first.conv1.weight[0] *= 1000.0
        module.head.weight.zero_()
        module.head.weight[0, 0] = 20.0
        module.head.weight[0, 1] = 0.02
        module.head.get_parameter("bias").fill_(-5.0)
    return module


def inputs(count: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Return random input counts (count, 1, cells, cells), divided by 1000."""
    return (np.random.default_rng(5).poisson(0.4, (count, 1, *GRID.shape)) / 1000).astype(np.float32)
