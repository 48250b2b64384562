"""Networks of random weights, for measurements of time."""

from __future__ import annotations

from pathlib import Path

from viewshed.grid import BevGrid
from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import NetworkCard

PUBLISHED = UNetShape(8, 4)
"""Shape of the paper's network."""

_SEED = 11


def draw_weights(path: Path, shape: UNetShape = PUBLISHED, cells: int = 256) -> None:
    """Write a network of random weights on the grid of ``road``, in ``cells`` cells a side."""
    import torch

    from viewshed_lab.training.onnx_export import export_onnx
    from viewshed_lab.training.unet_torch import UNet

    torch.manual_seed(_SEED)
    export_onnx(path, NetworkCard("drawn", shape, BevGrid(cells)), UNet(shape).eval())
