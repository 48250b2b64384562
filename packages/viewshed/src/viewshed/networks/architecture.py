"""The shape of a network and its dropout masks. Needs numpy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class UNetShape:
    """Shape of the U-Net of arXiv 2503.07375, of one map in: ``width · 2^i`` channels after i poolings.

    >>> UNetShape().parameters, sum(UNetShape().masked_channels)
    (486409, 352)
    """

    width: int = 8  # channels of the first stage, 1 to 256
    depth: int = 4  # poolings, 1 to 8
    dropout: float = 0.1  # share of channels that a mask sets to zero, in [0, 1)

    def __post_init__(self) -> None:
        for name, high in (("width", 256), ("depth", 8)):
            value = getattr(self, name)
            if not (isinstance(value, int) and 1 <= value <= high):
                raise ValueError(f"{name} must be a whole number in [1, {high}], got {value!r}")
        if not 0.0 <= self.dropout < 1.0:
            raise ValueError(f"dropout must lie in [0, 1), got {self.dropout}")

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels of the encoder's stages and, last, of the bottleneck."""
        return tuple(self.width << i for i in range(self.depth + 1))

    @property
    def masked_channels(self) -> tuple[int, ...]:
        """Channels of each masked stage in the order of a mask: encoder from stage 2, bottleneck, decoder but its last.

        >>> UNetShape(8, 4).masked_channels
        (16, 32, 64, 128, 64, 32, 16)
        """
        return (*self.widths[1:], *self.widths[-2:0:-1])

    def masks(self, passes: int, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return masks (passes, M) for Monte Carlo dropout: 0 with probability ``dropout``, else 1 / (1 - dropout).

        The masks of several passes are balanced: each channel is dropped in that share of them, as nearly as whole
        numbers allow (a Latin hypercube; McKay, Beckman and Conover 1979). The mean over 10 of them is nearer to that
        over very many than the mean over 20 that are drawn independently.
        """
        if passes < 1:
            raise ValueError(f"passes must be at least 1, got {passes}")
        drawn = rng.random((passes, sum(self.masked_channels)), dtype=np.float32)
        # One draw of each channel in each of `passes` equal parts of [0, 1), the parts in an order of their own.
        part = rng.permuted(np.broadcast_to(np.arange(passes)[:, None], drawn.shape), axis=0).astype(np.float32)
        keep = (part + drawn) / np.float32(passes) >= np.float32(self.dropout)
        return keep.astype(np.float32) * np.float32(1.0 / (1.0 - self.dropout))

    def no_masks(self, count: int) -> NDArray[np.float32]:
        """Return masks (count, M) that change nothing: dropout off."""
        return np.ones((count, sum(self.masked_channels)), np.float32)

    @property
    def parameters(self) -> int:
        """Number of trained numbers: convolutions, batch normalization (2 a channel), biases where none follows."""
        total = self.width + 1
        for inner, outer in self._stages():
            total += 9 * inner * outer + 9 * outer * outer + 4 * outer
        return total + sum(4 * 2 * w * w + w for w in self.widths[:-1])

    def flops(self, cells: int) -> int:
        """Return the multiplications and additions in convolutions of one pass over (cells, cells)."""
        stages = [9 * (inner + outer) * outer for inner, outer in self._stages()]
        macs = sum(products * (cells >> i) ** 2 for products, i in zip(stages, self._levels(), strict=True))
        macs += sum(2 * w * w * (cells >> i) ** 2 for i, w in enumerate(self.widths[:-1]))
        return 2 * (macs + self.width * cells**2)

    @property
    def divisor(self) -> int:
        """What the cells of a side must divide by."""
        return 1 << self.depth

    def _stages(self) -> list[tuple[int, int]]:
        """Channels in and out of each stage, encoder, bottleneck, decoder from deep to shallow."""
        down = list(zip((1, *self.widths[:-1]), self.widths, strict=True))
        return down + [(2 * w, w) for w in self.widths[-2::-1]]

    def _levels(self) -> list[int]:
        return [*range(self.depth + 1), *range(self.depth - 1, -1, -1)]
