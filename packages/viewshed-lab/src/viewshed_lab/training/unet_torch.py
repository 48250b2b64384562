"""The U-Net of arXiv 2503.07375 in torch. Dropout masks are an input, so one network serves MLE and MCD."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from viewshed._files import write_atomic
from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import NetworkCard


class Stage(nn.Module):
    """Two blocks of 3 × 3 convolution, batch normalization and ReLU."""

    def __init__(self, inner: int, outer: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inner, outer, 3, padding=1, bias=False)
        self.norm1 = nn.BatchNorm2d(outer)
        self.conv2 = nn.Conv2d(outer, outer, 3, padding=1, bias=False)
        self.norm2 = nn.BatchNorm2d(outer)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, inner, H, W) to (N, outer, H, W)."""
        x = torch.relu(self.norm1(self.conv1(x)))
        return torch.relu(self.norm2(self.conv2(x)))


class UNet(nn.Module):
    """Encoder, bottleneck and decoder with skips; masks multiply the channels after the stages with dropout.

    ``forward(inputs (N, 1, H, W), masks (N, M))`` returns logits (N, 1, H, W); masks of ones mean no dropout.
    """

    def __init__(self, shape: UNetShape) -> None:
        super().__init__()
        self.shape = shape
        inner = (1, *shape.widths[:-1])
        self.encoder = nn.ModuleList(Stage(a, b) for a, b in zip(inner, shape.widths, strict=True))
        self.up = nn.ModuleList(nn.ConvTranspose2d(2 * w, w, 2, stride=2) for w in shape.widths[-2::-1])
        self.decoder = nn.ModuleList(Stage(2 * w, w) for w in shape.widths[-2::-1])
        self.head = nn.Conv2d(shape.width, 1, 1)

    def forward(self, inputs: Tensor, masks: Tensor) -> Tensor:
        """Return logits (N, 1, H, W)."""
        parts = torch.split(masks[:, :, None, None], list(self.shape.masked_channels), dim=1)
        skips: list[Tensor] = []
        x = inputs
        for i, stage in enumerate(self.encoder):
            x = stage(x if i == 0 else torch.max_pool2d(x, 2))
            x = x if i == 0 else x * parts[i - 1]
            skips.append(x)
        skips.pop()
        for i, (up, stage) in enumerate(zip(self.up, self.decoder, strict=True)):
            x = stage(torch.cat([up(x), skips.pop()], dim=1))
            x = x * parts[self.shape.depth + i] if i < self.shape.depth - 1 else x
        logits: Tensor = self.head(x)
        return logits


class TorchRunner:
    """Runs a :class:`UNet` in evaluation mode, with fixed statistics of batch normalization."""

    def __init__(self, card: NetworkCard, module: UNet, device: str | torch.device = "cpu") -> None:
        if module.shape != card.shape:
            raise ValueError(f"module must have the card's shape {card.shape}, got {module.shape}")
        self.card = card
        self._module, self._device = module.to(device), torch.device(device)

    def single_threaded(self) -> None:
        """Do nothing: torch shares its threads among all runs."""
        return

    def run(self, inputs: NDArray[np.float32], masks: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return probabilities (N, cells, cells); see :class:`viewshed.networks.card.Runner`."""
        with self._evaluating():
            x, m = self._tensor(inputs), self._tensor(self.card.shape.no_masks(len(inputs)) if masks is None else masks)
            x = x.expand(len(m), *x.shape[1:]) if len(x) == 1 else x
            prob: NDArray[np.float32] = torch.sigmoid(self._module(x, m))[:, 0].float().cpu().numpy()
            return prob

    @contextlib.contextmanager
    def _evaluating(self) -> Iterator[None]:
        training = self._module.training
        self._module.eval()
        try:
            with torch.inference_mode():
                yield
        finally:
            self._module.train(training)

    def _tensor(self, array: NDArray[np.float32]) -> Tensor:
        return torch.from_numpy(np.array(array, np.float32)).to(self._device)


def save_weights(path: str | Path, card: NetworkCard, module: UNet) -> None:
    """Write the card and the weights of ``module`` to a new file, atomically."""
    buffer = io.BytesIO()
    state = {name: value.detach().cpu() for name, value in module.state_dict().items()}
    torch.save({"card": card.to_json(), "state": state}, buffer)
    write_atomic(path, buffer.getvalue())


def load_weights(path: str | Path) -> tuple[NetworkCard, UNet]:
    """Return the card and the network that :func:`save_weights` wrote, in evaluation mode, on the CPU.

    Raises:
        ValueError: the file is damaged, no checkpoint of viewshed, or of another version.
    """
    content = _content(Path(path))
    card = NetworkCard.from_json(content["card"])
    module = UNet(card.shape)
    try:
        # Older files may hold a second head, which is ignored.
        state = {name: value for name, value in content["state"].items() if not name.startswith("doubt.")}
        module.load_state_dict(state)
    except (RuntimeError, AttributeError) as error:
        first = " ".join(str(error).split())[:120]
        raise ValueError(f"{path} must hold the weights of {card.shape}, got others ({first}); train again") from error
    return card, module.eval()


def _content(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    try:
        content = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # torch.load raises many types
        raise ValueError(
            f"{path} must be a checkpoint of weights, got a damaged file or another kind; copy it again, or train again"
        ) from error
    if not (isinstance(content, dict) and {"card", "state"} <= set(content) and isinstance(content["card"], str)):
        raise ValueError(
            f"{path} must be a checkpoint that viewshed saved, got another; give the one of viewshed train"
        )
    return content
